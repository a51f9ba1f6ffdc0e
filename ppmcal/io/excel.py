"""Spreadsheets (.xlsx) as tables: one sheet, a header in its first row that is not blank."""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Callable
from itertools import takewhile
from typing import Any

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.csv import Table
from ppmcal.io.frames import as_table
from ppmcal.limits import TABLE_CELLS, UNPACKED_BYTES, refuse_shape

MAGIC = b"PK\x03\x04"
"""What every such file begins with, as every zip does."""
LAST_ROW = 1_048_576


def excel_table(data: bytes, source: str, may_be_text: Callable[[str], bool],
                sheet: str | None = None) -> Table:
    """Return a sheet as columns; an empty cell is nan, of a formula its last value counts.

    Args:
        data: of the file.
        source: what messages call it.
        may_be_text: says of a column name whether it may hold text.
        sheet: its name  [default: the first].

    Raises:
        BadInput: openpyxl is not there, the file is damaged, there is no such sheet, or as
            :func:`ppmcal.io.frames.as_table`.
    """
    try:
        from openpyxl import load_workbook  # for those who have such files
    except ImportError:
        raise BadInput("is a spreadsheet, which only openpyxl can read", source,
                       "Install it (pip install 'ppmcal[excel]'), or save the sheet as CSV"
                       ) from None
    try:
        with warnings.catch_warnings():    # of styles, which nobody asks for
            warnings.simplefilter("ignore")
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                UNPACKED_BYTES.refuse(sum(i.file_size for i in archive.infolist()), source)
            book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            names = [s.title for s in book.worksheets]
            rows = [] if sheet not in (None, *names) else _rows(book[sheet or names[0]], source)
    except BadInput:
        raise
    except Exception as error:    # a damaged archive raises anything
        raise BadInput(f"cannot be read as a spreadsheet ({type(error).__name__})", source,
                       "Save it again as .xlsx, or save the sheet as CSV") from None
    refuse_unknown("sheet", [sheet or names[0]], names, source)
    if not rows:
        raise BadInput("the sheet is empty", source, "Name another under `read.sheet` in the "
                       f"sidecar: {', '.join(names)}")
    return as_table(_columns(rows, source), (), source, may_be_text)


def _rows(sheet: Any, source: str) -> list[list[Any]]:
    """Return the rows of a sheet that are not blank."""
    sheet.reset_dimensions()    # or every row is filled up to what the sheet says of its width
    out: list[list[Any]] = []
    count = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        if number > LAST_ROW:    # rows that are not there are yielded, too
            raise BadInput(f"has a row after {LAST_ROW}, the last that a sheet can have", source,
                           "Save it again, or save the sheet as CSV")
        count += len(row)
        TABLE_CELLS.refuse(count, source)    # with those that are empty
        blank = len([*takewhile((None, "").__contains__, reversed(row))])
        cells = list(row[:len(row) - blank])
        if cells:
            out.append(cells)
            refuse_shape(len(out), len(cells), source)
    return out


def _columns(rows: list[list[Any]], source: str) -> dict[str, list[Any]]:
    """Return the columns that have a header; refuse cells without one, and doubles."""
    width = max(len(row) for row in rows)
    header, *body = [row + [None] * (width - len(row)) for row in rows]
    out: dict[str, list[Any]] = {}
    for i, title in enumerate(header):
        cells = [None if row[i] == "" else row[i] for row in body]
        name = "" if title is None else str(title).strip()
        if isinstance(title, int | float):
            raise BadInput("the first row holds numbers, not column names", f"{source}: header",
                           "Add a row with column names such as `pose, q_leg1, x, y, z`")
        if name in out:
            raise BadInput(f"two columns are called '{name}'", f"{source}: header",
                           "Rename or remove one of them")
        if name:
            out[name] = cells
        elif any(c is not None for c in cells):
            raise BadInput(f"column {i + 1} has no name", f"{source}: header", "Name it")
    return out
