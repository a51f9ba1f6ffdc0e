"""Columns of the evidence: an interface that leaves their storage to those who make them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Protocol

import numpy as np

from ppmcal.linalg import Array, Ints

KEPT = 2**23
"""Cached entries of columns: 64 MB."""


class ColumnSource(Protocol):
    """Columns (T) of n whitened values each."""

    @property
    def count(self) -> int:
        """Number of columns T."""

    def along(self, values: Array) -> Array:
        """Return the inner products (T, b) of all columns with values (n, b)."""

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) with these indices."""


@dataclass(frozen=True, eq=False)
class MatrixColumns:
    """Columns of a matrix (n, T)."""

    values: Array

    @property
    def count(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    def along(self, values: Array) -> Array:
        """Return the inner products (T, b) of all columns with values (n, b)."""
        return np.asarray(self.values.T @ values)

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) with these indices."""
        return self.values[:, list(which)]


@dataclass(frozen=True, eq=False)
class UnitColumns:
    """One unit column for each of n values: the columns of outlying rows."""

    count: int

    def along(self, values: Array) -> Array:
        """Return the inner products (n, b) of all columns with values (n, b)."""
        return values

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) with these indices."""
        out = np.zeros((self.count, len(which)))
        out[list(which), np.arange(len(which))] = 1.0
        return out


@dataclass(frozen=True, eq=False)
class JoinedColumns:
    """Columns of several sources, one after the other.

    The same columns are needed for each correlation in turn: up to ``KEPT`` entries are cached.
    """

    parts: tuple[ColumnSource, ...]
    _kept: dict[tuple[int, ...], Array] = field(default_factory=dict, repr=False)

    @property
    def starts(self) -> list[int]:
        """Index of the first column of each part, and finally the end."""
        return [0, *accumulate(p.count for p in self.parts)]

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.starts[-1]

    def along(self, values: Array) -> Array:
        """Return the inner products (T, b) of all columns with values (n, b)."""
        return np.concatenate([p.along(values) for p in self.parts])

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) with these indices."""
        key = tuple(which)
        if key not in self._kept:
            made = self._made(np.asarray(which, dtype=np.int64))
            if made.size + sum(own.size for own in self._kept.values()) > KEPT:
                self._kept.clear()
            self._kept[key] = made
        return self._kept[key]

    def _made(self, at: Ints) -> Array:
        """Return the columns (n, k) with these indices, read-only."""
        home = np.searchsorted(self.starts, at, side="right") - 1
        found = [(home == h, self.parts[h].some((at[home == h] - self.starts[h]).tolist()))
                 for h in np.unique(home).tolist()]
        out = np.empty((at.size, len(found[0][1]) if found else 0)).T     # column by column
        for mine, columns in found:
            out[:, mine] = columns
        out.flags.writeable = False
        return out
