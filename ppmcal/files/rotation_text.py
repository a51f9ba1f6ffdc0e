"""How tables of poses write spatial rotations: rotation vector, quaternion or Euler angles.

Euler angles stand in the columns ``euler_1, euler_2, euler_3``, in the order of the convention's
letters and in the file's angle unit. ``euler-xyz`` (small letters) turns about the fixed axes of
the base, first x, then y, then z; ``euler-XYZ`` (capitals) about the axes that turn along. All
twelve orders of each are known, also those that name one axis twice (``euler-ZYZ``).
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.arrays import known
from ppmcal.errors import BadInput, unknown
from ppmcal.files.pose_text import COORDINATES, QUATERNION
from ppmcal.files.table import Table
from ppmcal.mechanism import Mechanism

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

EULER = ("euler_1", "euler_2", "euler_3")
VECTOR = COORDINATES[3:]
ORDERS = tuple("".join(o) for letters in ("xyz", "XYZ") for o in product(letters, repeat=3)
               if o[0] != o[1] != o[2])
CONVENTIONS = ("rotvec", "quat", *(f"euler-{o}" for o in ORDERS))
GIMBAL = 1e-6
"""Gimbal lock: the second angle is within this, rad, of where the others turn about one axis."""


def check_convention(name: str, mechanism: Mechanism) -> str:
    """Return the convention's name.

    Raises:
        BadInput: there is none of that name, or the machine does not rotate in space.
    """
    if name not in CONVENTIONS:
        raise unknown("rotation convention", name, CONVENTIONS, "--rotation")
    if name != "rotvec" and mechanism.motion != "spatial":
        turn = "its rotation is rz" if mechanism.motion == "planar" else "it does not turn"
        raise BadInput(f"a {mechanism.motion} machine has no spatial rotation: {turn}",
                       "--rotation", "Leave the option out")
    return name


def columns_of(convention: str) -> tuple[str, ...]:
    """Return the names of a convention's columns."""
    if convention == "rotvec":
        return VECTOR
    return QUATERNION if convention == "quat" else EULER


def to_vector_columns(table: Table, convention: str, angle: float) -> Table:
    """Return the table with Euler angles (unit ``angle``, rad) turned into rx, ry, rz.

    Rows without any Euler angle have none of rx, ry, rz either.

    Raises:
        BadInput: rotation columns of another convention, columns missing, or a row with some
            of the three angles only.
    """
    own = columns_of(convention)
    foreign = [c for c in (*VECTOR, *QUATERNION, *EULER) if c in table.header and c not in own]
    if convention == "rotvec":
        # a quaternion says by its columns' names that it is one; Euler angles beside are repeated
        turned = any(c in table.header for c in (*VECTOR, *QUATERNION))
        foreign = [] if turned else [c for c in foreign if c in EULER]
    if foreign:
        raise BadInput(f"the column {foreign[0]} is not of the rotation convention {convention}",
                       f"{table.source}: header", f"Name the rotation columns {', '.join(own)}, or "
                       "choose another --rotation")
    have = [c for c in EULER if c in table.header]
    if own != EULER or not have:
        return table
    missing = [c for c in EULER if c not in have]
    if missing:
        raise BadInput(f"there is no column {', '.join(missing)}", f"{table.source}: header",
                       f"Give all of {', '.join(EULER)}")
    angles = np.stack([table.numbers[c] for c in EULER], axis=-1) * angle
    given = np.isfinite(angles)
    part = np.flatnonzero(given.any(axis=1) & ~given.all(axis=1))
    if part.size:
        row = int(part[0])
        empty = EULER[int(np.argmin(given[row]))]
        raise BadInput("only some of the Euler angles are given", table.at(empty, row),
                       "Give all three, or leave all three empty; to leave one coordinate of the "
                       "rotation open, write a rotation vector (--rotation rotvec)")
    vector = from_euler(angles, convention) / angle
    numbers = {k: v for k, v in table.numbers.items() if k not in EULER}
    numbers |= {name: vector[:, i] for i, name in enumerate(VECTOR)}
    names = dict(zip(EULER, VECTOR, strict=True))
    return replace(table, header=tuple(names.get(c, c) for c in table.header), numbers=numbers)


def from_euler(angles: Array, convention: str) -> Array:
    """Return rotation vectors (N, 3), rad, of Euler angles (N, 3), rad; nan rows stay nan."""
    from scipy.spatial.transform import Rotation

    out = np.full_like(angles, np.nan)
    good = known(angles)
    if good.any():
        order = convention.removeprefix("euler-")
        out[good] = Rotation.from_euler(order, angles[good]).as_rotvec()
    return out


def to_euler(vector: Array, convention: str) -> tuple[Array, Bools]:
    """Return Euler angles (N, 3), rad, of rotation vectors (N, 3), and rows in gimbal lock (N,).

    In gimbal lock only the sum or difference of the first and the third angle is known: the third
    one is 0.
    """
    from scipy.spatial.transform import Rotation

    out = np.full_like(vector, np.nan)
    good = known(vector)
    if not good.any():
        return out, good
    order: Any = convention.removeprefix("euler-")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        out[good] = Rotation.from_rotvec(vector[good]).as_euler(order)
    proper = order[0] == order[2]
    sine = np.abs(np.sin(out[:, 1]) if proper else np.cos(out[:, 1]))
    with np.errstate(invalid="ignore"):
        locked = good & (sine < GIMBAL) & (out[:, 2] == 0.0)
    return out, locked


def to_quaternion(vector: Array) -> Array:
    """Return quaternions x, y, z, w (N, 4), w >= 0, of rotation vectors (N, 3); nan stays nan."""
    from scipy.spatial.transform import Rotation

    out = np.full((len(vector), 4), np.nan)
    good = known(vector)
    if good.any():
        out[good] = Rotation.from_rotvec(vector[good]).as_quat(canonical=True)
    return out
