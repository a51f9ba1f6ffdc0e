"""What the data can tell apart: scaled, deterministic rank analysis.

All decisions are made on the small triangular factor R of the whitened Jacobian, with
columns scaled by the parameters' tolerances: one unit is one tolerance. Open frames and
targets are projected out first, so they cost rank only where they imitate geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal.arrays import Array, svd

RANK_TOLERANCE = 1e-9
"""A column counts as dependent below this part of the largest column."""
TIE = 1e-6
"""Pivots closer than this (relative) are a tie: the first in file order wins."""


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


def analyse(triangle: Array, geometry: int, scale: Array, tolerance: float = RANK_TOLERANCE
            ) -> Rank:
    """Return the rank of the first ``geometry`` columns, the others projected out.

    Args:
        triangle: R of the whitened Jacobian (C, C) or taller.
        geometry: number of parameter columns F; the rest are open frames and targets.
        scale: one tolerance of each parameter (F,), SI.
        tolerance: columns below this part of the largest are dependent.
    """
    block = triangle[:, :geometry] * scale
    nuisance = triangle[:, geometry:]
    if nuisance.shape[1]:
        q, size = _range(nuisance, tolerance)
        block = block - q[:, :size] @ (q[:, :size].T @ block)
        block = block - q[:, :size] @ (q[:, :size].T @ block)
    singular = np.zeros(0)
    if geometry:
        singular = svd(block)[1]
    kept, dropped, r = pivoted(block, tolerance)
    size = len(kept)
    combination = np.zeros((0, len(dropped)))
    if size:
        combination = np.asarray(np.linalg.solve(r[:size, :size], r[:size, size:]))
    return Rank(tuple(kept), tuple(dropped), combination, r[:size, :size], singular)


def _range(columns: Array, tolerance: float) -> tuple[Array, int]:
    norms = np.linalg.norm(columns, axis=0)
    u, s, _ = svd(columns / np.where(norms > 0.0, norms, 1.0))
    return u, int(np.sum(s > tolerance * max(s[0], 1e-300))) if s.size else 0


def pivoted(block: Array, tolerance: float) -> tuple[list[int], list[int], Array]:
    """Pivoted QR by Householder steps, ties broken by file order.

    Returns:
        kept columns, dropped columns, and R (rows, F) with columns in that order.
    """
    work = np.array(block, dtype=float)
    rows, count = work.shape
    order = list(range(count))
    largest = float(np.max(np.linalg.norm(work, axis=0))) if count and rows else 0.0
    size = 0
    while size < min(rows, count):
        norms = np.linalg.norm(work[size:, size:], axis=0)
        best = float(norms.max())
        if best <= tolerance * largest or best == 0.0:
            break
        ties = [j for j in range(norms.size) if norms[j] >= best * (1.0 - TIE)]
        pick = size + min(ties, key=lambda j: order[size + j])
        work[:, [size, pick]] = work[:, [pick, size]]
        order[size], order[pick] = order[pick], order[size]
        v = work[size:, size].copy()
        v[0] += np.copysign(np.linalg.norm(v), v[0])
        v /= np.linalg.norm(v)
        work[size:, size:] -= 2.0 * np.outer(v, v @ work[size:, size:])
        size += 1
    tail = sorted(range(size, count), key=lambda j: order[j])
    arranged = list(range(size)) + tail
    return order[:size], [order[j] for j in tail], work[:, arranged]


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
