"""The small linear problem of one iteration: all rows as one triangle, and its step.

Columns are judged in natural units (:func:`column_scale`), so that metres and radians,
geometry and frames can be weighed against each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.problem import Problem, State
from ppmcal.linalg import Array, Bools, svd

SOLVE_TOLERANCE = 1e-13
"""Directions below this part of the strongest are round-off: neither data nor prior see them."""


@dataclass(frozen=True)
class QRFactor:
    """All rows as one triangle: ``triangle`` (C, C), ``right`` (C,), and the sum of squares.

    The least-squares problem of the rows is |triangle s - right|^2 + (square - |right|^2).
    """

    triangle: Array
    right: Array
    square: float
    count: int


def prior_weights(problem: Problem, method: str) -> Array:
    """Return 1/tau per column (C,), 0 where there is no prior."""
    weights = np.zeros(len(problem.columns))
    if method in ("flat", "damped"):
        return weights
    for c, p in enumerate(problem.free):
        tau = problem.mechanism.parameters[p].prior_sigma
        weights[c] = 1.0 / tau if tau else 0.0
    return weights


def parameter_scale(problem: Problem) -> Array:
    """Return the unit in which each free parameter is judged (F,): its tolerance, SI.

    Without a finite tolerance: a thousandth of the reach, or 1e-3 rad.
    """
    out = np.empty(len(problem.free))
    for c, p in enumerate(problem.free):
        parameter = problem.mechanism.parameters[p]
        natural = parameter.size or 1e-3 * (
            problem.mechanism.reach if parameter.quantity == "length" else 1.0)
        out[c] = parameter.prior_sigma or natural
    return out


def qr_factor(problem: Problem, state: State, keep: Sequence[Bools],
                weights: Sequence[Array] | None = None) -> QRFactor:
    """Accumulate all rows into one triangle by QR, chunk by chunk.

    Args:
        problem: the machine and its C columns.
        state: where rows are linearised.
        keep: rows to use (N,), for each data set.
        weights: factor on each white row (N,), for each data set  [default: 1].
    """
    size = len(problem.columns) + 1
    stack = np.zeros((0, size))
    count = 0
    for rows in problem.rows(state, True, keep):
        block = np.concatenate([rows.jacobian, rows.residual[..., None]], axis=-1)
        if weights is not None:
            block = block * weights[rows.dataset][rows.index][:, None, None]
        block = block.reshape(-1, size)
        count += int(rows.observed.sum())
        stack = np.asarray(np.linalg.qr(np.concatenate([stack, block]), mode="r"))
    if problem.earlier is not None:
        residual, jacobian = problem.earlier.rows(problem.mechanism, problem.free, state.g)
        block = np.zeros((residual.size, size))
        block[:, :len(problem.free)], block[:, -1] = jacobian, residual
        stack = np.asarray(np.linalg.qr(np.concatenate([stack, block]), mode="r"))
        count += residual.size
    full = np.zeros((size, size))
    full[:min(size, stack.shape[0])] = stack[:size]
    right = full[:-1, -1]
    return QRFactor(full[:-1, :-1], right, float(np.sum(full[:, -1] ** 2)), count)


def cost(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
         weights: Sequence[Array] | None) -> float:
    """Return chi-squared of data and prior; inf where a kept row has no pose."""
    total = prior_square(problem, state, prior)
    for i, k in enumerate(keep):
        if not np.isfinite(state.poses[i][k]).all():
            return float("inf")
    for rows in problem.rows(state, False, keep):
        r = rows.residual
        if weights is not None:
            r = r * weights[rows.dataset][rows.index][:, None]
        total += float(np.sum(r * r))
    if problem.earlier is not None:
        total += float(np.sum(problem.earlier.rows(problem.mechanism, (), state.g)[0] ** 2))
    return total


def prior_square(problem: Problem, state: State, prior: Array) -> float:
    """Return the prior's part of chi-squared."""
    free = list(problem.free)
    away = (state.g[free] - problem.mechanism.nominals[free]) * prior[:len(free)]
    return float(np.sum(away**2))


def column_scale(problem: Problem) -> Array:
    """Return one natural unit per column (C,): tolerances; a thousandth of the reach, 1e-3 rad.

    Frames and geometry must be measured with like units: in a direction that moves both
    together the prior would else drown in the frame's larger numbers.
    """
    return np.concatenate([parameter_scale(problem), problem.open_scale()])


@dataclass(frozen=True)
class NormalStep:
    """One iteration's linear problem, diagonalised: minimise |s x - b|^2 along each direction.

    ``singular`` (r,), ``right`` (r,), ``directions`` (r, C) in natural units ``scale`` (C,).
    """

    singular: Array
    right: Array
    directions: Array
    scale: Array

    def step(self, damping: float = 0.0) -> tuple[Array, float]:
        """Return the step (C,) and the decrease of chi-squared that it promises.

        ``damping`` counts in parts of the strongest direction squared, in natural units
        (Levenberg). Directions that neither data nor prior see are left where they are.
        """
        s = self.singular
        largest = s.max(initial=1e-300)
        use = s > SOLVE_TOLERANCE * largest
        power = s**2 + damping * largest**2
        part = np.where(use, s**2 / np.where(use, power, 1.0), 0.0)
        x = self.directions.T @ np.where(use, part * self.right / np.where(use, s, 1.0), 0.0)
        decrease = float(np.sum(self.right**2 * (1.0 - (1.0 - part) ** 2)))
        return x * self.scale, decrease


def normal_step(problem: Problem, state: State, reduced: QRFactor, prior: Array) -> NormalStep:
    """Return the linear problem of data and prior at a state.

    Args:
        problem: the machine and its C columns.
        state: where the rows were linearised.
        reduced: all rows as one triangle.
        prior: weight of each column's distance from its nominal value (C,), 1/tau, SI.
    """
    free = list(problem.free)
    scale = column_scale(problem)
    away = np.zeros(len(problem.columns))
    away[:len(free)] = problem.mechanism.nominals[free] - state.g[free]
    matrix = np.concatenate([reduced.triangle * scale, np.diag(prior * scale)])
    u, s, vt = svd(matrix)
    right = u.T @ np.concatenate([reduced.right, prior * away])
    return NormalStep(s, right, vt, scale)


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


def least_squares(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
                 iterations: int, weigh: Callable[[State], Sequence[Array]] | None = None,
                 progress: Progress | None = None) -> tuple[State, QRFactor, int, bool]:
    """Return the minimum of chi-squared of data and prior.

    Args:
        problem: the machine and its C columns.
        state: where to start.
        keep: rows to use (N,), for each data set.
        prior: weight of each column's distance from its nominal value (C,), 1/tau, SI.
        iterations: at most so many.
        weigh: weights of rows at a state. Rows are re-weighted in each iteration, and a rough
            minimum is enough: it is only where the final fit starts.
        progress: called with iteration and chi-squared.

    Returns:
        The state at the minimum, its rows, the number of iterations, converged or not.
    """
    damping, decrease = 0.0, float("inf")
    unit = column_scale(problem)
    for count in range(1, iterations + 1):
        weights = weigh(state) if weigh else None
        reduced = qr_factor(problem, state, keep, weights)
        before = reduced.square + prior_square(problem, state, prior)
        limit = max(CONVERGED, (ROUGH if weigh else 1e-10) * before)
        if progress:
            progress(count, before)
        small = normal_step(problem, state, reduced, prior)
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
    return state, qr_factor(problem, state, keep, None), iterations, decrease < AT_THE_NOISE


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
    reduced = qr_factor(problem, trial, keep, weights)
    trial = problem.moved(trial, normal_step(problem, trial, reduced, prior).step()[0])
    return trial, cost(problem, trial, keep, prior, weights)
