"""Drawings for a page: figures of plotly as plain data, with colours by the page's names.

A colour is ``--after`` or ``--after/0.35`` (with its opacity): the script of the page puts in what
its style says, by day, by night or on paper. A trace with ``customdata`` has the key of a row for
each point; the script links these, and puts what :func:`told` knows of the rows in its ``text``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.plotting.bars import LEGEND, LIMITS, LOOKS, STEP, Chart, Row
from ppmcal.plotting.canvas import SMALL, WIDTH, Drawing, fitted
from ppmcal.plotting.plot import Axis, Plot
from ppmcal.plotting.style import PAGE, plain
from ppmcal.plotting.web_layers import Pane, Parts, Spec, add, lines, number, numbers, safe

PIXELS, BAR_PIXELS = 1.3, 1.25
"""Height of a plot and of a chart on a page, pixels per point of the drawing."""
TOOLS = 20
"""Room for plotly's buttons above a plot, pixels."""
HEAD, FOOT = 6 + TOOLS, 44
"""Room above and below the bars, pixels."""
NARROW = 1.3
"""Letters are so much larger, against the width, on the narrowest page."""


def spec(drawing: Drawing) -> Spec:
    """Return a drawing as plotly's ``data`` and ``layout``, and its ``height`` in pixels.

    Raises:
        TypeError: it shows something else than a plot or a chart.
    """
    if isinstance(drawing.content, Plot):
        return _plot(drawing.content, drawing)
    if isinstance(drawing.content, Chart):
        return _chart(drawing.content)
    raise TypeError(f"no figure for a page can be made of {type(drawing.content).__name__}")


def told(drawing: Drawing) -> dict[str, str]:
    """Return what is known of the rows that are points of a drawing, by their keys."""
    layers = drawing.content.layers if isinstance(drawing.content, Plot) else ()
    found = [p for layer in layers if (p := getattr(layer, "points", None)) is not None]
    return {key: lines(text) for p in found for key, text in zip(p.keys, p.texts, strict=False)}


def _plot(plot: Plot, drawing: Drawing) -> Spec:
    names = {{"ring": "before"}.get(kind, kind): words for kind, words in drawing.key}
    parts = Parts()
    for layer in plot.layers:
        add(layer, Pane(plot, names), parts)
    x, y = _axis(plot.x, plot.names[0]), _axis(plot.y, plot.names[1])
    if plot.rows:
        centres = len(plot.rows) - np.arange(len(plot.rows)) - 0.5
        shown = [safe(fitted(name, plot.left - 8.0, bold, SMALL)) for name, bold in plot.rows]
        y |= {"tickvals": centres.tolist(), "showgrid": False, "ticktext": [
            f"<b>{t}</b>" if bold else t for t, (_, bold) in zip(shown, plot.rows, strict=True)]}
    if plot.classes:
        x |= {"tickvals": numbers([at for at, *_ in plot.classes]), "title": {
            "text": safe(plot.names[0]), "standoff": 22},
            "ticktext": [safe(sign) for *_, sign in plot.classes]}
        parts.annotations += _owners(plot.classes)
    if plot.equal:
        y |= {"scaleanchor": "x", "scaleratio": 1}
    # where both scales are equal, the shape of the drawing is kept
    height = TOOLS + (1.0 if plot.equal else PIXELS) * plot.height
    return {"data": parts.data, "height": round(height), "layout": {
        "xaxis": x, "yaxis": y, "shapes": parts.shapes, "annotations": parts.annotations}}


def _axis(axis: Axis, name: str) -> Spec:
    ends = [axis.low, axis.high]
    out: Spec = {"range": numbers(np.log10(ends) if axis.log else ends)}
    if name:
        out["title"] = {"text": safe(name)}
    return out | ({"type": "log", "dtick": 1 if axis.high > 8.0 * axis.low else None,
                   "tickformat": ".3~g"} if axis.log else {})


def _owners(classes: Sequence[tuple[float, str, str]]) -> list[Spec]:
    """Return what the signs on x belong to, below them."""
    places: dict[str, list[float]] = {}
    for x, owner, _ in classes:
        places.setdefault(owner, []).append(x)
    return [{"x": number(sum(mine) / len(mine)), "y": 0, "yref": "paper", "yshift": -20,
             "yanchor": "top", "showarrow": False, "text": safe(fitted(owner, 60.0)),
             "font": {"color": "--soft"}} for owner, mine in places.items()]


# --- charts ---------------------------------------------------------------------------------------


def _chart(chart: Chart) -> Spec:
    """Return a chart; a scale by the square root has the roots on x.

    y is in points down from the first row. ``rows`` are words, which the script of the page cuts
    to the room that there is: ``label`` at the left, ``words`` at the right end, about ``y``.
    """
    first, *tops = chart.tops()
    places = [first, *tops[:-1]]
    kinds = list(dict.fromkeys(kind for row in chart.rows for _, kind in row.bars))
    limits = list(dict.fromkeys(kind for row in chart.rows for _, kind in row.limits))
    left, right = (v / WIDTH for v in chart.ends())
    legend = dict(chart.legend)
    data = [_bars(chart, kind, places, legend.get(kind, "")) for kind in kinds]
    data += [_limits(chart, kind, places, legend.get(kind, "")) for kind in limits]
    rows = BAR_PIXELS * (tops[-1] - first) if tops else STEP
    lines_of_legend = len({y for _, y in chart.places()})
    head = HEAD + BAR_PIXELS * LEGEND * lines_of_legend
    x: Spec = {"range": numbers([_across(chart, v) for v in (chart.low, chart.high)]),
               "domain": [number(left), number(right)], "showgrid": False,
               "title": {"text": safe(chart.axis), "standoff": 6}, "automargin": False}
    if chart.scale == "log":
        x |= {"type": "log", "range": numbers(np.log10([chart.low, chart.high]))}
    if chart.ticks:
        ticks = chart.shown(chart.ticks, NARROW)
        x |= {"tickvals": numbers([_across(chart, v) for v, _ in ticks]), "tickangle": 0,
              "ticktext": [safe(w) for _, w in ticks]}
    elif chart.scale == "root":
        x |= {"tickvals": numbers([_across(chart, v) for v in (chart.low, chart.high)]),
              "ticktext": [f"{v:.3g}" for v in (chart.low, chart.high)]}
    return {"data": data, "height": round(rows + head + FOOT), "layout": {
        "xaxis": x, "yaxis": {"range": [tops[-1] if tops else 1.0, first], "visible": False,
                              "fixedrange": True},
        "margin": {"l": 0, "r": 0, "t": round(head), "b": FOOT}, "barmode": "overlay",
        "showlegend": bool(chart.legend)}, "beside": chart.beside, "rows": [
            {"y": number(top + 10.0), "label": plain(row.label), "words": plain(row.words),
             "bold": row.strong, "strong": chart.beside or row.strong, "bars": bool(row.bars)}
            for row, top in zip(chart.rows, places, strict=True)]}


def _across(chart: Chart, value: float) -> float:
    """Return where a value is on x, moved to the ends of the scale."""
    inside = chart.inside(value)
    return float(np.sqrt(max(inside, 0.0))) if chart.scale == "root" else inside


def _bars(chart: Chart, kind: str, places: list[float], name: str) -> Spec:
    """Return all bars of one kind as one trace."""
    at, size, thick, said = [], [], [], []
    foot = _across(chart, chart.low)
    for row, top in zip(chart.rows, places, strict=True):
        for value, own, below, height in chart.bars(row):
            if own == kind:
                at.append(top + 14.0 + below)
                size.append(_across(chart, value) - foot)
                thick.append(height)
                said.append(_said(row, value, name, chart))
    bar = LOOKS[kind]
    colour = f"--{PAGE[bar.colour]}"
    marker: Spec = {"color": "--card/0", "line": {"color": colour, "width": 1.6}} if bar.frame \
        else {"color": colour + (f"/{bar.alpha}" if bar.alpha else "")}
    return {"type": "bar", "orientation": "h", "y": numbers(at), "x": numbers(size),
            "base": [number(foot)] * len(at), "width": numbers(thick), "marker": marker,
            "hovertext": said, "hoverinfo": "text", "name": safe(name), "showlegend": bool(name)}


def _said(row: Row, value: float, name: str, chart: Chart) -> str:
    """Return what pointing at a bar tells: label, what it is, value and the words at its end."""
    axis = chart.axis.rpartition(" (")
    unit = axis[2].removesuffix(")") if axis[0] else ""
    amount = (f"{name}: {value:.4g} {unit}" if name else f"{value:.4g} {unit}").rstrip()
    if chart.scale == "root":  # p-values, as the words say them
        amount = name
    head = f"<b>{safe(row.label)}</b>"
    return "<br>".join([head, *(safe(t) for t in (amount, row.words) if t)])


def _limits(chart: Chart, kind: str, places: list[float], name: str) -> Spec:
    """Return all upright lines of one kind as one trace."""
    x: list[float | None] = []
    y: list[float | None] = []
    for row, top in zip(chart.rows, places, strict=True):
        head, foot = (top + 14.0 + end for end in chart.upright)
        for value, own in row.limits:
            if own == kind:
                x += [number(_across(chart, value))] * 2 + [None]
                y += [number(head), number(foot), None]
    out: Spec = {"type": "scatter", "mode": "lines", "x": x, "y": y, "name": safe(name or "limit"),
                 "line": {"color": "--ink", "width": 1.5,
                          "dash": "dot" if LIMITS[kind] else "solid"}, "showlegend": bool(name)}
    return out | ({"hoverinfo": "name"} if name else {"hoverinfo": "skip"})
