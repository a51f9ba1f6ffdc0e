"""Levenberg-Marquardt on the whitened problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ppmcal.arrays import Array, Bools
from ppmcal.linear import Reduced, column_scale, cost, prior_square, reduce_rows, small_problem
from ppmcal.problem import Problem, State

Progress = Callable[[int, float], None]

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


def gauss_newton(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
                 iterations: int, weigh: Callable[[State], Sequence[Array]] | None = None,
                 progress: Progress | None = None) -> tuple[State, Reduced, int, bool]:
    """Return the state at the minimum, its rows, the number of iterations, converged or not.

    With ``weigh`` rows are re-weighted in each iteration, and a rough minimum is enough: it
    is only where the final fit starts.
    """
    damping, decrease = 0.0, float("inf")
    unit = column_scale(problem)
    for count in range(1, iterations + 1):
        weights = weigh(state) if weigh else None
        reduced = reduce_rows(problem, state, keep, weights)
        before = reduced.square + prior_square(problem, state, prior)
        limit = max(CONVERGED, (ROUGH if weigh else 1e-10) * before)
        if progress:
            progress(count, before)
        small = small_problem(problem, state, reduced, prior)
        while True:
            step, decrease = small.step(damping)
            if decrease < limit or float(np.max(np.abs(step / unit), initial=0.0)) < ROUND_OFF:
                # too small to be judged by the cost: a last plain step only polishes
                end = problem.moved(state, step) if damping == 0.0 else state
                return (end if solved(end, keep) else state), reduced, count, True
            trial = problem.moved(state, step)
            after = cost(problem, trial, keep, prior, weights)
            if after >= before and damping == 0.0:
                trial, after = _second_chance(problem, trial, keep, prior, weights)
            if after < before:
                state = trial
                damping = damping / 10.0 if damping > SMALLEST_DAMPING else 0.0
                break
            damping = max(10.0 * damping, SMALLEST_DAMPING)
            if damping > 1.0:
                return state, reduced, count, bool(decrease < 1e-6 * max(before, 1.0))
    # creeping along a valley: what is left to gain is no more than a tenth of the noise
    return state, reduce_rows(problem, state, keep, None), iterations, decrease < AT_THE_NOISE


def solved(state: State, keep: Sequence[Bools]) -> bool:
    """Whether every row in use has a pose."""
    return all(bool(np.isfinite(p[k]).all()) for p, k in zip(state.poses, keep, strict=True))


def _second_chance(problem: Problem, trial: State, keep: Sequence[Bools], prior: Array,
                   weights: Sequence[Array] | None) -> tuple[State, float]:
    """Take a second plain step from a trial that was worse, and judge after it.

    Where frame and geometry turn together the data see nothing at first order and a very
    steep wall at second order; one straight step runs into the wall, the next one off it.
    """
    if not solved(trial, keep):
        return trial, float("inf")
    reduced = reduce_rows(problem, trial, keep, weights)
    trial = problem.moved(trial, small_problem(problem, trial, reduced, prior).step()[0])
    return trial, cost(problem, trial, keep, prior, weights)
