"""The certificate as it is printed on A4: one HTML page, and a PDF.

The PDF is drawn by matplotlib: no other library is needed for it.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path

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
from ppmcal.plotting.style import INK, LINE, SOFT, figure, look, png

WIDTH, HEIGHT = 6.6, 2.9
"""Inches."""


def data_uri(record: CertificateRecord) -> str:
    """Return the map as an address that holds the picture itself."""
    with look():
        drawn = figure(WIDTH, HEIGHT)
        draw(drawn, record, (0.0, 0.0, 1.0, 1.0))
        return "data:image/png;base64," + base64.b64encode(png(drawn)).decode()


def draw(drawn: Any, record: CertificateRecord, box: tuple[float, float, float, float]) -> None:
    """Draw the map into a part of a figure: left, bottom, width, height, parts of it."""
    place = np.array([r.place for r in record.rows], dtype=float)
    size = np.array([r.error for r in record.rows], dtype=float)
    unit, flat = record.units.name("length"), np.ptp(place[:, 2]) <= 1e-9 * (1.0 + np.ptp(place))
    views = [(0, 1)] if flat else [(0, 1), (0, 2)]    # from above, and from the side
    left, bottom, width, height = box
    share = width * 0.86 / len(views)
    shown: Any = None
    for n, (a, b) in enumerate(views):
        axes = drawn.add_axes((left + n * share + 0.085 * width, bottom + 0.19 * height,
                               share - 0.10 * width, 0.72 * height))
        shown = axes.scatter(place[:, a], place[:, b], c=size, s=14, cmap="viridis", vmin=0.0)
        axes.set_xlabel(f"{'xyz'[a]}, {unit}")
        axes.set_ylabel(f"{'xyz'[b]}, {unit}")
        axes.tick_params(labelsize=7)
    bar = drawn.add_axes((left + 0.89 * width, bottom + 0.19 * height, 0.015 * width,
                          0.72 * height))
    drawn.colorbar(shown, cax=bar).set_label(f"error, {unit}")
    bar.tick_params(labelsize=7)


STYLE = """
@page { size: A4; margin: 18mm 16mm 18mm 16mm;
  @bottom-right { content: counter(page) " / " counter(pages); font: 8pt sans-serif; } }
* { box-sizing: border-box; }
body { font: 9.5pt/1.4 "DejaVu Sans", Arial, sans-serif; color: #1c2227; background: #fff;
  max-width: 178mm; margin: 8mm auto; padding: 0 2mm; overflow-wrap: anywhere; }
h1 { font-size: 16pt; margin: 0 0 4mm; border-bottom: 0.6mm solid #1f62a6; padding-bottom: 2mm; }
h2 { font-size: 11.5pt; margin: 5mm 0 1.5mm; break-after: avoid; }
p { margin: 1mm 0 2mm; }
table { border-collapse: collapse; width: 100%; table-layout: fixed; margin: 1mm 0 2mm;
  font-size: 8.5pt; }
th, td { text-align: left; vertical-align: top; padding: 0.8mm 1.2mm;
  border-bottom: 0.2mm solid #dde2e6; }
th { color: #5a6670; font-weight: 600; }
tr { break-inside: avoid; }
.n { text-align: right; font-variant-numeric: tabular-nums; overflow-wrap: normal; }
dl { display: grid; grid-template-columns: 32mm 1fr; gap: 0.6mm 3mm; margin: 0; }
dt { color: #5a6670; } dd { margin: 0; }
img { width: 100%; height: auto; break-inside: avoid; }
@media print { body { margin: 0; padding: 0; max-width: none; } }
"""


def html_page(record: CertificateRecord) -> str:
    """Return the page, with all that it shows inside."""
    head = escape(title(record))
    parts = "\n".join(_html(b, record) for b in blocks(record))
    return (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{head}</title>'
            f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n'
            f"<body><h1>{head}</h1>\n{parts}\n</body></html>\n")


def _html(block: Block, record: CertificateRecord) -> str:
    """Return one part of the page."""
    match block:
        case Heading(text):
            return f"<h2>{escape(text)}</h2>"
        case Words(text):
            return f"<p>{escape(text)}</p>"
        case NamedLines(pairs):
            return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>"
                                    for k, v in pairs) + "</dl>"
        case PrintedTable():
            return _grid(block)
        case ErrorMap():
            return (f'<img alt="Errors of {len(record.rows)} rows over the measured places" '
                    f'src="{data_uri(record)}">')


def _grid(grid: PrintedTable) -> str:
    def row(cells: Any, tag: str) -> str:
        return "<tr>" + "".join(
            f'<{tag}{" class=n" if n in grid.right else ""}>{escape(str(c))}</{tag}>'
            for n, c in enumerate(cells)) + "</tr>"

    columns = "".join(f'<col style="width:{100.0 * w:g}%">' for w in grid.widths)
    body = "".join(row(r, "td") for r in grid.rows)
    return (f"<table><colgroup>{columns}</colgroup><thead>{row(grid.heads, 'th')}</thead>"
            f"<tbody>{body}</tbody></table>")


# ---- PDF


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
