"""Ropes that were slack in rows of a fit: they would have to push, or read too long.

The reading of a slack rope exceeds the distance of its ends, in each row by any amount. Every rope
is tested for this if residuals exceed the noise or rows were left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import (
    Fit,
    Problem,
    State,
    column_scale,
    noise_check,
    prior_weights,
    rows_with_outliers,
)
from ppmcal.inference.one_sided import LongReadings, long_readings
from ppmcal.inference.priors import NOISE_FREEDOM, OWN_NOISE_FREEDOM, SURE_ODDS, WIDE
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.loads import rope_tensions
from ppmcal.linalg import Array, Bools, Ints, reciprocals
from ppmcal.notes import FINDING, Note
from ppmcal.wording import number, row_list

MOST_ROWS = 1500
"""Maximum number of rows searched for readings that are too long, evenly spread."""
ROUNDS = 4
"""Number of times that rows are recomputed with the readings found."""


def slack_ropes(fit: Fit) -> Iterator[Note]:
    """Yield the ropes that were slack: those that would have to push, and those that read long."""
    yield from _pushing(fit)
    yield from _long(fit)


def _pushing(fit: Fit) -> Iterator[Note]:
    """Yield, for each file, the ropes with negative tension, as measured or from the load."""
    mechanism = fit.problem.mechanism
    ropes = sorted({limb.actuator for limb in mechanism.limbs if limb.kind.pulls_only})
    if not ropes:
        return
    model = Model(mechanism, fit.state.g)
    for data, rows, pose in zip(fit.problem.datasets, fit.problem.environments, fit.state.poses,
                                strict=True):
        tension = rope_tensions(model, data.q, pose, rows.wrench, rows.tension)[:, ropes]
        for a, own in zip(ropes, tension.T, strict=True):
            slack = np.flatnonzero(own < 0.0)
            if slack.size:
                least = number(float(own[slack].min()), 3)
                yield Note(
                    f"{data.name}: {mechanism.actuators[a]} would have to push in "
                    f"{row_list(data.rows[slack] - 1)} (down to {least} N): a rope is slack "
                    "there, and its reading is meaningless. Leave these rows out, or load the "
                    "platform so that all ropes pull.", FINDING, "slack")


# --- readings that are too long -------------------------------------------------------------------

@dataclass(frozen=True, eq=False)
class _Tight:
    """A problem with one rope's readings shortened as found, and its state.

    ``longer``: shortening by data set (N,), m; ``moved``: step of open columns since the fit (C,).
    """

    problem: Problem
    state: State
    longer: tuple[Array, ...]
    moved: Array


@dataclass(frozen=True, eq=False)
class _LongRope:
    """A limb that reads long: in which rows of which data set (n,), and how certain that is."""

    limb: int
    dataset: Ints
    row: Ints
    found: LongReadings


def _long(fit: Fit) -> Iterator[Note]:
    """Yield, for each file, the ropes that read too long, in left-out rows as well."""
    mechanism, datasets = fit.problem.mechanism, fit.problem.datasets
    limbs = [i for i, limb in enumerate(mechanism.limbs) if limb.kind.pulls_only and sum(
        other.actuator == limb.actuator for other in mechanism.limbs) == 1]
    estimated = all(d.estimated for d in datasets)
    left_out = any(gone.any() for gone in fit.outliers)
    if not limbs or not fit.by_tolerances or not (
            estimated or left_out or noise_check(fit).failed):
        return
    keep = linalg.subsample(rows_with_outliers(fit), MOST_ROWS)
    known = float(OWN_NOISE_FREEDOM if estimated else NOISE_FREEDOM)
    found = [rope for i in limbs if (rope := _long_rope(fit, i, keep, known))]
    if not found:
        return
    sure = float(np.log(SURE_ODDS))
    best = max(found, key=lambda rope: rope.found.log_odds)
    if min(best.found.log_odds, best.found.beyond) < sure:
        return
    # with one contradiction per row only the spread of lengths could tell which rope it is
    apart = np.inf if fit.problem.blind and mechanism.surplus == 1 else sure
    others = [r for r in found if r is not best
              and r.found.log_odds > best.found.log_odds - apart and r.found.beyond > 0.0]
    for i in range(len(datasets)):
        off = (best.dataset == i) & (best.found.kind >= 0)
        if off.any():
            yield _told(fit, i, best, others, off, int(np.count_nonzero(best.dataset == i)))


def _told(fit: Fit, i: int, best: _LongRope, others: Sequence[_LongRope], off: Bools, count: int
          ) -> Note:
    mechanism, data = fit.problem.mechanism, fit.problem.datasets[i]
    names = [mechanism.limbs[r.limb].name for r in sorted((best, *others), key=lambda r: r.limb)]
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    length = best.found.length[off] / factor
    which = f"one of {', '.join(names)}" if others else names[0]
    by = f"if {mechanism.limbs[best.limb].name}, by" if others else "by"
    sizes = f"{by} {number(float(length.min()), 3)} to {number(float(length.max()), 3)} {unit}"
    noise = f"which leaves residuals of {number(best.found.noise, 3)} times the noise"
    if length.size == count and len(fit.problem.datasets) > 1:
        return Note(f"{data.name}: {which} reads long in every row ({sizes}), {noise}: another "
                    "zero than in the other files, or slack all the time? If another zero, write "
                    "`homing: per-file` into the sidecar; else pull every rope tight and measure "
                    "again.", FINDING, "slack")
    return Note(
        f"{data.name}: {which} reads long in {length.size} of {count} rows "
        f"({row_list(data.rows[best.row[off]] - 1)}; {sizes}), {noise}: slack? A slack rope reads "
        "longer than its ends are apart, which is meaningless. Pull every rope tight and measure "
        "again, or leave these rows out.", FINDING, "slack")


def _long_rope(fit: Fit, limb: int, keep: Sequence[Bools], known: float) -> _LongRope | None:
    """Return in which rows one limb reads long, None if that explains nothing."""
    problem = fit.problem
    weight = prior_weights(problem, "prior")
    scale = np.where(weight > 0.0, reciprocals(weight), float(WIDE) * column_scale(problem))
    at = _Tight(problem, fit.state, tuple(np.zeros(len(d)) for d in problem.datasets),
                np.zeros(len(scale)))
    rope = None
    for _ in range(ROUNDS):
        if rope is not None:
            at = _tightened(fit, at, rope, scale)
        white, jacobian, reading, dataset, row = _white(at, limb, keep, scale)
        found = long_readings(white, jacobian, reading, known)
        if found is None or found.log_odds < 0.0:
            return None
        rope = _LongRope(limb, dataset, row, found)
    return rope


def _from_nominal(at: _Tight, scale: Array) -> Array:
    """Return how far a state is from its priors, in their units (C,)."""
    problem = at.problem
    out = at.moved / scale
    for c, p in enumerate(problem.free):
        out[c] = (at.state.g[p] - problem.mechanism.parameters[p].nominal) / scale[c]
    return np.asarray(out)


def _white(at: _Tight, limb: int, keep: Sequence[Bools], scale: Array
           ) -> tuple[Array, Array, Array, Ints, Ints]:
    """Return white rows (N, m) referred to nominal and to the readings, and their derivatives.

    By parameters (N, m, C) in units of ``scale``, and by a reading (N, m, 1), per m; and the
    data set and row (N,) of each.
    """
    back, parts = _from_nominal(at, scale), []
    for rows in at.problem.rows(at.state, True, keep):
        jacobian = rows.jacobian * scale
        reading = np.zeros(rows.residual.shape)
        if rows.response is not None and rows.second is None:
            reading = rows.whitened(rows.response.by_slot(limb, "offset"))
        longer = at.longer[rows.dataset][rows.index, None]
        parts.append((rows.residual + jacobian @ back - reading * longer, jacobian,
                      reading[..., None], np.full(len(reading), rows.dataset), rows.index))
    widest = max(p[0].shape[1] for p in parts)
    white, jacobian, reading = (np.concatenate([np.pad(p[k], (
        (0, 0), (0, widest - p[k].shape[1]), *((0, 0),) * (p[k].ndim - 2))) for p in parts])
        for k in range(3))
    return (white, jacobian, reading, np.concatenate([p[3] for p in parts]),
            np.concatenate([p[4] for p in parts]))


def _tightened(fit: Fit, at: _Tight, rope: _LongRope, scale: Array) -> _Tight:
    """Return the problem with a limb's readings shortened as found."""
    mechanism, found = fit.problem.mechanism, rope.found
    ratio, actuator = mechanism.limb_ratios[rope.limb], mechanism.limbs[rope.limb].actuator
    longer, data = [], []
    for i, own in enumerate(fit.problem.datasets):
        off = np.zeros(len(own))
        off[rope.row[rope.dataset == i]] = found.length[rope.dataset == i]
        q = own.q.copy()
        q[:, actuator] -= off / ratio
        longer.append(off)
        data.append(replace(own, q=q))
    step = scale * (found.parameters - _from_nominal(at, scale))
    problem = replace(fit.problem, datasets=tuple(data))
    return _Tight(problem, problem.moved(at.state, step), tuple(longer), at.moved + step)
