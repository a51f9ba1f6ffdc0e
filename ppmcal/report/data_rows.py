"""What is known of measured rows, where a plot is pointed at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.io.csv import Table
from ppmcal.io.results.identification_tables import COORDINATES, quantity_of
from ppmcal.linalg import Array
from ppmcal.plotting.layers import Points, Undrawn
from ppmcal.report.format import number, sig, with_unit
from ppmcal.report.records import MeasuredRows
from ppmcal.report.rows import row_key, row_numbers
from ppmcal.units import Units

OWN = ("row", "dataset", "used")
"""Table of residuals.csv that say which row it is, not what held in it."""
MOST = 18
"""So many columns of the measurement file are shown of a row, three in a line."""
MOST_HELD, MOST_RUNS = 20_000, 500
"""So many rows at most are held by each thinned plot, numbered through in so many pieces."""
STAGES = ("before_", "after_", "sigma_")


@dataclass(frozen=True, eq=False)
class DataRows:
    """The rows of a residuals.csv, with what is known of each.

    Attributes:
        fit: which identification of the page, from 0.
        table: residuals.csv, N rows.
        units: of its columns.
        positions: measured x, y (N, 2), nan where unknown; None: all are.
        measured: the rows in the files that were fitted; None where these are not at hand.
    """

    fit: int | str
    table: Table
    units: Units
    positions: Array | None = None
    measured: MeasuredRows | None = None

    def points(self, index: NDArray[np.integer[Any]]) -> Points:
        """Return what some rows (M,), counted from 0, are."""
        names, rows = self.table.words("dataset"), row_numbers(self.table)
        picked = index.tolist()
        return Points([self._said(i) for i in picked],
                      [row_key(self.fit, names[i], int(rows[i])) for i in picked])

    def undrawn(self, y: Array, x: Array | None = None) -> Undrawn | None:
        """Return all rows at their places, for a layer that draws some; None for too many.

        Args:
            y: (N,), nan where a row has no place.
            x: likewise  [default: the number of the row in the table].
        """
        names, rows = self.table.words("dataset"), row_numbers(self.table)
        starts = [i for i in range(rows.size) if i == 0 or names[i] != names[i - 1]
                  or rows[i] != rows[i - 1] + 1]
        if rows.size > MOST_HELD or len(starts) > MOST_RUNS:
            return None
        runs = [(row_key(self.fit, names[i], int(rows[i])).rpartition(":")[0], int(rows[i]), j - i)
                for i, j in zip(starts, [*starts[1:], rows.size], strict=True)]
        return Undrawn(runs, y, x)

    def _said(self, i: int) -> str:
        """Return data set, row and what held in it, in lines."""
        row = number(float(self.table.number("row")[i]))
        name = ", ".join(t for t in (self.table.words("dataset")[i],
                                     "" if row is None else f"row {row:.0f}") if t)
        return "\n".join(t for t in (name, *self._conditions(i)) if t)

    def _conditions(self, i: int) -> Iterator[str]:
        """Yield where the row was measured, and what other columns say of it."""
        told = [] if self.measured is None else self.measured.said(i)
        yield from (", ".join(told[n:n + 3]) for n in range(0, min(len(told), MOST), 3))
        if not told and self.positions is not None and np.isfinite(self.positions[i]).all():
            x, y = self.positions[i].tolist()
            yield f"measured x {sig(x, 5)}, y {sig(y, 5)}"
        for name in self.table.header:
            if name in OWN or name.startswith(STAGES):
                continue
            if name in self.table.numbers:
                value = number(float(self.table.numbers[name][i]))
                unit = self.units.name(quantity_of(name)) if name in COORDINATES else ""
                if value is not None:
                    yield f"{name} {with_unit(value, unit, 5)}"
            elif self.table.words(name)[i]:
                yield f"{name}: {self.table.words(name)[i]}"
