"""A plot over two axes, made of layers; its rows, or places along its axis, may have names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.linalg import Array
from ppmcal.plotting import style
from ppmcal.plotting.canvas import HEIGHT, SMALL, WIDTH, Drawing, fitted, width
from ppmcal.plotting.layers import Layer, Starts, grown, within
from ppmcal.plotting.style import SMALLEST, tame

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
        wide: the drawing, points.
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
    wide: float = WIDTH

    def drawing(self, title: str, caption: str, description: str,
                key: tuple[tuple[str, str], ...] = (), note: str = "") -> Drawing:
        """Return the plot with the words around it."""
        return Drawing(title, caption.strip(), description, self, self.height, key, note)

    def across(self, wide: float) -> Plot:
        """Return the plot at another width: as high, or of the same shape where it is ``equal``.

        Numbers beside the axis get the room that they take; arrows grow with the plot.
        """
        widest = max(map(width, style.number_words(self.y.ticks())), default=0.0)
        left = self.left if self.rows else max(self.left, widest + 20.0)
        if not self.equal:
            return replace(self, wide=wide, left=left)
        by = (wide - left - RIGHT) / (self.wide - self.left - RIGHT)
        return replace(self, wide=wide, left=left, layers=[grown(x, by) for x in self.layers],
                       height=TOP + BOTTOM + by * (self.height - TOP - BOTTOM))

    def per(self) -> tuple[float, float]:
        """Return how much of each linear axis a point is, at the size of a file."""
        floor = self.height - BOTTOM - CLASS_ROOM * bool(self.classes)
        return ((self.x.high - self.x.low) / (self.wide - RIGHT - self.left),
                (self.y.high - self.y.low) / (floor - TOP))

    def starts(self, layer: Starts) -> Iterator[tuple[float, str, str]]:
        """Yield where each part begins, its name, and as much of that as has room."""
        for x, name in layer.places:
            yield x, name, fitted(name, min(90.0, (self.x.high - x) / self.per()[0]), size=SMALL)

    def inside(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return points moved into the axes (N,), (N,), nan where they cannot be drawn."""
        at, up = np.broadcast_arrays(within(np.ravel(x), self.x.low, self.x.high),
                                     within(np.ravel(y), self.y.low, self.y.high))
        return at, up


def rows_plot(x: Axis, name: str, layers: Sequence[Layer], rows: Sequence[tuple[str, bool]],
              unit: str = "", left: float = NAMES, step: float = ROW) -> Plot:
    """Return a plot of named rows, from the top down; the middle of row i is at :func:`row_y`."""
    return Plot(x, Axis(0.0, float(len(rows))), (name, ""), layers, (unit, ""), left,
                TOP + step * len(rows) + BOTTOM, rows)


def row_y(count: int) -> Array:
    """Return where the middles of rows are on y (count,)."""
    return np.asarray(count - np.arange(count) - 0.5, dtype=float)
