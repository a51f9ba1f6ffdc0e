"""Two other regularisations: one prior scale by cross-validation, and [PPM]'s damping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import Fit, FitOptions, like_noise
from ppmcal.calibration.fit.linearisation import column_scale, normal_step, qr_factor
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.calibration.fit.rank import RANK_TOLERANCE
from ppmcal.calibration.fit.unsolved_rows import NO_POSE
from ppmcal.errors import NoResult
from ppmcal.linalg import (
    Array,
    Bools,
    finite_rows,
    range_basis,
    reciprocals,
    svd,
    unit_columns,
    without_range,
)
from ppmcal.model.dataset import Dataset
from ppmcal.wording import pluralize
from ppmcal.wording.progress import note

DAMPED_ITERATIONS, SOON = 6000, 60
"""Maximum number of iterations of the damped scheme, and how many more are worthwhile once the
residuals are down to the noise."""
MOST_LOST = 0.5
"""A step that leaves more than this part of the rows without a pose has diverged."""


def gcv_scale(fit: Fit, base: Array) -> float:
    """Return the factor on all tolerances that minimises n RSS / (n - tr H)^2.

    Golub, Heath and Wahba (1979), on the linearised problem with open frames projected
    out; searched on a grid of 10^-3 to 10^3, refined once.
    """
    count = len(fit.problem.free)
    tau = np.where(base[:count] > 0.0, reciprocals(base[:count]), fit.scale[:count])
    away = (fit.state.g[list(fit.problem.free)]
            - fit.problem.mechanism.nominals[list(fit.problem.free)]) / tau
    block, nuisance = fit.information.root[:, :count] * tau, fit.information.root[:, count:]
    right = fit.information.right + block @ away
    lost = 0
    if nuisance.shape[1]:
        basis = range_basis(unit_columns(nuisance), RANK_TOLERANCE)
        lost = basis.shape[1]
        block, right = without_range(block, basis), without_range(right, basis)
    u, s, _ = svd(block)
    b = u.T @ right
    rest = fit.information.square - float(np.sum(fit.information.right**2)) + float(
        np.sum(right**2) - np.sum(b**2))

    def score(log_scale: float) -> float:
        f = s**2 / (s**2 + 10.0 ** (-2.0 * log_scale))
        return float((rest + np.sum(((1 - f) * b) ** 2))
                     / (fit.information.count - lost - np.sum(f)) ** 2)

    grid = np.linspace(-3.0, 3.0, 121)
    best = grid[int(np.argmin([score(x) for x in grid]))]
    fine = np.linspace(best - 0.05, best + 0.05, 41)
    return float(10.0 ** fine[int(np.argmin([score(x) for x in fine]))])


def damped(problem: Problem, state: State, keep: Sequence[Bools],
           reasons: Sequence[dict[int, str]], options: FitOptions) -> Fit:
    """The scheme of [PPM] section 4.5: step = (J^T J + lambda I)^-1 J^T r, in m and rad.

    This is damping, recentred in each iteration, and not a prior: the result depends on the
    units and on when it stops. It has converged when the remaining undamped step would move
    the predictions by less than a tenth of the noise, all rows together.

    It ends sooner after ``options.iterations``, or if the residuals are down to the noise and
    convergence is far off (Morozov's discrepancy principle): continuing would fit noise.
    :attr:`Fit.stopped` says so. Rows that lose their pose on the way are left out.

    Raises:
        NoResult: most of the rows lose their pose.
    """
    unit = replace(problem, datasets=tuple(unit_noise(d) for d in problem.datasets))
    count = len(problem.free)
    none = np.zeros(len(problem.columns))
    converged, stopped = False, ""
    limit = options.iterations or DAMPED_ITERATIONS
    information, plain = qr_factor(problem, state, keep), qr_factor(unit, state, keep)
    iteration, away = 0, float("inf")
    for iteration in range(1, limit + 1):
        matrix = plain.root.T @ plain.root
        matrix[:count, :count] += options.damping * np.eye(count)
        step = np.asarray(linalg.lstsq(matrix, plain.root.T @ plain.right, rcond=1e-15)[0],
                          dtype=np.float64)
        state = problem.moved(state, step)
        _refuse_astray(problem, state, keep, iteration)
        information, plain = qr_factor(problem, state, keep), qr_factor(unit, state, keep)
        note(f"iteration {iteration}, chi-squared {information.square:.6g}")
        left, _ = normal_step(unit, state, plain, none).step()
        away, before = float(np.sum((information.root @ left) ** 2)), away
        if away < 0.01:
            converged = True
            break
        if like_noise(information) and _hopeless(away, before, SOON):
            stopped = f"at the noise, after {pluralize(iteration, 'iteration')}"
            break
        if not options.iterations and iteration >= 20 and _hopeless(away, before, limit):
            break
    if options.iterations and not (converged or stopped):
        stopped = f"after {pluralize(iteration, 'iteration')}, as requested"
    lost = [k & ~finite_rows(p) for k, p in zip(keep, state.poses, strict=True)]
    return Fit(problem, state, information, none, column_scale(problem),
               tuple(k & ~gone for k, gone in zip(keep, lost, strict=True)),
               iteration, converged, stopped=stopped, reasons=tuple(
                   {**why, **dict.fromkeys(np.flatnonzero(gone).tolist(), NO_POSE)}
                   for why, gone in zip(reasons, lost, strict=True)))


def _refuse_astray(problem: Problem, state: State, keep: Sequence[Bools], iteration: int) -> None:
    """Refuse a machine at which most of the rows in use have no pose: nothing is left to fit."""
    rows = sum(int(k.sum()) for k in keep)
    lost = sum(int((~finite_rows(p[k])).sum()) for k, p in zip(keep, state.poses, strict=True))
    if lost > MOST_LOST * rows:
        raise NoResult(f"the damped scheme diverged: after {pluralize(iteration, 'iteration')} "
                       f"{lost} of {rows} rows have no pose",
                       ", ".join(d.source for d in problem.datasets),
                       "Look for mistyped values, which this scheme does not reject, or use "
                       "the prior (--method prior)")


def _hopeless(away: float, before: float, iterations: int) -> bool:
    """Whether the scheme contracts too slowly to converge within so many more iterations."""
    if away >= before:
        return True
    return bool(np.log(away / 0.01) / np.log(before / away) > iterations)


def unit_noise(data: Dataset) -> Dataset:
    """Return the data set with noise 1 m and 1 rad, no joint noise: the paper's weighting."""
    return replace(data, sigma_position=np.ones_like(data.sigma_position),
                   sigma_rotation=np.ones_like(data.sigma_rotation),
                   sigma_value=np.ones_like(data.sigma_value),
                   sigma_actuator=np.zeros_like(data.sigma_actuator), gap_factor=0.0,
                   covariance=None)
