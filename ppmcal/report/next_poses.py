"""The poses to measure next, as poses of the machine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.io.csv import Table
from ppmcal.io.results.scene import ScenePoses
from ppmcal.model.mechanism import Mechanism

KEY = "next:"
"""Keys of these poses begin so; those of measured rows with a number."""
MOST = 24
"""So many poses are drawn."""


def with_next(poses: ScenePoses, wanted: Table | None, mechanism: Mechanism) -> ScenePoses:
    """Return poses followed by those of next.csv, by its joint values.

    Args:
        poses: to draw the machine at.
        wanted: next.csv, in the file's units; None without one.
        mechanism: the machine.
    """
    names = [f"q_{a}" for a in mechanism.actuators]
    if wanted is None or not set(names) <= set(wanted.numbers):
        return poses
    factors = np.array([factor for factor, _ in mechanism.joint_units])
    q = np.stack([wanted.number(n) for n in names], axis=-1) * factors
    q, first = np.unique(q, axis=0, return_index=True)
    order = np.argsort(first)[:MOST]
    rows = [int(r) + 1 for r in first[order]]
    return ScenePoses([*poses.labels, *(_label(wanted, r) for r in rows)],
                      [*poses.keys, *(f"{KEY}{r}" for r in rows)],
                      np.concatenate([poses.q, q[order]]))


def _label(wanted: Table, row: int) -> str:
    """Return which row it is, and the load it is measured under if there is one."""
    more: Sequence[str] = [f"{name} {wanted.number(name)[row - 1]:.4g}"
                           for name in ("mass", "payload", "temperature")
                           if name in wanted.numbers]
    return f"measure next, row {row}" + "".join(f", {m}" for m in more)
