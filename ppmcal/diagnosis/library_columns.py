"""The columns of a library: told one by one, made together.

A column is told as the shifts that make it, as another one from a row on, or as a sum of others.
What a slot moves is asked once; columns that differ only by how far it moves are one product.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.diagnosis.linear_system import BLOCK, System, SystemPart
from ppmcal.linalg import Array, Bools
from ppmcal.model.effects import Shift


def only_slots(shift: Shift) -> bool:
    """Whether a shift moves nothing but slots of limbs."""
    return all(v is None for v in (shift.pose, shift.stretch, shift.frame, shift.target))


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

    def made(self) -> Array:
        """Return all columns (N, m, T), one after the other in memory."""
        out = np.zeros((self.count, *self.system.residual.shape))
        for at, column in self._given:
            out[at] = column
        for at, column, rows in self._later:
            np.multiply(column, rows[:, None], out=out[at])
        for number, part in enumerate(self.system.parts):
            self._shift(out, part, number)
        for at, columns in self._sums:
            np.sum(out[list(columns)], axis=0, out=out[at])
        return np.moveaxis(out, 0, -1)

    def _next(self) -> int:
        self.count += 1
        return self.count - 1

    def _shift(self, out: Array, part: SystemPart, number: int) -> None:
        """Add to columns (T, N, m) what shifts of one part do."""
        by_slot: dict[tuple[int, str], list[tuple[int, Array]]] = defaultdict(list)
        for at, factor, shifts in self._shifted:
            shift = shifts[number]
            for slot, change in shift.slots.items():
                by_slot[slot].append((at, factor * change))
            if not only_slots(shift):
                column = factor * part.column(replace(shift, slots={}))
                out[at, part.at, :column.shape[1]] += column
        rows = part.at.stop - part.at.start
        for slot, told in by_slot.items():
            unit = part.column(Shift({slot: np.ones(rows)}))
            for begin in range(0, len(told), BLOCK):
                some = told[begin:begin + BLOCK]
                change = np.stack([np.broadcast_to(c, (rows,)) for _, c in some])
                out[[at for at, _ in some], part.at, :unit.shape[1]] += change[..., None] * unit
