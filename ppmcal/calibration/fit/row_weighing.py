"""Each row counts by how likely it belongs, and the fit is made again until weights stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit.fit_result import (
    OUTLIER,
    Fit,
    FitOptions,
    prediction_covariance,
    values_taken,
)
from ppmcal.calibration.fit.fit_rows import fit_rows
from ppmcal.calibration.fit.linearisation import prior_weights
from ppmcal.calibration.fit.outliers import Distances, distances, unchecked
from ppmcal.calibration.fit.problem import State
from ppmcal.calibration.fit.unsolved_rows import NO_POSE
from ppmcal.inference.priors import NO_WEIGHT
from ppmcal.linalg import Array, Bools, finite_rows

BETWEEN_ROUNDS = 5
"""Iterations of the fit after each round, which starts next to its minimum."""
ROUNDS = 30
WHOLE, SETTLED = 0.05, 1e-5
"""Rows weigh alike where their weights would move no estimate by so many of its standard
deviations; and weights stay that would move none by so many any more."""


def weighed(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array],
            options: FitOptions) -> Fit:
    """Return the fit with each row by its weight, those left out that hardly have any.

    ``suspects`` (N,) by data set are out already and are judged with the others; ``poses``: where
    to look for theirs.
    """
    first, rows = fit, [k | s for k, s in zip(fit.keep, suspects, strict=True)]
    if any(s.any() for s in suspects):
        fit = replace(fit, state=_found_again(fit, suspects, poses))
    # the next round judges by a new fit anyway: one that wanders is not followed to its end
    short = replace(options, iterations=min(options.most, BETWEEN_ROUNDS))
    for _ in range(ROUNDS):
        found = distances(fit.problem, fit.state, prediction_covariance(fit), fit.keep)
        factor = found.factor(fit.keep)
        weights = found.weights(fit.keep, factor)
        keep = [r & finite_rows(pose) & (w >= float(NO_WEIGHT))
                for r, pose, w in zip(rows, fit.state.poses, weights, strict=True)]
        weights = [np.where(k, w, 1.0) for k, w in zip(keep, weights, strict=True)]
        now, ones = fit.problem.weights, [np.ones(k.size) for k in keep]
        whole = _moves(fit, found, factor, keep, weights, ones) < WHOLE
        weights = ones if whole else weights
        same = all(np.array_equal(a, b) for a, b in zip(keep, fit.keep, strict=True))
        if same and _moves(fit, found, factor, keep, weights, now) < SETTLED:
            break
        problem = fit.problem.weighted(weights)
        fit = fit_rows(problem, fit.state, keep, fit.reasons, fit.prior, short, fit.prior_scale)
    if not fit.converged and short.most < options.most:
        fit = fit_rows(fit.problem, fit.state, fit.keep, fit.reasons, fit.prior, options,
                       fit.prior_scale)
    # the steps of the search: those after it follow the weights
    return replace(_explained(fit, rows, found, factor), iterations=first.iterations,
                   summed=first.summed)


def _moves(fit: Fit, found: Distances, factor: float, keep: Sequence[Bools],
           weights: Sequence[Array], others: Sequence[Array]) -> float:
    """Return by how many standard deviations other weights may move estimates, at most or so."""
    lever = values_taken(fit) / max(sum(int(k.sum()) for k in keep), 1)
    return float(np.sqrt(lever)) / factor * sum(
        float(np.sum(np.abs(w - o)[k] * np.sqrt(d[k])))
        for w, o, d, k in zip(weights, others, found.square, keep, strict=True))


def _explained(fit: Fit, rows: Sequence[Bools], found: Distances, factor: float) -> Fit:
    """Return the fit with the reasons for which some of the rows (N,) are left out."""
    reasons: list[dict[int, str]] = []
    times: list[dict[int, float]] = []
    for own, away, some, keep, pose in zip(fit.reasons, found.over_noise(factor), rows, fit.keep,
                                           fit.state.poses, strict=True):
        gone = np.flatnonzero(some & ~keep).tolist()
        solved = finite_rows(pose)
        times.append({n: float(away[n]) for n in gone})
        kept = {n: why for n, why in own.items() if not keep[n]}
        reasons.append({**kept, **{n: f"{OUTLIER}: {away[n]:.1f} times the noise" if solved[n]
                                   else NO_POSE for n in gone}})
    return replace(fit, noise_factor=factor, reasons=tuple(reasons), times=tuple(times))


def weighed_by_files(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array],
                     options: FitOptions) -> Fit:
    """Return the fit with each row by its weight; see :func:`weighed`.

    Of several files one may be off as a whole (calipers of a part that shrank) and pull at the
    others' rows. A row that agrees with its own file, in a fit of that alone in which an error
    would show, is not the one that is wrong: it stays.
    """
    found = weighed(fit, suspects, poses, options)
    if len(fit.problem.datasets) < 2 or not any(o.any() for o in found.outliers):
        return found
    pardoned = [_agreeing(found, i, poses[i], options) if o.any() else o
                for i, o in enumerate(found.outliers)]
    if not any(p.any() for p in pardoned):
        return found
    keep = [k | p for k, p in zip(found.keep, pardoned, strict=True)]
    reasons = [{n: why for n, why in each.items() if not p[n]}
               for each, p in zip(found.reasons, pardoned, strict=True)]
    back = fit_rows(found.problem, _found_again(found, pardoned, poses), keep, reasons, found.prior,
                    options, found.prior_scale)
    return replace(back, noise_factor=found.noise_factor, times=found.times)


def _agreeing(found: Fit, index: int, poses: Array, options: FitOptions) -> Bools:
    """Return which rows (N,) that were left out of a data set agree with a fit of it alone.

    The other rows of the file predict them, at the noise that those show: fitted with the others, a
    wrong value would spread over them and pass for their noise. Rows that agree then predict too.
    """
    out = found.outliers[index]
    data = found.problem.datasets[index]
    if data.frame.same_as is not None or found.problem.earlier is not None:
        return np.zeros_like(out)
    alone = replace(found.problem, pivots=None, given=found.problem.environments[index:index + 1],
                    datasets=(replace(data, homing="shared" if data.homing == "shared" or not index
                                      else "alone"),))
    pose = np.where(out[:, None], poses, found.state.poses[index])
    state = alone.solve(State(found.state.g, (found.state.registrations[index],), (pose,)))
    solved = finite_rows(state.poses[0])
    keep = found.keep[index] & solved
    prior = prior_weights(alone, options.method)
    for _ in range(int((keep | out).sum())):
        own = fit_rows(alone, state, [keep], [{}], prior, options)
        own = replace(own, state=_found_again(own, [out & ~keep], state.poses))
        covariance = prediction_covariance(own)
        away = distances(alone, own.state, covariance, [keep])
        belongs = away.weights([keep], away.factor([keep]))[0] >= float(NO_WEIGHT)
        more = out & ~keep & finite_rows(own.state.poses[0]) & belongs
        if not more.any():
            break
        keep, state = keep | more, own.state
    hidden = [row for _, rows in unchecked(own, covariance) for row in rows]
    return np.asarray(out & keep & ~np.isin(data.rows, hidden))


def _found_again(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array]) -> State:
    """Return the fit's state with the poses of the suspects, where they have one."""
    there = replace(fit.state, poses=tuple(np.where(s[:, None], p, np.nan) for s, p in
                                           zip(suspects, poses, strict=True)))
    found = fit.problem.solve(there).poses
    return replace(fit.state, poses=tuple(np.where(s[:, None], new, old) for s, new, old in
                                          zip(suspects, found, fit.state.poses, strict=True)))
