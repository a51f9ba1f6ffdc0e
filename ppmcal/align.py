"""Closed-form start for an unknown frame and target: measured = frame o pose o target.

Rotations first (they do not depend on any origin), then frame origin and target point as
one linear problem. Position-only data start from the rigid alignment of the platform
origins, which a small target offset only perturbs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.arrays import known
from ppmcal.dataset import Dataset
from ppmcal.errors import BadInput
from ppmcal.observation import Station

Array = NDArray[np.float64]


def start_station(data: Dataset, pose: Array, actuators: int, motion: str) -> Station:
    """Return frame and target to start from.

    Args:
        data: the measurements; known parts of frame and target are kept.
        pose: platform motors at the rows' joint values (N, 8), nan rows are ignored.
        actuators: number of joint variables.
        motion: the machine's motion.
    """
    frame = cga.motor_from_rotation_vector(data.frame.value[3:], data.frame.value[:3])
    station = Station(frame, data.target.value, data.target_rotation.value, np.zeros(actuators))
    planar = motion == "planar"
    position = np.where(np.isfinite(data.position), data.position, 0.0) if planar else data.position
    if planar:
        position = np.where(known(data.position[:, :2])[:, None], position,
                            np.nan)
    rows = known(position) & known(pose)
    if not data.frame.fitted and not data.target.fitted and not data.target_rotation.fitted:
        return station
    if rows.sum() < 3:
        raise BadInput(f"only {int(rows.sum())} usable rows: an unknown frame or target needs "
                       "at least 3", data.source, "Measure more poses.")
    rotation = cga.rotation_matrix(pose[rows])
    origin = cga.translation(pose[rows])
    turn, body = _rotations(data, rows, rotation, origin, position[rows], station, planar)
    shift, target = _origins(data, turn, rotation, origin, position[rows], station, planar)
    return Station(cga.motor_from_matrix(turn, shift), target,
                   cga.rotation_vector(cga.motor_from_matrix(body, np.zeros(3))), station.homing)


def _rotations(data: Dataset, rows: NDArray[np.bool_], rotation: Array, origin: Array,
               position: Array, station: Station, planar: bool) -> tuple[Array, Array]:
    """Return the rotations of frame and target (3, 3)."""
    body = cga.rotation_matrix(cga.motor_from_rotation_vector(station.target_rotation,
                                                              np.zeros(3)))
    turn = cga.rotation_matrix(station.frame)
    measured = data.rotation[rows]
    if planar:
        measured = measured * np.array([np.nan, np.nan, 1.0])
        measured = np.where(np.isfinite(measured[:, 2:]), np.nan_to_num(measured), np.nan)
    whole = known(measured)
    translational = bool(np.ptp(rotation, axis=0).max() < 1e-12)
    if whole.sum() < 3 or (translational and data.target_rotation.fitted) or data.kind != "pose":
        if data.frame.fitted:
            turn = _rigid(origin, position, planar)
        return turn, body
    seen = cga.rotation_matrix(cga.motor_from_rotation_vector(measured[whole], np.zeros(3)))
    own = rotation[whole]
    if data.frame.fitted and data.target_rotation.fitted:
        turn = _rigid(origin, position, planar)
        for _ in range(50):
            body = _mean_rotation(np.swapaxes(turn @ own, -1, -2) @ seen, planar)
            turn = _mean_rotation(seen @ np.swapaxes(own @ body, -1, -2), planar)
    elif data.frame.fitted:
        turn = _mean_rotation(seen @ np.swapaxes(own @ body, -1, -2), planar)
    elif data.target_rotation.fitted:
        body = _mean_rotation(np.swapaxes(turn @ own, -1, -2) @ seen, planar)
    return turn, body


def _origins(data: Dataset, turn: Array, rotation: Array, origin: Array, position: Array,
             station: Station, planar: bool) -> tuple[Array, Array]:
    """Return frame origin and target (3,) each: linear least squares, smallest target."""
    shift, target = cga.translation(station.frame), station.target
    seen = turn @ rotation
    rest = position - origin @ turn.T
    blocks, columns = [], []
    if data.frame.fitted:
        blocks.append(np.broadcast_to(np.eye(3), seen.shape))
        columns.append("shift")
    else:
        rest = rest - shift
    if data.target.fitted:
        blocks.append(seen)
        columns.append("target")
    else:
        rest = rest - seen @ target
    if not blocks:
        return shift, target
    matrix = np.concatenate(blocks, axis=-1).reshape(-1, 3 * len(blocks))
    solution = np.linalg.lstsq(matrix, rest.reshape(-1), rcond=1e-9)[0].reshape(-1, 3)
    found = dict(zip(columns, solution, strict=True))
    flat = np.array([1.0, 1.0, 0.0]) if planar else np.ones(3)
    return found.get("shift", shift) * flat, found.get("target", target) * flat


def _rigid(origin: Array, position: Array, planar: bool) -> Array:
    """Rotation that best carries origins onto positions (Kabsch), (3, 3)."""
    a, b = origin - origin.mean(axis=0), position - position.mean(axis=0)
    return _nearest_rotation(b.T @ a, planar)


def _mean_rotation(rotations: Array, planar: bool) -> Array:
    return _nearest_rotation(rotations.sum(axis=0), planar)


def _nearest_rotation(matrix: Array, planar: bool) -> Array:
    """Return the proper rotation nearest to a 3x3 matrix; about z only in the plane."""
    if planar:
        angle = np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    u, _, vt = np.linalg.svd(matrix)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return np.asarray(u @ flip @ vt, dtype=float)
