"""Tables as instruments and controllers write them, under our own column names.

What is understood is said: how the file is separated, each column that is taken with its header
and unit and from where that is known, and each that is not.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.clock import Clock, clock_of_numbers, clock_of_words
from ppmcal.io.csv import Table, csv_table, refuse_absurd
from ppmcal.io.foreign_names import GROUPED, is_target, own_name, unit_in
from ppmcal.io.header_units import bare_name, without_units, zone_of
from ppmcal.io.input_files import first_bytes, read_bytes
from ppmcal.io.klipper_log import klipper_log
from ppmcal.io.measurement_columns import known_columns, translate_foreign, without_strangers
from ppmcal.io.point_list import with_header
from ppmcal.io.read_block import FURTHER, MATRIX, ReadFile
from ppmcal.io.reading import of_homogeneous, renamed, unit_of
from ppmcal.io.ros_bag import bag_tables, is_bag
from ppmcal.io.ros_tables import FORM, Recording, ros_csv, ros_headers
from ppmcal.io.tables import is_text, read_table
from ppmcal.io.yaml import number_text
from ppmcal.model.mechanism import Mechanism

WORDS = ("pose", "target", "session", "time", "date")
"""Columns that may hold words; so may parts of names."""


@dataclass(frozen=True)
class ForeignTable:
    """A table under our own names, and what was understood of it.

    Attributes:
        table: the columns that are known; ``time`` in s.
        headers: our own name -> the file's header.
        units: our own name -> unit, where the header has one.
        ignored: headers of the columns that are left alone.
        remarks: lines above the table, which nothing is made of: perhaps they name units.
        origin: our own name -> from where it is known that the column is this one.
        clock: of the column ``time``, None without one.
        form: what kind of file it is, where it is not a plain table.
        units_from: our own name -> from where its unit is known, if not from its header.
    """

    table: Table
    headers: Mapping[str, str]
    units: Mapping[str, str]
    ignored: tuple[str, ...]
    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    origin: Mapping[str, str] = field(default_factory=dict)
    clock: Clock | None = None
    form: str = ""
    units_from: Mapping[str, str] = field(default_factory=dict)

    @property
    def has_joints(self) -> bool:
        """Whether it holds joint values or commanded poses."""
        return any(h.startswith(("q_", "cmd_")) for h in self.table.header)


def foreign_tables(path: Path, mechanism: Mechanism, read: ReadFile, side: str
                   ) -> list[ForeignTable]:
    """Return the tables of a foreign file: one, or of a bag one for each message type.

    Args:
        path: CSV, list of points, ROS recording, log of Klipper, spreadsheet or Parquet.
        mechanism: for the names of its actuators.
        read: the sidecar's block; what it says of other files' columns is none of this one.
        side: what messages call the sidecar.

    Raises:
        BadInput: as :func:`csv_table` and :func:`with_header`, or an unknown unit in a header.
    """
    if path.is_dir() or is_bag(first_bytes(path, 16)):
        made = bag_tables(path, mechanism, read.topics)
    else:
        made = [_recording(path, mechanism, read)]
    return [_understood(r, mechanism, read, side) for r in made]


def _recording(path: Path, mechanism: Mechanism, read: ReadFile) -> Recording:
    """Return a file's table as it stands."""
    known = {*known_columns(mechanism), *MATRIX}

    def wordy(header: str) -> bool:
        own = next((o for o, h in read.columns.items() if h in (header, bare_name(header))), None)
        own = own or own_name(bare_name(header), known)[0]
        return header in read.ignore or own is None or own in WORDS or bool(GROUPED.fullmatch(own))

    source, data = str(path), read_bytes(path)
    if not is_text(data):
        return Recording(read_table(path, loose=wordy, sheet=read.sheet))
    special = klipper_log(data, source, mechanism) or ros_csv(data, source, mechanism)
    if special is not None:
        return special
    text_of, remarks = with_header(data, source)
    table = csv_table(text_of, source, wordy)
    if table.dialect and table.dialect.separator == "\t" and b"\t" not in data:
        table = replace(table, dialect=replace(table.dialect, separator=" "))
    refuse_absurd({h: v for h, v in table.numbers.items() if not wordy(h)}, source)
    return replace(ros_headers(table, mechanism), remarks=remarks)


def _understood(made: Recording, mechanism: Mechanism, read: ReadFile, side: str) -> ForeignTable:
    """Return a table under our own names."""
    known = {*known_columns(mechanism), *MATRIX}
    table, mine = made.table, _of_file(read, made.table)
    raw = table.header
    bare, headed = without_units(table, mine, known)
    original = dict(zip(bare.header, raw, strict=True))
    bare = of_homogeneous(bare, mine)
    original |= {h: h for h in bare.header if h not in original}
    theirs = [h for h in bare.header if h not in mine.ignore]
    told = set(mine.columns)
    table, findings = translate_foreign(renamed(bare, mine, mechanism, side), mechanism)
    names, origin = dict[str, str](), dict[str, str]()
    for name, header in zip(table.header, theirs, strict=True):
        own, why = own_name(name, known)
        if own and (own == name or own not in table.header) and own not in names:
            names[own] = header
            origin[own] = ("read.columns" if own in told else made.origin.get(original[header])
                           or (why if name == header else "a usual heading"))
    back = dict(zip(theirs, table.header, strict=True))
    _tell_targets(names, origin, back, known)
    if any(h.startswith(("q_", "cmd_")) and h in known for h in table.header):
        # in our own names, as `check` and `identify` read it
        kept = [n for n, h in zip(table.header, theirs, strict=True) if h not in names.values()]
        without_strangers(replace(table, header=tuple(kept), numbers={}, text={}), mechanism, known)
    numbers = {own: table.numbers[back[h]] for own, h in names.items() if back[h] in table.numbers}
    text = {own: table.text[back[h]] for own, h in names.items() if back[h] in table.text}
    units = {own: headed[h] for own, h in names.items() if h in headed}
    whence = dict.fromkeys(units, "ROS") if made.form == FORM else {}
    remark = unit_in(made.remarks)
    for own in (set("xyz") & set(names)) - set(units) if remark else ():
        units[own], whence[own] = str(remark), "a remark"
    found = ForeignTable(
        replace(table, header=tuple(names), numbers=numbers, text=text),
        {own: made.headers.get(original[h], original[h]) for own, h in names.items()}, units,
        tuple(h for n, h in original.items() if n not in names.values()),
        (*made.findings, *findings), made.remarks, origin, None, made.form, whence)
    return _with_clock(_with_groups(found), original.get(names.get("time", ""), ""), read, side)


def _tell_targets(names: dict[str, str], origin: dict[str, str], headers: Mapping[str, str],
                  known: Collection[str]) -> None:
    """Take one of two columns of names for the targets', in a table of points.

    Args:
        names: our own name -> the file's header; changed.
        origin: our own name -> from where it is known; changed.
        headers: the file's headers -> as the sidecar renames them.
        known: our own names.
    """
    called = [h for h, renamed in headers.items() if own_name(renamed, known)[0] == "pose"]
    what = [h for h in called if is_target(h)]
    if len(called) == 2 and len(what) == 1 and {"x", "y"} <= set(names):
        (names["pose"],) = set(called) - set(what)
        names["target"], origin["target"] = what[0], "a usual heading"


def _with_groups(found: ForeignTable) -> ForeignTable:
    """Return the table with its points' groups in their names: ``Group::Point``."""
    table = found.table
    groups = [h for h in table.header if GROUPED.fullmatch(h)]
    if not groups:
        return found
    parts = [table.labels(h) for h in [*groups, *(["pose"] if "pose" in table.header else [])]]
    names = tuple("::".join(p) for p in zip(*parts, strict=True))
    kept = tuple(h for h in table.header if h not in groups)
    text = {h: c for h, c in table.text.items() if h in kept and h != "pose"}
    numbers = {h: c for h, c in table.numbers.items() if h in kept and h != "pose"}
    whole = "', '".join(found.headers[h] for h in (*groups, "pose") if h in found.headers)
    return replace(found, headers={**found.headers, "pose": whole}, table=replace(
        table, header=kept if "pose" in kept else ("pose", *kept), numbers=numbers,
        text={**text, "pose": names}))


def _with_clock(found: ForeignTable, header: str, read: ReadFile, side: str) -> ForeignTable:
    """Return the table with its times in s, and their clock."""
    table, units = found.table, dict(found.units)
    if "date" in table.header:
        table = _with_dates(table)
    if "time" not in table.header:
        return replace(found, table=table)
    unit = units.pop("time", None) or unit_of("time", read, side)
    if "time" in table.text:
        clock = clock_of_words(table.text["time"], lambda i: table.at("time", i), read.dates,
                               zone_of(header) or read.zone)
    else:
        if unit is not None and unit not in FURTHER["time"]:
            raise BadInput(f"time cannot be in {unit}", f"{table.source}: header",
                           f"Write {' or '.join(FURTHER['time'])}")
        clock = clock_of_numbers(table.numbers["time"], table.at("time"),
                                 None if unit is None else FURTHER["time"][unit])
    return replace(found, table=replace(
        table, numbers={**table.numbers, "time": clock.seconds},
        text={h: c for h, c in table.text.items() if h != "time"}), units=units, clock=clock)


def _with_dates(table: Table) -> Table:
    """Return the table with dates and times of day in one column."""
    days = table.labels("date")
    text = {h: c for h, c in table.text.items() if h != "date"}
    numbers = {h: c for h, c in table.numbers.items() if h != "date"}
    if "time" in table.text:
        text["time"] = tuple(f"{d} {t}" if t else "" for d, t in zip(days, table.text["time"],
                                                                     strict=True))
    elif "time" not in table.header:
        text["time"] = days
    kept = [h for h in table.header if h != "date"]
    return replace(table, header=tuple(dict.fromkeys([*kept, "time"])), numbers=numbers, text=text)


def _of_file(read: ReadFile, table: Table) -> ReadFile:
    """Return of the block what names columns of this table."""
    bare = {bare_name(h) for h in table.header} | set(table.header)
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


def pose_names(table: Table) -> list[str]:
    """Return the names of N points or rows, with their groups."""
    if "pose" in table.numbers:
        return [number_text(v) if np.isfinite(v) else "" for v in table.numbers["pose"].tolist()]
    return [name.strip() for name in table.text["pose"]]
