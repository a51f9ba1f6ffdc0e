"""Drawings for a page: figures of plotly as plain data, with colours by the page's names.

A colour is ``--after`` or ``--after/0.35`` (with its opacity): the script of the page puts in what
its style says, by day, by night or on paper. A trace with ``customdata`` has the key of a row for
each point; the script links these, and puts what :func:`told` knows of the rows in its ``text``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.plotting.bars import Chart
from ppmcal.plotting.canvas import SMALL, Drawing, fitted
from ppmcal.plotting.plot import Axis, Plot
from ppmcal.plotting.web_bars import chart_spec
from ppmcal.plotting.web_layers import Pane, Parts, add
from ppmcal.plotting.web_values import TOOLS, Spec, lines, number, numbers, safe

PIXELS = 1.3
"""Height of a plot on a page, pixels per point of the drawing."""


def spec(drawing: Drawing) -> Spec:
    """Return a drawing as plotly's ``data`` and ``layout``, and its ``height`` in pixels.

    Raises:
        TypeError: it shows something else than a plot or a chart.
    """
    if isinstance(drawing.content, Plot):
        return _plot(drawing.content, drawing)
    if isinstance(drawing.content, Chart):
        return chart_spec(drawing.content)
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


# --- layers ---------------------------------------------------------------------------------------
