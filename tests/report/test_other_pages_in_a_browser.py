"""Pages without a fit of their own, in a browser: of batch, validate, kinematics, designs."""

import shutil
from pathlib import Path

import pytest
from helpers.browser import Browser, needs_browser
from helpers.commands import ppmcal
from helpers.shared import shared_desk

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.xdist_group("browser")]
SMALL = "x=-100:100:9,y=-100:100:9"
MADE = {
    "batch": [("batch", "fleet.yaml", "--cores", 1, "--out", "batched")],
    "validate": [("validate", "identified", "may.csv", "june.csv", "--against", "identified-may"),
                 ("report", "validated")],
    "compare": [("report", "compared")],
    "kinematics": [("kinematics", "inverse", "mine.yaml", "poses.csv", "--pictures", "--force"),
                   ("report", "kinematics")],
    "tolerances": [("tolerances", "mine.yaml", "--accuracy", 0.2, "--machines", 40, "--cores", 1),
                   ("report", "tolerances")],
    "workspace": [("workspace", "mine.yaml", "--grid", SMALL), ("report", "workspace")],
    "stiffness": [("stiffness", "mine.yaml", "--load", "fz=-100", "--grid", SMALL),
                  ("report", "stiffness")],
}
UNFOLD = "document.querySelectorAll('details').forEach(d => { d.open = true })"
DRAWINGS = "document.querySelectorAll('figure.plot .drawing, .machine')"
BESIDE = ("[...document.querySelectorAll('main *')].filter(e => {"
          "for (let p = e; p; p = p.parentElement) if (p.matches('.scroll,svg,.js-plotly-plot,"
          ".tools')) return false;"
          "const b = e.getBoundingClientRect();"
          "return b.width && b.right > innerWidth + 1 }).map(e => e.outerHTML.slice(0, 90))")
EMPTY = ("[...document.querySelectorAll('img')].filter(i => !i.complete || !i.naturalWidth)"
         ".map(i => i.alt)")
PALE = """(() => {
  const b = (t) => t.match(/[\\d.]+/g).slice(0, 3).reduce((s, v) => s + +v / 3, 0);
  const ground = (e) => { for (let p = e; p; p = p.parentElement) {
    const c = getComputedStyle(p).backgroundColor.match(/[\\d.]+/g);
    if (c.length < 4 || +c[3] > 0.5) return b(c.join(',')); } return 255; };
  return [...document.querySelectorAll('h1,h2,h3,p,td,th,li,figcaption,summary')]
    .filter((e) => e.offsetParent && e.textContent.trim()
      && Math.abs(b(getComputedStyle(e).color) - ground(e)) < 60)
    .map((e) => e.textContent.slice(0, 60)); })()"""


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    return Path(shutil.copytree(shared_desk(tmp_path_factory),
                                tmp_path_factory.mktemp("desk") / "files"))


@pytest.fixture(scope="module", params=MADE)
def made(request, desk):
    """Return a page."""
    for line in MADE[request.param]:
        words = [*line, "--out", f"page-{request.param}"] if line[0] == "report" else line
        ppmcal(*words, cwd=desk)
    pages = (desk / "batched/batch.html", desk / f"page-{request.param}/report.html")
    return pages[request.param != "batch"]


@pytest.fixture(scope="module")
def browser():
    with Browser() as one:
        yield one


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_a_page_fits_and_can_be_read(browser, made, width, dark):
    page = browser.open(made, width=width, dark=dark)
    page.evaluate(UNFOLD)
    for n in range(page.evaluate(f"{DRAWINGS}.length")):
        page.evaluate(f"{DRAWINGS}[{n}].scrollIntoView({{block: 'center', behavior: 'instant'}})")
        page.wait_for(f"!!{DRAWINGS}[{n}].dataset.drawn")
    assert page.evaluate("document.querySelectorAll('h2').length")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(BESIDE) == []
    assert page.evaluate(EMPTY) == []
    assert page.evaluate(PALE) == []
    assert "`" not in page.evaluate("document.querySelector('main').innerText")
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/[0-9]+/g)")
    assert (sum(map(int, ground)) < 200) == dark
    assert not page.errors
    assert not page.requests
    page.close()
