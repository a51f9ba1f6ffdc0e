"""Lists of points as trackers export them: with or without a header, separated in any way.

A list without a header has in each row a name (or groups and a name), x, y, z and perhaps a time.
"""

from __future__ import annotations

import re

from ppmcal.errors import BadInput
from ppmcal.io.csv import cleaned

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_CLUTTER = re.compile(r"\s*(//|[#!%](?!\s*\d))")
"""Begins a remark above a list."""
FORM = "Write in each row a name, x, y, z and perhaps a time in s, or a header above them"


def with_header(data: bytes, source: str) -> tuple[bytes, tuple[str, ...]]:
    """Return a file as a CSV with a header, and the remarks that stood above it.

    The columns of a list without one are ``pose``, ``x``, ``y``, ``z`` and perhaps ``time``.

    What is a CSV with a header stays as it is, but for remarks above it.

    Args:
        data: of the file.
        source: what messages call it.

    Raises:
        BadInput: rows of numbers that are no name, x, y, z and time.
    """
    lines = cleaned(data, source).decode("utf-8").split("\n")
    first = next((i for i, line in enumerate(lines)
                  if line.strip() and not _CLUTTER.match(line)), len(lines))
    remarks, lines = tuple(r.strip() for r in lines[:first] if r.strip()), lines[first:]
    return _as_csv(lines, source), remarks


def _as_csv(lines: list[str], source: str) -> bytes:
    rows = [line for line in lines if line.strip()]
    if not rows:
        raise BadInput("holds nothing but remarks", source, FORM)
    separator = next((s for s in ("\t", ";", ",", None) if _numbers(rows[0], s) >= 3), "")
    if separator == "":
        spaced = not any(mark in rows[0] for mark in "\t;,") and len(rows[0].split()) > 3
        return _tabbed(rows) if spaced else "\n".join(lines).encode()
    header = _header(rows, separator, source)
    if separator is None:
        return "\t".join(header).encode() + b"\n" + _tabbed(rows)
    if separator != ",":
        rows = [line.rstrip(separator + " ") for line in rows]
    else:
        rows = [line.rstrip(", ") for line in rows]
    return (separator.join(header) + "\n" + "\n".join(rows) + "\n").encode()


def _tabbed(rows: list[str]) -> bytes:
    return ("\n".join("\t".join(row.split()) for row in rows) + "\n").encode()


def _cells(row: str, separator: str | None) -> list[str]:
    """Return the cells of a row, without empty ones at its end; None: separated by spaces."""
    cells = [c.strip().strip('"') for c in row.split(separator)]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _is_number(cell: str, separator: str | None) -> bool:
    return _NUMBER.fullmatch(cell if separator == "," else cell.replace(",", ".")) is not None


def _numbers(row: str, separator: str | None) -> int:
    return sum(_is_number(c, separator) for c in _cells(row, separator))


def _header(rows: list[str], separator: str | None, source: str) -> list[str]:
    """Return the names of the columns of a list without a header."""
    cells = _cells(rows[0], separator)
    words = next(i for i, c in enumerate(cells) if _is_number(c, separator))
    named = words or int(len(cells) > 3)
    numbers = len(cells) - named
    if not named or numbers not in (3, 4) or _numbers(rows[0], separator) < len(cells) - words:
        raise BadInput(f"the first row has {named or 'no'} name{'s' if named > 1 else ''} and "
                       f"{numbers} numbers, and there is no header", f"{source}: row 1", FORM)
    if separator is None and words and len(rows) > 1:
        first = {tuple(_cells(r, separator)[:words]) for r in rows}
        if len(first) == 1:
            raise BadInput(f"all points are called {' '.join(cells[:words])}, or their names have "
                           "spaces in them like those between the columns", source,
                           "Export it with tabs or semicolons between the columns")
    groups = [f"group{i}" for i in range(1, named)]
    return [*groups, "pose", "x", "y", "z", "time"][:len(groups) + 1 + numbers]
