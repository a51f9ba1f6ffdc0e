"""What is gone of the gap, on poses that no fit has seen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import chdtrc, chdtri

from ppmcal.calibration.fit import Fit, prediction_covariance
from ppmcal.calibration.problem import Problem
from ppmcal.calibration.response import Rows
from ppmcal.calibration.sessions import pose_labels
from ppmcal.calibration.validation import fresh_state
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Dataset

DRAWS = 2000
TOGETHER = 2**19
"""So many poses are drawn together."""
UNPREDICTED = 100.0
"""Variance of a prediction over that of the noise, beyond which it is none."""
REJECT = 0.05


@dataclass(frozen=True)
class Gap:
    """Held-out errors in units of the noise.

    Attributes:
        noise: of the measurements, over the stated one.
        before, after: rms over the noise without and with the effects.
        closed: 1 - excess(after)/excess(before), None where nothing exceeded it before.
        interval: 95 % of ``closed``, by bootstrap over poses; None as ``closed``.
        confirmed: whether the improvement's interval excludes zero.
        worse: whether the errors have grown, as surely, or by more than the noise.
        poses: how many were held out.
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
    """Per row: squared white error, variance from the parameters, values, pose label."""

    square: Array
    variance: Array
    count: Array
    group: Ints

    @classmethod
    def joined(cls, parts: Sequence[HeldOutErrors]) -> HeldOutErrors:
        """Return the errors of several sets of rows as one."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


def _errors(fit: Fit, held: Sequence[Dataset]) -> HeldOutErrors:
    about = tuple(o.about for o in fit.problem.opens)
    problem = replace(fit.problem, datasets=tuple(held), pivots=about)
    state = fresh_state(problem, fit.state)
    return errors_of(problem, ((r, r.residual) for r in problem.rows(state)),
                     prediction_covariance(fit))


def errors_of(problem: Problem, predicted: Iterable[tuple[Rows, Array]], covariance: Array
              ) -> HeldOutErrors:
    """Return the errors of rows that were predicted.

    Args:
        problem: of which they are rows.
        predicted: chunks of rows with their white errors (n, m).
        covariance: of the columns, of the fit that predicts them (C, C).
    """
    parts: list[list[Array]] = [[], [], [], []]
    poses = pose_labels(problem.datasets)
    for rows, error in predicted:
        parts[0].append(np.sum(error**2, axis=1))
        parts[1].append(np.einsum("nmc,nmc->n", rows.jacobian @ covariance, rows.jacobian))
        parts[2].append(rows.observed.sum(axis=1).astype(float))
        parts[3].append(poses[rows.dataset][rows.index].astype(float))
    square, variance, count, label = (np.concatenate(p) if p else np.zeros(0) for p in parts)
    return HeldOutErrors(square, variance, count, label.astype(np.int64))


def measure_gap(before: Fit, after: Fit, held: Sequence[Dataset], noise: float, seed: int
                ) -> Gap | None:
    """Return the held-out gap, None if the held-out rows are not predictable.

    Args:
        before: the fit without the effects.
        after: the fit with them.
        held: rows that neither has seen.
        noise: over the stated one.
        seed: of the bootstrap.
    """
    old, new = _errors(before, held), _errors(after, held)
    if old.square.size != new.square.size or new.square.size == 0:
        return None
    return gap_of(old, new, noise, seed)


def gap_of(old: HeldOutErrors, new: HeldOutErrors, noise: float, seed: int) -> Gap:
    """Return the gap of the same rows predicted without and with the effects.

    Args:
        old: errors without the effects.
        new: errors with them.
        noise: over the stated one.
        seed: of the bootstrap.
    """
    count = np.maximum(new.count, 1.0)
    away = new.square / (noise**2 + new.variance / count)
    # a gross error is far from the others; where half of the rows are far, the model is wrong
    scale = max(1.0, float(np.median(away / chdtri(count, 0.5))))
    good = chdtrc(count, away / scale) * new.square.size >= REJECT
    # what neither fit can predict tells nothing of them
    good &= np.maximum(old.variance, new.variance) / count <= UNPREDICTED * noise**2
    if not good.any():
        good = np.ones_like(good)
    labels, group = np.unique(new.group[good], return_inverse=True)

    def per_pose(values: Array) -> Array:
        sums = np.bincount(group.reshape(-1), weights=values[good], minlength=labels.size)
        return np.asarray(sums, dtype=np.float64)

    table = np.stack([per_pose(v) for v in (old.square, new.square, old.variance, new.variance,
                                            new.count)])
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
