"""Rows that do not belong are left out, worst first, with the fit made again after each round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit.fit_result import OUTLIER, Fit, FitOptions, prediction_covariance
from ppmcal.calibration.fit.fit_rows import fit_rows
from ppmcal.calibration.fit.linearisation import prior_weights
from ppmcal.calibration.fit.outliers import REJECT, distances, unchecked, worst
from ppmcal.calibration.fit.problem import State
from ppmcal.calibration.fit.unsolved_rows import NO_POSE
from ppmcal.linalg import Array, Bools, finite_rows

BETWEEN_ROUNDS = 5
"""Iterations of the fit after each round, which starts next to its minimum."""


def without_outliers(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array],
                     options: FitOptions) -> Fit:
    """Leave out rows that do not belong, worst first, refitting after each round.

    ``suspects`` (N,) by data set are out already and are judged with the others at the end;
    ``poses``: where to look for theirs.
    """
    keep = [k.copy() for k in fit.keep]
    reasons = [dict(r) for r in fit.reasons]
    dropped = {(i, int(n)) for i, s in enumerate(suspects) for n in np.flatnonzero(s)}
    total = sum(int(k.sum()) for k in keep) + len(dropped)
    factor = 1.0
    # the next round judges by a new fit anyway: one that wanders is not followed to its end
    short = replace(options, iterations=min(options.most, BETWEEN_ROUNDS))
    for _ in range(total):
        found = distances(fit.problem, fit.state, prediction_covariance(fit), keep)
        factor = found.factor(keep)
        bad = worst(found, keep, factor)
        if not bad or len(dropped) >= total // 3:
            break
        # the worst half of many: a round is a fit, and who does belong is taken back at the end
        for i, n, _ in bad[:max(1, total // 50, len(bad) // 2)]:
            keep[i][n] = False
            dropped.add((i, n))
        fit = fit_rows(fit.problem, fit.state, keep, reasons, fit.prior, short, fit.prior_scale)
    if not fit.converged and short.most < options.most:
        fit = fit_rows(fit.problem, fit.state, keep, reasons, fit.prior, options, fit.prior_scale)
    if any(s.any() for s in suspects):
        fit = replace(fit, state=_found_again(fit, suspects, poses))
    return _readmit(fit, keep, reasons, dropped, factor, options)


def left_out_by_files(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array],
                      options: FitOptions) -> Fit:
    """Leave out rows that do not belong; see :func:`without_outliers`.

    Of several files one may be off as a whole (calipers of a part that shrank) and pull at the
    others' rows. A row that agrees with its own file, in a fit of that alone in which an error
    would show, is not the one that is wrong: it stays.
    """
    found = without_outliers(fit, suspects, poses, options)
    if len(fit.problem.datasets) < 2 or not any(o.any() for o in found.outliers):
        return found
    pardoned = [_agreeing(found, i, poses[i], options) if o.any() else o
                for i, o in enumerate(found.outliers)]
    if not any(p.any() for p in pardoned):
        return found
    keep = [k | p for k, p in zip(found.keep, pardoned, strict=True)]
    reasons = [{n: v for n, v in each.items() if not p[n]}
               for each, p in zip(found.reasons, pardoned, strict=True)]
    times = [{n: v for n, v in each.items() if not p[n]}
             for each, p in zip(found.times, pardoned, strict=True)]
    state = _found_again(found, pardoned, poses)
    back = fit_rows(found.problem, state, keep, reasons, found.prior, options,
                found.prior_scale)
    return replace(back, noise_factor=found.noise_factor, times=tuple(times))


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
    total = int((keep | out).sum())
    for _ in range(total):
        own = fit_rows(alone, state, [keep], [{}], prior, options)
        own = replace(own, state=_found_again(own, [out & ~keep], state.poses))
        covariance = prediction_covariance(own)
        away = distances(alone, own.state, covariance, [keep])
        agrees = away.p_values(away.factor([keep]))[0] * total >= REJECT
        more = out & ~keep & finite_rows(own.state.poses[0]) & agrees
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


def _readmit(fit: Fit, keep: list[Bools], reasons: list[dict[int, str]],
             dropped: set[tuple[int, int]], factor: float, options: FitOptions) -> Fit:
    """Take back rows that the final fit explains; write down why the others are out."""
    times: list[dict[int, float]] = [{} for _ in keep]
    if dropped:
        found = distances(fit.problem, fit.state, prediction_covariance(fit), keep)
        total = sum(int(k.sum()) for k in keep) + len(dropped)
        p, away = found.p_values(factor), found.over_noise(factor)
        solved = [finite_rows(pose) for pose in fit.state.poses]
        back = [(i, n) for i, n in sorted(dropped) if solved[i][n] and p[i][n] * total >= REJECT]
        for i, n in back:
            keep[i][n] = True
        for i, n in sorted(dropped - set(back)):
            times[i][n] = float(away[i][n])
            reasons[i][n] = (f"{OUTLIER}: {times[i][n]:.1f} times the noise" if solved[i][n]
                             else NO_POSE)
        if back:
            fit = fit_rows(fit.problem, fit.state, keep, reasons, fit.prior, options,
                       fit.prior_scale)
    return replace(fit, noise_factor=factor, reasons=tuple(reasons), times=tuple(times))
