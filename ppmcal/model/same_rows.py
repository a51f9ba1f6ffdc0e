"""Rows of two tables that are equal within the digits they are written with."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

import numpy as np

from ppmcal.linalg import Array, Ints
from ppmcal.units import ANGLES, LENGTHS

LOOKED_AT = 2000
MOST_STEPS, WHOLE = 1e11, 1e-3
"""Up to this many steps, double precision shows whether a multiple is whole, within ``WHOLE``."""
ROUND_OFF = 1e-9
"""Unit conversion is exact to this part of a column's largest value."""
KEPT, CARRIED = 1000, 5000
"""Rows kept of one table, and of all tables behind a fit, to recognise a copy later."""


@dataclass(frozen=True, eq=False)
class KnownRows:
    """Rows of a data set that a calibration has used, all or some evenly spread, SI.

    Attributes:
        source: the table's name.
        kind: of instrument.
        count: number of rows in the table.
        chance: that two measurements of one pose agree in every digit.
        columns: names, ``q_leg1`` ... ``x`` ... (c,).
        table: commanded and measured values (n, c), nan where missing.
    """

    source: str
    kind: str
    count: int
    chance: float
    columns: tuple[str, ...]
    table: Array

    @property
    def whole(self) -> bool:
        """Whether all rows of the table were kept."""
        return len(self.table) == self.count

    def thinned(self, most: int) -> KnownRows:
        """Return at most ``most`` rows, evenly spread."""
        if len(self.table) <= most:
            return self
        rows = np.unique(np.linspace(0, len(self.table) - 1, most).astype(int))
        return replace(self, table=self.table[rows])


def step_of(values: Array) -> float:
    """Return the largest step that all differences of values (N,) are multiples of, 0 for none.

    >>> step_of(np.array([0.5, 0.75, 1.5]))
    0.25
    """
    known = np.unique(values[np.isfinite(values)])
    if known.size > LOOKED_AT:
        known = known[np.unique(np.linspace(0, known.size - 1, LOOKED_AT).astype(int))]
    noise = 1e-12 * float(np.abs(known).max(initial=0.0))
    gaps = np.diff(known)
    gaps = gaps[gaps > noise]
    if not gaps.size:
        return last_digit(float(known[0])) if known.size else math.inf
    step = float(gaps.min())
    while step > 100.0 * noise:
        rest = np.abs(gaps - np.round(gaps / step) * step)
        # round-off of the step accumulates with each multiple in the gap
        left = rest[rest > np.minimum(noise * np.maximum(1.0, gaps / step), 0.02 * step)]
        if not left.size:
            return step
        step = float(left.min())
    return 0.0


def last_digit(value: float) -> float:
    """Return the place value of a number's last digit; inf for 0, which may have any.

    >>> last_digit(37.25), last_digit(1200.0)
    (0.01, 100.0)
    """
    if value == 0.0:
        return math.inf
    return float(Decimal(1).scaleb(int(Decimal(repr(value)).normalize().as_tuple().exponent)))


def tolerances(one: Array, two: Array, steps: tuple[Array, Array] | None = None) -> Array:
    """Return how far the same number may differ between two tables (c,).

    Half the coarser step; only round-off where the step is unknown.

    Args:
        one: a table (N, c).
        two: another (M, c) with the same columns.
        steps: step of each table's columns (c,)  [default: inferred from the numbers].
    """
    if steps is None:
        steps = (_steps(one), _steps(two))
    both = np.concatenate([one, two])
    size = np.abs(np.where(np.isfinite(both), both, 0.0)).max(axis=0, initial=0.0)
    coarse = np.maximum(*(np.where(np.isfinite(s), s, 0.0) for s in steps))
    return np.asarray(0.5 * coarse * (1.0 + 1e-6) + ROUND_OFF * np.maximum(size, 1e-300))


def _steps(table: Array) -> Array:
    """Return the steps of columns (c,), 0 where all values are equal: their digits show no step."""
    return np.array([step_of(c) or _decimals(c) if np.ptp(c) > 0.0 else 0.0 for c in table.T])


def _decimals(values: Array) -> float:
    """Return the last decimal place of SI values (N,) in any unit, 0 if all digits are used.

    For steps too small, relative to the values, for differences to show them.
    """
    size = float(np.abs(values).max())
    every = sorted({unit * 10.0**-digit for digit in range(10)
                    for unit in (1.0, *LENGTHS.values(), *ANGLES.values())}, reverse=True)
    for step in every:
        if size >= MOST_STEPS * step:
            break
        ratio = values / step
        if np.abs(ratio - np.round(ratio)).max() < WHOLE:
            return step
    return 0.0


def partners(one: Array, two: Array, away: Array) -> tuple[Ints, Ints]:
    """Return all pairs of rows that agree within ``away`` (c,): in ``one`` (P,), in ``two`` (P,).

    Args:
        one: a table (N, c) without nan.
        two: another (M, c).
        away: largest difference in each column.
    """
    from scipy.spatial import cKDTree  # slow to import, needed only with several files

    near: Any = cKDTree(one / away).query_ball_point(two / away, 1.0, p=np.inf)
    count = np.array([len(n) for n in near], dtype=np.int64)
    found = np.concatenate([np.zeros(0), *(np.asarray(n, dtype=float) for n in near)])
    return found.astype(np.int64), np.repeat(np.arange(len(two)), count)


def in_step(first: Ints, second: Ints, rows: int) -> Ints:
    """Return the partner of each row of the second table (rows,), -1 for none, in rising order.

    The longest pairing that keeps the order of both tables (Hunt and Szymanski, 1977).

    >>> in_step(np.array([0, 2, 1, 2]), np.array([0, 1, 2, 3]), 5).tolist()
    [0, -1, 1, 2, -1]
    """
    order = np.lexsort((-first, second))
    ends, last = list[int](), list[int]()
    before = np.full(order.size, -1)
    for n, pair in enumerate(order.tolist()):
        length = bisect_left(ends, int(first[pair]))
        before[n] = last[length - 1] if length else -1
        ends[length:length + 1] = [int(first[pair])]
        last[length:length + 1] = [n]
    out = np.full(rows, -1)
    n = last[-1] if last else -1
    while n >= 0:
        out[second[order[n]]] = first[order[n]]
        n = int(before[n])
    return out
