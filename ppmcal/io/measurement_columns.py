"""The columns of a measurement file: which there are, foreign headers, what each is in SI."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table, refuse_absurd
from ppmcal.io.pose_fields import COORDINATES, NORM_TOLERANCE, QUATERNION, factors, rotation_vectors
from ppmcal.io.schema import hint
from ppmcal.linalg import Array
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
ENVIRONMENT = ("temperature", "payload", "time", *WRENCH)
NOT_MOVED = 1e-12
MISSPELT = 0.8
"""A name so like one of ours (difflib's ratio) is taken for a mistake in writing it."""
LABELS = ("pose", "session", "time")
"""Columns that may hold words: names, and times of a clock."""
OURS = ("q_", "to_q_", "dir_", "vel_", "cmd_", "sigma_", "temperature_", "leg_length_")
"""What columns of ours begin with: a name that does is meant to be one."""
_HEXAPOD = {"x1": "x", "y1": "y", "z1": "z", "phix1": "rx", "phiy1": "ry", "phiz1": "rz"}
_CAPTURE = {**{f"position_{a}": a for a in "xyz"},
            **{f"orientation_{a}": f"quat_{a}" for a in "xyzw"}}


def known_columns(mechanism: Mechanism) -> list[str]:
    """Return every column name that a measurement file of this machine may have."""
    actuators = mechanism.actuators
    out = ["pose", "session", *(f"q_{a}" for a in actuators), *COORDINATES, *QUATERNION,
           "height", "distance", *ENVIRONMENT, *(f"to_q_{a}" for a in actuators),
           *(f"dir_{a}" for a in (*actuators, "x", "y", "z")),
           *(f"vel_{a}" for a in actuators), *(f"cmd_{c}" for c in (*COORDINATES, *QUATERNION)),
           *(f"sigma_{c}" for c in (*COORDINATES, "position", "rotation", "height", "distance"))]
    return list(dict.fromkeys(out))


def check_columns(table: Table, mechanism: Mechanism) -> None:
    """Refuse a column that nobody knows, with the nearest match."""
    known = known_columns(mechanism)
    for name in table.header:
        if name not in known and not name.startswith("temperature_"):
            raise BadInput(f"unknown column '{name}'", f"{table.source}: header",
                           f"Rename or remove it; the actuators are "
                           f"{', '.join(mechanism.actuators)}."
                           f"{hint(name, known)}")


def is_nobodys(name: str, known: Collection[str]) -> bool:
    """Whether a column is none of ours, and none that was perhaps meant to be.

    Args:
        name: without its unit.
        known: names of our columns.
    """
    return not (name in known or name.startswith(OURS)
                or get_close_matches(name, known, 1, MISSPELT))


def without_strangers(table: Table, mechanism: Mechanism, known: Collection[str]
                      ) -> tuple[Table, list[str]]:
    """Return the table without the columns that nobody needs, and that they are left alone.

    Args:
        table: under our own names, but for these.
        mechanism: the machine.
        known: names of our columns for it, and of what they are made of.

    Raises:
        BadInput: a column that was perhaps meant to be one of ours, or words where it has numbers.
    """
    check_columns(replace(table, header=tuple(h for h in table.header if h not in known
                                              and not is_nobodys(h, known))), mechanism)
    strange = [h for h in table.header if is_nobodys(h, known)]
    for name in set(table.text) - {*strange, *LABELS}:
        row = next((i for i, c in enumerate(table.text[name]) if not _is_number(c)), 0)
        raise BadInput(f"'{table.text[name][row]}' is not a number", table.at(name, row),
                       "Correct the cell, or leave it empty")
    if not strange:
        return table, []
    left = replace(table, header=tuple(h for h in table.header if h not in strange),
                   numbers={h: v for h, v in table.numbers.items() if h not in strange},
                   text={h: v for h, v in table.text.items() if h not in strange})
    names, one = ", ".join(strange), len(strange) == 1
    ignore = ", ".join(n if n.isidentifier() else f'"{n}"' for n in strange)
    return left, [f"{table.source}: column{'s' * (not one)} {names}: not used, nobody knows "
                  f"{'it' if one else 'them'}. `read: {{ignore: [{ignore}]}}` in the sidecar says "
                  "that this is meant"]


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def ambiguous_directions(table: Table, mechanism: Mechanism) -> list[str]:
    """Return what to say of directions that are a joint's and the platform's by their name.

    Raises:
        BadInput: not all joints have theirs, so that these may be the platform's.
    """
    joints = [f"dir_{a}" for a in mechanism.actuators]
    both = [f"dir_{c}" for c in "xyz" if f"dir_{c}" in joints and f"dir_{c}" in table.header]
    if not both:
        return []
    names = ", ".join(both)
    if not set(joints) <= set(table.header):
        own = both[0].removeprefix("dir_")
        raise BadInput(
            f"{names}: the platform's direction of approach, or that of the joint of this name?",
            f"{table.source}: header",
            f"Give the direction of every joint ({', '.join(joints)}); or, if it is the "
            f"platform's, call the actuator otherwise in the mechanism file, such as joint_{own}, "
            f"and write `read: {{columns: {{q_joint_{own}: q_{own}}}}}` into the sidecar")
    return [f"{table.source}: {names} are taken for the directions of the joints called so, not "
            "for the platform's."]


def translate_foreign(table: Table, mechanism: Mechanism) -> tuple[Table, list[str]]:
    """Return the table under our own column names, where its header is a known foreign one.

    ``x1,y1,z1,phix1,phiy1,phiz1`` with joint names ([LIN]'s hexapods), and
    ``leg_length_1.., position_x.., orientation_x..w`` (motion capture of a Stewart platform);
    ``leg_length_i`` belongs to the i-th actuator.
    """
    header, names = set(table.header), dict[str, str]()
    actuators, findings = mechanism.actuators, list[str]()
    if set(_HEXAPOD) <= header:
        names = dict(_HEXAPOD)
        own = set(known_columns(mechanism))
        joints = [c for c in table.header if c not in names and (c in actuators or (
            c not in own and not c.startswith("temperature_")))]
        if not set(actuators) <= set(joints) and len(joints) == len(actuators):
            findings.append(f"{table.source}: header: the joint columns {', '.join(joints)} are "
                            f"taken in order for the actuators {', '.join(actuators)}.")
            names.update({c: f"q_{a}" for c, a in zip(joints, actuators, strict=True)})
        else:
            names.update({c: f"q_{c}" for c in joints if c in actuators})
    elif "leg_length_1" in header:
        names = {c: own for c, own in _CAPTURE.items() if c in header}
        count = sum(c.startswith("leg_length_") for c in header)
        if count != len(actuators):
            raise BadInput(f"there are {count} leg_length columns, but the mechanism has "
                           f"{len(actuators)} actuators", f"{table.source}: header",
                           "Give one column for each actuator, leg_length_1 first")
        names.update({f"leg_length_{i + 1}": f"q_{a}" for i, a in enumerate(actuators)})
    if not names:
        return table, findings
    renamed = tuple(names.get(c, c) for c in table.header)
    for i, name in enumerate(renamed):
        if name in renamed[:i]:
            raise BadInput(f"the columns '{table.header[renamed.index(name)]}' and "
                           f"'{table.header[i]}' both mean {name}", f"{table.source}: header",
                           "Remove one of them")
    return replace(table, header=renamed,
                   numbers={names.get(c, c): v for c, v in table.numbers.items()},
                   text={names.get(c, c): v for c, v in table.text.items()}), findings


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


def row_list(indices: Array | NDArray[np.int64], most: int = 5) -> str:
    """Return ``rows 3, 7, 9 (+12 more)`` for row indices counted from 0."""
    shown = ", ".join(str(int(i) + 1) for i in indices[:most])
    more = f" (+{len(indices) - most} more)" if len(indices) > most else ""
    return f"row{'s' if len(indices) > 1 else ''} {shown}{more}"


def further_columns(table: Table, mechanism: Mechanism, joint: Array) -> dict[str, Array]:
    """Return the columns of the environment in SI: directions, velocities, temperature (K) ..."""
    factor = {f"vel_{a}": joint[i] for i, a in enumerate(mechanism.actuators)}
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
