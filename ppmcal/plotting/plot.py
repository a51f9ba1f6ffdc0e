"""A plot over two axes, made of layers; its rows, or places along its axis, may have names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from ppmcal.linalg import Array
from ppmcal.plotting import style
from ppmcal.plotting.canvas import HEIGHT, LETTERS, SMALL, WIDTH, Canvas, Drawing, width
from ppmcal.plotting.layers import Layer
from ppmcal.plotting.style import SMALLEST, SOFT, number_words, tame

LEFT, RIGHT, TOP, BOTTOM = 54.0, 10.0, 12.0, 40.0
NAMES, ROW = 150.0, 15.0
"""Room for the names of rows, and height of a row, points."""
CLASS_ROOM = 12.0
"""Further height below the axis for the names of classes."""


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


@dataclass(frozen=True, eq=False)
class Plot:
    """Layers over two axes.

    Attributes:
        x, y: the axes.
        names: of the axes, with their units.
        layers: from the lowest to the uppermost.
        units: of the axes, empty for bare numbers.
        left: room at the left; height: of the drawing, points.
        rows: names, and whether they are bold, of rows from the top down; y goes from 0 to
            their number.
        classes: place on x, name of what it belongs to, and its sign, instead of numbers.
        equal: a unit is as long on both axes.
    """

    x: Axis
    y: Axis
    names: tuple[str, str]
    layers: Sequence[Layer]
    units: tuple[str, str] = ("", "")
    left: float = LEFT
    height: float = HEIGHT
    rows: Sequence[tuple[str, bool]] = ()
    classes: Sequence[tuple[float, str, str]] = ()
    equal: bool = False

    def drawing(self, title: str, caption: str, description: str,
                key: tuple[tuple[str, str], ...] = (), note: str = "") -> Drawing:
        """Return the plot with the words around it."""
        return Drawing(title, caption.strip(), description, self, self.height, key, note)

    def draw(self, canvas: Canvas) -> None:
        """Draw it."""
        floor, right = self.height - BOTTOM - CLASS_ROOM * bool(self.classes), WIDTH - RIGHT
        for i, (name, bold) in enumerate(self.rows):
            step = (floor - TOP) / len(self.rows)
            canvas.text(self.left - 6.0, TOP + step * (i + 0.5) + 3.5, name, bold=bold,
                        room=self.left - 8.0, ha="right", size=SMALL)
        axes = canvas.axes(self.left, TOP, right, floor)
        self._scales(axes)
        for layer in self.layers:
            layer.draw(axes)
        middle, foot = (self.left + right) / 2.0, self.height - 6.0
        canvas.name(middle, foot - CLASS_ROOM * bool(self.classes),
                    "" if self.classes else self.names[0], right - self.left)
        canvas.name(11.0, (TOP + floor) / 2.0, self.names[1], TOP + floor, upright=True)
        if self.classes:
            self._classes(canvas, floor)

    def _scales(self, axes: Axes) -> None:
        """Set ends, ticks and lines of the axes."""
        x, y, right = self.x, self.y, WIDTH - RIGHT
        axes.set_xscale("log" if x.log else "linear")
        axes.set_yscale("log" if y.log else "linear")
        axes.set(xlim=(x.low, x.high), ylim=(y.low, y.high))
        axes.spines["left"].set(visible=True, linewidth=1.0, color=SOFT)
        for axis, ends, shown in ((axes.xaxis, x, not self.classes),
                                  (axes.yaxis, y, not self.rows)):
            ticks = ends.ticks() if shown else np.zeros(0)
            axis.set_ticks(ticks.tolist(), labels=number_words(ticks))
            axis.set_ticks([], minor=True)
        for label in axes.get_xticklabels():
            part = x.part(label.get_position()[0])
            label.set_visible(self.left + part * (right - self.left)
                              + 0.5 * width(label.get_text()) <= WIDTH)
        widest = max([width(words) for words in number_words(ticks)], default=1.0)
        axes.tick_params("y", length=0.0, pad=5.0,
                         labelsize=LETTERS * min(1.0, (self.left - 20.0) / widest))
        across = np.tile([x.low, x.high, np.nan], len(ticks))
        axes.plot(across, np.repeat(ticks, 3), color=style.LINE, linewidth=1.0, zorder=0.5,
                  clip_on=False, scalex=False, scaley=False)

    def _classes(self, canvas: Canvas, floor: float) -> None:
        """Write signs below their places, and once below them what they belong to."""
        room = (WIDTH - self.left - RIGHT) / max(len({owner for _, owner, _ in self.classes}), 1)
        owners: dict[str, list[float]] = {}
        for x, owner, sign in self.classes:
            place = self.left + self.x.part(x) * (WIDTH - self.left - RIGHT)
            owners.setdefault(owner, []).append(place)
            canvas.text(place, floor + 12.0, sign, ha="center", room=40.0)
        for owner, mine in owners.items():
            if room > width("leg…"):
                canvas.text(sum(mine) / len(mine), floor + 25.0, owner, SOFT, ha="center",
                            room=room)
        canvas.name((self.left + WIDTH - RIGHT) / 2.0, self.height - 6.0, self.names[0],
                    WIDTH - self.left)


def rows_plot(x: Axis, name: str, layers: Sequence[Layer], rows: Sequence[tuple[str, bool]],
              unit: str = "", left: float = NAMES, step: float = ROW) -> Plot:
    """Return a plot of named rows, from the top down; the middle of row i is at :func:`row_y`."""
    return Plot(x, Axis(0.0, float(len(rows))), (name, ""), layers, (unit, ""), left,
                TOP + step * len(rows) + BOTTOM, rows)


def row_y(count: int) -> Array:
    """Return where the middles of rows are on y (count,)."""
    return np.asarray(count - np.arange(count) - 0.5, dtype=float)
