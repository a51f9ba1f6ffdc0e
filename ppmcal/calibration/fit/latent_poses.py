"""Most likely poses of a machine with surplus equations, given its joints and the instrument.

By their noise its joints contradict each other and the instrument: the pose of a row is a
latent variable that minimises

    c' S^-1 c + (y - h)' V (y - h),

with c the closure at the joints as read, S its noise from joints and gaps, and V the inverse
covariance of the instrument. There, and not at the pose of the joints alone, the rows are linear in
the parameters without a first-order error, so that the gradient of chi-squared is exact (Golub and
Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ppmcal.calibration.fit.observation import ResidualJacobian
from ppmcal.kinematics.closure import Closure
from ppmcal.kinematics.forward import FARTHEST, moved
from ppmcal.kinematics.least_squares_closure import symmetric_system, with_gaps
from ppmcal.linalg import Array, solve_rows

STEPS = 10
STILL = 1e-10
"""Steps end when they are below this part of the length scale."""
ROUND_OFF = 1e-9
"""A value counts as larger only if it is by more than this part: the minimum is flat."""


def most_likely(closure: Closure, look: Callable[[Array], ResidualJacobian], pose: Array,
                sigma: Array, sigma_joint: Array, gaps: Array) -> Array:
    """Return the most likely poses (N, 8), started from ``pose``, kept where no step leads down.

    Args:
        closure: at the joint values as read.
        look: returns what the instrument observes at poses (N, 8).
        pose: motors (N, 8) by joints alone.
        sigma: standard deviations of its measurements (N, k).
        sigma_joint: of the joints, unit of q.
        gaps: standard uncertainty of closure gaps (m,).
    """
    mechanism = closure.model.mechanism
    best, least = pose, np.full(len(pose), np.inf)
    for _ in range(STEPS):
        value, step = _step(closure, look(pose), pose, sigma, sigma_joint, gaps)
        down = value <= (1.0 + ROUND_OFF) * least
        best = np.where(down[:, None], pose, best)
        least = np.where(down, np.minimum(value, least), least)
        twist = np.zeros((len(pose), 6))
        twist[:, mechanism.dof] = np.where(down[:, None] & np.isfinite(step), step, 0.0)
        away = np.linalg.norm(twist[:, :3], axis=1)
        twist[~(away < FARTHEST * mechanism.reach)] = 0.0
        if not np.any(np.abs(twist) > STILL * mechanism.length_scale):
            break
        pose = moved(best, twist)
    return best


def _step(closure: Closure, seen: ResidualJacobian, pose: Array, sigma: Array, sigma_joint: Array,
          gaps: Array) -> tuple[Array, Array]:
    """Return the function minimised (N,) at poses, and the step (N, d) from there."""
    c, lines = closure.misclosure_and_lines(pose)
    a = closure.pose_matrix(pose, lines)
    noise = with_gaps(closure.joint_matrix(pose, lines) * sigma_joint, gaps)
    system, size = symmetric_system(noise, a)
    m = a.shape[1]
    white = np.where(seen.observed, 1.0 / sigma, 0.0)
    residual = white * np.where(seen.observed, seen.residual, 0.0)
    h = white[..., None] * seen.by_poses[0][..., closure.model.mechanism.dof]
    back = np.swapaxes(h, -1, -2)
    system[:, m:, m:] = -size * (back @ h)
    right = np.concatenate([c, size[..., 0] * (back @ residual[..., None])[..., 0]], axis=1)
    with np.errstate(invalid="ignore"):
        force = solve_rows(system[:, :m, :m], c)
        value = np.sum(c * force, axis=1) / size[:, 0, 0] + np.sum(residual**2, axis=1)
    return value, -solve_rows(system, right)[:, m:]
