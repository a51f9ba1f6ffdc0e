"""Rows that are far beyond what noise and tolerances explain, whatever the geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.linearisation import parameter_scale, prior_weights
from ppmcal.calibration.fit.outliers import Distances, distances
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.inference.priors import MOST_GROSS
from ppmcal.linalg import Bools, reciprocals

GROSS = 5.0
"""Before a fit: a row so many times beyond what noise and tolerances explain waits aside."""


def explained_distances(problem: Problem, state: State) -> Distances:
    """Return every row's distance from the machine, freed of what the tolerances explain."""
    problem = toleranced(problem)
    weight = prior_weights(problem, "prior")
    # frames and targets are where they are; how far a scale may be off its file says
    scale = reciprocals(weight)
    scale[:len(problem.free)] = parameter_scale(problem)
    nobody = [np.zeros(len(d), dtype=bool) for d in problem.datasets]
    return distances(problem, state, np.diag(scale**2), nobody)


def toleranced(problem: Problem, fixed: bool = False) -> Problem:
    """Return the problem with every parameter free that has a tolerance: all that may be wrong.

    ``fixed``: also those that the file holds. What a fit may change is the user's choice, and says
    nothing of what is off in the machine.
    """
    own = {i for i, p in enumerate(problem.mechanism.parameters)
           if p.prior_sigma and (fixed or not p.fixed)}
    return replace(problem, free=tuple(sorted(own | set(problem.free))))


def gross_errors(problem: Problem, state: State, keep: Sequence[Bools]) -> list[Bools]:
    """Return which of the rows ``keep`` do not belong whatever the geometry, by data set (N,).

    None where there are too many of them to be single mistakes.
    """
    out = beyond(explained_distances(problem, state), keep)
    total = sum(int(k.sum()) for k in keep)
    if sum(int(o.sum()) for o in out) > float(MOST_GROSS) * total:
        return [np.zeros_like(o) for o in out]
    return out


def single_gross_rows(fit: Fit) -> list[Bools]:
    """Return rows (N,) of each data set that are gross errors while their neighbours are not."""
    out = []
    for gross in gross_errors(fit.problem, fit.state, rows_with_outliers(fit)):
        beside = np.convolve(gross, [1, 0, 1], mode="same") > 0 if gross.size > 1 else gross
        out.append(gross & ~beside)
    return out


def rows_with_outliers(fit: Fit) -> list[Bools]:
    """Return the rows (N,) of each data set that a fit uses or has left out as outliers."""
    return [k | o for k, o in zip(fit.keep, fit.outliers, strict=True)]


def beyond(found: Distances, keep: Sequence[Bools]) -> list[Bools]:
    """Return the rows ``keep`` that are beyond :data:`GROSS` times what half of them are."""
    limit = GROSS * max(1.0, found.times(keep))
    return [k & (np.sqrt(np.where(np.isnan(d) | (m == 0), 0.0, d) / chdtri(np.maximum(m, 1.0), 0.5))
                 > limit) for k, d, m in zip(keep, found.square, found.size, strict=True)]
