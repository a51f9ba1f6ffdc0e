"""Whole reports in a browser: a stage with all that a demo has, a delta, a rig, a printer."""

import os
import sys
from pathlib import Path

import pytest
from helpers.browser import Browser, needs_browser
from helpers.commands import ppmcal, rows
from helpers.paths import ROOT
from helpers.shared import shared_demo

from ppmcal.io import read_mechanism

DATA = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data"))
LARGEST = 5_000_000
UNFOLD = "document.querySelectorAll('details').forEach(d => { d.open = true })"
PICK = "document.dispatchEvent(new CustomEvent('ppmcal-select', {{detail: {{keys: {}}}}}))"
BESIDE = ("[...document.querySelectorAll('main *')].filter(e => {"
          "for (let p = e; p; p = p.parentElement) if (p.matches('.scroll,svg,.js-plotly-plot,"
          ".tools')) return false;"
          "const b = e.getBoundingClientRect();"
          "return b.width && b.right > innerWidth + 1 }).map(e => e.outerHTML.slice(0, 90))")
pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.xdist_group("browser")]


def campaign(kind, folder):
    """Simulate and identify a machine; return how many limbs it has."""
    ppmcal("init", kind, "--out", "mine.yaml", cwd=folder, expect=0)
    ppmcal("simulate", "mine.yaml", "mine.scenario.yaml", "--out", "simulated", cwd=folder)
    ppmcal("identify", "mine.yaml", "simulated/measurements.csv", "--out", "identified",
           cwd=folder)
    return len(read_mechanism(folder / "mine.yaml").limbs)


def stage(folder):
    """Return a page with every chapter of the demo's, made in a fifth of its time."""
    limbs = campaign("3-RRR-1", folder)
    seen = [(r["x"], r["y"], r["rz"]) for r in rows(folder / "simulated/measurements.csv")[:6]]
    (folder / "poses.csv").write_text("\n".join(map(",".join, [("x", "y", "rz"), *seen, ()])))
    steps = {"diagnosed": ("diagnose", "mine.yaml", "simulated/measurements.csv"),
             "compensated": ("compensate", "identified", "poses.csv"),
             "kinematics": ("kinematics", "inverse", "mine.yaml", "poses.csv"),
             "sensitivity": ("sensitivity", "mine.yaml"),
             "plan": ("plan", "mine.yaml", "--count", 5)}
    for out, words in steps.items():
        assert ppmcal(*words, "--out", out, cwd=folder).code in (0, 1)
    ppmcal("report", "identified", "simulated", *steps, "--out", "report", cwd=folder, expect=0)
    return folder / "report/report.html", limbs


def delta(folder):
    limbs = campaign("delta-linear", folder)
    ppmcal("report", "identified", "simulated", "--out", "report", cwd=folder, expect=0)
    return folder / "report/report.html", limbs


def rig(folder):
    if not (DATA / "stewart-jugglebot").is_dir():
        pytest.skip("real measurements are not at hand (PPMCAL_DATA)")
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import real_sessions

    real_sessions.written_rig(DATA / "stewart-jugglebot", folder)
    ppmcal("identify", "rig.yaml", "day108.csv", "--out", "identified", cwd=folder)
    ppmcal("report", "identified", "--out", "report", cwd=folder, expect=0)
    return folder / "report/report.html", 6


def printer(folder):
    ppmcal("import", "klipper", ROOT / "sample_data/printer/printer.cfg", cwd=folder, expect=0)
    ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", "imported/distances.csv",
           cwd=folder)
    ppmcal("export", "klipper", "identified", cwd=folder)
    ppmcal("report", "identified", "exported", "--out", "report", cwd=folder, expect=0)
    return folder / "report/report.html", 3


MAKERS = {"planar": stage, "delta": delta, "rig": rig, "printer": printer}


@pytest.fixture(scope="module", params=[pytest.param("demo", marks=pytest.mark.long), *MAKERS])
def made(request, tmp_path_factory):
    """Return a report and how many limbs its machine has."""
    if request.param == "demo":
        return shared_demo(tmp_path_factory) / "demo-results/report/report.html", 6
    return MAKERS[request.param](tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="module")
def browser():
    with Browser() as one:
        yield one


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_a_page_fits_and_draws_everything(browser, made, width, dark):
    path, limbs = made
    assert path.stat().st_size < LARGEST
    page = browser.open(path, width=width, dark=dark)
    # usable: what is first to be seen is drawn, long before all of it is
    ready = page.evaluate("performance.getEntriesByType('navigation')[0].domInteractive")
    assert ready < 10_000.0, f"{ready:.0f} ms to the first use"
    page.evaluate(UNFOLD)
    for selector in (".drawing", ".machine"):
        count = page.evaluate(f"document.querySelectorAll('{selector}').length")
        assert count
        for n in range(count):
            one = f"document.querySelectorAll('{selector}')[{n}]"
            page.evaluate(f"{one}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
            page.wait_for(f"!!{one}.dataset.drawn")
    drawn = page.evaluate("[...document.querySelectorAll('.machine')].map(m => +m.dataset.limbs)")
    assert drawn
    assert set(drawn) == {limbs}
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(BESIDE) == []
    assert not page.errors
    assert not page.requests
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/[0-9]+/g)")
    assert (sum(map(int, ground)) < 200) == dark
    page.close()


def test_rows_are_linked_from_the_table_to_plots_and_machine(browser, made):
    path, _ = made
    page = browser.open(path)
    page.evaluate(UNFOLD)
    row = page.evaluate("document.querySelector('tr[data-row]').dataset.row")
    page.evaluate(f"document.querySelector('tr[data-row]').click(); {UNFOLD}")
    assert row in page.evaluate("[...document.querySelectorAll('tr.lit')].map(r => r.dataset.row)")
    assert page.evaluate("document.querySelector('.chosen').hidden") is False
    page.evaluate(PICK.format("[]"))
    assert page.evaluate("document.querySelectorAll('tr.lit').length") == 0
    assert page.evaluate("document.querySelector('.chosen').hidden") is True
    assert not page.errors
    page.close()


def test_contents_lead_to_every_chapter_and_open_what_is_folded(browser, made):
    path, _ = made
    page = browser.open(path)
    lost = page.evaluate("[...document.querySelectorAll('.toc a')].filter("
                         "a => !document.getElementById(a.hash.slice(1))).length")
    assert lost == 0
    folded = page.evaluate("(document.querySelector('details.part:not([open])') || {}).id")
    assert folded
    page.evaluate(f"document.querySelector('.toc a[href=\"#{folded}\"]').click()")
    page.wait_for(f"document.getElementById('{folded}').open")
    page.close()


def test_a_table_is_searched_and_sorted(browser, made):
    path, _ = made
    page = browser.open(path)
    page.evaluate(UNFOLD)
    table = "document.querySelector('.tools input[type=search]').closest('.box')"
    page.evaluate(f"(() => {{ const f = {table}.querySelector('input'); f.value = "
                  f"{table}.querySelector('tbody tr').cells[0].textContent;"
                  "f.dispatchEvent(new Event('input')) })()")
    shown = f"[...{table}.querySelectorAll('tbody tr')].filter(r => !r.hidden).length"
    total = page.evaluate(f"{table}.querySelectorAll('tbody tr').length")
    assert 1 <= page.evaluate(shown) < total
    page.close()
