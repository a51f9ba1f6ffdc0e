"""Tables as instruments and controllers write them, under our own column names.

What is understood is said: how the file is separated, each column that is taken with its header
and unit, and each that is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table, csv_table, refuse_absurd
from ppmcal.io.dataset_reader import LABELS
from ppmcal.io.header_units import without_units
from ppmcal.io.measurement_columns import known_columns, translate_foreign
from ppmcal.io.point_list import with_header
from ppmcal.io.reading import MATRIX, ReadFile, renamed
from ppmcal.io.tables import is_text, read_table
from ppmcal.io.yaml import read_bytes
from ppmcal.model.mechanism import Mechanism

OTHERWISE: Mapping[str, str] = {
    **dict.fromkeys(("name", "point", "point name", "pointname", "point id", "pointid", "target",
                     "target name"), "pose"),
    **dict.fromkeys(("timestamp", "time stamp"), "time")}
"""Headers that are as good as our own."""


@dataclass(frozen=True)
class ForeignTable:
    """A table under our own names, and what was understood of it.

    Attributes:
        table: the columns that are known.
        headers: our own name -> the file's header.
        units: our own name -> unit, where the header has one.
        ignored: headers of the columns that are left alone.
        remarks: lines above the table, which nothing is made of: perhaps they name units.
    """

    table: Table
    headers: Mapping[str, str]
    units: Mapping[str, str]
    ignored: tuple[str, ...]
    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def has_joints(self) -> bool:
        """Whether it holds joint values or commanded poses."""
        return any(h.startswith(("q_", "cmd_")) for h in self.table.header)


def foreign_table(path: Path, mechanism: Mechanism, read: ReadFile, side: str) -> ForeignTable:
    """Return the table of a foreign file.

    Args:
        path: CSV, list of points, or any other file that :func:`read_table` knows.
        mechanism: for the names of its actuators.
        read: the sidecar's block; what it says of other files' columns is none of this one.
        side: what messages call the sidecar.

    Raises:
        BadInput: as :func:`csv_table` and :func:`with_header`, or an unknown unit in a header.
    """
    known = {*known_columns(mechanism), *MATRIX}

    def wordy(header: str) -> bool:
        own = next((o for o, h in read.columns.items() if h == header), None)
        own = own or _own(header.split("[")[0].split("(")[0].strip(), known)
        return header in read.ignore or own is None or own in LABELS

    source, remarks = str(path), tuple[str, ...]()
    if is_text(data := read_bytes(path)):
        text_of, remarks = with_header(data, source)
        table = csv_table(text_of, source, wordy)
        if table.dialect and table.dialect.separator == "\t" and b"\t" not in data:
            table = replace(table, dialect=replace(table.dialect, separator=" "))
        refuse_absurd({h: v for h, v in table.numbers.items() if not wordy(h)}, source)
    else:
        table = read_table(path, loose=wordy, sheet=read.sheet)
    mine = _of_file(read, table)
    raw = table.header
    table, headed = without_units(table, mine, known)
    original = dict(zip(table.header, raw, strict=True))
    theirs = [h for h in table.header if h not in mine.ignore]
    table, findings = translate_foreign(renamed(table, mine, mechanism, side), mechanism)
    names: dict[str, str] = {}
    for name, header in zip(table.header, theirs, strict=True):
        own = _own(name, known)
        if own and (own == name or own not in table.header) and own not in names:
            names[own] = header
    back = dict(zip(theirs, table.header, strict=True))
    numbers = {own: table.numbers[back[h]] for own, h in names.items() if back[h] in table.numbers}
    text = {own: table.text[back[h]] for own, h in names.items() if back[h] in table.text}
    return ForeignTable(
        replace(table, header=tuple(names), numbers=numbers, text=text),
        {own: original[h] for own, h in names.items()},
        {own: headed[h] for own, h in names.items() if h in headed},
        tuple(h for n, h in original.items() if n not in names.values()), tuple(findings),
        remarks)


def _own(name: str, known: set[str]) -> str | None:
    """Return our own name of a column, None where nobody knows it."""
    if name in known or name.startswith("temperature_"):
        return name
    low = name.lower().replace("_", " ")
    return next((k for k in known if k.lower() == name.lower()), None) or OTHERWISE.get(low)


def _of_file(read: ReadFile, table: Table) -> ReadFile:
    """Return of the block what names columns of this table."""
    bare = {h.split("[")[0].split("(")[0].strip() for h in table.header} | set(table.header)
    return read.model_copy(update={
        "columns": {own: h for own, h in read.columns.items() if h in bare},
        "ignore": [h for h in read.ignore if h in table.header]})


def refuse_unused(read: ReadFile, files: list[ForeignTable], side: str) -> None:
    """Refuse what the sidecar says of columns that no file has.

    Raises:
        BadInput: with the columns that there are.
    """
    taken = {own for f in files for own in f.headers}
    ignored = {h for f in files for h in f.ignored}
    there = ", ".join(h for f in files for h in (*f.headers.values(), *f.ignored))
    for own, header in read.columns.items():
        if own not in taken:
            raise BadInput(f"no file has a column '{header}'", f"{side}: read.columns.{own}",
                           f"Their columns are {there}")
    for header in read.ignore:
        if header not in ignored:
            raise BadInput(f"no file has a column '{header}'", f"{side}: read.ignore",
                           f"Their columns are {there}")
