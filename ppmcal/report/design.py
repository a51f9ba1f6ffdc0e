"""What was worked out before anything is measured, and results that no chapter is of.

Sensitivity, tolerances, stiffness, workspace and measuring plans write one form of record:
sentences, tables and the captions of their pictures, beside numbers of their own.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from ppmcal.codec import AGAIN
from ppmcal.errors import BadInput
from ppmcal.io.results.parts import ShownTable
from ppmcal.io.results.plan import PlanRecord
from ppmcal.io.results.record import AnyRecord
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.io.results.stiffness import StiffnessRecord
from ppmcal.io.results.tables import ANY_TABLE
from ppmcal.io.results.tolerances import TolerancesRecord
from ppmcal.io.results.workspace import WorkspaceRecord
from ppmcal.notes import FINDING, NOTE, Note, level_of
from ppmcal.plotting.style import with_palette
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
from ppmcal.report.records import CheckedRows, Designed, DesignRecord, Picture, ReportData
from ppmcal.report.section import Chapter, Folder, Kind, Section, filled
from ppmcal.report.verdict import finding_text
from ppmcal.store.inputs import track_input
from ppmcal.wording import sentence

DESIGNS: Mapping[str, type[DesignRecord]] = {kind.FILE.removesuffix(".json"): kind for kind in (
    SensitivityRecord, TolerancesRecord, StiffnessRecord, WorkspaceRecord, PlanRecord)}
"""Their records, by command."""
DESIGN_FILES = (*(kind.FILE for kind in DESIGNS.values()),
                *(f"{name}.csv" for name, kind in DESIGNS.items() if f"{name}.csv" in kind.TABLES))
"""Files by which such a folder is recognised; tables of other names are not theirs alone."""

LARGEST_FILE = 20_000_000
LARGEST_AREA = 60_000_000
"""Pictures of more bytes or dots stay out of the page."""
MOST = 40
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def designs_in(folder: Path) -> list[str]:
    """Return the commands of which a folder holds the record, or the table of the same name."""
    return [kind for kind in DESIGNS if any(
        (folder / f"{kind}.{end}").is_file() for end in ("json", "csv")
        if f"{kind}.{end}" in DESIGN_FILES)]


def designed(folder: Path) -> list[Designed]:
    """Return what such commands left in a folder; a broken record or table is BadInput."""
    out: list[Designed] = []
    for kind in designs_in(folder):
        file, of = folder / f"{kind}.json", DESIGNS[kind]
        record = of.read(file) if file.is_file() else of()
        _refuse_uneven(record, str(file))
        rows = {name: ANY_TABLE.read(folder / name, lambda _: False).size
                for name in of.TABLES if (folder / name).is_file()}
        out.append(Designed(str(folder), kind, record, rows, _listed(folder, record)))
    return out


def _refuse_uneven(record: DesignRecord, source: str) -> None:
    """Refuse a table whose rows have not one cell for each column."""
    for i, shown in enumerate(record.tables):
        for j, row in enumerate(shown.rows):
            if len(row) != len(shown.columns):
                raise BadInput(f"has {len(row)} cells, but the table has {len(shown.columns)} "
                               "columns", f"{source}: tables[{i}].rows[{j}]", AGAIN)


def _listed(folder: Path, record: DesignRecord) -> tuple[Picture, ...]:
    """Return the pictures that a record lists, or all of the folder where it has no list."""
    listed = record.pictures
    if listed is None:
        try:
            names = sorted(p.name for p in folder.iterdir() if p.suffix.lower() == ".png")
        except OSError:
            names = []
        listed = dict.fromkeys(names, "")
    out = [_picture(folder, name, caption) for name, caption in list(listed.items())[:MOST]]
    more = _left_out(f"the page takes {MOST} pictures")
    return (*out, *(Picture(name, "", problem=more) for name in list(listed)[MOST:]))


def _left_out(why: str) -> Note:
    return Note(f"left out: {why}", NOTE)


def _picture(folder: Path, name: str, caption: str) -> Picture:
    """Return one picture, or why it is not in the page."""
    def without(problem: str) -> Picture:
        return Picture(name, caption, problem=problem)

    if not name or name in (".", "..") or "/" in name or "\\" in name or "\0" in name:
        return without(_left_out("it is not in this folder"))
    path = folder / name
    try:
        if not path.is_file():
            return without("missing")
        if path.stat().st_size > LARGEST_FILE:
            return without(_left_out(f"larger than {LARGEST_FILE // 1_000_000} MB"))
        track_input(path)
        content = path.read_bytes()
    except OSError as error:
        return without(f"cannot be read ({error.strerror or error})")
    size, problem = png_size(content)
    return without(problem) if problem else Picture(name, caption, content, size)


def png_size(content: bytes) -> tuple[tuple[int, int], str]:
    """Return width and height of a PNG, or what is wrong with it.

    Every chunk is followed to the end and its check sum made, so that what was cut off or
    damaged does not leave a hole in the page.
    """
    if not content.startswith(_SIGNATURE):
        return (0, 0), _left_out("it is not a PNG")
    at, first, size = len(_SIGNATURE), True, (0, 0)
    while at + 12 <= len(content):
        length = int.from_bytes(content[at:at + 4], "big")
        body, end = content[at + 4:at + 8 + length], at + 12 + length
        if end > len(content) or zlib.crc32(body) != int.from_bytes(content[end - 4:end], "big"):
            break
        if first:
            if body[:4] != b"IHDR" or length != 13:
                break
            size = (int.from_bytes(body[4:8], "big"), int.from_bytes(body[8:12], "big"))
            if not 0 < size[0] * size[1] <= LARGEST_AREA:
                return (0, 0), _left_out(f"it has {size[0]} by {size[1]} dots")
        if body[:4] == b"IEND":
            return size, ""
        at, first = end, False
    return (0, 0), _left_out("it is cut off or damaged")


def other_section(other: CheckedRows[AnyRecord]) -> Section:
    """Return findings, plain facts and the size of any other output."""
    findings = [finding_text(f) for f in other.record.findings or ()]
    clean = other.record.findings is not None and not findings
    size = f"{count(other.table.size, 'row')} in its CSV." if other.table is not None else ""
    return Section(other.kind.capitalize(), paragraph(size, "note")
                   + paragraph("Nothing was found wrong." if clean else "")
                   + bullets(findings) + scalars(other.record.entries()), other.folder)


def scalars(record: Mapping[str, Any]) -> str:
    """Return the numbers and words of a JSON that has no section of its own."""
    pairs = []
    for key, value in record.items():
        if key in ("format", "findings", "provenance"):
            continue
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            shown = sig(value, 6) if isinstance(value, float) else str(value)
            pairs.append([text_cell(key.replace("_", " ")), text_cell(shown, "wrap")])
        elif isinstance(value, bool):
            pairs.append([text_cell(key.replace("_", " ")), text_cell("yes" if value else "no")])
    return table("", ["what", "value"], pairs)


def _others_of(folder: Folder) -> Iterator[CheckedRows[AnyRecord]]:
    """Yield output that no other kind takes: of check, or a table without its record."""
    held = {file for kind in designs_in(folder.path) for file in DESIGNS[kind].TABLES}
    for kind, stem in (("check", "check"), ("plan", "poses"), ("map", "map")):
        if f"{stem}.csv" not in held and folder.has(f"{stem}.csv", f"{stem}.json"):
            path = folder.path / f"{stem}.json"
            record = AnyRecord.read(path) if path.is_file() else AnyRecord()
            yield CheckedRows(folder.name, kind, record, folder.table(
                replace(ANY_TABLE, file=f"{stem}.csv"), lambda _: False))


OTHER: Kind[CheckedRows[AnyRecord]] = Kind(
    "others", "others", "further output", 10,
    ("check.json", "poses.csv", "poses.json", "map.csv"), _others_of,
    lambda o, _: [(f"Output in {o.folder}", partial(other_section, o))],
    lambda o, _: {"folder": o.folder, "kind": o.kind, "record": o.record.entries(),
                  "rows": o.table.size if o.table is not None else None},
    lambda o: [(o.kind, o.record)],
    lambda o, _: [(o.folder, finding_text(f)) for f in o.record.findings or ()])


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
