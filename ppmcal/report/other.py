"""Results that no chapter is of: a check's, or a table without its record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ppmcal.io.csv import Table
from ppmcal.io.results.record import AnyRecord
from ppmcal.io.results.tables import ANY_TABLE
from ppmcal.report.design_records import DESIGNS, designs_in
from ppmcal.report.html import bullets, count, paragraph, sig, table, text_cell
from ppmcal.report.kind import Folder, Kind
from ppmcal.report.section import Section
from ppmcal.report.verdict import finding_text


@dataclass(frozen=True)
class Other:
    """Any further output: check, a table without its record."""

    folder: str
    kind: str
    record: AnyRecord
    table: Table | None = None


def other_section(other: Other) -> Section:
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


def _others_of(folder: Folder) -> Iterator[Other]:
    """Yield output that no other kind takes: of check, or a table without its record."""
    held = {file for kind in designs_in(folder.path) for file in DESIGNS[kind].TABLES}
    for kind, stem in (("check", "check"), ("plan", "poses"), ("map", "map")):
        if f"{stem}.csv" not in held and folder.has(f"{stem}.csv", f"{stem}.json"):
            path = folder.path / f"{stem}.json"
            record = AnyRecord.read(path) if path.is_file() else AnyRecord()
            yield Other(folder.name, kind, record, folder.table(
                replace(ANY_TABLE, file=f"{stem}.csv"), lambda _: False))


OTHER: Kind[Other] = Kind(
    "others", "others", "further output", 10,
    ("check.json", "poses.csv", "poses.json", "map.csv"), _others_of,
    lambda o, _: [(f"Output in {o.folder}", partial(other_section, o))],
    lambda o, _: {"folder": o.folder, "kind": o.kind, "record": o.record.entries(),
                  "rows": o.table.size if o.table is not None else None},
    lambda o: [(o.kind, o.record)],
    lambda o, _: [(o.folder, finding_text(f)) for f in o.record.findings or ()])
