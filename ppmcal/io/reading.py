"""The sidecar's block ``read``: how the CSV is to be read where it is not as section 2 has it.

Everything is done on the table before anything else looks at it, in this order: columns, signs,
units, convention of rotations, mirrored axis, inverse pose. Only the shift of rows waits until
the rows have their numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import TypeVar

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.io.csv import Table
from ppmcal.io.measurement_columns import known_columns
from ppmcal.io.pose_fields import QUATERNION
from ppmcal.io.read_block import ANGULAR, FURTHER, HOMOGENEOUS, MATRIX, TEMPERATURES, ReadFile
from ppmcal.io.schema import hint
from ppmcal.kinematics.pose_readings import (
    AXES,
    QUATERNIONS,
    TURNS,
    inverse_pose,
    mirrored,
    understood,
)
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import LENGTHS, TURN, Units

T = TypeVar("T")


def renamed(table: Table, read: ReadFile, mechanism: Mechanism, side: str) -> Table:
    """Return the table under our own names, without the columns to be left alone.

    Raises:
        BadInput: a header that the file does not have, a column that nobody knows, or two
            headers for one column.
    """
    place = f"{side}: read.columns"
    known = [*known_columns(mechanism), *MATRIX]
    for own, header in read.columns.items():
        if header not in table.header:
            raise BadInput(f"{table.source} has no column '{header}'", f"{place}.{own}",
                           f"Its columns are {', '.join(table.header)}."
                           f"{hint(header, table.header)}")
        if own not in known and not own.startswith("temperature_"):
            raise unknown("column", own, known, place)
    names = {header: own for own, header in read.columns.items()}
    if len(names) < len(read.columns):
        twice = next(h for h in names if list(read.columns.values()).count(h) > 1)
        raise BadInput(f"the column '{twice}' is given for two of ours", place,
                       "Give each column once")
    left = set(read.ignore)
    for name in left - set(table.header):
        raise BadInput(f"{table.source} has no column '{name}'", f"{side}: read.ignore",
                       f"Remove it there.{hint(name, table.header)}")
    kept = [names.get(h, h) for h in table.header if h not in left]
    for h in table.header:
        if h not in left and h not in names and h in read.columns:
            raise BadInput(f"'{read.columns[h]}' and '{h}' both are {h}", f"{place}.{h}",
                           f"Say what the file's own {h} is, or write `ignore: [{h}]`")
    return replace(table, header=tuple(kept),
                   numbers={names.get(h, h): v for h, v in table.numbers.items() if h not in left},
                   text={names.get(h, h): v for h, v in table.text.items() if h not in left})


def of_homogeneous(table: Table, read: ReadFile) -> Table:
    """Return the table with the entries of matrices (m00 ... m23, t14 ...) under our own names.

    Raises:
        BadInput: a last row that is not 0, 0, 0, 1.
    """
    if read.rotation != "matrix":
        return table
    names = next((m for m in HOMOGENEOUS if set(list(m)[:9]) <= set(table.header)), None)
    if names is None:
        return table
    first = next(iter(names))
    low = int(first[1:2])
    last = [f"{first[0]}{low + 3}{low + j}" for j in range(4)]
    for name, wanted in zip(last, (0.0, 0.0, 0.0, 1.0), strict=True):
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(np.abs(table.numbers.get(name, np.array([])) - wanted) > 1e-9)
        if bad.size:
            raise BadInput(f"the last row of the matrix is not 0, 0, 0, 1 in row {bad[0] + 1}",
                           table.at(name, int(bad[0])), "Check that the columns are row by row")
    others = set(table.header) - set(names) - set(last)
    mine = {h: own for h, own in names.items()
            if h in table.header and h not in read.columns.values() and own not in others}
    kept = [h for h in table.header if h not in last]
    return replace(table, header=tuple(mine.get(h, h) for h in kept),
                   numbers={mine.get(h, h): v for h, v in table.numbers.items() if h in kept},
                   text={h: c for h, c in table.text.items() if h in kept})


def as_declared(table: Table, read: ReadFile, mechanism: Mechanism, units: Units, side: str,
                headed: Collection[str] = (), done: Collection[str] = ()) -> Table:
    """Return the table in the units, axes and conventions of section 2.

    The units of the columns ``headed`` stand in the header, not in the sidecar; those of the
    columns ``done`` have been dealt with.

    Raises:
        BadInput: a column that the file does not have, a unit that it cannot be in, or rotation
            columns that a convention lacks.
    """
    numbers = dict(table.numbers)
    for name, (_, sign) in _by_column(table, read.signs, f"{side}: read.signs").items():
        numbers[name] = sign * numbers[name]
    for name, (pattern, unit) in _by_column(table, read.units, f"{side}: read.units").items():
        if name not in done:
            place = (f"{table.source}: header, column {name}" if name in headed
                     else f"{side}: read.units.{pattern}")
            numbers[name] = _in_declared(numbers[name], name, unit, read, mechanism, units, place)
    table = replace(table, numbers=numbers)
    if read.rotation not in (None, "rotvec"):
        table = _as_vectors(table, str(read.rotation), mechanism, units.factor("angle"), side)
    if read.mirror or read.pose == "inverse":
        table = _seen_right(table, read, mechanism, units.factor("angle"), side)
    return table


def _by_column(table: Table, declared: Mapping[str, T], place: str) -> dict[str, tuple[str, T]]:
    """Return what is declared for columns and patterns, by column: the pattern and its value.

    Raises:
        BadInput: a pattern of no column or of words, or two for one column.
    """
    out: dict[str, tuple[str, T]] = {}
    for pattern, value in declared.items():
        for name in _matching(table, pattern, place):
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


def _matching(table: Table, pattern: str, place: str) -> list[str]:
    names = [n for n in table.header if fnmatchcase(n, pattern)]
    if not names:
        raise BadInput(f"no column is called '{pattern}'", f"{place}.{pattern}",
                       f"The columns are {', '.join(table.header)}.{hint(pattern, table.header)}")
    for name in names:
        if name in table.text:
            raise BadInput(f"the column '{name}' holds words", f"{place}.{pattern}",
                           "Remove the line")
    return names


def _in_declared(values: Array, name: str, unit: str, read: ReadFile, mechanism: Mechanism,
                 units: Units, place: str) -> Array:
    """Return a column's numbers in the unit that the file declares for it."""
    if name == "temperature" or name.startswith("temperature_"):
        _allowed(unit, TEMPERATURES, name, place)
        return TEMPERATURES[unit](values)
    known, declared = _choices(name, mechanism, units)
    if unit == "counts" and known is not LENGTHS:
        if read.counts_per_turn is None:
            raise BadInput("counts of what? The counts in a turn are missing", place,
                           "Write `counts_per_turn: 4096` beside it, with your own number")
        return np.asarray(values / read.counts_per_turn * TURN / declared)
    _allowed(unit, known, name, place)
    return np.asarray(values * (known[unit] / declared))


def _choices(name: str, mechanism: Mechanism, units: Units) -> tuple[Mapping[str, float], float]:
    """Return the units that a column may be in, SI, and the one that it is declared in."""
    for a, quantity, bare in zip(mechanism.actuators, mechanism.actuator_quantity,
                                 mechanism.actuator_has_ratio, strict=True):
        if name in (f"q_{a}", f"to_q_{a}", f"vel_{a}"):
            if bare:
                return ANGULAR, TURN
            return (LENGTHS if quantity == "length" else ANGULAR), units.factor(quantity)
    bare_name = name.removeprefix("cmd_").removeprefix("sigma_")
    if bare_name in (*TURNS, "rotation", "wx", "wy", "wz") or name.startswith("euler_"):
        return ANGULAR, units.factor("angle")
    if bare_name in (*AXES, "height", "distance", "position", "vx", "vy", "vz"):
        return LENGTHS, units.factor("length")
    kind = {"payload": "payload", "time": "time", **dict.fromkeys(("fx", "fy", "fz"), "force"),
            **dict.fromkeys(("mx", "my", "mz"), "moment")}
    return FURTHER.get(kind.get(name, ""), {}), 1.0


def declared_unit(name: str, mechanism: Mechanism, units: Units) -> str:
    """Return the unit of a column for which nobody names another; empty for a bare number."""
    if name == "temperature" or name.startswith("temperature_"):
        return "C"
    known, factor = _choices(name, mechanism, units)
    if known is LENGTHS:
        return units.length
    if known is ANGULAR:
        return units.angle if factor == units.factor("angle") else ""
    return next((u for u, f in known.items() if f == 1.0), "")


def _allowed(unit: str, allowed: Mapping[str, object], name: str, place: str) -> None:
    if unit not in allowed:
        raise BadInput(f"{name} cannot be in {unit}", place,
                       f"Write {' or '.join(allowed)}" if allowed else "Remove the line")


def _as_vectors(table: Table, convention: str, mechanism: Mechanism, angle: float, side: str
                ) -> Table:
    """Return the table with rotation vectors in place of what a convention writes."""
    place = f"{side}: read.rotation"
    if mechanism.motion != "spatial":
        raise BadInput(f"a {mechanism.motion} machine has no spatial rotation", place,
                       "Remove the line")
    own = (QUATERNION if convention in QUATERNIONS else MATRIX if convention == "matrix"
           else TURNS)
    lacking = [c for c in own if c not in table.numbers]
    if lacking:
        raise BadInput(f"{convention} needs the columns {', '.join(own)}; missing: "
                       f"{', '.join(lacking)}", place, "Name them under `columns`, or correct the "
                       "convention")
    raw = np.stack([table.numbers[c] for c in own], axis=-1)
    vectors = understood(raw * angle if own is TURNS else raw, convention) / angle
    if convention == "matrix":
        _refuse_no_rotation(raw, table, place)
    return _with_columns(table, dict(zip(TURNS, vectors.T, strict=True)), own)


def _refuse_no_rotation(raw: Array, table: Table, place: str) -> None:
    whole = finite_rows(raw)
    matrices = raw.reshape(-1, 3, 3)
    off = np.abs(matrices @ np.swapaxes(matrices, 1, 2) - np.eye(3)).max(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        bad = np.flatnonzero(whole & ((off > 1e-3) | (np.linalg.det(np.where(
            whole[:, None, None], matrices, 0.0)) < 0.0)))
    if bad.size:
        left = off[bad[0]] <= 1e-3
        raise BadInput(f"the matrix in row {bad[0] + 1} is not a rotation: "
                       + ("it is left-handed (its determinant is negative)" if left else
                          f"R R^T is {off[bad[0]]:.2g} from the unit matrix"),
                       f"{table.source}: row {bad[0] + 1}", "Check the order of the columns (row "
                       f"by row) and the digits; see {place}")


def _with_columns(table: Table, new: Mapping[str, Array], old: tuple[str, ...]) -> Table:
    gone = set(old) | set(new)
    kept = [h for h in table.header if h not in gone]
    return replace(table, header=(*kept, *new),
                   numbers={**{h: v for h, v in table.numbers.items() if h not in gone}, **new})


def _seen_right(table: Table, read: ReadFile, mechanism: Mechanism, angle: float, side: str
                ) -> Table:
    """Return the table with its measured poses turned round, or their axis the right way."""
    planar = mechanism.motion == "planar"
    key = "read.pose" if read.pose == "inverse" else "read.mirror"
    if any(c in table.header for c in QUATERNION):
        raise BadInput("quaternions are turned round as rotations of a convention", f"{side}: "
                       f"{key}", "Write `rotation: quat-xyzw` beside it")
    if planar and read.mirror == "z":
        raise BadInput("in the plane only x or y can be mirrored", f"{side}: read.mirror",
                       "Write x or y")
    needed = ("x", "y", "rz") if planar else (*AXES, *TURNS)
    lacking = [c for c in needed if c not in table.numbers]
    if read.pose == "inverse" and lacking:
        raise BadInput(f"an inverse pose needs {', '.join(needed)}; missing: "
                       f"{', '.join(lacking)}", f"{side}: read.pose", "Remove the line")
    blank = np.full(len(table), np.nan)
    position, turn = (np.stack([table.numbers.get(c, blank) for c in names], axis=-1)
                      for names in (AXES, TURNS))
    turn = turn * angle
    if read.mirror:
        position, turn = mirrored(position, turn, read.mirror)
    if read.pose == "inverse":
        position, turn = inverse_pose(position, turn, planar)
    new = {**dict(zip(AXES, position.T, strict=True)),
           **dict(zip(TURNS, (turn / angle).T, strict=True))}
    return _with_columns(table, {c: v for c, v in new.items() if c in table.numbers}, ())
