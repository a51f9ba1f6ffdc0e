"""Drawings as files of their own: SVG with its style inside, and PNG made from it."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from html import escape

from ppmcal.errors import BadInput
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import headline
from ppmcal.report import svg
from ppmcal.report.diagnosis_figures import pictures
from ppmcal.report.html import DRAWINGS, LIGHT
from ppmcal.report.svg_bars import EDGE, BarPicture

PAD, LINE = 14.0, 14.0
LETTERS = 62
"""Letters in a line of a caption below one drawing."""
SCALE = 1.6
"""Size in pixels of one unit of a drawing, as a browser first shows it."""
PNG_SCALE = 2.5
TITLES = {"gap": "How the gap closes", "ranking": "What could be missing",
          "actuators": "Where it is", "inputs": "What the residuals follow",
          "alternatives": "What these data cannot tell apart"}
EXTRA = "plots"


def diagnosis_files(record: DiagnosisRecord, png: bool = False) -> dict[str, str | bytes]:
    """Return file name -> SVG text, and PNG bytes where wanted, of a diagnosis's pictures."""
    out: dict[str, str | bytes] = {}
    for name, drawings in pictures(record).items():
        text = sheet(f"{record.name or 'ppmcal'}: {headline(record)}",
                     TITLES.get(name, name), drawings)
        out[f"{name}.svg"] = text
        if png:
            out[f"{name}.png"] = to_png(text)
    return out


def sheet(head: str, title: str, drawings: Sequence[BarPicture]) -> str:
    """Return drawings on one sheet, two in a row where there are several; no other file needed."""
    columns = 1 if len(drawings) == 1 else 2
    width = columns * (svg.WIDTH + PAD) + PAD
    lines = textwrap.wrap(head, int(width / 7.4)) or [""]
    y = PAD + LINE * len(lines) + 8.0
    parts = [svg.text(PAD, PAD + 8.0 + LINE * n, t, kind="strong") for n, t in enumerate(lines)]
    for begin in range(0, len(drawings), columns):
        row = drawings[begin:begin + columns]
        cells = [_cell(p, PAD + n * (svg.WIDTH + PAD), y) for n, p in enumerate(row)]
        parts += [text for text, _ in cells]
        y += max(height for _, height in cells) + PAD
    height = y + PAD / 2.0
    style = colours(DRAWINGS)
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{svg.num(width * SCALE)}" '
            f'height="{svg.num(height * SCALE)}" viewBox="0 0 {svg.num(width)} '
            f'{svg.num(height)}" role="img"><title>{escape(clean(title))}</title>'
            f"<style>{style}</style>"
            f'<rect width="100%" height="100%" fill="{LIGHT["card"]}"/>'
            + clean("".join(parts)) + "</svg>\n")


def _cell(picture: BarPicture, x: float, y: float) -> tuple[str, float]:
    """Return one drawing with its title above and its caption below, and the height of all."""
    titles = textwrap.wrap(picture.title, 56) or [""]
    out = [svg.text(svg.WIDTH / 2.0, 12.0 + 16.0 * n, t, "middle", "strong title")
           for n, t in enumerate(titles)]
    top = 16.0 * len(titles) + 4.0
    out.append(f'<g transform="translate(0 {svg.num(top)})"><desc>'
               f"{escape(picture.description)}</desc>{''.join(picture.parts)}</g>")
    bottom = top + picture.height + 10.0
    caption = f"{picture.note} {picture.caption}".strip()
    lines = textwrap.wrap(caption, LETTERS, replace_whitespace=False)
    out += [svg.text(EDGE, bottom + LINE * n, t) for n, t in enumerate(lines)]
    return (f'<g transform="translate({svg.num(x)} {svg.num(y)})">{"".join(out)}</g>',
            bottom + LINE * len(lines))


def colours(css: str) -> str:
    """Return rules with the colours themselves in place of their names."""
    return re.sub(r"var\(--(\w+)\)", lambda m: LIGHT[m[1]], css)


def clean(text: str) -> str:
    """Return text without the control letters that XML forbids."""
    return re.sub(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]", "\ufffd", text)


def need_png() -> None:
    """Refuse where the package that draws PNG is missing.

    Raises:
        BadInput: it names the extra to install.
    """
    try:
        import resvg_py  # noqa: F401
    except ImportError:
        raise BadInput(f"PNG pictures need the package resvg-py of the extra '{EXTRA}'", "--png",
                       f"Install it: pip install 'ppmcal[{EXTRA}]'; or leave --png out, the SVG "
                       "files need nothing") from None


def to_png(text: str) -> bytes:
    """Return an SVG drawing as PNG."""
    need_png()
    import resvg_py

    return bytes(resvg_py.svg_to_bytes(svg_string=text, zoom=PNG_SCALE / SCALE))
