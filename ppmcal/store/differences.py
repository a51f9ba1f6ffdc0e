"""Two versions of a file, value by value.

Where bytes need not be the same, a number may be off by :data:`OF_SCALE` of the largest number of
its column (of its list in JSON), by :data:`OF_SIGMA` of the sigma that stands beside it, or by
:data:`LEAST`, whichever is most; a number within text by one step of its last digit. Everything
else (names, verdicts, statuses, counts, which rows were used) must be the same.
"""

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

from ppmcal.wording import number

SAME, WITHIN, DIFFERS, OPEN = "same", "within bounds", "differs", "not compared"
OF_SCALE, OF_SIGMA, LEAST = 1e-6, 1e-3, 1e-9
BOUNDS = {"of_scale": OF_SCALE, "of_sigma": OF_SIGMA, "least": LEAST}
OWN = ("version", "environment", "numpy", "python")
"""Keys of a provenance that are not the same elsewhere, and are shown apart."""
ESTIMATES = ("value", "error", "data", "mean", "estimate")
"""Names of numbers whose standard deviation is the ``sigma`` beside them."""
NOTHING = "(nothing)"
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.\d+(?:[eE][-+]?\d+)?(?![\w.])")
"""A number within text: with a point, so that neither names nor counts are taken for one."""


@dataclass(frozen=True)
class ValueDifference:
    """A value that is not as it was: where, both as text, and how far apart, in ``unit``."""

    place: str = ""
    then: str = ""
    now: str = ""
    size: float | None = None
    unit: str = ""

    def words(self) -> str:
        """Return it in words."""
        if not (self.then or self.now):
            return self.place
        apart = f", apart by {number(self.size, 3)} {self.unit}".rstrip() if self.size else ""
        return f"{self.place}: {short_text(self.then)} there, {short_text(self.now)} now{apart}"


@dataclass(frozen=True)
class FileCheck:
    """A file against the one that comes out today.

    ``count``: values that differ; ``worst``: the one that is farthest from what is allowed.
    """

    file: str = ""
    status: str = SAME
    edited: bool = False
    count: int = 0
    worst: ValueDifference | None = None

    def words(self) -> str:
        """Return what is to say of it besides its status."""
        edited = "edited since ppmcal wrote it" * self.edited
        worst = self.worst.words() if self.worst else ""
        if worst and self.count > 1:
            worst = f"farthest apart at {worst}"
        return "; ".join(t for t in (edited, worst) if t)


@dataclass
class Tally:
    """Differences of a file so far: how many, the worst, and whether all are within bounds."""

    exact: bool
    root: str = ""
    count: int = 0
    over: float = -1.0
    within: bool = True
    worst: ValueDifference | None = None

    def differ(self, place: str, then: object, now: object, over: float = math.inf,
               size: float | None = None, unit: str = "") -> None:
        """Count one that is ``over`` times what is allowed; inf where nothing is."""
        self.count += 1
        self.within = self.within and over <= 1.0
        if over > self.over:
            self.over = over
            self.worst = ValueDifference(place=place, then=str(then), now=str(now), size=size,
                                         unit=unit)

    def of(self, name: str) -> FileCheck:
        """Return what was found of a file."""
        status = SAME if not self.count else WITHIN if self.within and not self.exact else DIFFERS
        return FileCheck(file=name, status=status, count=self.count, worst=self.worst)


def compared(name: str, then: bytes, now: bytes, exact: bool, root: bytes = b"") -> FileCheck:
    """Return how a file differs from an earlier one.

    Args:
        name: of the file; how it is read follows from its ending.
        then: its bytes.
        now: those that come out today.
        exact: whether they must be the same; else within bounds.
        root: where paths in it began today, and not then.
    """
    if root and not _is_binary(now):
        now = now.replace(root, b"")
    if then == now:
        return FileCheck(file=name)
    found, readable = Tally(exact, root.decode(errors="surrogateescape")), True
    try:
        _READERS.get(name.rpartition(".")[2], _text)(then, now, found)
    except (ValueError, OSError, yaml.YAMLError, csv.Error, ImportError, RecursionError):
        readable = False
    if found.count and readable:
        return found.of(name)
    if exact or not readable:    # no value differs that can be named: spaces, or a picture
        return FileCheck(file=name, status=DIFFERS, count=1, worst=ValueDifference(
            place=f"byte {_first(then, now)}", then=f"{len(then)} bytes", now=f"{len(now)} bytes"))
    return FileCheck(file=name, status=OPEN if _is_binary(then) else SAME)


def short_text(value: object) -> str:
    """Return what is shown of a value, which may be long."""
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _first(then: bytes, now: bytes) -> int:
    """Return the number, from 1, of the first byte that differs."""
    low, high = 0, min(len(then), len(now))
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if then[:middle] == now[:middle] else (low, middle - 1)
    return low + 1


def _numeric(value: object) -> float | None:
    """Return a cell or a JSON number as a float, None for anything else."""
    if isinstance(value, float | str):
        try:
            return float(value)
        except ValueError:
            return None
    return None


def _judge(found: Tally, place: str, then: Any, now: Any, scale: float, sigma: float | None,
           unit: str = "") -> None:
    """Count two values that are not the same; counts, without a point, may not be off at all."""
    a, b = _numeric(then), _numeric(now)
    counts = str(then).lstrip("-").isdigit() and str(now).lstrip("-").isdigit()
    if a is not None and b is not None and math.isfinite(a) and math.isfinite(b):
        allowed = max(OF_SCALE * max(scale, abs(a)), OF_SIGMA * (sigma or 0.0), LEAST)
        found.differ(place, then, now, math.inf if counts else abs(a - b) / allowed, abs(a - b),
                     unit)
    elif isinstance(then, str) and isinstance(now, str):
        found.differ(place, then, now, _in_text(then, now))
    else:
        found.differ(place, then, now)


def _in_text(then: str, now: str) -> float:
    """Return how far two texts are apart in steps of their numbers' last digits; inf in words."""
    if _NUMBER.sub("#", then) != _NUMBER.sub("#", now):
        return math.inf
    return max((_steps(a, b) for a, b in zip(_NUMBER.findall(then), _NUMBER.findall(now),
                                             strict=True) if a != b), default=0.0)


def _steps(then: str, now: str) -> float:
    a, b = float(then), float(now)
    step = max(_last_digit(then), _last_digit(now))
    return abs(a - b) / max(1.001 * step, OF_SCALE * abs(a), LEAST)


def _last_digit(text: str) -> float:
    """Return what one step of the last digit is worth."""
    digits, _, power = text.lower().partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))


# ---- tables


def _csv(then: bytes, now: bytes, found: Tally) -> None:
    """Count the cells of a CSV that differ; rows are numbered from 1, below the header."""
    def rows(content: bytes) -> Iterator[list[str]]:
        return csv.reader(io.StringIO(content.decode(), newline=""))

    header, other = next(rows(then), []), next(rows(now), [])
    if header != other:
        found.differ("header", ",".join(header), ",".join(other))
        return
    pairs = [(n, a, b) for n, (a, b) in enumerate(zip_longest(rows(then), rows(now)))
             if a != b]
    columns = {c for _, a, b in pairs if a and b for c, (x, y) in enumerate(
        zip(a, b, strict=False)) if x != y}
    scales = _scales(rows(then), columns)
    sigmas = {c: s for c in columns if (s := _sigma_column(header, c)) is not None}
    unit = header.index("unit") if "unit" in header else None
    for n, a, b in pairs:
        if a is None or b is None or len(a) != len(b) or len(a) != len(header):
            found.differ(f"row {n}", "a row" if a else NOTHING, "another" if b else NOTHING)
            continue
        for c, (x, y) in enumerate(zip(a, b, strict=True)):
            if x != y:
                _judge(found, f"row {n}, {header[c]}", x, y, scales.get(c, 0.0),
                       _numeric(a[sigmas[c]]) if c in sigmas else None,
                       "" if unit is None else a[unit])


def _scales(rows: Iterator[list[str]], columns: set[int]) -> dict[int, float]:
    """Return the largest number of each of some columns."""
    largest = dict.fromkeys(columns, 0.0)
    for row in rows:
        for c in columns:
            value = _numeric(row[c]) if c < len(row) else None
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
        own = OWN if place.path.endswith("provenance") and not found.exact else ()
        for key in dict.fromkeys([*then, *now]):
            at = place.key(str(key), then)
            if key in own:
                continue
            if key in then and key in now:
                _walk(then[key], now[key], at, found)
            else:
                found.differ(at.path, then.get(key, NOTHING), now.get(key, NOTHING))
    elif isinstance(then, list) and isinstance(now, list):
        if len(then) != len(now):
            found.differ(place.path, f"{len(then)} entries", f"{len(now)} entries")
            return
        scale = max(_largest(then), place.scale)
        for n, (a, b) in enumerate(zip(then, now, strict=True)):
            label = a.get("name", n + 1) if isinstance(a, dict) else n + 1
            _walk(a, b, place.item(label, scale), found)
    elif then != now or type(then) is not type(now):
        unit, sigma = place.around.get("unit"), place.around.get("sigma")
        beside = place.path.rpartition(".")[2] in ESTIMATES and isinstance(sigma, float)
        _judge(found, place.path, _float(then, now), _float(now, then), place.scale,
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


def _text(then: bytes, now: bytes, found: Tally) -> None:
    """Count the lines that differ; of what is not text nothing."""
    if _is_binary(then):
        return
    for n, (a, b) in enumerate(zip_longest(then.decode().splitlines(), now.decode().splitlines()),
                               1):
        if a is None or b is None:
            found.differ(f"line {n}", NOTHING if a is None else a, NOTHING if b is None else b)
        elif a != b:
            start = max(_first(a.encode(), b.encode()) - 20, 0)
            found.differ(f"line {n}", a[start:start + 60], b[start:start + 60], _in_text(a, b))


_READERS: dict[str, Callable[[bytes, bytes, Tally], None]] = {
    "csv": _csv, "json": _json, "yaml": _yaml, "parquet": _parquet}
