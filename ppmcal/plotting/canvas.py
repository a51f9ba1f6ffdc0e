"""Drawings in points: each a picture of its own, or one of several on a sheet."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, Protocol

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.text import Text
from matplotlib.textpath import text_to_path
from matplotlib.transforms import Affine2D

from ppmcal.plotting.style import INK, SOFT, figure, look, plain
from ppmcal.plotting.svg import TOLD, svg

WIDTH, HEIGHT, EDGE = 400.0, 250.0, 8.0
"""Size of a drawing, such that its letters stay readable on a 400 px screen; its margin."""
LETTERS, SMALL, NAME, HEAD = 11.0, 9.5, 11.5, 13.0
PAD, LEADING = 14.0, 14.0
"""Room about the drawings of a sheet, and from one line of words to the next."""


@lru_cache(4096)
def width(words: str, bold: bool = False, size: float = LETTERS) -> float:
    """Return how wide words are, points, in a wide font, so that they fit in others too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        font = FontProperties("DejaVu Sans", weight="bold" if bold else "normal", size=size)
        return float(text_to_path.get_text_width_height_descent(plain(words), font, False)[0])


def fitted(words: str, room: float, bold: bool = False, size: float = LETTERS) -> str:
    """Return words on one line, cut so that they fit into a width."""
    line = short = plain(words)
    while len(short) > 3 and width(short + "…" * (short != line), bold, size) > room:
        short = short[:-1]
    return line if short == line else short.rstrip() + "…"


def broken(words: str, room: float, bold: bool = False, size: float = LETTERS) -> list[str]:
    """Return words in lines that fit a width."""
    lines = [""]
    for word in plain(words).split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and width(longer, bold, size) > room:
            lines.append(word)
        else:
            lines[-1] = longer
    return [fitted(line, room, bold, size) for line in lines]


@dataclass(frozen=True)
class Canvas:
    """A part of a figure, in points to the right and down from its upper left corner."""

    figure: Figure
    left: float = 0.0
    top: float = 0.0

    def axes(self, left: float, top: float, right: float, bottom: float) -> Axes:
        """Return axes between two corners, without ground and with a line below."""
        wide, high = (72.0 * float(v) for v in self.figure.get_size_inches())
        out = self.figure.add_axes((
            (self.left + left) / wide, 1.0 - (self.top + bottom) / high,
            (right - left) / wide, (bottom - top) / high))
        out.patch.set_visible(False)
        out.set_autoscale_on(False)
        out.spines[["left", "right", "top"]].set_visible(False)
        out.spines["bottom"].set(linewidth=1.0, color=SOFT)
        out.tick_params(labelsize=LETTERS, labelcolor=SOFT, color=SOFT, width=1.0, length=4.0,
                        pad=1.5)
        return out

    def add(self, artist: Artist) -> None:
        """Draw something whose coordinates are points."""
        height = float(self.figure.get_size_inches()[1])
        artist.set_transform(
            Affine2D().translate(self.left, self.top).scale(1.0 / 72.0, -1.0 / 72.0)
            .translate(0.0, height) + self.figure.dpi_scale_trans)
        self.figure.add_artist(artist)

    def text(self, x: float, y: float, words: str, colour: str = INK, bold: bool = False,
             ha: Literal["left", "center", "right"] = "left", room: float | None = None,
             size: float = LETTERS, upright: bool = False) -> None:
        """Write words at a place; those that are cut to their room are shown on hovering."""
        shown = fitted(words, WIDTH - x - EDGE if room is None else room, bold, size)
        gid = None if shown == plain(words) else TOLD + plain(words)
        self.add(Text(x, y, shown, ha=ha, color=colour, size=size, gid=gid,
                      weight="bold" if bold else "normal", rotation=90.0 if upright else 0.0,
                      rotation_mode="anchor"))

    def name(self, x: float, y: float, words: str, room: float, upright: bool = False) -> None:
        """Write the name of an axis about a place."""
        self.text(x, y, words, ha="center", room=room, size=NAME, upright=upright)


class Content(Protocol):
    """What a drawing shows."""

    def draw(self, canvas: Canvas) -> None:
        """Draw it."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """One drawing and the words around it.

    Attributes:
        title: in words; caption: what it shows and how to read it.
        description: for those who cannot see it.
        content: what is drawn, on a canvas of :data:`WIDTH` and ``height`` points.
        key: kind (``before``, ``after``, ``out``, ``ring``) and name of each mark, for a page.
        note: what a drawing outside of a page has to say besides the caption.
    """

    title: str
    caption: str
    description: str
    content: Content
    height: float = HEIGHT
    key: tuple[tuple[str, str], ...] = ()
    note: str = ""

    def figure(self) -> Figure:
        """Return the drawing alone."""
        with look():
            drawn = figure(WIDTH / 72.0, self.height / 72.0)
            self.content.draw(Canvas(drawn))
        return drawn

    def svg(self) -> str:
        """Return the drawing alone as SVG."""
        return svg(self.figure(), self.title, self.description)


def sheet(head: str, drawings: Sequence[Drawing]) -> Figure:
    """Return drawings with titles and captions below a head, two in a row where there are more."""
    columns = min(len(drawings), 2)
    wide = columns * (WIDTH + PAD) + PAD
    lines = broken(head, wide - 2.0 * PAD, bold=True)
    titles = [broken(d.title, WIDTH, True, HEAD) for d in drawings]
    words = [broken(f"{d.note} {d.caption}", WIDTH - 2.0 * EDGE) for d in drawings]
    heights = [16.0 * len(t) + 18.0 + d.height + LEADING * len(w)
               for d, t, w in zip(drawings, titles, words, strict=True)]
    tops = [2.0 * PAD + LEADING * len(lines)]
    for row in range(0, len(drawings), columns):
        tops.append(tops[-1] + max(heights[row:row + columns]) + PAD)
    with look():
        drawn = figure(wide / 72.0, (tops[-1] - 0.5 * PAD) / 72.0)
        for n, line in enumerate(lines):
            Canvas(drawn).text(PAD, PAD + 8.0 + LEADING * n, line, bold=True, room=wide)
        for n, drawing in enumerate(drawings):
            at = Canvas(drawn, PAD + n % columns * (WIDTH + PAD), tops[n // columns])
            for i, line in enumerate(titles[n]):
                at.text(WIDTH / 2.0, 12.0 + 16.0 * i, line, INK, True, "center", WIDTH, HEAD)
            at = Canvas(drawn, at.left, at.top + 16.0 * len(titles[n]) + 4.0)
            drawing.content.draw(at)
            for i, line in enumerate(words[n]):
                at.text(EDGE, drawing.height + 14.0 + LEADING * i, line, SOFT, room=WIDTH)
    return drawn
