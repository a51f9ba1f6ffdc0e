"""Do the residuals agree with the stated noise? Chi-squared, by data set, and repeats."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from ppmcal.calibration.fit.coverage import LEAST
from ppmcal.calibration.fit.fit_result import (
    Fit,
    FitOptions,
    directions,
    prediction_covariance,
    values_taken,
)
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.gauge import by_frames
from ppmcal.calibration.fit.gauss_newton import least_squares, prior_square
from ppmcal.calibration.fit.linearisation import (
    prior_weights,
    qr_factor,
    seen_directions,
    to_prior,
)
from ppmcal.calibration.fit.observation import noise_quantity, typical_noise
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.repeated_rows import ENOUGH_REPEATS
from ppmcal.linalg import Array, Bools, svd
from ppmcal.model.dataset import Dataset
from ppmcal.model.repeats import repeats
from ppmcal.notes import NOTE, Note
from ppmcal.units import Finite, OrNull

log = logging.getLogger(__package__)

ROUNDS, SETTLED = 30, 0.005


def noise_ratios(fit: Fit) -> tuple[Array, Array]:
    """Return each data set's estimated over stated noise, and its redundancy (D,).

    nan where the redundancy is below :data:`LEAST`.
    """
    square, freedom = _squares(fit)
    enough = freedom >= LEAST
    return np.where(enough, np.sqrt(square / np.where(enough, freedom, 1.0)), np.nan), freedom


def _steps(fit: Fit, factor: Array) -> Array:
    """Return by how much to multiply each noise, which is now ``factor`` times the stated (D,)."""
    square, freedom = _squares(fit)
    began = np.array([d.estimated for d in fit.problem.datasets])
    own = np.sqrt((square + LEAST / factor**2) / (np.maximum(freedom, 0.0) + LEAST))
    return np.where(began, own, noise_ratios(fit)[0])


def _squares(fit: Fit) -> tuple[Array, Array]:
    """Return each data set's sum of squared white residuals and its redundancy (D,)."""
    count = len(fit.problem.datasets)
    square, freedom = np.zeros(count), np.zeros(count)
    covariance = prediction_covariance(fit)
    for rows in fit.problem.rows(fit.state, True, fit.keep):
        taken = float(np.sum((rows.jacobian @ covariance) * rows.jacobian))
        square[rows.dataset] += float(np.sum(rows.residual**2))
        freedom[rows.dataset] += rows.count - taken
    return square, freedom


def with_estimated_noise(problem: Problem, options: FitOptions,
                         which: Sequence[bool] | None = None) -> tuple[Fit, Array]:
    """Fit with the noise of each data set estimated from its residuals.

    Data sets that ask for this themselves start from their stated noise, which counts as
    :data:`LEAST` redundant values: a handful of touches can then weight its own noise without
    running off. That is the mode of an inverse gamma distribution of the variance.

    Args:
        problem: machine and data with stated noise.
        options: of the fits.
        which: data sets whose noise is estimated (D,)  [default: all].

    Returns:
        The fit, and the factor on the stated noise of each data set (D,).

    Raises:
        BadInput, NoResult: see :func:`ppmcal.calibration.fit.identify`.
    """
    factor = np.ones(len(problem.datasets))
    chosen = np.ones(factor.size, dtype=bool) if which is None else np.array(which)
    fit = identify(problem, options)
    for _ in range(ROUNDS):
        ratio = _steps(fit, factor)
        ratio = np.where(chosen & np.isfinite(ratio) & (ratio > 0.0), ratio, 1.0)
        if np.max(np.abs(np.log(ratio))) < SETTLED:
            break
        factor = factor * ratio
        log.info("noise estimated: %s times the stated one", ", ".join(f"{f:.3g}" for f in factor))
        scaled = replace(problem, datasets=_scaled(problem.datasets, factor))
        fit = identify(scaled, options, fit.state, near=True)
    return fit, factor


def noise_sentences(problem: Problem, factor: Array, which: Sequence[bool]) -> list[Note]:
    """Return the estimated noise of data sets (D,) in their own units, as notes."""
    out = []
    for data, f, wanted in zip(problem.datasets, factor.tolist(), which, strict=True):
        if wanted and not data.estimated:
            out.append(Note(f"{data.name}: noise {f:.3g} times the stated one.", NOTE, "noise"))
        elif wanted:
            of = noise_quantity(data)
            began, unit = typical_noise(data) / data.units.factor(of), data.units.name(of)
            out.append(Note(f"{data.name}: noise {began * f:.3g} {unit}, estimated from its "
                            f"residuals; the {began:g} {unit} in its sidecar counts as "
                            f"{LEAST:.0f} redundant values.", NOTE, "noise"))
    return out


def with_own_noise(problem: Problem, options: FitOptions
                   ) -> tuple[Problem, list[Note]]:
    """Return the problem with noise estimated for the data sets that ask for it, and the notes.

    Raises:
        BadInput, NoResult: see :func:`ppmcal.calibration.fit.identify`.
    """
    which = [d.estimated for d in problem.datasets]
    if not any(which):
        return problem, []
    _, factor = with_estimated_noise(problem, options, which)
    return (replace(problem, datasets=_scaled(problem.datasets, factor)),
            noise_sentences(problem, factor, which))


def with_noise(fit: Fit, factor: float, options: FitOptions) -> Fit:
    """Return a fit to the same rows with their stated noise times ``factor``.

    The tolerances stay as they are and so weigh more: values and uncertainties are the
    posterior for rows with this noise. Scaling all uncertainties instead would make parameters less
    certain than their tolerances, and values fitted to noise would stay. Without a prior, or with
    one chosen by generalised cross-validation from the residuals themselves, values stay.
    """
    if factor == 1.0:
        return fit
    datasets = _scaled(fit.problem.datasets, np.full(len(fit.problem.datasets), factor))
    noisier = fit.problem.changed(datasets=datasets)
    chosen = options.method == "gcv"
    wider = fit.prior_scale * (factor if chosen else 1.0)
    state, converged = fit.state, fit.converged
    if fit.prior.any() and not chosen:
        found = least_squares(noisier, state, fit.keep, fit.prior, options.most)
        state, converged = found.state, found.converged
    return replace(fit, state=state, information=qr_factor(noisier, state, fit.keep),
                   prior=prior_weights(noisier, options.method, wider) if chosen else fit.prior,
                   noise=factor * fit.noise, prior_scale=wider, converged=converged)


def _scaled(datasets: Sequence[Dataset], factor: Array) -> tuple[Dataset, ...]:
    return tuple(d.noisier(f) for d, f in zip(datasets, factor.tolist(), strict=True))


FAILED_NOISE = 1e-3
"""The noise check fails below this p-value, on either side."""
OVERSTATED = 0.5
"""A stated noise is overstated if residuals are below this part of it."""


LARGER, SMALLER, AGREES = "larger", "smaller", "agrees"
"""How residuals compare with the stated noise."""


STATED = "stated"
ESTIMATED = "estimated"


def noise_source(datasets: Sequence[Dataset]) -> str:
    """Return the source of data sets' noise: ``stated``, ``estimated``, or both in words.

    It is estimated if the sidecar says so: then its number is not a statement about the noise.
    """
    kinds = {d.estimated for d in datasets}
    return f"{STATED} or {ESTIMATED}" if len(kinds) > 1 else ESTIMATED if True in kinds else STATED


def noise_state(ratio: float | None, p: float | None) -> str:
    """Return whether residuals are larger or smaller than the stated noise, or agree with it.

    The one place that decides this. A failed check needs a small probability, because with few
    degrees of freedom any ratio is possible.

    Args:
        ratio: rms of the residuals over the stated noise.
        p: chance of a larger chi-squared; None, or nan, if it is unknown.
    """
    if ratio is None or p is None or np.isnan(p):
        return AGREES
    if p < FAILED_NOISE and ratio > 1.0:
        return LARGER
    return SMALLER if p > 1.0 - FAILED_NOISE and ratio < OVERSTATED else AGREES


@dataclass(frozen=True)
class Noise:
    """Residuals against the stated noise, and separately the errors against the tolerances.

    ``sigma_ratio``: residual over stated noise; ``chi2``, ``degrees``: of what no error of the
    machine can explain; ``chi2_p``: chance of a larger one; ``prior_chi2``, ``prior_degrees``,
    ``prior_p``: the same for the errors found, against tolerances and noise;
    ``repeat_ratio``: scatter of repeats over stated noise, None without repeats; ``by_dataset``:
    ``sigma_ratio`` of each data set with enough redundancy; all bare. ``source``: see
    :func:`noise_source`.
    """

    sigma_ratio: Finite
    chi2: Finite
    degrees: Finite
    chi2_p: Finite
    repeat_ratio: Finite | None
    repeat_degrees: OrNull[int]
    by_dataset: Mapping[str, OrNull[Finite]] = field(default_factory=dict)
    prior_chi2: OrNull[Finite] = 0.0
    prior_degrees: OrNull[Finite] = 0.0
    prior_p: Finite = float("nan")
    source: str = STATED

    @property
    def state(self) -> str:
        """Whether the residuals are larger or smaller than the stated noise, or agree with it."""
        return noise_state(self.sigma_ratio, self.chi2_p)

    @property
    def failed(self) -> bool:
        """Whether the residuals are larger than the stated noise can explain."""
        return self.state == LARGER

    @property
    def overstated(self) -> bool:
        """Whether the residuals are far smaller than the stated noise would make them."""
        return self.state == SMALLER

    @property
    def tight(self) -> bool:
        """Whether the errors are larger than tolerances and noise can explain."""
        return self.prior_p < FAILED_NOISE

    @property
    def unexplained(self) -> float:
        """The part of the residuals' rms that noise does not explain, 0 unless the check failed.

        The noise is that of the repeats if there are enough, else the stated one.
        """
        noise = 1.0
        if self.repeat_ratio is not None and self.repeat_degrees >= ENOUGH_REPEATS:
            noise = max(1.0, self.repeat_ratio)
        if not self.failed or self.sigma_ratio <= noise:
            return 0.0
        return float(np.sqrt(1.0 - (noise / self.sigma_ratio) ** 2))

    @property
    def inflation(self) -> float:
        """Factor on the noise of all rows: 1 unless the check failed."""
        return max(1.0, self.sigma_ratio) if self.failed else 1.0


KNOWN = 0.1
"""A direction in which one tolerance moves the rows by less than this part of their noise counts
as noise."""


def _split(fit: Fit) -> tuple[float, float, float, float]:
    """Return chi-squared and degrees of freedom of the noise alone, then of the prior's part.

    What no error of the machine can explain is noise alone; the rest of the minimum compares the
    errors with tolerances and noise. If both are right, the two parts are independent.
    """
    explained, taken = known_part(fit.information.root * fit.scale, fit.information.right,
                                  fit.prior * fit.scale)
    square, degrees = fit.information.square - explained, fit.information.count - taken
    every = fit.information.square + prior_square(fit.problem, fit.state, fit.prior)
    seen = int(np.sum(directions(fit)[2]))
    rest = fit.information.count + int(np.sum(fit.prior > 0.0)) - seen - degrees
    return max(square, 0.0), degrees, max(every - square, 0.0), rest


def known_part(rows: Array, right: Array, held: Array) -> tuple[float, int]:
    """Return chi-squared and values that rows explain where they know more than the tolerances.

    Args:
        rows: white, columns in natural units (n, C).
        right: their residuals (n,).
        held: weight of each column's distance from its nominal, natural units (C,).
    """
    u, s, vt = svd(rows)
    taken = (s > KNOWN * np.linalg.norm(vt * held, axis=1)) & seen_directions(s)
    return float(np.sum((u[:, taken].T @ right) ** 2)), int(taken.sum())


def noise_parts(fit: Fit) -> tuple[float, float]:
    """Return chi-squared and degrees of freedom of what no error of the machine can explain."""
    return _split(fit)[:2]


def against_tolerances(noise: Noise, fit: Fit) -> Noise:
    """Return the check with its prior's part from a fit whose noise was corrected."""
    _, _, chi2, degrees = _split(fit)
    # an error of the frame-defining parameters moves all others, and is no error of the machine
    chi2 = max(chi2 - by_frames(fit.problem.mechanism, fit.problem.datasets, fit.problem.free,
                                fit.prior * to_prior(fit.problem, fit.state)), 0.0)
    return replace(noise, prior_chi2=chi2, prior_degrees=degrees, prior_p=_chance(chi2, degrees))


def _chance(chi2: float, degrees: float) -> float:
    return float(chdtrc(degrees, chi2)) if degrees > 0 else float("nan")


def noise_check(fit: Fit) -> Noise:
    """Return chi-squared of noise and prior, the noise ratio, and the scatter of repeats."""
    square, left = fit.information.square, fit.information.count - values_taken(fit)
    if fit.problem.earlier is not None:
        # the ratio is that of the new rows
        problem, free = fit.problem, len(fit.problem.free)
        missed, slope = fit.problem.earlier.rows(problem.mechanism, problem.free, fit.state.g)
        covariance = prediction_covariance(fit)[:free, :free]
        square -= float(missed @ missed)
        left -= missed.size - float(np.sum((slope @ covariance) * slope))
    chi2, degrees, prior, prior_degrees = _split(fit)
    left = max(left, 1e-9)
    ratio = float(np.sqrt(max(square, 0.0) / left))
    repeat, repeat_degrees = _repeats(fit)
    # one data set has the ratio of all; several need another pass over the rows
    each = noise_ratios(fit)[0] if len(fit.problem.datasets) > 1 else np.array(
        [ratio if left >= LEAST else np.nan])
    own = {d.name: float(r) for d, r in zip(fit.problem.datasets, each, strict=True)
           if np.isfinite(r)}
    return Noise(ratio, chi2, degrees, _chance(chi2, degrees), repeat, repeat_degrees, own, prior,
                 prior_degrees, _chance(prior, prior_degrees), noise_source(fit.problem.datasets))


def _repeated(groups: NDArray[np.int64], keep: Bools) -> Bools:
    """Return which of the rows ``keep`` (N,) are repeated by others of them."""
    _, label, count = np.unique(groups[keep], return_inverse=True, return_counts=True)
    out = np.zeros_like(keep)
    out[keep] = count[label] > 1
    return out


def _repeats(fit: Fit) -> tuple[float | None, int]:
    """Scatter within repeats over the stated noise, and its degrees of freedom."""
    square, degrees = 0.0, 0.0
    for i, data in enumerate(fit.problem.datasets):
        same, weight = repeats(data), fit.problem.weights[i]
        parts = list(fit.problem.rows_of(i, fit.state, False, _repeated(same, fit.keep[i])))
        if not parts:
            continue
        r = np.concatenate([p.residual for p in parts])
        root = np.concatenate([np.sqrt(weight[p.index])[:, None] * p.observed for p in parts])
        _, label = np.unique(same[np.concatenate([p.index for p in parts])], return_inverse=True)
        count = np.zeros((label.max() + 1, r.shape[1]))
        total, more = np.zeros_like(count), np.zeros_like(count)
        np.add.at(count, label, root**2)
        np.add.at(more, label, root**4)
        np.add.at(total, label, root * r)
        some = np.where(count > 0.0, count, 1.0)
        away = np.where(root > 0.0, r - root * (total / some)[label], 0.0)
        square += float(np.sum(away**2))
        degrees += float(np.sum(count - more / some))
    return (float(np.sqrt(square / degrees)), round(degrees)) if degrees else (None, 0)
