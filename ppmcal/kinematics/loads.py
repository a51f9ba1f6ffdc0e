"""The loads of actuators and limbs due to a wrench on the platform."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ppmcal import linalg
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.least_squares_closure import held_by, surplus
from ppmcal.linalg import Array, Bools, finite_rows, solve_rows
from ppmcal.model.mechanism import Mechanism

EVEN = 0.05
"""Tensions without a load count as none if their mean is below this part of their size."""
ROUNDS, LEAST = 60, 0.02
"""Rounds of a search for tensions, and minimum tension of a tight rope relative to the largest."""


def loads(model: Model, q: Array, pose: Array, wrench: Array) -> Array:
    """Return f = J_q^T wrench (N, k): the wrench's work per unit of each joint coordinate u.

    [LIN] section 2.3: -A^-1 Jq maps joint motion to the platform, its transpose maps
    the platform's wrench (N, 6), base axes at the platform origin, to the joints.
    """
    out = np.full((q.shape[0], len(model.mechanism.actuators)), np.nan)
    rows, closure, lines, reaction = _reaction(model, q, pose, wrench)
    if rows.size:
        jq = closure.joint_matrix(pose[rows], lines, drive=False)
        # f = -Jq^T A^-T w
        out[rows] = -(np.swapaxes(jq, -1, -2) @ reaction[..., None])[..., 0]
    return out


def limb_forces(model: Model, q: Array, pose: Array, wrench: Array) -> Array:
    """Return the force with which the platform pushes on each limb, and this on the base (N, L, 3).

    The wrench (N, 6) is the sum of A's lines times the reactions: a limb's share of it acts
    along the line of its closure, base axes, N.
    """
    out = np.full((q.shape[0], len(model.mechanism.limbs), 3), np.nan)
    rows, closure, lines, reaction = _reaction(model, q, pose, wrench)
    if rows.size:
        force = reaction[..., None] * lines[..., :3]
        first = np.cumsum([0, *(len(b.point_moves) for b in closure.bodies)])
        out[rows] = np.stack([force[:, a:b].sum(axis=1)
                              for a, b in pairwise(first)], axis=1)
    return out


def tensions(model: Model, q: Array, pose: Array, on: NDArray[np.bool_]) -> Array:
    """Return the tensions of the drives (N, k) if those ``on`` (k,) pull by 1 and the others hold.

    Without a wrench, A' f = 0; nan if the others cannot hold. As many pull as there are
    surplus equations.
    """
    out = np.full((q.shape[0], len(model.mechanism.actuators)), np.nan)
    rows = np.flatnonzero(finite_rows(q) & finite_rows(pose))
    if rows.size:
        closure = model.take(rows).closure(q[rows])
        lines = closure.lines(pose[rows])
        platform = np.swapaxes(closure.pose_matrix(pose[rows], lines), -1, -2)
        drives = -np.swapaxes(closure.joint_matrix(pose[rows], lines, drive=False), -1, -2)
        balance = np.concatenate([platform, drives[:, on]], axis=1)
        pulled = np.repeat([0.0, 1.0], [platform.shape[1], int(on.sum())])
        force = solve_rows(balance, np.broadcast_to(pulled, balance.shape[:2]))
        out[rows] = (drives @ force[..., None])[..., 0]
    return out


def rope_tensions(model: Model, q: Array, pose: Array, wrench: Array, measured: Array | None
                  ) -> Array:
    """Return the tension of each drive (N, k), N: as measured, else due to the wrench (N, 6).

    nan if surplus equations leave open how limbs pull against each other. Below 0 a
    rope would have to push.
    """
    if model.mechanism.surplus:
        by_load = np.full((q.shape[0], len(model.mechanism.actuators)), np.nan)
    else:
        by_load = loads(model, q, pose, wrench)
    return by_load if measured is None else np.where(np.isfinite(measured), measured, by_load)


def only_pull(mechanism: Mechanism) -> Bools:
    """Return which equations are of ropes (m,)."""
    return np.array([limb.kind.pulls_only for limb in mechanism.limbs
                     for _ in range(limb.kind.surface.equations)])


def even_tension(mechanism: Mechanism, a: Array, ropes: Bools, tension: float) -> Array:
    """Return forces (N, m) that balance each other, with ropes as even as possible, N.

    Their mean is ``tension``; nan if ropes cannot pull against each other.
    """
    basis = surplus(mechanism, a)
    even = (basis @ np.swapaxes(basis, -1, -2) @ ropes.astype(float)[..., None])[..., 0]
    mean = even[:, ropes].mean(axis=1)
    factor = np.where(mean > EVEN, tension / np.where(mean > EVEN, mean, 1.0), np.nan)
    return np.asarray(even * factor[:, None])


def pretensions(model: Model, q: Array, pose: Array) -> Array:
    """Return the tensions (N, k) of drives whose ropes pull evenly, by 1 on average, no load.

    nan if they cannot pull against each other, and for drives without ropes.
    """
    mechanism = model.mechanism
    out = np.full((q.shape[0], len(mechanism.actuators)), np.nan)
    rows = np.flatnonzero(finite_rows(q) & finite_rows(pose))
    ropes = [limb.actuator for limb in mechanism.limbs if limb.kind.pulls_only]
    if rows.size and ropes and mechanism.surplus:
        closure = model.take(rows).closure(q[rows])
        lines = closure.lines(pose[rows])
        force = even_tension(mechanism, closure.pose_matrix(pose[rows], lines),
                             only_pull(mechanism), 1.0)
        drives = -np.swapaxes(closure.joint_matrix(pose[rows], lines, drive=False), -1, -2)
        on = np.isin(np.arange(out.shape[1]), ropes)
        out[rows] = np.where(on, (drives @ force[..., None])[..., 0], np.nan)
    return out


def tight_ropes(model: Model, q: Array, pose: Array, weight: bool = False) -> Bools:
    """Return whether all ropes can pull against each other at poses (N, 8), (N,).

    This is the case if tensions of one sign hold the platform without a wrench, or with a
    ``weight`` at its origin: found by alternating projections between those that do (A' f = 0) and
    those above a minimum (von Neumann 1949).
    """
    a = model.closure(q).pose_matrix(pose)
    if weight:
        mechanism = model.mechanism
        down = -np.append(mechanism.gravity, np.zeros(3))[list(mechanism.dof)]
        a = np.concatenate([a, np.broadcast_to(down, (len(a), 1, len(down)))], axis=1)
    basis = linalg.column_basis(a)
    free = np.eye(basis.shape[-2]) - basis @ np.swapaxes(basis, -1, -2)
    force = np.ones(basis.shape[:-1])
    for _ in range(ROUNDS):
        force = (free @ np.maximum(force, LEAST)[..., None])[..., 0]
        force /= np.maximum(np.abs(force).max(axis=1, keepdims=True), 1e-300)
    return np.asarray((force > 0.5 * LEAST).all(axis=1))


def spans(model: Model, q: Array, pose: Array) -> Array:
    """Return the horizontal distance of the two points of each limb's first equation (N, L), m."""
    out = np.full((q.shape[0], len(model.mechanism.limbs)), np.nan)
    rows = np.flatnonzero(finite_rows(q) & finite_rows(pose))
    if rows.size:
        here = model.take(rows).closure(q[rows]).at(pose[rows])
        first = np.cumsum([0, *(len(b.point_moves) for b in here.bodies)])[:-1]
        away = (here.carried(pose[rows]) - here.fixed)[:, first, :3]
        down = model.mechanism.gravity
        out[rows] = np.linalg.norm(away - (away @ down)[..., None] * down, axis=-1)
    return out


def _reaction(model: Model, q: Array, pose: Array, wrench: Array
              ) -> tuple[NDArray[np.int64], Closure, Array, Array]:
    """Return usable rows (n,), their closure, lines and A^-T w (n, m).

    At a singular pose nothing holds the load: nan. Surplus limbs share it by the compliance of
    their drives if all have one; otherwise as if all were equally compliant.
    """
    rows = np.flatnonzero(finite_rows(q) & finite_rows(pose) & finite_rows(wrench))
    closure = model.take(rows).closure(q[rows])
    lines = closure.lines(pose[rows])
    a = closure.pose_matrix(pose[rows], lines)
    own = wrench[rows][:, model.mechanism.dof, None]
    gives, by = _gives(model), None
    if model.mechanism.surplus and np.all(gives > 0.0) and np.ptp(gives) > 0.0:
        by = closure.joint_matrix(pose[rows], lines, drive=False) * np.sqrt(gives)
    return rows, closure, lines, held_by(closure, pose[rows], a, own, lines, by)[..., 0]


def _gives(model: Model) -> Array:
    """Return the compliance of drives by effects, per unit of a small load (k,); 0 if rigid."""
    out = np.zeros(len(model.mechanism.actuators))
    for effect in model.mechanism.effects:
        if effect.kind.gives is not None:
            out[list(effect.on)] += effect.kind.gives(
                {name: float(model.parameters[p]) for name, p in effect.parameters.items()})
    return out
