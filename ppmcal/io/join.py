"""Points of a tracker put beside the joint values at which they were measured."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.foreign import pose_names
from ppmcal.linalg import Array
from ppmcal.notes import Note
from ppmcal.wording import abbreviate_list, row_list

NEARER = ("Give a smaller --tolerance, join by name (--join name), or take joint values between "
          "the rows: --interpolate")
PARTIAL = "or leave out what matches nothing with --partial"


class NoMatch(BadInput):
    """Rows of one file that match none of the other."""


NOTHING: Mapping[str, float] = {}
CARRIED = ("dir_", "pose", "session")
"""Columns that begin so are those of the nearest row, not interpolated."""
MOVING = 1e-3
"""Rows equally near matter where joints differ by more than this part of their range."""


@dataclass(frozen=True)
class Join:
    """A joint log with points beside it, by ``name`` or ``time``.

    ``findings``: what was left out; ``how``: how far apart in time the two are.
    """

    table: Table
    by: str
    findings: tuple[str, ...]
    how: str = ""


def join(log: Table, points: Table, by: str | None, tolerance: float, partial: bool,
         interpolate: bool = False, turns: Mapping[str, float] = NOTHING) -> Join:
    """Return the rows of a joint log that have a point, with its columns.

    Args:
        log: with joint values.
        points: with what was measured.
        by: ``name``: ``pose`` of both is the same; ``time``: the nearest row of the log
            [default: name where names agree, else time].
        tolerance: how far two times may be apart, s; of an interpolated point, from the row
            before it and from that after it.
        partial: leave out points and named rows that match nothing, and say so.
        interpolate: take joint values between the two rows about a point's time; needs ``time``.
        turns: column of a rotary joint -> one turn in its unit: from 179 to -179 deg are 2 deg.

    Raises:
        BadInput: nothing to join by, what matches nothing or several rows, or a column
            that both have.
    """
    twice = [h for h in points.header if h in log.header and h not in ("pose", "time", "session")]
    if twice:
        raise BadInput(f"the joint log {log.source} has the column {', '.join(twice)} too",
                       f"{points.source}: header", "Write `ignore` for one of them in the sidecar, "
                       "by its header")
    by = by or ("time" if interpolate else _by(log, points))
    for table in (log, points):
        column = "pose" if by == "name" else "time"
        if column not in table.header:
            raise BadInput(f"there is no column {column} to join by {by}", f"{table.source}: "
                           "header", "Name it in the header, or join by the other: --join")
    how = ""
    if interpolate:
        if by == "name":
            raise BadInput("joint values are interpolated in time, not by name", "--interpolate",
                           "Give --join time, or leave one of the two out")
        left, taken, findings, how = _between(log, points, tolerance, partial, turns)
    else:
        if by == "name":
            rows, taken, findings = _by_name(log, points, partial)
        else:
            rows, taken, findings, how = _by_time(log, points, tolerance, partial, turns)
        order = np.lexsort((taken, rows))
        left, taken = rows_of(log, rows[order]), taken[order]
    right = rows_of(points, taken)
    more = right.without(log.header)
    return Join(replace(left.put({**more.numbers, **more.text}), size=len(taken),
                        header=(*log.header, *more.header)), by, tuple(findings), how)


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
    return [name.rsplit("::", 1)[-1].strip() for name in pose_names(table)]


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
    _refuse_unnamed_targets(theirs, points)
    there = set(theirs)
    alone = np.array([i for i, n in enumerate(theirs) if n not in where or not n], dtype=int)
    bare = np.array([i for i, n in enumerate(mine) if n not in there or not n], dtype=int)
    findings = _left(points, alone, [theirs[i] for i in alone], log, partial)
    findings += _left(log, bare, [mine[i] for i in bare], points, partial)
    taken = np.setdiff1d(np.arange(len(theirs)), alone)
    return _some(np.array([where[theirs[i]][0] for i in taken], dtype=int), taken, log, points,
                 findings)


def _refuse_unnamed_targets(names: list[str], points: Table) -> None:
    """Refuse points of one name in several groups: they may be several targets."""
    if "target" in points.header or "pose" not in points.text:
        return
    groups: dict[str, set[str]] = defaultdict(set)
    for name, whole in zip(names, points.text["pose"], strict=True):
        groups[name].add(whole)
    name, several = next(((n, g) for n, g in groups.items() if len(g) > 1), ("", set()))
    if several:
        raise BadInput(f"the point '{name}' stands in several groups "
                       f"({', '.join(sorted(several)[:3])})", points.source,
                       "If they are targets on the platform, say how names are made, such as "
                       "--names '{target}::{pose}'; else join by time, or split the file")


def _in_time(log: Table) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a log that have a time, in its order, and these times."""
    mine = log.numbers["time"]
    known = np.flatnonzero(np.isfinite(mine))
    if not known.size:
        raise BadInput("no row has a time", f"{log.source}: column time", "Fill it in")
    order = known[np.argsort(mine[known], kind="stable")]
    return order, mine[order]


def _by_time(log: Table, points: Table, tolerance: float, partial: bool,
             turns: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, list[str], str]:
    """Return rows of log and points nearest in time, what was left out, and how far apart."""
    theirs = points.numbers["time"]
    order, times = _in_time(log)
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
    step = _joint_steps(_smooth(log, order, turns), order[near[0]], order[near[1]])
    even &= (step > MOVING) | (times[near[0]] == times[near[1]])
    if even.any():
        i = int(np.flatnonzero(even)[0])
        raise BadInput(f"{row_list(np.flatnonzero(even))}: two rows of {log.source} are equally "
                       f"near in time ({row_list(np.sort(order[near[:2, i]]))} for row {i + 1})",
                       points.source, NEARER)
    taken = np.flatnonzero(good)
    rows = nearest[taken]
    # several targets are seen at one row, each once
    target = np.unique(points.labels("target"), return_inverse=True)[1][taken] if (
        "target" in points.header) else np.zeros_like(rows)
    place = rows * (int(target.max(initial=0)) + 1) + target
    crowded = np.flatnonzero(np.bincount(place, minlength=1)[place] > 1) if rows.size else rows
    if crowded.size:
        raise BadInput(f"{row_list(taken[crowded])} are nearest in time to the same row of "
                       f"{log.source} (row {rows[crowded[0]] + 1})", points.source, NEARER)
    alone = np.flatnonzero(~good)
    findings = _left(points, alone, [f"{theirs[i]:g} s" for i in alone], log, partial,
                     f" within {tolerance:g} s")
    how = ""
    if taken.size:
        how = f"Times are at most {apart[0, taken].max():.3g} s apart"
        beside = taken[apart[1, taken] <= tolerance]
        most = float(step[beside].max()) if beside.size else 0.0
        if most > MOVING:
            how += (f", and joints move by up to {100 * most:.2g} % of their range between the "
                    "rows about a point: --interpolate takes the values between them")
    return *_some(rows, taken, log, points, findings), how


def unwrapped(values: Array, turn: float) -> Array:
    """Return readings of a rotary joint in time (N,) without their jumps of one turn.

    A jump is over half a turn. Readings that go over more than one turn count turns by themselves.
    """
    known = np.flatnonzero(np.isfinite(values))
    if not known.size or np.ptp(values[known]) > turn * (1.0 + 1e-9):
        return values
    out = values.copy()
    out[known] = np.unwrap(values[known], period=turn)
    return out


def _smooth(log: Table, order: np.ndarray, turns: Mapping[str, float]) -> Table:
    """Return the log with rotary joints that do not jump in time."""
    numbers = dict(log.numbers)
    for name in set(turns) & set(numbers):
        values = numbers[name].copy()
        values[order] = unwrapped(values[order], turns[name])
        numbers[name] = values
    return replace(log, numbers=numbers)


def _as_logged(name: str, values: Array, log: Table, turns: Mapping[str, float]) -> Array:
    """Return joint values brought back into the turn that the log keeps to."""
    turn, theirs = turns.get(name, 0.0), log.numbers[name]
    if not turn or not np.isfinite(theirs).any():
        return values
    least, most = float(np.nanmin(theirs)), float(np.nanmax(theirs))
    if most - least > turn * (1.0 + 1e-9):
        return values
    usual = [low for low in (-turn / 2.0, 0.0) if low <= least and most <= low + turn]
    low = usual[0] if usual else (least + most - turn) / 2.0
    out: Array = np.where((values < low) | (values > low + turn),
                          np.mod(values - low, turn) + low, values)
    return out


def _joint_steps(log: Table, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the largest difference of two rows' joint values, in parts of the joint's range."""
    out = np.zeros(len(one))
    for name, values in log.numbers.items():
        if name.startswith(("q_", "cmd_")) and np.isfinite(values).any():
            reach = float(np.nanmax(values) - np.nanmin(values))
            if reach > 0.0:
                out = np.fmax(out, np.abs(values[one] - values[other]) / reach)
    return out


def _between(log: Table, points: Table, tolerance: float, partial: bool,
             turns: Mapping[str, float]) -> tuple[Table, np.ndarray, list[str], str]:
    """Return the log between its rows at the times of points, those points, and what is left."""
    turned = [h for h in log.header if h.startswith(("cmd_r", "cmd_quat"))]
    if turned:
        raise BadInput(f"{turned[0]} is of a rotation, which is not interpolated", log.source,
                       "Give joint values, or leave --interpolate out")
    order, times = _in_time(log)
    theirs = points.numbers["time"]
    after = np.clip(np.searchsorted(times, theirs, side="left"), 0, len(times) - 1)
    before = np.where(times[after] <= theirs, after, np.maximum(after - 1, 0))
    with np.errstate(invalid="ignore"):
        good = ((times[before] <= theirs) & (theirs <= times[after])
                & (theirs - times[before] <= tolerance) & (times[after] - theirs <= tolerance))
    alone, taken = np.flatnonzero(~good), np.flatnonzero(good)
    findings = _left(points, alone, [f"{theirs[i]:g} s" for i in alone], log, partial,
                     f" on both sides within {tolerance:g} s")
    _some(taken, taken, log, points, findings)
    taken = taken[np.argsort(theirs[taken], kind="stable")]
    low, high, at = before[taken], after[taken], theirs[taken]
    width = times[high] - times[low]
    part = np.where(width > 0.0, (at - times[low]) / np.where(width > 0.0, width, 1.0), 0.0)
    near = rows_of(log, order[np.where(part < 0.5, low, high)])
    smooth = _smooth(log, order, turns)
    numbers = {h: v if h.startswith(CARRIED) else _as_logged(
        h, smooth.numbers[h][order[low]] * (1.0 - part) + smooth.numbers[h][order[high]] * part,
        log, turns) for h, v in near.numbers.items()}
    step = _joint_steps(smooth, order[low], order[high])
    how = (f"Joint values are interpolated between rows at most {width.max():.3g} s apart, over "
           f"which joints move by up to {100 * step.max():.2g} % of their range")
    return replace(near, numbers={**numbers, "time": at}), taken, findings, how


def _left(table: Table, rows: np.ndarray, called: list[str], other: Table, partial: bool,
          within: str = "") -> list[str]:
    """Return the sentence on rows that match nothing; refuse them unless they may be left out."""
    if not rows.size:
        return []
    what = (f"{row_list(rows)} ({abbreviate_list(called)}): nothing in {other.source} "
            f"matches{within}")
    if not partial:
        raise NoMatch(what, table.source, f"Correct names or times, {PARTIAL}")
    return [Note(f"{table.source}: {what}; left out.")]


def _some(rows: np.ndarray, taken: np.ndarray, log: Table, points: Table, findings: list[str]
          ) -> tuple[np.ndarray, np.ndarray, list[str]]:
    if not rows.size:
        raise NoMatch(f"no point matches a row of {log.source}", points.source,
                       "Check that both are of one run, or join otherwise: --join")
    return rows, taken, findings


def rows_of(table: Table, rows: np.ndarray) -> Table:
    """Return some rows of a table."""
    return replace(table, size=len(rows), numbers={h: v[rows] for h, v in table.numbers.items()},
                   text={h: tuple(v[i] for i in rows) for h, v in table.text.items()})
