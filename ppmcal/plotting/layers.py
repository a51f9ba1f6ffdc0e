"""Layers of a plot as data: dots, strokes, lines, markers, arrows, bars, bands.

Each draws itself on matplotlib's axes; :mod:`ppmcal.plotting.web` makes traces of a page of it.
Values beyond an axis are drawn at its edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import ArrayLike

from ppmcal.linalg import Array
from ppmcal.plotting import style
from ppmcal.plotting.canvas import LETTERS, SMALL, fitted
from ppmcal.plotting.style import AFTER, SOFT, plain, tame

COLOURS = {"before": style.BEFORE, "after": AFTER, "out": style.OUT, "ink": style.INK}


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
        keys: row of the data of each (:func:`ppmcal.report.rows.row_key`), by which plots and
            tables of a page are linked; none where points are not rows.
        undrawn: the other rows, where points are some of them.
    """

    texts: Sequence[str] = ()
    keys: Sequence[str] = ()
    undrawn: Undrawn | None = None


NO_POINTS = Points()


@dataclass(frozen=True, eq=False)
class Strokes:
    """Strokes from ``low`` to ``high`` at ``x`` (N,), upright, or ``flat`` along x."""

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike
    kind: str
    size: float = 1.5
    alpha: float | None = None
    flat: bool = False
    cap: Literal["butt", "round"] = "butt"
    points: Points = NO_POINTS

    def draw(self, axes: Axes) -> None:
        """Draw them as one path."""
        ends = (_apart(self.x, self.x), _apart(self.low, self.high))[::-1 if self.flat else 1]
        _put(axes, *ends, color=COLOURS[self.kind], linewidth=self.size, alpha=self.alpha,
             solid_capstyle=self.cap)


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots at places (N,)."""

    x: ArrayLike
    y: ArrayLike
    kind: str
    size: float = 4.0
    points: Points = NO_POINTS

    def draw(self, axes: Axes) -> None:
        """Draw them as one path of round strokes of next to no length: thousands stay small."""
        at, half = np.asarray(self.x, dtype=float), 1e-5 * float(np.ptp(axes.get_xlim()))
        Strokes(self.y, at - half, at + half, self.kind, self.size, flat=True,
                cap="round").draw(axes)


@dataclass(frozen=True, eq=False)
class Polyline:
    """A line through points (N,); ``name``: what it is."""

    x: ArrayLike
    y: ArrayLike
    name: str = ""

    def draw(self, axes: Axes) -> None:
        """Draw it."""
        _put(axes, self.x, self.y, color=style.INK, linewidth=1.2)


@dataclass(frozen=True)
class Zero:
    """The line of zero."""

    upright: bool = False

    def draw(self, axes: Axes) -> None:
        """Draw it from edge to edge."""
        ends = ([(0.0, 0.0), axes.get_ylim()] if self.upright else
                [axes.get_xlim(), (0.0, 0.0)])
        _put(axes, *ends, color=SOFT, linewidth=1.2, alpha=0.5)


@dataclass(frozen=True, eq=False)
class Marks:
    """Markers at places (N,), open ones if ``kind`` is ``before``."""

    x: ArrayLike
    y: ArrayLike
    kind: str
    marker: Literal["o", "x", "D", "s"]
    size: float = 6.4
    points: Points = NO_POINTS

    def draw(self, axes: Axes) -> None:
        """Draw them."""
        fill = style.CARD if self.kind == "before" else COLOURS[self.kind]
        _put(axes, self.x, self.y, linestyle="none", marker=self.marker, markersize=self.size,
             color=COLOURS[self.kind], markeredgewidth=1.5, markerfacecolor=fill)


@dataclass(frozen=True, eq=False)
class Intervals:
    """Means with half their intervals (N,), ``aside`` points: rings before, discs after."""

    x: Array
    mean: Array
    half: Array
    kind: str
    aside: float = 0.0
    points: Points = NO_POINTS

    def draw(self, axes: Axes) -> None:
        """Draw strokes, then markers."""
        at = self.x + self.aside * _per(axes)[0]
        middle = np.where(np.isfinite(self.half), self.mean, np.nan)
        Strokes(at, middle - self.half, middle + self.half, self.kind).draw(axes)
        Marks(at, middle, self.kind, "o").draw(axes)


@dataclass(frozen=True)
class Band:
    """What is between two values of y, nothing where they are one."""

    low: float
    high: float

    def draw(self, axes: Axes) -> None:
        """Fill it."""
        if self.low < self.high:
            axes.axhspan(self.low, self.high, facecolor=AFTER, alpha=0.12, linewidth=0.0,
                         clip_on=False)


@dataclass(frozen=True, eq=False)
class Between:
    """What is between two lines over ``x`` (N,), cut off at the axes."""

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike

    def draw(self, axes: Axes) -> None:
        """Fill it."""
        at = np.asarray(self.x, dtype=float)
        ends = [np.clip(np.asarray(v, dtype=float), *axes.get_ylim())
                for v in (self.low, self.high)]
        corners = np.stack([np.append(at, at[::-1]), np.append(ends[0], ends[1][::-1])], axis=-1)
        axes.add_patch(PathPatch(Path(corners, closed=False), facecolor=AFTER, alpha=0.2,
                                 linewidth=0.0, clip_on=False))


@dataclass(frozen=True, eq=False)
class Histogram:
    """The bars of a histogram: ``tops`` (N,) between ``edges`` (N + 1,)."""

    edges: Array
    tops: Array

    def draw(self, axes: Axes) -> None:
        """Draw them as one path."""
        left = self.edges[:-1] + 0.06 * np.diff(self.edges)
        right = self.edges[1:] - 0.06 * np.diff(self.edges)
        foot = 0.0 * self.tops
        corners = np.stack([np.stack([left, left, right, right], axis=-1),
                            np.stack([foot, self.tops, self.tops, foot], axis=-1)], axis=-1)
        path = Path.make_compound_path_from_polys(corners[self.tops > 0.0])
        axes.add_patch(PathPatch(path, facecolor=AFTER, alpha=0.75, linewidth=0.0,
                                 clip_on=False))


@dataclass(frozen=True)
class Starts:
    """Where parts begin, and their names."""

    places: Sequence[tuple[float, str]]

    def draw(self, axes: Axes) -> None:
        """Draw a dashed line each, with as much of the name as has room."""
        for x, name in self.places:
            shown = fitted(name, min(90.0, (axes.get_xlim()[1] - x) / _per(axes)[0]), size=SMALL)
            axes.axvline(x, color=SOFT, alpha=0.7, linewidth=1.0, dashes=(3.0, 3.0), clip_on=False)
            axes.annotate(shown, (x, 1.0), (3.0, -8.0), xycoords=axes.get_xaxis_transform(),
                          textcoords="offset points", size=SMALL, color=SOFT)


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
        px = _apart(nil, dx, dx + 0.87 * u - 0.5 * v, dx, dx + 0.87 * u + 0.5 * v)
        py = _apart(nil, dy, dy + 0.5 * u + 0.87 * v, dy, dy - 0.5 * u + 0.87 * v)
        return np.repeat(self.x, 6) + wide * px, np.repeat(self.y, 6) + high * py

    def draw(self, axes: Axes) -> None:
        """Draw them as one path."""
        axes.plot(*self.pieces(*_per(axes)), color=COLOURS[self.kind], linewidth=1.2,
                  clip_on=False, scalex=False, scaley=False)


@dataclass(frozen=True)
class WordsAt:
    """Words that end at a place, points from the upper right corner."""

    x: float
    y: float
    text: str

    def draw(self, axes: Axes) -> None:
        """Write them."""
        axes.annotate(plain(self.text), (1.0, 1.0), (-self.x, -self.y), xycoords="axes fraction",
                      textcoords="offset points", ha="right", size=LETTERS, color=SOFT)


Layer: TypeAlias = (Strokes | Dots | Polyline | Zero | Marks | Intervals | Band | Between
                    | Histogram | Starts | Arrows | WordsAt)


def _put(axes: Axes, x: ArrayLike, y: ArrayLike, **look: Any) -> None:
    """Draw one line or markers of one look, with gaps where values are not finite."""
    ends = [within(v, *limits) for v, limits in ((x, axes.get_xlim()), (y, axes.get_ylim()))]
    axes.plot(*ends, clip_on=False, scalex=False, scaley=False, **look)


def within(values: ArrayLike, low: float, high: float) -> Array:
    """Return values (N,) moved to the ends of an axis, nan where they are not finite."""
    v = tame(np.asarray(values, dtype=float))
    out: Array = np.clip(np.where(np.isfinite(v), v, np.nan), low, high)
    return out


def _apart(*columns: ArrayLike) -> Array:
    """Return columns (N,) as pieces of a line, one row after the other."""
    out: Array = np.stack(np.broadcast_arrays(*columns, np.nan), axis=-1).ravel()
    return out


def _per(axes: Axes) -> tuple[float, float]:
    """Return how much of each linear axis one point is."""
    (a, b), (c, d), dots_ = axes.get_xlim(), axes.get_ylim(), axes.figure.dpi / 72.0
    return (b - a) * dots_ / axes.bbox.width, (d - c) * dots_ / axes.bbox.height
