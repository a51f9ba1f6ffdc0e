"""Rotation of an unknown measuring frame, from positions or from rotations, in closed form."""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array, nearest_rotation
from ppmcal.model.dataset import Dataset
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.registration import Registration

SEARCHED, REFINED, SEARCH_ROWS = 300, 5, 60
"""Frame rotations tried, those refined, and the rows that decide."""


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
    rigid = _nearest_rotation(b.T @ a, planar)
    if not data.target.fitted:
        return rigid
    some = np.linspace(0, len(origin) - 1, min(len(origin), SEARCH_ROWS)).astype(int)
    rows = rotation[some], origin[some], position[some]
    trials = [rigid, *_all_turns(planar)]
    misses = [_linear_miss(t, *rows)[0] for t in trials]
    best = [trials[i] for i in np.argsort(misses)[:REFINED]]
    refined = [_refined(t, *rows, planar) for t in best]
    return min(refined, key=lambda t: _linear_miss(t, *rows)[0])


def _all_turns(planar: bool) -> list[Array]:
    """Return rotations spread evenly over all (seeded quaternions; angles in the plane)."""
    if planar:
        angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
        return list(cga.rotation_matrix(cga.rotor(np.array([0.0, 0.0, 1.0]), angles)))
    quaternions = np.random.default_rng(0).normal(size=(SEARCHED, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return list(cga.rotation_matrix(cga.motor_from_quaternion(quaternions, np.zeros(3))))


def _linear_miss(turn: Array, rotation: Array, origin: Array, position: Array
                 ) -> tuple[float, Array, Array]:
    """Return the squared miss of a frame rotation, the residuals (n, 3) and the target (3,)."""
    n = origin.shape[0]
    matrix = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), turn @ rotation], axis=-1)
    right = (position - origin @ turn.T).reshape(-1)
    x = np.linalg.lstsq(matrix.reshape(-1, 6), right, rcond=1e-6)[0]
    residual = (right - matrix.reshape(-1, 6) @ x).reshape(n, 3)
    return float(np.sum(residual**2)), residual, x[3:]


def _refined(turn: Array, rotation: Array, origin: Array, position: Array, planar: bool) -> Array:
    """Gauss-Newton on the rotation, origin and target eliminated in each step."""
    for _ in range(25):
        before, residual, target = _linear_miss(turn, rotation, origin, position)
        n = origin.shape[0]
        seen = (origin + rotation @ target) @ turn.T
        by_turn = -cross_matrix(seen - seen.mean(axis=0))
        if planar:
            by_turn = by_turn * np.array([0.0, 0.0, 1.0])
        rest = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), turn @ rotation], axis=-1)
        matrix = np.concatenate([by_turn, rest], axis=-1).reshape(-1, 9)
        step = np.linalg.lstsq(matrix, residual.reshape(-1), rcond=1e-6)[0][:3]
        moved = cga.rotation_matrix(cga.motor_from_rotation_vector(step, np.zeros(3))) @ turn
        if _linear_miss(moved, rotation, origin, position)[0] >= before:
            break
        turn = moved
    return turn


def mean_rotation(rotations: Array, planar: bool) -> Array:
    """Return the mean of rotations (n, 3, 3): the proper one nearest to their sum."""
    return _nearest_rotation(rotations.sum(axis=0), planar)


def _nearest_rotation(matrix: Array, planar: bool) -> Array:
    """Return the proper rotation nearest to a 3x3 matrix; about z only in the plane."""
    if planar:
        angle = np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return nearest_rotation(matrix)
