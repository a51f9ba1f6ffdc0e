"""The identification loop: whitened Gauss-Newton with the tolerances as prior.

Minimises  sum |W (measured - predicted)|^2 + sum ((g - g0)/tau)^2  over the free
parameters and every open frame and target. Each iteration reduces all rows to one
triangle R by accumulated QR; everything else happens on that small matrix. Each row is
weighted by its probability of belonging; outliers are left out and reported.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import Fit, FitOptions, like_noise
from ppmcal.calibration.fit.gauss_newton import cost, least_squares, prior_square
from ppmcal.calibration.fit.linearisation import column_scale, parameter_scale, prior_weights
from ppmcal.calibration.fit.normal_equations import normal_sums
from ppmcal.calibration.fit.observation import coordinates, shown
from ppmcal.calibration.fit.other_assemblies import other_starts
from ppmcal.calibration.fit.outliers import gross_errors
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.calibration.fit.regularization import damped, gcv_scale
from ppmcal.calibration.fit.row_distances import beyond_weight, distances, huber_weights
from ppmcal.calibration.fit.row_weighing import fit_rows, weighed
from ppmcal.calibration.fit.unsolved_rows import NO_POSE, with_unsolved
from ppmcal.errors import BadInput, NoResult
from ppmcal.inference.row_weights import improbability
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.registration import Registration
from ppmcal.wording.progress import stage

MANY_ROWS, FEW_ROWS = 8000, 3000
"""With more rows than the first, a fit to a subsample of the second size comes first."""
log = logging.getLogger(__package__)
STIFFEST = 1e3
"""During the approach the prior is never weaker than the best-known direction over this."""
STAGE, STAGE_ITERATIONS = 30.0, 4
"""Factor by which each stage of the approach weakens the prior, and iterations per stage."""


def identify(problem: Problem, options: FitOptions | None = None, start: State | None = None,
             near: bool = False, at_minimum: bool = False) -> Fit:
    """Fit the free parameters and open frames to the data.

    Without a given start, if the fit does not converge or has no free geometry, another start of
    the frames is tried and the better fit returned; for joint values alone that do not fit, other
    assemblies of the limbs are tried.

    Args:
        problem: machine, data and free parameters.
        options: method and its settings.
        start: where to start  [default: the machine's present values].
        near: whether the start is already near the minimum.
        at_minimum: whether it is the minimum for many of the same rows.

    Raises:
        BadInput: too few rows. NoResult: no pose could be solved, or the damped scheme of
        [PPM] did not converge.
    """
    options = options or FitOptions()
    if start is not None or options.method == "damped":
        return _fitted(problem, options, start or problem.start(), near, at_minimum)
    state = problem.start()
    fit = _fitted(problem, options, state, near, at_minimum)
    blind = problem.free and all(d.kind.blind for d in problem.datasets)
    if blind and not like_noise(fit.information):
        fit = _elsewhere(fit, state, options)
    if problem.free and fit.converged:
        return fit
    registrations = _stepwise(problem, state, options.robust)
    if registrations is None:
        return fit
    state = problem.solve(replace(state, registrations=registrations))
    other = _fitted(problem, options, state, near, at_minimum)
    return min((fit, other), key=lambda f: loss(f, options.robust))


def _elsewhere(fit: Fit, state: State, options: FitOptions) -> Fit:
    """Return the better of a fit of joint values alone and one started from another assembly.

    While the geometry is off, limbs may close best on either side of the true platform pose. The
    other fit is compared with the poses that its machine reaches from home.
    """
    problem, prior = fit.problem, prior_weights(fit.problem, options.method)
    few, start, keep = _few_rows(problem, state)
    tried: list[tuple[float, int, State]] = []
    for other in other_starts(few, start):
        rows = _usable(few, other)[0]
        near = least_squares(few, other, rows, prior, STAGE_ITERATIONS, None, rough=True).state
        tried.append((cost(few, near, rows, prior, None), len(tried), near))
    if not tried or min(tried)[0] > cost(few, start, keep, prior, None):
        return fit      # worse than the start before any fit
    g = _fitted(few, options, min(tried)[2], False, False).state.g
    home = Model(problem.mechanism, g)
    poses = tuple(problem.reached(i, home) for i in range(len(problem.datasets)))
    again = _fitted(problem, options, State(g, state.registrations, poses), False, False)
    return min((fit, again), key=lambda f: loss(f, options.robust))


def _stepwise(problem: Problem, state: State, robust: bool) -> tuple[Registration, ...] | None:
    """Return another start for frames and targets, found by opening one thing after another."""
    return opened_in_turn(*_few_rows(problem, state), robust)


def _few_rows(problem: Problem, state: State) -> tuple[Problem, State, list[Bools]]:
    """Return the problem and its state, thinned if there are many rows, and the usable rows."""
    keep = _usable(problem, state)[0]
    if not _many(keep):
        return problem, state, keep
    problem, state = _thinned(problem, state, keep)
    return problem, state, _usable(problem, state)[0]


def _many(keep: Sequence[Bools]) -> bool:
    """Return whether there are so many rows that a subsample is fitted first."""
    return sum(int(k.sum()) for k in keep) > MANY_ROWS


def _fitted(problem: Problem, options: FitOptions, state: State, near: bool, at_minimum: bool
            ) -> Fit:
    """Fit from one start; arguments and errors as :func:`identify`."""
    prior = prior_weights(problem, options.method)
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
    many = _many(keep)
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
    if options.robust:
        # a third of the rows being wrong would pull a plain fit to themselves and then look right
        aside = beyond_weight(distances(problem, state), keep)
        suspects = [s | a for s, a in zip(suspects, aside, strict=True)]
        keep = [k & ~a for k, a in zip(keep, aside, strict=True)]
    with stage("fitting all rows"):
        fit = fit_rows(problem, state, keep, reasons, prior, options)
    if options.robust:
        with stage("judging each row"):
            fit = weighed(fit, suspects, unused, options)
        log.info("%d rows left out as gross errors, the noise of the others %.3g times the stated "
                 "one", sum(int(o.sum()) for o in fit.outliers),
                 fit.noise_factor.max(initial=1.0))
    if options.method == "gcv":
        # gross errors would make the machine look farther off than it is
        fit = _cross_validated(fit, options)
        if options.robust:
            fit = weighed(fit, fit.outliers, fit.state.poses, options)
    return with_unsolved(fit, lambda at, rows, why: fit_rows(
        at.problem, at.state, rows, why, at.prior, options, at.prior_scale))


def _only(state: State, keep: Sequence[Bools]) -> State:
    """Return the state without the poses of unused rows, which cost time."""
    if all(k.all() for k in keep):
        return state
    return replace(state, poses=tuple(np.where(k[:, None], p, np.nan) for p, k in
                                      zip(state.poses, keep, strict=True)))


def _thinned(problem: Problem, state: State, keep: Sequence[Bools]) -> tuple[Problem, State]:
    """Return the problem with about :data:`FEW_ROWS` of its rows, evenly spread, and its state.

    Finding the minimum takes many passes but few rows; only the last passes need all of them.
    """
    share = FEW_ROWS / sum(int(k.sum()) for k in keep)
    rows = []
    for k in keep:
        usable = np.flatnonzero(k)
        count = min(usable.size, max(100, round(share * usable.size)))
        rows.append(usable[np.linspace(0, usable.size - 1, count).astype(int)]
                    if usable.size else usable)
    datasets = tuple(d.take(r) for d, r in zip(problem.datasets, rows, strict=True))
    poses = tuple(p[r] for p, r in zip(state.poses, rows, strict=True))
    return problem.changed(datasets=datasets), replace(state, poses=poses)


def _near(problem: Problem, state: State, keep: Sequence[Bools], prior: Array, options: FitOptions,
          near: bool) -> State:
    """Return a state near the minimum, outliers weighted down."""
    if not near:
        state = start_off_zero(problem, state, keep)
    if not options.robust:
        return state if near else _approach(problem, state, keep, prior, None)

    log.info("far rows are weighted down on the way to the minimum")

    def weigh(at: State) -> Sequence[Array]:
        return huber_weights(problem, at, keep)

    if not near:
        state = _approach(problem, state, keep, prior, weigh)
    return least_squares(problem, state, keep, prior, options.most, weigh).state


def _approach(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
              weigh: Callable[[State], Sequence[Array]] | None) -> State:
    """Approach the minimum with a prior that is too strong at first and is then weakened.

    With exact data, the valley in which frame and geometry trade off is so narrow and curved
    that straight steps leave it. While the prior is never weaker than a thousandth of the
    best-known direction, the valley is wide and each stage starts close to its minimum.
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


def _usable(problem: Problem, state: State) -> tuple[list[Bools], list[dict[int, str]]]:
    """Return which rows can be used, and why the others cannot."""
    keep, reasons = [], []
    motion = problem.mechanism.motion
    for data, pose in zip(problem.datasets, state.poses, strict=True):
        joints = finite_rows(data.q)
        solved = finite_rows(pose)
        parts = list(coordinates(data, motion))
        measured = shown(data)[:, parts]
        seen = np.isfinite(measured).any(axis=1) | data.kind.blind
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
        surplus, free = problem.mechanism.surplus, len(problem.free)
        alone = surplus and all(d.kind.blind for d in problem.datasets)
        few = (f": {rows * surplus} numbers of joint values alone for {free} "
               "parameters") * bool(alone)
        more = f", at least {max(3, -(-free // surplus)) - rows} more" if alone else ""
        raise BadInput(f"{rows} usable row{'s' if rows > 1 else ''} cannot calibrate a machine"
                       f"{few}", where, f"Measure more poses{more}, some dozens if possible.")


def start_off_zero(problem: Problem, state: State, keep: Sequence[Bools]) -> State:
    """Move parameters off a nominal at which they have no first-order effect.

    A lateral offset that enters as u^2 + lateral^2 has zero slope at 0: Gauss-Newton would
    stay there. Such parameters start half a tolerance away; parameters without effect
    there too (a passive angle) stay at their nominal.
    """
    scale = parameter_scale(problem)
    flat = _flat_columns(problem, state, keep, scale)
    if not flat.any():
        return state
    step = np.zeros(len(problem.columns))
    step[:scale.size] = np.where(flat, 0.5 * scale, 0.0)
    aside = problem.moved(state, step)
    # move a parameter only if its slope half a tolerance away is noticeable
    still = _flat_columns(problem, aside, keep, scale)
    step[:scale.size] = np.where(flat & ~still, 0.5 * scale, 0.0)
    return problem.moved(state, step)


def _flat_columns(problem: Problem, state: State, keep: Sequence[Bools], scale: Array) -> Bools:
    squares = np.diagonal(normal_sums(problem, state, keep).matrix)[:scale.size]
    norms = np.sqrt(squares) * scale
    return np.asarray(norms < 1e-9 * max(float(norms.max(initial=0.0)), 1e-300), dtype=bool)


def _cross_validated(fit: Fit, options: FitOptions) -> Fit:
    """Refit with the prior scale chosen by generalised cross-validation."""
    base, scale = fit.prior, 1.0
    for _ in range(5):
        new = gcv_scale(fit, base)
        done = abs(np.log(new / scale)) < 0.05
        scale = new
        fit = fit_rows(fit.problem, fit.state, fit.keep, fit.reasons,
                       prior_weights(fit.problem, options.method, scale), options, scale)
        if done:
            break
    return fit


# --- a second start of frames and targets: one thing opened after another -------------------------
#
# Where a platform hardly turns, or its nominal geometry is far off, frame and target are confounded
# and their closed-form solution may be far off. A fit with the target kept where the file says is
# then nearer; opening one thing at a time from there never fits worse.

STEPWISE = ("target_rotation", "target")
"""Closed at first, then opened from the last to the first."""
ITERATIONS = 15


def opened_in_turn(problem: Problem, state: State, keep: Sequence[Bools], robust: bool
                   ) -> tuple[Registration, ...] | None:
    """Return the registrations found by fitting with one thing open after another.

    The geometry stays as it is. None where frames or targets have nothing else open.

    Args:
        problem: machine and data.
        state: with the poses at the machine's values.
        keep: rows to use (N,), by data set.
        robust: give far rows less weight.
    """
    found: State | None = None
    for narrow in _narrower(replace(problem, free=(), earlier=None)):
        if found is None:
            found = replace(narrow.start(), poses=state.poses)

        def weigh(at: State, narrow: Problem = narrow) -> Sequence[Array]:
            return huber_weights(narrow, at, keep)

        found = least_squares(narrow, found, keep, prior_weights(narrow, "prior"), ITERATIONS,
                              weigh if robust else None, rough=True).state
    return None if found is None else found.registrations


def _narrower(problem: Problem) -> Iterator[Problem]:
    """Yield a problem with less open, then with more, then as it is; nothing if none is."""
    words = [w for w in STEPWISE if any(_closed(d, [w]) is not d for d in problem.datasets)]
    for count in range(len(words), -1, -1) if words else ():
        yield problem.changed(datasets=tuple(_closed(d, words[:count]) for d in problem.datasets))


def _closed(data: Dataset, words: Sequence[str]) -> Dataset:
    """Return a data set with parts of its registration fixed at the file's; itself if none is."""
    if not data.frame.fitted:
        return data
    own = {w: replace(getattr(data, w), fitted=False) for w in words if getattr(data, w).fitted}
    return replace(data, **own) if own else data


def loss(fit: Fit, robust: bool) -> tuple[int, float]:
    """Return the loss of a fit: number of rows without pose, then chi-squared of data and prior.

    With ``robust``, rows that are far off count as rows that may not belong.
    """
    total, lost = prior_square(fit.problem, fit.state, fit.prior), 0
    found = distances(fit.problem, fit.state)
    for square, size, pose in zip(found.square, found.size, fit.state.poses,
                                  strict=True):
        there = np.isfinite(square) & (size > 0) & finite_rows(pose)
        lost += int((~there).sum())
        own = square[there]
        total += float(np.sum(improbability(own, size[there]) if robust else own))
    return lost, total
