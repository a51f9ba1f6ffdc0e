"""Tables in files: CSV, Parquet or a spreadsheet, whichever the file holds."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table, csv_table, refuse_absurd
from ppmcal.io.csv_body import Cells
from ppmcal.io.excel import MAGIC as EXCEL
from ppmcal.io.excel import excel_table
from ppmcal.io.parquet import MAGIC, parquet_table
from ppmcal.store.inputs import read_bytes

SUFFIXES = (".csv", ".parquet", ".xlsx")
"""Of measurement files, beside which a sidecar is looked for."""


def is_text(data: bytes) -> bool:
    """Return whether a file is neither Parquet nor a spreadsheet."""
    return not data.startswith((MAGIC, EXCEL))


def read_table(path: str | os.PathLike[str], text: Collection[str] = (),
               loose: Callable[[str], bool] | None = None, sheet: str | None = None,
               wanted: Callable[[str], bool] | None = None, rowless: bool = False) -> Table:
    """Return a file's table as columns.

    Args:
        path: the file.
        text: columns that are labels: kept as text unless all their cells are numbers.
        loose: says of a column name whether it may hold text too (default: none); such a
            column is only repeated, so its numbers may be of any size.
        sheet: of a spreadsheet  [default: the first].
        wanted: of which columns anything is kept  [default: all].
        rowless: whether a CSV may be a header alone.

    Raises:
        BadInput: as :func:`ppmcal.io.csv.csv_table`, :func:`ppmcal.io.parquet.parquet_table`
            and :func:`ppmcal.io.excel.excel_table`, a number that is too large, or a sheet of
            a file that has none.
    """
    def may_be_text(name: str) -> bool:
        return name in text or (loose is not None and loose(name))

    def is_wanted(name: str) -> bool:
        return wanted is None or wanted(name)

    source, data = str(path), read_bytes(Path(path))
    if data.startswith(EXCEL):
        table = excel_table(data, source, may_be_text, sheet)
    elif sheet is not None:
        raise BadInput(f"has no sheet '{sheet}': it is not a spreadsheet", source,
                       "Take `sheet` out of the sidecar's `read`")
    elif data.startswith(MAGIC):
        table = parquet_table(data, source, may_be_text)
    else:
        table = csv_table(data, source, Cells(may_be_text, wanted=is_wanted), rowless)
    if wanted is not None:
        table = table.without([h for h in table.header if not wanted(h)])
    refuse_absurd({h: v for h, v in table.numbers.items() if not may_be_text(h)}, source)
    return table
