"""How well a pose is held and moved: det A, singular values, dexterity.

Geometry only. Batched over N poses, chunk by chunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.least_squares_closure import closed_by
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism

CHUNK = 20_000
"""Poses evaluated at once."""
NO_LENGTH = 1e-7
"""A leg shorter than this part of the reach has no direction."""


@dataclass(frozen=True, eq=False)
class Quality:
    """Local measures of N poses, (N,) each; nan without joint values, or where a leg is a point.

    With rotation columns of A divided by :attr:`Mechanism.length_scale`, so that all are lengths:

    Attributes:
        determinant: det A.
        singular_value: the smallest of A
            (:func:`ppmcal.kinematics.forward.smallest_singular_value`).
        legs: smallest over largest singular value of A: how evenly the legs hold the platform.
        dexterity: smallest over largest singular value of the Jacobian from joint rates to the
            platform's twist, J = -A^-1 Jq, rotation rows multiplied by the length scale, joint
            angles counted as arcs at the length scale: 1/kappa(J), the local conditioning
            index of Gosselin, Angeles, "A global performance index for the kinematic
            optimization of robotic manipulators", J. Mech. Design 113(3), 1991. 1 is isotropic.
    """

    determinant: Array
    singular_value: Array
    legs: Array
    dexterity: Array


def measured(model: Model, q: Array, pose: Array) -> Quality:
    """Return the local measures of joint values (N, k) at poses (N, 6), chunk by chunk."""
    out = np.full((4, len(q)), np.nan)
    rows = np.flatnonzero(finite_rows(q) & finite_rows(pose))
    for i in range(0, len(rows), CHUNK):
        part = rows[i:i + CHUNK]
        out[:, part] = _measures(model, q[part], pose_motor(pose[part]))
    return Quality(out[0], out[1], out[2], out[3])


def _measures(model: Model, q: Array, pose: Array) -> Array:
    """Return the rows of :class:`Quality` (4, N) at motors (N, 8)."""
    mechanism = model.mechanism
    closure = model.closure(q)
    lines = closure.lines(pose)
    turns = [i for i, c in enumerate(mechanism.dof) if c >= 3]
    a = closure.pose_matrix(pose, lines).copy()
    a[..., turns] /= mechanism.length_scale
    determinant = linalg.determinant(a)
    of_a = linalg.singular_values(a)
    regular = of_a[:, -1] > 1e-14 * of_a[:, 0]
    jq = closure.joint_matrix(pose, lines) * _joint_scale(mechanism)
    safe = np.where(regular[:, None, None], a, np.eye(*a.shape[-2:]))
    of_j = linalg.singular_values(closed_by(closure, pose, safe, jq, lines))
    with np.errstate(invalid="ignore", divide="ignore"):
        dexterity = np.where(regular, of_j[:, -1] / of_j[:, 0], 0.0)
    out = np.stack([determinant, of_a[:, -1], of_a[:, -1] / of_a[:, 0], np.nan_to_num(dexterity)])
    # a leg without length has no line, and no side to be on
    spheres = closure.fixed[..., 4] * closure.moving[..., 4] != 0.0
    out[:, (spheres & (closure.radius < NO_LENGTH * mechanism.reach)).any(axis=1)] = np.nan
    return out


def _joint_scale(mechanism: Mechanism) -> Array:
    """Return what makes a joint value a length (k,): 1/ratio, angles by the length scale."""
    ratio = np.ones(len(mechanism.actuators))
    for limb in (mechanism.limbs[i] for i in reversed(mechanism.driven)):
        ratio[limb.actuator] = abs(limb.slots.values(mechanism.values).get("ratio", 1.0))
    length = [mechanism.length_scale if quantity == "angle" else 1.0
              for quantity in mechanism.actuator_quantity]
    return np.asarray(1.0 / (ratio * np.array(length)), dtype=float)
