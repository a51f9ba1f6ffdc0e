"""How far apart two calibrations of a machine send its platform."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array, nearest_rotation
from ppmcal.model.mechanism import Mechanism

LEAST = 3
"""Fewest poses by which two machines are aligned."""
NEAR = 1e-3
"""Steps are reduced by this factor, and their effects scaled up again."""


@dataclass(frozen=True)
class PoseDifference:
    """Distances of poses at the same joint values, frames aligned; m and rad.

    ``position_chance``, ``rotation_chance``: rms due to noise alone, nan if unknown.
    """

    position_rms: float
    position_max: float
    rotation_rms: float
    rotation_max: float
    poses: int
    position_chance: float = math.nan
    rotation_chance: float = math.nan


def pose_difference(
    mechanism: Mechanism, places: Sequence[int], old: Array, new: Array, volume: Array,
    noise: Array,
) -> PoseDifference | None:
    """Return how far apart the poses of two machines are at the same joint values.

    Args:
        mechanism: the newer one.
        places: parameters that both found (F,).
        old: their values in the older one (F,), SI.
        new: in the newer one (F,), SI.
        volume: poses (N, 6) of the older in the base frame, at whose joint values to compare.
        noise: steps from the older values (D, F) drawn from noise alone.
    """
    def machine(value: Array) -> Model:
        g = mechanism.values.copy()
        g[list(places)] = value
        return Model(mechanism, g)

    first = machine(old)
    q = inverse_table(first, volume).q
    q = q[np.isfinite(q).all(axis=1)]
    if len(q) < LEAST:
        return None
    start, size = forward(first, q).pose, mechanism.length_scale
    found = _apart(start, forward(machine(new), q).pose, size)
    # far out in a direction that hardly shows, only its curvature would be seen
    drawn = [d for step in noise
             if (d := _apart(start, forward(machine(old + NEAR * step), q).pose, size))]
    if found is None or not drawn:
        return found
    position, rotation = (np.sqrt(np.mean([value**2 for value in values])) / NEAR for values in zip(
        *((d.position_rms, d.rotation_rms) for d in drawn), strict=True))
    return replace(found, position_chance=float(position), rotation_chance=float(rotation))


def _apart(one: Array, two: Array, size: float) -> PoseDifference | None:
    """Align poses (N, 8) with others by one rigid motion; points at ``size`` stand for rotations.

    Poses that only one of them has are left out; None if too few remain.
    """
    good = np.isfinite(one).all(axis=1) & np.isfinite(two).all(axis=1)
    if good.sum() < LEAST:
        return None
    one, two = one[good], two[good]
    corners = np.concatenate([np.zeros((1, 3)), size * np.eye(3)])
    a, b = (cga.translation(p)[:, None, :] + corners @ np.swapaxes(
        cga.rotation_matrix(p), -1, -2) for p in (one, two))
    flat_a, flat_b = a.reshape(-1, 3), b.reshape(-1, 3)
    middle_a, middle_b = flat_a.mean(axis=0), flat_b.mean(axis=0)
    turn = nearest_rotation((flat_a - middle_a).T @ (flat_b - middle_b))
    position = np.linalg.norm((b[:, 0] - middle_b) @ turn.T + middle_a - a[:, 0], axis=1)
    both = np.swapaxes(cga.rotation_matrix(one), -1, -2) @ turn @ cga.rotation_matrix(two)
    sine = np.linalg.norm(both - np.swapaxes(both, -1, -2), axis=(-2, -1)) / np.sqrt(8.0)
    rotation = np.arcsin(np.minimum(sine, 1.0))
    return PoseDifference(float(np.sqrt(np.mean(position**2))), float(position.max()),
                          float(np.sqrt(np.mean(rotation**2))), float(rotation.max()), len(one))
