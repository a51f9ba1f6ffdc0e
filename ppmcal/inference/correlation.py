"""Noise correlated from row to row: the same columns, whitened for each correlation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ppmcal.inference.columns import ColumnSource
from ppmcal.linalg import Array, Bools, Ints

BLOCK = 64
"""Columns processed at a time, to keep intermediate arrays small."""


@dataclass(frozen=True, eq=False)
class RowNoise:
    """First-order autoregressive noise of N rows of m coordinates, rho from each to the next.

    ``apart`` (N - 1,): rows from each to the next, 0 where another sequence begins; ``observed``
    (N, m). Values are flat (N m,), zero where not observed.
    """

    rho: float
    apart: Ints
    observed: Bools

    @cached_property
    def before(self) -> tuple[Ints, Array]:
        """The row where each value's coordinate was last observed, and the correlation with it.

        (N, m) each; 0 for a value without such a row, or not observed itself.
        """
        rows = np.arange(len(self.observed))
        last = np.maximum.accumulate(np.where(self.observed, rows[:, None], -1), axis=0)
        last = np.vstack([np.full((1, last.shape[1]), -1), last])[:len(rows)]
        place, sequence = (np.concatenate([[0], np.cumsum(steps)])[:len(rows)]
                           for steps in (self.apart, self.apart <= 0))
        tied = (last >= 0) & self.observed & (sequence[last] == sequence[:, None])
        far = np.where(tied, place[:, None] - place[last], 1)
        return np.maximum(last, 0), np.where(tied, self.rho**far, 0.0)

    @property
    def log_det(self) -> float:
        """Half the logarithm of the determinant of the correlation matrix."""
        return 0.5 * float(np.sum(np.log1p(-self.before[1]**2)))

    def apply(self, values: Array) -> Array:
        """Return columns (N m, k) whitened."""
        if not self.rho:
            return values
        last, tie = self.before
        own, root = np.arange(last.shape[1]), self.observed / np.sqrt(1.0 - tie**2)
        columns = values.T.reshape(-1, *self.observed.shape)
        out = np.empty(columns.shape)
        for some in range(0, len(out), BLOCK):
            part = columns[some:some + BLOCK]
            out[some:some + BLOCK] = (part - tie * part[:, last, own]) * root
        return out.reshape(values.T.shape).T

    def transposed(self, values: Array) -> Array:
        """Return values (N m, k) multiplied by the transpose of :meth:`apply`."""
        if not self.rho:
            return values
        last, tie = self.before
        out = values.reshape(*self.observed.shape, -1) * (
            self.observed / np.sqrt(1.0 - tie**2))[..., None]
        row, own = np.nonzero(tie)
        out[last[row, own], own] -= tie[row, own, None] * out[row, own]
        return np.asarray(out.reshape(values.shape))


@dataclass(frozen=True, eq=False)
class Whitened:
    """Columns whitened for correlated noise."""

    columns: ColumnSource
    noise: RowNoise

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.columns.count

    def along(self, values: Array) -> Array:
        """Return the inner products (T, b) of all columns with values (n, b)."""
        return self.columns.along(self.noise.transposed(values))

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) with these indices."""
        return self.noise.apply(self.columns.some(which))
