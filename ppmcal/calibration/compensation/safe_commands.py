"""Commands that are safe to send: each better than none, and each reached on a safe way.

A row is refused if its corrected command is predicted to be worse than the uncorrected one, in
position or in rotation and with the uncertainty in both errors, or if the way to it from the
previous row that is not refused leaves limits, meets a singularity, or is a jump that the targets
do not make.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.compensation.commands import KINDS, NOTHING, Compensation
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.ways import Ways
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import stage

WORSE = 1.01
"""Errors within this factor are equal: the model's uncertainty is predicted linearly."""
JUMP = 0.25
"""A correction may change between rows by this part of the targets' own step in the joints."""
MOST_AHEAD = 12
"""Maximum number of times that the rows tried after a refused one are doubled."""
PATIENCE = 1000
"""Rounds in which refusals are taken back; if ways fail more often, too many rows are refused."""
Judge = Callable[[Ints, Ints], dict[int, str]]


def refused(found: Compensation, rows: Mapping[int, str]) -> Compensation:
    """Return the commands without those of ``rows``: index -> reason; predictions stay."""
    if not rows:
        return found
    gone = np.zeros(len(found.status), dtype=np.bool_)
    gone[list(rows)] = True
    status, reason = list(found.status), list(found.reason)
    for n, why in rows.items():
        status[n], reason[n] = "refused", why
    return replace(found, q=np.where(gone[:, None], np.nan, found.q),
                   command=np.where(gone[:, None], np.nan, found.command),
                   status=tuple(status), reason=tuple(reason))


def sent(found: Compensation) -> Bools:
    """Return which rows have a command (N,)."""
    return np.array([s == "ok" for s in found.status], dtype=np.bool_) & finite_rows(found.q)


def worse_rows(mechanism: Mechanism, found: Compensation) -> dict[int, str]:
    """Return the rows whose correction is predicted to be worse than none: index -> reason.

    By :data:`WORSE`, in position or in rotation; the model's uncertainty is in the errors
    with and without correction. Rows whose remaining error cannot be predicted are included.
    """
    unknown = np.flatnonzero(sent(found) & np.isnan(found.position_after))
    out = dict.fromkeys(unknown.tolist(), "the remaining error cannot be predicted: on the way "
                        "from home, the joints meet a singularity or leave their reach")
    for kind, quantity in reversed(KINDS.items()):
        before, after = found.expected(kind)
        after = np.where(np.isnan(after), getattr(found, f"{kind}_after"), after)
        factor, unit = mechanism.units.factor(quantity), mechanism.units.name(quantity)
        for n in np.flatnonzero(sent(found) & is_worse(mechanism, kind, before, after)).tolist():
            out[n] = ("the correction is predicted to be worse than none: "
                      f"{after[n] / factor:.3g} {unit} of {kind} with it, {before[n] / factor:.3g} "
                      f"{unit} without, including the model's uncertainty")
    return out


def is_worse(mechanism: Mechanism, kind: str, before: Array, after: Array) -> Bools:
    """Return where errors ``after`` correction exceed those ``before``, m or rad.

    For ``position`` or ``rotation``; errors below :data:`NOTHING`, or nan, do not.
    """
    least = NOTHING * (mechanism.reach if kind == "position" else 1.0)
    with np.errstate(invalid="ignore"):
        return np.asarray((after > WORSE * before) & (after > least))


@dataclass(frozen=True)
class Steps:
    """How far commands step beyond the targets' own steps, from row to row.

    ``rows``: indices of the later row (M,); ``beyond``: change of the worst joint's
    correction, m or rad (M,), 0 if less than :data:`JUMP` of the targets' own step;
    ``joint``: its index (M,).
    """

    rows: Ints
    beyond: Array
    joint: Ints


def _added_steps(mechanism: Mechanism, added: Array, nominal: Array, before: Ints, after: Ints
                 ) -> Steps:
    """Return how far corrections ``added`` (N, k) step beyond the nominal joints' own steps."""
    ratio = mechanism.joint_ratios
    own = np.abs(nominal[after] - nominal[before]) * ratio
    step = np.abs(added[after] - added[before]) * ratio
    beyond = np.zeros_like(step)
    for quantity in set(mechanism.actuator_quantity):
        mine = [q == quantity for q in mechanism.actuator_quantity]
        least = NOTHING * (mechanism.reach if quantity == "length" else 1.0)
        beyond[:, mine] = step[:, mine] - JUMP * own[:, mine].max(axis=1, keepdims=True) - least
    beyond = np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)
    joint = beyond.argmax(axis=1)
    return Steps(after, np.where(beyond.max(axis=1) > 0.0, step[np.arange(len(step)), joint], 0.0),
                 joint)


@stage("checking the ways between targets")
def unsafe_ways(mechanism: Mechanism, found: Compensation) -> dict[int, str]:
    """Return the rows that cannot be reached safely from the previous row: index -> reason.

    The previous row is the last one not refused; the first row may be reached from anywhere.
    """
    rows = np.flatnonzero(sent(found) & finite_rows(found.pose))
    if len(rows) < 2:
        return {}
    motor = np.full((len(found.q), 8), np.nan)
    motor[rows] = pose_motor(found.pose[rows])
    ways = Ways(mechanism, motor, found.q)

    def judge(before: Ints, after: Ints) -> dict[int, str]:
        # for the geometry only: a reversal, a warmer or a heavier row may step, as an effect
        return {**_jumps(mechanism, ways.q, found.q_nominal, before, after),
                **ways.judged(before, after)}

    return _followed(rows, judge)


def _jumps(mechanism: Mechanism, q: Array, nominal: Array, before: Ints, after: Ints
           ) -> dict[int, str]:
    """Return which steps from row to row (M,) are jumps, and why."""
    out = {}
    steps = _added_steps(mechanism, q - nominal, nominal, before, after)
    units = mechanism.joint_units
    for n in np.flatnonzero(steps.beyond > 0.0):
        j = int(steps.joint[n])
        size = abs(q[after[n], j] - q[before[n], j]) / units[j][0]
        out[int(n)] = (f"{mechanism.actuators[j]} would jump by {size:.6g} {units[j][1]}".rstrip()
                       + f" from row {before[n] + 1}, beyond the targets' own step")
    angle = [a == "angle" for a in mechanism.actuator_quantity]
    turn = np.where(angle, np.abs(q[after] - q[before]) * mechanism.joint_ratios, 0.0)
    for n in np.flatnonzero((turn > np.pi).any(axis=1)):
        j = int(turn[n].argmax())
        out[int(n)] = (f"{mechanism.actuators[j]} would turn by {np.degrees(turn[n, j]):.4g} deg "
                       f"from row {before[n] + 1}, the long way round")
    return out


def _followed(rows: Ints, judge: Judge) -> dict[int, str]:
    """Return which rows cannot be reached safely, in one pass in their order: row -> reason.

    Every row is judged from the previous one that is not refused, all of them together:
    after a refused row, twice as many are tried each time. Rows refused from a row that is then
    refused itself are judged again, and so are those refused across it.
    """
    alive = np.ones(len(rows), dtype=np.bool_)
    come_from, refused_from = np.full(len(rows), -1), np.full(len(rows), -1)
    reason: dict[int, str] = {}
    patience = PATIENCE
    tries = np.ones(len(rows), dtype=np.int64)
    wrong = judge(rows[:-1], rows[1:])
    sound = np.setdiff1d(np.arange(len(rows) - 1), list(wrong))
    come_from[sound + 1] = sound
    while True:
        index = np.flatnonzero(alive)
        open_ = np.flatnonzero(come_from[index[1:]] != index[:-1])
        if not open_.size:
            return {int(rows[n]): reason[n] for n in np.flatnonzero(~alive).tolist()}
        ahead = 2 ** np.minimum(tries[index[open_]], MOST_AHEAD)
        # where tries of rows overlap, the first row goes first
        apart = np.concatenate([[True], open_[1:] > np.maximum.accumulate(open_ + ahead)[:-1]])
        open_, ahead = open_[apart], np.minimum(ahead[apart], len(index) - 1 - open_[apart])
        start = np.cumsum(ahead) - ahead
        step = np.arange(int(ahead.sum())) - np.repeat(start, ahead)
        before = index[np.repeat(open_, ahead)]
        after = index[np.repeat(open_, ahead) + 1 + step]
        wrong = judge(rows[before], rows[after])
        good = np.ones(len(after), dtype=np.bool_)
        good[list(wrong)] = False
        first = np.minimum.reduceat(np.where(good, step, len(rows)), start)
        lost = np.flatnonzero(step < np.repeat(first, ahead))
        reason.update((int(after[n]), wrong[n]) for n in lost.tolist())
        alive[after[lost]], refused_from[after[lost]] = False, before[lost]
        again = ~alive & np.isin(refused_from, after[lost])
        patience -= 1
        while patience > 0 and again.any():
            alive[again], come_from[again] = True, -1
            # a row that is back is between others and the row from which they were refused
            back = np.cumsum(again)
            again = ~alive & (back > back[np.maximum(refused_from, 0)])
        reached = first < len(rows)
        come_from[index[open_[reached] + 1 + first[reached]]] = index[open_[reached]]
        tries[index[open_]] += 1


def own_steps(mechanism: Mechanism, found: Compensation) -> Steps:
    """Return how far commands step beyond their targets, due to conditions of the rows."""
    rows = np.flatnonzero(sent(found))
    return _added_steps(mechanism, found.q - found.q_nominal, found.q_nominal, rows[:-1], rows[1:])
