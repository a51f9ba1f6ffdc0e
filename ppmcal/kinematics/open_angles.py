"""Poses with some Euler angles or positions left open, through gimbal lock.

The open coordinates and the joints are solved for, and the named ones hold by construction: the
rotation of an open angle is a twist in every pose, even where the other two rotate about one axis.
So a tripod's tilt and azimuth (``euler-ZXZ`` with the third angle open) are found at home too,
where the azimuth has no rate.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.registration import carried_back, measured_pose
from ppmcal.kinematics.rotations import euler_rates, from_euler
from ppmcal.linalg import Array, Ints, finite_rows, solve_rows
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.registration import Registration

ITERATIONS = 50
TRIED = {0: 1, 1: 24, 2: 12, 3: 8}
"""Number of values tried for each open angle, by number of angles, to get closest to home."""
TURN = 0.5
"""Maximum change of open angles in one step, rad."""
CLOSED = 1e-12


def solve_open_angles(model: Model, registration: Registration, wanted: Array,
                      open_: NDArray[np.bool_], euler: str
                      ) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Newton on the open coordinates and the joints.

    Args:
        model: one machine, or one for each row.
        registration: the wanted point, and its frame.
        wanted: measured poses (N, 6), rotations as Euler angles.
        open_: coordinates that are not named (N, 6), equally many in every row.
        euler: convention of the angles.

    Returns:
        platform poses (N, 6), joint values (N, k), and which rows are solved (N,).
    """
    mechanism, n = model.mechanism, len(wanted)
    at, q = _starts(model, registration, wanted, open_, euler), home_state(mechanism).q
    q = np.tile(q, (n, 1))
    pick = np.argsort(~open_, axis=1, kind="stable")[:, :int(open_[0].sum())]
    solved, pose = np.zeros(n, dtype=bool), np.tile(mechanism.home, (n, 1))
    for _ in range(ITERATIONS):
        turned = np.concatenate([at[:, :3], from_euler(at[:, 3:], euler)], axis=1)
        pose = carried_back(mechanism, registration, turned)
        closure = model.closure(q)
        lines, c = closure.lines(pose), closure.misclosure(pose)
        solved = np.max(np.abs(c), axis=1) < CLOSED * mechanism.reach
        matrix = closure.pose_matrix(pose, lines) @ _twists(registration, pose, at, pick, euler)
        step = -solve_rows(np.concatenate([matrix, closure.joint_matrix(pose, lines)], axis=-1), c)
        good = finite_rows(step)
        if solved.all() or not good[~solved].any():
            break
        step[~good | solved] = 0.0
        turning = np.where(pick >= 3, step[:, :pick.shape[1]], 0.0)
        step *= np.minimum(1.0, TURN / np.maximum(np.max(np.abs(turning), axis=1), TURN))[:, None]
        rows = np.arange(n)[:, None]
        at[rows, pick] += step[:, :pick.shape[1]]
        q = q + step[:, pick.shape[1]:]
    return (np.concatenate([cga.translation(pose), cga.rotation_vector(pose)], axis=-1), q, solved)


def _starts(model: Model, registration: Registration, wanted: Array, open_: NDArray[np.bool_],
            euler: str) -> Array:
    """Return coordinates (N, 6) with the open ones as near to home as the named ones allow."""
    home = measured_pose(registration, model.mechanism.home[None])[0]
    out = np.where(open_, 0.0, np.nan_to_num(wanted))
    out[:, :3] = np.where(open_[:, :3], home[:3], out[:, :3])
    own = cga.motor_from_rotation_vector(home[3:], np.zeros(3))
    for pattern in np.unique(open_[:, 3:], axis=0):
        mine = np.flatnonzero((open_[:, 3:] == pattern).all(axis=1))
        angles = np.flatnonzero(pattern)
        each = np.linspace(-np.pi, np.pi, TRIED[len(angles)], endpoint=False)
        nearest, best = np.full(len(mine), np.inf), out[mine]
        for values in product(each, repeat=len(angles)):
            tried = out[mine]
            tried[:, 3 + angles] = values
            turned = cga.motor_from_rotation_vector(from_euler(tried[:, 3:], euler), np.zeros(3))
            away = np.linalg.norm(cga.rotation_vector(cga.compose(cga.reverse(own), turned)),
                                  axis=-1)
            best = np.where((away < nearest)[:, None], tried, best)
            nearest = np.minimum(away, nearest)
        out[mine] = best
    return out


def _twists(registration: Registration, pose: Array, at: Array, pick: Ints, euler: str) -> Array:
    """Return (N, 6, open) platform twists of the open coordinates, base axes, about its origin."""
    back = cga.rotation_matrix(cga.reverse(registration.frame))
    arm = (cga.rotation_matrix(pose) @ registration.target[..., None])[..., 0]
    every = np.zeros((len(pose), 6, 6))
    every[:, :3, :3] = back / registration.scale
    every[:, 3:, 3:] = back @ euler_rates(at[:, 3:], euler)
    # the tool point stays in place as the platform rotates: v = r x w
    every[:, :3, 3:] = cross_matrix(arm) @ every[:, 3:, 3:]
    return np.take_along_axis(every, pick[:, None, :], axis=2)
