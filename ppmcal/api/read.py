"""Files as instruments and controllers write them, as the two that the program works with."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ppmcal.api.inputs import Machine, Path_, load, source_of
from ppmcal.api.result import Result
from ppmcal.errors import BadInput, unknown
from ppmcal.io.csv import Table, csv_table
from ppmcal.io.csv_writer import Content, csv_lines
from ppmcal.io.dataset_reader import LABELS, dataset_of
from ppmcal.io.foreign import ForeignTable, foreign_table, refuse_unused
from ppmcal.io.header_units import with_units
from ppmcal.io.join import Join, join
from ppmcal.io.pose_fields import QUATERNION
from ppmcal.io.reading import MATRIX, ReadFile, as_declared
from ppmcal.io.schema import check
from ppmcal.io.sidecar import FORMAT, SidecarFile, sidecar_path
from ppmcal.io.yaml import dump_yaml, read_yaml
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import LENGTHS, Units

GUESS = 1e-5
"""Standard deviation with which an estimate of an unknown noise begins, m and rad."""
TURNED = (*(f"r{a}" for a in "xyz"), *QUATERNION, *MATRIX)


@dataclass(frozen=True, eq=False)
class ReadResult(Result):
    """What was read, and how it was understood.

    Attributes:
        data: the measurements, SI.
        table: its columns in the sidecar's units.
        sidecar: what the YAML beside the table says.
        sentences: what was understood of each file.
        name: of the two files, without their ends.
    """

    COMMAND: ClassVar[str] = "read"
    TABLE: ClassVar[str] = "run.csv"

    data: Dataset
    table: Table
    sidecar: Mapping[str, Any]
    sentences: tuple[str, ...]
    name: str = "run"

    def files(self) -> Mapping[str, Content]:
        """Return the CSV and its sidecar."""
        return {f"{self.name}.csv": table_text(self.table),
                f"{self.name}.yaml": dump_yaml(dict(self.sidecar))}

    def headline(self) -> str:
        """Return how many rows of which columns there are."""
        return f"{len(self.table)} rows of {', '.join(self.table.header)}."

    def summary(self) -> dict[str, object]:
        """Return what the command prints as JSON."""
        return {"format": "ppmcal/read/1", "rows": len(self.table),
                "columns": list(self.table.header), "understood": list(self.sentences),
                "findings": list(self.findings), "provenance": self.provenance}


def read(files: Path_ | Sequence[Path_], mechanism: Machine, *, sidecar: Path_ | None = None,
         join: str | None = None, tolerance: float = 0.5, partial: bool = False,
         units: str | None = None, name: str = "run") -> ReadResult:
    """Read files of instruments and controllers as measurements.

    Args:
        files: a table with joint values and what was measured; or a joint log, and lists of
            points (name, x, y, z and perhaps time) that are put beside it.
        mechanism: the machine that was measured.
        sidecar: what the numbers are, as beside a measurement file  [default: the one beside
            one of the files, or else the mechanism file's units, and frame, target and noise
            unknown].
        join: ``name``: a point's name is the log's ``pose``; ``time``: the nearest row
            [default: name where names agree, else time].
        tolerance: how far apart two times may be, s.
        partial: leave out what matches nothing, and say so.
        units: length unit of points whose header names none  [default: the sidecar's].
        name: of the two files that :meth:`ReadResult.save` writes, without their ends.

    Raises:
        BadInput: anything wrong in the files, rows that cannot be joined, or no joint values.
    """
    machine = load(mechanism)
    paths = [Path(f) for f in ([files] if isinstance(files, str | os.PathLike) else files)]
    if join not in (None, "name", "time"):
        raise unknown("way to join", join, ("name", "time"), "--join")
    if units is not None and units not in LENGTHS:
        raise unknown("length unit", units, LENGTHS, "--units")
    if not tolerance >= 0.0:
        raise BadInput(f"{tolerance} is no time", "--tolerance", "Write seconds, 0 or more")
    side = _sidecar(paths, sidecar)
    content = None if side is None else read_yaml(side)
    place = "the sidecar" if side is None else str(side)
    block = ReadFile() if content is None else check(SidecarFile, content, place).read
    found = [foreign_table(p, machine, block, place) for p in paths]
    refuse_unused(block, found, place)
    log, lists = _sorted(found, machine)
    if units is not None:
        lists = [_in_unit(points, units) for points in lists]
    sentences = [_understood(f, units) for f in found]
    table, notes = log.table, [n for f in found for n in f.findings]
    if lists:
        joined = _joined(log, lists, join, tolerance, partial)
        table, notes = joined.table, [*notes, *joined.findings]
        sentences.append(f"Joined by {joined.by}: {len(table)} rows.")
    if content is None:
        content, more = _unsaid(table, machine)
        notes += more
    file = check(SidecarFile, content, place)
    sentences.append(f"Columns whose header has no unit: {file.units.length} and "
                     f"{file.units.angle}, unless `read.units` says otherwise.")
    headed = {own: u for f in (log, *lists) for own, u in f.units.items() if own in table.header}
    rest = block.model_copy(update={"columns": {}, "ignore": []})
    table = as_declared(table, with_units(rest, headed, place), machine, file.units.units(), place,
                        headed)
    kept = {k: v for k, v in content.items() if k != "read"}
    kept |= {"read": {"shift": block.shift}} if block.shift else {}
    data = _checked(table, kept, place, machine)
    inputs: list[Path_] = [*paths, *([side] if side else []), *machine.inputs]
    return ReadResult(source_of("read", inputs, None), (*notes, *data.findings), data, table, kept,
                      tuple(sentences), name)


def table_text(table: Table) -> Content:
    """Return a table as a CSV."""
    return csv_lines(table.header, [table.numbers[h] if h in table.numbers else table.text[h]
                                    for h in table.header])


def _sidecar(paths: Sequence[Path], given: Path_ | None) -> Path | None:
    """Return the sidecar of the files, None where there is none."""
    if given is not None:
        return Path(given)
    there = list(dict.fromkeys(p for p in map(sidecar_path, paths) if p.is_file()))
    if len(there) > 1:
        raise BadInput("more than one of the files has a sidecar", ", ".join(map(str, there)),
                       "Give the one that counts with --sidecar")
    return there[0] if there else None


def _sorted(found: Sequence[ForeignTable], mechanism: Mechanism
            ) -> tuple[ForeignTable, list[ForeignTable]]:
    """Return the table that holds joints, and the lists of points."""
    logs = [f for f in found if f.has_joints]
    sources = ", ".join(f.table.source for f in (logs or found))
    if len(logs) > 1:
        raise BadInput("several files hold joint values", sources, "Read each with its own points")
    if not logs:
        joints = [f"q_{a}" for a in mechanism.actuators]
        raise BadInput(f"no file holds joint values ({', '.join(joints)})", sources,
                       "Name the columns under `read.columns` in a sidecar, such as "
                       f'{{{joints[0]}: "its header"}}')
    return logs[0], [f for f in found if f is not logs[0]]


def _in_unit(points: ForeignTable, unit: str) -> ForeignTable:
    more: dict[str, str] = {c: unit for c in ("x", "y", "z") if c in points.table.header}
    return replace(points, units={**more, **points.units})


def _joined(log: ForeignTable, lists: Sequence[ForeignTable], by: str | None, tolerance: float,
            partial: bool) -> Join:
    """Return the log with the points of all lists, which have the same columns."""
    first = lists[0]
    for other in lists[1:]:
        if set(other.table.header) != set(first.table.header) or other.units != first.units:
            raise BadInput(f"has other columns or units than {first.table.source}",
                           other.table.source, "Read it with the joint log by itself")
    tables = [f.table for f in lists]
    text = {h for t in tables for h in t.text}
    whole = Table(", ".join(t.source for t in tables), first.table.header,
                  {h: np.concatenate([t.numbers[h] for t in tables])
                   for h in first.table.header if h not in text},
                  {h: tuple(c for t in tables for c in t.labels(h)) for h in text},
                  sum(len(t) for t in tables))
    return join(log.table, whole, by, tolerance, partial)


def _understood(found: ForeignTable, unit: str | None) -> str:
    """Return how a file was understood: separator, columns with units, and what was ignored."""
    taken = []
    for own in found.table.header:
        header = found.headers.get(own, own)
        unit_ = found.units.get(own, "")
        taken.append(own + (f" ({header})" if header != own else f" [{unit_}]" if unit_ else ""))
    said = f" Remarks above: {' | '.join(found.remarks)}." if found.remarks else ""
    dialect = found.table.dialect
    text = (f"{found.table.source}: {len(found.table)} rows" +
            (f", {dialect}" if dialect else "") + f". Taken: {', '.join(taken)}.")
    if unit and not found.has_joints:
        text += f" Points in {unit} where their header does not say."
    return text + (f" Ignored: {', '.join(found.ignored)}." if found.ignored else "") + said


def _unsaid(table: Table, mechanism: Mechanism) -> tuple[dict[str, Any], list[str]]:
    """Return the sidecar of a table that has none, and what the user must add to it."""
    own = mechanism.units
    if "x" not in table.header and ({"height", "distance"} & set(table.header)):
        raise BadInput("heights and distances need a sidecar", table.source,
                       "Write one (README, The measurements) and give it with --sidecar")
    turning = mechanism.motion != "translational" and any(c in table.header for c in TURNED)
    sigma: dict[str, Any] = {"position": _rounded(GUESS, own, "length")}
    if turning:
        sigma["rotation"] = _rounded(GUESS, own, "angle")
    content = {"format": FORMAT, "units": {"length": own.length, "angle": own.angle},
               "instrument": {"kind": "pose" if turning else "position",
                              "sigma": {**sigma, "estimated": True}},
               "frame": "unknown", "target": "unknown"}
    return content, [f"there is no sidecar: units without another are taken for {own.length} and "
                     f"{own.angle}, frame and target for unknown, and the noise is estimated. "
                     "Write into the YAML what you know."]


def _rounded(value: float, units: Units, quantity: str) -> float:
    return float(f"{value / units.factor(quantity):.2g}")


def _checked(table: Table, content: Mapping[str, Any], place: str, mechanism: Mechanism) -> Dataset:
    """Return the data set of what will be written, read back by the program's own reader."""
    file = check(SidecarFile, dict(content), place)
    again = csv_table(str(table_text(table)).encode(), table.source, LABELS.__contains__)
    return dataset_of(again, file, place, mechanism)
