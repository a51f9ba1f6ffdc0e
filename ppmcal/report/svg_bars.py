"""Rows of labelled horizontal bars as SVG: the label above or beside, the value at the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape

from ppmcal.report import svg

NARROW, SLIM, BROAD = "ijlI|'.,:; ", "frt()[]-/¹⁻", "mwMW→×±%…"
"""Letters by width; all others are about as wide as an ``n``."""
WIDTHS = (3.6, 4.6, 10.6, 6.8)
"""Widths at 11 px in a wide font, so that words fit in others too."""
BOLD = 1.1
EDGE = 8.0


@dataclass(frozen=True)
class BarPicture:
    """One drawing: ``name`` for its file, parts in drawing coordinates, words around it.

    ``key`` is HTML that explains marks on the page; ``note`` is what a drawing outside of the
    page has to say besides the caption.
    """

    name: str
    title: str
    caption: str
    description: str
    parts: tuple[str, ...]
    height: float
    key: str = ""
    note: str = ""

    def document(self) -> str:
        """Return the drawing for the page."""
        return svg.document(self.title, self.description, self.parts, svg.WIDTH, self.height)


@dataclass
class Bars:
    """Collects bars from the top down.

    ``at`` turns a value into a horizontal place between ``left`` and ``right``.
    """

    at: Callable[[float], float]
    left: float = EDGE
    right: float = svg.WIDTH - EDGE
    y: float = 14.0
    parts: list[str] = field(default_factory=list)

    def text(self, words: str, kind: str = "ink", x: float | None = None, anchor: str = "start",
             room: float | None = None) -> None:
        """Write words at the present height, shortened to the room there is."""
        place = EDGE if x is None else x
        most = svg.WIDTH - EDGE - place if room is None else room
        self.parts.append(fitting(place, self.y, words, most, anchor, kind))

    def bar(self, value: float, kind: str, top: float, thick: float) -> None:
        """Draw a bar from the left to a value."""
        end = max(self.at(value), self.left + 0.8)
        self.parts.append(f'<rect class="{kind}" x="{svg.num(self.left)}" y="{svg.num(top)}" '
                          f'width="{svg.num(end - self.left)}" height="{svg.num(thick)}"/>')

    def limit(self, value: float, top: float, bottom: float, kind: str = "") -> None:
        """Draw a piece of an upright line at a value."""
        self.parts.append(f'<path class="limit {kind}" d="M{svg.num(self.at(value))} '
                          f'{svg.num(top)}V{svg.num(bottom)}"/>')

    def axis(self, ticks: Sequence[tuple[float, str]], name: str) -> None:
        """Draw the axis with those of its ticks whose labels have room, and its name below."""
        y, free = self.y, -math.inf
        marks = [f"M{svg.num(self.left)} {svg.num(y)}H{svg.num(self.right)}"]
        for value, words in ticks:
            x = self.at(value)
            half = width(words) / 2.0
            if x - half > free and x - half > -2.0:
                marks.append(f"M{svg.num(x)} {svg.num(y)}v4")
                inside = min(x, svg.WIDTH - half - 1.0)
                self.parts.append(svg.text(inside, y + 15.0, words, "middle"))
                free = x + half + 4.0
        self.parts.append(f'<path class="axis" d="{"".join(marks)}"/>')
        self.parts.append(svg.text((self.left + self.right) / 2.0, y + 31.0, name, "middle",
                                   "name"))
        self.y = y + 38.0


def width(words: str, bold: bool = False) -> float:
    """Return about how wide words of 11 px are."""
    total = sum(WIDTHS[0] if c in NARROW else WIDTHS[1] if c in SLIM else
                WIDTHS[2] if c in BROAD else WIDTHS[3] for c in words)
    return total * (BOLD if bold else 1.0)


def fitting(x: float, y: float, words: str, room: float, anchor: str = "start",
            kind: str = "ink") -> str:
    """Return words that fit into a width; shortened ones are told in full on hovering."""
    bold = "strong" in kind
    if width(words, bold) <= room:
        return svg.text(x, y, words, anchor, kind)
    short = words
    while len(short) > 3 and width(short + "…", bold) > room:
        short = short[:-1]
    return (f'<text x="{svg.num(x)}" y="{svg.num(y)}" text-anchor="{anchor}" class="{kind}">'
            f"{escape(short.rstrip())}…<title>{escape(words)}</title></text>")


def log_scale(low: float, high: float, left: float, right: float) -> Callable[[float], float]:
    """Return a logarithmic scale, clipped at both ends."""
    axis = svg.Axis(low, high, True)
    return lambda v: left + float(axis.at(v)) * (right - left)


def linear_scale(high: float, left: float, right: float) -> Callable[[float], float]:
    """Return a scale from 0, clipped."""
    axis = svg.Axis(0.0, high)
    return lambda v: left + float(axis.at(v)) * (right - left)


def ratio_ticks(high: float) -> list[tuple[float, str]]:
    """Return 1, 2, 5, 10 ... up to a value."""
    steps = [m * 10.0**k for k in range(0, 12) for m in (1, 2, 5)]
    if high > 100.0:
        steps = [s for s in steps if math.isclose(math.log10(s) % 1.0, 0.0, abs_tol=1e-9)]
    return [(s, svg.label(s)) for s in steps if s <= high * 1.0001]
