"""Conversion of measured columns from another convention, frame or row than the wanted one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.rotations import from_euler, to_euler, to_quaternion
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.motions import POSE_COORDINATES

AXES, TURNS = POSE_COORDINATES[:3], POSE_COORDINATES[3:]
QUATERNIONS = ("quat-xyzw", "quat-wxyz")


def understood(raw: Array, convention: str) -> Array:
    """Return rotation vectors (N, 3), rad, of rotation columns written in a convention.

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
    """Return rotation vectors (N, 3) as written in a convention; inverse of :func:`understood`."""
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
    """Return the data with its measured columns moved up by ``shift`` rows; ends are dropped.

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
                  sigma_value=data.sigma_value[source],
                  covariance=None if data.covariance is None else data.covariance[source])
    return out.take(keep)
