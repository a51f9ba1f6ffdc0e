"""Rotation of an unknown measuring frame, from positions or from rotations, in closed form."""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.linalg import Array, nearest_rotation
from ppmcal.model.dataset import Dataset
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.registration import Registration

SEARCHED, REFINED, STEPS, DECIDING = 300, 5, 25, 2000
"""Frame rotations tried, those refined, at most so many steps, and the rows that decide."""
NEGLIGIBLE = 1e-6
"""Singular values below this part of the largest count as none."""


def frame_turn(data: Dataset, rotation: Array, origin: Array, position: Array,
               registration: Registration, planar: bool) -> Array:
    """Return the frame's rotation (3, 3) from positions alone.

    With a known target: the rigid alignment of the points (Kabsch). With an unknown one the
    points are not known, and a machine that hardly moves sideways has no use for its
    platform's origins; then the rotation is searched, frame origin and target being linear.

    Args:
        data: says whether the target is known.
        rotation: of the platform in the base frame (n, 3, 3).
        origin: of the platform in the base frame (n, 3), m.
        position: as measured (n, 3), m.
        registration: holds the target where it is known.
        planar: turn about z only.
    """
    points = origin if data.target.fitted else origin + rotation @ registration.target
    a, b = points - points.mean(axis=0), position - position.mean(axis=0)
    rigid = nearest_rotation(b.T @ a, planar)
    if not data.target.fitted:
        return rigid
    some = np.linspace(0, len(origin) - 1, min(len(origin), DECIDING)).astype(int)
    form = _miss_form(rotation[some], origin[some], position[some])
    trials = np.concatenate([rigid[None], _all_turns(planar)])
    best = trials[np.argsort(_miss(form, trials), kind="stable")[:REFINED]]
    refined = _refined(form, best, planar)
    return np.asarray(refined[np.argmin(_miss(form, refined))])


def _all_turns(planar: bool) -> Array:
    """Return rotations (t, 3, 3) spread over all: seeded quaternions; angles in the plane."""
    if planar:
        angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
        return cga.rotation_matrix(cga.rotor(np.array([0.0, 0.0, 1.0]), angles))
    quaternions = np.random.default_rng(0).normal(size=(SEARCHED, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return cga.rotation_matrix(cga.motor_from_quaternion(quaternions, np.zeros(3)))


def _miss_form(rotation: Array, origin: Array, position: Array) -> Array:
    """Return F (k, 10): a rotation T of the frame misses by ``|F [vec T, 1]|``, at its best.

    Turned back into the base, position i is ``T' y_i = s + o_i + R_i t``: what the frame's
    origin s and the target t do does not depend on T, and is taken off once for all rotations.
    """
    n = origin.shape[0]
    y, o = position - position.mean(axis=0), origin - origin.mean(axis=0)
    by_turn = np.einsum("nj,ik->nijk", y, np.eye(3)).reshape(-1, 9)
    matrix = np.concatenate([by_turn, -o.reshape(-1, 1)], axis=1)
    rest = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), rotation], axis=-1)
    left, size, _ = linalg.svd(rest.reshape(-1, 6))
    basis = left[:, size > NEGLIGIBLE * size[0]]
    return linalg.triangle(matrix - basis @ (basis.T @ matrix))


def _residual(form: Array, turns: Array) -> Array:
    """Return the residuals (t, k) of rotations (t, 3, 3)."""
    return np.asarray(turns.reshape(-1, 9) @ form[:, :9].T + form[:, 9])


def _miss(form: Array, turns: Array) -> Array:
    """Return the squared misses (t,) of rotations (t, 3, 3)."""
    return np.asarray(np.sum(_residual(form, turns) ** 2, axis=1))


def _refined(form: Array, turns: Array, planar: bool) -> Array:
    """Gauss-Newton on rotations (t, 3, 3) at once; each stops where a step no longer helps."""
    axes = cross_matrix(np.eye(3))[2:] if planar else cross_matrix(np.eye(3))
    missed = _miss(form, turns)
    for _ in range(STEPS):
        by_turn = (axes @ turns[:, None]).reshape(len(turns), len(axes), 9) @ form[:, :9].T
        step = np.einsum("tak,tk->ta", -linalg.pinv(np.swapaxes(by_turn, 1, 2), NEGLIGIBLE),
                         _residual(form, turns))
        vector = np.zeros((len(turns), 3))
        vector[:, -len(axes):] = step
        moved = cga.rotation_matrix(cga.motor_from_rotation_vector(vector, np.zeros(3))) @ turns
        miss = _miss(form, moved)
        better = miss < missed
        if not better.any():
            break
        turns = np.where(better[:, None, None], moved, turns)
        missed = np.where(better, miss, missed)
    return turns


def mean_rotation(rotations: Array, planar: bool) -> Array:
    """Return the mean of rotations (n, 3, 3): the proper one nearest to their sum."""
    return nearest_rotation(rotations.sum(axis=0), planar)
