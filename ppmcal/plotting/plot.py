"""A plot over two axes, made of layers: dots, strokes, lines, markers, arrows, bars, bands.

A layer is a function that draws on axes. Values beyond an axis are drawn at its edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import ArrayLike

from ppmcal.linalg import Array
from ppmcal.plotting import style
from ppmcal.plotting.canvas import HEIGHT, LETTERS, SMALL, WIDTH, Canvas, Drawing, fitted, width
from ppmcal.plotting.style import AFTER, SMALLEST, SOFT, number_words, plain, tame

LEFT, RIGHT, TOP, BOTTOM = 54.0, 10.0, 12.0, 40.0
COLOURS = {"before": style.BEFORE, "after": AFTER, "out": style.OUT, "ink": style.INK}
Layer = Callable[[Axes], object]


@dataclass(frozen=True)
class Axis:
    """One axis from ``low`` to ``high``, linear or logarithmic."""

    low: float
    high: float
    log: bool = False

    def ticks(self) -> Array:
        """Return round values within the axis, powers of ten alone where there are three."""
        found = style.round_numbers(self.low, self.high, self.log, steps=(1, 2, 5, 10))
        tens = found[found == 10.0 ** np.round(np.log10(found))] if self.log else found
        return tens if len(tens) > 2 else found

    def part(self, value: float) -> float:
        """Return where a value is between the ends, 0 to 1."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


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
        return Axis(10.0 ** min(math.floor(math.log10(least)), top - 1), 10.0**top, True)
    low, high = (float(v.min()), float(v.max())) if v.size else (0.0, 1.0)
    largest = max(abs(low), abs(high))
    if zero:
        low, high = -largest, largest
    if not high - low > 1e-12 * largest:
        low, high = low - (largest or 1.0), high + (largest or 1.0)
    pad = margin * (high - low)
    return Axis(low - pad, high + pad)


def plotted(title: str, caption: str, description: str, x: Axis, y: Axis, names: tuple[str, str],
            layers: Sequence[Layer], key: tuple[tuple[str, str], ...] = ()) -> Drawing:
    """Return a plot with the words around it."""
    return Drawing(title, caption.strip(), description,
                   partial(plot, x=x, y=y, names=names, layers=layers), key=key)


def plot(canvas: Canvas, x: Axis, y: Axis, names: tuple[str, str], layers: Sequence[Layer],
         left: float = LEFT, height: float = HEIGHT, x_ticks: bool = True, y_ticks: bool = True
         ) -> None:
    """Draw layers over two axes that have their names beside them."""
    floor, right = height - BOTTOM, WIDTH - RIGHT
    axes = canvas.axes(left, TOP, right, floor)
    axes.set_xscale("log" if x.log else "linear")
    axes.set_yscale("log" if y.log else "linear")
    axes.set(xlim=(x.low, x.high), ylim=(y.low, y.high))
    axes.spines["left"].set(visible=True, linewidth=1.0, color=SOFT)
    for axis, ends, shown in ((axes.xaxis, x, x_ticks), (axes.yaxis, y, y_ticks)):
        ticks = ends.ticks() if shown else np.zeros(0)
        axis.set_ticks(ticks.tolist(), labels=number_words(ticks))
        axis.set_ticks([], minor=True)
    for label in axes.get_xticklabels():
        part = x.part(label.get_position()[0])
        label.set_visible(left + part * (right - left) + 0.5 * width(label.get_text()) <= WIDTH)
    widest = max([width(words) for words in number_words(ticks)], default=1.0)
    axes.tick_params("y", length=0.0, pad=5.0, labelsize=LETTERS * min(1.0, (left - 20.0) / widest))
    across = np.tile([x.low, x.high, np.nan], len(ticks))
    _put(axes, across, np.repeat(ticks, 3), color=style.LINE, linewidth=1.0, zorder=0.5)
    for layer in layers:
        layer(axes)
    canvas.name((left + right) / 2.0, height - 6.0, names[0], right - left)
    canvas.name(11.0, (TOP + floor) / 2.0, names[1], TOP + floor, upright=True)


def _put(axes: Axes, x: ArrayLike, y: ArrayLike, **look: Any) -> None:
    """Draw one line or markers of one look, with gaps where values are not finite."""
    ends = []
    for values, limits in ((x, axes.get_xlim()), (y, axes.get_ylim())):
        v = tame(np.asarray(values, dtype=float))
        ends.append(np.clip(np.where(np.isfinite(v), v, np.nan), *limits))
    axes.plot(*ends, clip_on=False, scalex=False, scaley=False, **look)


def _apart(*columns: ArrayLike) -> Array:
    """Return columns (N,) as pieces of a line, one row after the other."""
    out: Array = np.stack(np.broadcast_arrays(*columns, np.nan), axis=-1).ravel()
    return out


def _per(axes: Axes) -> tuple[float, float]:
    """Return how much of each linear axis one point is."""
    (a, b), (c, d), dots_ = axes.get_xlim(), axes.get_ylim(), axes.figure.dpi / 72.0
    return (b - a) * dots_ / axes.bbox.width, (d - c) * dots_ / axes.bbox.height


def strokes(x: ArrayLike, low: ArrayLike, high: ArrayLike, kind: str, size: float = 1.5,
            alpha: float | None = None, flat: bool = False, cap: Any = "butt") -> Layer:
    """Draw strokes from ``low`` to ``high`` at ``x``, upright, or ``flat`` along x."""
    ends = (_apart(x, x), _apart(low, high))[::-1 if flat else 1]
    return lambda axes: _put(axes, *ends, color=COLOURS[kind], linewidth=size, alpha=alpha,
                             solid_capstyle=cap)


def dots(x: ArrayLike, y: ArrayLike, kind: str, size: float = 4.0) -> Layer:
    """Draw dots as one path of round strokes of next to no length: thousands stay small."""
    def draw(axes: Axes) -> None:
        at, half = np.asarray(x, dtype=float), 1e-5 * float(np.ptp(axes.get_xlim()))
        strokes(y, at - half, at + half, kind, size, flat=True, cap="round")(axes)
    return draw


def line(x: ArrayLike, y: ArrayLike) -> Layer:
    """Draw a line through points."""
    return lambda axes: _put(axes, x, y, color=style.INK, linewidth=1.2)


def zero(upright: bool = False) -> Layer:
    """Draw the line of zero."""
    def draw(axes: Axes) -> None:
        ends = [axes.get_xlim(), (0.0, 0.0)] if not upright else [(0.0, 0.0), axes.get_ylim()]
        _put(axes, *ends, color=SOFT, linewidth=1.2, alpha=0.5)
    return draw


def marks(x: ArrayLike, y: ArrayLike, kind: str, marker: str, size: float = 6.4) -> Layer:
    """Draw markers, open ones if ``kind`` is ``before``."""
    fill = style.CARD if kind == "before" else COLOURS[kind]
    return lambda axes: _put(axes, x, y, linestyle="none", marker=marker, markersize=size,
                             color=COLOURS[kind], markeredgewidth=1.5, markerfacecolor=fill)


def intervals(x: Array, mean: Array, half: Array, kind: str, aside: float = 0.0) -> Layer:
    """Draw means with their intervals, some points aside: rings before, discs after."""
    def draw(axes: Axes) -> None:
        at, middle = x + aside * _per(axes)[0], np.where(np.isfinite(half), mean, np.nan)
        strokes(at, middle - half, middle + half, kind)(axes)
        marks(at, middle, kind, "o")(axes)
    return draw


def band(low: float, high: float) -> Layer:
    """Fill between two values of y, nothing where they are one."""
    return lambda axes: low < high and axes.axhspan(
        low, high, facecolor=AFTER, alpha=0.12, linewidth=0.0, clip_on=False)


def between(x: ArrayLike, low: ArrayLike, high: ArrayLike) -> Layer:
    """Fill between two lines over ``x``, cut off at the axes."""
    def draw(axes: Axes) -> None:
        at = np.asarray(x, dtype=float)
        ends = [np.clip(np.asarray(v, dtype=float), *axes.get_ylim()) for v in (low, high)]
        corners = np.stack([np.append(at, at[::-1]), np.append(ends[0], ends[1][::-1])], axis=-1)
        axes.add_patch(PathPatch(Path(corners, closed=False), facecolor=AFTER, alpha=0.2,
                                 linewidth=0.0, clip_on=False))
    return draw


def columns(edges: Array, tops: Array) -> Layer:
    """Draw the bars of a histogram as one path."""
    left, right = edges[:-1] + 0.06 * np.diff(edges), edges[1:] - 0.06 * np.diff(edges)
    corners = np.stack([np.stack([left, left, right, right], axis=-1),
                        np.stack([0.0 * tops, tops, tops, 0.0 * tops], axis=-1)], axis=-1)
    path = Path.make_compound_path_from_polys(corners[tops > 0.0])
    return lambda axes: axes.add_patch(PathPatch(path, facecolor=AFTER, alpha=0.75, linewidth=0.0,
                                                 clip_on=False))


def starts(places: Sequence[tuple[float, str]]) -> Layer:
    """Draw where parts begin: a dashed line with as much of the part's name as has room."""
    def draw(axes: Axes) -> None:
        for x, name in places:
            shown = fitted(name, min(90.0, (axes.get_xlim()[1] - x) / _per(axes)[0]), size=SMALL)
            axes.axvline(x, color=SOFT, alpha=0.7, linewidth=1.0, dashes=(3.0, 3.0), clip_on=False)
            axes.annotate(shown, (x, 1.0), (3.0, -8.0), xycoords=axes.get_xaxis_transform(),
                          textcoords="offset points", size=SMALL, color=SOFT)
    return draw


def arrows(x: Array, y: Array, dx: Array, dy: Array, kind: str) -> Layer:
    """Draw arrows as one path, from places in data by ``dx`` to the right and ``dy`` up, points."""
    size = np.hypot(dx, dy)
    head = np.where(size > 4.0, -3.0 / np.maximum(size, 4.0), np.nan)
    u, v, nil = head * dx, head * dy, 0.0 * dx
    px = _apart(nil, dx, dx + 0.87 * u - 0.5 * v, dx, dx + 0.87 * u + 0.5 * v)
    py = _apart(nil, dy, dy + 0.5 * u + 0.87 * v, dy, dy - 0.5 * u + 0.87 * v)

    def draw(axes: Axes) -> None:
        wide, high = _per(axes)
        axes.plot(np.repeat(x, 6) + wide * px, np.repeat(y, 6) + high * py, color=COLOURS[kind],
                  linewidth=1.2, clip_on=False, scalex=False, scaley=False)
    return draw


def words_at(x: float, y: float, text: str) -> Layer:
    """Write words that end at a place, points from the upper right corner."""
    return lambda axes: axes.annotate(
        plain(text), (1.0, 1.0), (-x, -y), xycoords="axes fraction", textcoords="offset points",
        ha="right", size=LETTERS, color=SOFT)
