"""The layers of a plot as traces and shapes of plotly: one function for each kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import singledispatch
from html import escape
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.linalg import Array, Bools
from ppmcal.plotting import layers
from ppmcal.plotting.layers import Layer, Points, Undrawn, apart
from ppmcal.plotting.plot import Axis, Plot
from ppmcal.plotting.style import plain
from ppmcal.wording import rounded

Spec: TypeAlias = dict[str, Any]
DIGITS = 6
SYMBOLS = {"o": "circle", "x": "x-thin", "D": "diamond", "s": "square"}
FORMAT = ".4~g"


def safe(text: object) -> str:
    """Return words that plotly shows as they are: neither tags nor placeholders."""
    return escape(plain(text), quote=False).replace("{", "&#123;")


def lines(text: str) -> str:
    """Return words in lines, the first one bold."""
    first, *more = (safe(t) for t in text.split("\n"))
    return "<br>".join([f"<b>{first}</b>", *more])


def number(value: float) -> float | None:
    """Return a number with as many digits as can be seen, None for none."""
    return rounded(value, DIGITS)


def numbers(values: ArrayLike) -> list[float | None]:
    """Return numbers with as many digits as can be seen."""
    return [number(v) for v in np.ravel(np.asarray(values, dtype=float)).tolist()]


@dataclass(frozen=True)
class Pane:
    """A plot as its layers see it; ``words``: what the kinds of marks are called."""

    plot: Plot
    words: Mapping[str, str]

    def inside(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Bools]:
        """Return points moved into the axes (N,), (N,), and which can be drawn (N,)."""
        at, up = self.plot.inside(x, y)
        return at, up, np.isfinite(at) & np.isfinite(up)

    def coordinate(self, axis: str, word: str = "") -> str:
        """Return the line that tells one coordinate of a point, with its unit."""
        i = "xy".index(axis)
        name, unit = word or self.plot.names[i], self.plot.units[i]
        return f"{safe(bare(name, unit))}: %{{{axis}:{FORMAT}}} {safe(unit)}".rstrip()

    def coordinates(self, word: str = "") -> list[str]:
        """Return the lines of both."""
        return [self.coordinate("x"), self.coordinate("y", word)]


def bare(name: str, unit: str) -> str:
    """Return the name of an axis without its unit."""
    return name.removesuffix(f" ({unit})") if unit else name


@dataclass
class Parts:
    """What a figure is made of."""

    data: list[Spec] = field(default_factory=list)
    shapes: list[Spec] = field(default_factory=list)
    annotations: list[Spec] = field(default_factory=list)


@singledispatch
def add(layer: Layer, pane: Pane, parts: Parts) -> None:
    """Add what one layer is in a figure.

    Raises:
        TypeError: nobody has said what it is there.
    """
    raise TypeError(f"no part of a page's figure can be made of {type(layer).__name__}")


def _template(pane: Pane, points: Points, kind: str) -> str:
    """Return what pointing at a point tells: what it is, then its coordinates with their units."""
    plot, word = pane.plot, pane.words.get(kind, "")
    out = ["%{text}"] if points.texts or points.keys else []
    if plot.rows:
        out.append(pane.coordinate("x", word))
    elif points.texts and plot.units[0] == "" and not plot.equal:
        out.append(pane.coordinate("y", word))  # x is only where the point stands
    else:
        out += pane.coordinates(word)
    return "<br>".join(out) + "<extra></extra>"


def _clipped(pane: Pane, template: str, axis: Axis, letter: str, values: Array,
             seen: Bools) -> str | list[str]:
    """Return a template whose values beyond an axis, drawn at its edge, are as they are."""
    out = [template if axis.low <= v <= axis.high else template.replace(
        f"%{{{letter}:{FORMAT}}}", f"{v:.4g}".replace("-", "−")) for v in values[seen].tolist()]
    return template if all(t is template for t in out) else out


def _points(pane: Pane, x: ArrayLike, y: ArrayLike, kind: str, points: Points, marker: Spec
            ) -> Spec:
    """Return a trace of markers."""
    at, up, seen = pane.inside(x, y)
    template = _template(pane, points, kind)
    rows = bool(pane.plot.rows)
    true = np.broadcast_to(np.ravel(np.asarray(x if rows else y, dtype=float)), seen.shape)
    out: Spec = {
        "type": "scatter", "mode": "markers", "x": numbers(at[seen]), "y": numbers(up[seen]),
        "marker": marker, "cliponaxis": False, "name": safe(pane.words.get(kind, kind)),
        "hovertemplate": _clipped(pane, template, pane.plot.x if rows else pane.plot.y,
                                  "x" if rows else "y", true, seen)}
    picked = np.flatnonzero(seen).tolist()
    if points.keys:
        out["customdata"] = [points.keys[i] for i in picked]
        if points.undrawn is not None:
            out["undrawn"] = _undrawn(pane, points.undrawn)
    elif points.texts:
        out["text"] = [lines(points.texts[i]) for i in picked]
    return out


def _undrawn(pane: Pane, rest: Undrawn) -> Spec:
    """Return the rows that are drawn when they are chosen, to four digits."""
    x = np.arange(1.0, rest.y.size + 1.0) if rest.x is None else rest.x
    at, up, seen = pane.inside(x, rest.y)
    short = [[float(f"{v:.4g}") if s else None for v, s in zip(values.tolist(), seen, strict=True)]
             for values in (at, up)]
    return {"runs": [list(run) for run in rest.runs], "y": short[1]} | (
        {} if rest.x is None else {"x": short[0]})


def _line(x: Iterable[float | None], y: Iterable[float | None], colour: str, size: float,
          **more: Any) -> Spec:
    """Return a trace of lines that tells nothing by itself."""
    return {"type": "scatter", "mode": "lines", "x": list(x), "y": list(y), "hoverinfo": "skip",
            "line": {"color": colour, "width": size}, **more}


@add.register
def _(layer: layers.Dots, pane: Pane, parts: Parts) -> None:
    parts.data.append(_points(pane, layer.x, layer.y, layer.kind, layer.points,
                              {"color": f"--{layer.kind}", "size": 1.4 * layer.size}))


@add.register
def _(layer: layers.Marks, pane: Pane, parts: Parts) -> None:
    parts.data.append(_points(pane, layer.x, layer.y, layer.kind, layer.points,
                              _marker(layer.kind, layer.marker, layer.size)))


def _marker(kind: str, marker: str, size: float) -> Spec:
    """Return a marker, an open one before, crosses as lines alone."""
    line = {"color": f"--{kind}", "width": 1.6}
    fill = "--card" if kind == "before" else f"--{kind}"
    return {"symbol": SYMBOLS[marker], "size": 1.3 * size, "color": fill, "line": line}


@add.register
def _(layer: layers.Strokes, pane: Pane, parts: Parts) -> None:
    ends = (layer.x, layer.x), (layer.low, layer.high)
    (x, y), (to_x, to_y) = (pane.plot.inside(*(np.broadcast_arrays(*map(np.ravel, (
        ends[0][i], ends[1][i])))[::-1 if layer.flat else 1])) for i in (0, 1))
    seen = np.isfinite(x) & np.isfinite(y) & np.isfinite(to_x) & np.isfinite(to_y)
    out = _line(numbers(apart(x[seen], to_x[seen])), numbers(apart(y[seen], to_y[seen])),
                f"--{layer.kind}" + (f"/{layer.alpha}" if layer.alpha else ""), 1.2 * layer.size)
    if layer.points.texts:
        said = [lines(t) for t, s in zip(layer.points.texts, seen.tolist(), strict=True) if s]
        out |= {"text": [t for s in said for t in (s, s, "")], "hoverinfo": "text"}
    parts.data.append(out)


@add.register
def _(layer: layers.Polyline, pane: Pane, parts: Parts) -> None:
    at, up, seen = pane.inside(layer.x, layer.y)
    name = [f"<b>{safe(layer.name)}</b>"] if layer.name else []
    parts.data.append(_line(
        numbers(np.where(seen, at, np.nan)), numbers(np.where(seen, up, np.nan)), "--ink", 1.6,
        hovertemplate="<br>".join([*name, *pane.coordinates()]) + "<extra></extra>",
        hoverinfo="all"))


@add.register
def _(layer: layers.Intervals, pane: Pane, parts: Parts) -> None:
    middle = layer.middle
    (x_name, y_name), (x_unit, y_unit) = pane.plot.names, pane.plot.units
    texts = layer.points.texts or [f"{bare(x_name, x_unit)} {v:.4g} {x_unit}".rstrip()
                                   for v in layer.x.tolist()]
    word = pane.words.get(layer.kind, bare(y_name, y_unit))
    said = Points([f"{t}\n{word}: {m:.3g} ± {h:.2g} {y_unit}".rstrip()
                   for t, m, h in zip(texts, middle.tolist(), layer.half.tolist(), strict=True)])
    trace = _points(pane, layer.x + layer.aside * pane.plot.per()[0], middle, layer.kind, said,
                    _marker(layer.kind, "o", 5.6))
    seen = pane.inside(layer.x, middle)[2]
    trace["hovertemplate"] = "%{text}<extra></extra>"
    trace["error_y"] = {"type": "data", "array": numbers(layer.half[seen]), "width": 0,
                        "thickness": 1.6, "color": f"--{layer.kind}"}
    parts.data.append(trace)


@add.register
def _(layer: layers.Arrows, pane: Pane, parts: Parts) -> None:
    x, y = layer.pieces(*pane.plot.per())
    parts.data.append(_line(numbers(x), numbers(y), f"--{layer.kind}", 1.4))
    if layer.sizes is None:
        return
    # the feet stand for the arrows where one points or selects
    trace = _points(pane, layer.x, layer.y, layer.kind, layer.points,
                    {"color": f"--{layer.kind}", "size": 4})
    seen = pane.inside(layer.x, layer.y)[2]
    word = safe(pane.words.get(layer.kind, "error"))
    tail = [] if layer.points.keys else pane.coordinates()
    trace["hovertemplate"] = [
        "<br>".join([f"%{{text}}<br>{word}: {v:.4g} {safe(layer.unit)}".rstrip(), *tail])
        + "<extra></extra>" for v in layer.sizes[seen].tolist()]
    parts.data.append(trace)


@add.register
def _(layer: layers.Histogram, pane: Pane, parts: Parts) -> None:
    seen = layer.tops > 0.0
    left, right = layer.edges[:-1][seen], layer.edges[1:][seen]
    x_unit = pane.plot.units[0]
    parts.data.append({
        "type": "bar", "x": numbers(0.5 * (left + right)), "y": numbers(layer.tops[seen]),
        "width": numbers(0.88 * (right - left)), "marker": {"color": "--after/0.75"},
        "text": [f"{a:.4g} … {b:.4g} {safe(x_unit)}".rstrip()
                 for a, b in zip(left.tolist(), right.tolist(), strict=True)],
        "textposition": "none", "hovertemplate":
            f"{safe(bare(pane.plot.names[0], x_unit))}: %{{text}}<br>"
            f"{pane.coordinate('y')}<extra></extra>"})


@add.register
def _(layer: layers.Between, pane: Pane, parts: Parts) -> None:
    x, y = layer.outline(pane.plot.y.low, pane.plot.y.high)
    parts.data.append(_line(numbers(x), numbers(y), "--after/0", 0, fill="toself",
                            fillcolor="--after/0.2"))


@add.register
def _(layer: layers.Zero, pane: Pane, parts: Parts) -> None:
    along, across = ("y", "x") if layer.upright else ("x", "y")
    parts.shapes.append({
        "type": "line", f"{along}ref": "paper", f"{along}0": 0, f"{along}1": 1, f"{across}0": 0,
        f"{across}1": 0, "line": {"color": "--soft/0.5", "width": 1.2}, "layer": "below"})


@add.register
def _(layer: layers.Band, pane: Pane, parts: Parts) -> None:
    if layer.low < layer.high:
        parts.shapes.append({
            "type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": number(layer.low),
            "y1": number(layer.high), "fillcolor": "--after/0.12", "line": {"width": 0},
            "layer": "below"})


@add.register
def _(layer: layers.Starts, pane: Pane, parts: Parts) -> None:
    for x, name, shown in pane.plot.starts(layer):
        parts.shapes.append({
            "type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": x, "x1": x,
            "line": {"color": "--soft/0.7", "width": 1, "dash": "dash"}, "layer": "below"})
        parts.annotations.append({
            "x": x, "y": 1, "yref": "paper", "xanchor": "left", "yanchor": "top",
            "showarrow": False, "text": safe(shown),
            "hovertext": safe(name), "font": {"color": "--soft", "size": 11}})


@add.register
def _(layer: layers.WordsAt, pane: Pane, parts: Parts) -> None:
    wide, high = pane.plot.per()
    parts.annotations.append({
        "x": number(pane.plot.x.high - wide * layer.x),
        "y": number(pane.plot.y.high - high * (layer.y - 4.0)), "xanchor": "right",
        "yanchor": "middle", "showarrow": False, "text": safe(layer.text),
        "font": {"color": "--soft"}})
