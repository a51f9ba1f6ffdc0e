"""The header of a table, gone through once: of each column our name, unit, sign, and why so.

A unit in a header (``q_leg1 [mm]``, ``x (mm)``, ``temperature [F]``) says the same as one under
``read.units`` in the sidecar. That block, and the units that columns may be in, stand here too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field

from ppmcal.errors import BadInput, unknown
from ppmcal.io.clock import ORDERS as ORDERS_OF_DATES
from ppmcal.io.column_names import known_columns, recorders_names
from ppmcal.io.csv import Table
from ppmcal.io.schema import (
    PULSES,
    ROW_COUNT,
    SIGN,
    Label,
    Strict,
    choice,
    did_you_mean,
    refuse,
    show,
)
from ppmcal.kinematics.pose_readings import AXES, QUATERNIONS
from ppmcal.kinematics.rotations import ORDERS
from ppmcal.linalg import Array
from ppmcal.model.dataset import PAYLOADS, POUND, STANDARD_GRAVITY, ZERO_CELSIUS
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.units import ANGLES, LENGTHS, TURN

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

MATRIX = tuple(f"r{i}{j}" for i in "123" for j in "123")
HOMOGENEOUS: tuple[Mapping[str, str], ...] = tuple(
    {**{f"{letter}{i + low}{j + low}": f"r{i + 1}{j + 1}" for i in range(3) for j in range(3)},
     **{f"{letter}{i + low}{3 + low}": "xyz"[i] for i in range(3)}}
    for letter in "mtrT" for low in (0, 1))
"""Entries of 4 x 4 matrices (m00, t11, ...): header -> our column; the first nine are R's."""
ROTATIONS = ("rotvec", *QUATERNIONS, *(f"euler-{o}" for o in ORDERS), "matrix")
FURTHER: Mapping[str, Mapping[str, float]] = {
    "payload": PAYLOADS,
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "force": {"N": 1.0, "kN": 1e3, "lbf": POUND * STANDARD_GRAVITY},
    "moment": {"N m": 1.0},
}
TEMPERATURES: Mapping[str, Callable[[Array], Array]] = {
    "C": lambda t: t, "K": lambda t: t - ZERO_CELSIUS, "F": lambda t: (t - 32.0) / 1.8}
ANGULAR = {**ANGLES, "turn": TURN}
UNITS = tuple(dict.fromkeys((*LENGTHS, *ANGULAR, "counts", *TEMPERATURES, *FURTHER["payload"],
                             *FURTHER["time"], *FURTHER["force"], *FURTHER["moment"])))


def _mapping(what: str, one: Callable[[object], object]) -> BeforeValidator:
    def check(value: object) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise refuse(f"{show(value)} is not a mapping", f"Write a column and its {what}, such "
                         "as {q_leg2: ...}")
        return {str(k): one(v) for k, v in value.items()}

    return BeforeValidator(check)


def _header_name(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise refuse(f"{show(value)} is not the name of a column", "Write the file's header there")
    return str(value).strip()


def _names(value: object) -> object:
    counts = [value.count(f"{{{w}}}") for w in ("pose", "target")] if isinstance(value, str) else []
    if sum(counts) == 0 or max(counts) > 1:
        raise refuse(f"{show(value)} does not say where pose and target stand in a name",
                     "Write both once, such as `{pose}_{target}`; `{target}` alone where times "
                     "tell the pose, `{pose}` alone for one target")
    return value


class ReadFile(Strict):
    """How to read the CSV where it is not as the program has it."""

    columns: Annotated[dict[str, str], _mapping("header in the file", _header_name)] = Field(
        default_factory=dict)
    """Our column: the file's header."""
    sheet: Label | None = None
    """Sheet of a spreadsheet  [default: the first]."""
    ignore: list[Label] = Field(default_factory=list)
    """Headers of the file to leave alone."""
    units: Annotated[dict[str, str], _mapping("unit", choice("unit", *UNITS).find)] = Field(
        default_factory=dict)
    """Unit of a column (or of all that a pattern such as q_* names), if not the file's."""
    counts_per_turn: Annotated[float, BeforeValidator(PULSES)] | None = None
    """Counts in a turn of the drive, for columns in counts."""
    signs: Annotated[dict[str, int], _mapping("sign", SIGN)] = Field(default_factory=dict)
    """Sign of a column (or pattern): 1 or -1."""
    rotation: Annotated[str, choice("rotation convention", *ROTATIONS)] | None = None
    """What the rotation columns hold; Euler angles: small letters fixed axes, capitals moving."""
    pose: Annotated[str, choice("pose", "direct", "inverse")] = "direct"
    """inverse: the measuring frame seen from the platform."""
    mirror: Annotated[str, choice("axis", *AXES)] | None = None
    """An axis of the instrument that points the other way (left-handed)."""
    shift: Annotated[int, BeforeValidator(ROW_COUNT)] = 0
    """The measured columns are so many rows behind the joint columns."""
    dates: Annotated[str, choice("order of dates", *ORDERS_OF_DATES)] | None = None
    """Which comes first in a date such as 03/04/2026."""
    zone: Label | None = None
    """Zone of times that name none: UTC, +02:00, Europe/Berlin."""
    names: Annotated[str, BeforeValidator(_names)] | None = None
    """How points are named: {pose} and {target}, such as `{pose}_{target}`."""
    targets: dict[str, Any] = Field(default_factory=dict)
    """Points of the platform by the names in {target}: [x, y, z] or unknown."""
    topics: list[Label] = Field(default_factory=list)
    """Topics of a bag to read  [default: the only ones with joints and poses]."""


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
    where it is a unit, as it must be behind a name that is ``known``.

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
        raise unknown("unit", unit, UNITS, f"{place}, column {header}")
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
    # what is a column already is not what another one was meant to be
    taken = {*read.columns.values(), *read.ignore, *(n for n in there if n in known)}
    free = [n for n in there if n not in taken]
    for own, header in read.columns.items():
        if header not in there:
            raise BadInput(f"{source} has no column '{header}'", f"{place}.{own}",
                           f"Its columns are {', '.join(there)}.{did_you_mean(header, free)}")
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
                           f"Remove it there.{did_you_mean(name, free)}")
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
