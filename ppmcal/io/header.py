"""The header of a table, gone through once: of each column our name, unit, sign, and why so.

A unit in a header (``q_leg1 [mm]``, ``x (mm)``, ``temperature [F]``) says the same as one under
``read.units`` in the sidecar.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TypeVar

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.io.column_names import known_columns, recorders_names
from ppmcal.io.csv import Table
from ppmcal.io.read_block import HOMOGENEOUS, MATRIX, UNITS, ReadFile
from ppmcal.io.schema import did_you_mean
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

T = TypeVar("T")
NAMED = "its name"
"""Origin of a column that is called as we call it."""
_WITH_UNIT = re.compile(r"(?P<name>.*\S)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))")
_SPELT: Mapping[str, str] = {
    "°": "deg", "°C": "C", "°F": "F", "degC": "C", "degF": "F", "µm": "um", "μm": "um",
    "inch": "in", "rev": "turn", "Nm": "N m", "N.m": "N m", "N·m": "N m", "N*m": "N m"}
"""Other ways to write a unit."""
BARE = ("", "-", "1")
"""Written in the place of a unit where there is none."""
CLOCKS = ("time", "timestamp", "time stamp", "date", "datetime", "date time")
"""Columns in whose brackets the form of a clock may stand, or its zone."""
_CLOCK = re.compile(r"[hHmMsSyYdDfFT:./\- ]{5,}|UTC|GMT|Z|UTC[+-]\d{1,2}|local|ISO ?8601", re.ASCII)
RATES = ("vel_", "vx", "vy", "vz", "wx", "wy", "wz")
"""Columns that begin so are per second: `mm/s` is the same as `mm`."""


@dataclass(frozen=True)
class HeaderColumn:
    """One column of a file, as its header and the sidecar's block ``read`` have it.

    Attributes:
        header: as it stands in the table.
        called: as the sidecar may call it: without its unit.
        name: ours; of a column that nobody knows, as it is called.
        unit: of its numbers, empty where that is the file's.
        sign: 1, or -1 where the sidecar turns it round.
        origin: from where it is known that the column is this one.
        unit_from: from where its unit is known.
        place: where its unit stands, for messages.
        shown: what people are shown as its header, where that is another  [default: the header].
    """

    header: str
    called: str
    name: str
    unit: str = ""
    sign: int = 1
    origin: str = NAMED
    unit_from: str = "header"
    place: str = ""
    shown: str = ""


Columns = Sequence[HeaderColumn]


def named(table: Table, columns: Columns) -> Table:
    """Return the columns of a table under our own names."""
    return table.named({c.header: c.name for c in columns})


def _parts(header: str) -> tuple[str, str | None]:
    """Return a header without brackets at its end, and what is in them, None without any."""
    found = _WITH_UNIT.fullmatch(header)
    return (found["name"], (found["square"] or found["round"] or "").strip()) if found else (
        header, None)


def bare_name(header: str) -> str:
    """Return a header without what stands in brackets at its end."""
    return _parts(header.strip())[0]


def zone_of(header: str) -> str | None:
    """Return the zone in the brackets of a header such as ``Time (UTC)``, None without one."""
    inside = _parts(header.strip())[1] or ""
    if inside in ("UTC", "GMT", "Z"):
        return "UTC"
    away = re.fullmatch(r"UTC([+-])(\d{1,2})", inside)
    return f"{away[1]}{int(away[2]):02d}:00" if away else None


def header_columns(table: Table, read: ReadFile, mechanism: Mechanism, side: str,
                   kind: InstrumentKind | None = None) -> tuple[Columns, list[Note]]:
    """Return the columns of a table without those to be left alone, and what was concluded.

    Args:
        table: as it was read.
        read: the sidecar's block.
        mechanism: for its actuators.
        side: what messages call the sidecar.
        kind: of the instrument, where that is known.

    Raises:
        BadInput: an unknown unit, two columns of one name, a header in the block that the file
            does not have, or a last row of matrices that is not 0, 0, 0, 1.
    """
    known = [*known_columns(mechanism, kind), *MATRIX]
    columns = _of_matrices(table, bare_columns(table, read, known), read)
    columns = _renamed(columns, read, known, table.source, side)
    names, findings = recorders_names([c.name for c in columns], mechanism, table.source)
    return [replace(c, name=names.get(c.name, c.name)) for c in columns], findings


def bare_columns(table: Table, read: ReadFile, known: Collection[str]) -> list[HeaderColumn]:
    """Return the columns by their headers alone: names without brackets, and units.

    A header that the sidecar names as it stands keeps its name; what it has in brackets counts
    where it is a unit.

    Args:
        table: as it was read.
        read: the sidecar's block.
        known: names of our own columns: what stands in brackets behind one must be a unit.

    Raises:
        BadInput: an unknown unit, or two columns of one name but for the unit.
    """
    whole = {*read.columns.values(), *read.ignore}
    out, seen = list[HeaderColumn](), set[str]()
    for header in table.header:
        name, unit = _split(header, f"{table.source}: header", known)
        name = header if header in whole else name
        out.append(HeaderColumn(header, name, name, "" if header in read.ignore else unit))
        if name in seen:
            raise BadInput(f"two columns are called '{name}', but for the unit",
                           f"{table.source}: header", f"Write `ignore: ['{header}']` "
                           "under `read` in the sidecar, or rename one of them")
        seen.add(name)
    return out


def _split(header: str, place: str, known: Collection[str]) -> tuple[str, str]:
    """Return name and unit of a header, the header and nothing where it has no unit."""
    name, unit = _parts(header)
    if unit is None:
        return header, ""
    unit = _SPELT.get(unit, unit)
    if name.startswith(RATES):
        unit = unit.removesuffix("/s")
    if unit in UNITS:
        return name, unit
    if name.lower() in CLOCKS and _CLOCK.fullmatch(unit):
        return name, ""
    ours = name in known or name.startswith("temperature_")
    if ours and unit not in BARE:
        error = unknown("unit", unit, UNITS)
        raise BadInput(error.what, f"{place}, column {header}", error.hint)
    return (name, "") if ours else (header, "")


def _of_matrices(table: Table, columns: list[HeaderColumn], read: ReadFile) -> list[HeaderColumn]:
    """Return the columns with the entries of matrices (m00 ... m23, t14 ...) under our own names.

    Raises:
        BadInput: a last row that is not 0, 0, 0, 1.
    """
    there = {c.name: c.header for c in columns}
    names = next((m for m in HOMOGENEOUS if set(list(m)[:9]) <= set(there)), None)
    if read.rotation != "matrix" or names is None:
        return columns
    first = next(iter(names))
    low = int(first[1:2])
    last = {f"{first[0]}{low + 3}{low + j}": float(j == 3) for j in range(4)}
    for name, wanted in last.items():
        with np.errstate(invalid="ignore"):
            values = table.numbers.get(there.get(name, ""), np.array([]))
            bad = np.flatnonzero(np.abs(values - wanted) > 1e-9)
        if bad.size:
            raise BadInput(f"the last row of the matrix is not 0, 0, 0, 1 in row {bad[0] + 1}",
                           table.at(name, int(bad[0])), "Check that the columns are row by row")
    others = set(there) - set(names) - set(last)
    mine = {h: own for h, own in names.items()
            if h in there and h not in read.columns.values() and own not in others}
    return [c if (own := mine.get(c.name)) is None else
            replace(c, called=own, name=own, shown=own) for c in columns if c.name not in last]


def _renamed(columns: Columns, read: ReadFile, known: Collection[str], source: str, side: str
             ) -> list[HeaderColumn]:
    """Return the columns under the names that the sidecar gives, without those to be left alone.

    Raises:
        BadInput: a header that the file does not have, a column that nobody knows, or two
            headers for one column.
    """
    place, there = f"{side}: read.columns", [c.name for c in columns]
    for own, header in read.columns.items():
        if header not in there:
            raise BadInput(f"{source} has no column '{header}'", f"{place}.{own}",
                           f"Its columns are {', '.join(there)}.{did_you_mean(header, there)}")
        if own not in known and not own.startswith("temperature_"):
            raise unknown("column", own, known, place)
    names = {header: own for own, header in read.columns.items()}
    if len(names) < len(read.columns):
        twice = next(h for h in names if list(read.columns.values()).count(h) > 1)
        raise BadInput(f"the column '{twice}' is given for two of ours", place,
                       "Give each column once")
    for name in read.ignore:
        if name not in there:
            raise BadInput(f"{source} has no column '{name}'", f"{side}: read.ignore",
                           f"Remove it there.{did_you_mean(name, there)}")
    for h in there:
        if h not in read.ignore and h not in names and h in read.columns:
            raise BadInput(f"'{read.columns[h]}' and '{h}' both are {h}", f"{place}.{h}",
                           f"Say what the file's own {h} is, or write `ignore: [{h}]`")
    return [replace(c, name=names.get(c.name, c.name)) for c in columns
            if c.name not in read.ignore]


def declared(columns: Columns, table: Table, read: ReadFile, side: str) -> list[HeaderColumn]:
    """Return the columns with the units and signs that the sidecar's block gives them.

    In the order of these units; ``table`` has the columns under our own names.

    Raises:
        BadInput: header and sidecar name two units for one column, a pattern of no column or of
            words, or two for one column.
    """
    headed = {c.name: c.unit for c in columns if c.unit}
    for name, unit in list(headed.items()):
        pattern = next((p for p in read.units if fnmatchcase(name, p)), None)
        if pattern is not None and read.units[pattern] != unit:
            raise BadInput(f"the sidecar says that {name} is in {read.units[pattern]}, the "
                           f"header that it is in {unit}", f"{side}: read.units.{pattern}",
                           "Correct the one that is wrong")
        if pattern is not None:
            del headed[name]
    signs = _by_column(table, read.signs, f"{side}: read.signs")
    units = _by_column(table, {**read.units, **headed}, f"{side}: read.units")
    out, rank = list[HeaderColumn](), {name: i for i, name in enumerate(units)}
    for c in sorted(columns, key=lambda c: rank.get(c.name, len(rank))):
        pattern, unit = units.get(c.name, ("", ""))
        out.append(replace(c, unit=unit, sign=signs.get(c.name, ("", 1))[1], place=(
            f"{table.source}: header, column {c.name}" if c.unit
            else f"{side}: read.units.{pattern}")))
    return out


def _by_column(table: Table, declared: Mapping[str, T], place: str) -> dict[str, tuple[str, T]]:
    """Return what is declared for columns and patterns, by column: the pattern and its value."""
    out: dict[str, tuple[str, T]] = {}
    for pattern, value in declared.items():
        names = [n for n in table.header if fnmatchcase(n, pattern)]
        if not names:
            raise BadInput(f"no column is called '{pattern}'", f"{place}.{pattern}", "The columns "
                           f"are {', '.join(table.header)}.{did_you_mean(pattern, table.header)}")
        for name in names:
            if name in table.text:
                raise BadInput(f"the column '{name}' holds words", f"{place}.{pattern}",
                               "Remove the line")
        for name in names:
            if name in out:
                first, one = out[name]
                raise BadInput(f"the column {name} is declared twice, by '{first}' ({one}) and by "
                               f"'{pattern}' ({value})", f"{place}.{pattern}",
                               "Leave one of the two, or name the columns one by one")
            out[name] = (pattern, value)
    return out


def unit_of(name: str, read: ReadFile, side: str) -> str | None:
    """Return the unit that the block declares for a column, None where it says nothing.

    Raises:
        BadInput: two patterns name it.
    """
    said = [p for p in read.units if fnmatchcase(name, p)]
    if len(said) > 1:
        raise BadInput(f"the column {name} is declared twice, by '{said[0]}' and by '{said[1]}'",
                       f"{side}: read.units.{said[1]}", "Leave one of the two")
    return read.units[said[0]] if said else None
