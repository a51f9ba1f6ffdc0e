"""What an instrument sees of a pose from where it stands: frame o pose o target."""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
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


def measured_pose(registration: Registration, pose: Array) -> Array:
    """Return what is seen of platform motors (n, 8): position and rotation vector (n, 6).

    Measuring frame, m and rad.
    """
    point, turn = predict(registration, pose)
    return np.concatenate([point, cga.rotation_vector(
        cga.motor_from_matrix(turn, np.zeros(3)))], axis=-1)
