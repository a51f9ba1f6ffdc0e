"""Plots of layers and rows of bars: what is drawn is read back from SVG and PNG."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from helpers.drawings import (
    bars,
    bold,
    boxes,
    figure_of,
    lines,
    parsed,
    pieces,
    shapes,
    style,
    svg_of,
    texts,
)
from matplotlib import image
from matplotlib.patches import Rectangle

from ppmcal.plotting.bars import Chart, Row, ratio_ticks
from ppmcal.plotting.canvas import WIDTH, Drawing, broken, fitted, width
from ppmcal.plotting.layers import (
    Arrows,
    Band,
    Dots,
    Histogram,
    Intervals,
    Marks,
    Polyline,
    Starts,
    Strokes,
    WordsAt,
    Zero,
)
from ppmcal.plotting.picture import sheet
from ppmcal.plotting.plot import Axis, Plot, span
from ppmcal.plotting.style import AFTER, BEFORE, OUT, PAGE, figure, look, png
from ppmcal.plotting.svg import svg
from ppmcal.report.html import template_text

HOSTILE = {"markup": "<b>&$_^{x}", "formula": "$\\frac{$", "control": "a\x00b\ud800\nc",
           "greek": "Ω" * 120, "long": "leg" * 80, "dollar": "\\$x$", "empty": ""}


def chart(label="leg1", words="3 mm", **more):
    rows = [Row("heading", strong=True),
            Row(label, ((4.0, "before"), (2.0, "after")), words, ((1.0, "limit"),)),
            Row("second", ((8.0, "before"), (1.0, "after")), "1 mm", ((1.0, "dotted"),))]
    given = {"scale": "log", "low": 0.5, "high": 16.0, "axis": "times", **more}
    return Chart(rows, **given)


X, Y = Axis(0.0, 10.0), Axis(-1.0, 1.0)


def picture(*layers, x=X, y=Y, names=("row", "error (mm)"), **more):
    return Drawing("Title", "Caption.", "Description.",
                   Plot(x, y, names, layers, **more))


def everything(n=5):
    t = np.linspace(0.5, 9.5, n)
    v = np.sin(t)
    return picture(
        Band(-0.5, 0.5), Zero(), Zero(upright=True), Dots(t, v, "after"), Polyline(t, v),
        Strokes(t, v - 0.1, v + 0.1, "before"), Strokes(v, t, t + 1.0, "before", flat=True),
        Marks(t, v, "out", "x"), Marks(t, v, "out", "D"), Intervals(t, v, 0.1 + 0.0 * v, "before"),
        Histogram(t, np.abs(v[1:])), Starts([(2.0, "tuesday")]),
        Arrows(t, v, 9.0 * v, 9.0 * v, "after"), WordsAt(20.0, 14.0, "2 mm"))


@pytest.mark.parametrize("scale", ["log", "linear", "root"])
@pytest.mark.parametrize("beside", [False, True])
def test_bars_are_in_proportion(scale, beside):
    low = 0.5 if scale == "log" else 0.0
    drawn = parsed(svg_of(chart(scale=scale, low=low, beside=beside)
                   .drawing("Title", "Caption.", "Description.")))
    size = {"log": lambda v: np.log(v / 0.5), "linear": float, "root": np.sqrt}[scale]
    # where labels are above, both bars of a row are drawn in one place
    before, after = bars(drawn, "before"), bars(drawn, "after")
    assert len(before) == len(after) == 2
    unit = before[0] / size(4.0)
    assert [before[1], *after] == pytest.approx([unit * size(v) for v in (8.0, 2.0, 1.0)], abs=0.2)
    left = shapes(drawn, "before")[0][0][0]
    (noise,), (dotted,) = lines(drawn, dashed=False), lines(drawn, dashed=True)
    for (x, top), (end, low_) in (noise, dotted):
        assert x == end and x - left == pytest.approx(unit * size(1.0), abs=0.2) and low_ > top
    assert {"leg1", "second", "3 mm", "1 mm", "times"} <= set(texts(drawn))
    assert "heading" in bold(drawn)


def test_bars_beyond_the_scale_end_at_it():
    rows = [Row("a", ((v, "after"),)) for v in (1e300, 16.0, 0.0, -1.0, 0.5)]
    drawn = parsed(svg_of(Chart(rows, "log", 0.5, 16.0, "").drawing("", "", "")))
    wide = [max(x for x, _ in b) - min(x for x, _ in b) for b in shapes(drawn, "after")]
    assert wide[0] == wide[1] > 300.0 and wide[2:] == pytest.approx([0.8] * 3, abs=0.05)


@pytest.mark.slow_cases("True-greek", "False-greek", "True-dollar")
@pytest.mark.long_cases("False-long", "True-long")
@pytest.mark.parametrize("label", HOSTILE.values(), ids=HOSTILE)
@pytest.mark.parametrize("beside", [False, True])
def test_no_words_break_a_drawing(label, beside):
    """Markup, formulas and letters that XML forbids are plain words; long ones are cut."""
    shown = " ".join("".join(c if c.isprintable() else " " for c in label).split())
    legend = [("before", label), ("limit", label)]
    found = [chart(label, label, beside=beside, axis=label, legend=legend)
             .drawing(label, label, label),
             picture(Starts([(2.0, label), (9.0, label)]), WordsAt(20.0, 14.0, label[:14]),
                     names=(label, label))]
    for one in found:
        root = parsed(svg_of(one))
        assert root.findtext("title") == one.title or root.findtext("title") == shown
        for box in boxes(root):
            assert -0.2 <= box.left <= box.right <= WIDTH + 0.2, box
            assert -0.2 <= box.top <= box.low <= one.height + 0.2, box
        words = ["".join(t.itertext()).removeprefix(t.text or "") or t.text or ""
                 for t in root.iter("text")]
        assert not shown or shown in words
    drawn = sheet(label, found)
    root = parsed(svg(drawn, label, label))
    assert root.findtext("title") == shown
    wide = float(root.get("viewBox").split()[2])
    assert all(-0.2 <= b.left <= b.right <= wide + 0.2 for b in boxes(root))
    assert png(drawn).startswith(b"\x89PNG")


def test_a_drawing_needs_nothing_else_and_is_the_same_again():
    one = everything()
    text = svg_of(one)
    assert text == svg_of(one) == svg_of(everything())
    assert not re.search(r"href|url\(| id=|<style|<image|nan|inf\b|class=|var\(", text)
    assert text.count("http") == 1
    assert set(re.findall(r"#[0-9a-f]{6}", text)) <= set(PAGE)
    root = parsed(text)
    assert root.get("viewBox") == "0 0 400 250" and root.findtext("title") == "Title"
    assert root.findtext("desc") == "Description."
    assert {"row", "error (mm)", "tuesday", "2 mm"} <= set(texts(root))
    assert AFTER in text and BEFORE in text and OUT in text


def test_the_page_has_the_colours_of_files_by_day():
    light = dict(re.findall(r"--(\w+):([^;}]+)", template_text("page.css").partition("}")[0]))
    short = {"#fff": "#ffffff"}
    assert {c: short.get(light[name], light[name]) for c, name in PAGE.items()} == {
        c: c for c in PAGE}


def test_layers_are_where_their_numbers_are():
    x, y = np.array([0.0, 5.0, 10.0, 5.0, np.nan]), np.array([-1.0, 0.0, 1.0, 7.0, 0.0])
    root = parsed(svg_of(picture(Dots(x, y, "after"), Marks(x, y, "out", "D", 6.0))))
    at = [p[0] for p in lines(root, AFTER)]
    left, low, right, top = *at[0], *at[2]
    assert left < right and low > top
    assert at[1] == pytest.approx((0.5 * (left + right), 0.5 * (low + top)), abs=0.1)
    assert at[3] == pytest.approx((0.5 * (left + right), top), abs=0.1)
    assert len(at) == 4
    (path,) = (p for p in root.iter("path") if style(p).get("fill") == OUT)
    middles = [tuple(np.mean(piece[:4], axis=0)) for piece in pieces(path)]
    assert np.allclose(middles, at, atol=0.15)


@pytest.mark.parametrize("ends", [(1e-5, 1e-2, True), (0.01, 0.1, True), (1e-4, 1e-3, True),
                                  (-0.0004, 0.0007, False), (-12345.6, 12346.1, False)])
def test_axes_leave_room_for_their_names(ends):
    root = parsed(svg_of(picture(x=Axis(1790.0, 1950.1), y=Axis(*ends))))
    found = boxes(root)
    assert len(found) > 4 and "1900" in texts(root)
    for n, box in enumerate(found):
        assert 0.0 <= box.left <= box.right <= WIDTH, box
        assert not [other for other in found[:n] if box.meets(other)], box


def test_thousands_of_dots_are_small():
    t = np.linspace(0.0, 10.0, 3000)
    one = picture(Dots(t, np.sin(t), "after"))
    assert len(svg_of(one)) < 3000 * 16 + 4000
    with look():
        shot = image.imread(io.BytesIO(png(figure_of(one))))[..., :3]
    blue = np.abs(shot - np.array([0x1f, 0x62, 0xa6]) / 255.0).max(axis=-1) < 0.02
    assert blue.any(axis=0).mean() > 0.75


@pytest.mark.slow
def test_each_of_some_dots_is_there_in_pixels_too():
    """Ends in whole pixels would leave a dot no length, and nothing to draw."""
    def blue(count):
        t = 0.31 + 9.0 * np.arange(count) / 29.0
        with look():
            shot = image.imread(io.BytesIO(png(figure_of(picture(
                Dots(t, 0.9 * np.sin(t), "after", 4.0))), dpi=213.0)))[..., :3]
        return (np.abs(shot - np.array([0x1f, 0x62, 0xa6]) / 255.0).max(axis=-1) < 0.1).sum()

    assert blue(30) > 20.0 * blue(1) > 0.0


@pytest.mark.parametrize("values", [[], [np.nan], [0.0], [3.0], [1e300, -1e300], [np.inf, 1.0],
                                    [5e-324] * 3, [1e-90, 2e-90], [1.0, 1.0 + 1e-15]])
@pytest.mark.parametrize("log", [False, True])
def test_no_numbers_break_a_drawing(values, log):
    v = np.array(values, dtype=float)
    drawn = svg_of(picture(Dots(v, v, "after"), Polyline(v, v), Marks(v, v, "before", "o"),
                    Strokes(v, -v, v, "out"), Intervals(v, v, v, "before"), Zero(),
                    x=span(v), y=span(v, log=log)))
    assert not re.search(r"nan|inf\b", drawn)
    assert all(t.strip() for t in texts(parsed(drawn)))


def test_what_an_inline_drawing_cannot_hold_is_refused():
    drawn = figure(4.0, 2.0)
    drawn.add_axes((0.1, 0.1, 0.8, 0.8)).plot([1, 2], [3, 4])
    with pytest.raises(ValueError, match="nothing clipped"):
        svg(drawn, "clipped")
    drawn = figure(4.0, 2.0)
    drawn.add_artist(Rectangle((0.1, 0.1), 0.5, 0.5, hatch="//"))
    with pytest.raises(ValueError, match="hatched"):
        svg(drawn, "hatched")


def test_words_are_cut_and_broken_to_their_room():
    assert fitted("short", 100.0) == "short"
    cut = fitted("a name that is too long", 60.0)
    assert cut.endswith("…") and width(cut) <= 60.0 < width(cut[:-1] + "nn…")
    lines_ = broken("words that need more than one line", 80.0)
    assert " ".join(lines_) == "words that need more than one line" and len(lines_) > 1
    assert max(map(width, lines_)) <= 80.0
    assert [w for _, w in ratio_ticks(20.0)] == ["1", "2", "5", "10", "20"]
    assert [w for _, w in ratio_ticks(1e4)] == ["1", "10", "100", "1000", "10000"]


def test_long_words_are_told_in_full_on_hovering():
    root = parsed(svg_of(chart("leg1 leg2 leg_3 " * 10 + "axes_1").drawing("", "", "")))
    (cut,) = (t for t in root.iter("text") if len(t))
    assert (cut.text or "").endswith("…")
    assert cut.findtext("title") == "leg1 leg2 leg_3 " * 10 + "axes_1"
    assert cut.text.removesuffix("…") in cut.findtext("title")
