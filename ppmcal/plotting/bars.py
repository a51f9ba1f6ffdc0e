"""Rows of labelled horizontal bars: the label above or beside, the value at the right end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from ppmcal.linalg import Array
from ppmcal.plotting.canvas import EDGE, WIDTH, Canvas, Drawing, broken, width
from ppmcal.plotting.style import AFTER, BEFORE, INK, OUT, SOFT, number_words, round_numbers, tame

THICK = {"explained": 5.0, "other": 2.5}
"""Thickness of bars that count less, of 8, where labels are above."""
LOOKS: dict[str, dict[str, Any]] = {
    "before": {"fill": False, "edgecolor": BEFORE, "linewidth": 1.4},
    "after": {"facecolor": AFTER}, "named": {"facecolor": AFTER}, "new": {"facecolor": AFTER},
    "more": {"fill": False, "edgecolor": AFTER, "linewidth": 1.4},
    "alternative": {"fill": False, "edgecolor": OUT, "linewidth": 1.4, "linestyle": (0, (4, 2))},
    "explained": {"facecolor": BEFORE, "alpha": 0.65}, "old": {"facecolor": BEFORE, "alpha": 0.65},
    "other": {"facecolor": SOFT, "alpha": 0.6}}
LIMITS: dict[str, Any] = {"limit": "-", "dotted": (0, (2, 2))}
SWATCH, LEGEND, STEP, LINE, FOOT = 22.0, 15.0, 31.0, 12.0, 38.0
MOST_LINES = 2
LABELS, VALUES, LEAST = 110.0, 180.0, 0.8
"""Most room for labels beside bars and for words at the end; length of bars of nothing."""


@dataclass(frozen=True)
class Row:
    """A label, bars as (value, kind), upright lines at values as (value, kind), words at the end.

    Kinds are those of :data:`LOOKS` and :data:`LIMITS`. A row without bars is a heading.
    """

    label: str
    bars: tuple[tuple[float, str], ...] = ()
    words: str = ""
    limits: tuple[tuple[float, str], ...] = ()
    strong: bool = False


@dataclass(frozen=True)
class Chart:
    """Rows of bars over one scale.

    Attributes:
        rows: from the top down.
        scale: of the bars; ``root``: as the square root, from 0.
        low, high: ends of the scale; what is beyond is drawn at them.
        axis: name of the scale, with its unit.
        ticks: places and words below the axis; round numbers where there are none.
        legend: kinds of bars and lines, and what they mean.
        beside: labels stand beside their bars, which are one below the other, instead of
            above; there they lie on each other.
    """

    rows: Sequence[Row]
    scale: Literal["linear", "log", "root"]
    low: float
    high: float
    axis: str
    ticks: Sequence[tuple[float, str]] = ()
    legend: Sequence[tuple[str, str]] = ()
    beside: bool = False

    def drawing(self, title: str, caption: str, description: str, note: str = "",
                key: tuple[tuple[str, str], ...] = ()) -> Drawing:
        """Return the chart with the words around it."""
        return Drawing(title, caption, description, self, self.tops()[-1] + FOOT, key, note)

    def draw(self, canvas: Canvas) -> None:
        """Draw it."""
        tops, (left, right) = self.tops(), self.ends()
        axes = canvas.axes(left, 0.0, right, tops[-1])
        if self.scale == "root":
            axes.set_xscale("function", functions=(_root, np.square))
        else:
            axes.set_xscale(self.scale)
        axes.set(xlim=(self.low, self.high), ylim=(tops[-1], 0.0), yticks=[])
        for (kind, words), (x, y) in zip(self.legend, self.places(), strict=True):
            thick = THICK.get(kind, 8.0)
            canvas.add(_line(x + 0.5 * SWATCH, y - 10.0, y + 2.0, kind) if kind in LIMITS else
                       _bar(x, y - 4.0 - 0.5 * thick, SWATCH, thick, kind))
            canvas.text(x + SWATCH + 5.0, y, words, SOFT)
        for row, top in zip(self.rows, tops, strict=False):
            self._row(canvas, axes, row, top + 14.0)
        self._ticks(axes, left, right)
        middle = 0.5 * (left + right)
        room = 2.0 * min(middle, WIDTH - middle) - EDGE
        canvas.name(middle, tops[-1] + 31.0, self.axis, room)

    def places(self) -> list[tuple[float, float]]:
        """Return where the entries of the legend begin."""
        out, x, y = [], EDGE, 14.0
        for _, words in self.legend:
            wide = SWATCH + 5.0 + width(words)
            if x > EDGE and x + wide > WIDTH - EDGE:
                x, y = EDGE, y + LEGEND
            out.append((x, y))
            x += wide + 12.0
        return out

    def tops(self) -> list[float]:
        """Return where each row begins, and where the axis is."""
        out = [self.places()[-1][1] + 8.0 if self.legend else 0.0]
        for row in self.rows:
            more = LINE * (len(self._label(row)) - 1)
            out.append(out[-1] + (STEP if row.bars else 19.0) + more)
        return [*out[:-1], out[-1] + 2.0]

    def ends(self) -> tuple[float, float]:
        """Return where the bars begin and where the longest ends."""
        if not self.beside:
            return EDGE, WIDTH - EDGE
        names = max(width(row.label) for row in self.rows if row.bars) + 6.0
        return (EDGE + min(names, LABELS),
                WIDTH - EDGE - max(self._value(row) for row in self.rows) - 8.0)

    def _value(self, row: Row) -> float:
        """Return the room that the words at the end of a row take."""
        return min(width(row.words, self.beside or row.strong), VALUES)

    def _label(self, row: Row) -> list[str]:
        """Return the label in one line or two beside the words at the end; longer ones are cut."""
        if self.beside and row.bars:
            return [row.label]
        lines = broken(row.label, self._room(row), row.strong)
        return lines if len(lines) <= MOST_LINES else [row.label]

    def _room(self, row: Row) -> float:
        """Return the room that the label of a row has."""
        if self.beside and row.bars:
            return self.ends()[0] - EDGE - 4.0
        return WIDTH - 2.0 * EDGE - self._value(row) - 6.0

    def _row(self, canvas: Canvas, axes: Axes, row: Row, y: float) -> None:
        """Draw one row, the foot of its label's first line at ``y``."""
        canvas.text(WIDTH - EDGE, y, row.words, bold=self.beside or row.strong, ha="right",
                    room=VALUES)
        for n, line in enumerate(self._label(row)):
            y += LINE * bool(n)
            canvas.text(EDGE, y, line, bold=row.strong, room=self._room(row))
        below, step = (-4.0 - 4.5 * (len(row.bars) - 1), 9.0) if self.beside else (9.5, 0.0)
        left, right = self.ends()
        across = (axes.transScale + axes.transLimits).inverted()
        least = float(across.transform((LEAST / (right - left), 0.0))[0])
        for i, (value, kind) in enumerate(row.bars):
            thick = 7.0 if self.beside else THICK.get(kind, 8.0)
            end = max(self._inside(value), least)
            axes.add_patch(_bar(self.low, y + below + step * i - 0.5 * thick, end - self.low, thick,
                                kind))
        for value, kind in row.limits:
            top = y - 14.0 if self.beside else y + 4.0
            axes.add_line(_line(self._inside(value), top, top + (20.0 if self.beside else 11.0),
                                kind))

    def _inside(self, value: float) -> float:
        return float(np.clip(tame(np.array(value)), self.low, self.high))

    def _ticks(self, axes: Axes, left: float, right: float) -> None:
        """Set those of the ticks whose labels have room."""
        found, free = list(self.ticks), 0.0
        if not found:
            places = round_numbers(self.low, self.high, False, 5, (1, 2, 5, 10))
            found = list(zip(places.tolist(), number_words(places), strict=True))
        shown = []
        across = axes.transScale + axes.transLimits
        for value, words in found:
            half = 0.5 * width(words)
            x = left + (right - left) * float(across.transform((value, 0.0))[0])
            if free <= x - half and x + half <= WIDTH:
                shown.append((value, words))
                free = x + half + 4.0
        axes.set_xticks([v for v, _ in shown], labels=[w for _, w in shown])
        axes.set_xticks([], minor=True)


def _bar(left: float, top: float, wide: float, thick: float, kind: str) -> Rectangle:
    return Rectangle((left, top), wide, thick, clip_on=False, **{"linewidth": 0.0, **LOOKS[kind]})


def _line(x: float, top: float, low: float, kind: str) -> Line2D:
    return Line2D([x, x], [top, low], color=INK, linewidth=1.2, linestyle=LIMITS[kind],
                  clip_on=False, solid_capstyle="butt")


def _root(values: Array) -> Array:
    return np.sqrt(np.maximum(values, 0.0))


def ratio_ticks(high: float) -> list[tuple[float, str]]:
    """Return 1, 2, 5, 10 ... up to a value."""
    tens = [10.0**k for k in range(12)]
    steps = tens if high > 100.0 else [m * t for t in tens for m in (1, 2, 5)]
    shown = [s for s in steps if s <= high * 1.0001]
    return list(zip(shown, number_words(shown), strict=True))
