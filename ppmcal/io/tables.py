"""Tables in files (CSV, Parquet or a spreadsheet, whichever the file holds) and in memory.

A spreadsheet is read as one sheet, with a header in its first row that is not blank. Parquet has
the same columns as a CSV in a quarter of the space and without parsing. In place of a file there
may be a data frame, a mapping of columns or an array.
"""

from __future__ import annotations

import io
import os
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from itertools import chain, takewhile
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.csv import Table, csv_table, refuse_absurd, refuse_double
from ppmcal.io.csv_body import Cells
from ppmcal.io.csv_dialect import PLAIN
from ppmcal.limits import CELL_SIZE, TABLE_CELLS, UNPACKED_BYTES, refuse_shape
from ppmcal.store.inputs import read_bytes

SUFFIXES = (".csv", ".parquet", ".xlsx")
"""Of measurement files, beside which a sidecar is looked for."""
EXCEL, PARQUET = b"PK\x03\x04", b"PAR1"
"""What every such file begins with; with the first one every zip does."""
LAST_ROW = 1_048_576
Tabular = str | os.PathLike[str] | Mapping[str, Any] | Any
"""A path of a CSV, a data frame (pandas, polars), a mapping of columns, or an array (N, c)."""
NAME = "table"
"""What a table without a file is called in messages."""


def is_text(data: bytes) -> bool:
    """Return whether a file is neither Parquet nor a spreadsheet."""
    return not data.startswith((PARQUET, EXCEL))


def read_table(path: str | os.PathLike[str], loose: Callable[[str], bool] = lambda name: False,
               sheet: str | None = None, wanted: Callable[[str], bool] = lambda name: True,
               rowless: bool = False) -> Table:
    """Return a file's table as columns; an empty cell is nan.

    Args:
        path: the file.
        loose: says of a column name whether it may hold text; it is text unless all cells are
            numbers, which may be of any size.
        sheet: of a spreadsheet  [default: the first].
        wanted: of which columns anything is kept  [default: all].
        rowless: whether a CSV may be a header alone.

    Raises:
        BadInput: as :func:`ppmcal.io.csv.csv_table` and :func:`as_table`, a file that is damaged
            or whose package is not there, a number that is too large, or a sheet that is not there.
    """
    source, data = str(path), read_bytes(Path(path))
    if data.startswith(EXCEL):
        table = as_table(_of_sheet(data, source, sheet), (), source, loose)
    elif sheet is not None:
        raise BadInput(f"has no sheet '{sheet}': it is not a spreadsheet", source,
                       "Take `sheet` out of the sidecar's `read`")
    elif data.startswith(PARQUET):
        table = as_table(_of_parquet(data, source), (), source, loose)
    else:
        table = csv_table(data, source, Cells(loose, wanted=wanted), rowless)
    table = table.without([h for h in table.header if not wanted(h)])
    refuse_absurd({h: v for h, v in table.numbers.items() if not loose(h)}, source)
    return table


# ---- spreadsheets


def _of_sheet(data: bytes, source: str, sheet: str | None) -> dict[str, list[Any]]:
    """Return the columns of a sheet; of a formula its last value counts."""
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
    return _columns(rows, source)


def _rows(sheet: Any, source: str) -> list[list[Any]]:
    """Return the rows of a sheet that are not blank."""
    sheet.reset_dimensions()    # or every row is filled up to what the sheet says of its width
    out: list[list[Any]] = []
    count = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        if number > LAST_ROW:    # rows that are not there are yielded, too
            raise BadInput(f"has a row after {LAST_ROW}, the last that a sheet can have", source,
                           "Save it again, or save the sheet as CSV")
        if not row:    # a million of them may stand before the next that is there
            continue
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
        refuse_double([*out, name], f"{source}: header")
        if name:
            out[name] = cells
        elif any(c is not None for c in cells):
            raise BadInput(f"column {i + 1} has no name", f"{source}: header", "Name it")
    return out


# ---- Parquet


def _of_parquet(data: bytes, source: str) -> dict[str, Any]:
    """Return the columns of a Parquet file."""
    try:
        import pyarrow  # forty megabytes, for those who have such files
        from pyarrow import parquet
    except ImportError:
        raise BadInput("is a Parquet file, which only pyarrow can read", source,
                       "Install it (pip install pyarrow), or save the table as CSV") from None
    try:
        about = parquet.read_metadata(pyarrow.BufferReader(data))
        words = _refuse_large(about, source)
        # words stay as the file has them: a dictionary, and a number in each row
        file = parquet.ParquetFile(pyarrow.BufferReader(data), metadata=about,
                                   read_dictionary=words)
        held = file.read()
        UNPACKED_BYTES.refuse(sum(map(_unpacked, held.columns)), source)
        names = [str(n).strip() for n in held.column_names]
        cells = list(map(_values, held.columns))
    # names and words that are not UTF-8 are met where they are taken out
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        what = (str(error) or type(error).__name__).splitlines()[0][:80]
        raise BadInput(f"cannot be read as Parquet ({what})", source,
                       "Write the file again, or save the table as CSV") from None
    refuse_double(names, source, "Rename one of them")
    return dict(zip(names, cells, strict=True))


def _refuse_large(about: Any, source: str) -> list[str]:
    """Refuse what is too large when it is unpacked, told by what the file says of itself.

    Returns the columns of words. Of damaged columns pyarrow ends the process where their own
    entries are asked for, so that only those of the schema and of whole groups are.
    """
    refuse_shape(about.num_rows, about.num_columns, source)
    groups = map(about.row_group, range(about.num_row_groups))
    size, words = sum(g.total_byte_size for g in groups), []
    for column in map(about.schema.column, range(about.num_columns)):
        if column.max_repetition_level or column.path != column.name:
            raise BadInput("holds several values in a row", f"{source}: column {column.path}",
                           "Give each of them a column, or leave the column out")
        if column.physical_type == "FIXED_LEN_BYTE_ARRAY":
            size += column.length * about.num_rows
        elif column.physical_type == "BYTE_ARRAY" and column.logical_type.type != "DECIMAL":
            words.append(column.path)
    UNPACKED_BYTES.refuse(size, source)
    if size > CELL_SIZE.most * (about.num_rows + 1) * about.num_columns:
        raise CELL_SIZE.error(source)
    return words


def _unpacked(column: Any) -> int:
    """Return the bytes of a column's cells, each counted, also where a dictionary has them once."""
    import pyarrow
    from pyarrow import compute

    if not pyarrow.types.is_dictionary(column.type):
        return int(column.nbytes)
    return sum(compute.sum(compute.take(compute.binary_length(c.dictionary), c.indices)).as_py()
               or 0 for c in column.chunks)


def refuse_without_pyarrow(source: str) -> None:
    """Refuse to begin what will end in a Parquet file that nothing can write.

    Raises:
        BadInput: pyarrow is not there.
    """
    if find_spec("pyarrow") is None:
        raise BadInput("is a Parquet file, which only pyarrow can write", source,
                       "Install it (pip install 'ppmcal[parquet]')")


def parquet_bytes(columns: Mapping[str, tuple[str, Sequence[Any]]]) -> bytes:
    """Return a Parquet file of columns: name -> kind and N cells, None for an empty one.

    Kinds are ``text``, ``float`` and ``int``.
    """
    import pyarrow
    from pyarrow import parquet

    kinds = {"text": pyarrow.string(), "float": pyarrow.float64(), "int": pyarrow.int64()}
    held = pyarrow.table({name: pyarrow.array(cells, kinds[kind])
                          for name, (kind, cells) in columns.items()})
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(held, sink)
    return bytes(sink.getvalue())


def _values(column: Any) -> Any:
    """Return the cells of a column (N,): floats where it holds numbers, else objects.

    Moments are words such as 2026-03-04T10:00:00.25Z, Z where the column has a zone.
    """
    import pyarrow

    if pyarrow.types.is_dictionary(column.type):
        return list(chain.from_iterable(map(_words, column.chunks)))
    cells = column.to_numpy()
    if np.issubdtype(cells.dtype, np.datetime64):
        zone = "Z" if getattr(column.type, "tz", None) else ""
        return [None if np.isnat(c) else f"{np.datetime_as_string(c)}{zone}" for c in cells]
    return cells.astype(float) if np.issubdtype(cells.dtype, np.number) else cells


def _words(chunk: Any) -> Any:
    """Return the cells of a part of a column (n,); equal ones are one object."""
    known = np.array([*chunk.dictionary.to_pylist(), None], dtype=object)
    return known[chunk.indices.fill_null(len(known) - 1).to_numpy()]


# ---- in memory


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
    columns = _held(source, names, what)
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


def _held(source: Any, names: Sequence[str], what: str) -> dict[str, Any]:
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
