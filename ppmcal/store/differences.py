"""Two versions of a file, value by value: tables, trees and text, each by its own reader."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import yaml

from ppmcal.store.tally import (
    DIFFERS,
    ESTIMATES,
    NOTHING,
    OPEN,
    SAME,
    FileCheck,
    Tally,
    ValueDifference,
    first_apart,
    in_text,
    is_sentence,
    judge,
    numeric,
)

OWN = ("version", "environment", "numpy", "python")
"""Keys of a provenance that are not the same elsewhere, and are shown apart."""
PAGES = ("html", "svg")
"""Endings of files that say and draw what other files hold."""


def compared(name: str, then: bytes, now: bytes, exact: bool, root: bytes = b"",
             reword: bool = False, later: bool = False) -> FileCheck:
    """Return how a file differs from an earlier one.

    Args:
        name: of the file; how it is read follows from its ending.
        then: its bytes.
        now: those that come out today.
        exact: whether they must be the same; else within bounds.
        root: where paths in it began today, and not then.
        reword: whether it is of another version, which may have other words for the same.
        later: whether that is a later one, which may have keys and columns that are not known yet.
    """
    if root and not _is_binary(now):
        now = now.replace(root, b"")
    if then == now:
        return FileCheck(file=name)
    found, readable = Tally(exact, root.decode(errors="surrogateescape"), reword, later), True
    try:
        _READERS.get(name.rpartition(".")[2], _text)(then, now, found)
    except (ValueError, OSError, yaml.YAMLError, csv.Error, ImportError, RecursionError):
        readable = False
    if (found.count or found.texts or found.unknown) and readable:
        return found.of(name)
    if exact or not readable:    # no value differs that can be named: spaces, or a picture
        return FileCheck(file=name, status=DIFFERS, count=1, worst=ValueDifference(
            place=f"byte {first_apart(then, now)}", then=f"{len(then)} bytes",
            now=f"{len(now)} bytes"))
    return FileCheck(file=name, status=OPEN if _is_binary(then) else SAME)


# ---- tables


def _csv(then: bytes, now: bytes, found: Tally) -> None:
    """Count the cells of a CSV that differ; rows are numbered from 1, below the header."""
    def rows(content: bytes) -> Iterator[list[str]]:
        return csv.reader(io.StringIO(content.decode(), newline=""))

    header, other = next(rows(then), []), next(rows(now), [])
    strange = {c for c, name in enumerate(header) if found.later and name not in other}
    for c in sorted(strange):
        found.strange(header[c])

    def earlier() -> Iterator[list[str]]:
        return iter([x for c, x in enumerate(row) if c not in strange] for row in rows(then))

    header = next(earlier(), [])
    if header != other:
        found.differ("header", ",".join(header), ",".join(other))
        return
    pairs = [(n, a, b) for n, (a, b) in enumerate(zip_longest(earlier(), rows(now)))
             if a != b]
    columns = {c for _, a, b in pairs if a and b for c, (x, y) in enumerate(
        zip(a, b, strict=False)) if x != y}
    scales = _scales(earlier(), columns)
    sigmas = {c: s for c in columns if (s := _sigma_column(header, c)) is not None}
    unit = header.index("unit") if "unit" in header else None
    for n, a, b in pairs:
        if a is None or b is None or len(a) != len(b) or len(a) != len(header):
            found.differ(f"row {n}", "a row" if a else NOTHING, "another" if b else NOTHING)
            continue
        for c, (x, y) in enumerate(zip(a, b, strict=True)):
            if x != y:
                judge(found, f"row {n}, {header[c]}", x, y, scales.get(c, 0.0),
                       numeric(a[sigmas[c]]) if c in sigmas else None,
                       "" if unit is None else a[unit])


def _scales(rows: Iterator[list[str]], columns: set[int]) -> dict[int, float]:
    """Return the largest number of each of some columns."""
    largest = dict.fromkeys(columns, 0.0)
    for row in rows:
        for c in columns:
            value = numeric(row[c]) if c < len(row) else None
            if value is not None and math.isfinite(value):
                largest[c] = max(largest[c], abs(value))
    return largest


def _sigma_column(header: Sequence[str], column: int) -> int | None:
    """Return the column with the standard deviations of a column's numbers, if there is one."""
    name = header[column]
    rest = re.sub(r"^(residual|before|after|error)_", "", name)
    names = [f"sigma_{name}", f"{name}_sigma", f"sigma_{rest}"]
    names += ["sigma"] * (name in ESTIMATES)
    return next((header.index(n) for n in names if n in header and n != name), None)


def _parquet(then: bytes, now: bytes, found: Tally) -> None:
    from pyarrow import BufferReader, parquet

    tables = [parquet.read_table(BufferReader(content)).to_pylist() for content in (then, now)]
    if found.root:
        tables[1] = [{k: v.replace(found.root, "") if isinstance(v, str) else v
                      for k, v in row.items()} for row in tables[1]]
    _walk(tables[0], tables[1], _Place("row"), found)


# ---- trees


@dataclass(frozen=True)
class _Place:
    """Where a value is in a tree, and what is known of its size."""

    path: str = ""
    scale: float = 0.0
    around: Mapping[str, Any] = field(default_factory=dict)

    def key(self, name: str, around: Mapping[str, Any]) -> _Place:
        return _Place(f"{self.path}.{name}" if self.path else name, 0.0, around)

    def item(self, label: object, scale: float) -> _Place:
        return _Place(f"{self.path}[{label}]", scale, self.around)


def _json(then: bytes, now: bytes, found: Tally) -> None:
    _walk(json.loads(then), json.loads(now), _Place(), found)


def _yaml(then: bytes, now: bytes, found: Tally) -> None:
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    a, b = (yaml.load(content, loader) for content in (then, now))
    _walk(a, b, _Place(), found)


def _walk(then: Any, now: Any, place: _Place, found: Tally) -> None:
    """Count the values of two trees that differ."""
    if isinstance(then, dict) and isinstance(now, dict):
        own = () if found.exact else OWN if place.path.endswith("provenance") else (
            OWN[:1] if not place.path else ())
        for key in dict.fromkeys([*then, *now]):
            at = place.key(str(key), then)
            if key in own:
                continue
            if key in then and key in now:
                _walk(then[key], now[key], at, found)
            elif found.later and key in then:
                found.strange(at.path)
            else:
                found.differ(at.path, then.get(key, NOTHING), now.get(key, NOTHING))
    elif isinstance(then, list) and isinstance(now, list):
        if len(then) != len(now):
            told = found.say if found.reword and then and now and all(
                isinstance(t, str) and is_sentence(place.path, t)
                for t in (*then, *now)) else found.differ
            told(place.path, f"{len(then)} entries", f"{len(now)} entries")
            return
        scale = max(_largest(then), place.scale)
        for n, (a, b) in enumerate(zip(then, now, strict=True)):
            label = a.get("name", n + 1) if isinstance(a, dict) else n + 1
            _walk(a, b, place.item(label, scale), found)
    elif then != now or type(then) is not type(now):
        unit, sigma = place.around.get("unit"), place.around.get("sigma")
        beside = place.path.rpartition(".")[2] in ESTIMATES and isinstance(sigma, float)
        judge(found, place.path, _float(then, now), _float(now, then), place.scale,
               sigma if beside else None, unit if isinstance(unit, str) else "")


def _float(value: Any, other: Any) -> Any:
    """Return a whole number beside one that is not as a float too: 1 and 1.0000000001."""
    with contextlib.suppress(OverflowError):    # of hundreds of digits: it stays what it is
        return float(value) if type(value) is int and isinstance(other, float) else value
    return value


def _largest(values: Sequence[Any]) -> float:
    """Return the largest number in nested lists."""
    return max((_largest(v) if isinstance(v, list) else abs(v) for v in values
                if isinstance(v, list | float)), default=0.0)


# ---- text


def _is_binary(content: bytes) -> bool:
    return b"\0" in content[:4096]


def _text(then: bytes, now: bytes, found: Tally, of_words: Callable[[str], bool] | None = None
          ) -> None:
    """Count the lines that differ; of what is not text nothing.

    Args:
        then: an earlier version.
        now: today's.
        found: what is counted.
        of_words: which lines are wording alone  [default: comments].
    """
    if _is_binary(then):
        return
    lines = [list(enumerate(c.decode().splitlines(), 1)) for c in (then, now)]
    if found.reword:
        of_words = of_words or _is_comment
        words = [[(n, t) for n, t in some if of_words(t)] for some in lines]
        for (n, a), (m, b) in zip_longest(*words, fillvalue=(0, NOTHING)):
            if a != b:
                found.say(f"line {n or m}", *_around(a, b))
        lines = [[(n, t) for n, t in some if not of_words(t)] for some in lines]
    for (n, a), (m, b) in zip_longest(*lines, fillvalue=(0, NOTHING)):
        if not (n and m):
            found.differ(f"line {n or m}", a, b)
        elif a != b:
            found.differ(f"line {n}", *_around(a, b), in_text(a, b))


def _page(then: bytes, now: bytes, found: Tally) -> None:
    """Count the lines that differ as wording: other files hold what they tell and draw."""
    _text(then, now, found, lambda _: True)


def _around(then: str, now: str) -> tuple[str, str]:
    """Return two lines about where they begin to differ."""
    start = max(first_apart(then.encode(), now.encode()) - 20, 0)
    return then[start:start + 60], now[start:start + 60]


def _is_comment(line: str) -> bool:
    """Whether a line of a configuration says something to people; Klipper's ``#*#`` are values."""
    line = line.lstrip()
    return line[:1] in ("#", ";") and not line.startswith("#*#")


_READERS: dict[str, Callable[[bytes, bytes, Tally], None]] = {
    "csv": _csv, "json": _json, "yaml": _yaml, "parquet": _parquet, **dict.fromkeys(PAGES, _page)}
