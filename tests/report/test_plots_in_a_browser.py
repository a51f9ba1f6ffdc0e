"""The plots of a page as a browser draws them: hover, linked rows, dark, paper, small screens."""

from __future__ import annotations

import json

import pytest
from helpers.browser import Browser, needs_browser
from helpers.report_files import identification, specs, write_csv, write_fit

from ppmcal.report import collect, to_html

pytestmark = [needs_browser, pytest.mark.xdist_group("browser")]
EVIL = "run </script><img src=x onerror=alert(1)>"
LISTEN = ("window.heard = []; document.addEventListener('ppmcal-select', "
          "(e) => window.heard.push(e.detail.keys))")
PICK = "document.dispatchEvent(new CustomEvent('ppmcal-select', {{detail: {{keys: {}}}}}))"
FRESH = "document.querySelectorAll('.drawing[data-drawn]').length"


def plot(title: str) -> str:
    return f'.drawing[data-name="{title}"]'


X, Y = plot("Residual of x by row, after"), plot("Residual of y by row, after")


@pytest.fixture(scope="module")
def browser():
    with Browser() as one:
        yield one


def opened(browser, path, **how):
    """Open a page with nothing folded."""
    page = browser.open(path, **how)
    page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true })")
    return page


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plots")
    fit = write_fit(folder / "fit", identification(), 60)
    text = (fit / "residuals.csv").read_text()
    (fit / "residuals.csv").write_text(text.replace(",run,", f",{EVIL},"))
    other = folder / "commands"
    other.mkdir()
    write_csv(other / "commands.csv", {"error_position_before": [0.3, 0.4],
                                       "error_position_after": [1e-3, 2e-3],
                                       "status": ["ok", "ok"], "reason": ["", ""]})
    (other / "commands.json").write_text(json.dumps({"units": {"length": "mm", "angle": "deg"}}))
    page = folder / "report.html"
    page.write_text(to_html(collect([fit, other])), encoding="utf-8")
    return page


def drawn(page, selector):
    """Bring a plot into the window and wait for it; return the middle of its pane."""
    page.middle(selector)
    page.wait_for(f"document.querySelector({selector!r}).dataset.drawn")
    page.pause(0.2)
    return page.middle(f"{selector} .nsewdrag")


def place(page, selector, key):
    """Return where the point of a row is in the window, pixels."""
    drawn(page, selector)
    return page.evaluate(f"""(() => {{
        const gd = document.querySelector({selector!r}), l = gd._fullLayout;
        const t = gd.data.find((t) => t.customdata && t.customdata.includes({key!r}));
        const i = t.customdata.indexOf({key!r});
        const b = gd.querySelector('.nsewdrag').getBoundingClientRect();
        return [b.x + l.xaxis.d2p(t.x[i]), b.y + l.yaxis.d2p(t.y[i])]; }})()""")


def lit(page, selector):
    """Return the keys of the rows that are lit, and whether the others are dim."""
    return page.evaluate(f"""(() => {{
        const gd = document.querySelector({selector!r});
        return [gd.data.flatMap((t) => (t.selectedpoints || []).map((i) => t.customdata[i])),
          gd.data.at(-1).x.length,
          [...gd.querySelectorAll('.points path')].filter((p) => +p.style.opacity < 0.5).length]
        }})()""")


def keys_of(html, title="Residual of x by row, after"):
    data = specs(html.read_text())[title]["data"]
    return next(t["customdata"] for t in data if "customdata" in t)


@pytest.mark.slow
def test_all_plots_are_drawn_without_an_error(browser, html):
    page = opened(browser, html)
    total = page.evaluate("document.querySelectorAll('figure.plot').length")
    assert total == len(specs(html.read_text())) >= 8
    assert page.evaluate(FRESH) < total or page.evaluate("innerHeight") > 3000, "drawn unseen"
    for i in range(total):
        page.evaluate(f"document.querySelectorAll('.drawing')[{i}].scrollIntoView()")
        page.wait_for(f"document.querySelectorAll('.drawing')[{i}].dataset.drawn")
    assert page.evaluate("document.querySelectorAll('.drawing .main-svg').length") >= total
    assert not page.errors and not page.requests
    assert page.evaluate("document.querySelectorAll('img').length") == 0
    assert page.evaluate("document.querySelectorAll('.plotlyjsicon, a[href*=plotly]').length") == 0
    page.close()


@pytest.mark.slow
def test_pointing_at_a_row_tells_it_with_its_unit(browser, html):
    page = opened(browser, html)
    key = keys_of(html)[7]
    page.hover(*place(page, X, key))
    page.wait_for(f"document.querySelector({X!r}).querySelector('.hoverlayer .hovertext')")
    text = page.evaluate(f"document.querySelector({X!r}).querySelector('.hovertext').textContent")
    assert EVIL in text and f"row {key.rpartition(':')[2]}" in text and "mm" in text
    assert not page.errors
    page.close()


@pytest.mark.slow
def test_rows_are_lit_in_all_plots_and_escape_puts_them_out(browser, html):
    page = opened(browser, html)
    keys = keys_of(html)[3:5]
    drawn(page, X), drawn(page, Y)
    page.evaluate(PICK.format(json.dumps(keys)))
    for one in (X, Y):
        drawn(page, one)
        page.wait_for(f"document.querySelector({one!r}).dataset.lit === '2'")
        found, rings, dim = lit(page, one)
        assert found == keys and rings == 2 and dim > 20
    late = plot("Residuals in the plane, after")  # drawn only now
    if page.evaluate(f"!!document.querySelector({late!r})"):
        drawn(page, late)
        assert lit(page, late)[0] == keys
    page.key("Escape")
    for one in (X, Y):
        drawn(page, one)
        page.wait_for(f"document.querySelector({one!r}).dataset.lit === '0'")
        assert lit(page, one) == [[], 0, 0]
    assert not page.errors
    page.close()


@pytest.mark.slow
def test_a_click_and_a_box_say_which_rows(browser, html):
    page = opened(browser, html)
    page.evaluate(LISTEN)
    key = keys_of(html)[7]
    page.click(*place(page, X, key))
    page.wait_for("window.heard.length")
    assert page.evaluate("window.heard.at(-1)") == [key]
    drawn(page, Y)
    page.evaluate(f"Plotly.relayout(document.querySelector({Y!r}), {{dragmode: 'select'}})"
                  ".then(() => 0)")
    x, y, wide, high = page.evaluate(
        f"(() => {{ const b = document.querySelector({Y!r}).querySelector('.nsewdrag')"
        ".getBoundingClientRect(); return [b.x, b.y, b.width, b.height] })()")
    page.drag(x + 3, y + 3, x + 0.5 * wide, y + high - 3)
    page.wait_for("window.heard.at(-1).length > 3")
    found = page.evaluate("window.heard.at(-1)")
    title = "Residual of y by row, after"
    every = {k for t in specs(html.read_text())[title]["data"] for k in t.get("customdata", ())}
    assert set(found) <= every and 0.3 * len(every) < len(found) < 0.7 * len(every)
    page.pause(0.5)
    assert page.evaluate("window.heard.length") < 6, "a selection must not answer itself"
    page.click(*place(page, X, key))
    page.wait_for(f"document.querySelector({Y!r}).dataset.lit === '1'")
    assert not page.errors
    page.close()


@pytest.mark.slow
def test_keys_go_from_point_to_point(browser, html):
    page = opened(browser, html)
    page.evaluate(LISTEN)
    drawn(page, X)
    page.evaluate(f"document.querySelector({X!r}).focus()")
    page.key("ArrowRight")
    page.wait_for(f"document.querySelector({X!r}).getAttribute('aria-description')")
    page.key("Enter")
    page.wait_for("window.heard.length")
    assert page.evaluate("window.heard.at(-1).length") == 1
    assert page.evaluate(f"document.querySelector({X!r}).getAttribute('aria-label').length") > 20
    page.close()


def colours(page, selector):
    """Return brightness of the ground and of the words of a plot, 0 to 255."""
    return page.evaluate(f"""(() => {{
        const b = (t) => t.match(/[\\d.]+/g).slice(0, 3).reduce((s, v) => s + +v / 3, 0);
        const e = document.querySelector({selector!r});
        return [b(getComputedStyle(e.closest('figure')).backgroundColor),
          b(getComputedStyle(e.querySelector('.xtitle')).fill)]; }})()""")


@pytest.mark.slow
def test_dark_is_dark_and_follows_a_change(browser, html):
    page = opened(browser, html, dark=True)
    drawn(page, X)
    ground, words = colours(page, X)
    assert ground < 80 < 150 < words
    page.media(dark=False)
    for _ in range(100):  # it is drawn anew when the machine finds time
        ground, words = colours(page, X)
        if words < 80:
            break
        page.pause(0.1)
    assert words < 80 < 200 < ground
    page.close()


@pytest.mark.slow
def test_paper_has_all_plots_in_light_colours(browser, html, tmp_path):
    page = opened(browser, html, dark=True)
    total = page.evaluate("document.querySelectorAll('figure.plot').length")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.wait_for(f"{FRESH} === {total}")
    assert colours(page, X)[1] < 80
    assert page.evaluate(f"document.querySelector({X!r})._fullLayout.width") == 330
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    drawn(page, X)
    page.wait_for(f"Math.abs(document.querySelector({X!r})._fullLayout.width - "
                  f"document.querySelector({X!r}).clientWidth) <= 1")
    assert colours(page, X)[1] > 150
    page.pdf(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF") and not page.errors
    page.close()


@pytest.mark.slow
def test_a_plot_follows_the_width_of_the_window(browser, html):
    page = opened(browser, html)
    drawn(page, X)
    page.resize(390, 800)
    page.wait_for(f"Math.abs(document.querySelector({X!r})._fullLayout.width - "
                  f"document.querySelector({X!r}).clientWidth) <= 1")
    for one in (X, Y):
        drawn(page, one)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.close()


@pytest.fixture(scope="module")
def long_html(tmp_path_factory):
    """Return a page of so many rows that its plots are thinned."""
    folder = tmp_path_factory.mktemp("long")
    page = folder / "report.html"
    page.write_text(to_html(collect([write_fit(folder / "fit", identification(), 1500)])),
                    encoding="utf-8")
    return page


@pytest.mark.slow
def test_a_row_that_is_thinned_away_is_drawn_when_it_is_chosen(browser, long_html):
    title = "Residual of x by row, after"
    drawn_keys = set(keys_of(long_html, title))
    assert len(drawn_keys) < 100
    some = next(k for k in drawn_keys)
    owner = some.rpartition(":")[0]
    number = next(n for n in range(700, 1500) if f"{owner}:{n}" not in drawn_keys)
    key = f"{owner}:{number}"
    page = opened(browser, long_html)
    drawn(page, X)
    page.evaluate(PICK.format(json.dumps([key])))
    page.wait_for(f"document.querySelector({X!r}).dataset.lit === '1'")
    table = (long_html.parent / "fit/residuals.csv").read_text().splitlines()
    column = table[0].split(",").index("after_x")
    value = float(table[number].split(",")[column])
    x, y, label = page.evaluate(
        f"(() => {{ const t = document.querySelector({X!r}).data.at(-2);"
        "return [t.x[0], t.y[0], t.text[0]] })()")
    assert x == number and y == pytest.approx(value, rel=1e-3) and f"row {number}" in label
    assert lit(page, X)[1] == 1, "it has its ring"
    page.key("Escape")
    page.wait_for(f"document.querySelector({X!r}).dataset.lit === '0'")
    assert page.evaluate(f"document.querySelector({X!r}).data.at(-2).customdata[0]") != key
    assert not page.errors
    page.close()


@pytest.mark.slow
def test_a_chosen_row_without_a_point_is_said_to_have_none(browser, long_html):
    page = opened(browser, long_html)
    drawn(page, X)
    owner = keys_of(long_html)[0].rpartition(":")[0]
    page.evaluate(PICK.format(json.dumps([f"{owner}:99999"])))
    note = f"document.querySelector({X!r}).parentElement.querySelector('.undrawn')"
    page.wait_for(f"!{note}.hidden")
    words = page.evaluate(f"{note}.textContent")
    assert "Not drawn here: run, row 99999." in words and words.endswith(" rows are.")
    page.key("Escape")
    page.wait_for(f"{note}.hidden")
    page.close()
