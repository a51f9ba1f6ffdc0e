"""Tables that are in memory: data frames, mappings of columns and arrays, in place of CSV files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table, refuse_absurd, refuse_double
from ppmcal.io.csv_dialect import PLAIN
from ppmcal.limits import CELL_SIZE, refuse_shape

Tabular = str | os.PathLike[str] | Mapping[str, Any] | Any
"""A path of a CSV, a data frame (pandas, polars), a mapping of columns, or an array (N, c)."""
NAME = "table"
"""What a table without a file is called in messages."""


def is_path(source: object) -> TypeGuard[str | os.PathLike[str]]:
    """Return whether a table is given as the path of a file."""
    return isinstance(source, str | os.PathLike)


def as_table(source: Any, names: Sequence[str] = (), what: str = NAME,
             loose: Callable[[str], bool] = lambda name: True) -> Table:
    """Return a table that is in memory as one that was read from a CSV.

    Args:
        source: a data frame, a mapping from column to N values, or an array (N, c).
        names: of the c columns of a bare array, in their order.
        what: what messages call it.
        loose: says of a column's name whether it may hold words too.

    Numbers become float columns (None and nan are empty cells), anything else words.

    Raises:
        BadInput: no rows, columns of different lengths or of one name, an array of another
            width, a word for a number, a number that is too large.
    """
    columns = _columns(source, names, what)
    sizes = {len(values) for values in columns.values()}
    if len(sizes) > 1:
        raise BadInput(f"has columns of {min(sizes)} and of {max(sizes)} rows", what,
                       "Give every column as many values")
    if not sizes or not max(sizes):
        raise BadInput("has no rows", what, "Give at least one row of numbers")
    refuse_shape(max(sizes), len(columns), what)
    numbers: dict[str, Any] = {}
    text: dict[str, tuple[str, ...]] = {}
    for name, values in columns.items():
        as_numbers = _numbers(values)
        if as_numbers is None:
            if not loose(name):
                row = next(i for i, v in enumerate(values) if _numbers([v]) is None)
                raise BadInput(f"'{str(values[row])[:40]}' is not a number",
                               f"{what}: row {row + 1}, column {name}", "Write a number")
            text[name] = tuple("" if v is None or v != v else str(v) for v in values)
            CELL_SIZE.refuse(max(map(len, text[name]), default=0), f"{what}: column {name}")
        else:
            numbers[name] = as_numbers
    refuse_absurd(numbers, what)
    return Table(what, tuple(columns), numbers, text, sizes.pop())


def _columns(source: Any, names: Sequence[str], what: str) -> dict[str, Any]:
    """Return the columns by name, whatever holds them."""
    if isinstance(source, Mapping) or hasattr(source, "columns"):
        keys = [str(k).strip() for k in (source if isinstance(source, Mapping) else source.columns)]
        refuse_double(keys, what, "Rename one of them")
        held = source if isinstance(source, Mapping) else {c: source[c] for c in source.columns}
        return {k: _cells(v) for k, v in zip(keys, held.values(), strict=True)}
    block = source if np.ma.isMaskedArray(source) else np.asarray(source)
    if block.ndim == 1:
        block = block[None]
    if block.ndim != 2 or block.shape[1] != len(names):
        raise BadInput(f"is an array of shape {np.shape(source)}", what,
                       f"Give (N, {len(names)}): {', '.join(names)}; or name the columns, as a "
                       "data frame or as a mapping")
    return {name: _cells(block[:, i]) for i, name in enumerate(names)}


def _cells(values: Any) -> Any:
    """Return the cells of a column: as they are where all are floats (N,), else a list."""
    if np.ma.isMaskedArray(values):    # what is masked is not measured
        return [None if hidden else value for value, hidden in
                zip(values.data.ravel().tolist(), np.ma.getmaskarray(values).ravel(), strict=True)]
    array = np.asarray(values)
    if array.dtype == np.float64:
        return array.ravel()
    return list(np.asarray(values, dtype=object).ravel())


def _numbers(values: Any) -> Any:
    """Return N cells as floats (N,), None where one of them is a word."""
    if isinstance(values, np.ndarray):
        return values
    try:
        return np.array([np.nan if v is None else _told(v) if isinstance(v, str) else float(v)
                         for v in values], dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None


def _told(word: str) -> float:
    """Return the number that a word is in a CSV (ValueError for none): to Python 1_2 is 12."""
    if PLAIN.fullmatch(word.strip()) is None:
        raise ValueError(word)
    return float(word)
