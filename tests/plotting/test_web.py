"""Drawings as figures of a page: as many points as are drawn, words with units, colours by name."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from helpers.report_files import identification, specs, write_csv, write_fit
from helpers.sources import nodes_of

from ppmcal import plotting
from ppmcal.io.results.identification_tables import row_key, row_numbers
from ppmcal.plotting.bars import Chart, Row
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import (
    Arrows,
    Band,
    Between,
    Dots,
    Histogram,
    Intervals,
    Layer,
    Marks,
    Points,
    Polyline,
    Starts,
    Strokes,
    WordsAt,
    Zero,
)
from ppmcal.plotting.picture import draw_layer, sheet
from ppmcal.plotting.plot import Axis, Plot, row_y, rows_plot, span
from ppmcal.plotting.style import PAGE
from ppmcal.plotting.web import spec, told
from ppmcal.plotting.web_layers import add
from ppmcal.report import collect, to_html
from ppmcal.report.figure_files import TITLES
from ppmcal.report.html import script_json
from ppmcal.report.residual_figures import POINTS, residual_figures
from ppmcal.report.rows import DataRows

PLOTTING = Path(plotting.__file__).parent
EVIL = "</script><b>%{x}</b> & 'leg' --after"
N = 7
T = np.linspace(0.5, 9.5, N)
V = np.sin(T)


def plot(*layers, **more):
    given = {"x": Axis(0.0, 10.0), "y": Axis(-1.0, 1.0), "names": ("time (s)", "error (mm)"),
             "units": ("s", "mm"), **more}
    return Plot(layers=layers, **given).drawing("Title", "Caption.", "Description.")


def every():
    said = Points([f"leg{i}" for i in range(N)], [f"0:run:{i}" for i in range(N)])
    return plot(
        Band(-0.5, 0.5), Zero(), Zero(upright=True), Dots(T, V, "after", points=said),
        Polyline(T, V, "curve"), Strokes(T, V - 0.1, V + 0.1, "before", alpha=0.4),
        Marks(T, V, "out", "x", points=said), Intervals(T, V, 0.1 + 0.0 * V, "before"),
        Histogram(T, np.abs(V[1:])), Between(T, V - 0.2, V + 0.2), Starts([(2.0, "tuesday")]),
        Arrows(T, V, 9.0 * V, 9.0 * V, "after", np.abs(V), "mm", said), WordsAt(20.0, 14.0, "2 mm"))


def hovers(trace):
    """Return what is told at each point of a trace, before the page puts in its rows."""
    template = trace.get("hovertemplate", trace.get("hovertext"))
    return [template] * len(trace["x"]) if isinstance(template, str) else template


def colours(value, key=""):
    """Yield all colours of a figure."""
    if isinstance(value, dict):
        for k, v in value.items():
            yield from colours(v, k)
    elif isinstance(value, list):
        for v in value:
            yield from colours(v, key)
    elif isinstance(value, str) and key.lower().endswith("color"):
        yield value


def test_every_layer_has_its_points_and_units():
    found = spec(every())
    markers = [t for t in found["data"] if t.get("mode") == "markers"]
    assert [len(t["x"]) for t in markers] == [N] * 4
    for trace in markers:
        np.testing.assert_allclose(trace["y"], V, rtol=1e-5)
        assert all("mm" in t for t in (trace["text"] if "error_y" in trace else hovers(trace)))
    (bars,) = (t for t in found["data"] if t["type"] == "bar")
    assert len(bars["x"]) == int(np.sum(V[1:] != 0.0)) and all("mm" in t for t in hovers(bars))
    curve = next(t for t in found["data"] if "curve" in str(t.get("hovertemplate")))
    assert "error: %{y:.4~g} mm" in curve["hovertemplate"]
    assert "time: %{x:.4~g} s" in curve["hovertemplate"]
    strokes = next(t for t in found["data"] if t.get("line", {}).get("color") == "--before/0.4")
    assert strokes["x"].count(None) == N and len(strokes["x"]) == 3 * N
    assert [s["type"] for s in found["layout"]["shapes"]] == ["rect", "line", "line", "line"]
    assert [a["text"] for a in found["layout"]["annotations"]] == ["tuesday", "2 mm"]
    json.dumps(found, allow_nan=False)


def test_colours_are_those_that_the_page_has_by_name():
    rows = [Row("leg1", ((3.0, k),), "3 mm", ((1.0, "limit"), (2.0, "dotted")))
            for k in ("before", "after", "more", "alternative", "explained", "other")]
    chart = Chart(rows, "linear", 0.0, 4.0, "rms (mm)").drawing("", "", "")
    for drawing in (every(), chart):
        used = set(colours(spec(drawing)))
        assert used and all(re.fullmatch(r"--(\w+)(/[\d.]+)*", c) for c in used)
        assert {c.split("/")[0][2:] for c in used} <= set(PAGE.values())


def test_names_are_words_whatever_they_hold():
    said = Points([EVIL] * N, [f"0:run:{i}" for i in range(N)])
    chart = Chart([Row(EVIL, ((1.0, "after"),), EVIL)], "linear", 0.0, 2.0, EVIL,
                  legend=[("after", EVIL)]).drawing(EVIL, EVIL, EVIL)
    rows = rows_plot(Axis(0.0, 1.0), EVIL, [Marks(V, row_y(N), "out", "D", points=said)],
                     [(EVIL, True)] * N)
    shown = [plot(Dots(T, V, "after", points=said), Starts([(1.0, EVIL)]), WordsAt(1.0, 1.0, EVIL),
                  Polyline(T, V, EVIL), names=(EVIL, EVIL)), rows.drawing(EVIL, EVIL, EVIL), chart]
    for drawing in shown:
        found = spec(drawing)
        text = script_json([{k: v for k, v in found.items() if k != "rows"}, told(drawing)])
        assert "<" not in text and "\\u003cb\\u003e%" not in text
        assert json.loads(script_json(found)) == json.loads(json.dumps(found))
        assert "%{x}" not in text and "\\u0026#123;" in text


def test_values_beyond_an_axis_are_at_its_edge_and_told_as_they_are():
    (trace,) = spec(plot(Dots([1.0, 2.0, 3.0], [0.5, 42.0, np.nan], "out")))["data"]
    assert trace["y"] == [0.5, 1.0]
    assert "%{y" in trace["hovertemplate"][0] and "42 mm" in trace["hovertemplate"][1]


def test_logarithms_and_equal_scales():
    found = spec(plot(Dots(T, 10.0**V, "after"), y=span(10.0**V, log=True), equal=True))["layout"]
    assert found["yaxis"]["type"] == "log" and found["yaxis"]["range"] == [-1.0, 1.0]
    assert found["yaxis"]["scaleanchor"] == "x" and "type" not in found["xaxis"]


@pytest.mark.parametrize(("scale", "low"), [("linear", 0.0), ("log", 0.5), ("root", 0.0)])
@pytest.mark.parametrize("beside", [False, True])
def test_bars_end_at_their_values(scale, low, beside):
    rows = [Row("leg1", ((4.0, "before"), (2.0, "after")), "4 → 2 mm", ((1.0, "limit"),)),
            Row("heading"), Row("leg2", ((99.0, "before"),), "99 mm")]
    found = spec(Chart(rows, scale, low, 16.0, "rms (mm)", beside=beside).drawing("", "", ""))
    ends = {t["name"] or i: [b + x for b, x in zip(t["base"], t["x"], strict=True)]
            for i, t in enumerate(found["data"]) if t["type"] == "bar"}
    root = np.sqrt if scale == "root" else float
    assert list(ends.values()) == [pytest.approx([root(4.0), root(16.0)], rel=1e-5),
                                   pytest.approx([root(2.0)], rel=1e-5)]
    assert all("mm" in t for trace in found["data"] if trace["type"] == "bar"
               for t in hovers(trace))
    assert [r["label"] for r in found["rows"]] == ["leg1", "heading", "leg2"]
    tops, height = found["layout"]["yaxis"]["range"][0], found["height"]
    assert all(0.0 < y < tops for t in found["data"] for y in t["y"] if y) and height > tops


def test_what_is_not_known_is_refused():
    class Strange:
        pass

    with pytest.raises(TypeError, match="Strange"):
        spec(Drawing("", "", "", Strange()))
    with pytest.raises(TypeError, match="Strange"):
        spec(plot(Strange()))
    for one in (Drawing("", "", "", Strange()), plot(Strange())):
        with pytest.raises(TypeError, match="Strange"):
            sheet("", [one])


def test_both_interpreters_know_every_layer_and_neither_is_known_to_the_data():
    """A figure is described once; a layer more is a class and a function in each of the two."""
    kinds = set(get_args(Layer))
    assert kinds == set(add.registry) - {object} == set(draw_layer.registry) - {object}
    for module in ("layers", "plot", "bars"):
        for node in nodes_of(PLOTTING / f"{module}.py"):
            name = getattr(node, "module", None) or ""
            assert not name.startswith(("matplotlib", "ppmcal.plotting.picture",
                                        "ppmcal.plotting.web")), module


# --- of a report ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fit(tmp_path_factory):
    return write_fit(tmp_path_factory.mktemp("web") / "fit", identification(), 40)


def test_every_row_is_a_point_with_its_key(fit):
    one = collect([fit]).identified[0]
    table = one.residuals
    keys = [row_key(0, d, n) for d, n in zip(table.words("dataset"), row_numbers(table).tolist(),
                                            strict=True)]
    for drawing in residual_figures(DataRows(0, table, one.record.units)):
        rows = [t for t in spec(drawing)["data"] if "customdata" in t]
        if not rows:
            assert "sigma" in " ".join(drawing.content.names)
            continue
        found = [k for t in rows for k in t["customdata"]]
        drawn = sum(np.isfinite(np.asarray(layer.y, dtype=float)).sum()
                    for layer in drawing.content.layers if isinstance(layer, Dots | Marks))
        assert len(found) == sum(len(t["x"]) for t in rows) == drawn
        assert set(found) <= set(keys) and set(found) <= set(told(drawing))
        unit = "deg" if "r" in drawing.title.split(" of ")[-1][:1] else "mm"
        assert all(unit in t for trace in rows for t in hovers(trace)), drawing.title
    assert "row 7" in told(residual_figures(DataRows(0, table, one.record.units))[1])[keys[6]]


def test_other_columns_of_the_rows_are_told(fit, tmp_path):
    text = (fit / "residuals.csv").read_text().splitlines()
    folder = write_fit(tmp_path / "more", identification(), 40)
    more = [f"{t},21.5,up,{i}" for i, t in enumerate(text[1:])]
    (folder / "residuals.csv").write_text("\n".join(
        [text[0] + ",temperature,approach,x", *more, ""]))
    one = collect([folder]).identified[0]
    known = told(residual_figures(DataRows.of(one, 0))[1])
    assert "temperature: 21.5" in known["0:run:5"] and "x 4.0000 mm" in known["0:run:5"]


@pytest.mark.slow
def test_many_rows_stay_small_and_the_largest_can_be_found(tmp_path):
    size = 10_000
    folder = write_fit(tmp_path / "big", identification(), size)
    lines = (folder / "residuals.csv").read_text().splitlines()
    head = lines[0].split(",")
    cells = lines[4321].split(",")
    cells[head.index("after_x")] = "0.9"
    lines[4321] = ",".join(cells)
    (folder / "residuals.csv").write_text("\n".join([*lines, ""]))
    page = to_html(collect([folder]))
    assert size > POINTS and len(page) < 5_000_000
    found = specs(page)["Residual of x by row, after"]
    assert "0:run:4321" in [k for t in found["data"] for k in t.get("customdata", ())]
    assert max(len(t["x"]) for t in found["data"]) < 3000


def test_no_plots_no_library(tmp_path):
    write_csv(tmp_path / "residuals.csv", {"row": [1], "dataset": ["a"], "before_x": [""],
                                           "after_x": [""], "sigma_x": [""]})
    page = to_html(collect([tmp_path]))
    assert "Plotly" not in page and len(page) < 100_000
    assert TITLES
