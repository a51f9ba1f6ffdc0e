"""What an instrument measures of a pose from its station: frame o pose o target."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift
from ppmcal.model.limbs.chain import cross_matrix, left_jacobian
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration


def predict(registration: Registration, pose: Array) -> tuple[Array, Array]:
    """Return the measurement of platform motors (n, 8): frame o pose o target.

    Returns:
        Positions (n, 3), m, and rotation matrices (n, 3, 3) in the measuring frame, before the
        instrument's scale.
    """
    seen = cga.compose(registration.frame, pose)
    body = cga.rotation_matrix(cga.motor_from_rotation_vector(registration.target_rotation,
                                                              np.zeros(3)))
    return cga.move_point(seen, registration.target), cga.rotation_matrix(seen) @ body


def displaced(pose: Array, shift: Shift | None) -> Array:
    """Return platform motors (n, 8) as the instrument sees them after frame or target moved."""
    if shift is None:
        return pose
    if shift.frame is not None:
        pose = cga.compose(_motor(shift.frame), pose)
    return pose if shift.target is None else cga.compose(pose, _motor(shift.target))


def by_displacement(pose: Array, shift: Shift | None) -> Array | None:
    """Return d(seen pose)/d(platform pose) (n, 6, 6), twists about the origins, base axes.

    The seen pose is :func:`displaced`; None if it is the platform's own.
    """
    if shift is None or (shift.frame is None and shift.target is None):
        return None
    out = np.zeros((len(pose), 6, 6))
    turn = cga.rotation_matrix(_motor(shift.frame)) if shift.frame is not None else np.eye(3)
    out[:, :3, :3] = out[:, 3:, 3:] = turn
    out[:, :3, 3:] = -turn @ cross_matrix(_arm(pose, shift))
    return out


def displacement_twists(pose: Array, by: Shift, now: Shift | None) -> Iterator[Array]:
    """Yield the platform twists (n, 6), base axes, equivalent to steps of frame and target.

    ``by``: the steps of their displacements; ``now``: their present displacements.
    """
    arm = _arm(pose, now)
    if by.frame is not None:
        present = np.zeros((len(pose), 6)) if now is None or now.frame is None else now.frame
        turn = cga.rotation_matrix(_motor(present))
        own = cga.translation(pose) + arm
        rotation = _times(left_jacobian(present[:, 3:]), by.frame[:, 3:])
        moved = by.frame[:, :3] + np.cross(rotation, _times(turn, own))
        back = np.swapaxes(turn, -1, -2)
        rotation, moved = _times(back, rotation), _times(back, moved)
        yield np.concatenate([moved - np.cross(rotation, arm), rotation], axis=1)
    if by.target is not None:
        present = np.zeros((len(pose), 6)) if now is None or now.target is None else now.target
        own = cga.rotation_matrix(pose)
        rotation = _times(own, _times(left_jacobian(present[:, 3:]), by.target[:, 3:]))
        moved = _times(own, by.target[:, :3])
        yield np.concatenate([moved - np.cross(rotation, arm), rotation], axis=1)


def _arm(pose: Array, shift: Shift | None) -> Array:
    """Return the displaced target's origin relative to the platform's (n, 3), base axes."""
    if shift is None or shift.target is None:
        return np.zeros((len(pose), 3))
    return _times(cga.rotation_matrix(pose), shift.target[:, :3])


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def after_events(registration: Registration, shift: Shift) -> Registration:
    """Return a registration after permanent changes; ``shift`` of one row, after the last event."""
    frame, target, turn = registration.frame, registration.target, registration.target_rotation
    if shift.frame is not None:
        frame = cga.compose(frame, _motor(shift.frame)[0])
    if shift.target is not None:
        moved = _motor(shift.target)[0]
        target = cga.move_point(moved, target)
        turn = cga.rotation_vector(cga.compose(moved, cga.motor_from_rotation_vector(
            turn, np.zeros(3))))
    return Registration(frame, target, turn, registration.homing, registration.scale,
                        registration.offset)


def _motor(displacement: Array) -> Array:
    return cga.motor_from_rotation_vector(displacement[:, 3:], displacement[:, :3])


def measured_pose(registration: Registration, pose: Array) -> Array:
    """Return the measured position and rotation vector (n, 6) of platform motors (n, 8).

    Measuring frame, m and rad, in the instrument's scale.
    """
    point, turn = predict(registration, pose)
    return np.concatenate([registration.scale * point, cga.rotation_vector(
        cga.motor_from_matrix(turn, np.zeros(3)))], axis=-1)


def carried_back(mechanism: Mechanism, registration: Registration, wanted: Array) -> Array:
    """Return platform motors (n, 8) of measured poses (n, 6): frame^-1 o wanted o target^-1.

    Open coordinates count as 0; in a translational machine the rotation stays.
    """
    filled = np.where(np.isnan(wanted), 0.0, wanted)
    filled[..., :3] /= registration.scale
    body = cga.motor_from_rotation_vector(registration.target_rotation, registration.target)
    back = cga.reverse(registration.frame)
    if not mechanism.motion.turns:
        turn = mechanism.home_pose[3:]
        own = cga.motor_from_rotation_vector(turn, np.zeros(3))
        at = cga.move_point(back, filled[:, :3]) - cga.move_point(own, registration.target)
        return cga.motor_from_rotation_vector(np.broadcast_to(turn, at.shape), at)
    return cga.compose(cga.compose(back, _motor(filled)), cga.reverse(body))
