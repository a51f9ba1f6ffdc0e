"""Columns in the units, axes and conventions that the program works with.

Everything is done on the table before anything else looks at it, in this order: signs, units,
convention of rotations, mirrored axis, inverse pose. Only the shift of rows waits until the rows
have their numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.header import (
    ANGULAR,
    FURTHER,
    MATRIX,
    TEMPERATURES,
    Columns,
    ReadFile,
    bare_columns,
    bare_name,
    declared,
    named,
)
from ppmcal.io.pose_fields import QUATERNION
from ppmcal.kinematics.pose_readings import (
    AXES,
    QUATERNIONS,
    TURNS,
    inverse_pose,
    mirrored,
    understood,
)
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.instruments import InstrumentKind, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import LENGTHS, TURN, Units


def in_units(table: Table, columns: Columns, read: ReadFile, mechanism: Mechanism, units: Units,
             kind: InstrumentKind | None = None) -> Table:
    """Return a table under our own names with its signs put right, and in the file's units.

    ``kind``: of the instrument, where its columns are there.

    Raises:
        BadInput: a unit that a column cannot be in.
    """
    numbers = dict(table.numbers)
    for c in columns:
        if c.sign != 1:
            numbers[c.name] = c.sign * numbers[c.name]
        if c.unit:
            numbers[c.name] = _in_declared(numbers[c.name], c.name, c.unit, read, mechanism, units,
                                           c.place, kind)
    return replace(table, numbers=numbers)


def in_own_units(table: Table, mechanism: Mechanism, known: Callable[[str], bool]) -> Table:
    """Return a table without a sidecar in the mechanism file's units, with bare names.

    ``known`` says of a name whether it is one of our columns; others stay as they are.

    Raises:
        BadInput: an unknown unit, counts, one that the column cannot be in, or two columns of one
            name.
    """
    read = ReadFile.model_construct(ignore=[h for h in table.header if not known(bare_name(h))])
    mine = {bare_name(h) for h in table.header} - set(read.ignore)
    columns = bare_columns(table, read, mine)
    for c in columns:
        if c.unit == "counts":
            raise BadInput(f"{c.name} is in counts, and how many make a turn is not known",
                           f"{table.source}: header, column {c.name}", "Give it in turns or deg")
    table = named(table, columns)
    return in_units(table, declared(columns, table, read, table.source), read, mechanism,
                    mechanism.units)


def in_conventions(table: Table, read: ReadFile, mechanism: Mechanism, units: Units, side: str
                   ) -> Table:
    """Return a table in the file's units in the axes and conventions of section 2.

    Raises:
        BadInput: rotation columns that a convention lacks, or what a machine has no use for.
    """
    if read.rotation not in (None, "rotvec"):
        table = _as_vectors(table, str(read.rotation), mechanism, units.factor("angle"), side)
    if read.mirror or read.pose == "inverse":
        table = _seen_right(table, read, mechanism, units.factor("angle"), side)
    return table


def _in_declared(values: Array, name: str, unit: str, read: ReadFile, mechanism: Mechanism,
                 units: Units, place: str, kind: InstrumentKind | None) -> Array:
    """Return a column's numbers in the unit that the file declares for it."""
    if name == "temperature" or name.startswith("temperature_"):
        _allowed(unit, TEMPERATURES, name, place)
        return TEMPERATURES[unit](values)
    known, declared = _choices(name, mechanism, units, kind)
    if unit == "counts" and known is not LENGTHS:
        if read.counts_per_turn is None:
            raise BadInput("counts of what? The counts in a turn are missing", place,
                           "Write `counts_per_turn: 4096` beside it, with your own number")
        return np.asarray(values / read.counts_per_turn * TURN / declared)
    _allowed(unit, known, name, place)
    return np.asarray(values * (known[unit] / declared))


def _choices(name: str, mechanism: Mechanism, units: Units, kind: InstrumentKind | None = None
             ) -> tuple[Mapping[str, float], float]:
    """Return the units that a column may be in, SI, and the one that it is declared in."""
    for a, quantity, bare in zip(mechanism.actuators, mechanism.actuator_quantity,
                                 mechanism.actuator_has_ratio, strict=True):
        if name in (f"q_{a}", f"to_q_{a}", f"vel_{a}"):
            if bare:
                return ANGULAR, TURN
            return (LENGTHS if quantity == "length" else ANGULAR), units.factor(quantity)
    bare_name = name.removeprefix("cmd_").removeprefix("sigma_").removeprefix("u95_")
    if kind is not None and not kind.of_poses and bare_name in kind.columns(mechanism.motion):
        own = kind.quantity if kind.scalar else "angle"
        return (LENGTHS if own == "length" else ANGULAR), units.factor(own)
    if bare_name in (*TURNS, "rotation", "wx", "wy", "wz") or name.startswith("euler_"):
        return ANGULAR, units.factor("angle")
    if bare_name in (*AXES, *number_names(), "position", "vx", "vy", "vz"):
        return LENGTHS, units.factor("length")
    further = {"payload": "payload", "time": "time", **dict.fromkeys(("fx", "fy", "fz"), "force"),
            **dict.fromkeys(("mx", "my", "mz"), "moment")}
    return FURTHER.get(further.get(name, ""), {}), 1.0


def declared_unit(name: str, mechanism: Mechanism, units: Units,
                  kind: InstrumentKind | None = None) -> str:
    """Return the unit of a column for which nobody names another; empty for a bare number."""
    if name == "temperature" or name.startswith("temperature_"):
        return "C"
    known, factor = _choices(name, mechanism, units, kind)
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
    if not mechanism.motion.measures_rotation_vectors:
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
    return table.without((*own, *TURNS)).put(dict(zip(TURNS, vectors.T, strict=True)))


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


def _seen_right(table: Table, read: ReadFile, mechanism: Mechanism, angle: float, side: str
                ) -> Table:
    """Return the table with its measured poses turned round, or their axis the right way."""
    planar = mechanism.motion.planar
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
    new = {c: v for c, v in new.items() if c in table.numbers}
    return table.without(new).put(new)
