"""The columns of a library: specified one by one, computed together.

A column is stored as its shifts, as another column restricted to some rows, or as a sum of others.
The response to a slot is computed once; columns differing only by its shift are one product.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ppmcal.diagnosis.linear_system import BLOCK, System
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.effects import Shift


def only_slots(shift: Shift) -> bool:
    """Whether a shift moves only slots of limbs."""
    return not shift.targets and all(
        v is None for v in (shift.pose, shift.stretch, shift.frame, shift.target))


FEW = 4
"""Fewest columns of one slot for which a product pays."""


@dataclass(frozen=True, eq=False)
class Outer:
    """Columns ``at`` (F,) that are ``unit`` (N, m) times ``change`` (F, N)."""

    at: Ints
    change: Array
    unit: Array


@dataclass(frozen=True, eq=False)
class Products:
    """Columns (T,) of N rows and m coordinates, in factored form.

    ``whole``: indices of columns stored in full, and ``given`` (W, N, m) their values; ``outer``:
    columns that are products, which makes inner products with them cheap; ``sums``: columns that
    are sums of others.
    """

    shape: tuple[int, int, int]
    whole: Ints
    given: Array
    outer: tuple[Outer, ...]
    sums: dict[int, Sequence[int]]

    def some(self, which: Sequence[int]) -> Array:
        """Return some columns (N, m, k), each contiguous in memory; repeats are allowed."""
        sums = {n: self.sums[t] for n, t in enumerate(which) if t in self.sums}
        need = [*which, *{c for own in sums.values() for c in own}.difference(which)]
        home, place = self._homes
        at, out = home[need], np.empty((len(need), *self.shape[1:]))
        for h in np.unique(at).tolist():
            own = np.flatnonzero(at == h)
            inside = place[np.take(need, own)]
            if h == len(self.outer):
                out[own] = self.given[inside]
            elif h >= 0:
                product = self.outer[h]
                out[own] = product.change[inside, :, None] * product.unit
        found = {c: n for n, c in enumerate(need)}
        for n, parts in sums.items():
            np.sum(out[[found[c] for c in parts]], axis=0, out=out[n])
        return np.moveaxis(out[:len(which)], 0, -1)

    @cached_property
    def _homes(self) -> tuple[Ints, Ints]:
        """By column (T,): number of its product, or one past the last; its index there."""
        home, place = np.full(self.shape[0], -1), np.zeros(self.shape[0], dtype=np.int64)
        for n, at in enumerate([*(p.at for p in self.outer), self.whole]):
            home[at], place[at] = n, np.arange(at.size)
        return home, place

    def along(self, values: Array, out: Array | None = None) -> Array:
        """Return the inner products (T, B) of all columns with values (N, m, B)."""
        out = np.empty((self.shape[0], values.shape[2])) if out is None else out
        flat = values.reshape(-1, values.shape[2])
        out[self.whole] = self.given.reshape(len(self.given), len(flat)) @ flat
        for product in self.outer:
            seen = np.einsum("nm,nmb->nb", product.unit, values)
            for begin in range(0, len(product.at), BLOCK):
                some = slice(begin, begin + BLOCK)
                out[product.at[some]] = product.change[some] @ seen
        for at, columns in self.sums.items():
            np.sum(out[list(columns)], axis=0, out=out[at])
        return out


class LibraryColumns:
    """Collects the columns over the rows of a system."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.count = 0
        self._given: dict[int, Array] = {}
        self._shifted: dict[int, tuple[float, Sequence[Shift]]] = {}
        self._later: dict[int, tuple[Array, Array | Bools]] = {}
        self._sums: dict[int, Sequence[int]] = {}

    def add(self, column: Array) -> int:
        """Add one whitened column (N, m); return its index."""
        self._given[self.count] = column
        return self._next()

    def shifted(self, shifts: Sequence[Shift], factor: float = 1.0) -> int:
        """Add the column of one shift per part, times a factor; return its index."""
        self._shifted[self.count] = factor, shifts
        return self._next()

    def value(self, at: int) -> Array:
        """Return a column of shifts, or a sum of them (N, m)."""
        if at in self._sums:
            return np.asarray(np.sum([self.value(c) for c in self._sums[at]], axis=0))
        factor, shifts = self._shifted[at]
        return factor * self.system.column(shifts)

    def later(self, column: Array, rows: Array | Bools) -> int:
        """Add a column (N, m) restricted to a mask of rows (N,), or times factors per row (N,)."""
        self._later[self.count] = column, rows
        return self._next()

    def sum_of(self, columns: Sequence[int]) -> int:
        """Add the sum of columns already added that are not sums themselves; return its index."""
        self._sums[self.count] = columns
        return self._next()

    def made(self) -> Products:
        """Return all columns in factored form."""
        outer = [*self._by_slot(), *self._by_event()]
        there = {int(c) for product in outer for c in product.at}
        given = self._given | {
            at: column * rows[:, None] for at, (column, rows) in self._later.items()
            if at not in there} | {
            at: factor * self.system.column(shifts)
            for at, (factor, shifts) in self._shifted.items() if at not in there}
        shape = self.system.residual.shape
        return Products((self.count, *shape), np.array(list(given), dtype=np.int64),
                        np.array(list(given.values())).reshape(-1, *shape), tuple(outer),
                        self._sums)

    def _next(self) -> int:
        self.count += 1
        return self.count - 1

    def _by_slot(self) -> Iterator[Outer]:
        """Yield the columns whose shifts are of a single slot, slot by slot."""
        parts = self.system.parts
        if len(parts) > len(self.system.firsts):
            return      # a row with two ends is a sum of two products
        told: dict[tuple[int, str], list[int]] = defaultdict(list)
        for at, (_, shifts) in self._shifted.items():
            slots = [tuple(shift.slots) for shift in shifts]
            if len(set(slots)) == 1 == len(slots[0]) and all(map(only_slots, shifts)):
                told[slots[0][0]].append(at)
        ones = [np.ones(p.at.stop - p.at.start) for p in parts]
        for slot, own in told.items():
            if len(own) >= FEW:
                change = np.array([np.concatenate([
                    factor * one * shift.slots[slot]
                    for one, shift in zip(ones, shifts, strict=True)])
                    for factor, shifts in map(self._shifted.__getitem__, own)])
                yield Outer(np.array(own), change,
                            self.system.column([Shift({slot: one}) for one in ones]))

    def _by_event(self) -> Iterator[Outer]:
        """Yield the columns that are restrictions of another one, column by column."""
        told: dict[int, list[int]] = defaultdict(list)
        for at, (column, _) in self._later.items():
            told[id(column)].append(at)
        for own in told.values():
            if len(own) >= FEW:
                yield Outer(np.array(own),
                            np.array([self._later[at][1] for at in own], dtype=float),
                            self._later[own[0]][0])
