"""Where an instrument stands, and what it would see of a pose: frame o pose o target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array


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
