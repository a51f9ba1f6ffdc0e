"""Rows and columns conditioned on blocks: "past the geometry" and "given these"."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.inference.columns import ColumnSource, MatrixColumns
from ppmcal.inference.priors import NOISE_FREEDOM
from ppmcal.linalg import Array


@dataclass(frozen=True, eq=False)
class Conditioned:
    """White values y (n,) and columns C (n, T) conditioned on Gaussian blocks Z (n, r).

    A block's coefficients are standard normal in units of the noise, so that y has the covariance
    I + Z Z' up to the noise scale; its inverse is M = I - W W'.

    Attributes:
        columns: all columns available.
        values: y. count: number of measured values n. basis: W (n, r).
        seen: C'W (T, r). right: C'My (T,).
        rest: y'My. log_det: half the logarithm of the determinant of I + Z Z'.
        known: degrees of freedom of the prior of the stated noise.
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
        """Return values (n,) and columns conditioned on no block.

        ``count``: of measured values; the others are zero here and in all columns. ``known``: of
        the noise.

        Raises:
            LinearAlgebraError: values or columns are not finite.
        """
        along, square = columns.along(values[:, None])[:, 0], np.vdot(values, values)
        linalg.finite("the evidence for causes", along, np.asarray(square))
        return cls(columns, values, values.size if count is None else count,
                   np.zeros((values.size, 0)), np.zeros((columns.count, 0)), along,
                   float(square), 0.0, known)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the noise posterior: those of the prior and of the values."""
        return self.known + self.count

    @property
    def spread(self) -> float:
        """Sum of squares of the noise posterior, including that of the prior."""
        return self.known + self.rest

    @property
    def log_evidence(self) -> float:
        """Logarithm of the values' density, up to a term that depends only on their number."""
        return -self.log_det - 0.5 * self.freedom * float(np.log(self.spread))

    def condensed(self, columns: Array) -> Conditioned:
        """Return the data reduced to other columns (n, T), in at most T + 1 rows."""
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
        """Return this conditioned on one more block Z (n, k): its columns times its prior root.

        Raises:
            LinearAlgebraError: the block, or its square, is not finite.
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
        if self.basis.shape[1] == 0:    # |My|^2 + |Z'My|^2 loses no digits either
            past = self.values - new @ gone
            rest = float(past @ past + np.sum(gone**2 / (1.0 + own)))
        more = self.columns.along(new)
        return Conditioned(self.columns, self.values, self.count, np.hstack([self.basis, new]),
                     np.hstack([self.seen, more]), self.right - more @ gone, rest,
                     self.log_det + 0.5 * float(np.sum(np.log1p(own))), self.known)
