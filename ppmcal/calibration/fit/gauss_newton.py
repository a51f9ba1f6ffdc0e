"""The search for the minimum: Gauss-Newton, damped where a plain step does not help.

Steps come from the normal equations while their condition allows, else from the triangle of a QR
of the rows; the last step, and every statement about the minimum, always from the triangle.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.fit.linearisation import (
    NormalStep,
    SquareRootInformation,
    SummedStep,
    column_scale,
    normal_step,
    qr_factor,
    summed_step,
    to_prior,
)
from ppmcal.calibration.fit.normal_equations import normal_sums, row_squares
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.calibration.fit.work import another_step
from ppmcal.kinematics.forward import Minima
from ppmcal.linalg import Array, Bools
from ppmcal.wording.progress import note

log = logging.getLogger(__package__)

CONVERGED = 1e-6
"""Converged: the next step would lower chi-squared by less than this."""
SMALLEST_DAMPING = 1e-16
"""Damping starts here when a plain step fails, and is dropped when it falls back below this."""
ROUGH = 1e-3
"""A re-weighted fit is good enough if a step would gain less than this part of chi-squared."""
ROUND_OFF = 1e-13
"""Or if the step is below this part of the parameters' scale."""
AT_THE_NOISE = 0.01
"""Largest decrease of chi-squared that a plain step may still predict at a minimum, relative to the
scatter of the rows: the predictions of all rows together would move by a tenth of the noise."""
SETTLING = 0.25
"""An uphill step is accepted if the next one predicts less than this part of its decrease."""
WORST_CONDITION = 1e12
"""Normal equations of unit columns with a condition above this leave a step fewer than four
digits: then QR is used, which loses none."""


@dataclass(frozen=True)
class Minimum:
    """Result of a search for the minimum.

    Attributes:
        state: where it ended.
        information: its rows as one triangle; None for a rough search.
        iterations, converged: of the search.
        summed: number of iterations whose step came from normal equations.
    """

    state: State
    information: SquareRootInformation | None
    iterations: int
    converged: bool
    summed: int


@dataclass(frozen=True, eq=False)
class Linearised:
    """The rows at a state: chi-squared of the data, the number of values, and the step.

    ``information``: None if the step comes from sums.
    """

    square: float
    count: float
    small: NormalStep | SummedStep
    information: SquareRootInformation | None

    @property
    def level(self) -> bool:
        """Whether this is a minimum: the remaining gain is far below the noise.

        The one criterion for any end of a search. It uses the plain step, because a damped one
        predicts little anywhere; and if the rows scatter more than stated, it is relative to
        that scatter, as the results are.
        """
        return self.promise < AT_THE_NOISE * self.scatter

    @property
    def promise(self) -> float:
        """Decrease of chi-squared that the plain step predicts."""
        return self.small.step()[1]

    @property
    def scatter(self) -> float:
        """Chi-squared per value, at least 1."""
        return max(1.0, self.square / max(self.count, 1))


def linearised(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
               weights: Sequence[Array] | None = None, by_sums: bool = True) -> Linearised:
    """Return the linear problem at a state, from sums if wanted and if they allow it."""
    if by_sums:
        sums = normal_sums(problem, state, keep, weights)
        summed = summed_step(problem, state, sums, prior)
        if summed.condition < WORST_CONDITION:
            return Linearised(sums.square, sums.count, summed, None)
    information = qr_factor(problem, state, keep, weights)
    return Linearised(information.square, information.count,
                      normal_step(problem, state, information, prior), information)


def least_squares(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
                  iterations: int, weigh: Callable[[State], Sequence[Array]] | None = None,
                  rough: bool = False) -> Minimum:
    """Return the minimum of chi-squared of data and prior.

    Args:
        problem: the machine and its C columns.
        state: where to start.
        keep: rows to use (N,), for each data set.
        prior: weight of each column's distance from its nominal value (C,), 1/tau, SI.
        iterations: maximum number of iterations.
        weigh: weights of rows at a state. Rows are re-weighted in each iteration, and a rough
            minimum is enough, because the final fit only starts there.
        rough: accept a rough minimum without weights too.
    """
    rough = rough or weigh is not None
    damping, by_sums, summed = 0.0, True, 0
    unit, minima = column_scale(problem), Minima()
    for count in range(1, iterations + 1):
        weights = weigh(state) if weigh else None
        now = linearised(problem, state, keep, prior, weights, by_sums)
        # a problem that is ill-conditioned at one state is so at the next
        by_sums = now.information is None
        summed += by_sums
        before = now.square + prior_square(problem, state, prior)
        limit = max(CONVERGED, (ROUGH if weigh else 1e-10) * before)
        note(f"iteration {count}, chi-squared {before:.6g}")
        log.debug("iteration %d: chi-squared %.8g, damping %.2g, %s", count, before, damping,
                  "normal equations" if by_sums else "QR")
        while True:
            step, decrease = now.small.step(damping)
            small = float(np.max(np.abs(step / unit), initial=0.0)) < ROUND_OFF
            if decrease < limit or small:
                if now.information is None and not rough:
                    now = linearised(problem, state, keep, prior, weights, False)
                    summed -= 1
                    continue
                if damping > 0.0:
                    return Minimum(state, now.information, count, now.level, summed)
                # too small for the cost to judge: a last plain step only polishes
                end = problem.moved(state, step)
                return Minimum(end if solved(end, keep) else state, now.information, count, True,
                               summed)
            if not another_step():
                return _given_up(problem, state, keep, prior, rough, count, summed)
            with np.errstate(over="ignore", invalid="ignore"):  # a step may overflow
                trial = problem.moved(state, step, wary=False)
                after = cost(problem, trial, keep, prior, weights)
            better: State | None = trial
            if not after < before:
                better = None
                if damping == 0.0:
                    better = _second_chance(problem, trial, keep, prior, weights, now, before)
            if better is not None:
                state = problem.kept(better, minima)
                damping = damping / 10.0 if damping > SMALLEST_DAMPING else 0.0
                break
            damping = max(10.0 * damping, SMALLEST_DAMPING)
            if damping > 1.0:
                return _given_up(problem, state, keep, prior, rough, count, summed)
    return _given_up(problem, state, keep, prior, rough, iterations, summed)


def _given_up(problem: Problem, state: State, keep: Sequence[Bools], prior: Array, rough: bool,
              iterations: int, summed: int) -> Minimum:
    """Return the end of a search that found no way down, or used up its iterations.

    It may still be the minimum: the search may creep along a valley, or round-off may hide
    the remaining gain.
    """
    if rough:
        return Minimum(state, None, iterations, False, summed)
    now = linearised(problem, state, keep, prior, None, False)
    return Minimum(state, now.information, iterations, now.level, summed)


def solved(state: State, keep: Sequence[Bools]) -> bool:
    """Whether every row in use has a pose."""
    return all(bool(np.isfinite(p[k]).all()) for p, k in zip(state.poses, keep, strict=True))


def _second_chance(problem: Problem, trial: State, keep: Sequence[Bools], prior: Array,
                   weights: Sequence[Array] | None, now: Linearised, before: float
                   ) -> State | None:
    """Return the state to continue from after a plain step ``trial`` that was worse, else None.

    Where frame and geometry turn together the data see nothing at first order and a very
    steep wall at second order; one straight step runs into the wall, the next one off it.

    Joint noise is carried to the measurements by the geometry and changes with it: chi-squared
    falls where that makes the noise larger, which steps ignore, so they may end where it is not
    least. There a step may raise it if hardly another step remains to be taken.
    """
    if not solved(trial, keep):
        return None
    there = linearised(problem, trial, keep, prior, weights, now.information is None)
    if any(problem.noisy_closure) and there.promise < SETTLING * now.promise:
        return trial
    trial = problem.moved(trial, there.small.step()[0], wary=False)
    return trial if cost(problem, trial, keep, prior, weights) < before else None


def cost(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
         weights: Sequence[Array] | None) -> float:
    """Return chi-squared of data and prior; inf where a kept row has no pose."""
    total = prior_square(problem, state, prior)
    if not solved(state, keep):
        return float("inf")
    given = problem.shared_stands(state, keep)
    for i, k in enumerate(keep):
        squares = row_squares(problem, state, i, k, given)
        total += float(np.sum(squares if weights is None else squares * weights[i][k] ** 2))
    if problem.earlier is not None:
        total += float(np.sum(problem.earlier.rows(problem.mechanism, (), state.g)[0] ** 2))
    return total


def prior_square(problem: Problem, state: State, prior: Array) -> float:
    """Return the prior's contribution to chi-squared."""
    return float(np.sum((prior * to_prior(problem, state)) ** 2))
