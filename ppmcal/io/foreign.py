"""Tables as instruments and controllers write them, under our own column names.

What is understood is said: how the file is separated, each column that is taken with its header
and unit and from where that is known, and each that is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.clock import Clock, clock_of_numbers, clock_of_words
from ppmcal.io.column_names import GROUPED, is_target, known_columns, own_name, strangers, unit_in
from ppmcal.io.csv import Table, csv_table, refuse_absurd
from ppmcal.io.header import (
    FURTHER,
    MATRIX,
    HeaderColumn,
    ReadFile,
    bare_name,
    header_columns,
    named,
    unit_of,
    zone_of,
)
from ppmcal.io.point_list import with_header
from ppmcal.io.recordings import (
    FORM,
    Recording,
    bag_tables,
    is_bag,
    klipper_log,
    ros_csv,
    ros_headers,
)
from ppmcal.io.tables import is_text, read_table
from ppmcal.io.yaml import number_text
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.inputs import first_bytes, read_bytes

HEADING = "a usual heading"
"""Origin of a column whose header many recorders write."""
WORDS = ("pose", "target", "session", "time", "date")
"""Columns that may hold words; so may parts of names."""


@dataclass(frozen=True)
class ForeignTable:
    """A table under our own names, and what was understood of it.

    Attributes:
        table: the columns that are known; ``time`` in s.
        columns: what is known of each by its header, with those of which others were made.
        ignored: headers of the columns that are left alone.
        remarks: lines above the table, which nothing is made of: perhaps they name units.
        clock: of the column ``time``, None without one.
        form: what kind of file it is, where it is not a plain table.
    """

    table: Table
    columns: Mapping[str, HeaderColumn]
    ignored: tuple[str, ...]
    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    clock: Clock | None = None
    form: str = ""

    @property
    def has_joints(self) -> bool:
        """Whether it holds joint values or commanded poses."""
        return any(h.startswith(("q_", "cmd_")) for h in self.table.header)


def foreign_tables(path: Path, mechanism: Mechanism, read: ReadFile, side: str,
                   kind: InstrumentKind | None = None) -> list[ForeignTable]:
    """Return the tables of a foreign file: one, or of a bag one for each message type.

    It is a CSV, list of points, ROS recording, log of Klipper, spreadsheet or Parquet. What the
    sidecar's block ``read`` says of other files' columns is none of this one.

    Raises:
        BadInput: as :func:`csv_table` and :func:`with_header`, or an unknown unit in a header.
    """
    if path.is_dir() or is_bag(first_bytes(path, 16)):
        made = bag_tables(path, mechanism, read.topics)
    else:
        made = [_recording(path, mechanism, read, kind)]
    return [_understood(r, mechanism, read, side, kind) for r in made]


def _recording(path: Path, mechanism: Mechanism, read: ReadFile, kind: InstrumentKind | None
               ) -> Recording:
    """Return a file's table as it stands."""
    known = {*known_columns(mechanism, kind), *MATRIX}

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


def _understood(made: Recording, mechanism: Mechanism, read: ReadFile, side: str,
                kind: InstrumentKind | None) -> ForeignTable:
    """Return a table under our own names."""
    known, table = {*known_columns(mechanism, kind), *MATRIX}, made.table
    mine = _of_file(read, table)
    # which target a row is of is no measurement
    marks = mine.columns.get("target")
    measured = mine.model_copy(update={
        "columns": {k: v for k, v in mine.columns.items() if k != "target"}})
    columns, findings = header_columns(table, measured, mechanism, side, kind)
    names, taken = {c.name for c in columns}, dict[str, HeaderColumn]()
    for c in columns:
        own, why = ("target", "") if marks in (c.header, c.called) else own_name(c.name, known)
        if own and (own == c.name or own not in names) and own not in taken:
            origin = "read.columns" if own in mine.columns else made.origin.get(c.header) or (
                why if c.name == c.called else HEADING)
            taken[own] = replace(c, name=own, origin=origin,
                                 shown=c.shown or made.headers.get(c.header, c.header),
                                 unit_from="ROS" if made.form == FORM else c.unit_from)
    _tell_targets(taken, [c for c in columns if own_name(c.name, known)[0] == "pose"])
    used = {c.header for c in taken.values()}
    if any(n.startswith(("q_", "cmd_")) and n in known for n in names):
        # in our own names, as `check` and `identify` read it
        strangers(dict.fromkeys(c.name for c in columns if c.header not in used), mechanism, known,
                  table.source)
    remark = unit_in(made.remarks)
    for own in set("xyz") & set(taken) if remark else ():
        if not taken[own].unit:
            taken[own] = replace(taken[own], unit=str(remark), unit_from="a remark")
    found = ForeignTable(
        named(table, [*taken.values()]), taken, tuple(h for h in table.header if h not in used),
        (*made.findings, *findings), made.remarks, None, made.form)
    return _with_clock(_with_groups(found), read, side)


def _tell_targets(taken: dict[str, HeaderColumn], called: Sequence[HeaderColumn]) -> None:
    """Take one of two columns of names, ``called``, for the targets', in a table of points.

    ``taken``: the columns by our own names; changed.
    """
    what = [c for c in called if is_target(c.called)]
    if len(called) == 2 and len(what) == 1 and {"x", "y"} <= set(taken):
        (pose,) = (c for c in called if c is not what[0])
        taken["pose"] = replace(taken["pose"], header=pose.header, called=pose.called,
                                unit=pose.unit, shown=pose.shown or pose.header)
        taken["target"] = replace(what[0], name="target", origin=HEADING, shown=what[0].header)


def _with_groups(found: ForeignTable) -> ForeignTable:
    """Return the table with its points' groups in their names: ``Group::Point``."""
    table, columns = found.table, found.columns
    groups = [h for h in table.header if GROUPED.fullmatch(h)]
    if not groups:
        return found
    parts = [table.labels(h) for h in [*groups, *(["pose"] if "pose" in table.header else [])]]
    names = tuple("::".join(p) for p in zip(*parts, strict=True))
    whole = "', '".join(columns[h].shown for h in (*groups, "pose") if h in columns)
    pose = replace(columns.get("pose", HeaderColumn("", "pose", "pose")), shown=whole)
    table = table.without(groups)
    if "pose" not in table.header:
        table = replace(table, header=("pose", *table.header))
    return replace(found, columns={**columns, "pose": pose}, table=table.put({"pose": names}))


def _with_clock(found: ForeignTable, read: ReadFile, side: str) -> ForeignTable:
    """Return the table with its times in s, and their clock."""
    table = _with_dates(found.table) if "date" in found.table.header else found.table
    if "time" not in table.header:
        return replace(found, table=table)
    column = found.columns.get("time", HeaderColumn("", "time", "time"))
    unit = column.unit or unit_of("time", read, side)
    if "time" in table.text:
        clock = clock_of_words(table.text["time"], lambda i: table.at("time", i), read.dates,
                               zone_of(column.header) or read.zone)
    else:
        if unit is not None and unit not in FURTHER["time"]:
            raise BadInput(f"time cannot be in {unit}", f"{table.source}: header",
                           f"Write {' or '.join(FURTHER['time'])}")
        clock = clock_of_numbers(table.numbers["time"], table.at("time"),
                                 None if unit is None else FURTHER["time"][unit])
    return replace(found, table=table.put({"time": clock.seconds}), clock=clock,
                   columns={h: replace(c, unit="") if h == "time" else c
                            for h, c in found.columns.items()})


def _with_dates(table: Table) -> Table:
    """Return the table with dates and times of day in one column."""
    days, table = table.labels("date"), table.without(("date",))
    if "time" in table.text:
        return table.put({"time": tuple(f"{d} {t}" if t else "" for d, t in zip(
            days, table.text["time"], strict=True))})
    return table if "time" in table.header else table.put({"time": days})


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
    taken = {own for f in files for own in f.columns}
    ignored = {h for f in files for h in f.ignored}
    there = ", ".join(h for f in files for h in (
        *(c.shown for c in f.columns.values()), *f.ignored))
    for place, header in (
            *((f"columns.{own}", h) for own, h in read.columns.items() if own not in taken),
            *(("ignore", h) for h in read.ignore if h not in ignored)):
        raise BadInput(f"no file has a column '{header}'", f"{side}: read.{place}",
                       f"Their columns are {there}")


def pose_names(table: Table) -> list[str]:
    """Return the names of N points or rows, with their groups."""
    if "pose" in table.numbers:
        return [number_text(v) if np.isfinite(v) else "" for v in table.numbers["pose"].tolist()]
    return [name.strip() for name in table.text["pose"]]
