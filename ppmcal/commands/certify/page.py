"""The certificate as one HTML page, made to be printed on A4."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

import numpy as np

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
from ppmcal.plotting.style import figure, look, png

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
    parts = "\n".join(_PARTS[type(b)](b, record) for b in blocks(record))
    return (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{head}</title>'
            f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n'
            f"<body><h1>{head}</h1>\n{parts}\n</body></html>\n")


def _grid(grid: PrintedTable, _: CertificateRecord) -> str:
    def row(cells: Any, tag: str) -> str:
        return "<tr>" + "".join(
            f'<{tag}{" class=n" if n in grid.right else ""}>{escape(str(c))}</{tag}>'
            for n, c in enumerate(cells)) + "</tr>"

    columns = "".join(f'<col style="width:{100.0 * w:g}%">' for w in grid.widths)
    body = "".join(row(r, "td") for r in grid.rows)
    return (f"<table><colgroup>{columns}</colgroup><thead>{row(grid.heads, 'th')}</thead>"
            f"<tbody>{body}</tbody></table>")


def _lines(lines: NamedLines, _: CertificateRecord) -> str:
    return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>"
                            for k, v in lines.pairs) + "</dl>"


def _heading(heading: Heading, _: CertificateRecord) -> str:
    return f"<h2>{escape(heading.text)}</h2>"


def _words(words: Words, _: CertificateRecord) -> str:
    return f"<p>{escape(words.text)}</p>"


def _map(_: ErrorMap, record: CertificateRecord) -> str:
    return (f'<img alt="Errors of {len(record.rows)} rows over the measured places" '
            f'src="{data_uri(record)}">')


_PARTS: Mapping[type[Block], Callable[[Any, CertificateRecord], str]] = {
    PrintedTable: _grid, NamedLines: _lines, Heading: _heading, Words: _words, ErrorMap: _map}
