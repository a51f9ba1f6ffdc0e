"""Which motions of the platform an instrument observes.

Touches of a flat do not show the position along it, a single target shows no rotation about it.
A term that moves the platform that way is not accepted, however well its small observed component
explains the residuals: commands would contain all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.knowledge import as_pose
from ppmcal.diagnosis.linear_system import System
from ppmcal.diagnosis.linearisation import WEAK_VISIBILITY
from ppmcal.linalg import Array

HALF = 0.5
"""Part of a displacement's square that has to be observed. For an observed error, a term at an
angle a to it corrects all of it and adds tan(a) of it across: beyond 45 deg the machine is worse
with the correction than without."""


@dataclass(frozen=True, eq=False)
class ObservedMotion:
    """The motion of the platform that the rows of a system observe.

    Attributes:
        seen: projector on the observed directions, lengths and arcs (6, 6).
        across: the platform's displacement with each joint (n, 6, k), by part of the system.
        joints: observed part of the platform's displacement with each joint, rms (k,).
    """

    seen: Array
    across: tuple[Array, ...]
    joints: Array

    def joint_seen(self, on: Sequence[bool]) -> bool:
        """Whether an error of these joints shows, given how each moves the platform."""
        return bool((self.joints[np.array(on)] > WEAK_VISIBILITY).all())

    def place_seen(self, coordinate: int) -> bool:
        """Whether a displacement of the platform along a coordinate is mostly observed."""
        return bool(self.seen[coordinate, coordinate] > HALF)

    def grams(self, weights: Sequence[Array], on: Sequence[bool]) -> tuple[Array, Array]:
        """Return inner products (K, K) of displacements by functions of joints, whole and observed.

        ``weights``: the functions in the rows (n, K), or by joint (n, k, K), by part.
        """
        count = weights[0].shape[-1]
        whole, seen = np.zeros((count, count)), np.zeros((count, count))
        for across, weight in zip(self.across, weights, strict=True):
            moved = np.zeros((*across.shape[:2], count))
            for a in np.flatnonzero(on):    # other joints may be outside its range
                own = weight if weight.ndim == 2 else weight[:, a]
                moved += across[..., a, None] * own[:, None]
            whole += _gram(moved)
            seen += _gram(self.seen @ moved)
        return whole, seen


def _gram(moved: Array) -> Array:
    flat = moved.reshape(-1, moved.shape[-1])
    return np.asarray(flat.T @ flat)


def observed_motion(system: System) -> ObservedMotion:
    """Return the platform's motion observed in rows; lengths and arcs at the platform's joints."""
    mechanism = system.problem.mechanism
    metric = np.array([1.0] * 3 + [mechanism.length_scale] * 3)
    seen = _seen(system, metric)
    across = tuple(np.stack([metric * as_pose(p.response).column(s) for s in p.of_joints], axis=-1)
                   for p in system.parts)
    whole = np.concatenate(across)
    felt, size = (np.sum(m**2, axis=(0, 1)) for m in (seen @ whole, whole))
    return ObservedMotion(seen, across, np.sqrt(felt / np.maximum(size, 1e-300)))


def _seen(system: System, metric: Array) -> Array:
    """Return the projector (6, 6) on the directions that measured values observe.

    Each value observes one direction, whatever its noise. A direction observed at most
    :data:`WEAK_VISIBILITY` times as well as the best one counts as blind.
    """
    total = np.zeros((6, 6))
    dof = np.isin(np.arange(6), system.problem.mechanism.dof)
    for part in system.parts:
        seen = part.response.seen
        looks = np.where(dof, seen.by_poses[part.response.end] / metric, 0.0)[seen.observed]
        length = np.linalg.norm(looks, axis=-1, keepdims=True)
        looks = looks / np.where(length > 0.0, length, 1.0)
        total += looks.T @ looks
    w, v = linalg.eigh(total)
    use = w > WEAK_VISIBILITY**2 * max(float(w[-1]), 1e-300)
    return np.asarray(v[:, use] @ v[:, use].T)
