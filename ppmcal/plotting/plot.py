"""A plot over two axes, made of layers: dots, strokes, lines, crosses, arrows, bars, bands.

A layer is a function that draws on axes. Values beyond an axis are drawn at its edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.transforms import ScaledTranslation
from numpy.typing import ArrayLike

from ppmcal.linalg import Array
from ppmcal.plotting.canvas import HEIGHT, LETTERS, NAME, SMALL, WIDTH, Canvas, fitted
from ppmcal.plotting.style import (
    AFTER,
    BEFORE,
    CARD,
    INK,
    LINE,
    OUT,
    SMALLEST,
    SOFT,
    number_words,
    round_numbers,
    tame,
)
from ppmcal.plotting.svg import one_line

LEFT, RIGHT, TOP, BOTTOM = 54.0, 10.0, 12.0, 40.0
COLOURS = {"before": BEFORE, "after": AFTER, "out": OUT, "ink": INK}
Layer = Callable[[Axes], object]


@dataclass(frozen=True)
class Axis:
    """One axis from ``low`` to ``high``, linear or logarithmic."""

    low: float
    high: float
    log: bool = False

    def ticks(self) -> Array:
        """Return round values within the axis."""
        return round_numbers(self.low, self.high, self.log, steps=(1, 2, 5, 10))


def span(values: ArrayLike, log: bool = False, zero: bool = False, margin: float = 0.05) -> Axis:
    """Return an axis that holds the finite values, with a margin.

    ``log``: whole powers of ten around them, all but the lowest half percent, which is drawn
    at the edge; ``zero``: symmetric about 0.
    """
    v = tame(np.ravel(np.asarray(values, dtype=float)))
    v = v[np.isfinite(v)]
    if log:
        v = v[v > SMALLEST]
        if not v.size:
            return Axis(0.1, 1.0, True)
        top = math.ceil(math.log10(float(v.max())) + 1e-9)
        least = max(float(np.quantile(v, 0.005)), 1e-12 * 10.0**top)
        foot = min(math.floor(math.log10(least)), top - 1)
        return Axis(10.0**foot, 10.0**top, True)
    low, high = (float(v.min()), float(v.max())) if v.size else (0.0, 1.0)
    if zero:
        high = max(abs(low), abs(high))
        low = -high
    largest = max(abs(low), abs(high))
    if not high - low > 1e-12 * largest:
        low, high = low - (largest or 1.0), high + (largest or 1.0)
    pad = margin * (high - low)
    return Axis(low - pad, high + pad)


def plot(canvas: Canvas, x: Axis, y: Axis, names: tuple[str, str], layers: Sequence[Layer],
         left: float = LEFT, height: float = HEIGHT, x_ticks: bool = True, y_ticks: bool = True
         ) -> Axes:
    """Draw layers over two axes that have their names beside them; return the axes."""
    floor, right = height - BOTTOM, WIDTH - RIGHT
    axes = canvas.axes(left, TOP, right, floor)
    axes.set_yscale("log" if y.log else "linear")
    axes.set(xlim=(x.low, x.high), ylim=(y.low, y.high))
    axes.spines["left"].set(visible=True, linewidth=1.0, color=SOFT)
    for axis, ends, shown in ((axes.xaxis, x, x_ticks), (axes.yaxis, y, y_ticks)):
        ticks = ends.ticks() if shown else np.zeros(0)
        axis.set_ticks(ticks.tolist(), labels=number_words(ticks))
        axis.set_ticks([], minor=True)
    axes.tick_params("x", length=4.0, pad=1.5)
    axes.tick_params("y", length=0.0, pad=5.0)
    if y_ticks:
        ticks = y.ticks()
        _lines(axes, [x.low, x.high, np.nan] * len(ticks), np.repeat(ticks, 3), LINE, 1.0)
        axes.lines[0].set_zorder(0.5)
    for layer in layers:
        layer(axes)
    middle = (TOP + floor) / 2.0
    canvas.text((left + right) / 2.0, height - 6.0, names[0], ha="center", room=right - left,
                size=NAME)
    canvas.text(11.0, middle, names[1], ha="center", room=2.0 * middle, size=NAME, upright=True)
    return axes


def _lines(axes: Axes, x: ArrayLike, y: ArrayLike, colour: str, width: float, alpha: float = 1.0,
           cap: Literal["butt", "round"] = "butt") -> None:
    """Draw lines as one path, in pieces where values are not finite."""
    x, y = (np.where(np.isfinite(v), v, np.nan) for v in (tame(np.asarray(x, dtype=float)),
                                                         tame(np.asarray(y, dtype=float))))
    axes.plot(np.clip(x, *axes.get_xlim()), np.clip(y, *axes.get_ylim()), color=colour,
              linewidth=width, alpha=None if alpha == 1.0 else alpha, solid_capstyle=cap,
              clip_on=False, scalex=False, scaley=False)


def _apart(*columns: ArrayLike) -> Array:
    """Return columns (N,) as pieces of a line, one row after the other."""
    out: Array = np.stack(np.broadcast_arrays(*columns, np.nan), axis=-1).ravel()
    return out


def dots(x: ArrayLike, y: ArrayLike, kind: str, size: float = 4.0) -> Layer:
    """Draw dots as one path of lines next to no length: thousands stay small."""
    def draw(axes: Axes) -> None:
        low, high = axes.get_xlim()
        at = np.clip(tame(np.asarray(x, dtype=float)), low, high)
        _lines(axes, _apart(at, at + 1e-5 * (high - low)), _apart(y, y), COLOURS[kind], size,
               cap="round")
    return draw


def strokes(x: ArrayLike, low: ArrayLike, high: ArrayLike, kind: str, width: float = 1.5,
            alpha: float = 1.0, flat: bool = False) -> Layer:
    """Draw strokes from ``low`` to ``high`` at ``x``, upright, or ``flat`` along x."""
    def draw(axes: Axes) -> None:
        ends = _apart(x, x), _apart(low, high)
        _lines(axes, *(ends[::-1] if flat else ends), COLOURS[kind], width, alpha)
    return draw


def line(x: ArrayLike, y: ArrayLike, kind: str = "ink") -> Layer:
    """Draw a line through points."""
    return lambda axes: _lines(axes, x, y, COLOURS[kind], 1.2)


def zero(upright: bool = False) -> Layer:
    """Draw the line of zero."""
    def draw(axes: Axes) -> None:
        ends, none = (axes.get_ylim() if upright else axes.get_xlim()), (0.0, 0.0)
        _lines(axes, *((none, ends) if upright else (ends, none)), SOFT, 1.2, 0.5)
    return draw


def marks(x: ArrayLike, y: ArrayLike, kind: str, marker: str, size: float = 6.4,
          aside: float = 0.0) -> Layer:
    """Draw markers, filled if ``kind`` is not ``before``, some points aside of their places."""
    def draw(axes: Axes) -> None:
        ends = [(tame(np.asarray(v, dtype=float)), lim) for v, lim in (
            (x, axes.get_xlim()), (y, axes.get_ylim()))]
        good = np.isfinite(ends[0][0]) & np.isfinite(ends[1][0])
        across, up = (np.clip(v[good], *lim) for v, lim in ends)
        axes.plot(across, up, linestyle="none", marker=marker, markersize=size,
                  color=COLOURS[kind], markeredgewidth=1.6 if marker == "x" else 1.4,
                  markerfacecolor=CARD if kind == "before" else COLOURS[kind], clip_on=False,
                  transform=axes.transData + _shift(axes, aside), scalex=False, scaley=False)
    return draw


def intervals(x: ArrayLike, mean: Array, half: Array, kind: str, aside: float = 0.0) -> Layer:
    """Draw means with their intervals: rings before, discs after."""
    def draw(axes: Axes) -> None:
        good = np.isfinite(mean) & np.isfinite(half)
        middle, wide = np.where(good, mean, np.nan), np.where(good, half, np.nan)
        strokes(x, middle - wide, middle + wide, kind)(axes)
        axes.lines[-1].set_transform(axes.transData + _shift(axes, aside))
        marks(x, middle, kind, "o", aside=aside)(axes)
    return draw


def _shift(axes: Axes, aside: float) -> ScaledTranslation:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return ScaledTranslation(aside / 72.0, 0.0, figure.dpi_scale_trans)


def band(low: float, high: float) -> Layer:
    """Fill between two values of y, nothing where they are one."""
    return lambda axes: low < high and axes.axhspan(
        low, high, facecolor=AFTER, alpha=0.12, linewidth=0.0, clip_on=False)


def columns(edges: Array, tops: Array) -> Layer:
    """Draw the bars of a histogram as one path."""
    def draw(axes: Axes) -> None:
        gap = 0.06 * np.diff(edges)
        left, right = edges[:-1] + gap, edges[1:] - gap
        corners = np.stack([np.stack([left, left, right, right], axis=-1),
                            np.stack([0.0 * tops, tops, tops, 0.0 * tops], axis=-1)], axis=-1)
        axes.add_patch(PathPatch(Path.make_compound_path_from_polys(corners[tops > 0.0]),
                                 facecolor=AFTER, alpha=0.75, linewidth=0.0, clip_on=False))
    return draw


def starts(places: Sequence[tuple[float, str]]) -> Layer:
    """Draw where parts begin: a dashed line with as much of the part's name as has room."""
    def draw(axes: Axes) -> None:
        (low, high), wide = axes.get_xlim(), 72.0 * _inches(axes)[0]
        for x, name in places:
            axes.axvline(x, color=SOFT, alpha=0.7, linewidth=1.0, dashes=(3.0, 3.0),
                         clip_on=False)
            shown = fitted(name, min(90.0, wide * (high - x) / (high - low)), size=SMALL)
            axes.annotate(shown, (x, 1.0), (3.0, -8.0), xycoords=axes.get_xaxis_transform(),
                          textcoords="offset points", size=SMALL, color=SOFT, parse_math=False)
    return draw


def arrows(x: Array, y: Array, dx: Array, dy: Array, kind: str) -> Layer:
    """Draw arrows as one path, from places in data by ``dx`` to the right and ``dy`` up, points."""
    def draw(axes: Axes) -> None:
        size = np.hypot(dx, dy)
        head = np.where(size > 4.0, -3.0 / np.maximum(size, 4.0), np.nan)
        u, v = head * dx, head * dy
        there, up = _apart(x, x, x, x, x), _apart(y, y, y, y, y)
        px = np.stack([0.0 * dx, dx, dx + 0.87 * u - 0.5 * v, dx, dx + 0.87 * u + 0.5 * v,
                       0.0 * dx], axis=-1).ravel()
        py = np.stack([0.0 * dy, dy, dy + 0.5 * u + 0.87 * v, dy, dy - 0.5 * u + 0.87 * v,
                       0.0 * dy], axis=-1).ravel()
        per = [(lim[1] - lim[0]) / (72.0 * extent) for lim, extent in zip(
            (axes.get_xlim(), axes.get_ylim()), _inches(axes), strict=True)]
        axes.plot(there + per[0] * px, up + per[1] * py, color=COLOURS[kind], linewidth=1.2,
                  clip_on=False, scalex=False, scaley=False)
    return draw


def _inches(axes: Axes) -> tuple[float, float]:
    """Return width and height of axes."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    wide, high = figure.get_size_inches()
    place = axes.get_position()
    return float(place.width * wide), float(place.height * high)


def words_at(x: float, y: float, text: str) -> Layer:
    """Write words that end at a place, points from the upper right corner."""
    return lambda axes: axes.annotate(
        one_line(text), (1.0, 1.0), (-x, -y), xycoords="axes fraction", textcoords="offset points",
        ha="right", size=LETTERS, color=SOFT, parse_math=False)

