"""The certificate as a PDF on A4, drawn by matplotlib: no other library is needed for it."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from typing import Any

import matplotlib
from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path

from ppmcal.commands.certify.page import HEIGHT, WIDTH, draw
from ppmcal.io.results.certificate import (
    Block,
    CertificateRecord,
    ErrorMap,
    Heading,
    NamedLines,
    PrintedTable,
    Words,
    blocks,
    title,
)
from ppmcal.plotting.style import INK, LINE, SOFT, look

PAPER = 210.0 / 25.4, 297.0 / 25.4
MARGIN, FOOT, STEP = 0.67, 0.75, 1.38
"""Left and right, below; distance of lines over the size of letters. Inches."""
BODY, SMALL, LARGE, TITLE = 8.5, 7.5, 10.5, 15.0
"""Sizes of letters, points."""


def pdf_pages(record: CertificateRecord) -> bytes:
    """Return the PDF; without a date of its own, so that the same numbers give the same bytes."""
    stream = io.BytesIO()
    with look(), matplotlib.rc_context({"pdf.fonttype": 42}):
        sheet = PrintedSheet(record)
        for block in blocks(record):
            sheet.put(block)
        pages = sheet.ended()
        with PdfPages(stream, metadata={
                "CreationDate": None, "Producer": None, "Creator": "ppmcal",
                "Title": title(record)}) as file:
            for page in pages:
                file.savefig(page)
    return stream.getvalue()


def _length(text: str, size: float) -> float:
    """Return how wide a text is, inches."""
    font = FontProperties(family=["DejaVu Sans"], size=size)
    return float(text_to_path.get_text_width_height_descent(text, font, False)[0]) / 72.0


def wrapped(text: str, width: float, size: float) -> list[str]:
    """Return a text in lines of a width, inches; a word that is wider is broken."""
    out = [""]
    for word in text.split():
        for piece in _pieces(word, width, size):
            longer = f"{out[-1]} {piece}".strip()
            if out[-1] and _length(longer, size) > width:
                out.append(piece)
            else:
                out[-1] = longer
    return out


def _pieces(word: str, width: float, size: float) -> Iterator[str]:
    while _length(word, size) > width and len(word) > 1:
        count = next((n for n in range(len(word) - 1, 1, -1)
                      if _length(word[:n], size) <= width), 1)
        yield word[:count]
        word = word[count:]
    yield word


class PrintedSheet:
    """Pages that are filled from above; ``y`` is where the next line goes, inches from below."""

    def __init__(self, record: CertificateRecord) -> None:
        """Begin the first page with the title."""
        self.record, self.pages = record, list[Figure]()
        self.width = PAPER[0] - 2.0 * MARGIN
        self.page()
        self.text(MARGIN, title(record), TITLE, weight="bold")
        self.down(TITLE, 1.9)

    def page(self) -> None:
        """Begin a new page."""
        one = Figure(figsize=PAPER)
        FigureCanvasPdf(one)
        self.pages.append(one)
        self.y = PAPER[1] - MARGIN

    def room(self, height: float) -> None:
        """Begin a new page where there is less room than that, inches."""
        if self.y - height < FOOT:
            self.page()

    def down(self, size: float, lines: float = 1.0) -> None:
        """Go down by lines of a size of letters."""
        self.y -= lines * size * STEP / 72.0

    def text(self, x: float, words: str, size: float, **more: Any) -> None:
        """Write a line below ``y``."""
        self.pages[-1].text(x / PAPER[0], self.y / PAPER[1], words, fontsize=size, va="top",
                            **{"color": INK, **more})

    def put(self, block: Block) -> None:
        """Lay out one part."""
        if isinstance(block, Heading):
            self.room(0.9)
            self.down(LARGE, 0.6)
            self.text(MARGIN, block.text, LARGE, weight="bold")
            self.down(LARGE, 1.15)
        elif isinstance(block, Words):
            self.row([block.text], [1.0], (), BODY)
        elif isinstance(block, NamedLines):
            for name, words in block.pairs:
                self.row([name, words], [0.19, 0.81], (), BODY)
        elif isinstance(block, ErrorMap):
            self.picture()
        else:
            self.grid(block)

    def grid(self, grid: PrintedTable) -> None:
        """Lay out a table, its heads again on each page."""
        self.row(grid.heads, grid.widths, grid.right, SMALL, color=SOFT)
        count = len(self.pages)
        for cells in grid.rows:
            self.room(0.35)
            if len(self.pages) > count:
                count = len(self.pages)
                self.row(grid.heads, grid.widths, grid.right, SMALL, color=SOFT)
            self.row(cells, grid.widths, grid.right, SMALL, rule=True)
        self.down(SMALL, 0.4)

    def row(self, cells: Sequence[str], widths: Sequence[float], right: Sequence[int],
            size: float, color: str = INK, rule: bool = False) -> None:
        """Lay out cells side by side, each in its own lines."""
        gap = 0.08
        told = [wrapped(c, w * self.width - gap, size)
                for c, w in zip(cells, widths, strict=True)]
        most = max(map(len, told))
        self.room(most * size * STEP / 72.0)
        for n in range(most):
            x = MARGIN
            for i, (lines, w) in enumerate(zip(told, widths, strict=True)):
                if n < len(lines) and lines[n]:
                    end = i in right
                    self.text(x + (w * self.width - gap if end else 0.0), lines[n], size,
                              ha="right" if end else "left", color=color)
                x += w * self.width
            self.down(size)
        if rule:
            at = (self.y + 0.035) / PAPER[1]
            self.pages[-1].add_artist(Line2D([MARGIN / PAPER[0], 1.0 - MARGIN / PAPER[0]], [at, at],
                                             color=LINE, linewidth=0.5))

    def picture(self) -> None:
        """Draw the map of errors."""
        height = self.width * HEIGHT / WIDTH
        self.room(height)
        draw(self.pages[-1], self.record, (
            MARGIN / PAPER[0], (self.y - height) / PAPER[1], self.width / PAPER[0],
            height / PAPER[1]))
        self.y -= height

    def ended(self) -> list[Figure]:
        """Return the pages, numbered."""
        for n, page in enumerate(self.pages, 1):
            page.text(1.0 - MARGIN / PAPER[0], 0.4 / PAPER[1], f"{n} / {len(self.pages)}",
                      fontsize=SMALL, ha="right", color=SOFT)
            page.text(MARGIN / PAPER[0], 0.4 / PAPER[1], title(self.record), fontsize=SMALL,
                      color=SOFT)
        return self.pages
