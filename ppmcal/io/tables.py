"""Tables in files: CSV, or Parquet, whichever the file holds."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path

from ppmcal.io.csv import Table, csv_table, refuse_absurd
from ppmcal.io.parquet import MAGIC, parquet_table
from ppmcal.io.yaml import read_bytes


def read_table(path: str | os.PathLike[str], text: Collection[str] = (),
               loose: Callable[[str], bool] | None = None) -> Table:
    """Return a file's table as columns.

    Args:
        path: the file.
        text: columns that are labels: kept as text unless all their cells are numbers.
        loose: says of a column name whether it may hold text too (default: none); such a
            column is only repeated, so its numbers may be of any size.

    Raises:
        BadInput: as :func:`ppmcal.io.csv.csv_table` and
            :func:`ppmcal.io.parquet.parquet_table`, or a number that is too large.
    """
    def may_be_text(name: str) -> bool:
        return name in text or (loose is not None and loose(name))

    source, data = str(path), read_bytes(Path(path))
    make = parquet_table if data.startswith(MAGIC) else csv_table
    table = make(data, source, may_be_text)
    refuse_absurd({h: v for h, v in table.numbers.items() if not may_be_text(h)}, source)
    return table
