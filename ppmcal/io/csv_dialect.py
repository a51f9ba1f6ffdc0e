"""How a CSV is written, and its plain numbers, parsed many at a time.

What separates the columns, and the mark in decimal numbers: spreadsheets in much of Europe write
decimal commas, and then semicolons or tabs between columns. Where commas separate the columns, a
decimal comma cannot be told from the next cell: such a file is refused.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic_core import from_json

from ppmcal.errors import BadInput
from ppmcal.linalg import Array

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "spaces"}
_QUOTED = re.compile(r'"[^"]*"')
_DECLARED = re.compile(rb"\A\"?sep=([,;\t])\"?\n")
_NUMERIC = b"0123456789+-.,eE\nnaN "
PLAIN = re.compile(r"[-+]?(\d+(?:\.\d*)?|\.\d+)([eE][-+]?\d+)?|nan|NaN|NAN|[-+]?(inf|Inf|INF)",
                   re.ASCII)
"""What counts as a number in a cell."""


@dataclass(frozen=True)
class Dialect:
    """Separator of the columns, and mark in the numbers: a point, or a comma beside another."""

    separator: str = ","
    decimal: str = "."

    def __str__(self) -> str:
        """Return ``separated by semicolons, decimal commas``."""
        return (f"separated by {SEPARATORS[self.separator]}, decimal "
                f"{'points' if self.decimal == '.' else 'commas'}")

    def plain(self, rows: bytes) -> bytes:
        """Return rows of this dialect in the one in which all are parsed: commas and points."""
        if self == Dialect():
            return rows
        return rows.translate(bytes.maketrans(f"{self.decimal}{self.separator}".encode(), b".,"))


def declared(data: bytes) -> tuple[bytes, str | None]:
    """Return a CSV without its first line ``sep=;``, which spreadsheets write, and that mark."""
    found = _DECLARED.match(data[:16])
    return (data[found.end():], found[1].decode()) if found else (data, None)


def separator_of(data: bytes, source: str) -> str:
    """Return what separates the columns, told by the header and the first row under it.

    Raises:
        BadInput: the header is separated by another mark than the rows.
    """
    lines = (line for line in data[:1 << 20].split(b"\n", 8)[:8] if line.strip())
    header, row = ([_QUOTED.sub("", line.decode("utf-8", "replace")) for line in lines]
                   + ["", ""])[:2]
    agreed = next((m for m in "\t;," if m in header and header.count(m) == row.count(m)), None)
    if agreed:
        return agreed
    if "," in header:
        return ","
    mark = next((m for m in "\t;" if m in header), ",")
    if mark != "," and mark not in row and (other := next((m for m in ",;\t" if m in row), "")):
        raise BadInput(f"the header is separated by {SEPARATORS[mark]}, the rows by "
                       f"{SEPARATORS[other]}", f"{source}: header",
                       "Save it with the same mark throughout, such as commas between columns")
    return mark


def decimal_of(data: bytes, start: int, separator: str) -> str | None:
    """Return the decimal mark of plain numbers from byte ``start`` on.

    None where only the cells can tell: where there are points and commas.
    """
    if separator == "," or data.find(b",", start) < 0:
        return "."
    return None if data.find(b".", start) >= 0 else ","


# ---- plain numbers


def is_number(cell: str, dialect: Dialect) -> bool:
    """Return whether a stripped cell is a number or empty."""
    if dialect.decimal == ",":
        cell = cell.replace(",", ".")
    return not cell or PLAIN.fullmatch(cell) is not None


def is_float(cell: str) -> bool:
    """Whether Python takes a word for a number, in whatever spelling."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def plain_column(cells: tuple[str, ...], dialect: Dialect) -> Array | None:
    """Return stripped cells as numbers (n,), nan where empty; None where one of them is not plain.

    None says nothing yet: a cell may be a number in a spelling that only :func:`is_number` knows.
    """
    flat = ",".join(cells) if dialect.decimal == "." else ";".join(cells)
    if not flat.isascii():
        return None
    raw = flat.encode("ascii")
    if dialect.decimal != ".":
        raw = raw.translate(bytes.maketrans(b",;", b".,"))
    if raw.count(b",") != len(cells) - 1 or b"\n" in raw or raw.translate(None, _NUMERIC):
        return None
    return _numbers(_filled(raw).replace(b"nan", b"NaN"), len(cells))


def parse(chunk: bytes, width: int) -> Array | None:
    """Return the numbers (n, width) of whole lines, None where they are not plain."""
    if chunk.translate(None, _NUMERIC):
        return None
    if b" " in chunk:    # a cell of spaces is empty; NumPy takes it for -1
        chunk = _unspaced(chunk)
    edges = cell_edges(chunk, width, ",")
    if edges is None or (width == 1 and np.any(np.diff(edges, axis=1) < 2)):
        return None
    chunk = _filled(chunk)
    block = _numbers(chunk.replace(b"nan", b"NaN").replace(b"\n", b","))
    return None if block is None or block.size % width else block.reshape(-1, width)


def _unspaced(chunk: bytes) -> bytes:
    """Take out spaces around cells; a run of them within a cell shrinks to one."""
    while b"  " in chunk:    # half as many each time; a pattern would begin at every space
        chunk = chunk.replace(b"  ", b" ")
    for mark in (b",", b"\n"):
        chunk = chunk.replace(b" " + mark, mark).replace(mark + b" ", mark)
    return chunk.strip(b" ")


def _numbers(flat: bytes, size: int | None = None) -> Array | None:
    """Return numbers separated by commas, as many as there are cells, else None.

    They are parsed as a JSON list, four times as fast as by NumPy and correctly rounded, unless
    some are written as JSON does not know them: +1, 01, .5.
    """
    try:
        numbers = np.array(from_json(b"[" + flat + b"]"), dtype=float)
    except (ValueError, OverflowError, TypeError):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                numbers = np.fromstring(flat.decode("ascii"), dtype=float, sep=",")
            except (ValueError, DeprecationWarning):
                return None
    size = flat.count(b",") + 1 if size is None else size
    return numbers if numbers.shape == (size,) else None


def cell_edges(chunk: bytes, width: int, separator: str) -> NDArray[np.int64] | None:
    """Return where the marks around the cells of whole lines stand (n, width + 1).

    None where the lines are ragged.
    """
    raw = np.frombuffer(chunk, dtype=np.uint8)
    ends = np.append(np.flatnonzero(raw == 10), raw.size)
    marks = np.flatnonzero(raw == ord(separator))
    if marks.size != ends.size * (width - 1):
        return None
    edges = np.column_stack([np.concatenate([[-1], ends[:-1]]), marks.reshape(ends.size, width - 1),
                             ends])
    return None if np.any(np.diff(edges, axis=1) < 1) else edges


def words_of(chunk: bytes, edges: NDArray[np.int64], column: int) -> tuple[str, ...]:
    """Return one column's cells, stripped; ``edges``: of :func:`cell_edges`."""
    starts, stops = (edges[:, column] + 1).tolist(), edges[:, column + 1].tolist()
    cells = [chunk[a:b] for a, b in zip(starts, stops, strict=True)]
    known = {cell: cell.decode("utf-8").strip() for cell in set(cells)}    # most stand often
    return tuple([known[cell] for cell in cells])


def without_columns(chunk: bytes, edges: NDArray[np.int64], among: Sequence[int]) -> bytes:
    """Return whole lines with zeros in every cell of some columns."""
    raw = np.frombuffer(chunk, dtype=np.uint8)
    inside = np.zeros(raw.size + 1, dtype=np.int8)
    out = raw.copy()
    for i in among:
        starts, stops = edges[:, i] + 1, edges[:, i + 1]
        full = stops > starts
        inside[starts[full]] += 1
        inside[stops[full]] -= 1
    # 0, 10, 0.0, 0.00, ...: a number of any length
    out[np.cumsum(inside[:-1], dtype=np.int8) > 0] = ord("0")
    for i in among:
        starts, size = edges[:, i] + 1, edges[:, i + 1] - edges[:, i] - 1
        out[starts[size == 2]] = ord("1")
        out[starts[size > 2] + 1] = ord(".")
    return out.tobytes()


def _filled(chunk: bytes) -> bytes:
    """Write NaN into empty cells."""
    if not (b",," in chunk or b",\n" in chunk or b"\n," in chunk or chunk[:1] in (b",", b"")
            or chunk[-1:] == b","):
        return chunk
    for _ in range(2):
        chunk = chunk.replace(b",,", b",NaN,")
    chunk = chunk.replace(b"\n,", b"\nNaN,").replace(b",\n", b",NaN\n")
    if chunk[:1] in (b",", b""):
        chunk = b"NaN" + chunk
    return chunk + b"NaN" if chunk[-1:] == b"," else chunk
