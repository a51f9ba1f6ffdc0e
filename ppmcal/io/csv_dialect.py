"""How a CSV is written: what separates its columns, and the mark in its decimal numbers.

Spreadsheets in much of Europe write decimal commas, and then semicolons or tabs between columns.
Where commas separate the columns, a decimal comma cannot be told from the next cell: such a file
is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ppmcal.errors import BadInput

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "spaces"}
_QUOTED = re.compile(r'"[^"]*"')
_DECLARED = re.compile(rb"\A\"?sep=([,;\t])\"?\n")
ONE_MARK = "Save it with one decimal mark, and with nothing between thousands"


@dataclass(frozen=True)
class Dialect:
    """Separator of the columns, and mark in the numbers: a point, or a comma beside another."""

    separator: str = ","
    decimal: str = "."

    def __str__(self) -> str:
        """Return ``separated by semicolons, decimal commas``."""
        return (f"separated by {SEPARATORS[self.separator]}, decimal "
                f"{'points' if self.decimal == '.' else 'commas'}")

    @property
    def plain(self) -> bool:
        """Whether it is the one in which everything is parsed: commas and points."""
        return self == Dialect()

    def translation(self) -> bytes:
        """Return the table of ``bytes.translate`` from this dialect to commas and points."""
        ours, theirs = self.separator.encode(), self.decimal.encode()
        return bytes.maketrans(ours, b",") if theirs == b"." else bytes.maketrans(
            ours + theirs, b",.")


def declared(data: bytes) -> tuple[bytes, str | None]:
    """Return a CSV without its first line ``sep=;``, which spreadsheets write, and that mark."""
    found = _DECLARED.match(data[:16])
    return (data[found.end():], found[1].decode()) if found else (data, None)


def separator_of(data: bytes, source: str) -> str:
    r"""Return what separates the columns, told by the header and the first row under it.

    Args:
        data: of the file, UTF-8, with ``\n`` line ends.
        source: what messages call it.

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


def marks_of_cells(columns: Iterable[tuple[str, Sequence[str]]], before: int,
                   first: dict[str, str]) -> None:
    """Note in ``first`` where each decimal mark stands first in columns of numbers.

    Args:
        columns: name and n cells of each.
        before: rows before these.
        first: mark -> place and cell, so far.
    """
    for name, cells in columns:
        whole = "".join(cells)
        for mark in ".,":
            if mark in whole and mark not in first:
                row = next(i for i, cell in enumerate(cells) if mark in cell)
                first[mark] = (f"row {before + row + 1}, column {name} "
                               f"('{cells[row].strip()[:40]}')")


def one_mark(first: Mapping[str, str], source: str) -> str:
    """Return the only decimal mark of a file, a point where there is none.

    Raises:
        BadInput: points and commas both occur, in one cell or in two.
    """
    if len(first) == 2:
        raise BadInput(f"the numbers have decimal points in {first['.']} and commas in "
                       f"{first[',']}", source, ONE_MARK)
    return next(iter(first), ".")
