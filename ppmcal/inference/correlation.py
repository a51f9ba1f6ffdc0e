"""Noise that is correlated from row to row: the same columns, white for each correlation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.inference.columns import ColumnSource
from ppmcal.linalg import Array, Bools, Ints

BLOCK = 64
"""Columns that are worked on at a time: what is in between stays small."""


@dataclass(frozen=True, eq=False)
class RowNoise:
    """First-order autoregressive noise of N rows of m coordinates, rho from each to the next.

    ``apart`` (N - 1,): rows from each to the next, 0 where another sequence begins; ``observed``
    (N, m). Values are flat (N m,), zero where nothing was observed.
    """

    rho: float
    apart: Ints
    observed: Bools

    @property
    def tie(self) -> Array:
        """Correlation of each row with the one before (N - 1, 1)."""
        return np.asarray(np.where(self.apart > 0, self.rho ** np.maximum(self.apart, 1), 0.0)
                          [:, None])

    @property
    def log_det(self) -> float:
        """Half the logarithm of the determinant of the correlation matrix."""
        used = self.observed[1:] & self.observed[:-1]
        return 0.5 * float(np.sum(np.log1p(-self.tie**2) * used))

    def apply(self, values: Array) -> Array:
        """Return columns (N m, k) whitened."""
        if not self.rho:
            return values
        rows, tie = self.observed.shape, self.tie[..., None]
        out = values.reshape(*rows, -1).copy()
        root = np.sqrt(1.0 - tie**2)
        before = values.reshape(*rows, -1)
        for some in range(0, out.shape[2], BLOCK):
            at = slice(some, some + BLOCK)
            out[1:, :, at] = (before[1:, :, at] - tie * before[:-1, :, at]) / root
        return np.asarray((out * self.observed[..., None]).reshape(values.shape))

    def transposed(self, values: Array) -> Array:
        """Return values (N m, k) times the transpose of what :meth:`apply` does."""
        if not self.rho:
            return values
        tie = self.tie[..., None]
        out = values.reshape(*self.observed.shape, -1) * self.observed[..., None]
        out[1:] /= np.sqrt(1.0 - tie**2)
        out[:-1] -= tie * out[1:]
        return np.asarray(out.reshape(values.shape))


@dataclass(frozen=True, eq=False)
class Whitened:
    """Columns as they are where noise is correlated."""

    columns: ColumnSource
    noise: RowNoise

    @property
    def count(self) -> int:
        """How many columns there are."""
        return self.columns.count

    def along(self, values: Array) -> Array:
        """Return the inner products (T, b) of all columns with values (n, b)."""
        return self.columns.along(self.noise.transposed(values))

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) of these numbers."""
        return self.noise.apply(self.columns.some(which))
