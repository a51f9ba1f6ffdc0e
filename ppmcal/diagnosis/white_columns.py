"""The columns of a library as its tests need them: whitened, of unit length, free of the geometry.

There may be thousands for thousands of rows. They are not kept: inner products with all of them go
by what they are made of (:mod:`ppmcal.diagnosis.library_columns`), and a few are made when they
are asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ppmcal.diagnosis.library_columns import Products
from ppmcal.diagnosis.linear_system import TOGETHER, System, Whitening
from ppmcal.linalg import Array, column_lengths

FEW, KEPT = 32, 2**23
"""Columns that are asked for so few at a time are kept, so many numbers of them."""
BLOCK = 256


@dataclass(frozen=True, eq=False)
class WhiteColumns:
    """Columns of a library, see :class:`ppmcal.diagnosis.added_variable_test.ProjectedColumns`.

    ``length`` (T,): of the whitened columns; ``hidden`` (r, T): what the geometry, with the basis
    (n, r), has of them at unit length.
    """

    products: Products
    noise: Whitening
    system: System
    basis: Array
    length: Array
    hidden: Array
    kept: dict[int, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, products: Products, noise: Whitening, system: System, basis: Array) -> WhiteColumns:
        """Return the columns of a library over a geometry with a whitened basis (n, r)."""
        total = products.shape[0]
        length, hidden = np.ones(total), np.zeros((total, basis.shape[1]))
        step = max(1, TOGETHER // len(basis))
        for begin in range(0, total, step):
            some = range(begin, min(begin + step, total))
            block = noise.apply(products.some(some), system)
            length[begin:some.stop] = column_lengths(block)
            hidden[begin:some.stop] = block.T @ basis / length[begin:some.stop, None]
        return cls(products, noise, system, basis, length, hidden.T)

    def __len__(self) -> int:
        """How many there are."""
        return len(self.length)

    def some(self, which: Sequence[int]) -> Array:
        """Return some of them, no two the same (k, n)."""
        if not 0 < len(which) <= FEW:
            return self._made(which)
        new = [c for c in which if c not in self.kept]
        if new:
            if len(self.kept) * len(self.basis) > KEPT:
                self.kept.clear()
                new = list(which)
            self.kept.update(zip(new, self._made(new), strict=True))
        return np.array([self.kept[c] for c in which])

    def _made(self, which: Sequence[int]) -> Array:
        at = list(which)
        out = self.noise.apply(self.products.some(at), self.system).T
        out /= self.length[at, None]
        out -= self.hidden[:, at].T @ self.basis.T
        return out

    def along(self, values: Array, out: Array | None = None) -> Array:
        """Return the inner products (T, b) of all of them with values (n, b)."""
        across = self.basis.T @ values
        out = self.products.along(self.noise.transposed(values, self.system), out)
        for begin in range(0, len(self), BLOCK):
            some = slice(begin, begin + BLOCK)
            out[some] /= self.length[some, None]
            out[some] -= self.hidden[:, some].T @ across
        return out
