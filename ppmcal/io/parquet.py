"""Parquet tables: the same columns as a CSV has, in a quarter of the space and without parsing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from itertools import chain
from typing import Any

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.frames import as_table
from ppmcal.limits import CELL_SIZE, UNPACKED_BYTES, refuse_shape

MAGIC = b"PAR1"
"""What every such file begins with."""


def parquet_table(data: bytes, source: str, may_be_text: Callable[[str], bool]) -> Table:
    """Return a Parquet file as columns; an empty cell is nan.

    Args:
        data: of the file.
        source: what messages call it.
        may_be_text: says of a column name whether it may hold text.

    Raises:
        BadInput: pyarrow is not there, the file is damaged, a column holds no numbers, or as
            :func:`ppmcal.io.frames.as_table`.
    """
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
        raise BadInput(f"cannot be read as Parquet ({_first_line(error)})", source,
                       "Write the file again, or save the table as CSV") from None
    double = next((n for i, n in enumerate(names) if n in names[:i]), None)
    if double is not None:
        raise BadInput(f"two columns are called '{double}'", source, "Rename one of them")
    columns = dict(zip(names, cells, strict=True))
    return as_table(columns, (), source, may_be_text)


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
    """Return a Parquet file.

    Args:
        columns: name -> kind (``text``, ``float`` or ``int``) and N cells; None is an empty one.
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


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0][:80] if str(error) else type(error).__name__
