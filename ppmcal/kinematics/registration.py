"""What an instrument sees of a pose from where it stands: frame o pose o target."""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift
from ppmcal.model.registration import Registration


def predict(registration: Registration, pose: Array) -> tuple[Array, Array]:
    """Return what is seen of platform motors (n, 8): frame o pose o target.

    Returns:
        Positions (n, 3), m, and rotation matrices (n, 3, 3) in the measuring frame.
    """
    seen = cga.compose(registration.frame, pose)
    body = cga.rotation_matrix(cga.motor_from_rotation_vector(registration.target_rotation,
                                                              np.zeros(3)))
    return cga.move_point(seen, registration.target), cga.rotation_matrix(seen) @ body


def displaced(pose: Array, shift: Shift | None) -> Array:
    """Return platform motors (n, 8) as the instrument has them once frame or target have moved."""
    if shift is None:
        return pose
    if shift.frame is not None:
        pose = cga.compose(_motor(shift.frame), pose)
    return pose if shift.target is None else cga.compose(pose, _motor(shift.target))


def after_events(registration: Registration, shift: Shift) -> Registration:
    """Return a registration with what has moved for good; ``shift`` of one row, after the last."""
    frame, target, turn = registration.frame, registration.target, registration.target_rotation
    if shift.frame is not None:
        frame = cga.compose(frame, _motor(shift.frame)[0])
    if shift.target is not None:
        moved = _motor(shift.target)[0]
        target = cga.move_point(moved, target)
        turn = cga.rotation_vector(cga.compose(moved, cga.motor_from_rotation_vector(
            turn, np.zeros(3))))
    return Registration(frame, target, turn, registration.homing)


def _motor(displacement: Array) -> Array:
    return cga.motor_from_rotation_vector(displacement[:, 3:], displacement[:, :3])


def measured_pose(registration: Registration, pose: Array) -> Array:
    """Return what is seen of platform motors (n, 8): position and rotation vector (n, 6).

    Measuring frame, m and rad.
    """
    point, turn = predict(registration, pose)
    return np.concatenate([point, cga.rotation_vector(
        cga.motor_from_matrix(turn, np.zeros(3)))], axis=-1)
