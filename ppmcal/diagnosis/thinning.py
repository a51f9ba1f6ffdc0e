"""Selection of rows for the search for effects if there are very many; fits use all rows.

Each session keeps its share, and so do rows of one load. Within these, rows are split into runs of
equal length in file order, and one row of each run is drawn with a fixed seed: time is covered
evenly, and the selection is not in step with anything that alternates from row to row, such as
directions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.calibration.fit import Problem, values_per_row
from ppmcal.diagnosis.linear_system import MOST_ROWS
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.sessions import session_masks

MOST_VALUES = 6000
"""Most values in all selected rows: 1000 poses, or 1500 heights."""
LEAST = 60
"""Rows kept of one session and load, if available."""
SAME_LOAD = 0.02
"""Loads that differ by less than this part of the largest count as equal."""
MOST_STRATA = 40
"""With more combinations of session and load than this, only the order of the rows counts."""


def thinned(problem: Problem, keep: Sequence[Bools]) -> list[Bools]:
    """Return masks (N,) by data set with at most as many rows as a search uses."""
    width = max(values_per_row(d, problem.mechanism) for d in problem.datasets)
    most = min(MOST_ROWS, MOST_VALUES // width)
    total = sum(int(k.sum()) for k in keep)
    if total <= most:
        return list(keep)
    labels = _strata(problem)
    used = np.concatenate(list(keep))
    sizes = np.bincount(labels[used])
    if np.count_nonzero(sizes) > MOST_STRATA:
        labels, sizes = np.zeros_like(labels), np.array([total])
    out = np.zeros(used.size, dtype=bool)
    for label, share in enumerate(_shares(sizes, most)):
        rows = np.flatnonzero(used & (labels == label))
        out[_one_of_each_run(rows, int(share))] = True
    return list(np.split(out, np.cumsum([len(d) for d in problem.datasets])[:-1]))


def _strata(problem: Problem) -> Ints:
    """Return one label per session and load for all rows, data set by data set."""
    session = np.zeros(sum(len(d) for d in problem.datasets))
    for n, (_, masks) in enumerate(session_masks(problem.datasets)):
        session[np.concatenate(masks)] = n
    load = np.nan_to_num(np.concatenate([e.wrench for e in problem.environments]))
    size = float(np.abs(load).max(initial=0.0)) or 1.0
    keys = np.column_stack([session, np.round(load / (SAME_LOAD * size))])
    return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1]).reshape(-1)


def _shares(sizes: Array | Ints, most: int) -> Ints:
    """Return how many rows each stratum keeps: in proportion, but at least the minimum.

    >>> _shares(np.array([8950, 1000, 50]), 1000).tolist()
    [852, 97, 50]
    """
    least = np.minimum(sizes, min(LEAST, most // sizes.size))
    room = sizes - least
    fair = np.minimum(np.floor(sizes * (most / sizes.sum())).astype(np.int64), sizes)
    out = np.maximum(fair, least)
    over = int(out.sum()) - most
    if over > 0:
        # strata above the minimum are reduced in proportion
        spare = np.where(room > 0, out - least, 0)
        out = out - np.ceil(spare * (over / max(int(spare.sum()), 1))).astype(np.int64)
    return np.asarray(np.clip(out, 0, sizes), dtype=np.int64)


def _one_of_each_run(rows: Ints, count: int) -> Ints:
    """Return ``count`` of the rows (n,), one from each run of equal length."""
    if count >= rows.size:
        return rows
    ends = np.linspace(0, rows.size, count + 1).astype(np.int64)
    chance = np.random.default_rng(count).random(count)
    return np.asarray(rows[ends[:-1] + (chance * np.diff(ends)).astype(np.int64)])
