"""Joints' zeros that moved between sessions: an endstop that slipped, a drive homed anew.

One shift per session and joint, asked as everything is: which of them are in the rows beside the
geometry, each by its probability. Rows that were left out of a session as outliers, most of them,
are taken back for the question.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.coverage import coverage_of, variances
from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.linearisation import to_prior
from ppmcal.calibration.fit.problem import Problem
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.priors import ALL_ALIKE, MOVED, SURE, WIDE
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior
from ppmcal.linalg import Array, Bools, Ints, reciprocals, subsample
from ppmcal.model.sessions import session_masks

MANY_OUT = 0.3
"""Rows left out count again where more than this part of their session was."""
SEEN = 3e-8
"""Directions of less than this part of the strongest are round-off."""
MOST = 20000
"""Shifts of zeros are looked for in at most so many rows, evenly spread."""


@dataclass(frozen=True)
class HomingShift:
    """A joint's zero in one session against the others: ``value`` +- ``sigma``, SI.

    ``half``: of the 95 % interval, the size of the noise not being known exactly.
    """

    session: str
    actuator: str
    value: float
    sigma: float
    half: float
    probability: float


def homing_shifts(fit: Fit) -> Iterator[HomingShift]:
    """Yield the joints' zeros that moved in one session against the others, of two the smaller."""
    sessions = _sessions(fit.problem)
    if len(sessions) < 2:
        return
    keep = _taken_back(fit, sessions)
    if len(sessions) == 2:    # what moved in one moved the other way in the other
        sessions = [min(reversed(sessions), key=lambda s: s[1].size)]
    names = fit.problem.mechanism.actuators
    rows, right, count = _reduced(fit, keep, [own for _, own in sessions])
    size = fit.scale.size
    held, away = fit.prior * fit.scale, to_prior(fit.problem, fit.state) / fit.scale
    one = np.log(float(MOVED) * (1.0 - float(ALL_ALIKE)) / len(names))
    every = np.log(float(MOVED) * float(ALL_ALIKE))
    joints = [(label, a) for label, _ in sessions for a in names]
    blocks = [Block(f"{a} of {label}", f"{a} of {label}", (n,), float(one), group=label)
              for n, (label, a) in enumerate(joints)]
    blocks += [Block(label, label, tuple(range(n * len(names), (n + 1) * len(names))), float(every))
               for n, (label, _) in enumerate(sessions) if len(names) > 1]
    found = posterior(Question(
        MatrixColumns(rows[:, size:]), right - rows[:, :size] @ away,
        rows[:, :size] * reciprocals(held, float(WIDE)), tuple(blocks),
        np.ones((right.size, 1), dtype=bool), np.zeros(right.size - 1, dtype=np.int64),
        measured=count))
    sure = [i for n, i in enumerate(found.best.chosen) if not any(
        m.probability > 1.0 - float(SURE) for m in found.members(n) if not m.family)]
    moved = sorted({c for i in sure for c in blocks[i].columns})
    probability = np.zeros(len(joints))
    for block, p in zip(blocks, found.probability.tolist(), strict=True):
        probability[list(block.columns)] += p
    if moved:
        yield from (HomingShift(*joints[c], value, sigma, half, min(float(probability[c]), 1.0))
                    for c, (value, sigma, half) in zip(moved, _fitted(
                        rows[:, [*range(size), *(size + c for c in moved)]], right, held, away,
                        count), strict=True))


def _fitted(rows: Array, right: Array, held: Array, away: Array, count: int
            ) -> Iterator[tuple[float, float, float]]:
    """Yield value, sigma and half of the 95 % interval of the columns after the C of a fit.

    Args:
        rows: reduced, of all columns.
        right: their residuals.
        held: weight of each of the C columns' distance from nominal.
        away: how far nominal is (C,).
        count: values behind the rows.
    """
    size = held.size
    whole = np.concatenate([rows, np.eye(size, rows.shape[1]) * held[:, None]])
    solved = linalg.pinv(whole, rcond=SEEN)
    step = solved @ np.concatenate([right, held * away])
    # what the rows then miss; tolerances give way too, which is no noise
    left = float(np.sum((right - rows @ step) ** 2))
    degrees = max(count - float(np.sum(rows * solved[:, :right.size].T)), 1.0)
    noise = max(1.0, left / degrees)
    times = coverage_of(variances(left / noise, degrees))
    for value, own in zip(step[size:].tolist(), solved[size:], strict=True):
        sigma = float(np.sqrt(noise) * np.linalg.norm(own))
        yield value, sigma, times * sigma


def _sessions(problem: Problem) -> list[tuple[str, Ints]]:
    """Return label and rows, numbered through all data sets, where zeros are taken as shared."""
    shared = np.concatenate([np.full(len(d), d.homing != "per-file") for d in problem.datasets])
    found = ((label, np.flatnonzero(np.concatenate(mask) & shared))
             for label, mask in session_masks(problem.datasets))
    return [(label, rows) for label, rows in found if rows.size]


def _taken_back(fit: Fit, sessions: Sequence[tuple[str, Ints]]) -> list[Bools]:
    """Return the rows for the test: those used, and all of a session that was mostly left out."""
    whole = np.concatenate(list(fit.keep))
    out = np.concatenate(fit.outliers)
    for _, rows in sessions:
        if out[rows].mean() > MANY_OUT:
            whole[rows] |= out[rows]
    return subsample(_by_dataset(whole, fit.keep), MOST)


def _by_dataset(whole: Bools, keep: Sequence[Bools]) -> list[Bools]:
    """Return a mask of all rows as one by data set, as long as those of ``keep``."""
    return np.split(whole, np.cumsum([len(k) for k in keep])[:-1])


def _reduced(fit: Fit, keep: Sequence[Bools], sessions: Sequence[Ints]
             ) -> tuple[Array, Array, int]:
    """Return the fit's rows, reduced: columns (k, C + S joints), residuals (k,), values behind.

    Its columns in natural units, then the shifts of all joints in each session, SI.
    """
    problem, joints = fit.problem, len(fit.problem.mechanism.actuators)
    homed = replace(problem, pivots=tuple(o.about for o in problem.opens), datasets=tuple(
        replace(d, homing="alone") if d.homing == "shared" else d for d in problem.datasets))
    own, size = [homed.columns.index(n) for n in problem.columns], fit.scale.size
    begin = np.cumsum([0, *(len(d) for d in problem.datasets)])
    session = np.full(begin[-1], -1)
    for s, rows in enumerate(sessions):
        session[rows] = s
    stack, count = np.zeros((0, size + len(sessions) * joints + 1)), 0.0
    if problem.earlier is not None:
        missed, slope = problem.earlier.rows(problem.mechanism, list(problem.free), fit.state.g)
        stack = np.zeros((missed.size, stack.shape[1]))
        stack[:, :len(problem.free)] = slope * fit.scale[:len(problem.free)]
        stack[:, -1], count = missed, missed.size
    for part in homed.rows(fit.state, True, keep):
        block = np.zeros((*part.residual.shape, stack.shape[1]))
        block[..., :size], block[..., -1] = part.jacobian[..., own] * fit.scale, part.residual
        mine = session[begin[part.dataset] + part.index]
        for s in range(len(sessions)):
            at = size + s * joints
            block[mine == s, :, at:at + joints] = part.jacobian[
                mine == s][..., homed.opens[part.dataset].homing]
        stack = linalg.triangle(np.concatenate([stack, block.reshape(-1, stack.shape[1])]))
        count += part.count
    return stack[:, :-1], stack[:, -1], round(count)
