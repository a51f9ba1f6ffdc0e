"""Lists of points as trackers export them: with or without a header, separated in any way.

A list without a header has in each row a name (or groups and a name), x, y, z and perhaps a time.
Above the rows there may be remarks, a heading of several lines, and a line of units; between the
rows remarks and blank lines.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.errors import BadInput
from ppmcal.io.clock import is_time
from ppmcal.io.csv import cleaned

_NUMBER = re.compile(r"[-+]?(\d+(?:\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_CLUTTER = re.compile(r"\s*(//|[#!%](?!\s*\d))")
"""Begins a remark."""
_HALF = re.compile(r"(\d:\d\d(?::\d\d(?:[.,:]\d+)?)?) +([AaPp][Mm])\b")
_MOMENT = re.compile(r"(\d{4}-\d\d?-\d\d?|\d\d?[./]\d\d?[./]\d{4}) +(\d\d?:\d\d)")
_UNIT = re.compile(r"[\[(]?\s*"
                   r"(?:(?:m|mm|um|µm|in|inch|rad|deg|°|s|ms|min|h|C|°C|F|K|-|1)\s*)?[\])]?")
FORM = "Write in each row a name, x, y, z and perhaps a time in s, or a header above them"
ABOVE = 200
"""Rows begin in one of the first so many lines, or the first one is the header."""


@dataclass(frozen=True)
class Split:
    """How lines fall into cells: at a mark, or at one or several spaces."""

    mark: str

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line, without empty ones at its end."""
        if self.mark == "  ":
            cells = re.split(r"\s{2,}|\t", line.strip())
        elif '"' in line and self.mark != " ":
            cells = next(csv.reader([line], delimiter=self.mark, skipinitialspace=True))
        else:
            cells = line.split(None if self.mark == " " else self.mark)
        cells = [c.strip().strip('"') for c in cells]
        while cells and not cells[-1]:
            cells.pop()
        return cells

    def is_number(self, cell: str) -> bool:
        """Whether a cell holds a number, with a decimal comma where that separates no cells."""
        return _NUMBER.fullmatch(cell if self.mark == "," else cell.replace(",", ".")) is not None

    def numbers(self, line: str) -> int:
        """Return how many cells of a line are numbers."""
        return sum(map(self.is_number, self.cells(line)))

    def separates(self, line: str) -> bool:
        """Whether a line may be a row: it has three numbers, and no other mark between its cells.

        At its spaces ``Pose;Leg 1 [mm];Leg 2 [mm];Leg 3 [mm]`` has three numbers too.
        """
        if self.numbers(line) < 3:
            return False
        marked = [c for c in self.cells(line) if (";" in c or "," in c) and not self.is_number(c)]
        return self.mark != " " or (len(marked) < 2 and line.strip().count("\t") < 3)


SPLITS = tuple(map(Split, ("\t", ";", ",", " ")))


def with_header(data: bytes, source: str) -> tuple[bytes, tuple[str, ...]]:
    """Return a file as a CSV with a header, and the remarks that stood above it.

    The columns of a list without one are ``group1`` ..., ``pose``, ``x``, ``y``, ``z`` and
    perhaps ``time``. What is a CSV with a header stays as it is, but for remarks.

    Raises:
        BadInput: rows of numbers that are not name, x, y, z and time.
    """
    lines = [line for line in cleaned(data, source).decode("utf-8").split("\n") if line.strip()]
    body = [i for i, line in enumerate(lines) if not _CLUTTER.match(line)]
    if not body:
        raise BadInput("holds nothing but remarks", source, FORM)
    found = next(((i, s) for i in body[:ABOVE] for s in SPLITS if s.separates(lines[i])), None)
    if found is None:
        remarks, rows = lines[:body[0]], lines[body[0]:]
        spaced = not any(mark in rows[0] for mark in "\t;,") and len(rows[0].split()) > 3
        text = "\n".join("\t".join(r.split()) for r in rows) if spaced else "\n".join(rows)
        return text.encode() + b"\n", _bare(remarks)
    start, split = found
    if split.mark == " ":
        split, lines = _spaced(lines, start)
    names, heading, start = _heading(lines, start, split)
    remarks = [line for line in lines[:start] if line not in heading]
    rows = [line for line in lines[start:]
            if not _CLUTTER.match(line) or split.numbers(line) >= 3]
    return _as_csv(names or _names(rows, split, source), rows, split), _bare(remarks)


def _bare(remarks: Sequence[str]) -> tuple[str, ...]:
    return tuple(line.strip() for line in remarks)


def _spaced(lines: list[str], start: int) -> tuple[Split, list[str]]:
    """Return whether several spaces separate cells, as in columns under each other, or each one."""
    wide = Split("  ")
    rows = [line for line in lines[start:] if not _CLUTTER.match(line)]
    counts = {len(wide.cells(line)) for line in rows}
    if len(counts) == 1 and min(counts) >= 4 and wide.numbers(rows[0]) >= 3:
        return wide, lines
    lines = [_HALF.sub(r"\1\2", line) for line in lines]
    if not any("date" in line.lower().split() for line in lines[:start]):
        lines = [_MOMENT.sub(r"\1T\2", line) for line in lines]
    return Split(" "), lines


def _heading(lines: list[str], start: int, split: Split) -> tuple[list[str], list[str], int]:
    """Return names of columns and the lines that they stand in, if any, and where rows begin."""
    width = len(split.cells(lines[start]))
    above = [(i, _cells(lines[i], split, width)) for i in range(start)]
    whole = [(i, c) for i, c in above if c is not None and not _CLUTTER.match(lines[i])]
    if not whole:
        last = next(((i, c) for i, c in reversed(above) if c and _names_axes(c)), None)
        if last is None and start and not _CLUTTER.match(lines[start - 1]) and (
                len(cells := split.cells(lines[start - 1])) > 2):
            last = start - 1, cells    # of another width: the reader says so
        return ([], [], start) if last is None else (last[1], [lines[last[0]]], start)
    first, names = whole[0]
    if all(names) and len(set(names)) == len(names):
        unit = next((c for i, c in whole if i == first + 1 and _is_units(c)), None)
        used = [first] + [first + 1] * (unit is not None)
        # what else is above the first row of numbers are rows without them
        return _with_units(names, unit), [lines[i] for i in used], used[-1] + 1
    unit = next((c for i, c in whole[1:] if i == start - 1 and _is_units(c)), None)
    named = [(i, c) for i, c in whole if c is not unit]
    last_names = named[-1][1]
    known = [n for n in last_names if n]
    if len(set(known)) < len(known) or len(known) < 3:
        last_names = _merged([c for _, c in named])
    return _with_units(last_names, unit), [lines[i] for i, _ in whole], start


def _cells(line: str, split: Split, width: int) -> list[str] | None:
    """Return the cells of a line of a heading; None where they are not those of the rows."""
    text = re.sub(r"^\s*(//+|[#!%]+)\s*", "", line)
    for way in (split, Split("  ")) if split.mark in (" ", "  ") else (split,):
        cells = way.cells(text)
        exact = split.mark in (" ", "  ")
        many = cells if exact else cells + [""] * (width - len(cells))
        # empty cells at the end of a row leave more names than cells
        if len(many) == width or (len(cells) > width and not exact):
            return many if len(many) > 1 and len(cells) > 1 and not split.numbers(text) else None
    return None


def _names_axes(cells: list[str]) -> bool:
    first = {c.lower()[:1] for c in cells}
    return {"x", "y", "z"} <= first


def _is_units(cells: list[str]) -> bool:
    return all(_UNIT.fullmatch(c) for c in cells) and any(c.strip("[]()- 1") for c in cells)


def _with_units(names: list[str], units: list[str] | None) -> list[str]:
    if units is None:
        return names
    bare = [u.strip("[]() ") for u in units] + [""] * len(names)
    return [f"{n} [{u}]" if u else n for n, u in zip(names, bare, strict=False)]


def _merged(rows: list[list[str]]) -> list[str]:
    """Return one name per column of several lines; what stands above goes on to the right."""
    filled = []
    for cells in rows[:-1]:
        out, last = list[str](), ""
        for cell in cells:
            last = cell or last
            out.append(last)
        filled.append(out)
    return [" ".join(filter(None, parts)) for parts in zip(*filled, rows[-1], strict=False)]


def _as_csv(names: list[str], rows: list[str], split: Split) -> bytes:
    """Return names and rows separated by one mark."""
    if split.mark in (" ", "  "):
        return "\n".join("\t".join(c) for c in [names, *map(split.cells, rows)]).encode() + b"\n"
    mark = split.mark
    quoted = [f'"{n}"' if mark in n else n for n in names]
    width = len(quoted)
    body = [_without_tail(row, mark, width) for row in rows]
    return (mark.join(quoted) + "\n" + "\n".join(body) + "\n").encode()


def _without_tail(row: str, mark: str, width: int) -> str:
    """Return a row without separators at its end that no column belongs to."""
    row = row.strip(" " if mark == "\t" else " \t")
    kept = row.rstrip(mark + " ")
    tail = row[len(kept):].split(mark)
    spare = min(row.count(mark) - width, len(tail) - 2) + 1
    if spare < 1 or '"' in row:
        return row
    return (kept + mark.join(tail[:len(tail) - spare])).rstrip(" ")


def _names(rows: list[str], split: Split, source: str) -> list[str]:
    """Return the names of the columns of a list without a header."""
    cells = split.cells(rows[0])
    timed = len(cells) > 3 and is_time(cells[-1])
    count = len(cells) - timed
    words = next(i for i, c in enumerate(cells) if split.is_number(c))
    named = words or int(count > 3)
    numbers = count - named
    if not named or numbers not in ((3,) if timed else (3, 4)) or (
            split.numbers(rows[0]) < count - words):
        raise BadInput(f"the first row has {named or 'no'} name{'s' if named > 1 else ''} and "
                       f"{numbers} numbers, and there is no header", f"{source}: row 1", FORM)
    if split.mark == " " and words and len(rows) > 1:
        first = {tuple(split.cells(r)[:words]) for r in rows}
        if len(first) == 1:
            raise BadInput(f"all points are called {' '.join(cells[:words])}, or their names have "
                           "spaces in them like those between the columns", source,
                           "Export it with tabs or semicolons between the columns")
    groups = [f"group{i}" for i in range(1, named)]
    return [*groups, "pose", "x", "y", "z", "time"][:named + numbers + timed]
