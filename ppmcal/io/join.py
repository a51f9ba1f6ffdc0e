"""Points of a tracker put beside the joint values at which they were measured."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.measurement_columns import row_list
from ppmcal.io.yaml import number_text

PARTIAL = "or leave out what matches nothing with --partial"


@dataclass(frozen=True)
class Join:
    """A joint log with points beside it, by ``name`` or ``time``; what was left out."""

    table: Table
    by: str
    findings: tuple[str, ...]


def join(log: Table, points: Table, by: str | None, tolerance: float, partial: bool) -> Join:
    """Return the rows of a joint log that have a point, with its columns.

    Args:
        log: with joint values.
        points: with what was measured.
        by: ``name``: ``pose`` of both is the same; ``time``: the nearest row of the log
            [default: name where names agree, else time].
        tolerance: how far two times may be apart, s.
        partial: leave out points and named rows that match nothing, and say so.

    Raises:
        BadInput: nothing to join by, what matches nothing or several rows, or a column
            that both have.
    """
    twice = [h for h in points.header if h in log.header and h not in ("pose", "time", "session")]
    if twice:
        raise BadInput(f"the joint log {log.source} has the column {', '.join(twice)} too",
                       f"{points.source}: header", "Write `ignore` for one of them in the sidecar, "
                       "by its header")
    by = by or _by(log, points)
    for table in (log, points):
        column = "pose" if by == "name" else "time"
        if column not in table.header:
            raise BadInput(f"there is no column {column} to join by {by}", f"{table.source}: "
                           "header", "Name it in the header, or join by the other: --join")
    rows, taken, findings = (_by_name(log, points, partial) if by == "name"
                             else _by_time(log, points, tolerance, partial))
    order = np.lexsort((taken, rows))
    left, right = _rows(log, rows[order]), _rows(points, taken[order])
    more = [h for h in points.header if h not in log.header]
    return Join(replace(left, header=(*log.header, *more),
                        numbers={**left.numbers, **{h: right.numbers[h] for h in more
                                                    if h in right.numbers}},
                        text={**left.text, **{h: right.text[h] for h in more if h in right.text}},
                        size=len(rows)), by, tuple(findings))


def _by(log: Table, points: Table) -> str:
    if "pose" in log.header and "pose" in points.header:
        mine, theirs = set(names(log)), set(names(points))
        if mine & theirs or not ("time" in log.header and "time" in points.header):
            return "name"
    if "time" in log.header and "time" in points.header:
        return "time"
    raise BadInput(f"its points cannot be put beside the rows of {log.source}: they share neither "
                   "names nor times", points.source, "Give both a column pose (the name of the "
                   "point) or time (s), or name them under `read.columns` in the sidecar")


def names(table: Table) -> list[str]:
    """Return the names of N points; of ``Collection::Group::Point`` the last part."""
    if "pose" in table.numbers:
        return [number_text(v) if np.isfinite(v) else "" for v in table.numbers["pose"].tolist()]
    return [name.rsplit("::", 1)[-1].strip() for name in table.text["pose"]]


def _by_name(log: Table, points: Table, partial: bool
             ) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return rows of log and points that belong together, and what was left out."""
    mine, theirs = names(log), names(points)
    where: dict[str, list[int]] = defaultdict(list)
    for i, name in enumerate(mine):
        where[name].append(i)
    double = sorted(i for n in set(theirs) & set(mine) if len(where[n]) > 1 for i in where[n])
    if double:
        raise BadInput(f"the point '{mine[double[0]]}' belongs to several rows of {log.source} "
                       f"({row_list(np.array(double))})", points.source,
                       "Give each row of the log a name of its own, or join by time: --join time")
    there = set(theirs)
    alone = np.array([i for i, n in enumerate(theirs) if n not in where or not n], dtype=int)
    bare = np.array([i for i, n in enumerate(mine) if n not in there or not n], dtype=int)
    findings = _left(points, alone, [theirs[i] for i in alone], log, partial)
    findings += _left(log, bare, [mine[i] for i in bare], points, partial)
    taken = np.setdiff1d(np.arange(len(theirs)), alone)
    return _some(np.array([where[theirs[i]][0] for i in taken], dtype=int), taken, log, points,
                 findings)


def _by_time(log: Table, points: Table, tolerance: float, partial: bool
             ) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return rows of log and points that are nearest in time, and what was left out."""
    mine, theirs = log.numbers["time"], points.numbers["time"]
    known = np.flatnonzero(np.isfinite(mine))
    if not known.size:
        raise BadInput("no row has a time", f"{log.source}: column time", "Fill it in")
    order = known[np.argsort(mine[known], kind="stable")]
    times = mine[order]
    after = np.searchsorted(times, theirs)
    near = after + np.array([[-1], [0], [1]])
    inside = (near >= 0) & (near < len(times))
    near = np.clip(near, 0, len(times) - 1)
    apart = np.where(inside, np.abs(times[near] - theirs), np.inf)
    best = np.argsort(apart, axis=0, kind="stable")
    near, apart = (np.take_along_axis(a, best, axis=0) for a in (near, apart))
    nearest, good = order[near[0]], apart[0] <= tolerance
    with np.errstate(invalid="ignore"):
        even = good & (apart[1] - apart[0] <= 1e-2 * tolerance)
    if even.any():
        i = int(np.flatnonzero(even)[0])
        raise BadInput(f"{row_list(np.flatnonzero(even))}: two rows of {log.source} are equally "
                       f"near in time ({row_list(np.sort(order[near[:2, i]]))} for row {i + 1})",
                       points.source, "Give a smaller --tolerance, or join by name: --join name")
    taken = np.flatnonzero(good)
    rows = nearest[taken]
    crowded = np.flatnonzero(np.bincount(rows, minlength=1)[rows] > 1) if rows.size else rows
    if crowded.size:
        raise BadInput(f"{row_list(taken[crowded])} are nearest in time to the same row of "
                       f"{log.source} (row {rows[crowded[0]] + 1})", points.source,
                       "Give a smaller --tolerance, or join by name: --join name")
    alone = np.flatnonzero(~good)
    findings = _left(points, alone, [f"{theirs[i]:g} s" for i in alone], log, partial,
                     f" within {tolerance:g} s")
    return _some(rows, taken, log, points, findings)


def _left(table: Table, rows: np.ndarray, called: list[str], other: Table, partial: bool,
          within: str = "") -> list[str]:
    """Return the sentence on rows that match nothing; refuse them unless they may be left out."""
    if not rows.size:
        return []
    shown = ", ".join(called[:5]) + (" ..." if len(called) > 5 else "")
    what = f"{row_list(rows)} ({shown}): nothing in {other.source} matches{within}"
    if not partial:
        raise BadInput(what, table.source, f"Correct names or times, {PARTIAL}")
    return [f"{table.source}: {what}; left out."]


def _some(rows: np.ndarray, taken: np.ndarray, log: Table, points: Table, findings: list[str]
          ) -> tuple[np.ndarray, np.ndarray, list[str]]:
    if not rows.size:
        raise BadInput(f"no point matches a row of {log.source}", points.source,
                       "Check that both are of one run, or join otherwise: --join")
    return rows, taken, findings


def _rows(table: Table, rows: np.ndarray) -> Table:
    return replace(table, numbers={h: v[rows] for h, v in table.numbers.items()},
                   text={h: tuple(v[i] for i in rows) for h, v in table.text.items()})
