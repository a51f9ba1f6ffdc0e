"""Where a machine with effects goes, and what to send so that it goes there.

Loads depend on the pose and, through compliance, the pose on the loads: the equilibrium
is found by repeating the forward kinematics with the loads of the previous pose, which
contracts by deflection over reach, some 1e-5, per round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import (
    ROUNDS,
    SETTLED,
    hopeless,
    shifted,
    shifted_once,
    slots_apart,
)
from ppmcal.kinematics.forward import (
    Forward,
    Minima,
    forward,
    least_of_minima,
    moved,
    newton,
)
from ppmcal.kinematics.inverse import inverse
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Environment, unknown_environment
from ppmcal.model.effects import Shift
from ppmcal.model.mechanism import Mechanism

GAPING_STEPS, STAYS = 4, 1e-3
"""Newton steps to joint values at which limbs gap; weight of platform motion against joints."""


def uses_load(mechanism: Mechanism) -> bool:
    """Whether an effect depends on the pose through the actuators' loads."""
    return any(e.kind.uses_load for e in mechanism.effects)


@dataclass(frozen=True)
class Reached:
    """Poses that a machine with effects takes.

    ``closed`` (N, 8): motors at which the limbs close; ``pose`` (N, 8): the platform's
    pose, including drift and frame compliance; ``model``: with its shift at these poses.
    """

    closed: Array
    pose: Array
    model: Model


def platform_pose(closed: Array, shift: Shift | None) -> Array:
    """Return closed poses (N, 8) displaced by the shift's platform twist."""
    if shift is None or shift.pose is None:
        return closed
    return moved(closed, shift.pose)


def reached_poses(model: Model, q: Array, environment: Environment | None = None,
                  start: Array | None = None, start_q: Array | None = None) -> Reached:
    """Return the equilibrium poses at joint values ``q`` (N, k); nan where there is none.

    Args:
        model: the machine at its parameters.
        q: joint values, SI.
        environment: of the rows; None if nothing is known.
        start: motors (N, 8) to start from, default home.
        start_q: joint values there.
    """
    rows = environment or unknown_environment(*q.shape)
    heavy = uses_load(model.mechanism)
    first = forward(model, q, start, start_q) if heavy or not model.mechanism.effects else None
    now = shifted(model, rows, q, first.pose if first else np.full((q.shape[0], 8), np.nan))
    if rows.stood is not None and not heavy and not row_known(now.shift, len(q)).any():
        # without an instrument, effects of the joints follow from the pose, so this settles
        heavy, first = True, forward(model, q, start, start_q)
        now = shifted(model, rows, q, first.pose)
    closed = first.pose if first and now is model else _forward(now, q, start, start_q).pose
    if heavy:
        closed, now = _settle(model, q, rows, closed)
    return Reached(closed, platform_pose(closed, now.shift), now)


def consistent_joints(model: Model, q: Array, environment: Environment) -> tuple[Array, Reached]:
    """Return joint values (N, k) near ``q`` at which all limbs close, and the poses.

    A machine with surplus equations cannot take arbitrary joint values: its encoders show where
    its limbs are. For other machines ``q`` itself.
    """
    real = reached_poses(model, q, environment)
    if not model.mechanism.surplus:
        return q, real
    for _ in range(ROUNDS):
        before, q = q, inverse(real.model, real.closed).q
        real = reached_poses(model, q, environment, real.closed, q)
        change = np.abs(q - before)[finite_rows(q)]
        if not np.any(change > SETTLED * model.mechanism.reach):
            break
    return q, real


def gaping(q: Array, real: Reached, gaps: Array) -> tuple[Array, Reached]:
    """Return joint values (N, k) at which limbs have given gaps (N, m), and the poses.

    Joints move by the gaps of their own limbs; if equations have no drive, or share one, so does
    the platform, by as little as possible.

    Args:
        q: joint values at which all limbs close.
        real: the poses there.
        gaps: true lengths; for equations between directions, their own values.
    """
    mechanism, closed = real.model.mechanism, real.closed.copy()
    rows = np.flatnonzero(finite_rows(closed) & finite_rows(q))
    q, model = q.copy(), real.model.take(rows)
    d = len(mechanism.dof)
    size = np.array([1.0 if c < 3 else mechanism.length_scale for c in mechanism.dof])
    for _ in range(GAPING_STEPS):
        closure, pose = model.closure(q[rows]), closed[rows]
        lines = closure.lines(pose)
        both = np.concatenate([closure.pose_matrix(pose, lines) / size * STAYS,
                               closure.joint_matrix(pose, lines) / mechanism.joint_ratios], axis=-1)
        step = (linalg.pinv(both) @ (gaps[rows] - closure.lengths(pose))[..., None])[..., 0]
        twist = np.zeros((len(rows), 6))
        twist[:, mechanism.dof] = step[:, :d] * STAYS / size
        closed[rows] = moved(pose, twist)
        q[rows] += step[:, d:] / mechanism.joint_ratios
    return q, Reached(closed, platform_pose(closed, real.model.shift), real.model)


def _forward(model: Model, q: Array, start: Array | None, start_q: Array | None) -> Forward:
    """Forward kinematics of the rows whose shift is known."""
    usable = row_known(model.shift, q.shape[0])
    return forward(model, np.where(usable[:, None], q, np.nan), start, start_q)


def row_known(shift: Shift | None, rows: int) -> NDArray[np.bool_]:
    """Return which rows have everything that their effects need (N,)."""
    usable = np.ones(rows, dtype=bool)
    if shift is not None:
        for value in (*shift.slots.values(), *([] if shift.pose is None else [shift.pose])):
            usable &= finite_rows(value.reshape(rows, int(np.prod(value.shape[1:]))))
    return usable


def settle(model: Model, q: Array, rows: Environment, closed: Array, wary: bool = True,
           minima: Minima | None = None) -> tuple[Array, Model]:
    """Return closed poses (N, 8) near ``closed`` with the effects in equilibrium, and the model.

    Rows that do not settle become nan.

    Args:
        model: the machine at its parameters.
        q: joint values (N, k).
        rows: the environment that effects depend on, N rows.
        closed: platform motors (N, 8) to start from, without the effects' own twist.
        wary: whether rows of surplus limbs that stand out are solved again.
        minima: those known during a fit, to which new ones are added.
    """
    now = shifted(model, rows, q, closed)
    n = q.shape[0]
    if not uses_load(model.mechanism):
        return _newton(now, q, closed, wary, minima), now
    return _settle(model, q, rows, _newton(now, q, np.where(
        row_known(now.shift, n)[:, None], closed, np.nan), wary, minima), wary, minima)


def _newton(model: Model, q: Array, closed: Array, wary: bool = True,
            minima: Minima | None = None) -> Array:
    """Solve the closure from warm poses; rows that fail are led from home."""
    out = np.full_like(closed, np.nan)
    rows = np.flatnonzero(finite_rows(closed) & finite_rows(q) & row_known(model.shift, q.shape[0]))
    if rows.size:
        of = rows.size if model.mechanism.surplus else 0
        found, converged, _ = newton(model.take(rows).closure(q[rows]), closed[rows])
        out[rows[converged]] = found[converged]
        lost = rows[~converged]
        if lost.size:
            out[lost] = forward(model.take(lost), q[lost], of=of).pose
        if wary and model.mechanism.surplus:
            out[rows] = least_of_minima(model.take(rows), q[rows], out[rows],
                                        unreached=~finite_rows(out[rows]), minima=minima)
    return out


def _settle(model: Model, q: Array, rows: Environment, closed: Array, wary: bool = True,
            minima: Minima | None = None) -> tuple[Array, Model]:
    """Iterate closure and loads to consistency; rows that cannot converge become nan at once.

    Only rows that still move are solved again, with loads once per round, so that the cost is that
    of the rows that need it. Whether a row settles is judged by its slots, because those of a round
    follow from the previous ones alone. A pose moves by the change of slots one round earlier, so
    pose and slots together would seem to rest in the first round.
    """
    reach = model.mechanism.reach
    now, closed = shifted_once(model, rows, q, closed), closed.copy()
    active = np.flatnonzero(finite_rows(closed))
    last = np.full(q.shape[0], np.inf)
    for left in range(ROUNDS - 1, -1, -1):
        new = _newton(now.take(active), q[active], closed[active], wary, minima)
        moved_by = np.abs(cga.translation(new) - cga.translation(closed[active])).max(axis=1)
        closed[active] = new
        before, now = now, shifted_once(now, rows, q, closed)
        change = slots_apart(before, now, q.shape[0])[active]
        lost = hopeless(change, last[active], SETTLED * reach, left, reach)
        last[active] = change
        unsettled = np.maximum(change, moved_by) > SETTLED * reach   # False for nan, no pose
        if not left:
            lost |= unsettled
        closed[active[lost]] = np.nan
        active = active[unsettled & ~lost]
        if not active.size:
            break
    return closed, now
