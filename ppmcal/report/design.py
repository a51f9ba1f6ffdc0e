"""The section about what was worked out before measuring: one form for five commands."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from html import escape
from typing import Any

from ppmcal.io.results.design import ShownTable
from ppmcal.plotting.palette import with_palette
from ppmcal.report.format import count, exact, number, sig
from ppmcal.report.headlines import attention
from ppmcal.report.html import Cell, amount, bullets, dotted, paragraph, table, words
from ppmcal.report.other import scalars
from ppmcal.report.records import Designed, Picture, ReportData
from ppmcal.report.section import Section, filled
from ppmcal.report.verdict import verdicts
from ppmcal.wording import sentence

TITLES = {"sensitivity": "Sensitivity", "tolerances": "Tolerances", "stiffness": "Stiffness",
          "workspace": "Workspace and singularities", "plan": "Measuring plan"}
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
    out = [paragraph(_source(one), "note")]
    out += [paragraph(s, "big" if i == 0 else "") for i, s in enumerate(r.said)]
    out.append(bullets(r.findings))
    if not r.said:
        out.append(scalars({k: v for k, v in r.entries().items() if k != "name"}))
    of = f" of {r.name}" if r.name else ""
    return Section(f"{title(one)}{of}", "".join(out), parts=filled(
        [Section("Pictures", _pictures(one), count(len(one.pictures), "picture"), folded),
         *(_table(one, t, folded) for t in r.tables)]))


def title(one: Designed) -> str:
    """Return the section's title."""
    return TITLES.get(one.kind, one.kind.capitalize())


def design_headline(one: Designed) -> str:
    """Return what a design says first, empty where it says nothing."""
    return f"{title(one)}: {one.record.said[0]}" if one.record.said else ""


def _source(one: Designed) -> str:
    held = ", ".join(f"{count(n, 'row')} in {name}" for name, n in one.rows.items())
    return f"From {one.folder}" + (f": {held}." if held else ".")


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
    return [amount(v, shown[i].rstrip(".")) if i in shown else _cell(v)
            for i, v in enumerate(values)]


def _cell(value: Any) -> Cell:
    """Return one cell; words that are a number stand as such."""
    if isinstance(value, bool):
        return words("yes" if value else "no")
    if value is None or isinstance(value, int):
        return amount(value, "–" if value is None else exact(value))
    try:
        plain = float(value)
    except ValueError:
        return dotted(value) if len(value) <= WIDE else words(value, "wrap")
    if math.isfinite(plain):
        return amount(plain, str(value).strip().replace("-", "−"))
    return amount(None, "–" if math.isnan(plain) else "−∞" if plain < 0.0 else "∞")


def _pictures(one: Designed) -> str:
    """Return all pictures, and what became of those that are not there."""
    figures = "".join(_figure(p, title(one)) for p in one.pictures if not p.problem)
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


def look_at(data: ReportData) -> list[tuple[str, str]]:
    """Return all that the user must look at, designs included, as (where, sentence)."""
    out = attention(data)
    for one in data.designed:
        out += [(one.folder, text) for text in one.record.findings]
        out += [(one.folder, f"the picture {p.file} is missing" if p.problem == "missing" else
                 f"the picture {p.file} cannot be shown: {p.problem}") for p in one.pictures
                if p.problem and not p.problem.startswith("left out")]
    if not out:    # a doubt that is not a finding is still a doubt
        out = [(v.of, f"{line.question} {line.word}. {line.text}") for v in verdicts(data)
               for line in v.lines if line.state != "ok"]
    return list(dict.fromkeys(out))
