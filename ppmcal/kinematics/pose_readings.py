"""Ways to read a measurement file: whose column is whose, units, signs, rotations, frames.

A measurement file is numbers under names. The same numbers read in another way are another
campaign: :class:`JointReading` for the joint columns, :class:`PoseReading` for the measured ones,
both together with a shift of the rows a :class:`FileReading`. Order of reading: columns, signs,
units, convention of rotations, mirrored axis, inverse pose, shift of rows (contract, section 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.rotations import from_euler, to_euler, to_quaternion
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism
from ppmcal.units import ANGLES, LENGTHS, TURN, Units

AXES, TURNS = POSE_COORDINATES[:3], POSE_COORDINATES[3:]
QUATERNIONS = ("quat-xyzw", "quat-wxyz")
IDENTITY = (0, 1, 2)
PLUS = (1, 1, 1)
DECLARED = ("", "", "")


@dataclass(frozen=True)
class JointReading:
    """Another reading of k joint columns.

    ``order``: joint i stands in the column of joint ``order[i]``; ``signs``: +1 or -1 on it;
    ``units``: of that column, empty where it is the declared one.
    """

    order: tuple[int, ...]
    signs: tuple[int, ...]
    units: tuple[str, ...]

    @classmethod
    def plain(cls, count: int) -> JointReading:
        """Return the reading as declared of ``count`` joints."""
        return cls(tuple(range(count)), (1,) * count, ("",) * count)

    def of(self, q: Array, declared: Array) -> Array:
        """Return the joint values (N, k) of a file that was read as ``q``.

        ``declared``: SI value of the declared unit of each joint (k,).
        """
        factors = [s * unit_factor(u, d) for s, u, d in
                   zip(self.signs, self.units, declared, strict=True)]
        # a column's raw number times the unit of the joint that it now belongs to
        raw = q / declared
        return np.asarray(raw[:, list(self.order)] * declared * np.array(factors))

    @property
    def parts(self) -> float:
        """How many things are read in another way; an order is one, and a little by column."""
        moved = sum(i != o for i, o in enumerate(self.order))
        return (moved > 0) + 0.1 * moved + _minority(self.signs, 1) + _minority(self.units, "")


def _minority(values: Sequence[object], usual: object) -> int:
    """Return how many differ from the usual; all of them alike count as one mistake."""
    other = [v for v in values if v != usual]
    return 1 if len(other) == len(values) > 1 and len(set(other)) == 1 else len(other)


@dataclass(frozen=True)
class PoseReading:
    """Another reading of the measured columns.

    ``order``, ``signs``: of x, y, z; ``turn_order``, ``turn_signs``: of the rotation columns;
    ``units`` of the positions, ``turn_unit``, ``rotation`` (the convention): empty as declared;
    ``mirror``: an axis of the instrument that points the other way; ``inverse``: measuring frame
    seen from the platform.
    """

    order: tuple[int, ...] = IDENTITY
    signs: tuple[int, ...] = PLUS
    units: tuple[str, ...] = DECLARED
    turn_order: tuple[int, ...] = IDENTITY
    turn_signs: tuple[int, ...] = PLUS
    turn_unit: str = ""
    rotation: str = ""
    mirror: str = ""
    inverse: bool = False

    def with_rotation(self, other: PoseReading) -> PoseReading:
        """Return this reading with the rotation columns read as in another one."""
        return replace(self, turn_order=other.turn_order, turn_signs=other.turn_signs,
                       turn_unit=other.turn_unit, rotation=other.rotation)

    @property
    def parts(self) -> float:
        """How many things are read in another way; an axis is sooner mirrored than exchanged."""
        named = sum(1 for f in ("turn_unit", "rotation", "mirror", "inverse") if getattr(self, f))
        orders = 1.1 * ((self.order != IDENTITY) + (self.turn_order != IDENTITY))
        return named + orders + _minority(self.units, "") + _minority(
            self.signs, 1) + _minority(self.turn_signs, 1)

    def of(self, position: Array, rotation: Array, units: Units, convention: str,
           planar: bool) -> tuple[Array, Array]:
        """Return positions and rotation vectors (N, 3) of a file that was read as these.

        ``convention``: in which its rotation columns were read so far.
        """
        length, angle = LENGTHS[units.length], ANGLES[units.angle]
        factors = [s * unit_factor(u, length) for s, u in zip(self.signs, self.units, strict=True)]
        position = position[:, list(self.order)] * np.array(factors)
        rotation = self._turned(rotation, angle, convention, planar)
        if self.mirror:
            position, rotation = mirrored(position, rotation, self.mirror)
        if self.inverse:
            position, rotation = inverse_pose(position, rotation, planar)
        return position, rotation

    def _turned(self, rotation: Array, angle: float, convention: str, planar: bool) -> Array:
        if PoseReading().with_rotation(self) == PoseReading():
            return rotation
        if planar:
            return rotation * self.turn_signs[2] * unit_factor(self.turn_unit, angle)
        raw = written(rotation, convention)
        if raw.shape[1] == 3:
            raw = raw[:, list(self.turn_order)] * np.array(self.turn_signs) * unit_factor(
                self.turn_unit, angle)
        elif self.turn_signs != PLUS:
            raw = raw * np.array([*self.turn_signs, 1])
        return understood(raw, self.rotation or convention)


@dataclass(frozen=True)
class FileReading:
    """A way to read one file; ``shift``: the measured columns are so many rows late."""

    joints: JointReading
    pose: PoseReading = field(default_factory=PoseReading)
    shift: int = 0

    @property
    def parts(self) -> float:
        """How many things are read in another way."""
        return self.joints.parts + self.pose.parts + (self.shift != 0)

    def of(self, data: Dataset, mechanism: Mechanism) -> Dataset:
        """Return a data set of a machine read in this way."""
        q = self.joints.of(data.q, mechanism.joint_factors(data.units))
        position, rotation = self.pose.of(data.position, data.rotation, data.units,
                                          data.convention, mechanism.motion == "planar")
        out = replace(data, q=q, position=position, rotation=rotation, whole=None, place=None)
        return shifted_rows(out, self.shift)


def unit_factor(unit: str, declared: float) -> float:
    """Return by what a value read in the declared unit (SI value) is multiplied."""
    if not unit:
        return 1.0
    return ({**LENGTHS, **ANGLES, "turn": TURN}[unit]) / declared


def understood(raw: Array, convention: str) -> Array:
    """Return rotation vectors (N, 3), rad, of rotation columns as written in a convention.

    ``raw``: (N, 3) rad, quaternions (N, 4) of any length, or matrices (N, 9) row by row.
    """
    if convention in ("", "rotvec"):
        return raw
    if convention in QUATERNIONS:
        return _of_quaternion(raw if convention == "quat-xyzw" else np.roll(raw, -1, axis=1))
    if convention == "matrix":
        out = np.full((len(raw), 3), np.nan)
        good = finite_rows(raw)
        out[good] = cga.rotation_vector(cga.motor_from_matrix(
            raw[good].reshape(-1, 3, 3), np.zeros(3)))
        return out
    return from_euler(raw, convention)


def _of_quaternion(raw: Array) -> Array:
    size = np.linalg.norm(raw, axis=1)
    out = np.full((len(raw), 3), np.nan)
    good = np.isfinite(size) & (size > 0.0)
    out[good] = cga.rotation_vector(cga.motor_from_quaternion(
        raw[good] / size[good, None], np.zeros(3)))
    return out


def written(rotation: Array, convention: str) -> Array:
    """Return rotation vectors (N, 3) as a convention writes them; the inverse of the other."""
    if convention in ("", "rotvec", "matrix"):
        return rotation
    if convention in QUATERNIONS:
        quaternion = to_quaternion(rotation)
        return quaternion if convention == "quat-xyzw" else np.roll(quaternion, 1, axis=1)
    return to_euler(rotation, convention)[0]


def mirrored(position: Array, rotation: Array, axis: str) -> tuple[Array, Array]:
    """Return poses (N, 3), (N, 3) of an instrument with one axis pointing the other way.

    A reflection M turns p into M p and R into M R M, whose rotation vector is -M w.
    """
    flip = np.ones(3)
    flip[AXES.index(axis)] = -1.0
    return position * flip, rotation * -flip


def inverse_pose(position: Array, rotation: Array, planar: bool) -> tuple[Array, Array]:
    """Return the inverse of poses (N, 3), (N, 3): -R^T p and -w; nan where incomplete."""
    turn = np.where([True, True, not planar], 0.0, rotation) if planar else rotation
    place = np.where([False, False, planar], 0.0, position)
    out = np.full_like(position, np.nan)
    good = finite_rows(turn) & finite_rows(place)
    back = cga.rotation_matrix(cga.motor_from_rotation_vector(-turn[good], np.zeros(3)))
    out[good] = -(back @ place[good][..., None])[..., 0]
    if planar:
        out[:, 2] = position[:, 2]
    return out, -rotation


def shifted_rows(data: Dataset, shift: int) -> Dataset:
    """Return the data with its measured columns moved up by ``shift`` rows; ends are left empty.

    The row numbers stay those of the joints.
    """
    if not shift:
        return data
    n = len(data)
    source = np.arange(n) + shift
    inside = (source >= 0) & (source < n)
    source = np.clip(source, 0, n - 1)

    def moved(values: Array) -> Array:
        out = np.array(values[source])
        out[~inside] = np.nan
        return out

    keep = np.flatnonzero(inside)
    out = replace(data, position=moved(data.position), rotation=moved(data.rotation),
                  value=moved(data.value), sigma_position=data.sigma_position[source],
                  sigma_rotation=data.sigma_rotation[source],
                  sigma_value=data.sigma_value[source])
    return out.take(keep)
