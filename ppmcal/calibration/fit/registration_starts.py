"""A second start of frames and targets: from the fit with less open, one thing after another.

Where a platform hardly turns, or its nominal geometry misses by much, what frame and target do
looks alike, and the closed form of both may put them far off. A fit that leaves the target where
the file says is then nearer; opening one thing at a time from there never fits worse.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.gauss_newton import least_squares, prior_square
from ppmcal.calibration.fit.linearisation import prior_weights
from ppmcal.calibration.fit.outliers import distances, huber_weights
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.inference.row_weights import improbability
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.registration import Registration

STEPWISE = ("target_rotation", "target")
"""What is left closed at first, and opened from the last to the first."""
ITERATIONS = 15


def opened_in_turn(problem: Problem, state: State, keep: Sequence[Bools], robust: bool
                   ) -> tuple[Registration, ...] | None:
    """Return where registrations end that are fitted with one thing open after another.

    The geometry stays as it is. None where nothing is open beside frames or beside a target.

    Args:
        problem: machine and data.
        state: with the poses at the machine's values.
        keep: rows to use (N,), by data set.
        robust: far rows count less.
    """
    found: State | None = None
    for narrow in _narrower(replace(problem, free=(), earlier=None)):
        if found is None:
            found = replace(narrow.start(), poses=state.poses)

        def weigh(at: State, narrow: Problem = narrow) -> Sequence[Array]:
            return huber_weights(narrow, at, keep)

        found = least_squares(narrow, found, keep, prior_weights(narrow, "prior"), ITERATIONS,
                              weigh if robust else None, rough=True).state
    return None if found is None else found.registrations


def _narrower(problem: Problem) -> Iterator[Problem]:
    """Yield a problem with less open, then with more, then as it is; nothing where none has."""
    words = [w for w in STEPWISE if any(_closed(d, [w]) is not d for d in problem.datasets)]
    for count in range(len(words), -1, -1) if words else ():
        yield problem.changed(datasets=tuple(_closed(d, words[:count]) for d in problem.datasets))


def _closed(data: Dataset, words: Sequence[str]) -> Dataset:
    """Return a data set with parts of its registration as the file says; itself without any."""
    if not data.frame.fitted:
        return data
    own = {w: replace(getattr(data, w), fitted=False) for w in words if getattr(data, w).fitted}
    return replace(data, **own) if own else data


def loss(fit: Fit, robust: bool) -> tuple[int, float]:
    """Return how badly a fit does: rows that have no pose, then chi-squared of data and prior.

    With ``robust`` rows that are far off count as rows that may not belong.
    """
    total, lost = prior_square(fit.problem, fit.state, fit.prior), 0
    found = distances(fit.problem, fit.state)
    for square, size, pose in zip(found.square, found.size, fit.state.poses,
                                  strict=True):
        there = np.isfinite(square) & (size > 0) & finite_rows(pose)
        lost += int((~there).sum())
        own = square[there]
        total += float(np.sum(improbability(own, size[there]) if robust else own))
    return lost, total
