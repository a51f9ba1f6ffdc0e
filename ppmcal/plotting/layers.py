"""Layers of a plot as data: dots, strokes, lines, markers, arrows, bars, bands.

:mod:`ppmcal.plotting.picture` draws each with matplotlib, :mod:`ppmcal.plotting.web_layers` makes
traces of a page of it. Values beyond an axis are drawn at its edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.linalg import Array
from ppmcal.plotting.style import tame


@dataclass(frozen=True, eq=False)
class Undrawn:
    """All N rows of a thinned layer: a page draws those of them that are chosen elsewhere.

    Attributes:
        runs: (key without its row number, first row number, how many), one after the other.
        y: of each row (N,), nan where it has none.
        x: likewise; None where it is 1 ... N.
    """

    runs: Sequence[tuple[str, int, int]]
    y: Array
    x: Array | None = None


@dataclass(frozen=True)
class Points:
    """What the N points of a layer are; shown where a page is pointed at.

    Attributes:
        texts: what each is, in lines.
        keys: row of the data of each (`row_key` of :mod:`ppmcal.io.results.identification_tables`),
            by which plots and tables of a page are linked; none where points are not rows.
        undrawn: the other rows, where points are some of them.
    """

    texts: Sequence[str] = ()
    keys: Sequence[str] = ()
    undrawn: Undrawn | None = None


NO_POINTS = Points()


@dataclass(frozen=True, eq=False)
class Strokes:
    """Strokes from ``low`` to ``high`` at ``x`` (N,), upright, or ``flat`` along x.

    ``name``: what a line from edge to edge is.
    """

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike
    kind: str
    size: float = 1.5
    alpha: float | None = None
    flat: bool = False
    cap: Literal["butt", "round"] = "butt"
    points: Points = NO_POINTS
    name: str = ""


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots at places (N,)."""

    x: ArrayLike
    y: ArrayLike
    kind: str
    size: float = 4.0
    points: Points = NO_POINTS


@dataclass(frozen=True, eq=False)
class Polyline:
    """A line through points (N,); ``name``: what it is; ``tint``: its kind in a picture."""

    x: ArrayLike
    y: ArrayLike
    name: str = ""
    tint: str = "ink"
    size: float = 1.2
    dashed: bool = False


@dataclass(frozen=True)
class Zero:
    """The line of zero, from edge to edge."""

    upright: bool = False


@dataclass(frozen=True, eq=False)
class Marks:
    """Markers at places (N,), open ones if ``kind`` is ``before``."""

    x: ArrayLike
    y: ArrayLike
    kind: str
    marker: Literal["o", "x", "D", "s"]
    size: float = 6.4
    points: Points = NO_POINTS


@dataclass(frozen=True, eq=False)
class Intervals:
    """Means with half their intervals (N,), ``aside`` points: rings before, discs after."""

    x: Array
    mean: Array
    half: Array
    kind: str
    aside: float = 0.0
    points: Points = NO_POINTS

    @property
    def middle(self) -> Array:
        """The means (N,), nan where there is no interval."""
        return np.where(np.isfinite(self.half), self.mean, np.nan)


@dataclass(frozen=True)
class Band:
    """What is between two values of y, nothing where they are one."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Between:
    """What is between two lines over ``x`` (N,), cut off at the axes."""

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike

    def outline(self, bottom: float, top: float) -> tuple[Array, Array]:
        """Return the corners (2 N,), (2 N,), cut off at two values of y."""
        x = np.ravel(np.asarray(self.x, dtype=float))
        low, high = (np.clip(np.asarray(v, dtype=float), bottom, top)
                     for v in (self.low, self.high))
        return np.append(x, x[::-1]), np.append(low, high[::-1])


@dataclass(frozen=True, eq=False)
class Histogram:
    """The bars of a histogram: ``tops`` (N,) between ``edges`` (N + 1,)."""

    edges: Array
    tops: Array


@dataclass(frozen=True)
class Starts:
    """Where parts begin, a dashed line each, and their names."""

    places: Sequence[tuple[float, str]]


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows from places in data (N,) by ``dx`` to the right and ``dy`` up, points (N,).

    ``sizes`` (N,): how long they are in truth, in ``unit``.
    """

    x: Array
    y: Array
    dx: Array
    dy: Array
    kind: str
    sizes: Array | None = None
    unit: str = ""
    points: Points = NO_POINTS

    def pieces(self, wide: float, high: float) -> tuple[Array, Array]:
        """Return the corners (6 N,) of all in data, where a point is ``wide`` and ``high``."""
        dx, dy = self.dx, self.dy
        size = np.hypot(dx, dy)
        head = np.where(size > 4.0, -3.0 / np.maximum(size, 4.0), np.nan)
        u, v, nil = head * dx, head * dy, 0.0 * dx
        px = apart(nil, dx, dx + 0.87 * u - 0.5 * v, dx, dx + 0.87 * u + 0.5 * v)
        py = apart(nil, dy, dy + 0.5 * u + 0.87 * v, dy, dy - 0.5 * u + 0.87 * v)
        return np.repeat(self.x, 6) + wide * px, np.repeat(self.y, 6) + high * py


@dataclass(frozen=True)
class WordsAt:
    """Words that end at a place, points from the upper right corner."""

    x: float
    y: float
    text: str


Layer: TypeAlias = (Strokes | Dots | Polyline | Zero | Marks | Intervals | Band | Between
                    | Histogram | Starts | Arrows | WordsAt)


def grown(layer: Layer, by: float) -> Layer:
    """Return a layer whose lengths in points grow with the plot."""
    if isinstance(layer, Arrows):
        return replace(layer, dx=by * layer.dx, dy=by * layer.dy)
    return replace(layer, x=by * layer.x, y=by * layer.y) if isinstance(layer, WordsAt) else layer


def within(values: ArrayLike, low: float, high: float) -> Array:
    """Return values (N,) moved to the ends of an axis, nan where they are not finite."""
    v = tame(np.asarray(values, dtype=float))
    out: Array = np.clip(np.where(np.isfinite(v), v, np.nan), low, high)
    return out


def apart(*columns: ArrayLike) -> Array:
    """Return columns (N,) as pieces of a line, one row after the other, nan between them."""
    out: Array = np.stack(np.broadcast_arrays(*columns, np.nan), axis=-1).ravel()
    return out
