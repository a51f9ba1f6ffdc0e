"""Poses about home, one coordinate after the other: how a machine moves when commanded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal.errors import LinearAlgebraError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_attempt
from ppmcal.kinematics.partial_pose import inverse_partial, named_only, pose_vector
from ppmcal.linalg import Array, Bools
from ppmcal.model.mechanism import Mechanism

PART_OF_REACH = 0.1
"""Distance by which a coordinate is moved, relative to the reach."""
MOST_TURN = 0.35
"""Maximum rotation, rad."""
HALVINGS = 5
STEPS = (0.5, 1.0)


@dataclass(frozen=True)
class PoseSweep:
    """Home, and each coordinate moved down and up from it.

    Attributes:
        coordinate: index of the moved coordinate, -1 at home, (N,); step: by how much, m or rad.
        pose: full platform poses (N, 6); q: joint values (N, k), SI.
        still: indices of coordinates that could not be moved: the machine determines them, or
            every step is out of reach or beyond the limits.
        lost: indices of limbs that do not reach home; then home is the only pose, as far as
            each limb goes.
    """

    coordinate: tuple[int, ...]
    step: Array
    pose: Array
    q: Array
    still: tuple[int, ...]
    lost: tuple[int, ...] = ()


def pose_sweep(model: Model) -> PoseSweep:
    """Return home and poses about it that the machine reaches within its limits.

    Each coordinate is moved by a tenth of the reach (a rotation by as much at the platform's
    joints), or by a half, a quarter, ... of that, with a pose at half the distance.
    """
    mechanism = model.mechanism
    state = home_attempt(mechanism)
    if state.lost:
        return PoseSweep((-1,), np.zeros(1), mechanism.home_pose[None], state.q[None],
                         mechanism.dof, state.lost)
    asked, labels = _asked(mechanism)
    found = inverse_partial(model, asked)
    good = found.reached & _within_limits(mechanism, found.q, state.q)
    rows: list[int] = []
    still = []
    for c in mechanism.dof:
        own = []
        for sign in (-1.0, 1.0):
            for halved in range(HALVINGS):
                tried = [n for n, label in enumerate(labels) if label == (c, sign, halved)]
                if tried and all(good[tried]):
                    own += tried[::-1] if sign < 0.0 else tried
                    break
        rows += own
        still += [] if own else [c]
    coordinate = (-1, *(int(labels[n][0]) for n in rows))
    at_home = mechanism.home_pose
    step = [0.0, *(float(asked[n, labels[n][0]] - at_home[labels[n][0]]) for n in rows)]
    pose = np.concatenate([at_home[None], pose_vector(found.pose[rows])])
    return PoseSweep(coordinate, np.array(step), pose,
                     np.concatenate([state.q[None], found.q[rows]]), tuple(still))


def _asked(mechanism: Mechanism) -> tuple[Array, list[tuple[int, float, int]]]:
    """Return poses to try (N, 6), each with its coordinate, sign and number of halvings."""
    home = np.array(mechanism.home_pose)
    if mechanism.dependent:
        try:
            home = named_only(mechanism, home[None])[0]
        except LinearAlgebraError:
            return np.zeros((0, 6)), []
    size = PART_OF_REACH * mechanism.reach
    asked, labels = [], []
    for c in mechanism.dof:
        if np.isnan(home[c]):
            continue
        most = size if c < 3 else min(size / mechanism.length_scale, MOST_TURN)
        for sign in (-1.0, 1.0):
            for halved in range(HALVINGS):
                for part in STEPS:
                    row = home.copy()
                    row[c] += sign * part * most / 2.0**halved
                    asked.append(row)
                    labels.append((c, sign, halved))
    return np.reshape(asked, (-1, 6)), labels


def _within_limits(mechanism: Mechanism, q: Array, home_q: Array) -> Bools:
    """Return which rows (N,) keep the limits of those joints that keep them at home."""
    low, high = mechanism.limits.T
    kept = (home_q >= low) & (home_q <= high)
    return np.asarray((((q >= low) & (q <= high)) | ~kept).all(axis=1), dtype=np.bool_)
