"""How noisy each instrument is: residuals by data set, and weights from them.

Variance components by Helmert's simple estimate: the noise of a data set is its squared
residuals over its redundancy (rows minus what the fit takes from them), and with the new
weights the fit is repeated until the two agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.arrays import Array
from ppmcal.fit import Fit, Options, prediction_covariance
from ppmcal.gauss_newton import Progress, gauss_newton
from ppmcal.identify import identify
from ppmcal.linear import reduce_rows
from ppmcal.model.dataset import Dataset
from ppmcal.problem import Problem

LEAST = 5.0
"""A data set of less redundancy keeps its stated noise."""
ROUNDS, SETTLED = 30, 0.005


def noise_ratios(fit: Fit) -> tuple[Array, Array]:
    """Return each data set's noise over the stated one, and its redundancy (D,).

    nan where the redundancy is below :data:`LEAST`.
    """
    count = len(fit.problem.datasets)
    square, freedom = np.zeros(count), np.zeros(count)
    covariance = prediction_covariance(fit)
    for rows in fit.problem.rows(fit.state, True, fit.keep):
        taken = float(np.sum((rows.jacobian @ covariance) * rows.jacobian))
        square[rows.dataset] += float(np.sum(rows.residual**2))
        freedom[rows.dataset] += float(rows.observed.sum()) - taken
    enough = freedom >= LEAST
    return np.where(enough, np.sqrt(square / np.where(enough, freedom, 1.0)), np.nan), freedom


def with_estimated_noise(problem: Problem, options: Options, progress: Progress | None = None
                         ) -> tuple[Fit, Array]:
    """Fit with the noise of each data set as its residuals show it.

    Args:
        problem: machine and data with stated noise.
        options: of the fits.
        progress: as for :func:`ppmcal.identify.identify`.

    Returns:
        The fit, and by what the stated noise of each data set was multiplied (D,).

    Raises:
        BadInput, NoResult: as :func:`ppmcal.identify.identify`.
    """
    factor = np.ones(len(problem.datasets))
    fit = identify(problem, options, progress)
    for _ in range(ROUNDS):
        ratio, _ = noise_ratios(fit)
        ratio = np.where(np.isfinite(ratio) & (ratio > 0.0), ratio, 1.0)
        if np.max(np.abs(np.log(ratio))) < SETTLED:
            break
        factor = factor * ratio
        scaled = replace(problem, datasets=_scaled(problem.datasets, factor))
        fit = identify(scaled, options, progress, fit.state, near=True)
    return fit, factor


def with_noise(fit: Fit, factor: float, options: Options) -> Fit:
    """Return a fit to the same rows with their stated noise times ``factor``.

    The tolerances stay what they are, so that they weigh more: values and uncertainties are the
    posterior of rows so noisy. Scaling all uncertainties instead would make parameters less
    certain than their tolerances, and values fitted to noise would stay. Without a prior, or with
    one that generalised cross-validation chose by the residuals themselves, values stay.
    """
    if factor == 1.0:
        return fit
    datasets = _scaled(fit.problem.datasets, np.full(len(fit.problem.datasets), factor))
    noisier = replace(fit.problem, datasets=datasets,
                      pivots=tuple(o.about for o in fit.problem.opens))
    chosen = options.method == "gcv"
    state, converged = fit.state, fit.converged
    if fit.prior.any() and not chosen:
        state, _, _, converged = gauss_newton(noisier, state, fit.keep, fit.prior,
                                              options.most)
    return replace(fit, state=state, reduced=reduce_rows(noisier, state, fit.keep),
                   prior=fit.prior / factor if chosen else fit.prior, noise=factor * fit.noise,
                   prior_scale=fit.prior_scale * (factor if chosen else 1.0),
                   converged=fit.converged and converged)


def _scaled(datasets: Sequence[Dataset], factor: Array) -> tuple[Dataset, ...]:
    return tuple(replace(
        d, sigma_position=f * d.sigma_position, sigma_rotation=f * d.sigma_rotation,
        sigma_value=f * d.sigma_value, sigma_actuator=f * d.sigma_actuator)
        for d, f in zip(datasets, factor.tolist(), strict=True))
