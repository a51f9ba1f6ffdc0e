"""Misfit common to two sessions: the model's part of the residuals, and the noise beside it.

Errors of a model recur at the same joint values; noise does not. Rows of two sessions that
are closest to each other are paired: where residuals are alike, their difference is the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtr, chdtrc

from ppmcal.calibration.fit import FAILED_NOISE, LEAST, PoseResiduals, Posterior, SessionKnowledge
from ppmcal.linalg import Array, Ints

SAME = 0.2
"""Poses are the same if they are closer than this part of the typical spacing of poses."""

SURE = 4.0
"""Residuals are alike if their correlation exceeds chance by this many standard deviations."""
MISSED = 5.0
"""Errors of the model may be this many times as large within its own columns as outside them."""
LEAST_SHARE = 0.05
"""Minimum part of the residuals that is noise: the same rows in both would suggest none."""


@dataclass(frozen=True)
class DifferenceNoise:
    """Noise of two sessions over their stated ones, for the difference of the two.

    ``degrees``: degrees of freedom of its estimate, inf if the stated ones hold; ``share``:
    part of the residuals' size that is noise, the rest is common to both; ``same``: whether the
    two measured the same poses; ``pairs``: rows of the old and the new (n,) that are one pose,
    if both keep their rows as measured; ``alike``: size of errors that rows of the same poses may
    have in common, times the noise, 0: none.
    """

    old: float
    new: float
    degrees: float
    share: float
    same: bool
    pairs: tuple[Ints, Ints] | None = None
    alike: float = 0.0


def noise_between(old: Posterior, new: Posterior) -> DifferenceNoise:
    """Return the noise of two calibrations' data without their common misfit."""
    one, two = old.session, new.session
    if one is None or two is None:
        return DifferenceNoise(old.inflation, new.inflation, np.inf, 1.0, False)
    same, share = _paired(one.sights, two.sights)
    if not same:
        # neighbouring rows are alike, but fits to different poses are not
        share = 1.0
    ratios, degrees = [], 0.0
    for session, posterior in ((one, old), (two, new)):
        ratio = share * session.noise
        if session.degrees < LEAST:
            # as many columns as rows: with other poses the model's part is unknown
            ratios.append(1.0 if same else posterior.inflation)
            continue
        square = session.degrees * ratio**2
        chance = float(min(chdtr(session.degrees, square), chdtrc(session.degrees, square)))
        failed = chance < FAILED_NOISE
        # a misfit that does not recur at the same poses varies with the poses
        apart = max(1.0, session.spread / max(session.noise, 1e-300)) if share == 1.0 else 1.0
        ratios.append(ratio * apart if failed else 1.0)
        degrees += session.degrees * failed
    if degrees and share == 1.0 and _alike(one, two):
        # errors seen in one session are in the other too, at other poses or in left-out rows
        square = sum(s.degrees * r**2 for s, r in zip((one, two), ratios, strict=True))
        both = float(np.sqrt(square / (one.degrees + two.degrees)))
        ratios = [max(r, both) for r in ratios]
    pairs = _single_rows(one, two) if same and one.single and two.single else None
    shared = same and (share < 1.0 or min(one.degrees, two.degrees) < LEAST)
    return DifferenceNoise(ratios[0], ratios[1], degrees or np.inf, share, same, pairs,
                 shared * MISSED * max(old.inflation, new.inflation, one.noise, two.noise))


def _alike(old: SessionKnowledge, new: SessionKnowledge) -> bool:
    """Return whether two sessions used instruments of the same kinds."""
    one, two = (sorted({(v.kind, v.rotations) for v in s.sights}) for s in (old, new))
    return one == two


def _single_rows(old: SessionKnowledge, new: SessionKnowledge) -> tuple[Ints, Ints] | None:
    """Return which rows of the two are one pose, None if rows lack some coordinates."""
    if any(s.right.size != sum(d.rest.size for d in s.sights) for s in (old, new)):
        return None
    found: list[list[Ints]] = [[], []]
    begin = [0, 0]
    for a, b in zip(old.sights, new.sights, strict=True):
        i, j, _ = _nearest(a.q, b.q)
        for side, index, data in ((0, i, a), (1, j, b)):
            width = data.rest.shape[1]
            found[side].append((begin[side] + width * index[:, None]
                                + np.arange(width)).ravel())
            begin[side] += data.rest.size
    return np.concatenate(found[0]), np.concatenate(found[1])


def _paired(old: tuple[PoseResiduals, ...], new: tuple[PoseResiduals, ...]) -> tuple[bool, float]:
    """Return whether the poses are the same, and the difference of pairs over their residuals."""
    difference = size = 0.0
    same, count = len(old) == len(new), 0
    for a, b in zip(old, new, strict=False):
        if a.kind != b.kind or a.rest.shape[1] != b.rest.shape[1]:
            same = False
            continue
        a, b = _once(a), _once(b)
        i, j, near = _nearest(a.q, b.q)
        same &= near
        if i.size < LEAST:
            continue
        places = a.rest.shape[1] - a.rotations
        for part in (slice(0, places), slice(places, a.rest.shape[1])):
            one, two = a.rest[i, part], b.rest[j, part]
            whole = float(np.sum(one**2) + np.sum(two**2))
            if whole > 0.0:
                difference += one.size * float(np.sum((two - one) ** 2)) / whole
                size += one.size
                count += one.size
    if count < LEAST:
        return same, 1.0
    # pairs that have nothing in common are this much alike by chance
    if 1.0 - difference / size < SURE / np.sqrt(size):
        return same, 1.0
    return same, float(np.clip(np.sqrt(difference / size), LEAST_SHARE, 1.0))


def _once(sight: PoseResiduals) -> PoseResiduals:
    """Return the first row of each repeated pose."""
    unit = np.ptp(sight.q, axis=0)
    places = np.round(sight.q / np.where(unit > 0.0, unit, 1.0), 9)
    first = np.sort(np.unique(places, axis=0, return_index=True)[1])
    return replace(sight, q=sight.q[first], rest=sight.rest[first])


def _nearest(a: Array, b: Array) -> tuple[Ints, Ints, bool]:
    """Return pairs of rows that are mutually nearest, and whether they are the same poses."""
    from scipy.spatial import cKDTree  # slow to import, needed for several files only

    unit = np.ptp(np.concatenate([a, b]), axis=0)
    unit = np.where(unit > 0.0, unit, 1.0)
    one, two = cKDTree(a / unit), cKDTree(b / unit)
    distance, j = (np.asarray(v) for v in two.query(a / unit))
    back = np.asarray(one.query(b / unit)[1])
    mutual = back[j] == np.arange(len(a))
    apart = np.asarray(one.query(a / unit, k=2)[0])[:, -1]
    spacing = float(np.median(apart[np.isfinite(apart)])) if len(a) > 1 else 1.0
    i = np.flatnonzero(mutual)
    near = i.size >= 0.8 * max(len(a), len(b)) and bool(
        np.median(distance[i]) < SAME * max(spacing, 1e-12))
    return i, j[i].astype(np.int64), near
