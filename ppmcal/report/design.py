"""The section about what was worked out before measuring: one form for five commands."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from functools import partial
from html import escape
from typing import Any

from ppmcal.io.results.parts import ShownTable
from ppmcal.notes import FINDING, level_of
from ppmcal.plotting.style import with_palette
from ppmcal.report.design_records import DESIGN_FILES, designed
from ppmcal.report.html import (
    Cell,
    bullets,
    count,
    exact,
    name_cell,
    number,
    number_cell,
    paragraph,
    sig,
    table,
    text_cell,
)
from ppmcal.report.kind import Chapter, Kind
from ppmcal.report.other import scalars
from ppmcal.report.records import Designed, Picture, ReportData
from ppmcal.report.section import Section, filled
from ppmcal.wording import sentence

SHOWN = 30
"""Rows of a table that are shown; the JSON holds them all."""
CSS_DOTS = 96.0 / 150.0
"""Pictures have 150 dots to the inch, a page 96."""
DIGITS = 5
WIDE = 40
"""Cells with more letters may break."""


def design_section(one: Designed, folded: bool = False) -> Section:
    """Return everything about one design: what it says, its tables, pictures and findings."""
    r = one.record
    held = ", ".join(f"{count(n, 'row')} in {name}" for name, n in one.rows.items())
    out = [paragraph(f"From {one.folder}" + (f": {held}." if held else "."), "note")]
    out += [paragraph(s, "big" if i == 0 else "") for i, s in enumerate(r.summary)]
    out.append(bullets(r.findings))
    if not r.summary:
        out.append(scalars({k: v for k, v in r.entries().items() if k != "name"}))
    of = f" of {r.name}" if r.name else ""
    return Section(f"{one.record.TITLE}{of}", "".join(out), parts=filled(
        [Section("Pictures", _pictures(one), count(len(one.pictures), "picture"), folded),
         *(_table(one, t, folded) for t in r.tables)]))


def _table(one: Designed, shown: ShownTable, folded: bool) -> Section:
    """Return one table: its first rows, heads with units, and its note."""
    rows = shown.rows
    heads = [_head(c, one.record.units) for c in shown.columns]
    across = [_column(list(c)) for c in zip(*rows[:SHOWN], strict=True)]
    body = list(zip(*across, strict=True))
    more = (f"The first {SHOWN} of {count(len(rows), 'row')}; {one.kind}.json has them all."
            if len(rows) > SHOWN else "")
    note = " ".join(t for t in (sentence(shown.note), more) if t)
    html = table("", heads, body, sort=True) if heads else ""
    return Section(shown.title or "Table", (html or paragraph("No rows.", "note"))
                   + paragraph(note, "note"), count(len(rows), "row"), folded)


def _head(column: str, units: Mapping[str, str]) -> str:
    """Return a column's name with its unit."""
    unit, plain = units.get(column, ""), column.replace("_", " ")
    return f"{plain}, {unit}" if unit and unit != "1" else plain


def _column(values: list[Any]) -> list[Cell]:
    """Return one column of cells, without the zeros at which all of its numbers end."""
    shown = {i: sig(v, DIGITS) for i, v in enumerate(values) if isinstance(v, float)
             and number(v) is not None}
    broken = [s for s in shown.values() if "." in s]
    while broken and all(s.endswith("0") for s in broken):
        broken = [s[:-1] for s in broken]
        shown = {i: s[:-1] if "." in s else s for i, s in shown.items()}
    return [number_cell(v, shown[i].rstrip(".")) if i in shown else _cell(v)
            for i, v in enumerate(values)]


def _cell(value: Any) -> Cell:
    """Return one cell; words that are a number stand as such."""
    if isinstance(value, bool):
        return text_cell("yes" if value else "no")
    if value is None or isinstance(value, int):
        return number_cell(value, "–" if value is None else exact(value))
    try:
        plain = float(value)
    except ValueError:
        return name_cell(value) if len(value) <= WIDE else text_cell(value, "wrap")
    if math.isfinite(plain):
        return number_cell(plain, str(value).strip().replace("-", "−"))
    return number_cell(None, "–" if math.isnan(plain) else "−∞" if plain < 0.0 else "∞")


def _pictures(one: Designed) -> str:
    """Return all pictures, and what became of those that are not there."""
    figures = "".join(_figure(p, one.record.TITLE) for p in one.pictures if not p.problem)
    lacking = "".join(paragraph(f"{p.file}: {p.problem}.", "bad")
                      for p in one.pictures if p.problem)
    return (f'<div class="pictures">{figures}</div>' if figures else "") + lacking


def _figure(p: Picture, section: str) -> str:
    """Return a picture on a light card; its words are drawn dark."""
    caption = sentence(p.caption) or p.file
    alt = escape(f"{section}: {caption}", quote=True)
    data = base64.b64encode(with_palette(p.png)).decode("ascii")
    width, height = (max(round(v * CSS_DOTS), 1) for v in p.size)
    return (f'<figure class="picture"><img alt="{alt}" width="{width}" height="{height}" '
            f'src="data:image/png;base64,{data}"><figcaption>{escape(caption)}</figcaption>'
            "</figure>")


def _findings(one: Designed, _: ReportData) -> list[tuple[str, str]]:
    out = [(one.folder, text) for text in one.record.findings]
    return out + [(one.folder, f"the picture {p.file} is missing" if p.problem == "missing" else
                   f"the picture {p.file} cannot be shown: {p.problem}") for p in one.pictures
                  if p.problem and level_of(p.problem) == FINDING]


def _chapters(one: Designed, data: ReportData) -> list[Chapter]:
    several = len(data.designed) + len(data.identified) > 1
    return [(f"Error analysis in {one.folder}", partial(design_section, one, several))]


def _shown(one: Designed, _: ReportData) -> dict[str, Any]:
    return {"folder": one.folder, "kind": one.kind, "record": one.record.entries(),
            "rows": one.rows, "pictures": [
                {"file": p.file, "caption": p.caption, "size": p.size, "problem": p.problem}
                for p in one.pictures]}


DESIGN: Kind[Designed] = Kind(
    "designed", "designs", "error analysis", 90, DESIGN_FILES, lambda folder: designed(folder.path),
    _chapters, _shown, lambda one: [(one.kind, one.record)], _findings,
    lead=lambda one, _: [f"{one.record.TITLE}: {text}" for text in one.record.summary[:1]])
