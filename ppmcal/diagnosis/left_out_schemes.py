"""Schemes for leaving rows out: whole sessions, ranges of time and of the environment.

Leaving out single poses is not enough: they lie between others measured at the same time and
temperature, so that even a wrong effect of time or heat predicts them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ppmcal.calibration.fit import Problem
from ppmcal.calibration.validation import thirds
from ppmcal.linalg import Array, Bools
from ppmcal.model.sessions import session_masks

LEVELS = 3
"""With fewer levels of load, none can be left out: the others would not show its effect."""
SESSION = "session"


def schemes(problem: Problem) -> Iterator[tuple[str, list[list[Bools]]]]:
    """Yield each scheme's name and blocks of rows: a mask (N,) by data set for each block."""
    parts = session_masks(problem.datasets)
    if len(parts) > 1:
        yield SESSION, [mask for _, mask in parts]
    order = [thirds(np.arange(len(d), dtype=float)) for d in problem.datasets]
    yield "time", [list(masks) for masks in zip(*order, strict=True)]
    heat = np.concatenate([c.temperature for c in problem.environments])
    load = np.concatenate([np.linalg.norm(c.wrench, axis=1) for c in problem.environments])
    ends = np.cumsum([len(d) for d in problem.datasets])[:-1]
    for by, values in (("temperature", heat), ("load", load)):
        if _varies(values) and (by != "load" or np.unique(np.round(values, 9)).size >= LEVELS):
            yield by, [np.split(mask, ends) for mask in thirds(values)]


def _varies(values: Array) -> bool:
    return bool(np.isfinite(values).all()
                and np.ptp(values) > 1e-9 * max(np.abs(values).max(), 1e-300))
