"""The joint log among the files that were read, and points put beside it on one clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.commands.read.options import ReadArguments
from ppmcal.commands.read.targets import found_offset, known_points, with_targets
from ppmcal.errors import BadInput
from ppmcal.io.clock import Clock, on_clock_of
from ppmcal.io.column_names import is_target
from ppmcal.io.csv import Table
from ppmcal.io.csv import joined as in_one
from ppmcal.io.foreign import ForeignTable, pose_names
from ppmcal.io.header import ANGULAR, ReadFile, declared, unit_of
from ppmcal.io.join import NoMatch, join, unwrapped
from ppmcal.io.measurement_columns import stacked
from ppmcal.io.reading import in_units
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import TURN, Units

FIND = "find"
LONGEST = 1e10
"""No two clocks differ by more, s."""


def sort_out(found: Sequence[ForeignTable], mechanism: Mechanism
             ) -> tuple[ForeignTable, list[ForeignTable]]:
    """Return the table that holds joints, and the lists of points.

    Raises:
        BadInput: none or several hold joints.
    """
    logs = [f for f in found if f.has_joints]
    sources = ", ".join(f.table.source for f in (logs or found))
    if len(logs) > 1:
        raise BadInput("several files hold joint values", sources, "Read each with its own points")
    if not logs:
        joints = [f"q_{a}" for a in mechanism.actuators]
        there = ", ".join(dict.fromkeys(h for f in found for h in f.ignored))
        raise BadInput(f"no file holds joint values ({', '.join(joints)})", sources,
                       "Name the columns under `read.columns` in a sidecar, such as "
                       f'{{{joints[0]}: "its header"}}'
                       + (f". Not understood: {there[:200]}" if there else ""))
    return logs[0], [f for f in found if f is not logs[0]]


def joined(log: ForeignTable, lists: Sequence[ForeignTable], asked: ReadArguments, block: ReadFile,
           mechanism: Mechanism, units: Units, place: str
           ) -> tuple[Table, tuple[str, ...], tuple[str, ...]]:
    """Return the log with the points beside it, or as it is where there are none.

    With findings, and what was done in sentences. ``units`` are those of columns that say nothing
    else.

    Raises:
        BadInput: lists that differ, clocks that cannot be compared, or as :func:`join`.
    """
    offset = _offset(asked.clock_offset)
    if not lists:
        for wanted, flag in ((asked.interpolate, "--interpolate"), (offset, "--clock-offset"),
                             (asked.join, "--join")):
            if wanted:
                raise BadInput("there is one table, and nothing to put beside it", flag,
                               "Give a list of points too, or leave the option out")
        table, said = _from_first(log.table, log.clock)
        called = pose_names(table) if "pose" in table.header else []
        table, named = with_targets(table, block.names, called)
        return table, (), (*named, *said)
    points = _one_list(lists)
    by_time = asked.join == "time" or asked.interpolate or offset is not None
    rows = () if by_time or "pose" not in log.table.header else pose_names(log.table)
    table, named = with_targets(
        points.table, block.names, rows,
        "pose" in points.columns and is_target(points.columns["pose"].shown))
    sentences = list(named)
    timed = log.clock is not None and points.clock is not None
    if offset is not None:
        if not timed:
            raise BadInput("log and points do not both have times", "--clock-offset",
                           "Leave it out, and join by name")
        assert log.clock is not None and points.clock is not None
        own = _comparable(log, points)
        ahead = offset
        if offset == FIND:
            found, table, more = found_offset(
                mechanism, *_joints(log, block, mechanism, units, place), own, table,
                [f.table for f in lists], known_points(block, mechanism, units, place))
            sentences += [*more, str(found)]
            ahead = found.value
        table = table.put({"time": own - float(ahead)})
    elif timed and asked.join != "name" and not _by_name(log.table, table, asked):
        assert log.clock is not None and points.clock is not None
        times = on_clock_of(log.clock, points.clock, log.table.source, table.source)
        table = table.put({"time": times})
    by = asked.join or ("time" if offset is not None else None)
    try:
        made = join(log.table, table, by, asked.tolerance, asked.partial, asked.interpolate,
                    _turns(log, block, mechanism, units, place))
    except BadInput as error:
        raise _with_hint(error, log, points, offset) from None
    after, said = _from_first(made.table, log.clock if "time" in log.table.header else points.clock)
    sentences.append(f"Joined by {made.by}: {len(made.table)} rows."
                     + (f" {made.how}." if made.how else ""))
    return after, made.findings, (*sentences, *said)


def _offset(given: float | str | None) -> float | str | None:
    """Return a number of seconds, ``find``, or None."""
    if given is None or given == FIND:
        return given
    try:
        value = float(given)
    except ValueError:
        value = math.nan
    if not abs(value) < LONGEST:
        raise BadInput(f"'{given}' is not a number of seconds", "--clock-offset",
                       "Give what the points' clock is ahead by, s, or `find`")
    return value


def _by_name(log: Table, points: Table, asked: ReadArguments) -> bool:
    """Whether names will decide, so that clocks need not agree."""
    if asked.interpolate or asked.join == "time":
        return False
    both = "pose" in log.header and "pose" in points.header
    mine = {n.rsplit("::", 1)[-1] for n in pose_names(log)} if both else set()
    return bool(both and mine & {n.rsplit("::", 1)[-1] for n in pose_names(points)})


def _comparable(log: ForeignTable, points: ForeignTable) -> Array:
    """Return the points' times; on the log's clock as far as that can be told."""
    assert log.clock is not None and points.clock is not None
    try:
        return on_clock_of(log.clock, points.clock, log.table.source, points.table.source)
    except BadInput:
        return points.clock.seconds    # an offset between clocks of any two kinds


def _with_hint(error: BadInput, log: ForeignTable, points: ForeignTable,
               offset: float | str | None) -> BadInput:
    """Return a refusal with both spans of time, where the two do not overlap."""
    clocks = [f.clock for f in (log, points)]
    if offset is not None or None in clocks or not isinstance(error, NoMatch):
        return error
    one, two = (c for c in clocks if c is not None)
    ends = [(c.first, float(np.nanmax(c.seconds, initial=-np.inf))) for c in (one, two)]
    if ends[0][0] <= ends[1][1] and ends[1][0] <= ends[0][1]:
        return error
    return BadInput(f"{error.what} (the log runs from {one.name(ends[0][0])} to "
                    f"{one.name(ends[0][1])}, the points from {two.name(ends[1][0])})", error.where,
                    f"{error.hint}. If the clocks differ: --clock-offset S, or --clock-offset find")


def _turns(log: ForeignTable, block: ReadFile, mechanism: Mechanism, units: Units, place: str
           ) -> dict[str, float]:
    """Return columns of joints that may turn over -> one turn as the column counts it."""
    out = {}
    for name in _wrapping(mechanism):
        unit = _units(log).get(name) or unit_of(name, block, place) or units.angle
        if unit == "counts" and block.counts_per_turn is not None:
            out[name] = float(block.counts_per_turn)
        elif unit in ANGULAR:
            out[name] = TURN / ANGULAR[unit]
    return out


def _wrapping(mechanism: Mechanism) -> list[str]:
    """Return the columns of rotary joints whose readings may jump by a turn."""
    return [f"q_{a}" for a, quantity, bare, (low, high) in zip(
        mechanism.actuators, mechanism.actuator_quantity, mechanism.actuator_has_ratio,
        mechanism.limits.tolist(), strict=True)
        if quantity == "angle" and not bare and _may_jump(low, high)]


def _may_jump(low: float, high: float) -> bool:
    """Whether over half a turn from one reading to the next is a jump, not a long move: rad.

    It is none where limits allow such a move and keep the joint off 180 deg, where readings wrap.
    """
    if high - low <= 0.5 * TURN or high - low >= TURN * (1.0 - 1e-9):
        return True
    return bool(low < TURN * (math.ceil(low / TURN - 0.5) + 0.5) < high)


def _joints(log: ForeignTable, block: ReadFile, mechanism: Mechanism, units: Units, place: str
            ) -> tuple[Array, Array]:
    """Return a log's times (N,), ascending, and joint values (N, k), SI."""
    names = [f"q_{a}" for a in mechanism.actuators]
    missing = [n for n in names if n not in log.table.numbers]
    if missing:
        raise BadInput(f"finding an offset needs joint values, and {missing[0]} is missing",
                       log.table.source, "Give the offset: --clock-offset S")
    rest = ReadFile.model_construct(signs={p: s for p, s in block.signs.items()
                                           if p.startswith("q_")},
                                    counts_per_turn=block.counts_per_turn)
    columns = [replace(c, unit=c.unit or unit_of(n, block, place) or "")
               for n, c in log.columns.items() if n in names]
    table = in_units(log.table, declared(columns, log.table, rest, place), block, mechanism, units)
    assert log.clock is not None
    times = log.clock.seconds
    order = np.argsort(times, kind="stable")
    order = order[np.isfinite(times[order])]
    q = (stacked(table, names) * mechanism.joint_factors(units))[order]
    for i in [names.index(n) for n in _wrapping(mechanism)]:
        q[:, i] = unwrapped(q[:, i], TURN)
    return times[order], q


def _one_list(lists: Sequence[ForeignTable]) -> ForeignTable:
    """Return the points of all lists, which have the same columns."""
    first = lists[0]
    for other in lists[1:]:
        alike = (set(other.table.header) == set(first.table.header)
                 and _units(other) == _units(first) and _kind(first.clock) == _kind(other.clock))
        if not alike:
            raise BadInput(f"has other columns, units or times than {first.table.source}",
                           other.table.source, "Read it with the joint log by itself")
    if len(lists) == 1:
        return first
    tables = [f.table for f in lists]
    whole = replace(in_one(tables), source=", ".join(t.source for t in tables), dialect=None)
    clock = first.clock and replace(first.clock, seconds=whole.numbers["time"])
    return replace(first, table=whole, clock=clock)


def _units(found: ForeignTable) -> dict[str, str]:
    return {n: c.unit for n, c in found.columns.items() if c.unit}


def _kind(clock: Clock | None) -> tuple[bool, ...]:
    return () if clock is None else (clock.counter, clock.dated, clock.zoned)


def _from_first(table: Table, clock: Clock | None) -> tuple[Table, tuple[str, ...]]:
    """Return the table with its times counted from the first, unless they are a counter's."""
    if clock is None or clock.counter or "time" not in table.numbers:
        return table, ()
    times = table.numbers["time"]
    known = times[np.isfinite(times)]
    first = float(known.min()) if known.size else 0.0
    return table.put({"time": times - first}), (
        f"Column time: s since {clock.name(first)}.",)
