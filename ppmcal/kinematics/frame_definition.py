"""A base frame defined by measurements: by points of the base, or by the first pose.

Such a frame is given, not fitted, and has the uncertainty of its definition: with F the motor of
the base in the measuring frame, noise makes it F exp(e), where e, a twist about the base's
origin in base axes, has a covariance (6, 6), displacement first.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.registration import Registration

STEP = 1e-3
"""Part of a standard deviation by which measurements are moved for a derivative."""


def frame_by_points(points: Array) -> Array:
    """Return the motor (8,) of the base in the frame in which three of its points were measured.

    Args:
        points: the origin, one on the x axis, one in the x-y plane with positive y (3, 3), m;
            for a planar machine (2, 3), without the last.
    """
    origin, ahead = points[:2]
    x = (ahead - origin) / np.linalg.norm(ahead - origin)
    z = np.array([0.0, 0.0, 1.0])
    if len(points) == 3:
        z = np.cross(x, points[2] - origin)
        z = z / np.linalg.norm(z)
    return cga.motor_from_matrix(np.stack([x, np.cross(z, x), z], axis=-1), origin)


def frame_by_pose(seen: Array, pose: Array, registration: Registration) -> Array:
    """Return the motor (8,) of the base in a frame in which a pose of the platform was measured.

    Args:
        seen: as measured (6,), m and rad.
        pose: motor of the platform in the base frame (8,).
        registration: target and its rotation, in platform axes.
    """
    body = cga.motor_from_rotation_vector(registration.target_rotation, registration.target)
    return cga.compose(pose_motor(seen), cga.reverse(cga.compose(pose, body)))


def frame_covariance(frame: Callable[[Array], Array], values: Array, covariance: Array) -> Array:
    """Return the covariance (6, 6) of a frame from that of the values (n,) that define it.

    Args:
        frame: gives its motor (8,) from the values.
        values: as measured.
        covariance: of the values (n, n).
    """
    back, size = cga.reverse(frame(values)), np.sqrt(np.diagonal(covariance))
    jacobian = np.zeros((6, len(values)))
    for i in np.flatnonzero(size > 0.0):
        step = STEP * size[i] * np.eye(len(values))[i]
        ends = [pose_vector(cga.compose(back, frame(values + way * step))) for way in (1.0, -1.0)]
        jacobian[:, i] = (ends[0] - ends[1]) / (2.0 * STEP * size[i])
    return np.asarray(jacobian @ covariance @ jacobian.T)


def seen_variance(covariance: Array, points: Array) -> Array:
    """Return the variance (N, 6) of poses due to a frame's (6, 6), m^2 and rad^2, base axes.

    ``points``: positions of the poses (N, 3), base frame; x, y, z, then rotations.
    """
    lever = np.zeros((len(points), 6, 6))
    lever[:, :3, :3] = lever[:, 3:, 3:] = np.eye(3)
    lever[:, :3, 3:] = -cross_matrix(points)
    return np.asarray(np.einsum("nij,jk,nik->ni", lever, covariance, lever))
