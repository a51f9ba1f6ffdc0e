"""Rows that repeat the row before: an instrument, or a log of joints, that had not moved on.

Noise makes it next to impossible that a pose is measured twice with the same digits, and a
machine that has moved does not show the joint values of the row before. Where a machine stays, a
measurement is stale if it repeats to the last digit and the file's other repeats do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import coordinates, shown
from ppmcal.calibration.interpretation.misread import Mistake
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import SCALARS
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted

FEWEST = 8
"""Rows that a data set must have, for its usual step to be known."""
MOVED = 0.1
"""A machine has moved that went farther than this part of its usual step."""
MOST = 0.5
"""Where more rows than this part repeat, they are meant to."""
BY_CHANCE = 0.05
"""Rows expected to repeat by the coarseness of the digits alone: from here on none is stale."""


def stale(data: Dataset, mechanism: Mechanism) -> tuple[Bools, tuple[Mistake, ...]]:
    """Return which rows repeat the one before (N,), and that as mistakes.

    Heights and distances may well come out the same twice: they are not judged.
    """
    out = np.zeros(len(data), dtype=bool)
    if data.kind in SCALARS or data.commanded is not None or len(data) < FEWEST:
        return out, ()
    parts = list(coordinates(data, mechanism.motion))
    measured = shown(data)[:, parts]
    scale = np.where(np.array(parts) < 3, 1.0, mechanism.length_scale)
    same_pose, pose_step = _steps(measured * scale)
    same_joints, joint_step = _steps(data.q)
    next_to = np.append(False, np.diff(data.rows) == 1)
    # by the file: joint values that stay are what makes rows of one pose otherwise
    labels = data.groups if data.labels is None else data.labels
    same_group = np.append(False, np.diff(labels) == 0)
    moved = _moved(joint_step, joint_step)
    resting = _same_at_rest(measured, np.isfinite(joint_step) & ~moved & next_to)
    why = ", although the machine had moved"
    at_rest = f"{why} or its other repeats differ" if resting.any() else why
    found = []
    for rows, columns, what, reason in (
            (same_pose & moved & next_to | resting,
             tuple(("x", "y", "z", "rx", "ry", "rz")[c] for c in parts),
             "the measurement is still that", at_rest),
            (same_joints & _moved(pose_step, pose_step[~same_joints]) & next_to & ~same_group,
             tuple(f"q_{a}" for a in mechanism.actuators),
             "the joint values are still those", why)):
        if rows.any() and rows.mean() < MOST:
            out |= rows
            numbers = tuple(int(n) for n in data.rows[rows])
            found.append(Mistake("stale", columns, f"in {counted(len(numbers), 'row')} {what} "
                                 f"of the row before{reason}", numbers))
    return out, tuple(found)


def _same_at_rest(measured: Array, rest: Bools) -> Bools:
    """Return which measurements (N, m) repeat the one before although noise should show (N,).

    ``rest``: rows at which the machine had stayed (N,). The other ones tell how often a coordinate
    comes out the same by itself.
    """
    equal = np.concatenate([np.zeros((1, measured.shape[1]), bool), np.diff(measured, axis=0) == 0])
    same = rest & equal.all(axis=1)
    others = rest & ~same & np.isfinite(measured).all(axis=1)
    count = int(others.sum())
    # a rate after so many trials, never 0 (Laplace)
    chance = float(np.prod((equal[others].sum(axis=0) + 1.0) / (count + 2.0)))
    if same.sum() >= MOST * rest.sum() or chance * rest.sum() > BY_CHANCE:
        return np.zeros_like(rest)
    return same


def _steps(values: Array) -> tuple[Bools, Array]:
    """Return which rows equal the one before to the last digit (N,), and the steps (N,)."""
    step = np.append(np.nan, np.linalg.norm(np.diff(values, axis=0), axis=1))
    return step == 0.0, step


def _moved(step: Array, moves: Array) -> Bools:
    """Return which steps (N,) are of a machine that moved.

    ``moves``: steps that tell how far it usually goes (M,), without the scatter of repeats.
    """
    moving = moves[np.isfinite(moves) & (moves > 0.0)]
    usual = float(np.median(moving)) if moving.size else np.inf
    with np.errstate(invalid="ignore"):
        return np.asarray(step > MOVED * usual)


def without_stale(datasets: Sequence[Dataset], mechanism: Mechanism) -> tuple[Dataset, ...]:
    """Return the data sets with their stale rows marked unusable, which findings say."""
    out = []
    for data in datasets:
        rows, found = stale(data, mechanism)
        if not found:
            out.append(data)
            continue
        told = [f"{data.source}: {m.text}: {_numbers(m.rows)}; left out." for m in found]
        # data that came here before say so already
        out.append(replace(data.without(rows, "stale: repeats the row before"),
                           findings=tuple(dict.fromkeys((*data.findings, *told)))))
    return tuple(out)


def _numbers(rows: Sequence[int], most: int = 8) -> str:
    more = f" (+{len(rows) - most} more)" if len(rows) > most else ""
    return f"row{'s' if len(rows) > 1 else ''} {', '.join(map(str, rows[:most]))}{more}"
