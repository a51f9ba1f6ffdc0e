"""Intervals that hold on another day: by sessions, or by blocks of the only one.

Noise averages out over rows; differences between sessions do not, nor do errors that are smooth
over the workspace or over time. With several sessions their disagreement enters the intervals.
Blocks of rows near each other in joint space, and blocks of rows in their order, are treated like
sessions (a block bootstrap in closed form: the fit's own linear problem, block by block), and count
if they differ by more than noise. A single session cannot show what differs between sessions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    coverage_of,
    half_of_mixture,
    noise_parts,
    posterior,
    prediction_covariance,
    variances,
)
from ppmcal.calibration.knowledge.session_clusters import by_gaps, clusters
from ppmcal.calibration.knowledge.session_variance import SessionVariance, differs, session_variance
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.sessions import session_masks
from ppmcal.notes import Note
from ppmcal.wording.progress import stage

BLOCKS, LEAST_ROWS, MOST_PLACES = 8, 3, 100
"""Blocks of a session, minimum rows in each, and maximum number of blocks of places."""
STRETCHES = 1.0
"""Blocks of one machine differ by at most this many tolerances."""
APART = "identify each alone, and `ppmcal compare` reports what changed"
"""What to do about sessions that differ."""


BETWEEN = 9
"""Noise variances of the mixture for which the covariance is computed; others are interpolated."""


def by_noise(fit: Fit, options: FitOptions, more: Array | float = 0.0) -> Array:
    """Return the half width of the 95 % interval of every column (C,), noise size integrated out.

    The variance of the rows is a scaled inverse chi-squared about the stated one, which counts as
    :data:`ppmcal.calibration.fit.LEAST` values, and the part of the residuals that no error
    of the machine can explain. Without a prior on the parameters this is Student's t; a parameter
    held by its tolerance is no less certain for noisier rows. inf where the column is unbounded.

    Args:
        fit: with the noise used for its intervals so far.
        options: of this fit; a prior that was chosen by the residuals scales with the noise.
        more: variance of each column (C,) that is not due to noise of the rows.
    """
    variance = variances(*noise_parts(fit))
    if options.method == "gcv" or not fit.prior.any():
        each = np.outer(variance, np.diagonal(prediction_covariance(fit)))
    else:
        some = np.geomspace(variance.min(), variance.max(), BETWEEN)
        known = [np.diagonal(prediction_covariance(replace(
            fit, information=replace(fit.information, root=fit.information.root / np.sqrt(v)))))
            for v in some.tolist()]
        logs = np.log(np.maximum(known, 1e-300)).T
        each = np.exp([np.interp(np.log(variance), np.log(some), own) for own in logs]).T
    half = half_of_mixture(each + more)
    return np.where(np.isinf(np.diagonal(posterior(fit))), np.inf, half)


def coverage(fit: Fit) -> float:
    """Return the half width of a 95 % interval over the sigma for the fit's noise.

    Like :func:`by_noise`, for quantities without tolerance: an effect's size, a learned curve.
    """
    return coverage_of(variances(*noise_parts(fit)))


@stage("widening intervals where rows disagree")
def cluster_robust(fit: Fit, inflation: float) -> tuple[SessionVariance | None,
                                                        SessionVariance | None]:
    """Return the effect of sessions, and of blocks of rows, on a fit's uncertainty.

    Either is None if there is none; intervals of sessions include those of blocks.

    Args:
        fit: with rows ``inflation`` times as noisy as stated.
        inflation: see there.
    """
    sessions, blocks = by_sessions(fit, inflation), by_blocks(fit, inflation)
    if sessions is not None and blocks is not None:
        sessions = replace(sessions, half=np.maximum(sessions.half, blocks.half))
    return sessions, blocks


def by_sessions(fit: Fit, inflation: float) -> SessionVariance | None:
    """Return the effect of sessions that differ on a fit's uncertainty, None for one session.

    Args:
        fit: with rows ``inflation`` times as noisy as stated.
        inflation: see there.
    """
    found = [(label, [m & k for m, k in zip(mask, fit.keep, strict=True)])
             for label, mask in session_masks(fit.problem.datasets)]
    seen = [(label, mask) for label, mask in found if any(m.any() for m in mask)]
    if len(seen) < 2 or not fit.problem.free or fit.problem.earlier is not None:
        return None
    data = clusters(fit, [label for label, _ in seen], [mask for _, mask in seen])
    return session_variance(fit, data, inflation, alike=True)


def by_blocks(fit: Fit, inflation: float) -> SessionVariance | None:
    """Return the same for blocks of rows, over joint space or in their order.

    For joint values alone, rows at one place are a block too: what limbs pull against each other
    there is one number, however often it is read. None if none differ by more than noise, or there
    are too few rows; otherwise the kind of block that makes the intervals longest.
    """
    rows = [int(k.sum()) for k in fit.keep]
    if sum(rows) < BLOCKS * LEAST_ROWS or not fit.problem.free or fit.problem.earlier is not None:
        return None
    found = []
    ways = {"joint space": _blocks(_labels(fit, _near), BLOCKS),
            "order": _blocks(_labels(fit, _in_order), BLOCKS)}
    if fit.problem.blind and (places := _places(fit)):
        ways["place"] = places
    for name, masks in ways.items():
        data = clusters(fit, [f"{name} {b + 1}" for b in range(len(masks))], masks)
        if fit.problem.blind:
            parts, most = by_gaps(data), float(np.sqrt(data.count.sum()))
            if differs(fit, data, inflation, parts, most):
                found.append(replace(session_variance(fit, data, inflation, most, parts=parts),
                                     sessions=False))
        elif differs(fit, data, inflation):
            found.append(replace(session_variance(fit, data, inflation, STRETCHES), sessions=False))
    count = len(fit.problem.free)
    return max(found, default=None, key=lambda f: float(np.median(
        f.half[:count] / fit.scale[:count])))


def _blocks(labels: Sequence[Ints], count: int) -> list[list[Bools]]:
    """Return the rows (N,) of every data set, block by block, from their block numbers (N,)."""
    return [[own == b for own in labels] for b in range(count)]


def _places(fit: Fit) -> list[list[Bools]]:
    """Return the rows (N,) of every data set, place by place; empty if no place is read again.

    Many places are merged with their neighbours, which does not change their effect on the noise.
    """
    labels, count = [], 0
    for data, keep in zip(fit.problem.datasets, fit.keep, strict=True):
        own = np.full(len(data), -1)
        places, own[keep] = np.unique(data.groups[keep], return_inverse=True)
        own[keep] += count
        labels.append(own)
        count += places.size
    if count == sum(int(k.sum()) for k in fit.keep):
        return []
    blocks = min(count, MOST_PLACES)
    return _blocks([np.where(own < 0, -1, own * blocks // count) for own in labels], blocks)


def spatial_blocks(fit: Fit) -> list[Ints]:
    """Return the block in joint space of each row (N,) in use, -1 for other rows."""
    return _labels(fit, _near)


def _labels(fit: Fit, label: Callable[[Array], Ints]) -> list[Ints]:
    """Return block numbers (N,) of the rows in use of every data set, -1 for others."""
    labels = []
    for data, keep in zip(fit.problem.datasets, fit.keep, strict=True):
        own = np.full(len(data), -1)
        use = keep & finite_rows(data.q)
        own[use] = label(data.q[use])
        labels.append(own)
    return labels


def _in_order(q: Array) -> Ints:
    """Return block numbers (n,) of rows in their order."""
    return np.arange(len(q)) * BLOCKS // max(len(q), 1)


def _near(q: Array) -> Ints:
    """Return block numbers (n,) of neighbouring rows: halved three times where q is widest."""
    block = np.zeros(len(q), dtype=int)
    level = 1
    while level < BLOCKS:
        new = block.copy()
        for b in range(level):
            mine = np.flatnonzero(block == b)
            if mine.size:
                widest = int(np.argmax(np.std(q[mine], axis=0)))
                order = mine[np.argsort(q[mine, widest], kind="stable")]
                new[order[mine.size // 2:]] += level
        block, level = new, 2 * level
    return block


SHOWN, VISIBLE = 3, 1.05


def in_words(fit: Fit, found: SessionVariance | None, alone: Array,
             blocks: SessionVariance | None = None) -> list[Note]:
    """Return findings on parameters that sessions disagree about, in file units.

    Args:
        fit: of all rows.
        found: disagreement of sessions or blocks of rows.
        alone: half width of the 95 % interval of each parameter by noise alone (F,), or nan.
        blocks: disagreement of blocks of rows beside the sessions ``found``.
    """
    if found is not None and found.sessions and blocks is not None and fit.problem.blind:
        own = replace(found, half=np.append(alone, found.half[alone.size:]))
        return [*in_words(fit, own, alone), *in_words(fit, blocks, alone)]
    if found is None or not (found.differ or found.disagree.any()):
        return []
    known = np.isfinite(alone) & (alone > 0.0)
    wide = float(np.median(found.half[:alone.size][known] / alone[known])) if known.any() else 1.0
    if not found.sessions:
        return [Note(f"the residuals are smooth over {found.labels[0].rsplit(' ', 1)[0]}: "
                     f"rows there are not independent, and intervals allow for it{_longer(wide)}; "
                     "`ppmcal diagnose` looks for a cause", topic="sessions")]
    if not found.disagree.any():
        return [Note(f"{len(found.labels)} sessions differ by more than their noise: intervals "
                     f"allow for it{_longer(wide)}; {APART}", topic="sessions")]
    worst = np.argsort(found.p_value, kind="stable")[:int(found.disagree.sum())]
    each = "; ".join(_values(fit, found, c) for c in worst[:SHOWN].tolist())
    more = f"; and {len(worst) - SHOWN} more" if len(worst) > SHOWN else ""
    return [Note(f"sessions disagree about {len(worst)} of {found.p_value.size} parameters, each "
                 f"fitted alone: {each}{more}; intervals allow for it; {APART}", topic="sessions")]


def _longer(times: float) -> str:
    """Return by how much intervals are longer, empty if their median hardly is."""
    return (f" and are {times:.2g} times as long as noise alone makes them (median)"
            if times >= VISIBLE else "")


def _values(fit: Fit, found: SessionVariance, column: int) -> str:
    """Return a parameter's value and 95 % interval by noise in each session, file units."""
    place = fit.problem.free[column]
    parameter, units = fit.problem.mechanism.parameters[place], fit.problem.mechanism.units
    factor = units.factor(parameter.quantity)
    value = float(fit.state.g[place])
    each = ", ".join(
        f"{(value + own) / factor:.6g} +- {found.coverage * sigma / factor:.2g} in {label}"
        for label, own, sigma in zip(found.labels, found.own[:, column].tolist(),
                                     found.own_sigma[:, column].tolist(), strict=True))
    return (f"{parameter.name} {each} {units.name(parameter.quantity)}"
            + "/unit" * parameter.per_unit)
