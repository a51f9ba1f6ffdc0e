"""The search for the minimum: Gauss-Newton, damped where a plain step does not help.

Steps come from the normal equations while their condition allows, else from the triangle that QR
makes of the rows; the last step, and all that is said of the minimum, always from the triangle.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.least_squares import (
    NormalStep,
    QRFactor,
    SummedStep,
    column_scale,
    normal_step,
    qr_factor,
    summed_step,
)
from ppmcal.calibration.normal_equations import normal_sums, row_squares
from ppmcal.calibration.problem import Problem, State
from ppmcal.linalg import Array, Bools
from ppmcal.wording.progress import note

log = logging.getLogger(__package__)

CONVERGED = 1e-6
"""Converged: the next step would lower chi-squared by less than this."""
SMALLEST_DAMPING = 1e-16
"""Damping starts here when a plain step fails, and is dropped as soon as it falls back."""
ROUGH = 1e-3
"""A re-weighted fit is good enough when a step would gain less than this part."""
ROUND_OFF = 1e-13
"""Or the step is below this part of the parameters' scale."""
AT_THE_NOISE = 0.01
"""What a step may still promise of chi-squared where a fit has used up its iterations: the
predictions of all rows together would move by a tenth of the noise."""
WORST_CONDITION = 1e12
"""Normal equations of unit columns with a condition above this leave a step fewer than four of
its digits: QR then, which loses none."""


@dataclass(frozen=True)
class Minimum:
    """Where a search for the minimum ended.

    Attributes:
        state: there.
        reduced: its rows as one triangle; None of a rough search.
        iterations, converged: of the search.
        summed: in how many of the iterations the step came from normal equations.
    """

    state: State
    reduced: QRFactor | None
    iterations: int
    converged: bool
    summed: int


@dataclass(frozen=True, eq=False)
class Linearised:
    """The rows at a state: chi-squared of the data, and the step; ``reduced`` None from sums."""

    square: float
    small: NormalStep | SummedStep
    reduced: QRFactor | None


def linearised(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
               weights: Sequence[Array] | None = None, by_sums: bool = True) -> Linearised:
    """Return the linear problem at a state, from sums where wanted and where they allow it."""
    if by_sums:
        sums = normal_sums(problem, state, keep, weights)
        summed = summed_step(problem, state, sums, prior)
        if summed.condition < WORST_CONDITION:
            return Linearised(sums.square, summed, None)
    reduced = qr_factor(problem, state, keep, weights)
    return Linearised(reduced.square, normal_step(problem, state, reduced, prior), reduced)


def least_squares(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
                  iterations: int, weigh: Callable[[State], Sequence[Array]] | None = None,
                  rough: bool = False) -> Minimum:
    """Return the minimum of chi-squared of data and prior.

    Args:
        problem: the machine and its C columns.
        state: where to start.
        keep: rows to use (N,), for each data set.
        prior: weight of each column's distance from its nominal value (C,), 1/tau, SI.
        iterations: at most so many.
        weigh: weights of rows at a state. Rows are re-weighted in each iteration, and a rough
            minimum is enough: it is only where the final fit starts.
        rough: it is without weights too.
    """
    rough = rough or weigh is not None
    damping, decrease, by_sums, summed = 0.0, float("inf"), True, 0
    unit = column_scale(problem)
    for count in range(1, iterations + 1):
        weights = weigh(state) if weigh else None
        now = linearised(problem, state, keep, prior, weights, by_sums)
        # what is ill-conditioned at one state is so at the next
        by_sums = now.reduced is None
        summed += by_sums
        before = now.square + prior_square(problem, state, prior)
        limit = max(CONVERGED, (ROUGH if weigh else 1e-10) * before)
        note(f"iteration {count}, chi-squared {before:.6g}")
        log.debug("iteration %d: chi-squared %.8g, damping %.2g, %s", count, before, damping,
                  "normal equations" if by_sums else "QR")
        while True:
            step, decrease = now.small.step(damping)
            if decrease < limit or float(np.max(np.abs(step / unit), initial=0.0)) < ROUND_OFF:
                if now.reduced is None and not rough:
                    now = linearised(problem, state, keep, prior, weights, False)
                    summed -= 1
                    continue
                # too small to be judged by the cost: a last plain step only polishes
                end = problem.moved(state, step) if damping == 0.0 else state
                end = end if solved(end, keep) else state
                return Minimum(end, now.reduced, count, True, summed)
            trial = problem.moved(state, step)
            after = cost(problem, trial, keep, prior, weights)
            if after >= before and damping == 0.0:
                trial, after = _second_chance(problem, trial, keep, prior, weights, by_sums)
            if after < before:
                state = trial
                damping = damping / 10.0 if damping > SMALLEST_DAMPING else 0.0
                break
            damping = max(10.0 * damping, SMALLEST_DAMPING)
            if damping > 1.0:
                level = bool(decrease < 1e-6 * max(before, 1.0))
                reduced = now.reduced or (None if rough else qr_factor(problem, state, keep))
                return Minimum(state, reduced, count, level, summed)
    # creeping along a valley: what is left to gain is no more than a tenth of the noise
    reduced = None if rough else qr_factor(problem, state, keep, None)
    return Minimum(state, reduced, iterations, decrease < AT_THE_NOISE, summed)


def solved(state: State, keep: Sequence[Bools]) -> bool:
    """Whether every row in use has a pose."""
    return all(bool(np.isfinite(p[k]).all()) for p, k in zip(state.poses, keep, strict=True))


def _second_chance(problem: Problem, trial: State, keep: Sequence[Bools], prior: Array,
                   weights: Sequence[Array] | None, by_sums: bool) -> tuple[State, float]:
    """Take a second plain step from a trial that was worse, and judge after it.

    Where frame and geometry turn together the data see nothing at first order and a very
    steep wall at second order; one straight step runs into the wall, the next one off it.
    """
    if not solved(trial, keep):
        return trial, float("inf")
    there = linearised(problem, trial, keep, prior, weights, by_sums)
    trial = problem.moved(trial, there.small.step()[0])
    return trial, cost(problem, trial, keep, prior, weights)


def cost(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
         weights: Sequence[Array] | None) -> float:
    """Return chi-squared of data and prior; inf where a kept row has no pose."""
    total = prior_square(problem, state, prior)
    for i, k in enumerate(keep):
        if not np.isfinite(state.poses[i][k]).all():
            return float("inf")
    for i, k in enumerate(keep):
        squares = row_squares(problem, state, i, k)
        if squares is not None:
            total += float(np.sum(squares if weights is None else squares * weights[i][k] ** 2))
            continue
        for rows in problem.rows_of(i, state, False, k):
            r = rows.residual
            if weights is not None:
                r = r * weights[i][rows.index][:, None]
            total += float(np.sum(r * r))
    if problem.earlier is not None:
        total += float(np.sum(problem.earlier.rows(problem.mechanism, (), state.g)[0] ** 2))
    return total


def prior_square(problem: Problem, state: State, prior: Array) -> float:
    """Return the prior's part of chi-squared."""
    free = list(problem.free)
    away = (state.g[free] - problem.mechanism.nominals[free]) * prior[:len(free)]
    return float(np.sum(away**2))
