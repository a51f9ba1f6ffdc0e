"""The columns of a measurement file in SI: joints, commanded and measured poses, conditions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.column_names import ENVIRONMENT, tension_columns
from ppmcal.io.csv import Table, refuse_absurd
from ppmcal.io.pose_fields import COORDINATES, NORM_TOLERANCE, QUATERNION, factors, rotation_vectors
from ppmcal.linalg import Array
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units
from ppmcal.wording import row_list

NOT_MOVED = 1e-12


def stacked(table: Table, names: Sequence[str]) -> Array:
    """Return columns side by side (N, len(names)), nan where the file has none."""
    out = np.full((len(table), len(names)), np.nan)
    for i, name in enumerate(names):
        if name in table.numbers:
            out[:, i] = table.numbers[name]
    return out


def poses(table: Table, mechanism: Mechanism, units: Units, prefix: str = "") -> Array:
    """Return poses (N, 6) in SI: nan where left empty, 0 where the machine cannot move.

    Raises:
        BadInput: a coordinate that the machine does not have, other than 0.
    """
    out = stacked(table, [f"{prefix}{c}" for c in COORDINATES]) * factors(units)
    out[:, 3:] = rotations(table, units.factor("angle"), prefix)[0]
    for i, name in enumerate(COORDINATES):
        if i in mechanism.dof:
            continue
        moved = np.flatnonzero(np.abs(np.nan_to_num(out[:, i])) > NOT_MOVED)
        if moved.size:
            own = prefix + (name if f"{prefix}{name}" in table.header else QUATERNION[i - 3])
            raise BadInput(f"a {mechanism.motion} machine has no coordinate {name} "
                           f"({row_list(moved)})", table.at(own, int(moved[0])),
                           "Remove the column; a pose here is "
                           f"{', '.join(prefix + c for c in mechanism.coordinates)}")
        out[:, i] = 0.0
    return out


def rotations(table: Table, angle: float, prefix: str = "") -> tuple[Array, bool]:
    """Return rotation vectors (N, 3), rad, nan where not given; and whether any column is.

    Quaternions must have length 1 within 1e-3 and are normalised.

    Raises:
        BadInput: rotation given twice, an incomplete quaternion, or rows off the norm.
    """
    vector = [f"{prefix}{c}" for c in COORDINATES[3:] if f"{prefix}{c}" in table.header]
    quaternion = [f"{prefix}{c}" for c in QUATERNION if f"{prefix}{c}" in table.header]
    if vector and quaternion:
        raise BadInput(f"the rotation is given twice, as {vector[0]} and as {quaternion[0]}",
                       f"{table.source}: header", "Remove one of the two")
    if not quaternion:
        return stacked(table, [f"{prefix}{c}" for c in COORDINATES[3:]]) * angle, bool(vector)
    if len(quaternion) < 4:
        raise BadInput(f"the quaternion has only {', '.join(quaternion)}",
                       f"{table.source}: header", "Give the four columns "
                       f"{', '.join(prefix + c for c in QUATERNION)}")
    q = stacked(table, quaternion)
    norm = np.sqrt(np.sum(q * q, axis=1))
    bad = np.flatnonzero(np.abs(norm - 1.0) > NORM_TOLERANCE)
    if bad.size:
        raise BadInput(f"the quaternion does not have length 1 in {row_list(bad)} "
                       f"(row {bad[0] + 1}: {norm[bad[0]]:.6g})",
                       table.at(quaternion[0], int(bad[0])),
                       "Check the order x, y, z, w and the digits")
    return rotation_vectors(q / norm[:, None]), True


def joint_values(table: Table, mechanism: Mechanism, units: Units, joint: Array
            ) -> tuple[Array, Array | None]:
    """Return q (N, k) and commanded poses (N, 6) or None; refuse a file without either."""
    names = [f"q_{a}" for a in mechanism.actuators]
    have = [n for n in names if n in table.header]
    commands = [c for c in table.header if c.startswith("cmd_")]
    if not commands and len(have) < len(names):
        missing = [n for n in names if n not in have]
        raise BadInput(f"there is no column {', '.join(missing)}", f"{table.source}: header",
                       "Give the joint values of all actuators, or commanded poses (cmd_x, ...)")
    for name in have:
        _not_empty(table, name)
    q = stacked(table, names) * joint
    if not commands:
        return q, None
    if len(have) == len(names):
        raise BadInput("there are joint columns (q_...) and commanded poses (cmd_...)",
                       f"{table.source}: header", "Keep the columns that the controller used: "
                       f"remove {', '.join(commands)}, or the q_ columns")
    if have and len(have) < len(names):
        raise BadInput(f"the columns {', '.join(n for n in names if n not in have)} are missing",
                       f"{table.source}: header", "Give all joint columns, or only cmd_ columns")
    commanded = poses(table, mechanism, units, "cmd_")
    given = [mechanism.coordinates[i] for i, d in enumerate(mechanism.dof)
             if np.isfinite(commanded[:, d]).any()]
    if len(given) < mechanism.freedoms:
        lacking = [f"cmd_{c}" for c in mechanism.coordinates if c not in given]
        raise BadInput(f"the commanded pose lacks {', '.join(lacking)}", f"{table.source}: header",
                       f"A pose of this machine needs {mechanism.freedoms} of "
                       f"{', '.join('cmd_' + c for c in mechanism.coordinates)}")
    return q, commanded


def _not_empty(table: Table, name: str) -> None:
    if not np.isfinite(table.numbers[name]).any():
        raise BadInput("all values of the column are missing", table.at(name),
                       "Fill it in, or remove the column")


def second_joints(table: Table, mechanism: Mechanism, joint: Array, kind: InstrumentKind
                  ) -> Array | None:
    """Return the joint values (N, k) at the other end of a distance, None where there is none."""
    names = [f"to_q_{a}" for a in mechanism.actuators]
    have = [n for n in names if n in table.header]
    if not have or not kind.along_line:
        return None
    if len(have) < len(names):
        raise BadInput(f"the columns {', '.join(n for n in names if n not in have)} are missing",
                       f"{table.source}: header",
                       "Give the second position's joint values of all actuators")
    for name in have:
        _not_empty(table, name)
    return stacked(table, names) * joint


def further_columns(table: Table, mechanism: Mechanism, joint: Array) -> dict[str, Array]:
    """Return the columns of the environment in SI: directions, velocities, temperature (K) ..."""
    factor = {f"vel_{a}": joint[i] for i, a in enumerate(mechanism.actuators)}
    factor |= dict.fromkeys(tension_columns(mechanism), 1.0)
    directions = {f"dir_{a}" for a in (*mechanism.actuators, "x", "y", "z")}
    out: dict[str, Array] = {}
    for name in table.header:
        warm = name == "temperature" or name.startswith("temperature_")
        mine = warm or name in directions or name in factor or name in ENVIRONMENT
        if not mine or name not in table.numbers:
            continue
        values = table.numbers[name]
        refuse_absurd({name: values}, table.source)
        if name in directions:
            bad = np.flatnonzero(np.isfinite(values) & (np.abs(values) != 1.0))
            if bad.size:
                raise BadInput(f"{values[bad[0]]:g} is not a direction of approach",
                               table.at(name, int(bad[0])), "Write 1, -1, or leave it empty")
        if name == "payload" and np.any(values < 0.0):
            raise BadInput("a payload cannot be negative",
                           table.at(name, int(np.argmax(values < 0.0))), "Write kg, 0 or more")
        out[name] = values + ZERO_CELSIUS if warm else values * factor.get(name, 1.0)
    return out
