"""Poses as files write them: ``x, y, rz``, ``x, y, z`` or ``x, y, z`` with a rotation.

A full pose is (6,): x, y, z in m and the rotation vector rx, ry, rz in rad, from platform to
base. Coordinates that a machine does not have are 0; ones left empty are nan.

Tables write spatial rotations as a rotation vector, a quaternion or Euler angles. These stand in
the columns ``euler_1, euler_2, euler_3``, in the order of the convention's letters
(:mod:`ppmcal.kinematics.rotations`) and in the file's angle unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.io.csv import Table
from ppmcal.io.schema import Number as _Number
from ppmcal.io.schema import Strict, check
from ppmcal.kinematics.rotations import CONVENTIONS
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units, coordinate_quantity, to_file

COORDINATES = ("x", "y", "z", "rx", "ry", "rz")
QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")
EULER = ("euler_1", "euler_2", "euler_3")
VECTOR = COORDINATES[3:]
CORRELATIONS = {f"rho_{a}_{b}": (i, j) for i, a in enumerate(COORDINATES)
                for j, b in enumerate(COORDINATES) if i < j}
"""Columns of a row's correlations of the noise of two coordinates, and which these are."""
NORM_TOLERANCE = 1e-3


class PoseFile(Strict):
    """The mapping of a pose; which keys are needed depends on the motion."""

    x: _Number | None = None
    """Position along x, unit of length."""
    y: _Number | None = None
    """Position along y, unit of length."""
    z: _Number | None = None
    """Position along z, unit of length; not in the plane."""
    rx: _Number | None = None
    """Rotation vector along x, unit of angle."""
    ry: _Number | None = None
    """Rotation vector along y, unit of angle."""
    rz: _Number | None = None
    """Rotation vector along z, unit of angle; in the plane the angle of rotation."""
    quat_x: _Number | None = None
    """Quaternion in place of the rotation vector: its x."""
    quat_y: _Number | None = None
    """Quaternion: its y."""
    quat_z: _Number | None = None
    """Quaternion: its z."""
    quat_w: _Number | None = None
    """Quaternion: its scalar part."""


def factors(units: Units) -> Array:
    """Return the SI value of one file unit of each pose coordinate (6,)."""
    return np.array([units.factor(coordinate_quantity(c)) for c in COORDINATES])


def rotation_vectors(quaternions: Array) -> Array:
    """Return rotation vectors (N, 3), rad, of unit quaternions x, y, z, w (N, 4)."""
    q = np.atleast_2d(quaternions)
    q = q * np.where(q[:, 3:] < 0.0, -1.0, 1.0)
    sine = np.sqrt(np.sum(q[:, :3] ** 2, axis=1))
    angle = 2.0 * np.arctan2(sine, q[:, 3])
    small = sine < 1e-8
    factor = np.where(small, 2.0, angle / np.where(small, 1.0, sine))
    return np.asarray(factor[:, None] * q[:, :3], dtype=float)


def pose_from_map(data: object, allowed: Sequence[str], units: Units, source: str, where: str, *,
                  needed: Sequence[str] | None = None) -> Array:
    """Return the pose (6,) of a mapping; coordinates outside ``allowed`` are 0.

    Those of ``needed`` must be given  [default: all allowed], others are nan.

    Raises:
        BadInput: a key that does not fit, a missing one, or a quaternion off its norm.
    """
    pose = check(PoseFile, data, source, prefix=where)
    place = f"{source}: {where}"
    given = {n: v for n, v in pose.model_dump().items() if v is not None}
    out = np.full(6, np.nan)
    quaternion = [n for n in QUATERNION if n in given]
    for name in given:
        turning = name in QUATERNION and "rx" in allowed
        if name not in allowed and not turning:
            error = unknown("pose coordinate", name, allowed, place)
            raise BadInput(f"this pose has no coordinate '{name}'", place, error.hint)
    if quaternion:
        _put_quaternion(out, given, place)
    for i, name in enumerate(COORDINATES):
        if name in given:
            out[i] = given[name] * units.factor(coordinate_quantity(name))
        elif name not in allowed:
            out[i] = 0.0
    for name in allowed if needed is None else needed:
        i = COORDINATES.index(name)
        if np.isnan(out[i]):
            raise BadInput(f"the pose coordinate '{name}' is missing", place,
                           f"Write {{{', '.join(f'{c}: 0' for c in allowed)}}} with your numbers")
    return out


def _put_quaternion(out: Array, given: dict[str, float], place: str) -> None:
    missing = [n for n in QUATERNION if n not in given]
    if missing:
        raise BadInput(f"the quaternion lacks {', '.join(missing)}", place,
                       f"Give all of {', '.join(QUATERNION)}")
    if any(n in given for n in ("rx", "ry", "rz")):
        raise BadInput("the rotation is given twice, as a vector and as a quaternion", place,
                       "Remove rx, ry, rz or the quaternion")
    q = np.array([given[n] for n in QUATERNION])
    norm = float(np.linalg.norm(q))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise BadInput(f"the quaternion has length {norm:.6g}", place,
                       "A rotation needs length 1; check the order x, y, z, w and the digits")
    out[3:] = rotation_vectors(q[None] / norm)[0]


def pose_to_map(pose: Array, allowed: Sequence[str], units: Units) -> dict[str, float]:
    """Return the mapping that :func:`pose_from_map` reads back as ``pose`` (6,)."""
    return {name: to_file(float(pose[i]), units.factor(coordinate_quantity(name)))
            for i, name in enumerate(COORDINATES) if name in allowed}


# ---- rotations of tables


def check_convention(name: str, mechanism: Mechanism) -> str:
    """Return the convention's name.

    Raises:
        BadInput: there is none of that name, or the machine does not rotate in space.
    """
    refuse_unknown("rotation convention", [name], CONVENTIONS, "--rotation")
    if name != "rotvec" and not mechanism.motion.turns_freely:
        turn = "its rotation is rz" if mechanism.motion.turns else "it does not turn"
        raise BadInput(f"a {mechanism.motion} machine has no spatial rotation: {turn}",
                       "--rotation", "Leave the option out")
    return name


def columns_of(convention: str) -> tuple[str, ...]:
    """Return the names of a convention's columns."""
    if convention == "rotvec":
        return VECTOR
    return QUATERNION if convention == "quat" else EULER


def under_vector_names(table: Table, convention: str) -> Table:
    """Return the table with its Euler angles under the names rx, ry, rz.

    Raises:
        BadInput: rotation columns of another convention, or Euler columns missing.
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
    names = dict(zip(EULER, VECTOR, strict=True))
    return table.named({c: names.get(c, c) for c in table.header})
