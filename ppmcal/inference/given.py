"""Rows and columns given the blocks that are taken: "past the geometry" and "given these"."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.inference.columns import ColumnSource, MatrixColumns
from ppmcal.inference.priors import NOISE_FREEDOM
from ppmcal.linalg import Array


@dataclass(frozen=True, eq=False)
class Conditioned:
    """White values y (n,) and columns C (n, T) where Gaussian blocks Z (n, r) are taken.

    A block's coefficients are standard normal in units of the noise, so that y has the covariance
    I + Z Z' before the noise's scale; its inverse is M = I - W W'.

    Attributes:
        columns: all columns that can be asked for.
        values: y. count: how many of them were measured, n. basis: W (n, r).
        seen: C'W (T, r). right: C'My (T,).
        rest: y'My. log_det: half the logarithm of the determinant of I + Z Z'.
        known: values that the stated noise is as good as, the degrees of freedom of its prior.
    """

    columns: ColumnSource
    values: Array
    count: int
    basis: Array
    seen: Array
    right: Array
    rest: float
    log_det: float
    known: float = float(NOISE_FREEDOM)

    @classmethod
    def nothing(cls, columns: ColumnSource, values: Array, count: int | None = None,
                known: float = float(NOISE_FREEDOM)) -> Conditioned:
        """Return values (n,) and columns with no block taken.

        ``count``: of the values that were measured, the others are zero here and in all columns.
        ``known``: of the noise.

        Raises:
            LinearAlgebraError: if values or columns hold anything but numbers.
        """
        along, square = columns.along(values[:, None])[:, 0], np.vdot(values, values)
        linalg.finite("what values say of their causes", along, np.asarray(square))
        return cls(columns, values, values.size if count is None else count,
                   np.zeros((values.size, 0)), np.zeros((columns.count, 0)), along,
                   float(square), 0.0, known)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the noise's posterior: the prior's and the values'."""
        return self.known + self.count

    @property
    def spread(self) -> float:
        """Sum of squares behind the noise's posterior, the prior's with it."""
        return self.known + self.rest

    @property
    def log_evidence(self) -> float:
        """Logarithm of the values' density, up to what depends on their number alone."""
        return -self.log_det - 0.5 * self.freedom * float(np.log(self.spread))

    def condensed(self, columns: Array) -> Conditioned:
        """Return what the values say of other columns (n, T) alone, in no more than T + 1 rows."""
        seen = columns.T @ self.basis
        gram = columns.T @ columns
        right = columns.T @ self.values - seen @ (self.basis.T @ self.values)
        scale = np.append(np.sqrt(np.diagonal(gram)), np.sqrt(self.rest))
        scale[scale == 0.0] = 1.0
        whole = np.block([[gram - seen @ seen.T, right[:, None]],
                          [right[None, :], np.array([[self.rest]])]]) / np.outer(scale, scale)
        own, turn = linalg.eigh(whole)
        rows = (np.sqrt(np.maximum(own, 0.0)) * turn).T * scale
        return replace(self, columns=MatrixColumns(rows[:, :-1]), values=rows[:, -1],
                       basis=np.zeros((len(rows), 0)), seen=np.zeros((len(right), 0)), right=right)

    def taking(self, block: Array) -> Conditioned:
        """Return this with a block Z (n, k) more: its columns times the root of its prior.

        Raises:
            LinearAlgebraError: if the block, or its square, holds anything but numbers.
        """
        if block.shape[1] == 0:
            return self
        if self.basis.shape[1] == 0:    # a first block may be wide: its square would lose digits
            left, size, _ = linalg.svd(block)
            own = size**2
            linalg.finite("the size of a block", own)
            new = left * (size / np.sqrt(1.0 + own))
        else:
            inside = block - self.basis @ (self.basis.T @ block)
            own, turn = linalg.eigh(block.T @ inside)
            own = np.maximum(own, 0.0)
            new = inside @ (turn / np.sqrt(1.0 + own))
        gone = new.T @ self.values
        rest = max(self.rest - float(gone @ gone), 0.0)
        if self.basis.shape[1] == 0:    # |My|^2 + |Z'My|^2, which loses none either
            past = self.values - new @ gone
            rest = float(past @ past + np.sum(gone**2 / (1.0 + own)))
        more = self.columns.along(new)
        return Conditioned(self.columns, self.values, self.count, np.hstack([self.basis, new]),
                     np.hstack([self.seen, more]), self.right - more @ gone, rest,
                     self.log_det + 0.5 * float(np.sum(np.log1p(own))), self.known)
