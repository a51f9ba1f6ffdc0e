"""Linear algebra that several packages need: array types, ranges, rotations, rows in use.

Every solver and decomposition of the program is called here and nowhere else: any failure raises
:class:`ppmcal.errors.LinearAlgebraError`, which says what could not be computed and why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ppmcal.errors import LinearAlgebraError

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
LinAlgError = np.linalg.LinAlgError
"""NumPy's and SciPy's own error, for code that has to catch it."""


def finite_rows(rows: Array) -> Bools:
    """Return which rows of (N, m) are finite throughout (N,).

    >>> finite_rows(np.array([[1.0, 2.0], [np.nan, 3.0]])).tolist()
    [True, False]
    """
    return np.asarray(np.isfinite(rows).all(axis=1), dtype=np.bool_)


TOO_FAR = ("Look for values, sigmas and tolerances that are far too large or too small, and for a "
           "wrong unit")
TOO_FEW = "Look for poses that are all alike, or near a singularity of the machine"


def _not_finite(what: str) -> NoReturn:
    raise LinearAlgebraError(f"{what} could not be computed: an intermediate value is infinite or "
                             "not a number", hint=TOO_FAR)


def finite(what: str, *matrices: Array) -> None:
    """Reject matrices with entries that are not finite.

    Raises:
        LinearAlgebraError: naming ``what`` was to be computed.
    """
    for matrix in matrices:
        # the sum of squares is cheap, and finite only if all entries are
        if not math.isfinite(np.vdot(matrix, matrix)) and not np.isfinite(matrix).all():
            _not_finite(what)


@contextmanager
def guarded(what: str, why: str = "the matrix behind it is singular") -> Iterator[None]:
    """Turn the failure of a NumPy or SciPy decomposition in the block into this program's error.

    Args:
        what: the result wanted, such as "the inverse of a matrix".
        why: the reason for the failure.

    Raises:
        LinearAlgebraError: in place of NumPy's.
    """
    try:
        yield
    except np.linalg.LinAlgError:
        raise _lost(what, why) from None
    except ValueError as error:
        if "finite" not in str(error):
            raise
        _not_finite(what)


def _lost(what: str, why: str = "the matrix behind it is singular") -> LinearAlgebraError:
    return LinearAlgebraError(f"{what} could not be computed: {why}", hint=TOO_FEW)


# Each takes batches (..., m, n) like NumPy's own, rejects entries that are not finite, and raises
# LinearAlgebraError naming ``what`` was to be computed.


def solve(matrix: Array, right: Array, what: str = "the solution of linear equations") -> Array:
    """Return x of matrix (..., n, n) x = right, as :func:`numpy.linalg.solve`."""
    finite(what, matrix, right)
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        raise _lost(what) from None


def solve_lower(triangle: Array, right: Array, what: str = "the solution of linear equations"
                ) -> Array:
    """Return x of lower triangular matrices (..., n, n) x = right (..., n, m).

    >>> solve_lower(np.array([[2.0, 0.0], [1.0, 1.0]]), np.array([[2.0], [3.0]])).tolist()
    [[1.0], [2.0]]
    """
    from scipy.linalg.lapack import dtrtrs

    finite(what, triangle, right)
    out = np.zeros(right.shape)
    for at in np.ndindex(right.shape[:-2]) if right.size else ():
        out[at], singular = dtrtrs(triangle[at], right[at], lower=1)
        if singular:
            raise _lost(what)
    return out


def fading_sum(values: Array, factor: float) -> Array:
    """Return y (N, k) of values x (N, k): y_n = x_n + factor y_(n-1), a factor below 1.

    >>> fading_sum(np.array([[1.0], [0.0], [2.0]]), 0.5).ravel().tolist()
    [1.0, 0.5, 2.25]
    """
    from scipy.linalg import solve_banded

    band = np.repeat([[1.0], [-factor]], len(values), axis=1)
    with guarded("a fading sum"):
        return np.asarray(solve_banded((1, 0), band, values))


def solve_blocks(matrix: Array, right: Array) -> Array:
    """Solve (N, d, d) x = (N or 1, d, m) row by row.

    A row that is singular or not finite gives nan and no error.
    """
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        with np.errstate(invalid="ignore", over="ignore"):
            bad = ~(np.abs(np.linalg.det(matrix)) > 0.0)
        safe = np.where(bad[:, None, None], np.eye(matrix.shape[-1]), matrix)
        out = np.linalg.solve(safe, right)
        out[bad] = np.nan
        return np.asarray(out, dtype=float)


def determinant(matrix: Array) -> Array:
    """Return det (...) of (..., m, d); for tall matrices the product of the singular values.

    That has no sign: a tall matrix loses rank at isolated points, which any path can avoid.
    """
    if matrix.shape[-2] == matrix.shape[-1]:
        return np.asarray(np.linalg.det(matrix))
    with np.errstate(invalid="ignore"):
        square = np.linalg.det(np.swapaxes(matrix, -1, -2) @ matrix)
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def solve_rows(matrix: Array, right: Array) -> Array:
    """Solve (N, d, d) x = (N, d) row by row; see :func:`solve_blocks`."""
    return solve_blocks(matrix, right[..., None])[..., 0]


def inv(matrix: Array, what: str = "the inverse of a matrix") -> Array:
    """Return the inverse of (..., n, n)."""
    finite(what, matrix)
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        raise _lost(what) from None


def cholesky(matrix: Array, what: str = "the square root of a covariance") -> Array:
    """Return the lower factor L of (..., n, n) = L L^T."""
    finite(what, matrix)
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        raise _lost(what, "the covariance behind it is not positive definite") from None


def eigh(matrix: Array, what: str = "the principal directions of a matrix",
         metric: Array | None = None) -> tuple[Array, Array]:
    """Return eigenvalues (..., n), ascending, and vectors of a symmetric matrix (..., n, n).

    With a ``metric`` (n, n), positive definite, solve matrix v = w metric v, for one matrix.
    """
    finite(what, matrix, *(() if metric is None else (metric,)))
    with guarded(what):
        if metric is None:
            w, v = np.linalg.eigh(matrix)
        else:
            from scipy.linalg import eigh as general

            w, v = general(matrix, metric)
    return w, v


def tridiagonal(matrix: Array, along: Array, what: str = "the tridiagonal form of a matrix"
                ) -> tuple[Array, Array, Array]:
    """Tridiagonalise symmetric matrices (..., n, n), the first axis along vectors (..., n).

    Return diagonals (..., n), off-diagonals (..., n - 1), and lengths (...) of the vectors.
    """
    from scipy.linalg.lapack import dsytrd

    finite(what, matrix, along)
    length = np.sqrt(np.sum(along**2, axis=-1))
    mirror = along.copy()           # Householder reflection of the first axis into the vector
    mirror[..., 0] += np.copysign(length, along[..., 0])
    square = np.sum(mirror**2, axis=-1)
    mirror *= np.sqrt(2.0 * reciprocals(square))[..., None]
    across = (matrix @ mirror[..., None])[..., 0]
    across -= 0.5 * np.sum(across * mirror, axis=-1, keepdims=True) * mirror
    turned = matrix - across[..., :, None] * mirror[..., None, :]
    turned -= mirror[..., :, None] * across[..., None, :]
    size = matrix.shape[-1]
    diagonal, beside = np.empty(along.shape), np.empty((*length.shape, max(size - 1, 0)))
    for at in np.ndindex(length.shape):     # memory order does not matter: matrices are symmetric
        _, diagonal[at], beside[at], _, _ = dsytrd(turned[at].T, lower=1, overwrite_a=1)
    return diagonal, beside, length


def eigvalsh(matrix: Array, what: str = "the principal sizes of a matrix") -> Array:
    """Return the eigenvalues (..., n), ascending, of a symmetric matrix (..., n, n)."""
    finite(what, matrix)
    with guarded(what, "its iteration does not converge"):
        return np.asarray(np.linalg.eigvalsh(matrix))


def triangle(matrix: Array, what: str = "the triangle of a matrix") -> Array:
    """Return R (..., k, n) of the QR decomposition of (..., m, n)."""
    finite(what, matrix)
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def column_basis(matrix: Array, what: str = "the triangle of a matrix") -> Array:
    """Return Q (..., m, k) of the QR decomposition of (..., m, n)."""
    finite(what, matrix)
    return np.asarray(np.linalg.qr(matrix)[0])


def svd(matrix: Array, full: bool = False, what: str = "the singular values of a matrix"
        ) -> tuple[Array, Array, Array]:
    """Return the thin (or ``full``) singular value decomposition u, s, vt of (..., m, n).

    LAPACK's fast divide and conquer occasionally fails to converge on a sound matrix with many
    equal singular values; QR iteration then takes over.
    """
    finite(what, matrix)
    try:
        u, s, vt = np.linalg.svd(matrix, full_matrices=full)
    except np.linalg.LinAlgError:
        u, s, vt = _svd_by_qr(matrix, full, what)
    return u, s, vt


def _svd_by_qr(matrix: Array, full: bool, what: str) -> tuple[Array, Array, Array]:
    from scipy.linalg import svd as by_qr

    flat = matrix.reshape(-1, *matrix.shape[-2:])
    with guarded(what, "its iteration does not converge"):
        parts = [by_qr(one, full_matrices=full, lapack_driver="gesvd") for one in flat]
    u, s, vt = (np.stack(p).reshape(*matrix.shape[:-2], *p[0].shape)
                for p in zip(*parts, strict=True))
    return u, s, vt


def singular_values(matrix: Array, what: str = "the singular values of a matrix") -> Array:
    """Return the singular values (..., k), descending, of (..., m, n)."""
    finite(what, matrix)
    try:
        return np.asarray(np.linalg.svd(matrix, compute_uv=False))
    except np.linalg.LinAlgError:
        return _svd_by_qr(matrix, False, what)[1]


def largest_singular(matrix: Array) -> float:
    """Return the largest singular value of a matrix (m, n), 0 where it is empty."""
    return float(singular_values(matrix).max(initial=0.0)) if matrix.size else 0.0


def condition(matrix: Array) -> float:
    """Return largest over smallest singular value of (m, n), inf where it is singular."""
    s = singular_values(matrix)
    return float(s[0] / s[-1]) if s[-1] > 0.0 else math.inf


def pinv(matrix: Array, rcond: float = 1e-15, hermitian: bool = False,
         what: str = "the pseudo-inverse of a matrix") -> Array:
    """Return the pseudo-inverse (..., n, m) of (..., m, n).

    Singular values below ``rcond`` times the largest count as 0.
    """
    finite(what, matrix)
    try:
        return np.asarray(np.linalg.pinv(matrix, rcond, hermitian))
    except np.linalg.LinAlgError:
        u, s, vt = _svd_by_qr(matrix, False, what)
        use = s > rcond * s.max(axis=-1, keepdims=True, initial=0.0)
        inverse = reciprocals(np.where(use, s, 0.0))
        return np.asarray(np.swapaxes(vt, -1, -2) @ (inverse[..., None] * np.swapaxes(u, -1, -2)))


def lstsq(matrix: Array, right: Array, rcond: float | None = None,
          what: str = "the solution of a least-squares problem") -> tuple[Array, int]:
    """Return the minimum-norm x (n,) or (n, k) minimising |matrix (m, n) x - right|, and the rank.

    Singular values below ``rcond`` times the largest count as 0; default round-off.
    """
    finite(what, matrix, right)
    try:
        found, _, rank, _ = np.linalg.lstsq(matrix, right, rcond=rcond)
        return np.asarray(found, dtype=float), int(rank)
    except np.linalg.LinAlgError:
        least = np.finfo(float).eps * max(matrix.shape) if rcond is None else rcond
        s = _svd_by_qr(matrix, False, what)[1]
        return pinv(matrix, least, what=what) @ right, int(np.sum(s > least * s.max(initial=0.0)))


def reciprocals(values: Array, instead: float = 0.0) -> Array:
    """Return 1 over each value (...), ``instead`` where it is not above 0.

    Weights are 0 where nothing constrains a column, and so are tolerances where nothing moves.

    >>> reciprocals(np.array([2.0, 0.0])).tolist()
    [0.5, 0.0]
    """
    there = values > 0.0
    return np.where(there, 1.0 / np.where(there, values, 1.0), instead)


def unit_columns(matrix: Array) -> Array:
    """Return a matrix (m, n) with columns of length 1; zero columns stay zero."""
    return np.asarray(matrix / column_lengths(matrix))


def column_lengths(matrix: Array) -> Array:
    """Return the lengths (n,) of the columns of a matrix (m, n), 1 for zero columns."""
    norms = np.sqrt(np.einsum("nc,nc->c", matrix, matrix))
    return np.where(norms > 0.0, norms, 1.0)


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Return square blocks (k, k) along the diagonal of a matrix, zero elsewhere.

    >>> block_diagonal([np.eye(1), np.ones((2, 2))]).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]]
    """
    ends = np.cumsum([len(b) for b in blocks])
    out = np.zeros((ends[-1], ends[-1]))
    for block, end in zip(blocks, ends, strict=True):
        out[end - len(block):end, end - len(block):end] = block
    return out


def range_basis(matrix: Array, relative: float = 0.0, least: float = 0.0) -> Array:
    """Return an orthonormal basis (m, rank) of a matrix's columns (m, n).

    Directions with a singular value of at most ``relative`` times the largest, or at most
    ``least``, are left out.

    >>> range_basis(np.array([[1.0, 1.0], [1.0, 1.0]]), 1e-12).shape
    (2, 1)
    """
    if not matrix.shape[1]:
        return np.zeros((matrix.shape[0], 0))
    u, s, _ = svd(matrix)
    return np.asarray(u[:, (s > relative * s.max(initial=1e-300)) & (s > least)])


def without_range(block: Array, basis: Array) -> Array:
    """Return columns (m, c) without their part in the span of an orthonormal basis (m, r).

    Projected twice, so that the result is orthogonal to within round-off of the columns.
    """
    for _ in range(2):
        block = block - basis @ (basis.T @ block)
    return block


def nearest_rotation(matrix: Array, planar: bool = False) -> Array:
    """Return the proper rotations nearest to matrices (..., 3, 3), in the Frobenius norm (Kabsch).

    ``planar``: about z only.
    """
    if planar:
        angle = np.arctan2(matrix[..., 1, 0] - matrix[..., 0, 1],
                           matrix[..., 0, 0] + matrix[..., 1, 1])
        out = np.zeros((*angle.shape, 3, 3))
        out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
        out[..., 1, 0], out[..., 0, 1], out[..., 2, 2] = np.sin(angle), -np.sin(angle), 1.0
        return out
    u, _, vt = svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return np.asarray(u @ vt)


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
    """Return ``change(*rows)`` (N, ...), computed once where all rows share one in memory.

    >>> row_by_row(lambda a: 2.0 * a, np.broadcast_to(1.5, (4, 1))).strides[0]
    0
    """
    if any(len(r) < 2 or r.strides[0] != 0 for r in rows):
        return change(*rows)
    one = change(*(r[:1] for r in rows))
    return np.broadcast_to(one, (len(rows[0]), *one.shape[1:]))


def taken(rows: Array, keep: Ints | Bools) -> Array:
    """Return ``rows[keep]``; rows that share one in memory still do."""
    if len(rows) < 2 or rows.strides[0] != 0:
        return rows[keep]
    count = int(keep.sum()) if keep.dtype == np.bool_ else len(keep)
    return np.broadcast_to(rows[:1], (count, *rows.shape[1:]))


def logsumexp(values: ArrayLike, axis: int | tuple[int, ...] | None = None) -> Array:
    """Return the logarithm of the sum of exponentials, -inf for no values.

    Like SciPy's, whose call overhead exceeds most of the sums needed here.
    """
    x = np.asarray(values, dtype=float)
    top = np.max(x, axis=axis, keepdims=True, initial=-np.inf)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        out = np.log(np.sum(np.exp(x - top), axis=axis, keepdims=True)) + top
    return np.asarray(np.squeeze(out, axis=axis))
