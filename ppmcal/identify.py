"""The identification loop: whitened Gauss-Newton with the tolerances as prior.

Minimised is  sum |W (measured - predicted)|^2 + sum ((g - g0)/tau)^2  over the free
parameters and every open frame and target. Each iteration reduces all rows to one
triangle R by accumulated QR; everything else happens on that small matrix. Rows that do
not belong are down-weighted on the way and, at the end, left out and reported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal.dataset import Dataset
from ppmcal.errors import BadInput, NoResult
from ppmcal.observation import coordinates
from ppmcal.problem import Problem, State
from ppmcal.rank import RANK_TOLERANCE
from ppmcal.robust import REJECT, distances, huber_weights, worst

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

CONVERGED = 1e-6
"""Converged: the next step would lower chi-squared by less than this."""
SOLVE_TOLERANCE = 1e-13
"""Directions below this part of the strongest are round-off: neither data nor prior see them."""
SMALLEST_DAMPING = 1e-6
"""Damping starts here when a plain step fails, and is dropped as soon as it falls back."""
ROUND_OFF = 1e-13
"""Or the step is below this part of the parameters' scale (round-off)."""


@dataclass(frozen=True)
class Options:
    """How to identify.

    ``method``: ``prior``, ``flat`` (no prior), ``gcv`` (prior scale by generalised
    cross-validation) or ``damped`` ([PPM] section 4.5, with ``damping`` its 0.9).
    """

    method: str = "prior"
    damping: float = 0.9
    robust: bool = True
    iterations: int = 60


@dataclass(frozen=True)
class Reduced:
    """All rows as one triangle: ``triangle`` (C, C), ``right`` (C,), and the sum of squares.

    The least-squares problem of the rows is |triangle s - right|^2 + (square - |right|^2).
    """

    triangle: Array
    right: Array
    square: float
    count: int


@dataclass(frozen=True)
class Fit:
    """A converged (or stopped) fit.

    Attributes:
        problem, state: what was fitted and where it ended.
        reduced: the rows at the end.
        prior: weights 1/tau of the parameter columns, 0 without prior (C,).
        scale: one tolerance, or a unit of comparable effect, per column (C,).
        keep: rows used, by data set.
        iterations, converged: of the loop.
        noise_factor: robust scale of the residuals over the stated noise, at least 1.
        prior_scale: factor on the tolerances that generalised cross-validation chose.
        reasons: why rows were left out, by data set: row index -> reason.
    """

    problem: Problem
    state: State
    reduced: Reduced
    prior: Array
    scale: Array
    keep: tuple[Bools, ...]
    iterations: int
    converged: bool
    noise_factor: float = 1.0
    prior_scale: float = 1.0
    reasons: tuple[dict[int, str], ...] = ()


Progress = Callable[[int, float], None]


def prior_weights(problem: Problem, method: str) -> Array:
    """Return 1/tau per column (C,), 0 where there is no prior."""
    weights = np.zeros(len(problem.columns))
    if method in ("flat", "damped"):
        return weights
    for c, p in enumerate(problem.free):
        tau = problem.mechanism.parameters[p].tolerance
        weights[c] = 1.0 / tau if tau is not None and np.isfinite(tau) and tau > 0.0 else 0.0
    return weights


def parameter_scale(problem: Problem) -> Array:
    """Return the unit in which each free parameter is judged (F,): its tolerance, SI.

    Without a finite tolerance: a thousandth of the reach, or 1e-3 rad.
    """
    out = np.empty(len(problem.free))
    for c, p in enumerate(problem.free):
        parameter = problem.mechanism.parameters[p]
        tau = parameter.tolerance
        natural = 1e-3 * (problem.mechanism.reach if parameter.quantity == "length" else 1.0)
        out[c] = tau if tau is not None and np.isfinite(tau) and tau > 0.0 else natural
    return out


def reduce_rows(problem: Problem, state: State, keep: Sequence[Bools],
                weights: Sequence[Array] | None = None) -> Reduced:
    """Accumulate all rows into one triangle by QR."""
    size = len(problem.columns) + 1
    stack = np.zeros((0, size))
    count = 0
    for rows in problem.rows(state, True, keep):
        block = np.concatenate([rows.jacobian, rows.residual[..., None]], axis=-1)
        if weights is not None:
            block = block * weights[rows.dataset][rows.index][:, None, None]
        block = block.reshape(-1, size)
        count += int(rows.observed.sum())
        stack = np.linalg.qr(np.concatenate([stack, block]), mode="r")
    full = np.zeros((size, size))
    full[:min(size, stack.shape[0])] = stack[:size]
    right = full[:-1, -1]
    return Reduced(full[:-1, :-1], right, float(np.sum(full[:, -1] ** 2)), count)


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


def solve_step(problem: Problem, state: State, reduced: Reduced, prior: Array, damping: float
               ) -> tuple[Array, float]:
    """Return the step (C,) of the small problem and the decrease it promises.

    Directions that neither data nor prior see are left where they are (minimum norm in
    scaled units).
    """
    free = list(problem.free)
    scale = column_scale(problem)
    away = np.zeros(len(problem.columns))
    away[:len(free)] = problem.mechanism.nominals[free] - state.g[free]
    norms = np.linalg.norm(reduced.triangle * scale, axis=0)
    extra = np.sqrt(damping) * np.where(norms > 0.0, norms, 1.0)
    matrix = np.concatenate([reduced.triangle * scale, np.diag(prior * scale), np.diag(extra)])
    right = np.concatenate([reduced.right, prior * away, np.zeros(scale.size)])
    size = scale.size
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    use = s > SOLVE_TOLERANCE * s.max(initial=1e-300)
    coefficient = np.where(use, (u.T @ right) / np.where(use, s, 1.0), 0.0)
    x = vt.T @ coefficient
    plain = matrix[:2 * size]
    decrease = float(np.sum(right[:2 * size] ** 2) - np.sum((right[:2 * size] - plain @ x) ** 2))
    return x * scale, decrease


def gauss_newton(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
                 iterations: int, weigh: Callable[[State], Sequence[Array]] | None = None,
                 progress: Progress | None = None) -> tuple[State, Reduced, int, bool]:
    """Levenberg-Marquardt on the whitened problem; returns state, rows, count, converged."""
    damping = 0.0
    for count in range(1, iterations + 1):
        weights = weigh(state) if weigh else None
        reduced = reduce_rows(problem, state, keep, weights)
        before = cost(problem, state, keep, prior, weights)
        if progress:
            progress(count, before)
        while True:
            step, decrease = solve_step(problem, state, reduced, prior, damping)
            scaled = float(np.max(np.abs(step / column_scale(problem)), initial=0.0))
            limit = max(CONVERGED, 1e-10 * before)
            if decrease < limit or scaled < ROUND_OFF:
                return problem.moved(state, step) if damping == 0.0 and _better(
                    problem, state, step, keep, prior, weights, before) else state, \
                    reduced, count, True
            trial = problem.moved(state, step)
            after = cost(problem, trial, keep, prior, weights)
            if after >= before and damping == 0.0:
                trial, after = _second_chance(problem, trial, keep, prior, weights)
            if after < before or (weigh is not None and after < before * (1 + 1e-9)):
                state = trial
                damping = damping / 10.0 if damping > SMALLEST_DAMPING else 0.0
                break
            damping = max(10.0 * damping, SMALLEST_DAMPING)
            if damping > 1e6:
                return state, reduced, count, bool(decrease < 1e-6 * max(before, 1.0))
    return state, reduce_rows(problem, state, keep, None), iterations, False


def _second_chance(problem: Problem, trial: State, keep: Sequence[Bools], prior: Array,
                   weights: Sequence[Array] | None) -> tuple[State, float]:
    """Take a second plain step from a trial that was worse, and judge after it.

    Where frame and geometry turn together the data see nothing at first order and a very
    steep wall at second order; one straight step runs into the wall, the next one off it.
    """
    if any(not np.isfinite(p[k]).all() for p, k in zip(trial.poses, keep, strict=True)):
        return trial, float("inf")
    reduced = reduce_rows(problem, trial, keep, weights)
    trial = problem.moved(trial, solve_step(problem, trial, reduced, prior, 0.0)[0])
    return trial, cost(problem, trial, keep, prior, weights)


def _better(problem: Problem, state: State, step: Array, keep: Sequence[Bools], prior: Array,
            weights: Sequence[Array] | None, before: float) -> bool:
    return cost(problem, problem.moved(state, step), keep, prior, weights) <= before


def identify(problem: Problem, options: Options | None = None, progress: Progress | None = None,
             start: State | None = None) -> Fit:
    """Fit the free parameters and open frames to the data.

    Args:
        problem: machine, data and free parameters.
        options: method and its settings.
        progress: called with (iteration, chi-squared).
        start: where to start, default the machine's present values.

    Raises:
        BadInput: too few rows. NoResult: no pose could be solved, or the damped scheme of
        [PPM] did not converge.
    """
    options = options or Options()
    prior = prior_weights(problem, options.method)
    state = start or problem.start()
    keep, reasons = _usable(problem, state)
    _enough(problem, keep)
    state = replace(state, poses=tuple(np.where(k[:, None], p, np.nan) for p, k in
                                       zip(state.poses, keep, strict=True)))
    state = start_off_zero(problem, state, keep)
    if options.method == "damped":
        return damped(problem, state, keep, reasons, options, progress)
    if options.robust:
        state, _, _, _ = gauss_newton(problem, state, keep, prior, options.iterations,
                                      lambda s: huber_weights(problem, s, keep), progress)
    fit = _fit(problem, state, keep, reasons, prior, options, progress)
    if options.method == "gcv":
        fit = _cross_validated(fit, options, progress)
    return _without_outliers(fit, options, progress) if options.robust else fit


def _fit(problem: Problem, state: State, keep: Sequence[Bools], reasons: Sequence[dict[int, str]],
         prior: Array, options: Options, progress: Progress | None, scale: float = 1.0) -> Fit:
    state, reduced, count, converged = gauss_newton(problem, state, keep, prior,
                                                    options.iterations, None, progress)
    return Fit(problem, state, reduced, prior, column_scale(problem), tuple(keep),
               count, converged, prior_scale=scale, reasons=tuple(reasons))


def _usable(problem: Problem, state: State) -> tuple[list[Bools], list[dict[int, str]]]:
    """Return which rows can be used, and why the others cannot."""
    keep, reasons = [], []
    motion = problem.mechanism.motion
    for data, pose in zip(problem.datasets, state.poses, strict=True):
        known = np.isfinite(data.q).all(axis=1)
        solved = np.isfinite(pose).all(axis=1)
        parts = list(coordinates(data, motion))
        measured = np.concatenate([data.position, data.rotation], axis=1)[:, parts]
        seen = np.isfinite(measured).any(axis=1)
        keep.append(solved & seen)
        own: dict[int, str] = {}
        for rows, reason in ((~known, "joint values missing"),
                             (known & ~solved, "no pose at these joint values"),
                             (solved & ~seen, "nothing measured")):
            own.update({int(n): reason for n in np.flatnonzero(rows)})
        reasons.append(own)
    return keep, reasons


def _enough(problem: Problem, keep: Sequence[Bools]) -> None:
    rows = sum(int(k.sum()) for k in keep)
    where = ", ".join(d.source for d in problem.datasets)
    if rows == 0:
        raise NoResult("no row has a pose: the joint values do not fit this machine", where,
                       "Check the q columns, their units and the home pose.")
    if rows < 3:
        raise BadInput(f"{rows} usable row{'s' if rows > 1 else ''} cannot calibrate a machine",
                       where, "Measure more poses, some dozens if possible.")


def start_off_zero(problem: Problem, state: State, keep: Sequence[Bools]) -> State:
    """Move parameters off a nominal at which they have no first-order effect.

    A lateral offset that enters as u^2 + lateral^2 has zero slope at 0: Gauss-Newton would
    stay there. Such parameters start half a tolerance away; those whose effect vanishes
    there too (a passive angle) stay at their nominal.
    """
    scale = parameter_scale(problem)
    flat = _flat_columns(problem, state, keep, scale)
    if not flat.any():
        return state
    step = np.zeros(len(problem.columns))
    step[:scale.size] = np.where(flat, 0.5 * scale, 0.0)
    aside = problem.moved(state, step)
    # only a noticeable slope half a tolerance away makes a parameter worth moving
    still = _flat_columns(problem, aside, keep, scale)
    step[:scale.size] = np.where(flat & ~still, 0.5 * scale, 0.0)
    return problem.moved(state, step)


def _flat_columns(problem: Problem, state: State, keep: Sequence[Bools], scale: Array) -> Bools:
    reduced = reduce_rows(problem, state, keep)
    norms = np.linalg.norm(reduced.triangle[:, :scale.size], axis=0) * scale
    return np.asarray(norms < 1e-9 * max(float(norms.max(initial=0.0)), 1e-300), dtype=bool)


def posterior(fit: Fit) -> Array:
    """Return the covariance of all columns (C, C), SI; inf on the diagonal where unbounded.

    Directions seen neither by data nor by prior have no bound; columns that take part in one
    get an infinite variance, and their covariances are those within the bounded part.
    """
    matrix = np.concatenate([fit.reduced.triangle * fit.scale, np.diag(fit.prior * fit.scale)])
    _, s, vt = np.linalg.svd(matrix, full_matrices=False)
    use = s > SOLVE_TOLERANCE * s.max(initial=1e-300)
    v = vt[use].T / s[use]
    out = (v @ v.T) * np.outer(fit.scale, fit.scale)
    free = np.sqrt(np.sum(vt[~use] ** 2, axis=0)) > 1e-6
    out[free, free] = np.inf
    return np.asarray(out, dtype=float)


def prediction_covariance(fit: Fit) -> Array:
    """Return a covariance (C, C) that is right for predictions of measured rows.

    Null directions do not move what the data saw, so they are left out altogether.
    """
    matrix = np.concatenate([fit.reduced.triangle * fit.scale, np.diag(fit.prior * fit.scale)])
    _, s, vt = np.linalg.svd(matrix, full_matrices=False)
    use = s > SOLVE_TOLERANCE * s.max(initial=1e-300)
    v = vt[use].T / s[use]
    return np.asarray((v @ v.T) * np.outer(fit.scale, fit.scale), dtype=float)


def _without_outliers(fit: Fit, options: Options, progress: Progress | None) -> Fit:
    """Leave out rows that do not belong, worst first, refitting after each round."""
    keep = [k.copy() for k in fit.keep]
    reasons = [dict(r) for r in fit.reasons]
    total = sum(int(k.sum()) for k in keep)
    dropped: set[tuple[int, int]] = set()
    factor = 1.0
    for _ in range(total):
        found = distances(fit.problem, fit.state, prediction_covariance(fit), keep)
        factor = found.factor(keep)
        bad = worst(found, keep, factor)
        if not bad or len(dropped) >= total // 3:
            break
        for i, n, _ in bad[:max(1, total // 50)]:
            keep[i][n] = False
            dropped.add((i, n))
        fit = _fit(fit.problem, fit.state, keep, reasons, fit.prior, options, progress,
                   fit.prior_scale)
    return _readmit(fit, keep, reasons, dropped, factor, options, progress)


def _readmit(fit: Fit, keep: list[Bools], reasons: list[dict[int, str]],
             dropped: set[tuple[int, int]], factor: float, options: Options,
             progress: Progress | None) -> Fit:
    """Take back rows that the final fit explains; write down why the others are out."""
    if dropped:
        found = distances(fit.problem, fit.state, prediction_covariance(fit), keep)
        total = sum(int(k.sum()) for k in keep) + len(dropped)
        p = found.p_values(factor)
        back = [(i, n) for i, n in sorted(dropped) if p[i][n] * total >= REJECT]
        for i, n in back:
            keep[i][n] = True
        for i, n in sorted(dropped - set(back)):
            away = np.sqrt(found.square[i][n] / max(found.size[i][n], 1.0)) / factor
            reasons[i][n] = f"outlier: {away:.1f} times the noise"
        if back:
            fit = _fit(fit.problem, fit.state, keep, reasons, fit.prior, options, progress,
                       fit.prior_scale)
    return replace(fit, noise_factor=factor, reasons=tuple(reasons))


def _cross_validated(fit: Fit, options: Options, progress: Progress | None) -> Fit:
    """Refit with the prior scale that generalised cross-validation chooses."""
    base = fit.prior
    scale = 1.0
    for _ in range(5):
        new = gcv_scale(fit, base)
        done = abs(np.log(new / scale)) < 0.05
        scale = new
        fit = _fit(fit.problem, fit.state, fit.keep, fit.reasons, base / scale, options, progress,
                   scale)
        if done:
            break
    return fit


def gcv_scale(fit: Fit, base: Array) -> float:
    """Return the factor on all tolerances that minimises n RSS / (n - tr H)^2.

    Golub, Heath and Wahba (1979), on the linearised problem with open frames projected
    out; searched on a grid of 10^-3 to 10^3, refined once.
    """
    count = len(fit.problem.free)
    tau = np.where(base[:count] > 0.0, 1.0 / np.where(base[:count] > 0.0, base[:count], 1.0),
                   fit.scale[:count])
    away = (fit.state.g[list(fit.problem.free)]
            - fit.problem.mechanism.nominals[list(fit.problem.free)]) / tau
    block, nuisance = fit.reduced.triangle[:, :count] * tau, fit.reduced.triangle[:, count:]
    right = fit.reduced.right + block @ away
    lost = 0
    if nuisance.shape[1]:
        u, s, _ = np.linalg.svd(nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300),
                                full_matrices=False)
        u = u[:, s > RANK_TOLERANCE * s[0]]
        lost = u.shape[1]
        block, right = block - u @ (u.T @ block), right - u @ (u.T @ right)
    u, s, _ = np.linalg.svd(block, full_matrices=False)
    b = u.T @ right
    rest = fit.reduced.square - float(np.sum(fit.reduced.right**2)) + float(
        np.sum(right**2) - np.sum(b**2))

    def score(log_scale: float) -> float:
        f = s**2 / (s**2 + 10.0 ** (-2.0 * log_scale))
        return float((rest + np.sum(((1 - f) * b) ** 2))
                     / (fit.reduced.count - lost - np.sum(f)) ** 2)

    grid = np.linspace(-3.0, 3.0, 121)
    best = grid[int(np.argmin([score(x) for x in grid]))]
    fine = np.linspace(best - 0.05, best + 0.05, 41)
    return float(10.0 ** fine[int(np.argmin([score(x) for x in fine]))])


def damped(problem: Problem, state: State, keep: Sequence[Bools],
           reasons: Sequence[dict[int, str]], options: Options,
           progress: Progress | None = None) -> Fit:
    """The scheme of [PPM] section 4.5: step = (J^T J + lambda I)^-1 J^T r, in m and rad.

    A damping, centred anew in each iteration, not a prior: where it ends depends on the
    units and on when it stops. It is called converged when an undamped step would lower
    the whitened chi-squared by less than 0.01.
    """
    unit = replace(problem, datasets=tuple(unit_noise(d) for d in problem.datasets))
    count = len(problem.free)
    none = np.zeros(len(problem.columns))
    converged = False
    reduced = reduce_rows(problem, state, keep)
    iteration = 0
    for iteration in range(1, 100 * options.iterations + 1):
        plain = reduce_rows(unit, state, keep)
        matrix = plain.triangle.T @ plain.triangle
        matrix[:count, :count] += options.damping * np.eye(count)
        step = np.linalg.lstsq(matrix, plain.triangle.T @ plain.right, rcond=1e-15)[0]
        state = problem.moved(state, step)
        reduced = reduce_rows(problem, state, keep)
        if progress:
            progress(iteration, reduced.square)
        if solve_step(problem, state, reduced, none, 0.0)[1] < max(0.01, 1e-9 * reduced.square):
            converged = True
            break
    return Fit(problem, state, reduced, none, column_scale(problem), tuple(keep),
               iteration, converged, reasons=tuple(reasons))


def unit_noise(data: Dataset) -> Dataset:
    """Return the data set with noise 1 m and 1 rad, no joint noise: the paper's weighting."""
    return replace(data, sigma_position=np.ones_like(data.sigma_position),
                   sigma_rotation=np.ones_like(data.sigma_rotation),
                   sigma_value=np.ones_like(data.sigma_value),
                   sigma_actuator=np.zeros_like(data.sigma_actuator))
