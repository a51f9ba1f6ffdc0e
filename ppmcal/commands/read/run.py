"""Files as instruments and controllers write them, as the two that the program works with."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ppmcal.commands.inputs import load
from ppmcal.commands.read.combined import ReadRun, combined
from ppmcal.commands.read.join import joined, sort_out
from ppmcal.commands.read.options import ReadArguments
from ppmcal.commands.read.targets import each_target
from ppmcal.commands.read.words import understood
from ppmcal.commands.result import Result
from ppmcal.commands.spec import Path_
from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.io.body_targets import stands
from ppmcal.io.column_names import LABELS
from ppmcal.io.csv import Table, csv_lines, csv_table
from ppmcal.io.dataset_reader import dataset_of
from ppmcal.io.foreign import ForeignTable, foreign_tables, refuse_unused
from ppmcal.io.header import MATRIX, ReadFile, declared, unit_of
from ppmcal.io.join import rows_of
from ppmcal.io.pose_fields import QUATERNION
from ppmcal.io.reading import declared_unit, in_conventions, in_units
from ppmcal.io.schema import check
from ppmcal.io.sidecar import FORMAT, SidecarFile, located, sidecar_path
from ppmcal.io.yaml import dump_yaml, read_yaml
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import InstrumentKind, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.store.inputs import own_input
from ppmcal.store.output import Content, Output
from ppmcal.store.provenance import origin_comment, source_of
from ppmcal.units import LENGTHS, Units
from ppmcal.wording.told import Told

GUESS = 1e-5
"""Standard deviation with which an estimate of an unknown noise begins, m and rad."""
TURNED = (*(f"r{a}" for a in "xyz"), *QUATERNION, *MATRIX)


@dataclass(frozen=True, eq=False)
class ReadResult(Result):
    """What was read, and how it was understood.

    Attributes:
        runs: one measurement file, or one for each target on the platform.
        sentences: what was understood of each file.
    """

    COMMAND: ClassVar[str] = "read"
    TABLE: ClassVar[str] = "run.csv"

    runs: tuple[ReadRun, ...]
    sentences: tuple[str, ...]

    @property
    def data(self) -> Dataset:
        """The measurements of the first file, SI."""
        return self.runs[0].data

    @property
    def table(self) -> Table:
        """The columns of the first file, in its sidecar's units."""
        return self.runs[0].table

    @property
    def sidecar(self) -> Mapping[str, Any]:
        """What the YAML beside the first table says."""
        return self.runs[0].sidecar

    def files(self) -> Mapping[str, Content]:
        """Return each CSV and its sidecar, which says at its head what it was made from."""
        origin = origin_comment(self.provenance)
        return {f"{run.name}.{end}": content for run in self.runs
                for end, content in (("csv", table_text(run.table)),
                                     ("yaml", origin + dump_yaml(dict(run.sidecar))))}

    def headline(self) -> str:
        """Return how many rows of which columns there are."""
        rows = " and ".join(str(len(run.table)) for run in self.runs)
        return f"{rows} rows of {', '.join(self.table.header)}."

    def told(self) -> Iterator[Told]:
        """Yield what was understood."""
        yield from self.sentences

    def write(self, asked: ReadArguments) -> list[Path]:
        """Write the files among others, all of them or none; return their paths."""
        assert asked.out is not None
        output = Output(Path(asked.out).parent, loose=True)
        for name, content in self.files().items():
            output.add(name, content)
        return output.write()

    def finished(self, written: Sequence[Path], asked: Any) -> Iterator[Told]:
        """Yield where the files are."""
        yield f"Written: {', '.join(map(str, written))}"

    def summary_of(self, written: Sequence[Path]) -> Mapping[str, Any]:
        """Return the files that were written."""
        return {"written": [str(p) for p in written]}

    def summary(self) -> dict[str, object]:
        """Return what the command prints as JSON."""
        return {"format": "ppmcal/read/1", "rows": sum(len(run.table) for run in self.runs),
                "columns": list(self.table.header), "understood": list(self.sentences),
                "findings": list(self.findings), "provenance": self.provenance}


def run(asked: ReadArguments) -> ReadResult:
    """Read files of instruments and controllers as measurements."""
    files = asked.files
    paths = [Path(f) for f in ([files] if isinstance(files, str | os.PathLike) else files)]
    if asked.out is not None:
        known = [*paths, *(Path(p) for p in (asked.mechanism, asked.sidecar) if p)]
        _refuse_to_replace(Path(asked.out), known, asked.force)
    machine = load(asked.mechanism)
    _check_options(asked.join, asked.units, asked.tolerance)
    side = _sidecar(paths, asked.sidecar)
    content = None if side is None else read_yaml(side)
    place = "the sidecar" if side is None else str(side)
    runs, notes, sentences = list[ReadRun](), list[str](), list[str]()
    for target, own, block in each_target(paths, machine, content, asked.names, place):
        table, kept, more, said = _understood(asked, paths, machine, own, block, place)
        notes += more
        sentences += [words for words in said if words not in sentences]
        if target:
            runs.append(_of_target(target, table, kept, asked.name, runs, place, machine))
        else:
            runs += _by_target(table, kept, block, asked, place, machine)
    if len({run.name for run in runs}) < len(runs):
        raise BadInput("two targets would be written to one file", f"{place}: read.names",
                       "Name them by letters and digits")
    found = [n for run in runs for n in run.data.findings]
    notes += dict.fromkeys(found) if asked.combined else found
    if asked.combined:
        table, kept, more, words = combined(runs, machine, place)
        notes, sentences = notes + more, [*sentences, words]
        runs = [ReadRun(asked.name, table, kept, _checked(table, kept, place, machine),
                        np.arange(len(table)))]
    whole = [q for p in paths for q in (sorted(p.iterdir()) if p.is_dir() else [p]) if q.is_file()]
    inputs: list[Path_] = [*whole, *([side] if side else []), *machine.inputs]
    result = ReadResult(source_of("read", inputs, None), tuple(notes), tuple(runs),
                        tuple(sentences))
    if asked.out is not None:
        for name in result.files():
            _refuse_to_replace(Path(asked.out).with_name(name).with_suffix(".csv"),
                               [Path(p) for p in result.provenance["inputs"]], asked.force)
    return result


def _understood(asked: ReadArguments, paths: Sequence[Path], machine: Mechanism,
                content: Mapping[str, Any] | None, block: ReadFile, place: str
                ) -> tuple[Table, dict[str, Any], list[str], list[str]]:
    """Return files as one table, its sidecar, what was found, and what was understood of each."""
    kind = None if content is None else located(
        check(SidecarFile, dict(content), place), machine, place).instrument.kind
    found = [f for p in paths for f in foreign_tables(p, machine, block, place, kind)]
    refuse_unused(block, found, place)
    log, lists = sort_out(found, machine)
    lists = lists if asked.units is None else [_in_unit(points, asked.units) for points in lists]
    declared = (machine.units if content is None else
                check(SidecarFile, dict(content), place).units.units())
    table, odd, said = joined(log, lists, asked, block, machine, declared, place)
    notes = [n for f in found for n in f.findings] + list(odd)
    by = "sidecar" if content is not None else "mechanism file"
    if content is None:
        content, more = _unsaid(table, machine)
        notes += more
    file = check(SidecarFile, dict(content), place)

    def told(f: ForeignTable, own: str) -> tuple[str, str]:
        by_side, own_units = unit_of(own, block, place), file.units.units()
        column = f.columns.get(own)
        if column is not None and column.unit:
            return column.unit, column.unit_from
        if by_side is not None:
            return by_side, "read.units"
        unit = declared_unit(own, machine, own_units, kind)
        return unit, by if unit in (own_units.length, own_units.angle) else ""

    sentences = [understood(f, told) for f in (log, *lists)] + list(said)
    table = _declared(table, [log, *lists], block, machine, file.units.units(), place, kind)
    kept = {k: v for k, v in content.items() if k != "read"}
    kept |= {"read": {"shift": block.shift}} if block.shift else {}
    return table, kept, notes, sentences


def _refuse_to_replace(out: Path, inputs: Sequence[Path], force: bool) -> None:
    """Refuse to replace an input, or what is there."""
    if out.suffix != ".csv":
        raise BadInput("is not the name of a CSV file", str(out), "Write --out run.csv")
    for place in (out, out.with_suffix(".yaml")):
        if any(place.exists() and p.exists() and place.samefile(p) for p in inputs):
            raise own_input(str(place), "Give another --out")
        if place.exists() and not force:
            raise BadInput("exists already", str(place), "Give another --out, or --force")


def _check_options(join: str | None, units: str | None, tolerance: float) -> None:
    if join not in (None, "name", "time"):
        raise unknown("way to join", join, ("name", "time"), "--join")
    if units is not None and units not in LENGTHS:
        raise unknown("length unit", units, LENGTHS, "--units")
    if not tolerance >= 0.0:
        raise BadInput(f"{tolerance} is not a time", "--tolerance", "Write seconds, 0 or more")


def _declared(table: Table, files: Sequence[ForeignTable], block: ReadFile, machine: Mechanism,
              units: Units, place: str, kind: InstrumentKind | None) -> Table:
    """Return the table in the sidecar's units, axes and conventions."""
    columns = [c for f in files for n, c in f.columns.items() if n in table.header]
    columns = [replace(c, unit="") if c.name == "time" else c
               for c in declared(columns, table, block, place)]
    return in_conventions(in_units(table, columns, block, machine, units, kind), block, machine,
                          units, place)


def _by_target(table: Table, kept: dict[str, Any], block: ReadFile, asked: ReadArguments,
               place: str, machine: Mechanism) -> tuple[ReadRun, ...]:
    """Return one measurement file, or one for each target, all seen from one frame."""
    if "target" not in table.header:
        return (ReadRun(asked.name, table, kept, _checked(table, kept, place, machine),
                        np.arange(len(table))),)
    if kept.get("target") not in (None, "unknown"):
        raise BadInput("there are several targets, and one `target`", f"{place}: target",
                       "Write `target: unknown`, and the points under `read.targets`")
    targets, runs = list(dict.fromkeys(table.text["target"])), list[ReadRun]()
    refuse_unknown("target", block.targets, targets, f"{place}: read.targets")
    bare = table.without(("target",))
    stand = None
    if asked.combined:
        data = _checked(bare, {**kept, "target": "unknown"}, place, machine)
        stand = stands((data.whole or data).groups, table.text["target"])
    for target in targets:
        rows = np.flatnonzero(np.array(table.text["target"]) == target)
        side = {**kept, "target": block.targets.get(target, "unknown")}
        run = _of_target(target, rows_of(bare, rows), side, asked.name, runs, place, machine)
        runs.append(run if stand is None else replace(run, stands=stand[rows]))
    return tuple(runs)


def _of_target(target: str, table: Table, kept: Mapping[str, Any], name: str,
               before: Sequence[ReadRun], place: str, machine: Mechanism) -> ReadRun:
    """Return the measurement file of one of several targets; ``before``: those of others."""
    side = {**kept, "name": f"{kept.get('name', name)} {target}"}
    if before and kept.get("frame") == "unknown":
        side["frame"] = {"same_as": before[0].sidecar["name"]}
    return ReadRun(f"{name}-{re.sub(r'[^A-Za-z0-9_.-]+', '-', target)}", table, side,
                   _checked(table, side, place, machine, target), np.arange(len(table)), target)


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


def _in_unit(points: ForeignTable, unit: str) -> ForeignTable:
    return replace(points, columns={
        n: replace(c, unit=unit, unit_from="--units") if n in ("x", "y", "z") and not c.unit else c
        for n, c in points.columns.items()})


def _unsaid(table: Table, mechanism: Mechanism) -> tuple[dict[str, Any], list[Note]]:
    """Return the sidecar of a table that has none, and what the user must add to it."""
    own = mechanism.units
    if "x" not in table.header and set(number_names()) & set(table.header):
        raise BadInput("heights and distances need a sidecar", table.source,
                       "Write one (README, The measurements) and give it with --sidecar")
    turning = mechanism.motion.turns and any(c in table.header for c in TURNED)
    sigma: dict[str, Any] = {"position": _rounded(GUESS, own, "length")}
    if turning:
        sigma["rotation"] = _rounded(GUESS, own, "angle")
    content = {"format": FORMAT, "units": {"length": own.length, "angle": own.angle},
               "instrument": {"kind": "pose" if turning else "position",
                              "sigma": {**sigma, "estimated": True}},
               "frame": "unknown", "target": "unknown"}
    return content, [Note(f"no sidecar: units that no header states are taken as {own.length} and "
                          f"{own.angle}, frame and target as unknown, and the noise is estimated. "
                          "Write what you know into the YAML.")]


def _rounded(value: float, units: Units, quantity: str) -> float:
    return float(f"{value / units.factor(quantity):.2g}")


def _checked(table: Table, content: Mapping[str, Any], place: str, mechanism: Mechanism,
             mark: str = "") -> Dataset:
    """Return the data set of what will be written, read back by the program's own reader.

    ``mark``: the target that it is of, where there are several.
    """
    file = check(SidecarFile, dict(content), place)
    again = csv_table(str(table_text(table)).encode(), table.source, LABELS.__contains__)
    return dataset_of(again, file, place, mechanism, mark)
