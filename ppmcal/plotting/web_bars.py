"""Rows of bars for a page: laid out as in a file, with hover and zoom."""

from __future__ import annotations

import numpy as np

from ppmcal.plotting.bars import LEGEND, LOOKS, STEP, THICK, Chart, Row
from ppmcal.plotting.canvas import WIDTH, width
from ppmcal.plotting.style import AFTER, BEFORE, INK, OUT, PAGE, SOFT, plain, tame
from ppmcal.plotting.web_values import TOOLS, Spec, number, numbers, safe

PIXELS = 1.25
"""Height on a page, pixels per point of the drawing."""
HEAD, FOOT = 6 + TOOLS, 44
"""Room above and below the bars, pixels."""
NARROW = 1.3
"""Letters are so much larger, against the width, on the narrowest page."""
COLOURS = {name: f"--{PAGE[name]}" for name in (AFTER, BEFORE, INK, OUT, SOFT)}
DASHES = {"limit": "solid", "dotted": "dot"}


def chart_spec(chart: Chart) -> Spec:
    """Return a chart as plotly's ``data`` and ``layout``, and its ``height`` in pixels.

    y is in points down from the first row; a scale by the square root has the roots on x. ``rows``
    are words, which the script of the page cuts to the room that there is: ``label`` at the left,
    ``words`` at the right end, about ``y``.
    """
    first, *tops = chart.tops()
    places = [first, *tops[:-1]]
    kinds = list(dict.fromkeys(kind for row in chart.rows for _, kind in row.bars))
    limits = list(dict.fromkeys(kind for row in chart.rows for _, kind in row.limits))
    left, right = (v / WIDTH for v in chart.ends())
    legend = dict(chart.legend)
    data = [_bars(chart, kind, places, legend.get(kind, "")) for kind in kinds]
    data += [_limits(chart, kind, places, legend.get(kind, "")) for kind in limits]
    rows = PIXELS * (tops[-1] - first) if tops else STEP
    head = HEAD + (PIXELS * LEGEND * (1 + _lines(chart)) if chart.legend else 0.0)
    x: Spec = {"range": numbers([_across(chart, v) for v in (chart.low, chart.high)]),
               "domain": [number(left), number(right)], "showgrid": False,
               "title": {"text": safe(chart.axis), "standoff": 6}, "automargin": False}
    if chart.scale == "log":
        x |= {"type": "log", "range": numbers(np.log10([chart.low, chart.high]))}
    if chart.ticks:
        ticks = _ticks(chart)
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
    inside = float(np.clip(tame(np.array(value)), chart.low, chart.high))
    return float(np.sqrt(max(inside, 0.0))) if chart.scale == "root" else inside


def _ticks(chart: Chart) -> list[tuple[float, str]]:
    """Return those of the ticks whose words have room on a narrow page."""
    (left, right), out, free = chart.ends(), [], 0.0
    scale = np.log if chart.scale == "log" else float
    low, high = (scale(_across(chart, v)) for v in (chart.low, chart.high))
    for value, words in chart.ticks:
        half = NARROW * 0.5 * width(words)
        x = left + (right - left) * (scale(_across(chart, value)) - low) / (high - low)
        if free <= x - half and x + half <= WIDTH:
            out.append((value, words))
            free = x + half + 4.0
    return out


def _lines(chart: Chart) -> int:
    """Return in how many lines the legend stands, beyond the first."""
    return len({y for _, y in chart.places()}) - 1


def _bars(chart: Chart, kind: str, places: list[float], name: str) -> Spec:
    """Return all bars of one kind as one trace."""
    at, size, thick, said = [], [], [], []
    foot = _across(chart, chart.low)
    for row, top in zip(chart.rows, places, strict=True):
        below, step = (-4.0 - 4.5 * (len(row.bars) - 1), 9.0) if chart.beside else (9.5, 0.0)
        for i, (value, own) in enumerate(row.bars):
            if own == kind:
                at.append(top + 14.0 + below + step * i)
                size.append(_across(chart, value) - foot)
                thick.append(7.0 if chart.beside else THICK.get(kind, 8.0))
                said.append(_said(row, value, name, chart))
    look = LOOKS[kind]
    open_ = look.get("fill") is False
    edge = COLOURS.get(look.get("edgecolor", ""), "")
    marker: Spec = {"color": "--card/0" if open_ else COLOURS[look["facecolor"]]}
    if "alpha" in look:
        marker["color"] += f"/{look['alpha']}"
    if open_:
        marker["line"] = {"color": edge, "width": 1.6}
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
        head = top if chart.beside else top + 18.0
        for value, own in row.limits:
            if own == kind:
                x += [number(_across(chart, value))] * 2 + [None]
                y += [number(head), number(head + (20.0 if chart.beside else 11.0)), None]
    out: Spec = {"type": "scatter", "mode": "lines", "x": x, "y": y, "name": safe(name or "limit"),
                 "line": {"color": "--ink", "width": 1.5, "dash": DASHES[kind]},
                 "showlegend": bool(name)}
    return out | ({"hoverinfo": "name"} if name else {"hoverinfo": "skip"})
