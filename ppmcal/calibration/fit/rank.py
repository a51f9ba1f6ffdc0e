"""Which columns the data can determine: scaled, deterministic rank analysis.

All decisions are made on the small triangular factor R of the whitened Jacobian, with
columns scaled by the parameters' tolerances: one unit is one tolerance. Open frames and
targets are projected out first, so they cost rank only where they are confounded with geometry.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Array, range_basis, svd, unit_columns, without_range

RANK_TOLERANCE = 1e-9
"""A column counts as dependent below this part of the largest column."""
ROUND_OFF = 1e-13
"""Columns whose part outside of open frames and targets is below this are round-off."""
TIE = 1e-6
"""Pivots closer than this (relative) are a tie: the first by name wins."""
TAKES_PART = 1e-6
"""A column takes part in a combination if above this part of its strongest column."""
COORDINATE = re.compile(
    r"(\.point|\.center)\.(?:[xyz]|radius|angle)$|(\.direction|\.axis)\.r[xyz]$")
"""Coordinates of a point or a direction, which depend on the frame that they are written in."""


@dataclass(frozen=True)
class Rank:
    """Rank of the geometry block.

    Attributes:
        kept: columns that are independent, in pivot order (r,).
        dropped: columns that the kept ones explain.
        combination: dropped ~ kept @ combination, in scaled units (r, len(dropped)).
        factor: triangular factor of the kept columns (r, r), nuisance projected out.
        singular: singular values of the whole projected block, descending.
    """

    kept: tuple[int, ...]
    dropped: tuple[int, ...]
    combination: Array
    factor: Array
    singular: Array


def analyse(triangle: Array, geometry: int, scale: Array, tolerance: float = RANK_TOLERANCE,
            names: Sequence[str] = ()) -> Rank:
    """Return the rank of the first ``geometry`` columns, the others projected out.

    Args:
        triangle: R of the whitened Jacobian (C, C) or taller.
        geometry: number of parameter columns F; the rest are open frames and targets.
        scale: one tolerance of each parameter (F,), SI.
        tolerance: columns below this part of the largest are dependent.
        names: of the columns (F,), so that ties do not depend on the order of limbs in a file.
    """
    block = triangle[:, :geometry] * scale
    least = ROUND_OFF * float(np.linalg.norm(block, axis=0).max(initial=0.0))
    nuisance = triangle[:, geometry:]
    if nuisance.shape[1]:
        block = without_range(block, range_basis(unit_columns(nuisance), tolerance))
    singular = np.zeros(0)
    if geometry:
        singular = svd(block)[1]
    kept, dropped, r = pivoted(block, tolerance, names, least)
    size = len(kept)
    combination = np.zeros((0, len(dropped)))
    if size:
        combination = linalg.solve(r[:size, :size], r[:size, size:])
    return Rank(tuple(kept), tuple(dropped), combination, r[:size, :size], singular)


def whole_rank(triangle: Array, geometry: int, scale: Array, tolerance: float = RANK_TOLERANCE,
               names: Sequence[str] = ()) -> tuple[Rank, list[int], list[int]]:
    """Return the geometry's rank, and of all columns those kept and those that others explain.

    This is the redundancy that `check` predicts and `identify` reports: open frames and targets add
    no rank where geometry is confounded with them, and are judged among themselves. Arguments as of
    :func:`analyse`, but ``scale`` (C,) and ``names`` for all columns.
    """
    rank = analyse(triangle, geometry, scale[:geometry], tolerance, names[:geometry])
    kept, dropped = list(rank.kept), list(rank.dropped)
    if triangle.shape[1] > geometry:
        nuisance = triangle[:, geometry:]
        among = analyse(nuisance, nuisance.shape[1], scale[geometry:],
                        names=names[geometry:])
        kept += [geometry + c for c in among.kept]
        dropped += [geometry + c for c in among.dropped]
    return rank, kept, dropped


def pivoted(block: Array, tolerance: float, names: Sequence[str] = (), least: float = 0.0
            ) -> tuple[list[int], list[int], Array]:
    """Pivoted QR by Householder steps, ties broken by :func:`by_name`, or by order without names.

    Columns below ``tolerance`` of the largest, or below ``least``, are dependent.

    Returns:
        kept columns, dropped columns, and R (rows, F) with columns in that order.
    """
    work = np.array(block, dtype=float)
    rows, count = work.shape
    order = list(range(count))
    turn = by_name(names[:count]) if names else order
    largest = float(np.max(np.linalg.norm(work, axis=0))) if count and rows else 0.0
    size = 0
    while size < min(rows, count):
        norms = np.linalg.norm(work[size:, size:], axis=0)
        best = float(norms.max())
        if best <= max(tolerance * largest, least) or best == 0.0:
            break
        ties = [j for j in range(norms.size) if norms[j] >= best * (1.0 - TIE)]
        pick = size + min(ties, key=lambda j: turn[order[size + j]])
        work[:, [size, pick]] = work[:, [pick, size]]
        order[size], order[pick] = order[pick], order[size]
        v = work[size:, size].copy()
        v[0] += np.copysign(np.linalg.norm(v), v[0])
        v /= np.linalg.norm(v)
        work[size:, size:] -= 2.0 * np.outer(v, v @ work[size:, size:])
        size += 1
    tail = sorted(range(size, count), key=lambda j: turn[order[j]])
    arranged = list(range(size)) + tail
    return order[:size], [order[j] for j in tail], work[:, arranged]


def by_name(names: Sequence[str]) -> list[int]:
    """Return the rank of each name with limbs sorted (leg2 before leg10), their slots unsorted.

    >>> by_name(["leg10.offset", "leg2.offset", "leg2.length"])
    [2, 0, 1]
    """
    def limb(i: int) -> list[tuple[bool, int, str]]:
        # words come after numbers
        return [(not part.isdigit(), int(part) if part.isdigit() else 0, part)
                for part in re.split(r"(\d+)", names[i].partition(".")[0])]

    place = [0] * len(names)
    for turn, i in enumerate(sorted(range(len(names)), key=limb)):
        place[i] = turn
    return place


@dataclass(frozen=True)
class Unidentifiable:
    """Parameters that the data determine only in combination.

    Attributes:
        combinations: number of their combinations that change nothing measured.
        slots: paths without coordinates, such as ``leg1.base.point``, sorted by name.
        parameters: all of their columns that take part, sorted by name.
        limbs: those of the machine's ``of_limbs`` that they belong to, once they are set.
        unseen: whether nothing in these slots has any effect.
    """

    combinations: int
    slots: tuple[str, ...]
    parameters: tuple[str, ...]
    limbs: tuple[str, ...] = ()
    of_limbs: int = 0
    unseen: bool = False


def slot_of(name: str) -> str:
    """Return a parameter's path without the coordinate of a point or of a direction.

    >>> slot_of("leg1.base.point.x"), slot_of("leg1.joint1.rz")
    ('leg1.base.point', 'leg1.joint1.rz')
    """
    return COORDINATE.sub(lambda m: m[1] or m[2], name)


def unidentifiable(rank: Rank, names: Sequence[str]) -> tuple[Unidentifiable, ...]:
    """Return the combinations that the data cannot resolve, as sets independent of the basis.

    Columns belong together if they appear in one dependence. Unlike the column that a pivoted
    QR happens to drop, these sets depend neither on the order of limbs and columns nor on units:
    they are the connected components of the null space, in any basis. Points and directions
    count as wholes, so that they do not depend on the base frame's axes either.

    Args:
        rank: of the geometry's columns.
        names: of these columns (F,).
    """
    parent: dict[str, str] = {}

    def root(slot: str) -> str:
        while parent.setdefault(slot, slot) != slot:
            slot = parent[slot]
        return slot

    used = set(rank.dropped)
    length = np.linalg.norm(rank.factor, axis=0)
    largest = float(length.max(initial=0.0))
    for d, share in zip(rank.dropped, (np.abs(rank.combination) * length[:, None]).T, strict=True):
        # a column without effect is round-off of all the others and belongs to none
        strongest = max(float(share.max(initial=0.0)), 10.0 * RANK_TOLERANCE * largest / TAKES_PART)
        part = np.flatnonzero(share > TAKES_PART * strongest)
        for k in part.tolist():
            used.add(rank.kept[k])
            parent[root(slot_of(names[rank.kept[k]]))] = root(slot_of(names[d]))
    groups: dict[str, list[int]] = {}
    place = by_name(names)
    for c in sorted(used, key=lambda c: place[c]):
        groups.setdefault(root(slot_of(names[c])), []).append(c)
    out = []
    for group in groups.values():
        slots = tuple(dict.fromkeys(slot_of(names[c]) for c in group))
        count = sum(c in rank.dropped for c in group)
        whole = sum(slot_of(names[c]) in slots for c in (*rank.kept, *rank.dropped))
        out.append(Unidentifiable(count, slots, tuple(names[c] for c in group),
                                  unseen=count == whole))
    return tuple(out)


def observability(singular: Array, rank: int, poses: int) -> dict[str, float]:
    """Return the observability indices O1 to O5 of the identifiable part.

    O1 = (s1...sp)^(1/p)/sqrt(N) (Borm and Menq), O2 = sp/s1 (Driels and Pathre), O3 = sp
    (Nahvi et al.), O4 = sp^2/s1 (Nahvi and Hollerbach), O5 = 1/sum(1/s) (Sun and
    Hollerbach); s in tolerances per standard deviation.
    """
    s = singular[:rank]
    if not s.size:
        return {f"O{i}": 0.0 for i in range(1, 6)}
    return {"O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(max(poses, 1))),
            "O2": float(s[-1] / s[0]), "O3": float(s[-1]), "O4": float(s[-1] ** 2 / s[0]),
            "O5": float(1.0 / np.sum(1.0 / s))}
