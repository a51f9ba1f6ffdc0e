"""The search for the minimum: Gauss-Newton, damped where a plain step does not help.

Steps come from the normal equations while their condition allows, else from the triangle that QR
makes of the rows; the last step, and all that is said of the minimum, always from the triangle.
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
"""Damping starts here when a plain step fails, and is dropped as soon as it falls back."""
ROUGH = 1e-3
"""A re-weighted fit is good enough when a step would gain less than this part."""
ROUND_OFF = 1e-13
"""Or the step is below this part of the parameters' scale."""
AT_THE_NOISE = 0.01
"""What a plain step may still promise of chi-squared at a minimum, in units of the noise that the
rows show: the predictions of all rows together would move by a tenth of it."""
SETTLING = 0.25
"""Steps end where each promises less than this part of what the one before it did."""
WORST_CONDITION = 1e12
"""Normal equations of unit columns with a condition above this leave a step fewer than four of
its digits: QR then, which loses none."""


@dataclass(frozen=True)
class Minimum:
    """Where a search for the minimum ended.

    Attributes:
        state: there.
        information: its rows as one triangle; None of a rough search.
        iterations, converged: of the search.
        summed: in how many of the iterations the step came from normal equations.
    """

    state: State
    information: SquareRootInformation | None
    iterations: int
    converged: bool
    summed: int


@dataclass(frozen=True, eq=False)
class Linearised:
    """The rows at a state: chi-squared of the data and of how many values, and the step.

    ``information``: None where the step is from sums.
    """

    square: float
    count: float
    small: NormalStep | SummedStep
    information: SquareRootInformation | None

    @property
    def level(self) -> bool:
        """Whether this is a minimum: what is left to gain is far below the noise.

        The one criterion, wherever a search ends. A damped step promises little anywhere, so it
        is the plain one that is asked; and where the rows scatter by more than was stated, it
        is in that scatter that results are told.
        """
        return self.promise < AT_THE_NOISE * self.scatter

    @property
    def promise(self) -> float:
        """By how much the plain step would lower chi-squared."""
        return self.small.step()[1]

    @property
    def scatter(self) -> float:
        """What one value adds to chi-squared, 1 where that is less than the noise."""
        return max(1.0, self.square / max(self.count, 1))


def linearised(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
               weights: Sequence[Array] | None = None, by_sums: bool = True) -> Linearised:
    """Return the linear problem at a state, from sums where wanted and where they allow it."""
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
        iterations: at most so many.
        weigh: weights of rows at a state. Rows are re-weighted in each iteration, and a rough
            minimum is enough: it is only where the final fit starts.
        rough: it is without weights too.
    """
    rough = rough or weigh is not None
    damping, by_sums, summed = 0.0, True, 0
    unit, minima = column_scale(problem), Minima()
    for count in range(1, iterations + 1):
        weights = weigh(state) if weigh else None
        now = linearised(problem, state, keep, prior, weights, by_sums)
        # what is ill-conditioned at one state is so at the next
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
                # too small to be judged by the cost: a last plain step only polishes
                end = problem.moved(state, step)
                return Minimum(end if solved(end, keep) else state, now.information, count, True,
                               summed)
            if not another_step():
                return _given_up(problem, state, keep, prior, rough, count, summed)
            with np.errstate(over="ignore", invalid="ignore"):  # a step may lead out of all numbers
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
    """Return where a search ended that found no way down, or used up its iterations.

    It may be the minimum all the same: the way there may be a valley along which it creeps, or
    round-off may hide what is left.
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
    """Return the state to go on from after a plain step ``trial`` that was worse, None without.

    Where frame and geometry turn together the data see nothing at first order and a very
    steep wall at second order; one straight step runs into the wall, the next one off it.

    The noise of joints is carried over to what is measured by the geometry, and moves with it:
    chi-squared falls where that makes it larger, which no step goes for, and steps may end where
    it is not least. So there a step may raise it that leaves hardly another one to take.
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
    """Return the prior's part of chi-squared."""
    return float(np.sum((prior * to_prior(problem, state)) ** 2))
