"""Rows of labelled horizontal bars: the label above or beside, the value at the right end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ppmcal.plotting.canvas import EDGE, WIDTH, Drawing, broken, width
from ppmcal.plotting.style import AFTER, BEFORE, OUT, SOFT, number_words, tame

THICK = {"explained": 5.0, "other": 2.5}
"""Thickness of bars that count less, of 8, where labels are above."""


@dataclass(frozen=True)
class BarLook:
    """How bars of one kind look: filled, with an opacity, or as a frame."""

    colour: str
    frame: bool = False
    alpha: float | None = None
    dashed: bool = False


LOOKS = {
    "before": BarLook(BEFORE, frame=True), "after": BarLook(AFTER), "named": BarLook(AFTER),
    "new": BarLook(AFTER), "more": BarLook(AFTER, frame=True),
    "alternative": BarLook(OUT, frame=True, dashed=True), "explained": BarLook(BEFORE, alpha=0.65),
    "old": BarLook(BEFORE, alpha=0.65), "other": BarLook(SOFT, alpha=0.6)}
LIMITS = {"limit": False, "dotted": True}
"""Kinds of upright lines, and whether they are dotted."""
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
        wide: the drawing, points.
    """

    rows: Sequence[Row]
    scale: Literal["linear", "log", "root"]
    low: float
    high: float
    axis: str
    ticks: Sequence[tuple[float, str]] = ()
    legend: Sequence[tuple[str, str]] = ()
    beside: bool = False
    wide: float = WIDTH

    @property
    def height(self) -> float:
        """Height of the drawing, points."""
        return self.tops()[-1] + FOOT

    def across(self, wide: float) -> Chart:
        """Return the chart at another width."""
        return replace(self, wide=wide)

    def drawing(self, title: str, caption: str, description: str, note: str = "",
                key: tuple[tuple[str, str], ...] = ()) -> Drawing:
        """Return the chart with the words around it."""
        return Drawing(title, caption, description, self, self.height, key, note)

    def places(self) -> list[tuple[float, float]]:
        """Return where the entries of the legend begin."""
        return legend_places([words for _, words in self.legend], EDGE, self.wide)

    def tops(self) -> list[float]:
        """Return where each row begins, and where the axis is."""
        out = [self.places()[-1][1] + 8.0 if self.legend else 0.0]
        for row in self.rows:
            more = LINE * (len(self.label(row)) - 1)
            out.append(out[-1] + (STEP if row.bars else 19.0) + more)
        return [*out[:-1], out[-1] + 2.0]

    def ends(self) -> tuple[float, float]:
        """Return where the bars begin and where the longest ends."""
        if not self.beside:
            return EDGE, self.wide - EDGE
        names = max(width(row.label) for row in self.rows if row.bars) + 6.0
        return (EDGE + min(names, LABELS),
                self.wide - EDGE - max(self.value_room(row) for row in self.rows) - 8.0)

    def value_room(self, row: Row) -> float:
        """Return the room that the words at the end of a row take."""
        return min(width(row.words, self.beside or row.strong), VALUES)

    def label(self, row: Row) -> list[str]:
        """Return the label in one line or two beside the words at the end; longer ones are cut."""
        if self.beside and row.bars:
            return [row.label]
        lines = broken(row.label, self.label_room(row), row.strong)
        return lines if len(lines) <= MOST_LINES else [row.label]

    def label_room(self, row: Row) -> float:
        """Return the room that the label of a row has."""
        if self.beside and row.bars:
            return self.ends()[0] - EDGE - 4.0
        return self.wide - 2.0 * EDGE - self.value_room(row) - 6.0

    def bars(self, row: Row) -> Iterator[tuple[float, str, float, float]]:
        """Yield value, kind, middle below the foot of the label, and thickness of each bar."""
        first, step = (-4.0 - 4.5 * (len(row.bars) - 1), 9.0) if self.beside else (9.5, 0.0)
        for i, (value, kind) in enumerate(row.bars):
            yield value, kind, first + step * i, 7.0 if self.beside else THICK.get(kind, 8.0)

    @property
    def upright(self) -> tuple[float, float]:
        """Where upright lines begin and end below the foot of a label."""
        return (-14.0, 6.0) if self.beside else (4.0, 15.0)

    def part(self, value: float) -> float:
        """Return where a value is between the ends of the scale, 0 to 1."""
        ends = np.array([self.low, self.inside(value), self.high])
        if self.scale != "linear":
            ends = np.log(ends) if self.scale == "log" else np.sqrt(np.maximum(ends, 0.0))
        low, at, high = ends.tolist()
        return float((at - low) / (high - low))

    def inside(self, value: float) -> float:
        """Return a value moved to the ends of the scale."""
        return float(np.clip(tame(np.array(value)), self.low, self.high))

    def shown(self, ticks: Sequence[tuple[float, str]], letters: float = 1.0
              ) -> list[tuple[float, str]]:
        """Return those of the ticks whose words have room, where letters are so much larger."""
        (left, right), out, free = self.ends(), [], 0.0
        for value, words in ticks:
            half = 0.5 * letters * width(words)
            x = left + (right - left) * self.part(value)
            if free <= x - half and x + half <= self.wide:
                out.append((value, words))
                free = x + half + 4.0
        return out


def legend_places(names: Sequence[str], left: float, wide: float) -> list[tuple[float, float]]:
    """Return where the entries of a legend begin, from ``left`` on in lines ``wide`` points."""
    out, x, y = [], left, 14.0
    for words in names:
        room = SWATCH + 5.0 + width(words)
        if x > left and x + room > wide - EDGE:
            x, y = left, y + LEGEND
        out.append((x, y))
        x += room + 12.0
    return out


def ratio_ticks(high: float) -> list[tuple[float, str]]:
    """Return 1, 2, 5, 10 ... up to a value."""
    tens = [10.0**k for k in range(12)]
    steps = tens if high > 100.0 else [m * t for t in tens for m in (1, 2, 5)]
    shown = [s for s in steps if s <= high * 1.0001]
    return list(zip(shown, number_words(shown), strict=True))
