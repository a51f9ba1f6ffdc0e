"""How far two calibrations of a machine send its platform apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.posterior import Earlier
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array, nearest_rotation
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True)
class PoseDifference:
    """How far poses at the same joints lie apart, frames laid on each other; m and rad."""

    position_rms: float
    position_max: float
    rotation_rms: float
    rotation_max: float
    poses: int


def pose_difference(
    mechanism: Mechanism, old: Earlier, new: Array, volume: Array
) -> PoseDifference | None:
    """Return how far the poses of two machines lie apart at the same joints.

    Args:
        mechanism: the newer one.
        old: what the earlier calibration knew, and at which values.
        new: values of the same parameters in the newer one (F,), SI.
        volume: poses (N, 6) of the older in the base frame, whose joints are compared.
    """
    ends = []
    g = mechanism.values.copy()
    g[list(old.places)] = old.value
    first = Model(mechanism, g)
    q = inverse_table(first, volume).q
    q = q[np.isfinite(q).all(axis=1)]
    if len(q) < 3:
        return None
    g = mechanism.values.copy()
    g[list(old.places)] = new
    for model in (first, Model(mechanism, g)):
        ends.append(forward(model, q).pose)
    good = np.isfinite(ends[0]).all(axis=1) & np.isfinite(ends[1]).all(axis=1)
    if good.sum() < 3:
        return None
    return _apart(ends[0][good], ends[1][good], mechanism.length_scale)


def _apart(one: Array, two: Array, size: float) -> PoseDifference:
    """Lay poses (N, 8) on others by one rigid motion; points at ``size`` stand for rotations."""
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
