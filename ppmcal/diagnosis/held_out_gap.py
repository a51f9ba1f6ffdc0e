"""How much of the excess error the effects remove, on poses held out of the fits.

No row is left out because one of the two models misfits it: misfits of the model under test are
what the gap has to show. Outliers misfit under both. For such a row only the difference between the
models counts: both errors are scaled by one factor until the smaller one equals the largest to be
expected by chance; the part common to both beyond the noise is then subtracted from both. So an
outlier cannot outweigh all other rows, and favours neither model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ppmcal.calibration.fit import (
    Fit,
    Problem,
    State,
    prediction_covariance,
    single_gross_rows,
    values_per_row,
)
from ppmcal.calibration.validation import fresh_state, split
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.refit import of_rows
from ppmcal.inference.priors import SURE
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.sessions import pose_labels

DRAWS = 2000
TOGETHER = 2**19
"""Number of poses drawn in one batch of the bootstrap."""
UNPREDICTED = 100.0
"""Variance of a prediction over that of the noise, beyond which it counts as no prediction."""


@dataclass(frozen=True)
class Gap:
    """Held-out errors in units of the noise.

    Attributes:
        noise: of the measurements, over the stated one.
        before, after: rms over the noise without and with the effects.
        closed: 1 - excess(after)/excess(before), None where nothing exceeded it before.
        interval: 95 % interval of ``closed``, by bootstrap over poses; None if ``closed`` is.
        confirmed: whether the improvement's interval excludes zero.
        worse: whether the errors have grown, with the same confidence, or by more than the noise.
        poses: number of poses held out.
    """

    noise: float
    before: float
    after: float
    closed: float | None
    interval: tuple[float, float] | None
    confirmed: bool
    worse: bool
    poses: int


@dataclass(frozen=True)
class HeldOutErrors:
    """Per row: squared whitened error, variance from the parameters, values, pose label."""

    square: Array
    variance: Array
    count: Array
    group: Ints


def _predictor(fit: Fit, held: Sequence[Dataset]) -> tuple[Problem, State]:
    """Return held-out rows as a problem, with the state predicted by a fit."""
    problem = fit.problem.changed(datasets=tuple(held))
    return problem, fresh_state(problem, fit.state)


def _errors(fit: Fit, problem: Problem, state: State, among: Sequence[Bools] | None = None
            ) -> HeldOutErrors:
    """Return the prediction errors of rows: all, or those ``among`` each data set."""
    parts: list[list[Array]] = [[], [], [], []]
    poses, covariance = pose_labels(problem.datasets), prediction_covariance(fit)
    for rows in problem.rows(state, True, among):
        parts[0].append(np.sum(rows.residual**2, axis=1))
        parts[1].append(np.einsum("nmc,nmc->n", rows.jacobian @ covariance, rows.jacobian))
        parts[2].append(rows.observed.sum(axis=1).astype(float))
        parts[3].append(poses[rows.dataset][rows.index].astype(float))
    square, variance, count, label = (np.concatenate(p) if p else np.zeros(0) for p in parts)
    return HeldOutErrors(square, variance, count, label.astype(np.int64))


def measure_gap(before: Fit, after: Fit, held: Sequence[Dataset], noise: float, seed: int
                ) -> Gap | None:
    """Return the held-out gap, None if no held-out row is predictable.

    If the machine has a pose for a row without the effects but not with them, the effects fail
    there: the gap is then computed from the other rows, and counts as worse.

    Args:
        before: the fit without the effects.
        after: the fit with them.
        held: rows that neither has seen.
        noise: over the stated noise.
        seed: of the bootstrap.
    """
    parts = [(fit, *_predictor(fit, held)) for fit in (before, after)]
    reached = [[finite_rows(p) for p in state.poses] for _, _, state in parts]
    both = [a & b for a, b in zip(*reached, strict=True)]
    if not any(rows.any() for rows in both):
        return None
    old, new = (_errors(*part, both) for part in parts)
    gap = gap_of(old, new, noise, seed)
    lost = any(bool((a & ~b).any()) for a, b in zip(*reached, strict=True))
    return replace(gap, confirmed=False, worse=True) if lost else gap


def gap_of(old: HeldOutErrors, new: HeldOutErrors, noise: float, seed: int) -> Gap:
    """Return the gap of the same rows predicted without and with the effects.

    Args:
        old: errors without the effects.
        new: errors with them.
        noise: over the stated one.
        seed: of the bootstrap.
    """
    count, own = np.maximum(new.count, 1.0), UNPREDICTED * noise**2
    # rows that neither fit can predict are no evidence; rows that only one cannot count against it
    told = np.minimum(old.variance, new.variance) / count <= own
    if not told.any():
        told = np.ones_like(told)
    squares, variances = without_common_misses(old, new, noise, told)
    labels, group = np.unique(new.group[told], return_inverse=True)

    def per_pose(values: Array) -> Array:
        sums = np.bincount(group.reshape(-1), weights=values[told], minlength=labels.size)
        return np.asarray(sums, dtype=np.float64)

    table = np.stack([per_pose(v) for v in (
        # where a fit predicts nothing, its own uncertainty is no excuse
        *squares, *(np.minimum(v, own * count) for v in variances), new.count)])
    whole = table.sum(axis=1)
    sums = _bootstrap(table, seed)
    closed, change = _closed(whole, noise), (sums[0] - sums[1]) / sums[4]
    interval = None
    if closed is not None:
        values = [_closed(s, noise) for s in sums.T]
        known = [v for v in values if v is not None]
        low, high = np.quantile(known, [0.025, 0.975]) if known else (closed, closed)
        interval = float(low), float(high)
    first, last = (float(np.sqrt(whole[i] / whole[4])) / noise for i in (0, 1))
    worse = bool(np.quantile(change, 0.975) < 0.0) or last**2 - first**2 > 1.0
    return Gap(noise, first, last, closed, interval, bool(np.quantile(change, 0.025) > 0.0),
               worse, int(labels.size))


def without_common_misses(old: HeldOutErrors, new: HeldOutErrors, noise: float, told: Bools
                          ) -> tuple[list[Array], list[Array]]:
    """Return squared errors and variances (N,) of both models, less the misfit common to both.

    Args:
        old: errors without the effects.
        new: errors of the same rows with them.
        noise: over the stated one.
        told: rows that count (N,).
    """
    count, both = np.maximum(new.count, 1.0), (old, new)
    away = np.minimum(*(e.square / (noise**2 + e.variance / count) for e in both))
    # if both misfit half of the rows, the rows are not to blame
    scale = max(1.0, float(np.median((away / chdtri(count, 0.5))[told])))
    # bound that noise alone rarely exceeds in any row
    most = scale * chdtri(count, (1.0 - SURE.value) / max(int(told.sum()), 1))
    gross = away > most
    squares = [np.where(gross, most / np.maximum(away, most), 1.0) * e.square for e in both]
    common = np.where(gross, np.minimum(*squares) - scale * noise**2 * count, 0.0)
    return ([s - np.maximum(common, 0.0) for s in squares],
            [np.where(gross, 0.0, e.variance) for e in both])


def _bootstrap(table: Array, seed: int) -> Array:
    """Return sums (k, B) over poses of a table (k, P) drawn with replacement."""
    rng, poses = np.random.default_rng(seed), table.shape[1]
    out = np.empty((len(table), DRAWS))
    step = max(1, TOGETHER // poses)
    for begin in range(0, DRAWS, step):
        sums = out[:, begin:begin + step]
        drawn = rng.integers(poses, size=(sums.shape[1], poses))
        drawn += poses * np.arange(len(drawn))[:, None]
        often = np.bincount(drawn.ravel(), minlength=drawn.size).reshape(drawn.shape)
        sums[...] = table @ often.T
    return out


def _closed(sums: Array, noise: float) -> float | None:
    before = max(0.0, float((sums[0] - sums[2]) / sums[4]) - noise**2)
    after = max(0.0, float((sums[1] - sums[3]) / sums[4]) - noise**2)
    return None if before <= 0.0 else 1.0 - float(np.sqrt(after / before))


def training_part(whole: Fit, options: DiagnosisOptions) -> tuple[Fit, tuple[Dataset, ...]]:
    """Hold out whole commanded poses, if that leaves enough to fit; fit the others."""
    problem = whole.problem
    out = split(problem.datasets, options.holdout, options.seed)
    values = sum(int((~o).sum()) * values_per_row(d, problem.mechanism)
                 for o, d in zip(out, problem.datasets, strict=True))
    if values < 2.0 * len(problem.columns) or not any(o.any() for o in out):
        return whole, ()
    held = tuple(d.take(o & d.usable & ~typo) for d, o, typo in zip(
        problem.datasets, out, single_gross_rows(whole), strict=True))
    return of_rows(whole, [~o for o in out], options.fit), held
