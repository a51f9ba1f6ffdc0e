"""What a browser makes of drawings: limbs, slider, points, the chosen row, what needs a look."""

import json
import shutil
from dataclasses import replace

import pytest
from helpers.browser import Browser, needs_browser
from helpers.commands import ppmcal
from helpers.paths import ROOT

from ppmcal.io import read_mechanism
from ppmcal.io.results.scene import Scene
from ppmcal.report.drawing import drawing_page

pytestmark = needs_browser
EVIL = "</script><img src=x onerror=alert(1)> & \u2028 'leg'"
SCENES = "document.querySelectorAll('.machine')"


@pytest.fixture(scope="module")
def browser():
    with Browser() as one:
        yield one


def drawn(page, n=0):
    """Bring a drawing into view, wait for it and return its state."""
    page.evaluate(f"{SCENES}[{n}].scrollIntoView({{block: 'center', behavior: 'instant'}})")
    page.wait_for(f"!!{SCENES}[{n}].dataset.drawn")
    return state(page, n)


def state(page, n=0):
    return page.evaluate(f"({{...{SCENES}[{n}].dataset}})")


def limbs_drawn(page, n=0):
    """Return the names that label the limbs in the drawing itself, and how many traces it has."""
    return page.evaluate(
        f"{SCENES}[{n}].querySelector('.js-plotly-plot').data.find(t => t.name === 'names')"
        ".text.filter(t => t)")


def move(page, to, n=0):
    page.evaluate(f"(() => {{ const s = {SCENES}[{n}].querySelector('.m-pose'); s.value = {to};"
                  "s.dispatchEvent(new Event('input')) })()")
    page.pause(0.2)


def label(page, n=0):
    return page.evaluate(f"{SCENES}[{n}].querySelector('.m-label').value")


def overflow(page):
    return page.evaluate("document.documentElement.scrollWidth - innerWidth")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6-UPS", "3-RRR-1", "delta-linear", "3-RPS"])
@pytest.mark.parametrize("width, dark", [(1280, False), (390, True)])
def test_a_page_of_check_is_drawn(browser, tmp_path, name, width, dark):
    machine = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    evil = replace(machine, limbs=(replace(machine.limbs[0], name=EVIL), *machine.limbs[1:]))
    path = tmp_path / "machine.html"
    path.write_text(drawing_page(Scene.of(evil)), encoding="utf-8")
    page = browser.open(path, width=width, dark=dark)
    assert int(drawn(page)["drawn"]) >= 8
    labels = limbs_drawn(page)
    assert len(labels) == len(machine.limbs) and labels[1:] == [b.name for b in machine.limbs[1:]]
    assert label(page) == "home" and overflow(page) <= 0
    last = int(page.evaluate("document.querySelector('.m-pose').max"))
    assert last >= 4 * len(machine.dof) - 1 - 4 * (len(machine.dof) - len(machine.actuators))
    move(page, 1)
    assert label(page) != "home" and state(page)["frame"] != "0"
    page.evaluate("document.querySelector('.m-home').click()")
    assert label(page) == "home"
    assert page.evaluate("document.querySelectorAll('.m-joints tbody tr').length") == len(
        machine.actuators)
    ink = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(json.loads(f"[{ink[4:-1]}]")) < 200) == dark
    assert page.evaluate("document.querySelector('img[src=x]')") is None
    assert not page.errors and not page.requests
    page.close()


@pytest.mark.slow
def test_a_home_out_of_reach_is_drawn_open(browser, tmp_path):
    text = (ROOT / "configs/3-RRR-1.yaml").read_text().replace("distal: 220", "distal: 20", 1)
    (tmp_path / "far.yaml").write_text(text)
    run = ppmcal("check", "far.yaml", "--draw", "far.html", cwd=tmp_path, expect=2)
    assert "cannot be reached by limb 'leg1'" in run.err and "as far as it goes" in run.out
    page = browser.open(tmp_path / "far.html")
    drawn(page)
    assert "leg1 does not close: 10 mm" in page.evaluate(
        "document.querySelector('.m-marks').textContent")
    gap = page.evaluate("document.querySelector('.js-plotly-plot').data"
                        ".filter(t => t.name === 'does not close').map(t => [t.line.color, t.x])")
    assert gap[0][0] == "rgb(194, 41, 58)" and len(gap[0][1]) == 3
    assert len(limbs_drawn(page)) == 3 and not page.errors
    page.close()


@pytest.fixture(scope="module", params=["3-RPR", "6-UPS"])
def report(request, tmp_path_factory):
    """Return a report of an identification from simulated rows, and how many limbs it has."""
    folder = tmp_path_factory.mktemp("report")
    ppmcal("init", request.param, "--out", "mine.yaml", cwd=folder, expect=0)
    ppmcal("simulate", "mine.yaml", "mine.scenario.yaml", "--out", "simulated", cwd=folder)
    ppmcal("identify", "mine.yaml", "simulated/measurements.csv", "--out", "fit", cwd=folder)
    shutil.copytree(folder / "fit", folder / "again")
    ppmcal("report", "fit", "again", "--out", "report", cwd=folder)
    return folder / "report/report.html", 3 if request.param == "3-RPR" else 6


@pytest.mark.slow
def test_the_report_draws_each_machine_and_links_its_rows(browser, report):
    path, limbs = report
    page = browser.open(path)
    assert page.evaluate(f"{SCENES}.length") == 2
    for n in range(2):
        assert drawn(page, n)["index"] == str(n)
        assert len(limbs_drawn(page, n)) == limbs
        # the second machine and the measured rows with their errors are there
        names = page.evaluate(
            f"{SCENES}[{n}].querySelector('.js-plotly-plot').data.map(t => t.name)")
        assert any(t.startswith("identified, ×") for t in names)
        assert "measured rows" in names and any(t.startswith("errors after") for t in names)
    # from the page to the drawing: the point is lit, the machine moves, numbers are told
    key, frame = page.evaluate(
        f"(() => {{ const s = JSON.parse({SCENES}[0].querySelector('script').textContent);"
        "const m = s.measured.find(m => m.own); return [m.key, m.frame] })()")
    page.evaluate("document.dispatchEvent(new CustomEvent('ppmcal-select', {detail: {keys: ["
                  f"{json.dumps(key)}], source: document.body}}}}))")
    page.pause(0.3)
    assert state(page, 0)["frame"] == str(frame) and label(page, 0).startswith("row ")
    said = page.evaluate(f"{SCENES}[0].querySelector('.m-row-said').textContent")
    assert label(page, 0) in said and "after the fit" in said and "at its joint values" in said
    lit = f"{SCENES}[0].querySelector('.js-plotly-plot').data.filter(t => t.name === 'chosen')"
    assert page.evaluate(lit + ".length") == 1
    assert state(page, 1)["chosen"] == "0"
    # from the drawing to the page: a click says which row
    page.evaluate("document.addEventListener('ppmcal-select', e => { window.got = e.detail.keys })")
    other = page.evaluate(
        f"(() => {{ const plot = {SCENES}[1].querySelector('.js-plotly-plot');"
        "const t = plot.data.find(t => t.name === 'measured rows');"
        "plot.emit('plotly_click', {points: [{customdata: t.customdata[0]}]});"
        "return t.customdata[0] })()")
    page.wait_for("!!window.got")
    assert page.evaluate("window.got") == [other] and other.startswith("1:")
    page.pause(0.2)
    assert state(page, 1)["chosen"] == "1" and state(page, 0)["chosen"] == "0"
    page.evaluate("document.dispatchEvent(new CustomEvent('ppmcal-select', {detail: {keys: []}}))")
    page.pause(0.2)
    assert state(page, 1)["chosen"] == "0" and not page.errors
    page.close()


@pytest.mark.slow
def test_the_errors_switch_between_before_and_after(browser, report):
    path, _ = report
    page = browser.open(path, width=390, dark=True)
    drawn(page)
    plot = "document.querySelector('.machine .js-plotly-plot')"
    for stage in ("before", "after"):
        page.evaluate(f"document.querySelector('[data-stage={stage}]').click()")
        page.pause(0.3)
        assert page.evaluate(f"{plot}.data.some(t => t.name.startsWith('errors {stage}'))")
        assert stage in page.evaluate(
            f"{plot}.data.find(t => t.name === 'measured rows').marker.colorbar.title.text")
    page.evaluate("document.querySelector('[data-stage=none]').click()")
    page.pause(0.3)
    assert not page.evaluate(f"{plot}.data.some(t => t.name.startsWith('errors'))")
    assert overflow(page) <= 0 and not page.errors
    page.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6-UPS", "3-RRR-1"])
def test_a_dark_drawing_is_printed_on_a_light_ground(browser, tmp_path, name):
    from PIL import Image

    path = tmp_path / "machine.html"
    machine = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    path.write_text(drawing_page(Scene.of(machine)), encoding="utf-8")
    page = browser.open(path, dark=True)
    drawn(page)

    def ground():
        page.pause(0.3)
        page.middle(".m-drawing")
        left, top = page.evaluate("(() => { const b = document.querySelector('.m-drawing')"
                                  ".getBoundingClientRect(); return [b.x, b.y] })()")
        page.screenshot(tmp_path / "seen.png")
        with Image.open(tmp_path / "seen.png") as image:
            return min(image.convert("RGB").getpixel((int(left) + 8, int(top) + 120)))

    assert ground() < 60
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert ground() > 225
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert ground() < 60
    page.close()
