"""The rows of kinematics.csv as a motion over time: what its pictures draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ppmcal.io.csv import Table
from ppmcal.io.results.kinematics import KINEMATICS_TABLE, KinematicsRecord
from ppmcal.kinematics.path_rates import follows
from ppmcal.linalg import Array, Bools
from ppmcal.plotting.plot import Axis, span
from ppmcal.report.html import with_label

NOT_FOUND = "not converged"
GONE = ("unreachable", NOT_FOUND, "refused")
"""Statuses of rows without a pose or without joint values."""


@dataclass(frozen=True)
class TimedRows:
    """Kinematics of N rows as they are drawn.

    Attributes:
        record: kinematics.json; columns: of kinematics.csv.
        at: time or row (N,); name: of that axis; timed: whether it is time.
        status: of each row; rows: their numbers from 1, before thinning.
    """

    record: KinematicsRecord
    columns: Table
    at: Array
    name: str
    timed: bool
    status: tuple[str, ...]
    note: str = ""

    def number(self, name: str) -> Array:
        """Return a column (N,)."""
        return self.columns.number(name)

    def label(self, name: str) -> str:
        """Return a column's name with its unit."""
        return with_label(name, self.record.units.get(name, ""))

    def flagged(self, words: Sequence[str]) -> Bools:
        """Return which rows have one of some statuses (N,)."""
        return np.array([s in words for s in self.status], dtype=bool)

    @property
    def across(self) -> Axis:
        """The axis of time or rows."""
        return span(self.at, margin=0.02)


def is_shown(name: str) -> bool:
    """Whether a column of kinematics.csv is drawn, or says how its row went."""
    return KINEMATICS_TABLE.numbers(name) or name in ("t", "row", "own", "status", "reason")


def drawn_columns(columns: Mapping[str, Any]) -> Table:
    """Return columns (N,) of numbers or words as those of a file."""
    numbers, text = {}, {}
    for name, values in columns.items():
        if KINEMATICS_TABLE.numbers(name):
            numbers[name] = np.asarray(values, dtype=float)
        elif is_shown(name):
            text[name] = tuple(str(v) for v in values)
    size = max((len(v) for v in columns.values()), default=0)
    return Table("kinematics.csv", tuple(columns), numbers, text, size)


def _own_modes(record: KinematicsRecord, columns: Table) -> Table:
    """Return the machine's own assembly mode of each row, all rows where there is one mode a row.

    A row whose own mode is not known stays as a gap.
    """
    row, own = _numbers(columns, "row"), _numbers(columns, "own") == 1.0
    if record.modes is None or not np.isfinite(row).all():
        return columns
    _, first = np.unique(row, return_index=True)
    lines = np.array([next(iter(np.flatnonzero(own & (row == row[i]))), i) for i in first])
    lost = ~own[lines]
    given = ("time", *(h for h in columns.numbers if h.startswith("q_")))
    numbers = {k: np.where(lost & (k not in given), np.nan, v[lines])
               for k, v in columns.numbers.items()}
    text = {k: tuple(NOT_FOUND if gone and k == "status" else v[i]
                     for i, gone in zip(lines, lost, strict=True))
            for k, v in columns.text.items()}
    return replace(columns, size=len(lines), numbers=numbers, text=text)


def motion_of(record: KinematicsRecord, columns: Table) -> TimedRows:
    """Return the rows over time, or over their numbers where there is no time."""
    columns = _own_modes(record, columns)
    name = next((h for h in ("time", "t") if h in columns.header), "")
    at = _numbers(columns, name)
    timed = follows(at)
    if not timed:
        at = np.arange(1.0, columns.size + 1.0)
    axis = "time (s)" if timed else "row, in the order of the file"
    note = f"The column {name} does not go up: rows in its place." if name and not timed else ""
    return TimedRows(record, columns, at, axis, timed, columns.words("status"), note)


def _numbers(columns: Table, name: str) -> Array:
    """Return a column (N,), all nan where it holds other words than numbers."""
    if name in columns.numbers or not name:
        return columns.number(name)
    try:
        return np.array([float(word or "nan") for word in columns.words(name)])
    except ValueError:
        return np.full(columns.size, np.nan)
