"""The columns of a library: told one by one, made together.

A column is told as the shifts that make it, as another one from a row on, or as a sum of others.
What a slot moves is asked once; columns that differ only by how far it moves are one product.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.diagnosis.linear_system import BLOCK, System
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.effects import Shift


def only_slots(shift: Shift) -> bool:
    """Whether a shift moves nothing but slots of limbs."""
    return all(v is None for v in (shift.pose, shift.stretch, shift.frame, shift.target))


@dataclass(frozen=True, eq=False)
class Outer:
    """Columns ``at`` (F,) that are ``unit`` (n, m) times ``change`` (F, n) in ``rows``."""

    at: Ints
    rows: slice
    change: Array
    unit: Array


@dataclass(frozen=True, eq=False)
class Products:
    """How columns of a library are made: inner products with them take a row for its coordinates.

    ``whole``: which columns stand for themselves, and ``given`` (W, N, m) what they are; ``outer``:
    those that are products; ``sums``: those that are sums of others.
    """

    count: int
    whole: tuple[int, ...]
    given: Array
    outer: tuple[Outer, ...]
    sums: tuple[tuple[int, Sequence[int]], ...]

    def along(self, values: Array) -> Array:
        """Return the inner products (T, B) of all columns with values (N, m, B)."""
        out = np.zeros((self.count, values.shape[2]))
        out[list(self.whole)] = self.given.reshape(len(self.given), -1) @ values.reshape(
            -1, values.shape[2])
        for product in self.outer:
            seen = np.einsum("nm,nmb->nb", product.unit,
                             values[product.rows, :product.unit.shape[1]])
            for begin in range(0, len(product.at), BLOCK):
                some = slice(begin, begin + BLOCK)
                out[product.at[some]] += product.change[some] @ seen
        for at, columns in self.sums:
            np.sum(out[list(columns)], axis=0, out=out[at])
        return out


class LibraryColumns:
    """Collects what columns are over the rows of a system."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.count = 0
        self._given: list[tuple[int, Array]] = []
        self._shifted: list[tuple[int, float, Sequence[Shift]]] = []
        self._later: list[tuple[int, Array, Bools]] = []
        self._sums: list[tuple[int, Sequence[int]]] = []

    def add(self, column: Array) -> int:
        """Add one white column (N, m); return where it is."""
        self._given.append((self.count, column))
        return self._next()

    def shifted(self, shifts: Sequence[Shift], factor: float = 1.0) -> int:
        """Add the column of one shift per part, times a factor; return where it is."""
        self._shifted.append((self.count, factor, shifts))
        return self._next()

    def later(self, column: Array, rows: Bools) -> int:
        """Add what a column (N, m) is in some rows (N,), and 0 in the others."""
        self._later.append((self.count, column, rows))
        return self._next()

    def sum_of(self, columns: Sequence[int]) -> int:
        """Add the sum of columns that were added before; return where it is."""
        self._sums.append((self.count, columns))
        return self._next()

    def made(self) -> tuple[Array, Products]:
        """Return all columns (N, m, T), one after the other in memory, and how they are made."""
        out = np.zeros((self.count, *self.system.residual.shape))
        whole = [at for at, _ in self._given]
        for at, column in self._given:
            out[at] = column
        for at, factor, shifts in self._shifted:
            if not all(map(only_slots, shifts)):
                out[at] = factor * self.system.column(shifts)
                whole.append(at)
        outer = [*self._by_slot(), *self._by_event()]
        for product in outer:
            for begin in range(0, len(product.at), BLOCK):
                some = slice(begin, begin + BLOCK)
                out[product.at[some], product.rows, :product.unit.shape[1]] += (
                    product.change[some, :, None] * product.unit)
        for at, columns in self._sums:
            np.sum(out[list(columns)], axis=0, out=out[at])
        return np.moveaxis(out, 0, -1), Products(
            self.count, tuple(whole), out[whole], tuple(outer), tuple(self._sums))

    def _next(self) -> int:
        self.count += 1
        return self.count - 1

    def _by_slot(self) -> Iterator[Outer]:
        """Yield the columns of shifts of slots alone, part by part and slot by slot."""
        for number, part in enumerate(self.system.parts):
            rows = part.at.stop - part.at.start
            told: dict[tuple[int, str], list[tuple[int, Array]]] = defaultdict(list)
            for at, factor, shifts in self._shifted:
                if all(map(only_slots, shifts)):
                    for slot, change in shifts[number].slots.items():
                        told[slot].append((at, np.broadcast_to(factor * change, (rows,))))
            for slot, own in told.items():
                yield Outer(np.array([at for at, _ in own]), part.at, np.stack([c for _, c in own]),
                            part.column(Shift({slot: np.ones(rows)})))

    def _by_event(self) -> Iterator[Outer]:
        """Yield the columns that are another one in some rows."""
        told: dict[int, list[tuple[int, Array, Bools]]] = defaultdict(list)
        for event in self._later:
            told[id(event[1])].append(event)
        for own in told.values():
            yield Outer(np.array([at for at, *_ in own]), slice(None),
                        np.stack([rows for *_, rows in own]).astype(float), own[0][1])
