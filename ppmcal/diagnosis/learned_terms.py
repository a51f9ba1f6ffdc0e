"""Terms learned from what named effects leave, kept only where held-out rows agree.

Learned on the training rows, judged on the poses that were held out and on stretches of time and
conditions left out in turn, then learned again from all rows. They claim no cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Fit, FitOptions, rows_with_outliers
from ppmcal.diagnosis.equation_forms import Equation
from ppmcal.diagnosis.equations import equations, sized_again
from ppmcal.diagnosis.held_out_blocks import BlockGap, compared_rows, schemes
from ppmcal.diagnosis.held_out_gap import Gap, HeldOutErrors, gap_of, measure_gap
from ppmcal.diagnosis.learning import Learned, Term, learn, relearned
from ppmcal.diagnosis.linear_system import INVISIBLE, MOST_ROWS, Whitening, build, range_basis
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.result import Found, LearnedTerms
from ppmcal.diagnosis.term_candidates import (
    TermCandidate,
    Visible,
    again,
    all_settings,
    candidates,
    slow_inputs,
)
from ppmcal.errors import PpmcalError
from ppmcal.linalg import Array, Bools, Ints, finite_rows, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.effects.learned import learned_kind
from ppmcal.model.mechanism import Mechanism, with_effect
from ppmcal.model.sessions import pose_labels

ROUNDS = 2
"""Rows that looked like outliers may be what the terms explain: learned again with them."""
SEEN = 1e-10
FOLDS = 5
AS_WELL = 0.05
"""An equation may leave so much more of what a learned term closes (of the squares)."""


def learned_beyond(found: Found, whole: Fit, held: Sequence[Dataset], named: bool, wanders: bool,
                   seed: int, options: FitOptions) -> LearnedTerms | None:
    """Return what is learned from what a search left; ``whole``: the fit of all rows so far."""
    return learned_terms(found.after if named else found.before, whole, held, found.last.noise,
                         found.noise, seed, options, wanders)


def with_learned(whole: Fit, terms: LearnedTerms | None, options: FitOptions) -> Fit:
    """Return a fit of all rows with what was learned, if anything was, in the machine."""
    if terms is None:
        return whole
    return with_mechanism(whole, with_terms(whole.problem.mechanism, terms.learned), options)


def learned_terms(base: Fit, whole: Fit, held: Sequence[Dataset], whitening: Whitening,
                  noise: float, seed: int, options: FitOptions, wandering: bool = False
                  ) -> LearnedTerms | None:
    """Return what is learned beyond a fit, None where held-out rows do not confirm it.

    Args:
        base: the fit of the training rows with the named effects.
        whole: the same of all rows.
        held: rows left out of the fits; what they confirm was chosen with them.
        whitening: of the residuals.
        noise: over the stated one.
        seed: of the bootstrap.
        options: of the fits.
        wandering: machine or instrument wander in time, so that nothing is learned from inputs
            that go with the clock.
    """
    if not held:
        return None
    everywhere = all_settings(whole)
    several = any(o.any() for o in base.outliers)
    # what looks like gross errors may be what is missing
    for outliers in (False, True) if several else (False,):
        seen = visible(base, _start(base, outliers), whitening)
        skipped = slow_inputs(seen) if wandering else ()
        found = learn(seen, candidates(seen, everywhere, skipped))
        while found is not None:
            kept = _judged(base, whole, found, held, outliers, whitening, noise, seed, options)
            if kept is not None:
                return kept
            # what comes first is surest
            found = relearned(seen, [found.terms[0].candidate]) if len(found.terms) > 1 else None
    return None


def _start(fit: Fit, outliers: bool) -> list[Bools]:
    """Return the rows that a fit uses, with those that it left out as outliers if wanted."""
    return rows_with_outliers(fit) if outliers else list(fit.keep)


def _judged(base: Fit, whole: Fit, found: Learned, held: Sequence[Dataset], outliers: bool,
            whitening: Whitening, noise: float, seed: int, options: FitOptions
            ) -> LearnedTerms | None:
    """Return the terms learned from all rows if those of the training rows predict the others."""
    chosen = [t.candidate for t in found.terms]
    try:
        trained, rows, fit = _fitted(base, _start(base, outliers), chosen, whitening, options)
        gap = measure_gap(base, fit, held, noise, seed)
        if gap is None or gap.worse or gap.after >= gap.before:
            return None
        learned, seen, final = _fitted(whole, _start(whole, outliers), chosen, whitening, options)
        judged = _JudgedRows(whole, final, seen, learned.terms)
    except PpmcalError:
        return None
    if not gap.confirmed:
        # of a quarter of the poses few may be where the term is large: all of them, in turn
        turns = _left_out(judged, _pose_folds(seen, seed), noise, seed)
        if turns is None or not turns.confirmed:
            return None
    blocks = tuple(_block_gaps(judged, noise, seed))
    if any(b.gap.worse for b in blocks):
        return None
    short = _as_well(base, fit, trained, rows, gap, held, seed, options)
    return LearnedTerms(learned, seen, whole, final, gap, blocks,
                        sized_again(seen, learned, short))


def _as_well(base: Fit, fit: Fit, learned: Learned, seen: Visible, gap: Gap,
             held: Sequence[Dataset], seed: int, options: FitOptions
             ) -> tuple[Equation | None, ...]:
    """Return the equations of the training rows that predict held-out poses as well as the terms.

    Each takes the place of its own term, the others staying as they are. ``fit``: with the terms;
    ``gap``: of it.
    """
    out: list[Equation | None] = []
    for i, found in enumerate(equations(seen, learned, seed)):
        after = None
        if found is not None:
            curves = (*learned.curves[:i], found, *learned.curves[i + 1:])
            machine = with_terms(base.problem.mechanism, replace(learned, curves=curves))
            try:
                other = with_mechanism(base, machine, options)
                after = measure_gap(fit, other, held, gap.noise, seed)
            except PpmcalError:
                after = None
        good = after is not None and not after.worse and (
            after.after**2 - after.before**2 <= AS_WELL * max(gap.before**2 - gap.after**2, 0.0))
        out.append(replace(found, after=after.after) if good and found and after else None)
    return tuple(out)


def _fitted(fit: Fit, rows: Sequence[Bools], chosen: Sequence[TermCandidate], whitening: Whitening,
            options: FitOptions) -> tuple[Learned, Visible, Fit]:
    """Return the terms, the rows they are from, and the fit with them.

    ``rows``: those to start with, by data set. They are learned again where the fit with them
    uses more rows.
    """
    keep = list(rows)
    for _ in range(ROUNDS):
        seen = visible(fit, keep, whitening)
        found = relearned(seen, chosen)
        machine = with_terms(fit.problem.mechanism, found)
        after = with_mechanism(fit, machine, options)
        more = _rows(fit, after)
        if sum(k.sum() for k in more) <= sum(k.sum() for k in keep):
            break
        keep = more
    return found, seen, after


def _rows(before: Fit, after: Fit) -> list[Bools]:
    """Return the rows that the second fit uses and that the first one has poses for."""
    return [k & finite_rows(p) for k, p in zip(after.keep, before.state.poses, strict=True)]


def visible(fit: Fit, keep: Sequence[Bools], whitening: Whitening) -> Visible:
    """Return rows of a fit with what geometry and effects cannot do there."""
    return visible_at(fit, subsample(list(keep), MOST_ROWS), whitening)


def visible_at(fit: Fit, rows: Sequence[Bools], whitening: Whitening) -> Visible:
    """Return the same of all of some rows."""
    system = build(fit.problem, fit.state, rows)
    basis = range_basis(whitening.apply(system.jacobian, system), INVISIBLE)
    residual = whitening.apply(system.residual[..., None], system)[:, 0]
    return Visible(system, whitening, basis, residual - basis @ (basis.T @ residual))


def with_terms(mechanism: Mechanism, found: Learned) -> Mechanism:
    """Return the machine with learned terms as effects that no fit changes."""
    for term, curve in zip(found.terms, found.curves, strict=True):
        mechanism = with_effect(mechanism, learned_kind(curve), term.candidate.on, {})
    return mechanism


class _JudgedRows:
    """Rows on which terms are judged, and which of these they and geometry are solved for in.

    Every row that can be compared, whether the terms miss it or not; rows that were left out as
    outliers are predicted only.
    """

    def __init__(self, before: Fit, after: Fit, seen: Visible, terms: Sequence[Term]) -> None:
        rows = compared_rows(before, after)
        used = _chosen(seen, rows)
        if sum(int(r.sum()) for r in rows) > sum(int(u.sum()) for u in used):
            rows = [u | r for u, r in zip(used, subsample(rows, MOST_ROWS), strict=True)]
            self.seen = visible_at(before, rows, seen.noise)
            terms = [replace(t, candidate=again(self.seen, t.candidate)) for t in terms]
        else:
            self.seen = seen
        system = self.seen.system
        self.used: Bools = np.array([used[d][n] for d, n in zip(
            system.dataset, system.row, strict=True)], dtype=bool)
        self.terms = terms


def _chosen(seen: Visible, like: Sequence[Bools]) -> list[Bools]:
    """Return the rows (N,) of each data set that are in a system."""
    out = [np.zeros_like(r) for r in like]
    for d, n in zip(seen.system.dataset, seen.system.row, strict=True):
        out[d][n] = True
    return out


def _block_gaps(judged: _JudgedRows, noise: float, seed: int) -> list[BlockGap]:
    """Return the gap over stretches of time and conditions left out, without and with the terms."""
    found = [(by, _left_out(judged, folds, noise, seed))
             for by, folds in schemes(judged.seen.system.problem)]
    return [BlockGap(by, gap) for by, gap in found if gap is not None]


def _pose_folds(seen: Visible, seed: int) -> list[list[Bools]]:
    """Return commanded poses put into folds at random: the rows of each (N,), by data set."""
    rng = np.random.default_rng(seed)
    fold: dict[int, int] = {}
    folds = list[Ints]()
    for own in pose_labels(seen.system.problem.datasets):
        # a pose that another file of the campaign has too is in the same fold there
        new = np.setdiff1d(own, list(fold))
        fold |= zip(new.tolist(), rng.permutation(np.arange(new.size) % FOLDS).tolist(),
                    strict=True)
        folds.append(np.array([fold[label] for label in own.tolist()], dtype=np.int64))
    return [[f == k for f in folds] for k in range(FOLDS)]


def _left_out(judged: _JudgedRows, folds: Sequence[Sequence[Bools]], noise: float, seed: int
              ) -> Gap | None:
    """Return the gap of rows that are left out in turn, without and with the terms.

    To first order: geometry and terms solved for without them, lengths and sizes kept.
    """
    seen, system = judged.seen, judged.seen.system
    shape = system.residual.shape
    white = seen.noise.apply(np.concatenate(
        [system.jacobian, system.residual[..., None]], axis=-1), system)
    z = np.concatenate([np.zeros((len(white), 0)), *(
        t.candidate.columns @ (t.size * t.shape.root) for t in judged.terms)], axis=1)
    flat = np.concatenate([white[:, :-1], z], axis=1)
    errors: list[tuple[HeldOutErrors, HeldOutErrors]] = []
    for fold in folds:
        mine = np.array([fold[d][n] for d, n in zip(system.dataset, system.row, strict=True)])
        rest = judged.used & ~mine
        if not mine.any() or not rest.any():
            continue
        block, known = (np.repeat(m, shape[1]) for m in (mine, rest))
        pair = [_predicted(flat[:, :c], white[:, -1], block, known, white.shape[1] - 1)
                for c in (white.shape[1] - 1, flat.shape[1])]
        errors.append((_errors(seen, pair[0], mine), _errors(seen, pair[1], mine)))
    if not errors:
        return None
    old, new = (HeldOutErrors.joined([p[k] for p in errors]) for k in (0, 1))
    return gap_of(old, new, noise, seed)


def _predicted(columns: Array, residual: Array, block: Bools, known: Bools, free: int) -> Array:
    """Return the residual (b,) of a block as the rows that are ``known`` predict it.

    The first ``free`` columns are as they come; the others are standard normal times sigma.
    """
    rest = columns[known]
    normal = rest.T @ rest + np.diag(np.arange(columns.shape[1]) >= free).astype(float)
    w, v = linalg.eigh(normal)
    use = w > SEEN * max(float(w[-1]), 1e-300)
    step = (v[:, use] / w[use]) @ (v[:, use].T @ (rest.T @ residual[known]))
    left = np.asarray(residual[block] - columns[block] @ step)
    # frame and target of a session left out are those of its own rows
    own = np.sum(rest[:, :free] ** 2, axis=0) <= SEEN * np.sum(columns[:, :free] ** 2, axis=0)
    basis = range_basis(columns[block][:, :free][:, own])
    return np.asarray(left - basis @ (basis.T @ left))


def _errors(seen: Visible, left: Array, mine: Bools) -> HeldOutErrors:
    system = seen.system
    square = np.sum(left.reshape(-1, system.residual.shape[1]) ** 2, axis=1)
    count = system.observed[mine].sum(axis=1).astype(float)
    return HeldOutErrors(square, np.zeros(square.size), count, system.group[mine])

