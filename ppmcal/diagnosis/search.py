"""Tests of a library of hypotheses, and the thresholds that noise alone sets them.

The library is searched, so thresholds are quantiles of the *smallest* p-value that noise
alone gives, simulated through the same projections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppmcal.diagnosis.added_variable_test import AddedVariableTest, Noise, log_p, squares_of
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.linalg import Array

DETECT, NAME = 0.03, 0.01
"""False alarms of the search. The tests of what is left have another 0.01; what remains of
0.05 is for noise that is not quite what was simulated."""
TOGETHER = 2**16
"""So many numbers of simulated noise are looked at together: what is in between stays in cache."""
Group = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Hypotheses with as many columns: their indices (f,) and columns (f, k)."""


@dataclass(frozen=True, eq=False)
class Search:
    """Tests and thresholds for a library of hypotheses.

    ``detect``, ``name``: log p below which something is there, and may be named; ``smallest``
    (B,) of noise.
    """

    test: AddedVariableTest
    hypotheses: tuple[Hypothesis, ...]
    detect: float
    name: float
    smallest: Array

    @cached_property
    def distinct(self) -> int:
        """How many there are, the constants of a grid not counted."""
        return len({(f.family, f.on, f.shared) for f in self.hypotheses})

    @cached_property
    def _groups(self) -> list[Group]:
        return by_size(self.hypotheses)

    @cached_property
    def _found(self) -> dict[tuple[int, ...], Array]:
        return {}

    def values(self, chosen: Sequence[int] = ()) -> Array:
        """Return the log p of every hypothesis (F,) with the hypotheses ``chosen`` in the model."""
        key = tuple(sorted(chosen))
        if key not in self._found:
            rest = self.test.given(columns_of(self, key))
            self._found[key] = _scanned(rest, self._groups, len(self.hypotheses)) / np.array(
                [f.caution for f in self.hypotheses])
            self._found[key].setflags(write=False)
        return self._found[key]

    def over_all(self, value: float) -> float:
        """Return the log of how often noise alone shows a log p as small as ``value`` somewhere.

        That is what is told: what is found has the smallest p of thousands. It is counted in the
        simulated noise as far as that reaches; beyond the threshold for names it falls as the p of
        one hypothesis does, as that of any number of them would.
        """
        if value <= self.name:
            return float(np.log(NAME) + value - self.name)
        if value <= self.detect:
            return float(np.interp(value, [self.name, self.detect], np.log([NAME, DETECT])))
        often = (np.sum(self.smallest <= value) + 1.0) / (self.smallest.size + 1.0)
        return float(np.log(max(often, DETECT)))


def by_size(hypotheses: Sequence[Hypothesis]) -> list[Group]:
    """Return the hypotheses in groups of equal size."""
    sizes = [f.size for f in hypotheses]
    groups = ([i for i, n in enumerate(sizes) if n == size] for size in dict.fromkeys(sizes))
    return [(np.array(g), np.array([hypotheses[i].columns for i in g])) for g in groups]


def scan(test: AddedVariableTest, hypotheses: Sequence[Hypothesis]) -> Array:
    """Return the log p of all hypotheses (F,), the model's columns being projected out already."""
    found = _scanned(test, by_size(hypotheses), len(hypotheses))
    return np.asarray(found / np.array([f.caution for f in hypotheses]))


def _scanned(test: AddedVariableTest, groups: Sequence[Group], count: int) -> Array:
    out = np.zeros(count)
    for which, columns in groups:
        square, rank = test.explained(columns)
        out[which] = log_p(square, test.square, rank, test.freedom)
    return out


def null_scan(test: AddedVariableTest, hypotheses: Sequence[Hypothesis], noise: Noise) -> Array:
    """Return the smallest log p over all hypotheses for each draw of noise (B,)."""
    groups = [(columns, *test.roots(columns)) for _, columns in by_size(hypotheses)]
    smallest = [np.zeros(0)]
    for right, total in noise:
        # of one rank the largest square has the smallest p
        largest: dict[int, Array] = {}
        for columns, roots, ranks in groups:
            step = max(1, TOGETHER // (columns.shape[1] * total.size))
            for begin in range(0, len(columns), step):
                some = slice(begin, begin + step)
                square = squares_of(roots[some], right[columns[some]])
                for rank in np.unique(ranks[some]).tolist():
                    most = square[ranks[some] == rank].max(axis=0)
                    largest[rank] = np.maximum(largest.get(rank, most), most)
        values = np.zeros(total.size)
        for rank, most in largest.items():
            values = np.minimum(values, log_p(most, total, rank, test.freedom))
        smallest.append(values)
    return np.concatenate(smallest)


def prepare(test: AddedVariableTest, hypotheses: Sequence[Hypothesis], noise: Noise = (),
            like: Search | None = None) -> Search:
    """Return the search with its thresholds from simulated noise, or those of ``like``."""
    if like is not None:
        return replace(like, test=test, hypotheses=tuple(hypotheses))
    smallest = null_scan(test, hypotheses, noise)
    # without freedom nothing can be shown, however small the smallest
    detect, name = np.minimum(np.quantile(smallest, [DETECT, NAME]), np.log([DETECT, NAME]))
    return Search(test, tuple(hypotheses), float(detect), float(name), smallest)


def columns_of(search: Search, chosen: Sequence[int]) -> list[int]:
    """Return the columns of chosen hypotheses, each once."""
    return list(dict.fromkeys(c for i in chosen for c in search.hypotheses[i].columns))
