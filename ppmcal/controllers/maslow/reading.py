"""The log of a Maslow 4, and other lists of its belts' lengths, as runs of readings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ppmcal.controllers.ropes import RopeRun, places_of
from ppmcal.controllers.text import read_text
from ppmcal.errors import BadInput
from ppmcal.io.csv import csv_table
from ppmcal.limits import TABLE_BYTES
from ppmcal.linalg import Array
from ppmcal.notes import FINDING, Note
from ppmcal.store.inputs import read_bytes
from ppmcal.wording import pluralize

BELTS = ("bl", "br", "tr", "tl")
"""Counter-clockwise from the bottom left, as the firmware lists them."""
SHORTEST, LONGEST = 10.0, 20_000.0
"""No belt is shorter or longer, mm."""
LEAST_AREA = 1e4
"""Two sides of a frame span more, mm^2."""
FEWEST = 4
"""Places that a run needs: five coordinates of anchors are open, and a place says two numbers."""
KEYS = ("tlX", "tlY", "trX", "trY", "blX", "blY", "brX", "brY")
HEIGHTS = tuple(f"{belt}Z" for belt in BELTS)
"""Keys of what anchors are above the router's own plane, mm."""
NEEDED = ("tlX", "tlY", "trX", "trY", "brX")
"""Anchors' keys; bl is the origin, and brY 0 where nothing else is said."""
_CLBM = "CLBM"
_READING = re.compile(r"\{([^{}]*)\}")
_BELT = re.compile(rf"""["']?\b({'|'.join(BELTS)})\b["']?\s*[:=]\s*([^,;}}]*)""",
                   re.ASCII | re.IGNORECASE)
_OPENED = re.compile(rf"""\{{[^{{}}]*\b({'|'.join(BELTS)})\b["']?\s*[:=]""",
                     re.ASCII | re.IGNORECASE)
_KEY = re.compile(rf"(?<![A-Za-z])(?:maslow_)?({'|'.join(KEYS + HEIGHTS)})\s*[:=]\s*"
                  r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True)
class Log:
    """What a file holds: runs, keys of anchors, mm, and what of it was passed over."""

    runs: tuple[RopeRun, ...]
    keys: dict[str, float]
    findings: tuple[str, ...]


@dataclass
class _Run:
    """A run as it grows.

    Attributes:
        first: its first line.
        listed: whether it is of CLBM lines.
        whole: whether its list was closed.
        rows: of four lengths, with the line of each.
    """

    first: int
    listed: bool
    whole: bool = False
    rows: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)


def read_log(path: Path) -> Log:
    """Return the runs of a file and the keys of anchors in it.

    Raises:
        BadInput: no readings, a broken or implausible one, or no run with enough places.
    """
    data = read_bytes(path)
    text = data.decode("utf-8-sig", errors="replace")
    lines = text.splitlines()
    head = next((line for line in lines if line.strip()), "")
    if "{" not in head and set(BELTS) <= set(re.split(r"[,;\t\s]+", head.strip().lower())):
        runs, findings = [_table(data, path)], list[str]()
    else:
        runs, findings = _listed(lines, path)
    if not runs:
        raise BadInput("holds no readings of belts", str(path),
                       "Give the firmware's log with its CLBM lines, lists such as {bl:1631.15, "
                       "br:2729.87, tr:2400.60, tl:998.65}, or a CSV with columns bl, br, tr, tl")
    good = [run for run in runs if _places(run.joints) >= FEWEST]
    if not good:
        most = max(runs, key=lambda run: _places(run.joints))
        raise BadInput(f"a run has readings at {pluralize(_places(most.joints), 'place')}, and "
                       f"{FEWEST} are the least", f"{path}: {most.where}",
                       "Calibrate with more points: the firmware's grid has nine at least")
    findings += [Note(f"{path}: {run.where}: readings at {pluralize(_places(run.joints), 'place')} "
                      f"are no calibration, and left out: {FEWEST} are the least", FINDING)
                 for run in runs if _places(run.joints) < FEWEST]
    return Log(tuple(good), _keys(text), tuple(findings))


def read_keys(path: Path) -> dict[str, float]:
    """Return the anchors' keys of a ``maslow.yaml``, mm.

    Raises:
        BadInput: one that is needed is missing.
    """
    return keys_of(read_text(path, limit=TABLE_BYTES), str(path))


def keys_of(text: str, source: str) -> dict[str, float]:
    """Return the anchors' keys in a text, mm.

    Raises:
        BadInput: one that is needed is missing.
    """
    keys = _keys(text)
    if missing := [k for k in NEEDED if k not in keys]:
        raise BadInput(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing",
                       source, "Give the machine's maslow.yaml, with lines such as "
                       "Maslow_tlX: 0.0")
    if not goes_round(anchors_of(keys)):
        raise BadInput("the anchors bl, br, tr and tl do not go round counter-clockwise: they are "
                       "in one line, or the frame is mirrored", source,
                       "Check tlX ... brY: x goes right and y up, mm")
    return keys


def anchors_of(keys: Mapping[str, float]) -> Array:
    """Return the anchors (4, 2), mm, in the order of :data:`BELTS`; what is not said is 0."""
    return np.array([[keys.get(f"{belt}{axis}", 0.0) for axis in "XY"] for belt in BELTS])


def heights_of(keys: Mapping[str, float]) -> Array:
    """Return how far anchors (4,) are above the plane, mm, in the order of :data:`BELTS`."""
    return np.abs([keys.get(key, 0.0) for key in HEIGHTS])


def goes_round(anchors: Array) -> bool:
    """Return whether anchors (4, 2) or (4, 3), mm, are corners of a frame, counter-clockwise."""
    if not np.all(np.abs(anchors) <= LONGEST):
        return False
    x, y = (np.roll(anchors, -1, axis=0) - anchors).T[:2]    # of the sides
    return bool(np.all(x * np.roll(y, -1) - y * np.roll(x, -1) > LEAST_AREA))


def _keys(text: str) -> dict[str, float]:
    """Return the anchors' keys in a text, the last of each."""
    return {name[:2].lower() + name[2:].upper(): float(value) for name, value in _KEY.findall(text)}


def _places(joints: Array) -> int:
    return int(places_of(joints)[-1])


def _table(data: bytes, path: Path) -> RopeRun:
    """Return the one run of a CSV."""
    table = csv_table(data, str(path), lambda name: name.strip().lower() not in BELTS)
    columns = {name.strip().lower(): values for name, values in table.numbers.items()}
    if missing := [belt for belt in BELTS if belt not in columns]:
        raise BadInput(f"has no column {' and no column '.join(missing)}", f"{path}: header",
                       "Name the belts' columns bl, br, tr and tl")
    rows = np.column_stack([columns[belt] for belt in BELTS])
    for n, row in enumerate(rows, 1):
        _plausible(dict(zip(BELTS, row.tolist(), strict=True)), f"{path}: row {n}")
    return RopeRun(rows, f"rows 1 to {len(rows)}")


def _listed(lines: list[str], path: Path) -> tuple[list[RopeRun], list[str]]:
    """Return the runs of a log, and what to say of them.

    A CLBM line is a run; one with a single reading goes on with the one before, as the firmware
    logs a calibration under way, and one that repeats the run before it and adds to it takes its
    place. Plain lists are a run until anything else comes.
    """
    runs: list[_Run] = []
    growing = 0
    open_ = False
    for number, line in enumerate(lines, 1):
        if not _OPENED.search(line):
            open_ = open_ and runs[-1].listed and not runs[-1].whole and line.strip() in ("", "]")
            if open_ and line.strip() == "]":
                runs[-1].whole, open_ = True, False
            continue
        rows = [(number, row) for row in _readings(line, f"{path}: line {number}")]
        listed = _CLBM in line
        goes_on = open_ and not listed and (not runs[-1].listed or not runs[-1].whole)
        single = listed and len(rows) == 1 and bool(runs) and runs[-1].listed
        if goes_on or single:
            runs[-1].rows += rows
        elif listed and runs and runs[-1].listed and [r for _, r in rows[:len(runs[-1].rows)]] == [
                r for _, r in runs[-1].rows]:
            growing += 1
            runs[-1].rows = rows
        else:
            runs.append(_Run(number, listed, rows=rows))
        runs[-1].whole = "]" in line
        open_ = True
    told = [f"{path}: {growing} of the CLBM lines repeat the line before and add to it: the last "
            "of them counts"] if growing else []
    return [RopeRun(np.array([row for _, row in run.rows]),
                     f"lines {run.first} to {run.rows[-1][0]}" if run.rows[-1][0] > run.first
                     else f"line {run.first}") for run in runs], told


def _readings(line: str, where: str) -> Iterator[tuple[float, ...]]:
    """Yield the lengths of each reading of a line, in the order of :data:`BELTS`."""
    parts = _READING.findall(line)
    if line.count("{") != line.count("}") or not parts:
        raise BadInput("a reading is cut off", where,
                       "Take the rest of it out of the file, or log it again")
    for inside in parts:
        given: dict[str, float] = {}
        for name, words in _BELT.findall(inside):
            belt = name.lower()
            if belt in given:
                raise BadInput(f"a reading has {belt} twice", where,
                               "Take the line as the firmware wrote it")
            try:
                given[belt] = float(words)
            except ValueError:
                raise BadInput(f"{belt} is '{words.strip()[:40]}', not a length in mm", where,
                               "Take the line as the firmware wrote it, or out of the file"
                               ) from None
        if missing := [belt for belt in BELTS if belt not in given]:
            raise BadInput(f"a reading has no {' and no '.join(missing)}", where,
                           "All four belts have to be read at every place: take the reading out "
                           "of the file")
        _plausible(given, where)
        yield tuple(given[belt] for belt in BELTS)


def _plausible(given: dict[str, float], where: str) -> None:
    """Refuse what is not a belt's length, mm."""
    for belt, length in given.items():
        if not SHORTEST <= length <= LONGEST:
            raise BadInput(f"{belt} is {length:g}, which is implausible for a belt's length in mm",
                           where, f"Lengths are mm, from {SHORTEST:g} to {LONGEST:g}: take the "
                           "reading out of the file if it is worthless")
