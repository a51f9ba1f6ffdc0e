"""A drawing as data, in points: its size, its words and how much room they take.

:mod:`ppmcal.plotting.picture` makes pictures of drawings with matplotlib,
:mod:`ppmcal.plotting.web` figures of a page with plotly.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from ppmcal.plotting.style import plain

WIDTH, HEIGHT, EDGE = 400.0, 250.0, 8.0
"""Size of a drawing, such that its letters stay readable on a 400 px screen; its margin."""
LETTERS, SMALL, NAME, HEAD = 11.0, 9.5, 11.5, 13.0


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


@dataclass(frozen=True, eq=False)
class Drawing:
    """One drawing and the words around it.

    Attributes:
        title: in words; caption: what it shows and how to read it.
        description: for those who cannot see it.
        content: a :class:`~ppmcal.plotting.plot.Plot` or :class:`~ppmcal.plotting.bars.Chart` of
            :data:`WIDTH` and ``height`` points.
        key: kind (``before``, ``after``, ``out``, ``ring``) and name of each mark, for a page.
        note: what a drawing outside of a page has to say besides the caption.
    """

    title: str
    caption: str
    description: str
    content: object
    height: float = HEIGHT
    key: tuple[tuple[str, str], ...] = ()
    note: str = ""
