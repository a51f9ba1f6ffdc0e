"""Rows that repeat the row before: an instrument, or a log of joints, that had not moved on.

Noise makes it next to impossible that a pose is measured twice with the same digits, and a
machine that has moved does not show the joint values of the row before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.mistakes import Mistake
from ppmcal.calibration.observation import SCALARS, coordinates, shown
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted

FEWEST = 8
"""Rows that a data set must have, for its usual step to be known."""
MOVED = 0.1
"""A machine has moved that went farther than this part of its usual step."""
MOST = 0.5
"""Where more rows than this part repeat, they are meant to."""


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
    same_group = np.append(False, np.diff(data.groups) == 0)
    found = []
    for rows, columns, what in (
            (same_pose & _moved(joint_step) & next_to,
             tuple(("x", "y", "z", "rx", "ry", "rz")[c] for c in parts), "the measurement"),
            (same_joints & _moved(pose_step) & next_to & ~same_group,
             tuple(f"q_{a}" for a in mechanism.actuators), "the joint values")):
        if rows.any() and rows.mean() < MOST:
            out |= rows
            numbers = tuple(int(n) for n in data.rows[rows])
            found.append(Mistake("stale", columns, f"in {counted(len(numbers), 'row')} "
                                 f"{what} {'is' if what.endswith('t') else 'are'} still that of "
                                 "the row before, although the machine had moved", numbers))
    return out, tuple(found)


def _steps(values: Array) -> tuple[Bools, Array]:
    """Return which rows equal the one before to the last digit (N,), and the steps (N,)."""
    step = np.append(np.nan, np.linalg.norm(np.diff(values, axis=0), axis=1))
    return step == 0.0, step


def _moved(step: Array) -> Bools:
    moving = step[np.isfinite(step) & (step > 0.0)]
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
        out.append(replace(data.without(rows, "stale: repeats the row before"),
                           findings=(*data.findings, *told)))
    return tuple(out)


def _numbers(rows: Sequence[int], most: int = 8) -> str:
    more = f" (+{len(rows) - most} more)" if len(rows) > most else ""
    return f"row{'s' if len(rows) > 1 else ''} {', '.join(map(str, rows[:most]))}{more}"
