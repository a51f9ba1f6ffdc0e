"""CSV tables: what a file must be, its header, and its rows as columns; and how they are written.

Columns may be separated by commas, semicolons or tabs; see :mod:`ppmcal.io.csv_dialect`. Rows
count from 1, without the header and without blank lines; :mod:`ppmcal.io.csv_body` reads them.
"""

from __future__ import annotations

import csv
import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv_body import Body, Cells
from ppmcal.io.csv_dialect import PLAIN, Dialect, declared, separator_of
from ppmcal.limits import TABLE_COLUMNS, refuse_long_lines, refuse_shape
from ppmcal.linalg import Array, Bools
from ppmcal.store.output import LongText
from ppmcal.wording import pluralize, row_list
from ppmcal.wording.progress import note

log = logging.getLogger(__package__)
SHOWN = 24
"""Columns of a table that are logged."""
NO_TABLES = (b"%PDF-", b"PK\x03\x04", b"{\\rtf")
"""What files of other programs begin with: PDF, those of offices, RTF."""
LARGEST = 1e15
"""No cell of a column that the program computes with may hold a larger number."""


@dataclass(frozen=True)
class Table:
    """A CSV with N rows: ``numbers`` (N,) by column, nan where empty; ``text`` by column.

    ``dialect`` is how the file was written, None for what is not a CSV.
    """

    source: str
    header: tuple[str, ...]
    numbers: Mapping[str, Array]
    text: Mapping[str, tuple[str, ...]]
    size: int
    dialect: Dialect | None = None

    def __len__(self) -> int:
        """Return the number of rows N."""
        return self.size

    def number(self, column: str) -> Array:
        """Return a column of numbers (N,), all nan if it is not there."""
        return self.numbers.get(column, np.full(self.size, np.nan))

    def words(self, column: str) -> tuple[str, ...]:
        """Return a column of words, all empty if it is not there."""
        return self.text.get(column, ("",) * self.size)

    def labels(self, column: str) -> tuple[str, ...]:
        """Return a column's cells as words."""
        if column in self.text:
            return self.text[column]
        return tuple("" if np.isnan(v) else f"{v:.17g}" for v in self.numbers[column].tolist())

    def named(self, names: Mapping[str, str]) -> Table:
        """Return the columns of ``names`` (here -> there) in its order, called as they are there.

        Of two that are called alike the first one's place counts.
        """
        return replace(self, header=tuple(dict.fromkeys(names.values())),
                       numbers={names[h]: v for h, v in self.numbers.items() if h in names},
                       text={names[h]: v for h, v in self.text.items() if h in names})

    def without(self, columns: Collection[str]) -> Table:
        """Return the table without some columns."""
        return self.named({h: h for h in self.header if h not in columns})

    def put(self, columns: Mapping[str, Array | tuple[str, ...]]) -> Table:
        """Return the table with columns in place of those of their names, new ones at its end."""
        kept = self.without([h for h in columns if h in self.header])
        return replace(kept, header=tuple(dict.fromkeys((*self.header, *columns))),
                       numbers={**kept.numbers, **{h: c for h, c in columns.items()
                                                   if not isinstance(c, tuple)}},
                       text={**kept.text, **{h: c for h, c in columns.items()
                                             if isinstance(c, tuple)}})

    def refuse_rows(self, bad: Bools, column: str, what: str, hint: str, listed: bool = False
                    ) -> None:
        """Refuse a column with bad rows (N,), at the first of them.

        Raises:
            BadInput: ``what`` is wrong, with the rows where they are to be ``listed``.
        """
        rows = np.flatnonzero(bad)
        if rows.size:
            raise BadInput(f"{what} ({row_list(rows)})" if listed else what,
                           self.at(column, int(rows[0])), hint)

    def at(self, column: str, row: int | None = None) -> str:
        """Return ``run3.csv: row 17, column x`` (row index counted from 0)."""
        place = f"column {column}" if row is None else f"row {row + 1}, column {column}"
        return f"{self.source}: {place}"


def csv_table(data: bytes, source: str, cells: Cells | Callable[[str], bool],
              rowless: bool = False) -> Table:
    """Return a CSV as columns.

    Args:
        data: of the file; a BOM, CRLF line ends and a first line ``sep=;`` are accepted.
        source: what messages call it.
        cells: what columns may hold; or says of a column's name whether it may hold text.
        rowless: whether there may be a header alone.

    Raises:
        BadInput: empty, binary, ragged, without rows, duplicate columns, or a cell that is
            not a number (with row and column).
    """
    cells = cells if isinstance(cells, Cells) else Cells(cells)
    data, mark = declared(cleaned(data, source))
    separator = mark or separator_of(data, source)
    first = data.find(b"\n") if b"\n" in data else len(data)
    header = _header(data[:first], source, separator)
    if not data[first:first + 4096].strip() and not data[first:].strip():
        if rowless:
            wanted = [h for h in header if cells.wanted(h)]
            return Table(source, header, {h: np.zeros(0) for h in wanted if not cells.words(h)},
                         {h: () for h in wanted if cells.words(h)}, 0)
        raise BadInput("has a header but no rows", source, "Add at least one row of numbers")
    refuse_shape(data.count(b"\n", first + 1), len(header), source)
    return Table(source, header, *Body(data, first + 1, header, source, cells, separator).read())


def whole_rows(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the bytes of a CSV cut between rows; a cell in quotes may hold line ends."""
    rest = b""
    for piece in pieces:
        rest += piece
        end = rest.rfind(b"\n") + 1
        if end and rest.count(b'"', 0, end) % 2 == 0:
            yield rest[:end]
            rest = rest[end:]
    if rest:
        yield rest


def joined(tables: Sequence[Table]) -> Table:
    """Return tables with the same columns as one, row under row; words where one has words."""
    first, words = tables[0], {h for t in tables for h in t.text}
    return first if len(tables) == 1 else replace(
        first, size=sum(t.size for t in tables),
        numbers={h: np.concatenate([t.numbers[h] for t in tables]) for h in first.numbers
                 if h not in words},
        text={h: tuple(chain.from_iterable(t.labels(h) for t in tables))
              for h in first.header if h in words})


def cleaned(data: bytes, source: str) -> bytes:
    """Return UTF-8 bytes with newlines only."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadInput("is UTF-16 text", source, "Save it as CSV in UTF-8")
    if b"\x00" in data or data.startswith(NO_TABLES):
        raise BadInput("is a binary file", source,
                       "Give a CSV file; export spreadsheets as comma-separated text")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data = data.lstrip(b"\n") if data[:1] == b"\n" else data
    if not data[:4096].strip() and not data.strip():
        raise BadInput("is empty", source, "Write a header line and one row per measurement")
    if not data.isascii():
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as error:
            line = data[:error.start].count(b"\n") + 1
            raise BadInput("is not UTF-8 text", f"{source}:{line}",
                           "Save it as CSV in UTF-8") from None
    refuse_long_lines(data, source)
    return data


def _header(line: bytes, source: str, separator: str) -> tuple[str, ...]:
    """Return the column names; refuse blanks, numbers and duplicates."""
    text = line.decode("utf-8")
    TABLE_COLUMNS.refuse(text.count(separator) + 1, f"{source}: header")
    try:
        names = next(csv.reader([text], strict=True, delimiter=separator))
    except (csv.Error, StopIteration) as error:
        raise BadInput(f"the header cannot be read ({error})", f"{source}: header",
                       "Write column names with commas between them") from None
    names = [n.strip() for n in names]
    if any(PLAIN.fullmatch(n.replace(",", ".")) for n in names):
        raise BadInput("the first line holds numbers, not column names", f"{source}: header",
                       "Add a header line such as `pose,q_leg1,q_leg2,q_leg3,x,y,rz`")
    for i, name in enumerate(names):
        if not name:
            raise BadInput(f"column {i + 1} has no name", f"{source}: header",
                           "Name it, or remove the stray separator")
    refuse_double(names, f"{source}: header")
    return tuple(names)


def refuse_double(names: Sequence[str], place: str, hint: str = "Rename or remove one of them",
                  what: str = "columns") -> None:
    """Refuse two columns of one name."""
    double = next((n for i, n in enumerate(names) if n in names[:i]), None)
    if double is not None:
        raise BadInput(f"two {what} are called '{double}'", place, hint)


def remark_table(table: Table) -> None:
    """Log rows and columns of a table."""
    names = [*table.header[:SHOWN], *(["..."] if len(table.header) > SHOWN else [])]
    log.info("%s: %s, %s: %s", table.source, pluralize(len(table), "row"),
             pluralize(len(table.header), "column"), ", ".join(names))


def refuse_absurd(numbers: Mapping[str, Array], source: str, largest: float = LARGEST,
                  infinite: bool = False) -> None:
    """Refuse columns (N,) with numbers that no machine has; they would only end in overflow.

    ``largest``: the largest number that is taken; ``infinite``: whether inf is all the same.
    """
    for name, values in numbers.items():
        with np.errstate(invalid="ignore"):
            absurd = np.flatnonzero((np.abs(values) > largest) & ~(infinite & np.isinf(values)))
        if absurd.size:
            row = int(absurd[0])
            what = ("an infinite value cannot have been measured" if np.isinf(values[row])
                    else f"{values[row]:g} is out of range")
            raise BadInput(what,
                           f"{source}: row {row + 1}, column {name}",
                           "Correct the cell, or leave it empty if it was not measured")


# ---- tables that are written: line by line, so that a long one is never held whole


CHUNK = 20_000


def csv_text(header: Sequence[str], columns: Sequence[Any]) -> str:
    """Return a CSV, as :func:`csv_lines`, whole."""
    return str(csv_lines(header, columns))


def csv_lines(header: Sequence[str], columns: Sequence[Any],
              over: Sequence[float | None] | None = None) -> LongText:
    """Return a CSV with 17 significant digits.

    ``columns``: sequences or arrays (N,) of floats, integers, booleans or words (None is an empty
    cell); ``over``: what a column's numbers are divided by as they are written, None: nothing.
    """
    units = over or [None] * len(columns)
    arrays = [_printable(c if unit is None else np.asarray(c, dtype=float))
              for c, unit in zip(columns, units, strict=True)]
    if len(arrays) != len(header):
        raise ValueError(f"{len(header)} names for {len(arrays)} columns")
    sizes = {len(a) for _, a in arrays}
    if len(sizes) > 1:
        raise ValueError(f"columns of different lengths: {sorted(sizes)}")
    size = sizes.pop() if sizes else 0
    line = ",".join(form for form, _ in arrays) + "\n"
    plain = bool(arrays) and all(form == "%.17g" for form, _ in arrays)

    def parts() -> Iterator[str]:
        yield ",".join(_cell(h) for h in header) + "\n"
        for start in range(0, size, CHUNK):
            if start:
                note(f"row {start} of {size}")
            own = [a[start:start + CHUNK] if unit is None else a[start:start + CHUNK] / unit
                   for (_, a), unit in zip(arrays, units, strict=True)]
            if plain:
                cells = np.column_stack(own).ravel().tolist()
            else:
                lists = [a.tolist() if form != "%s" else [_cell(v) for v in a]
                         for (form, _), a in zip(arrays, own, strict=True)]
                cells = [c for row in zip(*lists, strict=True) for c in row]
            yield (line * len(own[0])) % tuple(cells)

    return LongText(parts)


def _printable(values: Any) -> tuple[str, Any]:
    """Return the format of a column and the column as an array (N,)."""
    array = np.asarray(values)
    if array.ndim != 1:
        array = np.array(list(values), dtype=object)
    if array.dtype.kind == "f":
        return "%.17g", array
    if array.dtype.kind in "iu":
        return "%d", array
    return "%s", array if array.dtype == object else array.astype(object)


def _cell(value: object) -> str:
    """Return one cell of text, quoted where it must be."""
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.17g}"
    text = str(value)
    if any(c in text for c in ',"\n\r'):
        return '"' + text.replace('"', '""') + '"'
    return text
