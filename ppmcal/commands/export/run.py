"""A machine as lines for a controller."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from ppmcal.calibration.fit import secondary
from ppmcal.commands.export.options import ExportArguments
from ppmcal.commands.inputs import files_of, load, refuse_unfit
from ppmcal.commands.result import Result
from ppmcal.commands.spec import Path_
from ppmcal.controllers import loaded
from ppmcal.controllers.export import (
    KNOWLEDGE,
    UNKNOWN,
    Exported,
    Exporter,
    pose_uncertainty,
    record_of,
)
from ppmcal.controllers.pose_errors import MM
from ppmcal.errors import BadInput, NoResult
from ppmcal.io.csv_writer import csv_text
from ppmcal.io.results.export import NO_GAIN, ExportRecord, error_size, fixed
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.store.output import Content
from ppmcal.store.provenance import source_of
from ppmcal.wording.told import ShortTable, Told

ROWS = 24
"""Numbers that are shown."""


def told(record: ExportRecord) -> Iterator[Told]:
    """Yield the numbers, the errors with old and new ones, notes and advice."""
    yield f"{record.name}: {record.summary}."
    if record.parameters:
        yield ShortTable(["parameter", "old", "new", "change", "unit"],
                         list(_numbers(record))[:ROWS], (1, 2, 3))
    if len(record.parameters) > ROWS:
        yield f"... and {len(record.parameters) - ROWS} more, all in export.json."
    yield (f"Predicted error over {record.over}; \"expected\" counts the model's own uncertainty "
           "too:")
    yield _errors(record)
    yield record.predicted.sentence()
    for note in record.notes:
        yield f"Note: {note}."
    yield from record.advice


def _errors(record: ExportRecord) -> ShortTable:
    """Return the table of errors with the old and the new numbers."""
    rows = [[label, *(error_size(v, part.unit) or "unknown" for part in (e, e.rotation)
                      if part is not None for v in (part.rms, part.max))]
            for label, e in (("old, model exact", record.gain.before),
                             ("new, model exact", record.gain.after))]
    for label, size in (("old, expected", record.predicted.before),
                        ("new, expected", record.predicted.after)):
        expected = [error_size(size.rms, size.unit) or "unknown", ""]
        if record.gain.after.rotation is not None:
            turn = size.rotation
            expected += [error_size(turn.rms, turn.unit) if turn else "unknown", ""]
        rows.append([label, *expected])
    turns = ["rms deg", "max deg"] * (record.gain.after.rotation is not None)
    return ShortTable(["", "rms mm", "max mm", *turns], rows, (1, 2, 3, 4))


def _numbers(record: ExportRecord) -> Iterator[list[str]]:
    """Yield the rows of the table of numbers."""
    for name, new in record.parameters.items():
        old = record.old.get(name)
        if name.endswith(" points"):    # a count, not a length
            yield [name, "-", f"{new:.0f}", "-", ""]
            continue
        change = "-" if old is None or new is None else f"{round(new - old, 4) + 0.0:+.4f}"
        yield [name, fixed(old) or "-", fixed(new), change, record.number_units.get(name, "")]


@dataclass(frozen=True, eq=False, repr=False)
class ExportResult(Result):
    """A machine as a controller takes it.

    Attributes:
        mechanism: the machine.
        exported: the controller's files, read back and found equal, and the errors left, SI.
        record: the content of export.json.
    """

    COMMAND: ClassVar[str] = "export"
    TABLE: ClassVar[str] = "numbers.csv"

    mechanism: Mechanism
    exported: Exported
    record: ExportRecord

    def files(self) -> Mapping[str, str | bytes]:
        """Return the controller's files and export.json."""
        return {**self.exported.files, self.record.FILE: self.record.text()}

    def tables(self) -> Mapping[str, Content]:
        """Return the controller's numbers as a table besides the files."""
        numbers = self.exported.numbers
        own = csv_text(["parameter", "old", "new", "unit"],
                       [[n.name for n in numbers],
                        [float("nan") if n.old is None else n.old for n in numbers],
                        [n.new for n in numbers], [n.unit for n in numbers]])
        return {**super().tables(), self.TABLE: own}

    @property
    def warnings(self) -> list[str]:
        """What needs a look."""
        return list(self.findings)

    def told(self) -> Iterator[Told]:
        """Yield the numbers, and what they are worth."""
        return told(self.record)

    def headline(self) -> str:
        """Return what the controller holds of the machine."""
        return f"{self.record.name}: {self.record.summary}."


def run(asked: ExportArguments) -> ExportResult:
    """Write a machine as a controller's configuration takes it."""
    writer: Exporter = loaded(asked.form)
    machine = load(asked.model)
    warned = refuse_unfit(machine, regardless=asked.regardless)
    source_file = Path(machine.source)
    old, poses = asked.old, asked.poses
    made = writer.export(machine, None if old is None else Path(old),
                         None if poses is None else Path(poses))
    if asked.write:
        made = _copied(writer, asked.form, made, old)
    notes = list[Note]()
    sure = secondary("how well the model is known", lambda: pose_uncertainty(
        machine, made.poses, source_file), UNKNOWN, notes)
    made = replace(made, uncertainty=replace(sure, reason=notes[0]) if notes else sure)
    _refuse_worse(made, machine.source, asked.regardless)
    known = source_file.with_name(KNOWLEDGE) if made.uncertainty.frame else None
    source = source_of("export", [*machine.inputs, *files_of(old, poses, known)], None)
    record = record_of(made, machine.name, source)
    return ExportResult(source, (*warned, *notes, *record.all_findings()), machine, made, record)


def _copied(writer: Exporter, form: str, made: Exported, old: Path_ | None) -> Exported:
    """Return the export with a copy of the controller's file."""
    patch = getattr(writer, "patch", None)
    if patch is None:
        raise BadInput(f"{form} writes no copy of a controller's file", "--write", "Leave it out")
    if old is None:
        raise BadInput("there is no file to copy", "--write",
                       "Give the printer's own with --old printer.cfg")
    out: Exported = patch(made, Path(old))
    return out


def _refuse_worse(made: Exported, source: str, regardless: bool) -> None:
    """Refuse numbers with which the machine misses more than with the old ones.

    The model's own uncertainty is in both errors, and decides nothing.

    Raises:
        NoResult: with both errors, if the model is exact.
    """
    before, after = made.before.rms, made.after.rms
    if after > before + NO_GAIN * MM and not regardless:    # else the record says it
        raise NoResult(
            f"the new {made.title} numbers are worse than the old ones: {after / MM:.3g} mm rms "
            f"with them, {before / MM:.3g} mm without", source,
            "Keep the old ones; --regardless writes the new ones all the same")
