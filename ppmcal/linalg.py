"""Linear algebra that several packages need: array types, ranges, rotations, rows in use."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def finite_rows(rows: Array) -> Bools:
    """Return which rows of (N, m) hold a number everywhere (N,).

    >>> finite_rows(np.array([[1.0, 2.0], [np.nan, 3.0]])).tolist()
    [True, False]
    """
    return np.asarray(np.isfinite(rows).all(axis=1), dtype=np.bool_)


def svd(matrix: Array) -> tuple[Array, Array, Array]:
    """Return the thin singular value decomposition u, s, vt of a matrix (m, n).

    LAPACK's divide and conquer, which is fast, now and then does not converge on a sound matrix
    with many equal singular values; then by QR iteration, which does.
    """
    try:
        u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        from scipy.linalg import svd as by_qr

        u, s, vt = by_qr(matrix, full_matrices=False, lapack_driver="gesvd")
    return u, s, vt


def unit_columns(matrix: Array) -> Array:
    """Return a matrix (m, n) with columns of length 1; empty ones stay so."""
    return np.asarray(matrix / column_lengths(matrix))


def column_lengths(matrix: Array) -> Array:
    """Return the lengths (n,) of the columns of a matrix (m, n), 1 for empty ones."""
    norms = np.sqrt(np.einsum("nc,nc->c", matrix, matrix))
    return np.where(norms > 0.0, norms, 1.0)


def range_basis(matrix: Array, relative: float = 0.0, least: float = 0.0) -> Array:
    """Return an orthonormal basis (m, rank) of a matrix's columns (m, n).

    Directions are left out whose singular value is at most ``relative`` of the largest, or at
    most ``least``.

    >>> range_basis(np.array([[1.0, 1.0], [1.0, 1.0]]), 1e-12).shape
    (2, 1)
    """
    if not matrix.shape[1]:
        return np.zeros((matrix.shape[0], 0))
    u, s, _ = svd(matrix)
    return np.asarray(u[:, (s > relative * s.max(initial=1e-300)) & (s > least)])


def without_range(block: Array, basis: Array) -> Array:
    """Return columns (m, c) less their part in the span of an orthonormal basis (m, r).

    Twice, so that what is left is orthogonal to round-off of the columns themselves.
    """
    for _ in range(2):
        block = block - basis @ (basis.T @ block)
    return block


def nearest_rotation(matrix: Array) -> Array:
    """Return the proper rotation nearest to a matrix (3, 3), in the Frobenius norm (Kabsch)."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def subsample(keep: Sequence[Bools], most: int) -> list[Bools]:
    """Return masks with at most ``most`` rows in all, evenly spread."""
    total = sum(int(k.sum()) for k in keep)
    if total <= most:
        return list(keep)
    out = []
    for k in keep:
        rows = np.flatnonzero(k)
        count = min(rows.size, max(1, most * rows.size // total))
        mask = np.zeros_like(k)
        mask[rows[np.linspace(0, rows.size - 1, count).astype(int)]] = True
        out.append(mask)
    return out


def row_by_row(change: Callable[..., Array], *rows: Array) -> Array:
    """Return ``change(*rows)`` (N, ...), made once and kept as one of rows that are one in memory.

    >>> row_by_row(lambda a: 2.0 * a, np.broadcast_to(1.5, (4, 1))).strides[0]
    0
    """
    if any(len(r) < 2 or r.strides[0] != 0 for r in rows):
        return change(*rows)
    one = change(*(r[:1] for r in rows))
    return np.broadcast_to(one, (len(rows[0]), *one.shape[1:]))


def taken(rows: Array, keep: Ints | Bools) -> Array:
    """Return ``rows[keep]``; rows that are one in memory stay so."""
    if len(rows) < 2 or rows.strides[0] != 0:
        return rows[keep]
    count = int(keep.sum()) if keep.dtype == np.bool_ else len(keep)
    return np.broadcast_to(rows[:1], (count, *rows.shape[1:]))


def ways(q: Array) -> Array:
    """Return the direction from the row before (N, k), +-1; a joint at rest keeps its last.

    nan until a joint has moved for the first time; values that are missing are passed over.

    >>> ways(np.array([[1.0], [2.0], [np.nan], [2.0], [1.5]])).ravel().tolist()
    [nan, 1.0, 1.0, 1.0, -1.0]
    """
    if not len(q):
        return np.array(q)
    rows = np.arange(len(q))[:, None]
    known = np.isfinite(q)
    seen = np.maximum.accumulate(np.where(known, rows, -1), axis=0)
    before = np.concatenate([np.full((1, q.shape[1]), -1), seen])[:len(q)]
    start = np.take_along_axis(q, np.maximum(before, 0), axis=0)
    move = np.where(known & (before >= 0), np.sign(np.where(known, q, 0.0) - start), 0.0)
    last = np.maximum.accumulate(np.where(move != 0.0, rows, -1), axis=0)
    found = np.take_along_axis(move, np.maximum(last, 0), axis=0)
    return np.where(last >= 0, found, np.nan)
