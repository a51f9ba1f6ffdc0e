"""Assembly modes in space: a point pair, or a search by Newton from many starts.

Three spheres of a translational machine meet in two points. For a general spatial machine there is
no closed form (a 6-U(P)S has up to forty real modes: Dietmaier, "The Stewart-Gough platform of
general geometry can have 40 real postures", Advances in Robot Kinematics, 1998). Starts are drawn
over all rotations and over a box about the base, batch by batch, until batches find nothing new.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.design.intersection_spatial import origin_surfaces
from ppmcal.errors import NoResult
from ppmcal.kinematics.closure import Closure
from ppmcal.kinematics.forward import CLOSED, newton
from ppmcal.linalg import Array, Bools
from ppmcal.model.mechanism import Mechanism, joint_points

PLACE = "assembly modes"
BATCH = 1000
PATIENCE = 3
"""The search ends after so many batches that found nothing new,"""
MOST = 12
"""or after so many in all."""
SHARP = 1e-7
"""Converged poses nearer than this, in length scales and rad, are one mode,"""
BLUNT = 1e-4
"""others nearer than this: at a double root a gap of 1e-12 leaves the pose open by 1e-6."""


@dataclass(frozen=True, eq=False)
class FoundModes:
    """Poses that close: motors (n, 8), and whether Newton converged on each (n,).

    One on which it did not, though it closes, is a double root or nearly one.
    """

    motors: Array
    sharp: Bools


def apart(mechanism: Mechanism, poses: Array, other: Array) -> Array:
    """Return how far motors (n, 8) are from another (8,), in length scales and rad (n,)."""
    gap = _place(mechanism, poses) - _place(mechanism, np.atleast_2d(other))
    return np.asarray(np.linalg.norm(gap, axis=-1), dtype=float)


def _place(mechanism: Mechanism, poses: Array) -> Array:
    """Return (n, 12) numbers whose distance is that of poses nearby: origin and rotation."""
    turn = cga.rotation_matrix(poses).reshape(-1, 9) / np.sqrt(2.0)
    return np.concatenate([cga.translation(poses) / mechanism.length_scale, turn], axis=-1)


def closing(closure: Closure, starts: Array) -> FoundModes:
    """Return the distinct poses that close, by Newton from ``starts`` (M, 8).

    At a double root Newton's steps end in round-off before they are small; a pose that closes
    to :data:`ppmcal.kinematics.forward.CLOSED` of the reach is kept all the same.
    """
    if not len(starts):
        return FoundModes(np.zeros((0, 8)), np.zeros(0, dtype=bool))
    solved, sharp, _ = newton(closure, starts)
    allowed = CLOSED * closure.model.mechanism.reach
    with np.errstate(invalid="ignore", over="ignore"):
        ends = np.abs(closure.misclosure(solved)).max(axis=1) < allowed
        begins = np.abs(closure.misclosure(starts)).max(axis=1) < allowed
    poses = np.where(ends[:, None], solved, starts)
    kept = ends | begins
    return distinct(closure.model.mechanism, FoundModes(poses[kept], (sharp & ends)[kept]))


def distinct(mechanism: Mechanism, found: FoundModes) -> FoundModes:
    """Return each pose once, converged ones before those that are not."""
    order = np.argsort(~found.sharp, kind="stable")
    motors, sharp = found.motors[order], found.sharp[order]
    kept = []
    left = np.arange(len(motors))
    while left.size:
        first = left[0]
        kept.append(first)
        near = np.where(sharp[left] & sharp[first], SHARP, BLUNT)
        left = left[apart(mechanism, motors[left], motors[first]) > near]
    return FoundModes(motors[kept], sharp[kept])


def search(closure: Closure, seed: int) -> FoundModes:
    """Return the modes that Newton finds from drawn starts; there may be more."""
    mechanism = closure.model.mechanism
    rng = np.random.default_rng(seed)
    none = FoundModes(np.zeros((0, 8)), np.zeros(0, dtype=bool))
    found, idle = none, 0
    for _ in range(MOST):
        more = closing(closure, _starts(mechanism, rng, BATCH))
        both = distinct(mechanism, FoundModes(np.concatenate([found.motors, more.motors]),
                                         np.concatenate([found.sharp, more.sharp])))
        idle = 0 if len(both.motors) > len(found.motors) else idle + 1
        found = both
        if idle == PATIENCE:
            break
    return found


def _starts(mechanism: Mechanism, rng: np.random.Generator, count: int) -> Array:
    """Return drawn motors (count, 8): any rotation, the origin within the reach of the base."""
    centre = joint_points(mechanism)[0].mean(axis=0)
    quaternion = rng.normal(size=(count, 4))
    size = np.linalg.norm(quaternion, axis=1)
    angle = 2.0 * np.arccos(np.clip(np.abs(quaternion[:, 0]) / size, 0.0, 1.0))
    axis = quaternion[:, 1:] * np.sign(quaternion[:, :1])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return cga.motor_from_rotation_vector(
        axis * angle[:, None], centre + rng.uniform(-1.0, 1.0, (count, 3)) * mechanism.reach)


def point_pair(closure: Closure) -> FoundModes:
    """Return the modes of a machine that never turns: where three surfaces meet.

    They are those of its origin, and meet in a point pair ([PPM] eq. 5, 17). Surplus surfaces
    leave of the pair what closes by them too.

    Raises:
        NoResult: the centres are on one line; then there are infinitely many poses or none.
    """
    reach = closure.model.mechanism.reach
    for surfaces in origin_surfaces(closure):
        pair = cga.meet(*surfaces)
        flat, square = cga.middle(pair), cga.pair_radius_squared(pair)
        if np.isfinite(flat).all() and np.max(np.abs(flat)) <= 1e6 * reach:
            break
    else:
        raise NoResult("the centres of the three spheres are on one line: infinitely many poses "
                       "close at these joint values, or none", PLACE, "Choose other joint values")
    near = np.abs(square) < 1e-12 * reach * reach
    places = flat[None] if near else cga.coordinates(np.stack(cga.split(pair)[:2]))
    if not np.isfinite(places).all():
        places = np.zeros((0, 3))
    turn = np.broadcast_to(closure.model.mechanism.home_pose[3:], places.shape)
    return closing(closure, cga.motor_from_rotation_vector(turn, places))
