"""Inner products of the projected columns: every test is a small solve on them.

With J the geometry, M = I - QQ^T and Q a basis of J's range, the added-variable test of
columns C on the residual r needs only G = C^T M C, b = C^T M r and |M r|^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import betainc, betaln

from ppmcal.linalg import Array, Ints, column_lengths, unit_columns

VISIBLE = 1e-8
"""Squared length left of a column, over its own, below which the geometry swallows it."""
TINY = 1e-200


@dataclass(frozen=True, eq=False)
class AddedVariableTest:
    """Tests for T columns.

    Attributes:
        gram: C^T M C (T, T) and right: C^T M r (T,) of columns scaled to unit length.
        length: their length (T,) before M: a coefficient is right/gram/length.
        square: |M r|^2; freedom: n - rank J.
        hidden: Q^T C (r, T), the part that geometry swallows.
        null: C^T M z of simulated noise (T, B), and null_square (B,).
        taken: columns that are in the model; back: C^T M C_taken times their inverse (T, s).
    """

    gram: Array
    right: Array
    length: Array
    square: float
    freedom: int
    hidden: Array
    null: Array
    null_square: Array
    taken: tuple[int, ...] = ()
    back: Array | None = None

    def given(self, chosen: Sequence[int]) -> AddedVariableTest:
        """Return the tests that are left when the columns ``chosen`` are in the model.

        The simulated noise is not carried along: thresholds are made once, at the start.
        """
        if not chosen:
            return self
        s = list(chosen)
        inverse = pseudo_inverse(self.gram[np.ix_(s, s)])
        back = self.gram[:, s] @ inverse
        rank = int(np.round(np.trace(inverse @ self.gram[np.ix_(s, s)])))
        return replace(
            self, right=self.right - back @ self.right[s], square=self.left(s),
            freedom=self.freedom - rank, null=self.null[:, :0],
            null_square=self.null_square[:0], taken=tuple(s), back=back)

    def block(self, rows: Ints, columns: Ints) -> Array:
        """Return C^T M C between columns (..., a) and (..., b), the chosen ones taken out."""
        found = self.gram[rows[..., :, None], columns[..., None, :]]
        if self.back is None:
            return found
        across = self.gram[np.array(self.taken)[:, None], columns[..., None, :]]
        return np.asarray(found - self.back[rows] @ across)

    def left(self, chosen: Sequence[int]) -> float:
        """Return |M r|^2 with the columns ``chosen`` in the model."""
        s = list(chosen)
        if not s:
            return self.square
        inverse = pseudo_inverse(self.gram[np.ix_(s, s)])
        return self.square - float(self.right[s] @ inverse @ self.right[s])

    def extended(self, weights: Array) -> AddedVariableTest:
        """Return the tests with further columns: combinations C ``weights`` (T, E).

        The simulated noise is not carried along.
        """
        w = weights * self.length[:, None]
        norm = np.sqrt(np.sum(w * (self.gram @ w), axis=0) + np.sum((self.hidden @ w)**2, axis=0))
        unit = w / norm
        cross = self.gram @ unit
        gram = np.block([[self.gram, cross], [cross.T, unit.T @ cross]])
        return replace(self, gram=gram, right=np.append(self.right, unit.T @ self.right),
                       length=np.append(self.length, norm),
                       hidden=np.concatenate([self.hidden, self.hidden @ unit], axis=1),
                       null=np.zeros((len(gram), 0)), null_square=self.null_square[:0])

    def fit(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return coefficients of the columns ``chosen`` and their covariance, SI."""
        s = list(chosen)
        inverse = pseudo_inverse(self.gram[np.ix_(s, s)])
        left = self.square - float(self.right[s] @ inverse @ self.right[s])
        variance = max(left, 0.0) / max(self.freedom - len(s), 1)
        scale = 1.0 / self.length[s]
        return inverse @ self.right[s] * scale, inverse * variance * np.outer(scale, scale)

    def survival(self, chosen: Sequence[int]) -> float:
        """Return which part of the columns' length the geometry leaves."""
        s = list(chosen)
        return float(np.sqrt(max(float(np.mean(np.diagonal(self.gram)[s])), 0.0)))

    def explained(self, groups: Ints, null: bool = False) -> tuple[Array, Ints]:
        """Return |P^T r|^2 of groups of columns (F, k), and the ranks (F,).

        With ``null`` of the simulated noise, (F, B).
        """
        blocks = self.block(groups, groups)
        w, v = np.linalg.eigh(blocks)
        use = w > VISIBLE
        root = np.where(use, 1.0 / np.sqrt(np.where(use, w, 1.0)), 0.0)
        right = self.null[groups] if null else self.right[groups][..., None]
        parts = root[..., None] * (np.swapaxes(v, -1, -2) @ right)
        square = np.sum(parts**2, axis=1)
        return (square if null else square[:, 0]), use.sum(axis=1)


def pseudo_inverse(block: Array) -> Array:
    """Return the inverse of a symmetric block, its invisible directions left out."""
    w, v = np.linalg.eigh(block)
    use = w > VISIBLE
    return np.asarray((v[:, use] / w[use]) @ v[:, use].T)


def build_test(
    basis: Array, columns: Array, residual: Array, count: int, noise: Array
) -> AddedVariableTest:
    """Return the tests of columns (n, T) on a residual (n,), J having the basis (n, r).

    ``count``: how many of the n values were measured, the others being zero everywhere;
    ``noise`` (n, B): simulated, for the thresholds.
    """
    unit, length = unit_columns(columns), column_lengths(columns)
    hidden = basis.T @ unit
    unit = unit - basis @ hidden
    across = basis.T @ noise
    clean = residual - basis @ (basis.T @ residual)
    return AddedVariableTest(unit.T @ unit, unit.T @ clean, length, float(clean @ clean),
                count - basis.shape[1], hidden, unit.T @ noise,
                np.sum(noise**2, axis=0) - np.sum(across**2, axis=0))


def probability(value: float) -> float:
    """Return the p-value of a log p, above 0 however small it is."""
    return float(np.exp(max(value, -740.0)))


def log_p(explained: Array, square: Array | float, size: Array | Ints | int, freedom: int) -> Array:
    """Return the log p-value of the F test (added variable), also where p underflows.

    R^2 = explained/square has a Beta(k/2, (nu - k)/2) distribution under the null. Columns
    that leave no freedom prove nothing: log p = 0.
    """
    a = np.asarray(size, dtype=float) / 2.0
    b = np.maximum(freedom / 2.0 - a, 0.5)
    x = np.clip(np.asarray(explained) / np.maximum(square, 1e-300), 0.0, 1.0 - 1e-15)
    safe = np.where(a > 0.0, a, 0.5)
    p = betainc(b, safe, 1.0 - x)
    with np.errstate(divide="ignore"):
        far = b * np.log1p(-x) + (safe - 1.0) * np.log(np.maximum(x, 1e-300)) - np.log(
            b) - betaln(safe, b)
        out = np.where(p > TINY, np.log(np.maximum(p, 1e-300)), np.minimum(far, np.log(TINY)))
    return np.asarray(np.where((a > 0.0) & (2.0 * a < freedom), out, 0.0), dtype=float)
