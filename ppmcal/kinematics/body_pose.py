"""The pose of a body from measured positions of several of its points, with its covariance.

Generalised least squares: y_i = t + R p_i + noise of covariance C_i, for the measured targets i;
Gauss-Newton from the rigid alignment of the points (Kabsch). Displacement and rotation are those
of the points' centroid, which are nearly uncorrelated, and are transferred to the body's origin at
the end. Source of the covariance: Förstner, Wrobel: Photogrammetric Computer Vision, 4.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array, Bools, Ints, nearest_rotation
from ppmcal.model.limbs.chain import cross_matrix

ITERATIONS, SETTLED = 50, 1e-6
"""Maximum number of Gauss-Newton steps, and the step at which it ends, in standard deviations."""
UNKNOWN_TURN = 0.1
"""Standard deviation of a rotation, rad, above which no covariance describes its error: its
second-order terms are more than a twentieth of it. Targets so near a line determine no pose."""
FLAT = 1e-6
"""Targets closer to a line than this part of their extent are on it."""
TOO_FEW, ON_A_LINE = "too few targets are seen", "the targets that are seen are on one line"
IN_ONE_PLACE = "the targets that are seen are in one place"
NOT_RIGID = "no pose of the body fits the measured targets"


@dataclass(frozen=True, eq=False)
class BodyPoses:
    """Poses of a body at n stands, measuring frame, as measured by its targets.

    Attributes:
        pose: position of the body's origin and rotation vector (n, 6), m and rad; nan where
            unknown. For planar bodies z, rx and ry are 0.
        covariance: of the origin's displacement and of a rotation on the measuring frame's side,
            about its axes (n, 6, 6), m^2, m rad, rad^2; exp(error) times the rotation is the
            measured one. 0 in coordinates that planar bodies do not have, nan without a pose.
        chi_squared: weighted sum of squared residuals of the measured positions (n,).
        freedom: number of measured values beyond those of a pose (n,), 0 without a pose.
        reason: why there is no pose (n,), "" if there is one.
    """

    pose: Array
    covariance: Array
    chi_squared: Array
    freedom: Ints
    reason: tuple[str, ...]


def body_poses(points: Array, measured: Array, noise: Array, planar: bool = False) -> BodyPoses:
    """Return the poses at which T targets of one body were measured at n stands.

    Three targets that are not on a line determine a pose; planar: two in different places.

    Args:
        points: the targets in the body's axes (T, 3), m; taken as exact.
        measured: their positions (n, T, 3), m, measuring frame; a target with a nan coordinate
            was not seen.
        noise: standard deviations (n, T, 3), m, or covariances (n, T, 3, 3), m^2, of each position.
        planar: everything is in the x-y plane; z is ignored.

    Raises:
        LinearAlgebraError: the covariance of a seen target is not positive definite.
    """
    axes = 2 if planar else 3
    parts = [0, 1, 5] if planar else list(range(6))
    seen = np.asarray(np.isfinite(measured[..., :axes]).all(axis=-1))
    white = _inverse_roots(noise, seen, axes)
    mine = np.arange(3) < axes
    points = np.where(mine, points, 0.0)
    measured = np.where(seen[..., None] & mine, measured, 0.0)
    count = seen.sum(axis=1)
    middle = seen @ points / np.maximum(count, 1)[:, None]
    arms = np.where(seen[..., None], points - middle[:, None], 0.0)
    there = measured.sum(axis=1) / np.maximum(count, 1)[:, None]
    reason = _unseen(arms, count, axes)
    rows = np.flatnonzero(reason == "")
    n = len(seen)
    pose, covariance = np.full((n, 6), np.nan), np.full((n, 6, 6), np.nan)
    squares, freedom = np.full(n, np.nan), np.zeros(n, dtype=np.int64)
    own = _Sights(arms[rows], measured[rows], white[rows], parts)
    turn, origin, settled = own.fitted(there[rows], seen[rows])
    normal, _, missed = own.normal(turn, origin)
    variance = linalg.inv(normal)
    sure = np.all(np.diagonal(variance, axis1=1, axis2=2)[:, axes:] < UNKNOWN_TURN**2, axis=1)
    reason[rows[~sure]] = ON_A_LINE if axes == 3 else IN_ONE_PLACE
    reason[rows[sure & ~settled]] = NOT_RIGID
    good = sure & settled
    at = rows[good]
    pose[at], covariance[at] = _at_origin(turn[good], origin[good], middle[at], variance[good],
                                          parts)
    squares[at], freedom[at] = missed[good], axes * count[at] - len(parts)
    return BodyPoses(pose, covariance, squares, freedom, tuple(reason.tolist()))


def _at_origin(turn: Array, middle: Array, own: Array, variance: Array, parts: list[int]
               ) -> tuple[Array, Array]:
    """Return poses (n, 6) of the body's origin and their covariances (n, 6, 6).

    Args:
        turn: rotations (n, 3, 3).
        middle: position of the targets' centroid (n, 3), m.
        own: the same in the body's axes.
        variance: of the centroid's displacement and of the rotation (n, c, c).
        parts: which c of the six coordinates these are.
    """
    back = -(turn @ own[..., None])[..., 0]
    lever = np.tile(np.eye(6), (len(turn), 1, 1))
    lever[:, :3, 3:] = -cross_matrix(back)
    lever = lever[:, :, parts]
    return (pose_vector(cga.motor_from_matrix(turn, middle + back)),
            lever @ variance @ np.swapaxes(lever, 1, 2))


def _inverse_roots(noise: Array, seen: Bools, axes: int) -> Array:
    """Return matrices that whiten positions (n, T, a, a), 0 for targets that were not seen."""
    if noise.ndim == seen.ndim + 1:
        noise = noise[..., None] ** 2 * np.eye(3)
    covariance = np.where(seen[..., None, None], noise[..., :axes, :axes], np.eye(axes))
    return np.where(seen[..., None, None], linalg.inv(linalg.cholesky(covariance)), 0.0)


def _unseen(arms: Array, count: Ints, axes: int) -> Array:
    """Return why the targets seen at stands (n,) determine no pose, "" if they may."""
    size = linalg.singular_values(arms)[:, axes - 2]
    reason = np.full(count.size, "", dtype=object)
    reason[size <= FLAT * np.abs(arms).max(axis=(1, 2), initial=0.0)] = (
        ON_A_LINE if axes == 3 else IN_ONE_PLACE)
    reason[count < axes] = TOO_FEW
    return reason


@dataclass(frozen=True, eq=False)
class _Sights:
    """Measurements in n rows.

    ``arms``: targets relative to their centroid (n, T, 3), 0 if not seen; ``measured`` (n, T, 3);
    ``white``: whitens positions (n, T, a, a); ``parts``: the open coordinates of a pose.
    """

    arms: Array
    measured: Array
    white: Array
    parts: list[int]

    def fitted(self, there: Array, seen: Bools) -> tuple[Array, Array, Bools]:
        """Return rotations (n, 3, 3), positions of centroids (n, 3), and whether they converged."""
        apart = np.where(seen[..., None], self.measured - there[:, None], 0.0)
        turn = nearest_rotation(np.swapaxes(apart, 1, 2) @ self.arms, len(self.parts) == 3)
        origin, settled = there, np.zeros(len(there), dtype=np.bool_)
        for _ in range(ITERATIONS):
            normal, right, _ = self.normal(turn, origin)
            step = np.zeros((len(there), 6))
            step[:, self.parts] = linalg.solve_rows(normal, right)
            # the step's length in standard deviations
            size = np.einsum("ni,ni->n", step[:, self.parts], right)
            settled = np.abs(size) < SETTLED**2
            origin = origin + step[:, :3]
            turn = cga.rotation_matrix(cga.motor_from_rotation_vector(
                step[:, 3:], np.zeros(3))) @ turn
            if settled.all():
                break
        return turn, origin, settled

    def normal(self, turn: Array, origin: Array) -> tuple[Array, Array, Array]:
        """Return J'J (n, c, c), J'r (n, c) and r'r (n,) of white residuals."""
        axes, turned = self.white.shape[-1], self.arms @ np.swapaxes(turn, 1, 2)
        by_pose = np.zeros((*turned.shape, 6))
        by_pose[..., :3], by_pose[..., 3:] = np.eye(3), -cross_matrix(turned)
        n, m = len(turn), axes * turned.shape[1]
        by_pose = (self.white @ by_pose[..., :axes, :][..., self.parts]).reshape(
            n, m, len(self.parts))
        missed = (self.measured - origin[:, None] - turned)[..., :axes, None]
        missed = (self.white @ missed).reshape(n, m)
        return (np.swapaxes(by_pose, 1, 2) @ by_pose,
                np.einsum("nmc,nm->nc", by_pose, missed), np.einsum("nm,nm->n", missed, missed))
