"""Drawings as files for papers: at the width of a column, with a legend and without a title.

A drawing is laid out in its own points, so many to the width that its letters have 7 to 8 printed
ones, then the whole is scaled. Colours differ in lightness too, so that they can be told in grey.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends import backend_pdf
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from ppmcal.plotting import layers, style
from ppmcal.plotting.bars import LEGEND, SWATCH, Chart, legend_places
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Layer
from ppmcal.plotting.picture import Canvas, draw, draw_layer
from ppmcal.plotting.plot import Axis, Plot
from ppmcal.plotting.style import figure, look, plain
from ppmcal.plotting.svg import svg

FORMATS = ("pdf", "svg", "png")
POINT = 0.7
"""Printed points of one of a drawing."""
LETTERS = 7.0, 8.0
"""Smallest and largest letters, printed points."""
DPI = 600
MM = 25.4 / 72.0
"""Millimetres of a printed point."""
PRINTED = {style.BEFORE: "#dd8a3a", style.AFTER: "#0b4a85", style.OUT: "#c2293a"}
"""Colours on paper: blue and orange for eyes of all kinds, one dark and one light."""
_PDF: Any = backend_pdf
UNKNOWN = "?"
"""Stands for a letter that the font lacks."""


def paper(drawing: Drawing, width: float, form: str) -> str | bytes:
    """Return a drawing as a file ``width`` mm wide, the same bytes for the same drawing.

    ``form``: one of :data:`FORMATS`.
    """
    with look():
        drawn = _figure(drawing, width / MM / POINT)
        if form == "svg":
            return svg(drawn, drawing.title, drawing.description, POINT * MM, "mm")
        for text in drawn.findobj(Text):
            text.set_text(known(text.get_text()))
        return _pdf(drawn) if form == "pdf" else _png(drawn)


@cache
def _letters() -> frozenset[int]:
    """Return the letters that the font of all pictures has."""
    return frozenset(get_font(findfont(FontProperties("DejaVu Sans"))).get_charmap())


def known(words: str) -> str:
    """Return words with :data:`UNKNOWN` for letters that the font lacks."""
    return "".join(c if ord(c) in _letters() or c == "\n" else UNKNOWN for c in words)


def _figure(drawing: Drawing, wide: float) -> Figure:
    """Return a drawing ``wide`` points wide, its legend above it."""
    content = drawing.content
    if not isinstance(content, Plot | Chart):
        raise TypeError(f"no picture can be made of {type(content).__name__}")
    content, entries = content.across(wide), list(legend(drawing))
    left = content.left if isinstance(content, Plot) and not content.rows else 0.0
    places = legend_places([words for _, words in entries], left, wide)
    top = LEGEND * len({y for _, y in places})
    drawn = figure(wide / 72.0, (top + content.height) / 72.0)
    draw(content, Canvas(drawn, 0.0, top, wide, LETTERS[0] / POINT))
    for (layer, words), (x, y) in zip(entries, places, strict=True):
        _sample(layer, Canvas(drawn, x, y - 9.0))
        Canvas(drawn, wide=wide).text(x + SWATCH + 5.0, y, words, style.INK)
    for artist in drawn.findobj():
        _print(artist)
    return drawn


def legend(drawing: Drawing) -> Iterator[tuple[Layer, str]]:
    """Yield what the marks and lines of a plot mean, each with a layer that has such ones."""
    if not isinstance(drawing.content, Plot):
        return    # a chart has its own
    of, named = drawing.content.layers, dict[str, Layer]()
    for kind, words in drawing.key:
        look_for = {"ring": "before"}.get(kind, kind)
        same = [x for x in of if getattr(x, "kind", "") == look_for]
        if same:
            yield same[-1], words
    for layer in of:
        if isinstance(layer, layers.Polyline | layers.Strokes) and layer.name:
            named.setdefault(layer.name, layer)
    yield from ((layer, name) for name, layer in named.items())


def _sample(layer: Layer, canvas: Canvas) -> None:
    """Draw one mark or line of a layer, as a legend has it."""
    pane = Plot(Axis(0.0, SWATCH), Axis(0.0, 10.0), ("", ""), ())
    middle, at = np.array([SWATCH / 2.0]), np.array([5.0])
    axes = canvas.axes(0.0, 0.0, SWATCH, 10.0)
    axes.set(xlim=(0.0, SWATCH), ylim=(0.0, 10.0), xticks=[], yticks=[])
    axes.spines["bottom"].set_visible(False)
    if isinstance(layer, layers.Dots | layers.Marks):
        layer = replace(layer, x=middle, y=at)
    elif isinstance(layer, layers.Intervals):
        layer = layers.Marks(middle, at, layer.kind, "o")
    elif isinstance(layer, layers.Polyline):
        layer = replace(layer, x=[0.0, SWATCH], y=[5.0, 5.0])
    elif isinstance(layer, layers.Arrows):
        layer = layers.Arrows(np.zeros(1), at, np.array([SWATCH]), np.zeros(1), layer.kind)
        pane = replace(pane, wide=SWATCH + 10.0, left=0.0)
    elif isinstance(layer, layers.Strokes):
        layer = replace(layer, x=at, low=[0.0], high=[SWATCH], flat=True)
    draw_layer(layer, pane, axes)


def _print(artist: Artist) -> None:
    """Give an artist the colours and sizes of letters that it has on paper."""
    if isinstance(artist, Text):
        low, high = LETTERS
        artist.set_fontsize(float(np.clip(artist.get_fontsize(), low / POINT, high / POINT)))
        artist.set_text(plain(artist.get_text()))
    elif isinstance(artist, Line2D):
        if to_hex(artist.get_color()) == style.OUT and not str(artist.get_label()).startswith("_"):
            artist.set_linestyle((0, (4, 2)))    # a limit, which is red on a screen
        artist.set_color(_printed(artist.get_color()))
        artist.set_markerfacecolor(_printed(artist.get_markerfacecolor()))
        artist.set_markeredgecolor(_printed(artist.get_markeredgecolor()))
    elif isinstance(artist, Patch):
        # what is not filled is black without opacity
        artist.set_facecolor(_printed(artist.get_facecolor()))
        artist.set_edgecolor(_printed(artist.get_edgecolor()))


def _printed(colour: Any) -> Any:
    """Return the colour that one of a screen has on paper."""
    return PRINTED.get(to_hex(colour), colour)


def _pdf(drawn: Figure) -> bytes:
    """Return a figure as PDF, its fonts embedded, without date or version in it."""
    stream = io.BytesIO()
    width, height = (float(v) for v in drawn.get_size_inches())
    drawn.dpi = 72
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        file = _PDF.PdfFile(stream, dict.fromkeys(("CreationDate", "Creator", "Producer")))
        try:
            file.newPage(POINT * width, POINT * height)
            file.width, file.height = width, height    # what is beyond is not drawn
            file.output(POINT, 0, 0, POINT, 0, 0, _PDF.Op.concat_matrix)
            renderer = _PDF.RendererPdf(file, 72, height, width)
            drawn.draw(renderer)
            renderer.finalize()
            file.finalize()
        finally:
            file.close()
    return stream.getvalue()


def _png(drawn: Figure) -> bytes:
    """Return a figure as PNG of :data:`DPI` printed dots to the inch."""
    stream = io.BytesIO()
    drawn.savefig(stream, format="png", dpi=POINT * DPI, metadata={"Software": None},
                  pil_kwargs={"dpi": (DPI, DPI)})
    return stream.getvalue()
