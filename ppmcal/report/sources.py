"""Reading what the commands wrote; every refusal names file and place.

Nothing here trusts the files: they may be cut off, edited by hand or written by another
version. A missing key is not an error, a value of the wrong kind is.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from ppmcal.codec import AGAIN
from ppmcal.errors import BadInput
from ppmcal.io.results.comparison import ComparisonRecord
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.limits import TABLE_BYTES, TABLE_COLUMNS, refuse_shape
from ppmcal.linalg import Array
from ppmcal.report.format import LARGEST
from ppmcal.report.records import Columns
from ppmcal.store.inputs import refuse_no_file, track_input

CHUNK = 50_000
P = TypeVar("P", IdentificationRecord, ComparisonRecord)

_NUMBERS = frozenset({"row", "used", "x", "y", "nominal", "value", "error", "sigma", "sigma_data",
                      "tolerance", "low", "high", "p_value", "survival", "sigma_position",
                      "sigma_rotation"})
_PREFIXES = ("before_", "after_", "geometry_", "sigma_", "error_", "q_", "cmd_", "rate_")
_COMMANDS = re.compile(r"x|y|(q|cmd)_.+|(error_(position|rotation)_(before|after))"
                       r"|sigma_(position|rotation)")
_KINEMATICS = re.compile(r"[xyz]|r[xyz]|euler_[123]|quat_[xyzw]|(q|rate)_.+"
                         r"|condition|time")


def is_number_column(name: str) -> bool:
    """Whether a column of that name holds numbers in ppmcal's own files."""
    return name in _NUMBERS or name.startswith(_PREFIXES)


def is_command_number(name: str) -> bool:
    """Whether a column of commands.csv is ppmcal's own; others come from the user's targets."""
    return _COMMANDS.fullmatch(name) is not None


def is_kinematics_number(name: str) -> bool:
    """Whether a column of kinematics.csv holds numbers that are drawn."""
    return _KINEMATICS.fullmatch(name) is not None


def is_shown_of_kinematics(name: str) -> bool:
    """Whether a column of kinematics.csv is drawn, or says how its row went."""
    return is_kinematics_number(name) or name in ("t", "row", "own", "status", "reason")


def read_columns(path: Path, whole: bool = True, wanted: Callable[[str], bool] | None = None,
                 numeric: Callable[[str], bool] = is_number_column) -> Columns:
    """Return a CSV as columns.

    Args:
        path: the file.
        whole: refuse a file whose last line has no end: a written file that was cut off.
        wanted: which columns to keep (default all).
        numeric: which columns hold numbers, the others are kept as text.
    """
    source = str(path)
    track_input(path)
    try:
        with open(path, encoding="utf-8-sig", newline="", opener=_opened) as stream:
            found = os.fstat(stream.fileno())
            refuse_no_file(found, path)
            TABLE_BYTES.refuse(found.st_size, source)
            if whole:
                _refuse_open_end(path)
            return _read(csv.reader(stream, strict=True), source, wanted or (lambda _: True),
                         numeric)
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", source,
                       "Check the path and its permissions") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"is not UTF-8 text (byte {error.start})", source, AGAIN) from None


def _opened(path: str, flags: int) -> int:
    """Open a file without waiting for what is a pipe."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _refuse_open_end(path: Path) -> None:
    with path.open("rb") as stream:
        if stream.seek(0, 2) == 0:
            raise BadInput("is empty", str(path), AGAIN)
        stream.seek(-1, 2)
        if stream.read(1) not in b"\r\n":
            raise BadInput("is cut off: its last line has no end", f"{path}: last line", AGAIN)


def _read(reader: Iterator[list[str]], source: str, wanted: Callable[[str], bool],
          numeric: Callable[[str], bool]) -> Columns:
    """Read header and rows in chunks."""
    count = 0
    try:
        header = tuple(c.strip() for c in next(reader, []))
        if not any(header):
            raise BadInput("has no header", f"{source}: line 1", AGAIN)
        TABLE_COLUMNS.refuse(len(header), f"{source}: header")
        if len(set(header)) != len(header):
            double = next(h for h in header if header.count(h) > 1)
            raise BadInput(f"two columns are called '{double}'", f"{source}: header", AGAIN)
        numbers: dict[str, list[Array]] = {h: [] for h in header if wanted(h) and numeric(h)}
        text: dict[str, list[str]] = {h: [] for h in header if wanted(h) and h not in numbers}
        seen: dict[str, str] = {}
        while rows := list(islice(reader, CHUNK)):
            rows = _even(rows, header, source, count)
            for name, cells in zip(header, zip(*rows, strict=True), strict=False):
                if name in numbers:
                    block = _floats(cells, f"{source}: row", count, name)
                    _refuse_absurd(block, f"{source}: row", count, name)
                    numbers[name].append(block)
                elif name in text:
                    text[name].extend(seen.setdefault(c, c) for c in cells)
            count += len(rows)
            refuse_shape(count, len(header), source)
    except csv.Error as error:
        raise BadInput(f"cannot be read as CSV ({error})", f"{source}: after row {count}",
                       AGAIN) from None
    joined = {k: np.concatenate(v) if v else np.zeros(0) for k, v in numbers.items()}
    return Columns(source, header, joined, {k: tuple(v) for k, v in text.items()}, count)


def _even(rows: list[list[str]], header: tuple[str, ...], source: str, start: int
          ) -> list[list[str]]:
    """Return the rows without blank lines; refuse one of another length."""
    rows = [r for r in rows if r]
    for i, row in enumerate(rows):
        if len(row) != len(header):
            raise BadInput(f"the row has {len(row)} cells, but the header has {len(header)}",
                           f"{source}: row {start + i + 1}", AGAIN)
    return rows


def _refuse_absurd(block: Array, where: str, start: int, name: str) -> None:
    """Refuse finite numbers whose square would overflow."""
    absurd = np.flatnonzero(np.isfinite(block) & (np.abs(block) > LARGEST))
    if absurd.size:
        raise BadInput(f"{block[absurd[0]]:g} is out of range",
                       f"{where} {start + int(absurd[0]) + 1}, column {name}", AGAIN)


def _floats(cells: tuple[str, ...], where: str, start: int, name: str) -> Array:
    """Return one column's part (N,), nan where empty; refuse what is not a number."""
    try:
        return np.fromiter(map(float, cells), dtype=float, count=len(cells))
    except ValueError:
        out = np.full(len(cells), np.nan)
    words = {"": np.nan, "true": 1.0, "false": 0.0}
    for i, cell in enumerate(cells):
        plain = cell.strip().lower()
        try:
            out[i] = words[plain] if plain in words else float(plain)
        except ValueError:
            raise BadInput(f"'{cell[:40]}' is not a number",
                           f"{where} {start + i + 1}, column {name}", AGAIN) from None
    return out


def with_parameters(record: P, table_of: Callable[[], Columns | None]) -> P:
    """Return a record that has no parameters with those of a CSV."""
    rows = None if record.parameters else table_of()
    if rows is None:
        return record
    table = [{**{k: v[i] for k, v in rows.text.items()},
              **{k: float(v[i]) if np.isfinite(v[i]) else None for k, v in rows.numbers.items()}}
             for i in range(rows.size)]
    return record.changed(parameters=type(record).checked(
        {"parameters": table}, Path(rows.source)).parameters)
