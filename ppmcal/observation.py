"""What an instrument sees of a pose: measured = frame o pose o target.

Shapes: N rows, m measured coordinates per row. Positions come first, rotations after:
(x, y, rz) in the plane, (x, y, z) or (x, y, z, rx, ry, rz) in space. Rotation residuals
are rotation vectors in the measuring frame's axes, so that no representation enters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.arrays import known
from ppmcal.dataset import Dataset
from ppmcal.limbs.chain import cross_matrix, left_jacobian

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Station:
    """Where one data set's instrument stands, at present.

    ``frame`` motor (8,); ``target`` (3,); ``target_rotation`` rotation vector (3,);
    ``homing`` (k,): shift of the joint values of this file, unit of q.
    """

    frame: Array
    target: Array
    target_rotation: Array
    homing: Array


@dataclass(frozen=True)
class View:
    """Residuals of n rows and how the prediction moves.

    Attributes:
        residual: measured - predicted (n, m), 0 where not measured; m and rad.
        observed: (n, m).
        by_pose: d prediction / d(platform origin displacement, rotation), (n, m, 6).
        by_frame: d prediction / d(frame displacement, turn about the pivot), (n, m, 6).
        by_target: d prediction / d target (n, m, 3).
        by_target_rotation: d prediction / d target rotation vector (n, m, 3).
        point: where the measured point truly is, measuring frame (n, 3); places: how many
            of the m coordinates are positions.
    """

    residual: Array
    observed: Bools
    by_pose: Array
    by_frame: Array
    by_target: Array
    by_target_rotation: Array
    point: Array
    places: int


def coordinates(data: Dataset, motion: str) -> tuple[int, ...]:
    """Return which of (x, y, z, rx, ry, rz) the data set's instrument measures."""
    if motion == "planar":
        return (0, 1, 5) if data.kind == "pose" else (0, 1)
    return (0, 1, 2, 3, 4, 5) if data.kind == "pose" and motion == "spatial" else (0, 1, 2)


def pivot(data: Dataset) -> Array:
    """Return the point about which the frame is turned in fits (3,): the data's middle."""
    seen = np.isfinite(data.position)
    count = np.maximum(seen.sum(axis=0), 1)
    return np.asarray(np.where(seen, data.position, 0.0).sum(axis=0) / count, dtype=float)


def predict(station: Station, pose: Array) -> tuple[Array, Array]:
    """Return predicted positions (n, 3) and rotation matrices (n, 3, 3) in the frame."""
    seen = cga.compose(station.frame, pose)
    body = cga.rotation_matrix(cga.motor_from_rotation_vector(station.target_rotation, np.zeros(3)))
    return cga.move_point(seen, station.target), cga.rotation_matrix(seen) @ body


def measured_pose(station: Station, pose: Array) -> Array:
    """Return predicted measurements (n, 6): position and rotation vector in the frame."""
    point, turn = predict(station, pose)
    return np.concatenate([point, cga.rotation_vector(
        cga.motor_from_matrix(turn, np.zeros(3)))], axis=-1)


def view(data: Dataset, station: Station, pose: Array, motion: str, about: Array,
         stretch: Array | None = None) -> View:
    """Compare the data set's rows with poses (n, 8); ``about`` is the frame's pivot (3,).

    The instrument shows (1 + ``stretch``) (1 or n, 3, 3) times the true position.
    """
    chosen = coordinates(data, motion)
    point, rotation = predict(station, pose)
    residual = np.full((len(data), 6), np.nan)
    residual[:, :3] = data.position - stretched(point, stretch)
    turned = rotation_residual(data, rotation, motion)
    residual[:, 3:] = turned
    observed = np.isfinite(residual[:, chosen])
    frame = cga.rotation_matrix(station.frame)
    arm = cga.rotation_matrix(pose) @ station.target
    n = len(data)
    by_pose, by_frame = np.zeros((n, 6, 6)), np.zeros((n, 6, 6))
    by_target, by_rotation = np.zeros((n, 6, 3)), np.zeros((n, 6, 3))
    half = np.eye(3) + 0.5 * cross_matrix(np.where(np.isfinite(turned), turned, 0.0))
    by_pose[:, :3, :3] = frame
    by_pose[:, :3, 3:] = -frame @ cross_matrix(arm)
    by_pose[:, 3:, 3:] = half @ frame
    by_frame[:, :3, :3] = np.eye(3)
    by_frame[:, :3, 3:] = -cross_matrix(point - about)
    by_frame[:, 3:, 3:] = half
    seen = frame @ cga.rotation_matrix(pose)
    by_target[:, :3] = seen
    by_rotation[:, 3:] = half @ seen @ left_jacobian(station.target_rotation)
    if stretch is not None:
        for block in (by_pose, by_frame, by_target):
            block[:, :3] += stretch @ block[:, :3]
    pick = list(chosen)
    return View(np.where(observed, residual[:, pick], 0.0), observed, by_pose[:, pick],
                by_frame[:, pick], by_target[:, pick], by_rotation[:, pick], point,
                sum(1 for c in chosen if c < 3))


def stretched(point: Array, stretch: Array | None) -> Array:
    """Return points (n, 3) as an instrument with a scale error shows them."""
    return point if stretch is None else point + (stretch @ point[..., None])[..., 0]


def rotation_residual(data: Dataset, predicted: Array, motion: str) -> Array:
    """Return measured against predicted rotation (n, 3), nan where incomplete."""
    measured = data.rotation
    if motion == "planar":
        angle = np.arctan2(predicted[:, 1, 0], predicted[:, 0, 0])
        out = np.full_like(measured, np.nan)
        difference = measured[:, 2] - angle
        out[:, 2] = difference - 2.0 * np.pi * np.round(difference / (2.0 * np.pi))
        return out
    whole = known(measured)
    filled = np.where(whole[:, None], measured, 0.0)
    turn = cga.rotation_matrix(cga.motor_from_rotation_vector(filled, np.zeros(3)))
    motor = cga.motor_from_matrix(turn @ np.swapaxes(predicted, -1, -2), np.zeros(3))
    return np.where(whole[:, None], cga.rotation_vector(motor), np.nan)


def noise(data: Dataset, motion: str) -> Array:
    """Return the stated standard deviations of the measured coordinates (n, m)."""
    both = np.concatenate([data.sigma_position, data.sigma_rotation], axis=1)
    return both[:, list(coordinates(data, motion))]


def whitener(view_: View, sigma: Array, by_joint: Array | None, sigma_joint: Array) -> Array:
    """Return W (n, m, m) with W W^T the inverse covariance's root: W r is white.

    Args:
        view_: the rows; unmeasured coordinates get a unit row of their own.
        sigma: standard deviations (n, m).
        by_joint: d prediction / dq (n, m, k), or None without joint noise.
        sigma_joint: noise of the joints (k,), unit of q.
    """
    m = sigma.shape[1]
    safe = np.where(view_.observed, sigma, 1.0)
    if by_joint is None or not np.any(sigma_joint > 0.0):
        return np.eye(m) / safe[..., None]
    spread = by_joint * sigma_joint
    spread = np.where(view_.observed[..., None], spread, 0.0)
    covariance = spread @ np.swapaxes(spread, -1, -2) + np.eye(m) * (safe**2)[..., None]
    # scale to unit diagonal first: metres and radians differ by orders of magnitude
    d = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    root = np.linalg.cholesky(covariance / (d[..., :, None] * d[..., None, :]))
    return np.asarray(np.linalg.inv(root) / d[..., None, :], dtype=float)
