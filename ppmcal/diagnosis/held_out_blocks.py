"""The gap on whole sessions, stretches of time and of the environment, each left out in turn.

Held-out poses lie between others that were measured at the same time and temperature: an effect
of time or heat that is wrong predicts them all the same. A block is predicted by what the fit
would be without it, to first order: with the normal matrix A of all rows and prior, and the
block's rows J and residuals r,

    r_out = r + J (A - J^T J)^-1 J^T r.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Fit, Problem, Rows, rows_with_outliers, single_gross_rows
from ppmcal.calibration.validation import thirds
from ppmcal.diagnosis.held_out_gap import Gap, HeldOutErrors, errors_of, gap_of
from ppmcal.linalg import Array, Bools, range_basis
from ppmcal.model.sessions import session_masks

LEVELS = 3
"""A load of fewer levels cannot be left out: the others would not tell what it does."""
SEEN = 1e-10
"""Directions below this part of the strongest are not known without the block."""
SESSION = "session"
IN_STEP = 0.7
"""What has so large a rank correlation with the rows' order is as good as time."""

@dataclass(frozen=True)
class BlockGap:
    """The gap when a session, or all rows of one third of ``by``, are left out in turn."""

    by: str
    gap: Gap


def block_gaps(before: Fit, after: Fit, noise: float, seed: int) -> tuple[BlockGap, ...]:
    """Return the gap over stretches of time, temperature and load, where these vary.

    Args:
        before: the fit of all rows without the effects.
        after: the fit with them.
        noise: over the stated one.
        seed: of the bootstrap.
    """
    keep = compared_rows(before, after)
    seen = [_all_rows(fit, keep) for fit in (before, after)]
    out = []
    for by, folds in schemes(after.problem):
        pairs = [(_left_out(before, fold, keep, seen[0]), _left_out(after, fold, keep, seen[1]))
                 for fold in folds]
        pairs = [(old, new) for old, new in pairs if old.square.size == new.square.size > 0]
        if len(pairs) == len(folds):
            old, new = (HeldOutErrors.joined([p[k] for p in pairs]) for k in (0, 1))
            out.append(BlockGap(by, gap_of(old, new, noise, seed)))
    return tuple(out)


def compared_rows(before: Fit, after: Fit) -> list[Bools]:
    """Return the rows (N,) of each data set on which two fits are compared, whoever misses them.

    Rows that either left out as outliers are among them: those tell most. Only what is a gross
    error whatever the geometry is not.
    """
    return [a & b & ~typo for a, b, typo in zip(
        rows_with_outliers(before), rows_with_outliers(after), single_gross_rows(before),
        strict=True)]


def schemes(problem: Problem) -> Iterator[tuple[str, list[list[Bools]]]]:
    """Yield what rows are left out by, and the blocks: a mask (N,) by data set for each.

    No stretch of time is left out of a campaign with an event: what happened in it cannot be
    known without it, nor what follows if the rest follows in it.
    """
    parts = session_masks(problem.datasets)
    if len(parts) > 1:
        yield SESSION, [mask for _, mask in parts]
    events = any(e.kind.onset for e in problem.mechanism.effects)
    order = [thirds(np.arange(len(d), dtype=float)) for d in problem.datasets]
    if not events:
        yield "time", [list(masks) for masks in zip(*order, strict=True)]
    row = np.concatenate([c.row for c in problem.environments])
    heat = np.concatenate([c.temperature for c in problem.environments])
    load = np.concatenate([np.linalg.norm(c.wrench, axis=1) for c in problem.environments])
    ends = np.cumsum([len(d) for d in problem.datasets])[:-1]
    for by, values in (("temperature", heat), ("load", load)):
        if events and abs(_rank_correlation(values, row)) > IN_STEP:
            continue
        if _varies(values) and (by != "load" or np.unique(np.round(values, 9)).size >= LEVELS):
            yield by, [np.split(mask, ends) for mask in thirds(values)]


def _rank_correlation(a: Array, b: Array) -> float:
    """Return Spearman's rank correlation where both are known, 0 where one is the same."""
    known = np.isfinite(a) & np.isfinite(b)
    ranks = [np.argsort(np.argsort(v[known], kind="stable")).astype(float) for v in (a, b)]
    if known.sum() < 3 or np.ptp(a[known]) == 0.0:
        return 0.0
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def _varies(values: Array) -> bool:
    return bool(np.isfinite(values).all()
                and np.ptp(values) > 1e-9 * max(np.abs(values).max(), 1e-300))


MOST_KEPT = 2**25
"""A Jacobian of more numbers is made anew for each block that is left out."""


def _all_rows(fit: Fit, keep: Sequence[Bools]) -> list[Rows] | None:
    """Return the rows of a fit, without how they respond; None where they are too many."""
    width = 6 * fit.scale.size
    if width * sum(int(k.sum()) for k in keep) > MOST_KEPT:
        return None
    return [replace(r, response=None, second=None) for r in fit.problem.rows(fit.state, True, keep)]


def _some(rows: Rows, mask: Bools) -> Rows:
    return replace(rows, index=rows.index[mask], residual=rows.residual[mask],
                   jacobian=rows.jacobian[mask], observed=rows.observed[mask], raw=rows.raw[mask],
                   whitener=rows.whitener[mask])


def _left_out(fit: Fit, fold: Sequence[Bools], keep: Sequence[Bools],
              seen: Sequence[Rows] | None = None) -> HeldOutErrors:
    """Return the errors of a block's rows as the fit without them predicts them.

    Rows that the fit has left out anyway are predicted by it as it is. A frame or target that
    nothing else tells of, that of a whole session, stays fitted to the block's own rows. ``seen``:
    all rows, where they are known.
    """
    if seen is None:
        seen = list(fit.problem.rows(fit.state, True, [f & k for f, k in zip(
            fold, keep, strict=True)]))
    rows = [_some(r, fold[r.dataset][r.index]) for r in seen]
    width = fit.scale.size
    flat = [r.jacobian.reshape(-1, width) * fit.scale for r in rows]
    triangle = fit.reduced.triangle * fit.scale
    normal = triangle.T @ triangle + np.diag((fit.prior * fit.scale) ** 2)
    right = np.zeros(width)
    used = [np.repeat(fit.keep[r.dataset][r.index], r.residual.shape[1]) for r in rows]
    out = np.concatenate([np.zeros((0, width)), *(j[u] for j, u in zip(flat, used, strict=True))])
    missed = np.concatenate([np.zeros(0), *(
        r.residual.reshape(-1)[u] for r, u in zip(rows, used, strict=True))])
    alone = _seen_only_here(fit, normal, out)
    if alone.any():
        basis = range_basis(out[:, alone], SEEN)
        out, missed = out - basis @ (basis.T @ out), missed - basis @ (basis.T @ missed)
    normal -= out.T @ out
    right += out.T @ missed
    w, v = linalg.eigh(normal)
    use = w > SEEN * max(float(w[-1]), 1e-300)
    inverse = (v[:, use] / w[use]) @ v[:, use].T
    step = inverse @ right
    return errors_of(fit.problem, (
        (r, r.residual + (j @ step).reshape(r.residual.shape))
        for j, r in zip(flat, rows, strict=True)), inverse * np.outer(fit.scale, fit.scale))


def _seen_only_here(fit: Fit, normal: Array, out: Array) -> Bools:
    """Return which columns of frames, targets and zeros only the rows ``out`` tell of (C,)."""
    own = np.arange(len(normal)) >= len(fit.problem.free)
    whole = np.diagonal(normal)
    return np.asarray(own & (whole > 0.0) & (whole - np.sum(out**2, axis=0) <= SEEN * whole))
