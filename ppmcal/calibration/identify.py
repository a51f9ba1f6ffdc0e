"""The identification loop: whitened Gauss-Newton with the tolerances as prior.

Minimised is  sum |W (measured - predicted)|^2 + sum ((g - g0)/tau)^2  over the free
parameters and every open frame and target. Each iteration reduces all rows to one
triangle R by accumulated QR; everything else happens on that small matrix. Rows that do
not belong are down-weighted on the way and, at the end, left out and reported.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import OUTLIER, Fit, FitOptions, prediction_covariance
from ppmcal.calibration.gauss_newton import Minimum, least_squares
from ppmcal.calibration.gross_rows import gross_errors
from ppmcal.calibration.least_squares import (
    QRFactor,
    column_scale,
    parameter_scale,
    prior_weights,
    qr_factor,
)
from ppmcal.calibration.normal_equations import normal_sums
from ppmcal.calibration.observation import coordinates, shown
from ppmcal.calibration.outliers import REJECT, distances, huber_weights, unchecked, worst
from ppmcal.calibration.problem import Problem, State
from ppmcal.calibration.regularization import damped, gcv_scale
from ppmcal.calibration.unsolved_rows import NO_POSE, with_unsolved
from ppmcal.errors import BadInput, NoResult
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.wording.progress import stage

MANY_ROWS, FEW_ROWS = 8000, 3000
"""Beyond so many rows a fit to so few of them comes first."""
log = logging.getLogger(__package__)
STIFFEST = 1e3
"""While approaching, the prior is no weaker than the best known direction over this."""
STAGE, STAGE_ITERATIONS = 30.0, 4
"""Each stage of the approach weakens the prior by this much, in so many iterations."""


def identify(problem: Problem, options: FitOptions | None = None, start: State | None = None,
             near: bool = False, at_minimum: bool = False) -> Fit:
    """Fit the free parameters and open frames to the data.

    Args:
        problem: machine, data and free parameters.
        options: method and its settings.
        start: where to start, default the machine's present values.
        near: whether the start is near the minimum already.
        at_minimum: whether it is the minimum of many of the same rows.

    Raises:
        BadInput: too few rows. NoResult: no pose could be solved, or the damped scheme of
        [PPM] did not converge.
    """
    options = options or FitOptions()
    prior = prior_weights(problem, options.method)
    state = start or problem.start()
    keep, reasons = _usable(problem, state)
    _enough(problem, keep)
    suspects = [np.zeros_like(k) for k in keep]
    if options.robust and options.method != "damped":
        with stage("looking for gross errors"):
            suspects = gross_errors(problem, state, keep)
        log.info("%d of %d rows set aside as gross errors before the fit",
                 sum(int(s.sum()) for s in suspects), sum(int(k.sum()) for k in keep))
        keep = [k & ~s for k, s in zip(keep, suspects, strict=True)]
    unused = state.poses
    state = _only(state, keep)
    if options.method == "damped":
        state = start_off_zero(problem, state, keep)
        return damped(problem, state, keep, reasons, options)
    many = sum(int(k.sum()) for k in keep) > MANY_ROWS
    if many and not at_minimum:
        thinned, few = _thinned(problem, state, keep)
        log.info("more than %d rows: the minimum is sought with %d of them first", MANY_ROWS,
                 sum(len(d) for d in thinned.datasets))
        with stage("fitting some of the rows"):
            first = identify(thinned, options, few)
        state = problem.solve(State(first.state.g, first.state.registrations, state.poses))
        keep, later = _usable(problem, state)
        keep = [k & ~s for k, s in zip(keep, suspects, strict=True)]
        reasons = [{**new, **old} for new, old in zip(later, reasons, strict=True)]
    elif not many:
        with stage("coming near"):
            state = _near(problem, state, keep, prior, options, near)
    with stage("fitting all rows"):
        fit = _fit(problem, state, keep, reasons, prior, options)
    if options.robust:
        with stage("judging each row"):
            fit = _left_out_by_files(fit, suspects, unused, options)
        log.info("%d rows left out as gross errors, the noise of the others %.3g times the stated "
                 "one", sum(int(o.sum()) for o in fit.outliers), fit.noise_factor)
    if options.method == "gcv":
        # gross errors would pass for a machine that is farther off than it is
        fit = _cross_validated(fit, options)
        if options.robust:
            fit = _without_outliers(fit, fit.outliers, fit.state.poses, options)
    return with_unsolved(fit, lambda at, rows, why: _fit(
        problem, at.state, rows, why, at.prior, options, at.prior_scale))


def _only(state: State, keep: Sequence[Bools]) -> State:
    """Return the state without poses of the rows that are not in use, which cost time."""
    if all(k.all() for k in keep):
        return state
    return replace(state, poses=tuple(np.where(k[:, None], p, np.nan) for p, k in
                                      zip(state.poses, keep, strict=True)))


def _thinned(problem: Problem, state: State, keep: Sequence[Bools]) -> tuple[Problem, State]:
    """Return the problem with some :data:`FEW_ROWS` of its rows, evenly spread, and its state.

    Finding the minimum takes many passes and few rows; only the last passes need them all.
    """
    share = FEW_ROWS / sum(int(k.sum()) for k in keep)
    rows = []
    for k in keep:
        usable = np.flatnonzero(k)
        count = min(usable.size, max(100, round(share * usable.size)))
        rows.append(usable[np.linspace(0, usable.size - 1, count).astype(int)]
                    if usable.size else usable)
    datasets = tuple(d.take(r) for d, r in zip(problem.datasets, rows, strict=True))
    about = tuple(o.about for o in problem.opens)
    poses = tuple(p[r] for p, r in zip(state.poses, rows, strict=True))
    return replace(problem, datasets=datasets, pivots=about), replace(state, poses=poses)


def _near(problem: Problem, state: State, keep: Sequence[Bools], prior: Array, options: FitOptions,
          near: bool) -> State:
    """Return a state near the minimum, outliers weighted down."""
    if not near:
        state = start_off_zero(problem, state, keep)
    if not options.robust:
        return state if near else _approach(problem, state, keep, prior, None)

    log.info("far rows are weighted down (Huber) on the way to the minimum")

    def weigh(at: State) -> Sequence[Array]:
        return huber_weights(problem, at, keep)

    if not near:
        state = _approach(problem, state, keep, prior, weigh)
    return least_squares(problem, state, keep, prior, options.most, weigh).state


def _approach(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
              weigh: Callable[[State], Sequence[Array]] | None) -> State:
    """Come near the minimum with a prior that is too strong at first, then less and less.

    Exact data make the valley in which frame and geometry trade places so narrow and curved
    that straight steps leave it. With the prior never weaker than a thousandth of what the
    data know best, the valley is wide, and each stage starts next to its minimum.
    """
    scale = column_scale(problem)
    seen = normal_sums(problem, state, keep).matrix * (scale[:, None] * scale)
    known_best = float(np.sqrt(linalg.largest_singular(seen)))
    weakest = float((prior[prior > 0.0] * column_scale(problem)[prior > 0.0]).min(initial=np.inf))
    excess = known_best / (STIFFEST * weakest)
    while excess > 1.0:
        state = least_squares(problem, state, keep, prior * excess, STAGE_ITERATIONS, weigh,
                              rough=True).state
        excess /= STAGE
    return state


def _fit(problem: Problem, state: State, keep: Sequence[Bools], reasons: Sequence[dict[int, str]],
         prior: Array, options: FitOptions, scale: float = 1.0) -> Fit:
    found = least_squares(problem, state, keep, prior, options.most, None)
    reduced = found.reduced or qr_factor(problem, found.state, keep)
    _remark(problem, found, reduced, keep)
    return Fit(problem, found.state, reduced, prior, column_scale(problem), tuple(keep),
               found.iterations, found.converged, prior_scale=scale, reasons=tuple(reasons),
               summed=found.summed)


def _remark(problem: Problem, found: Minimum, reduced: QRFactor, keep: Sequence[Bools]) -> None:
    """Log how a fit went."""
    if log.isEnabledFor(logging.INFO):
        used = reduced.triangle * column_scale(problem)
        condition = float(linalg.condition(used)) if used.size else 1.0
        log.info("%d columns to %d rows: %s after %d iterations, %d of them from normal equations, "
                 "the others by QR; chi-squared %.6g, condition of the data alone %.2g",
                 len(problem.columns), sum(int(k.sum()) for k in keep),
                 "converged" if found.converged else "not converged", found.iterations,
                 found.summed, reduced.square, condition)


def _usable(problem: Problem, state: State) -> tuple[list[Bools], list[dict[int, str]]]:
    """Return which rows can be used, and why the others cannot."""
    keep, reasons = [], []
    motion = problem.mechanism.motion
    for data, pose in zip(problem.datasets, state.poses, strict=True):
        joints = finite_rows(data.q)
        solved = finite_rows(pose)
        parts = list(coordinates(data, motion))
        measured = shown(data)[:, parts]
        seen = np.isfinite(measured).any(axis=1)
        own: dict[int, str] = {n: r for n, r in enumerate(data.unusable or ()) if r}
        keep.append(solved & seen)
        keep[-1][list(own)] = False
        for rows, reason in ((~joints, "joint values missing"),
                             (joints & ~solved, NO_POSE),
                             (solved & ~seen, "nothing measured")):
            own.update({int(n): reason for n in np.flatnonzero(rows) if int(n) not in own})
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
    squares = np.diagonal(normal_sums(problem, state, keep).matrix)[:scale.size]
    norms = np.sqrt(squares) * scale
    return np.asarray(norms < 1e-9 * max(float(norms.max(initial=0.0)), 1e-300), dtype=bool)


def _without_outliers(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array],
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
    for _ in range(total):
        found = distances(fit.problem, fit.state, prediction_covariance(fit), keep)
        factor = found.factor(keep)
        bad = worst(found, keep, factor)
        if not bad or len(dropped) >= total // 3:
            break
        for i, n, _ in bad[:max(1, total // 50)]:
            keep[i][n] = False
            dropped.add((i, n))
        fit = _fit(fit.problem, fit.state, keep, reasons, fit.prior, options,
                   fit.prior_scale)
    if any(s.any() for s in suspects):
        fit = replace(fit, state=_found_again(fit, suspects, poses))
    return _readmit(fit, keep, reasons, dropped, factor, options)


def _left_out_by_files(fit: Fit, suspects: Sequence[Bools], poses: Sequence[Array],
                       options: FitOptions) -> Fit:
    """Leave out rows that do not belong; see :func:`_without_outliers`.

    Of several files one may be off as a whole (calipers of a part that shrank) and pull at the
    others' rows. A row that agrees with its own file, in a fit of that alone in which an error
    would show, is not the one that is wrong: it stays.
    """
    found = _without_outliers(fit, suspects, poses, options)
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
    back = _fit(found.problem, state, keep, reasons, found.prior, options,
                found.prior_scale)
    return replace(back, noise_factor=found.noise_factor, times=tuple(times))


def _agreeing(found: Fit, index: int, poses: Array, options: FitOptions) -> Bools:
    """Return which rows (N,) that were left out of a data set agree with a fit of it alone."""
    out = found.outliers[index]
    data = found.problem.datasets[index]
    if data.frame.same_as is not None or found.problem.earlier is not None:
        return np.zeros_like(out)
    alone = replace(found.problem, pivots=None, given=found.problem.environments[index:index + 1],
                    datasets=(replace(data, homing="shared" if data.homing == "shared" or not index
                                      else "alone"),))
    pose = np.where(out[:, None], poses, found.state.poses[index])
    state = alone.solve(State(found.state.g, (found.state.registrations[index],), (pose,)))
    keep = [(found.keep[index] | out) & finite_rows(state.poses[0])]
    own = _fit(alone, state, keep, [{}], prior_weights(alone, options.method), options)
    own = _without_outliers(own, [np.zeros_like(out)], state.poses, options)
    hidden = [row for _, rows in unchecked(own, prediction_covariance(own)) for row in rows]
    return np.asarray(out & own.keep[0] & ~np.isin(data.rows, hidden))


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
        p = found.p_values(factor)
        solved = [finite_rows(pose) for pose in fit.state.poses]
        back = [(i, n) for i, n in sorted(dropped) if solved[i][n] and p[i][n] * total >= REJECT]
        for i, n in back:
            keep[i][n] = True
        for i, n in sorted(dropped - set(back)):
            away = np.sqrt(found.square[i][n] / max(found.size[i][n], 1.0)) / factor
            times[i][n] = float(away)
            reasons[i][n] = (f"{OUTLIER}: {away:.1f} times the noise" if solved[i][n]
                             else NO_POSE)
        if back:
            fit = _fit(fit.problem, fit.state, keep, reasons, fit.prior, options,
                       fit.prior_scale)
    return replace(fit, noise_factor=factor, reasons=tuple(reasons), times=tuple(times))


def _cross_validated(fit: Fit, options: FitOptions) -> Fit:
    """Refit with the prior scale that generalised cross-validation chooses."""
    base = fit.prior
    scale = 1.0
    for _ in range(5):
        new = gcv_scale(fit, base)
        done = abs(np.log(new / scale)) < 0.05
        scale = new
        fit = _fit(fit.problem, fit.state, fit.keep, fit.reasons, base / scale, options,
                   scale)
        if done:
            break
    return fit
