"""Points of several targets on the platform: told apart by their names, each with its own place.

A name is ``pose``, or ``Group::Point``, or ``Collection::Group::Point``. What is measured at one
pose with several reflectors is one group by default: the group is the pose, the point the target.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.calibration.interpretation import (
    ClockOffset,
    SeenTargets,
    find_clock_offset,
    one_target,
)
from ppmcal.errors import BadInput
from ppmcal.io.body_targets import naming, wide_parts
from ppmcal.io.csv import Table
from ppmcal.io.foreign import pose_names
from ppmcal.io.header import ReadFile
from ppmcal.io.measurement_columns import stacked
from ppmcal.io.schema import check
from ppmcal.io.sidecar import SidecarFile, located
from ppmcal.io.sidecar_values import point_of
from ppmcal.io.tables import read_table
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units

SHOWN = 6


def with_targets(points: Table, names: str | None, rows: Sequence[str] = (),
                 by_target: bool = False) -> tuple[Table, tuple[str, ...]]:
    """Return points with columns ``pose`` and ``target`` as their names have them, and what it is.

    Args:
        points: with what was measured.
        names: how names are made, such as ``{pose}_{target}``  [default: as groups and the file's
            columns tell].
        rows: names of the log's rows, where points find theirs by name.
        by_target: the names are headed `Target`.

    Raises:
        BadInput: no names, names that are not made like that, or groups that may be targets.
    """
    if names:
        return _as_named(points, names), ()
    if "target" in points.header:
        named = pose_names(points) if "pose" in points.header else None
        return _split(points, named, points.labels("target"), "Points are named by pose and target"
                      if named else "A column names each row's target")
    if "pose" not in points.header or "x" not in points.header:
        return points, ()
    whole = pose_names(points)
    mine = {_last(n) for n in rows}
    if {_last(n) for n in whole} & mine:
        return points, ()
    groups, what = [n.rpartition("::")[0] for n in whole], [_last(n) for n in whole]
    if len(set(groups)) > 1 and (
            len(set(what)) < len(set(zip(groups, what, strict=True)))    # names in several groups
            or {_last(g) for g in groups} & mine):
        if not {_last(g) for g in groups} & mine and len(set(what)) > len(set(groups)):
            raise BadInput(f"points of the same names ({_listed(what)}) stand in several groups "
                           f"({_listed(groups)})", points.source, "If the groups are targets on "
                           "the platform: --names '{target}::{pose}'; if they are poses: --names "
                           "'{pose}::{target}'; if all points are one target: --names '{pose}'")
        short = [_last(g) for g in groups]
        alike = len(set(short)) == len(set(groups))
        return _split(points, short if alike else groups, what,
                      "A point's group is its pose, the last part of its name the target")
    if by_target and not mine and len(set(groups)) == 1:
        return _split(points, None, what, "A point's name is its target")
    return points, ()


def _last(name: str) -> str:
    return name.rpartition("::")[2].strip()


def _listed(names: Sequence[str]) -> str:
    each = list(dict.fromkeys(names))
    return ", ".join(each[:SHOWN]) + (f" ... ({len(each)})" if len(each) > SHOWN else "")


def _split(points: Table, pose: Sequence[str] | None, target: Sequence[str], said: str
           ) -> tuple[Table, tuple[str, ...]]:
    """Return points with a target each; as they are where names are not targets' or of one."""
    count = Counter(target)
    if len(count) < 2 or 2 * len(count) > len(target):
        return points.without(("target",)), ()
    table = points.without(("target",)) if pose is not None else points.without(("target", "pose"))
    table = table if pose is None else table.put({"pose": tuple(pose)})
    return table.put({"target": tuple(target)}), (
        f"{said}: {len(count)} targets ({_listed(target)}).",)


def _as_named(points: Table, names: str) -> Table:
    """Return points with the pose and the target that their names say.

    Raises:
        BadInput: no names, or a name that is not made like that.
    """
    if "pose" not in points.header:
        raise BadInput("points have no names", points.source, "Leave `names` out")
    parts = re.split(r"(\{pose\}|\{target\})", names)
    pattern = "".join(f"(?P<{p[1:-1]}>.+?)" if p in ("{pose}", "{target}") else re.escape(p)
                      for p in parts)
    form = re.compile(rf"(?:.*::)?{pattern}")
    found = dict[str, list[str]](pose=[], target=[])
    for i, whole in enumerate(pose_names(points)):
        match = form.fullmatch(whole)
        if match is None:
            raise BadInput(f"the name '{whole}' is not made like {names}", points.at("pose", i),
                           "Correct --names (or `read.names`), or the name")
        for word, text in match.groupdict().items():
            found[word].append(text)
    return points.without(("target", "pose")).put({h: tuple(v) for h, v in found.items() if v})


def known_points(block: ReadFile, mechanism: Mechanism, units: Units, place: str
                 ) -> dict[str, Array]:
    """Return where targets are on the platform (3,), m, by name; only those that are known.

    Raises:
        BadInput: not a point.
    """
    every = {name: point_of(raw, mechanism.motion, units, place, f"read.targets.{name}")
             for name, raw in block.targets.items()}
    return {name: np.asarray(point.value) for name, point in every.items() if not point.fitted}


def found_offset(mechanism: Mechanism, times: Array, q: Array, seen_at: Array, points: Table,
                 lists: Sequence[Table], known: Mapping[str, Array]
                 ) -> tuple[ClockOffset, Table, tuple[str, ...]]:
    """Return the clocks' offset, the points with their targets, and what was found out of these.

    Points that are not told to be of several targets are tried as one. If they follow the machine
    only as one target for each name, or for each file, then they are that.

    Args:
        mechanism: nominal.
        times: of the log (N,), s, ascending.
        q: of the log (N, k), SI.
        seen_at: times of points (M,), s.
        points: the M points.
        lists: the tables that they come from, in this order.
        known: targets' places (3,), m, by name.

    Raises:
        BadInput: as :func:`find_clock_offset`.
    """
    seen = stacked(points, ["x", "y", "z"])

    def find(targets: SeenTargets) -> ClockOffset:
        return find_clock_offset(mechanism, times, q, seen_at, seen, points.source, targets)

    if "target" in points.header:
        return find(_labelled(points.text["target"], known)), points, ()
    try:
        return find(one_target(len(points))), points, ()
    except BadInput as one:
        for names, said in _perhaps(points, lists):
            if len(set(names)) < 2 or 2 * len(set(names)) > len(names):
                continue
            try:
                found = find(_labelled(names, known))
            except BadInput:
                continue
            return found, *_split(points, None, names, said)
        raise one from None


def _perhaps(points: Table, lists: Sequence[Table]) -> list[tuple[list[str], str]]:
    """Return what might tell targets apart: the points' names, and the files that hold them."""
    out = []
    if "pose" in points.header:
        out.append((pose_names(points), "As one target the points do not follow the machine, as "
                    "one for each name they do"))
    files = [Path(t.source).stem for t in lists for _ in range(len(t))]
    out.append((files, "As one target the points do not follow the machine, as one for each file "
                "they do"))
    return out


def _labelled(names: Sequence[str], known: Mapping[str, Array]) -> SeenTargets:
    each = list(dict.fromkeys(names))
    nowhere = np.full(3, np.nan)
    return SeenTargets(tuple(each), np.array([each.index(n) for n in names], dtype=np.int64),
                       np.array([known.get(n, nowhere) for n in each]))


def each_target(paths: Sequence[Path], machine: Mechanism, content: Mapping[str, Any] | None,
                names: str | None, place: str
                ) -> Iterator[tuple[str, Mapping[str, Any] | None, ReadFile]]:
    """Yield each target whose columns a wide file has: name, sidecar and how its own are read.

    Else one without a name, whose block has the points that the sidecar names.

    Args:
        paths: of the files.
        machine: that was measured.
        content: what the sidecar says, None without one.
        names: how points are called, in place of ``read.names``.
        place: what messages call the sidecar.

    Raises:
        BadInput: as :func:`ppmcal.io.body_targets.wide_parts`.
    """
    block = ReadFile() if content is None else check(SidecarFile, dict(content), place).read
    block = block if names is None else check(ReadFile, {"names": names}, "--names").model_copy(
        update={k: getattr(block, k) for k in block.model_fields_set - {"names"}})
    if content is None or not content.get("targets"):
        yield "", content, block
        return
    file = located(check(SidecarFile, dict(content), place), machine, place)
    assert file.targets is not None
    alone = {k: v for k, v in content.items() if k != "targets"}
    table = read_table(paths[0], loose=lambda header: True, sheet=block.sheet)
    header = naming(table, block)
    if len(paths) > 1 or header:
        named = {} if header is None else {"target": header}
        yield "", {**alone, "target": "unknown"}, block.model_copy(update={
            "targets": file.targets, "columns": {**block.columns, **named}})
        return
    parts = wide_parts(table, file, machine)
    taken = {h for part in parts for h in part.columns}
    for part in parts:
        own = {name: header for header, name in part.columns.items()}
        yield part.target, {**alone, "target": file.targets[part.target]}, (
            part.file.read.model_copy(update={
                "columns": {**part.file.read.columns, **own},
                "ignore": [*block.ignore, *(h for h in table.header if h in taken - {*part.columns})
                           ]}))
