"""Joint zeros that moved between sessions: an endstop that slipped, a drive homed again.

One shift per session and joint; which of them are in the rows beside the geometry is decided by
probability, as elsewhere. If most rows of a session were left out as outliers, they are taken
back for this decision.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.added_columns import AddedColumns, added_columns
from ppmcal.calibration.fit.coverage import coverage_of, variances
from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.problem import Problem
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.priors import ALL_ALIKE, MOVED, SURE
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior
from ppmcal.linalg import Bools
from ppmcal.model.sessions import session_masks
from ppmcal.units import Finite, OfUnit

MANY_OUT = 0.3
"""Rows left out count again if more than this part of their session was left out."""
SEEN = 3e-8
"""Directions below this part of the strongest are round-off."""


@dataclass(frozen=True)
class HomingShift:
    """A joint's zero in one session relative to the others: ``value`` +- ``sigma``, SI.

    ``half``: half width of the 95 % interval, with the size of the noise uncertain;
    ``unit``: the joint's, once it is set.
    """

    session: str
    actuator: str
    value: OfUnit[Finite]
    sigma: OfUnit[Finite]
    unit: str = field(default="", kw_only=True)
    probability: Finite
    half: OfUnit[Finite]


def homing_shifts(fit: Fit) -> Iterator[HomingShift]:
    """Yield the joint zeros that moved in one session against the others; of two, the smaller."""
    sessions = _sessions(fit.problem)
    if len(sessions) < 2:
        return
    keep = _taken_back(fit, sessions)
    if len(sessions) == 2:    # a shift in one is the opposite shift in the other
        sessions = [min(reversed(sessions), key=lambda s: sum(map(np.sum, s[1])))]
    problem, names = fit.problem, fit.problem.mechanism.actuators
    homed = problem.changed(datasets=tuple(
        replace(d, homing="alone") if d.homing == "shared" else d for d in problem.datasets))
    rows = added_columns(problem, fit.state, keep, fit.prior, homed, [
        {i: (o.homing, m) for i, (o, m) in enumerate(zip(homed.opens, masks, strict=True))
         if m.any()} for _, masks in sessions])
    joints = [(label, a) for label, _ in sessions for a in names]
    moved = _moved(rows, joints, len(names))
    if moved:
        yield from (HomingShift(*joints[c], value, sigma, p, half)
                    for (c, p), (value, sigma, half) in zip(
                        moved.items(), _fitted(rows, list(moved)), strict=True))


def _moved(rows: AddedColumns, joints: Sequence[tuple[str, str]], each: int) -> dict[int, float]:
    """Return which session joints surely moved, and how likely; ``each``: joints a session."""
    one = float(np.log(float(MOVED) * (1.0 - float(ALL_ALIKE)) / each))
    every = float(np.log(float(MOVED) * float(ALL_ALIKE)))
    blocks = [Block(f"{a} of {label}", f"{a} of {label}", (n,), one, group=label)
              for n, (label, a) in enumerate(joints)]
    blocks += [Block(joints[n][0], joints[n][0], tuple(range(n, n + each)), every)
               for n in range(0, len(joints), each) if each > 1]
    found = posterior(Question(
        MatrixColumns(rows.added), rows.values, rows.geometry, tuple(blocks),
        np.ones((rows.right.size, 1), dtype=bool), np.zeros(rows.right.size - 1, dtype=np.int64),
        measured=rows.count))
    sure = [i for n, i in enumerate(found.best.chosen) if not any(
        m.probability > 1.0 - float(SURE) for m in found.members(n) if not m.family)]
    own = {c for i in sure for c in blocks[i].columns}
    return {c: min(sum(float(p) for b, p in zip(blocks, found.probability, strict=True)
                       if c in b.columns), 1.0) for c in sorted(own)}


def _fitted(found: AddedColumns, some: Sequence[int]) -> Iterator[tuple[float, float, float]]:
    """Yield value, sigma and half width of the 95 % interval of some of the added columns."""
    size, right = found.held.size, found.right
    rows = np.concatenate([found.rows, found.added[:, some]], axis=1)
    whole = np.concatenate([rows, np.eye(size, rows.shape[1]) * found.held[:, None]])
    solved = linalg.pinv(whole, rcond=SEEN)
    step = solved @ np.concatenate([right, found.held * found.away])
    # residuals of the rows alone: tolerances give way too, which is not noise
    left = float(np.sum((right - rows @ step) ** 2))
    degrees = max(found.count - float(np.sum(rows * solved[:, :right.size].T)), 1.0)
    noise = max(1.0, left / degrees)
    times = coverage_of(variances(left / noise, degrees))
    for value, own in zip(step[size:].tolist(), solved[size:], strict=True):
        sigma = float(np.sqrt(noise) * np.linalg.norm(own))
        yield value, sigma, times * sigma


def _sessions(problem: Problem) -> list[tuple[str, list[Bools]]]:
    """Return label and rows (N,) by data set of each session whose zeros are taken as shared."""
    found = ((label, [m & (d.homing != "per-file") for m, d in zip(
        mask, problem.datasets, strict=True)]) for label, mask in session_masks(problem.datasets))
    return [(label, masks) for label, masks in found if any(m.any() for m in masks)]


def _taken_back(fit: Fit, sessions: Sequence[tuple[str, Sequence[Bools]]]) -> list[Bools]:
    """Return the rows to judge by: those used, and all of a session that was mostly left out."""
    keep = [k.copy() for k in fit.keep]
    for _, masks in sessions:
        gone = [o & m for o, m in zip(fit.outliers, masks, strict=True)]
        if sum(map(np.sum, gone)) > MANY_OUT * sum(map(np.sum, masks)):
            keep = [k | g for k, g in zip(keep, gone, strict=True)]
    return keep
