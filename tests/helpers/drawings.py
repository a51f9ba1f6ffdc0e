"""SVG drawings read back: their words, bars, lines and markers, by how they look."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from matplotlib.figure import Figure

from ppmcal.plotting.canvas import LETTERS, WIDTH, Drawing, width
from ppmcal.plotting.picture import Canvas, draw
from ppmcal.plotting.style import AFTER, BEFORE, CARD, INK, OUT, SOFT, figure, look
from ppmcal.plotting.svg import svg

FILLS = {"before": ("none", BEFORE), "after": (AFTER, None), "named": (AFTER, None),
         "more": ("none", AFTER), "alternative": ("none", OUT), "explained": (BEFORE, None),
         "other": (SOFT, None), "ring": (CARD, BEFORE), "disc": (AFTER, AFTER)}
"""Fill and stroke of each kind of mark."""
SWATCH = 22.0


def figure_of(drawing: Drawing) -> Figure:
    """Return a drawing alone, as a sheet has it among others."""
    with look():
        drawn = figure(WIDTH / 72.0, drawing.height / 72.0)
        draw(drawing.content, Canvas(drawn))
    return drawn


def svg_of(drawing: Drawing) -> str:
    """Return a drawing alone as SVG."""
    return svg(figure_of(drawing), drawing.title, drawing.description)


def parsed(text: str) -> Element:
    """Return a drawing without namespace."""
    return ElementTree.fromstring(text.replace(' xmlns="http://www.w3.org/2000/svg"', ""))


def texts(root: Element) -> list[str]:
    """Return all words that are drawn."""
    return [t.text or "" for t in root.iter("text")]


def style(node: Element) -> dict[str, str]:
    """Return the style of a shape."""
    return dict(p.split(":", 1) for p in node.get("style", "").split(";") if p)


def bold(root: Element) -> list[str]:
    """Return the words in bold letters."""
    return [t.text or "" for t in root.iter("text") if style(t).get("font-weight") == "700"]


def pieces(path: Element) -> Iterator[list[tuple[float, float]]]:
    """Yield the points of each piece of a path."""
    for piece in path.get("d", "").split("M")[1:]:
        at: list[tuple[float, float]] = []
        for letter, rest in re.findall(r"([LCVhz]?)([-\d. ]*)", piece):
            n = [float(v) for v in rest.split()]
            if letter == "V":
                at.append((at[-1][0], n[0]))
            elif letter != "h":
                at += list(zip(n[::2], n[1::2], strict=True))
        yield at


def shapes(root: Element, *kinds: str) -> list[list[tuple[float, float]]]:
    """Return the corners of closed shapes that look like some kind, from the top down."""
    looks = [FILLS[k] for k in kinds]
    found = [piece for p in root.iter("path") if p.get("d", "").endswith("z")
             and (style(p).get("fill"), style(p).get("stroke")) in looks for piece in pieces(p)]
    return sorted(found, key=lambda piece: min(y for _, y in piece))


def bars(root: Element, *kinds: str) -> list[float]:
    """Return the lengths of bars from the top down, those of the legend left out."""
    lengths = [max(x for x, _ in b) - min(x for x, _ in b) for b in shapes(root, *kinds)]
    return [w for w in lengths if abs(w - SWATCH) > 0.01]


def lines(root: Element, colour: str = INK, dashed: bool | None = None
          ) -> list[list[tuple[float, float]]]:
    """Return the points of lines of a colour."""
    return [piece for p in root.iter("path") if style(p).get("stroke") == colour
            and style(p).get("fill") == "none" and not p.get("d", "").endswith("z")
            and dashed in (None, "stroke-dasharray" in style(p)) for piece in pieces(p)]


@dataclass(frozen=True)
class Box:
    """Where words are: ``left``, ``right``, ``top``, ``low``."""

    words: str
    left: float
    right: float
    top: float
    low: float

    def meets(self, other: Box) -> bool:
        """Return whether words lie on other words."""
        return (self.left < other.right and other.left < self.right
                and self.top < other.low and other.top < self.low)


def boxes(root: Element) -> list[Box]:
    """Return the room that words take, as wide as in a wide font."""
    out = []
    for t in root.iter("text"):
        look, words = style(t), t.text or ""
        size = float(look.get("font-size", f"{LETTERS}px").removesuffix("px"))
        room = width(words, look.get("font-weight") == "700", size)
        part = {"middle": 0.5, "end": 1.0}.get(look.get("text-anchor", ""), 0.0)
        x, y = float(t.get("x", 0.0)), float(t.get("y", 0.0))
        if "rotate" in t.get("transform", ""):
            out.append(Box(words, x - 0.8 * size, x + 0.2 * size, y - room * (1.0 - part),
                           y + room * part))
        else:
            out.append(Box(words, x - part * room, x + (1.0 - part) * room, y - 0.75 * size,
                           y + 0.14 * size))
    return out
