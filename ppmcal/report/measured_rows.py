"""What the fitted files say of the rows of residuals.csv: where and under what conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.report.records import Columns, Identified, MeasuredRows, Simulated
from ppmcal.report.sources import read_columns
from ppmcal.store.inputs import digest_of

NOT_SHOWN = ("q_", "q2_", "vel_", "sigma_", "cmd_")
"""Columns that begin so are not conditions that a person looks for."""


def is_place(column: str) -> bool:
    """Whether a column of a measurement file is x or y."""
    return column in ("x", "y")


def is_condition(column: str) -> bool:
    """Whether a column of a measurement file is shown of a row: pose, temperature, load, time."""
    return not column.startswith(NOT_SHOWN)


def with_measured(one: Identified, simulated: Sequence[Simulated]) -> Identified:
    """Find the lines of the residual rows, in files with the check sum of the input."""
    table = one.residuals
    if table is None or not table.size:
        return one
    tables: list[Columns] = []
    which, line = (np.full(table.size, -1, dtype=np.int64) for _ in range(2))
    datasets = one.record.datasets
    names = np.array(table.words("dataset"), dtype=object)
    rows = np.clip(table.number("row"), -1.0, 1e9)
    for entry in datasets:
        found = _measured(one, entry.source, simulated)
        mine = (names == entry.name) | (len(datasets) == 1)
        if found is None or not np.isfinite(rows[mine]).all() or not mine.any():
            continue
        index = np.nan_to_num(rows, nan=-1.0).astype(int) - (0 if rows[mine].min() < 1 else 1)
        mine &= (index >= 0) & (index < found.size)
        which[mine], line[mine] = len(tables), index[mine]
        tables.append(found)
    measured = MeasuredRows(tuple(tables), which, line) if tables else None
    places = _places(table, measured)
    known = np.isfinite(places).all(axis=1).any()
    return replace(one, measured=measured, positions=places if known else None)


def _places(table: Columns, measured: MeasuredRows | None) -> np.ndarray:
    """Return measured x, y (N, 2), nan where unknown: those of residuals.csv if it has them."""
    if _has_places(table):
        return np.column_stack([table.number("x"), table.number("y")])
    out = np.full((table.size, 2), np.nan)
    for n, own in enumerate(measured.tables if measured is not None else ()):
        if measured is not None and _has_places(own):
            mine = measured.table == n
            out[mine] = np.column_stack([own.number("x"), own.number("y")])[measured.line[mine]]
    return out


def _has_places(table: Columns) -> bool:
    return "x" in table.numbers and "y" in table.numbers


def recorded_inputs(one: Identified, source: str) -> list[str]:
    """Return the inputs of a record that a data set came from: the very one, else its namesakes."""
    inputs = one.record.provenance.inputs
    return [k for k in inputs if k == source] or [
        k for k in inputs if source and Path(k).name == Path(source).name]


def _measured(one: Identified, source: str, simulated: Sequence[Simulated]) -> Columns | None:
    """Return the conditions of a measurement file, if it is the very one that was fitted."""
    inputs, names = one.record.provenance.inputs, recorded_inputs(one, source)
    if len(names) != 1 or not inputs[names[0]]:
        return None
    table = next((s.measurements for s in simulated if s.digest == inputs[names[0]]), None)
    if table is None and digest_of(Path(names[0])) == inputs[names[0]]:
        try:
            return read_columns(Path(names[0]), whole=False, wanted=is_condition,
                                numeric=is_place)
        except BadInput:
            return None
    return table
