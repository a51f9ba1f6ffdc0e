"""The rows of a CSV, part by part: plain numbers fast, others cell by cell with their messages.

Only the part in which something stands out of the ordinary (text, ragged rows) goes the slow way,
so that one bad cell among a million rows is refused where the reading meets it.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv_dialect import (
    Dialect,
    cell_edges,
    decimal_of,
    is_number,
    parse,
    plain_column,
    without_columns,
    words_of,
)
from ppmcal.linalg import Array

CHUNK = 1 << 20
ROWS = 20_000
"""Bytes that are parsed at once, and rows that are looked at cell by cell at once."""


@dataclass(frozen=True)
class Cells:
    """What the cells of a table may hold, asked by a column's name.

    Attributes:
        may_be_text: words, where some are no numbers; else numbers.
        words: words, whatever they look like.
        wanted: of others nothing is kept, and nothing refused.
    """

    may_be_text: Callable[[str], bool]
    words: Callable[[str], bool] = lambda _: False
    wanted: Callable[[str], bool] = lambda _: True


@dataclass(frozen=True)
class _Part:
    """Some rows: ``block`` (n, width) of the bytes ``span``, or columns of numbers by name.

    ``words``: the columns that may hold words, as they stand, which go before those of the block;
    ``wordy``: those that do hold some.
    """

    size: int
    block: Array | None = None
    span: tuple[int, int] = (0, 0)
    words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    wordy: frozenset[str] = frozenset()
    numbers: Mapping[str, Array] = field(default_factory=dict)


class Body:
    """The rows of a file from byte ``start`` on, and the dialect that they turn out to be in."""

    def __init__(self, data: bytes, start: int, header: tuple[str, ...], source: str,
                 cells: Cells, separator: str) -> None:
        self.data, self.start, self.header, self.source = data, start, header, source
        self.wanted = tuple(h for h in header if cells.wanted(h))
        self.always = frozenset(h for h in self.wanted if cells.words(h))
        self.loose = self.always.union(
            h for h in header if cells.may_be_text(h) or h not in self.wanted)
        self.quoted = data.find(b'"', start) >= 0
        decimal = "." if separator == "," else decimal_of(data, start, separator)
        self.dialect = Dialect(separator, decimal or ".")
        self.known = decimal is not None

    def read(self) -> tuple[Mapping[str, Array], Mapping[str, tuple[str, ...]], int, Dialect]:
        """Return the columns of numbers (N,), nan where empty, those of words, N, and the dialect.

        Raises:
            BadInput: ragged rows, none at all, two decimal marks, or a cell that is not a number.
        """
        parts = list(self._parts())
        size = sum(p.size for p in parts)
        if not size:
            raise BadInput("has a header but no rows", self.source,
                           "Add at least one row of numbers")
        blocks = [p.block for p in parts if p.block is not None and not p.words]
        if len(blocks) == len(parts) and self.wanted == self.header and not self.always:
            whole = np.concatenate(blocks) if len(blocks) != 1 else blocks[0]
            return {h: whole[:, i] for i, h in enumerate(self.header)}, {}, size, self.dialect
        wordy = self.always.union(*(p.wordy for p in parts))
        return ({h: np.concatenate([self._numbers(p, h) for p in parts])
                 for h in self.wanted if h not in wordy},
                {h: tuple(chain.from_iterable(self._words(p, h) for p in parts))
                 for h in self.wanted if h in wordy}, size, self.dialect)

    def _parts(self) -> Iterator[_Part]:
        """Yield the rows part by part."""
        count, width = 0, len(self.header)
        fast, settled = self.known and not self.quoted, self.dialect.separator == ","
        for start, stop in self._spans():
            block = parse(self.dialect.plain(self.data[start:stop]), width) if fast else None
            if block is not None:
                part: _Part | None = _Part(len(block), block, (start, stop))
            else:
                if not settled:
                    self.dialect, settled = Dialect(self.dialect.separator, self._decimal()), True
                part = self._beside_words(start, stop) if not self.quoted else None
            if part is not None:
                count += part.size
                yield part
                continue
            for rows in self._rows(start, stop, count):
                yield self._slow(rows, count)
                count += len(rows)

    def _beside_words(self, start: int, stop: int) -> _Part | None:
        """Return lines whose words stand in the columns of words only, None where they do not."""
        chunk, width = self.data[start:stop], len(self.header)
        among = [i for i, h in enumerate(self.header) if h in self.loose]
        edges = cell_edges(chunk, width, self.dialect.separator) if among else None
        if edges is None:
            return None
        block = parse(self.dialect.plain(without_columns(chunk, edges, among)), width)
        if block is None:
            return None
        words = {self.header[i]: words_of(chunk, edges, i) for i in among
                 if self.header[i] in self.wanted}
        return _Part(len(block), block, (start, stop), words, self._wordy(words))

    def _wordy(self, words: Mapping[str, tuple[str, ...]]) -> frozenset[str]:
        """Return the columns of words that hold one."""
        return frozenset(h for h, cells in words.items() if h in self.always or (
            plain_column(cells, self.dialect) is None
            and not all(is_number(c, self.dialect) for c in cells)))

    def _spans(self) -> Iterator[tuple[int, int]]:
        """Yield where whole lines begin and end; all of them where quotes may hold line ends."""
        start, stop = self.start, len(self.data)
        while stop > start and self.data[stop - 1] == 10:
            stop -= 1
        while start < stop:
            # no line is as long as a chunk: that is refused before
            end = stop if self.quoted or stop - start <= CHUNK else self.data.rfind(
                b"\n", start, start + CHUNK)
            yield start, end
            start = end + 1

    def _rows(self, start: int, stop: int, count: int) -> Iterator[list[list[str]]]:
        """Yield the rows between two bytes, some at a time, without blank ones."""
        width, lines = len(self.header), self._lines(start, stop)
        reader = csv.reader(lines, strict=True, delimiter=self.dialect.separator)
        rows: list[list[str]] = []
        try:
            for row in reader:
                if len(row) != width:
                    if any(cell.strip() for cell in row):
                        raise _ragged(row, count + len(rows), self.header, self.source)
                    continue
                rows.append(row)
                if len(rows) == ROWS:
                    yield rows
                    count, rows = count + ROWS, []
        except csv.Error as error:
            raise BadInput(f"cannot be read as CSV ({error})",
                           f"{self.source}: row {count + len(rows) + 1}",
                           "Check the quotes and line ends there") from None
        if rows:
            yield rows

    def _lines(self, start: int, stop: int) -> Iterable[str]:
        if not self.quoted:
            return self.data[start:stop].decode("utf-8").split("\n")
        raw = io.BytesIO(self.data)
        raw.seek(start)
        return io.TextIOWrapper(raw, encoding="utf-8", newline="")

    def _decimal(self) -> str:
        """Return the decimal mark, told by the cells of the columns of numbers, or of all.

        A point where there is none; points and commas, in one cell or in two, are refused.
        """
        chosen = [h for h in self.header if h not in self.loose] or list(self.header)
        first: dict[str, str] = {}
        count = 0
        for span in self._spans():
            for rows in self._rows(*span, count):
                columns = dict(zip(self.header, zip(*rows, strict=True), strict=True))
                for name in chosen:
                    cells = columns[name]
                    whole = "".join(cells)
                    for mark in ".,":
                        if mark in whole and mark not in first:
                            row = next(i for i, cell in enumerate(cells) if mark in cell)
                            first[mark] = (f"row {count + row + 1}, column {name} "
                                           f"('{cells[row].strip()[:40]}')")
                count += len(rows)
        if len(first) == 2:
            raise BadInput(f"the numbers have decimal points in {first['.']} and commas in "
                           f"{first[',']}", self.source, "Save it with one decimal mark, and with "
                           "nothing between thousands")
        return next(iter(first), ".")

    def _slow(self, rows: list[list[str]], count: int) -> _Part:
        """Return some rows as columns; ``count``: rows before them."""
        words, numbers = dict[str, tuple[str, ...]](), dict[str, Array]()
        for name, given in zip(self.header, zip(*rows, strict=True), strict=True):
            if name not in self.wanted:
                continue
            spaced = len(f"-{'-'.join(given)}-".split()) > 1    # at either end of a cell
            cells = tuple([c.strip() for c in given]) if spaced else given
            if name in self.loose:
                words[name] = cells
            else:
                numbers[name] = self._column(cells, name, count)
        return _Part(len(rows), None, (0, 0), words, self._wordy(words), numbers)

    def _numbers(self, part: _Part, name: str) -> Array:
        """Return one column of a part (n,)."""
        if name in part.words:
            return self._column(part.words[name], name, 0)
        return part.numbers[name] if part.block is None else np.asarray(
            part.block[:, self.header.index(name)])

    def _words(self, part: _Part, name: str) -> Iterable[str]:
        """Return one column of a part as it stands in the file."""
        if name in part.words:
            return part.words[name]
        i, mark = self.header.index(name), self.dialect.separator
        lines = self.data[slice(*part.span)].decode("utf-8").split("\n")
        return (line.split(mark)[i].strip() for line in lines)

    def _column(self, cells: tuple[str, ...], name: str, count: int) -> Array:
        """Return one column (n,); refuse the first cell that is not a number."""
        found = plain_column(cells, self.dialect)
        if found is not None:
            return found
        out, point = np.empty(len(cells)), self.dialect.decimal == "."
        for i, cell in enumerate(cells):
            if not is_number(cell, self.dialect):
                raise _no_number(cell, name, f"{self.source}: row {count + i + 1}, column {name}",
                                 point)
            out[i] = float(cell if point else cell.replace(",", ".")) if cell else np.nan
        return out


def _no_number(cell: str, name: str, where: str, point: bool) -> BadInput:
    """Return the refusal of a cell; ``point``: whether decimals have points."""
    hint = "Write a number, or leave the cell empty if it was not measured"
    if point and re.fullmatch(r"[-+]?\d+,\d+", cell):
        hint = "Write a decimal point instead of the comma"
    if cell == name:
        hint = ("The header stands again in this row, as where files were put together: "
                "take the line out")
    shown = cell if len(cell) <= 40 else cell[:37] + "..."
    return BadInput(f"'{shown}' is not a number", where, hint)


def _ragged(row: list[str], index: int, header: tuple[str, ...], source: str) -> BadInput:
    where = f"{source}: row {index + 1}"
    what = f"the row has {len(row)} cells, but the header has {len(header)}"
    if len(row) == 1 and row[0].count(";") + 1 == len(header):
        return BadInput("the cells are separated by semicolons, the header by commas", where,
                        "Save it with commas between columns and points in the numbers")
    whole = sum(re.fullmatch(r"\s*[-+]?\d+\s*", c) is not None for c in row)
    if len(row) > len(header) and 2 * whole > len(row):
        return BadInput(f"{what}; it looks like decimal commas", where,
                        "Save it with points in the numbers and commas between columns")
    return BadInput(what, where, "Give every row one cell for each column; leave a missing value "
                                 "empty")
