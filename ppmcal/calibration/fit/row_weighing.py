"""Fits given rows from near their minimum, repeated until the row weights settle.

Each row is weighted by its probability of belonging.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import (
    OUTLIER,
    Fit,
    FitOptions,
    prediction_covariance,
    values_taken,
)
from ppmcal.calibration.fit.gauss_newton import Minimum, least_squares
from ppmcal.calibration.fit.linearisation import SquareRootInformation, column_scale, qr_factor
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.calibration.fit.repeated_rows import RepeatedRows, by_repeats
from ppmcal.calibration.fit.row_distances import Distances, distances
from ppmcal.calibration.fit.unsolved_rows import NO_POSE
from ppmcal.inference.priors import NO_WEIGHT
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.notes import NOTE, Note

log = logging.getLogger(__package__)


def fit_rows(problem: Problem, state: State, keep: Sequence[Bools],
             reasons: Sequence[dict[int, str]], prior: Array, options: FitOptions,
             scale: float = 1.0) -> Fit:
    """Return the minimum of the rows in use.

    Args:
        problem: machine, data and free parameters.
        state: a start near the minimum.
        keep: which rows (N,) of each data set are in use.
        reasons: why the others are not, by row.
        prior: weights (C,) of the parameters, 1/SI.
        options: method and its settings.
        scale: factor on the tolerances in ``prior``.
    """
    found = least_squares(problem, state, keep, prior, options.most, None)
    information = found.information or qr_factor(problem, found.state, keep)
    _remark(problem, found, information, keep)
    return Fit(problem, found.state, information, prior, column_scale(problem), tuple(keep),
               found.iterations, found.converged, prior_scale=scale, reasons=tuple(reasons),
               summed=found.summed)


def _remark(problem: Problem, found: Minimum, information: SquareRootInformation,
            keep: Sequence[Bools]) -> None:
    """Log how a fit went."""
    if log.isEnabledFor(logging.INFO):
        used = information.root * column_scale(problem)
        condition = float(linalg.condition(used)) if used.size else 1.0
        log.info("%d columns to %d rows: %s after %d iterations, %d of them from normal equations, "
                 "the others by QR; chi-squared %.6g, condition of the data alone %.2g",
                 len(problem.columns), sum(int(k.sum()) for k in keep),
                 "converged" if found.converged else "not converged", found.iterations,
                 found.summed, information.square, condition)


BETWEEN_ROUNDS = 5
"""Iterations of the fit after each round, which starts close to its minimum."""
ROUNDS = 30
WHOLE, SETTLED = 0.05, 1e-5
"""Rows weigh the same if their weights move no estimate by this many of its standard deviations;
weights have settled if they would move none by this many any more."""

NOISE_OF = {False: "noise", True: "scatter of its repeats"}
"""Reference by which a left-out row is judged: False for all rows, True for its repeats."""


def weighed(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array],
            options: FitOptions) -> Fit:
    """Return the fit with weighted rows, without those that have hardly any weight.

    ``suspects`` (N,) by data set are out already and are judged with the others; ``poses``: from
    which to solve theirs.
    """
    first, rows = fit, [k | s for k, s in zip(fit.keep, suspects, strict=True)]
    if any(s.any() for s in suspects):
        fit = replace(fit, state=_found_again(fit, suspects, poses))
    # the next round judges by a new fit anyway: one that wanders need not be finished
    short = replace(options, iterations=min(options.most, BETWEEN_ROUNDS))
    for _ in range(ROUNDS):
        found = distances(fit.problem, fit.state, prediction_covariance(fit), fit.keep)
        factor = found.factor(fit.keep)
        again = by_repeats(fit, rows, factor)
        weights = [w * a.weight for w, a in
                   zip(found.weights(fit.keep, factor), again, strict=True)]
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
    # report the steps of the search; those after it only follow the weights
    return replace(_explained(fit, rows, found, factor, again), iterations=first.iterations,
                   summed=first.summed)


def _moves(fit: Fit, found: Distances, factor: Array, keep: Sequence[Bools],
           weights: Sequence[Array], others: Sequence[Array]) -> float:
    """Return by how many standard deviations other weights may move estimates: an upper bound."""
    lever = values_taken(fit) / max(sum(int(k.sum()) for k in keep), 1)
    return float(np.sqrt(lever)) * float(np.sum([
        np.sum(np.abs(w - o)[k] * np.sqrt(d[k])) / f
        for w, o, d, k, f in zip(weights, others, found.square, keep, factor, strict=True)]))


def _explained(fit: Fit, rows: Sequence[Bools], found: Distances, factor: Array,
               again: Sequence[RepeatedRows]) -> Fit:
    """Return the fit with the reasons why some of the rows (N,) are left out."""
    reasons, times = list[dict[int, str]](), list[dict[int, float]]()
    beside = list[dict[int, Ints]]()
    for own, away, weight, repeated, some, keep, pose in zip(
            fit.reasons, found.over_noise(factor), found.weights(fit.keep, factor), again, rows,
            fit.keep, fit.state.poses, strict=True):
        gone = np.flatnonzero(some & ~keep).tolist()
        solved = finite_rows(pose)
        # repeats show which joint it is, and by how much
        by_repeats = (repeated.weight < float(NO_WEIGHT)) | (repeated.weight < weight)
        far = np.where(by_repeats, repeated.times, away)
        times.append({n: float(far[n]) for n in gone})
        beside.append({n: np.flatnonzero(keep & (repeated.place == repeated.place[n]))
                       for n in gone if by_repeats[n] and solved[n]})
        kept = {n: why for n, why in own.items() if not keep[n]}
        reasons.append({**kept, **{
            n: Note(f"{OUTLIER}: {far[n]:.1f} times the {NOISE_OF[n in beside[-1]]}", NOTE,
                    OUTLIER) if solved[n] else NO_POSE for n in gone}})
    return replace(fit, noise_factor=factor, reasons=tuple(reasons), times=tuple(times),
                   repeated=tuple(beside), contradicting=tuple(
                       _contradicting(r, k) for r, k in zip(again, fit.keep, strict=True)))


def _contradicting(again: RepeatedRows, keep: Bools) -> tuple[Ints, ...]:
    """Return the rows ``keep`` (N,) that are unsure, place by place."""
    unsure = again.unsure & keep
    return tuple(np.flatnonzero(unsure & (again.place == place))
                 for place in np.unique(again.place[unsure]))


def _found_again(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array]) -> State:
    """Return the fit's state with the poses of the suspects where they have one."""
    there = replace(fit.state, poses=tuple(np.where(s[:, None], p, np.nan) for s, p in
                                           zip(suspects, poses, strict=True)))
    found = fit.problem.solve(there).poses
    return replace(fit.state, poses=tuple(np.where(s[:, None], new, old) for s, new, old in
                                          zip(suspects, found, fit.state.poses, strict=True)))
