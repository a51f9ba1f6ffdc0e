"""A machine as lines for a controller."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.calibration.fit import secondary
from ppmcal.commands.export.options import ExportArguments
from ppmcal.commands.export.verdict import doubts, evidence_of, refuse_worse, verdict_of
from ppmcal.commands.inputs import files_of, imports_behind, load, refuse_unfit
from ppmcal.commands.result import Result
from ppmcal.commands.spec import Path_
from ppmcal.controllers import loaded
from ppmcal.controllers.export import UNKNOWN, Exported, Exporter, pose_uncertainty, record_of
from ppmcal.controllers.number_intervals import with_intervals
from ppmcal.errors import BadInput
from ppmcal.io.csv import csv_text
from ppmcal.io.results.export import ExportRecord, error_size, fixed
from ppmcal.io.results.knowledge import KNOWLEDGE
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.store.inputs import digest_of
from ppmcal.store.output import Content, replace_kept
from ppmcal.store.provenance import source_of
from ppmcal.wording import number
from ppmcal.wording.told import CopiedLines, ShortTable, Told

ROWS = 24
"""Numbers that are shown."""


def told(record: ExportRecord, copied: bool = False) -> Iterator[Told]:
    """Yield the verdict, lines to paste, numbers, errors with old and new ones, notes, advice."""
    if record.judged:
        yield record.judged
    if record.lines and not copied:
        yield f"Lines to paste, in {record.files[0]}:"
        yield CopiedLines(record.lines)
    yield f"{record.name}: {record.summary}."
    if record.parameters:
        known = bool(record.number_half)
        yield ShortTable(["parameter", "old", "new", "change", *["+- 95 %"] * known, "unit"],
                         list(_numbers(record))[:ROWS], (1, 2, 3, *[4] * known))
    if len(record.parameters) > ROWS:
        yield f"... and {len(record.parameters) - ROWS} more, all in export.json."
    if record.number_half:
        yield record.intervals_sentence()
    yield (f"Predicted error over {record.over}; \"expected\" counts the model's own uncertainty "
           "too:")
    yield _errors(record)
    yield record.predicted_sentence()
    for note in record.notes:
        yield f"Note: {note}."
    yield from record.advice


def _errors(record: ExportRecord) -> ShortTable:
    """Return the table of errors with the old and the new numbers."""
    rows = [[label, *(error_size(v, part.unit) or "unknown" for part in (e, e.rotation)
                      if part is not None for v in (part.rms, part.max))]
            for label, e in (("old, model exact", record.before),
                             ("new, model exact", record.after))]
    for label, size in (("old, expected", record.expected_before),
                        ("new, expected", record.expected_after)):
        expected = [error_size(size.rms, size.unit) or "unknown", ""]
        if record.after.rotation is not None:
            turn = size.rotation
            expected += [error_size(turn.rms, turn.unit) if turn else "unknown", ""]
        rows.append([label, *expected])
    turns = ["rms deg", "max deg"] * (record.after.rotation is not None)
    return ShortTable(["", "rms mm", "max mm", *turns], rows, (1, 2, 3, 4))


def _numbers(record: ExportRecord) -> Iterator[list[str]]:
    """Yield the rows of the table of numbers."""
    known = bool(record.number_half)
    for name, new in record.parameters.items():
        old = record.old.get(name)
        if name.endswith(" points"):    # a count, not a length
            yield [name, "-", f"{new:.0f}", "-", *["-"] * known, ""]
            continue
        change = "-" if old is None or new is None else f"{round(new - old, 4) + 0.0:+.4f}"
        half = [number(record.number_half.get(name), 3)] * known
        yield [name, fixed(old) or "-", fixed(new), change, *half,
               record.number_units.get(name, "")]


@dataclass(frozen=True, eq=False, repr=False)
class ExportResult(Result):
    """A machine as a controller takes it.

    Attributes:
        mechanism: the machine.
        exported: the controller's files, read back and found equal, and the errors left, SI.
        record: the content of export.json.
        old: the controller's file that the copy in ``exported`` is to replace, None without one.
    """

    COMMAND: ClassVar[str] = "export"
    TABLE: ClassVar[str] = "numbers.csv"

    mechanism: Mechanism
    exported: Exported
    record: ExportRecord
    old: Path | None = None

    def files(self) -> Mapping[str, str | bytes]:
        """Return the controller's files and export.json."""
        return {**self.exported.files, self.record.FILE: self.record.text()}

    def tables(self) -> Mapping[str, Content]:
        """Return the controller's numbers as a table besides the files."""
        own = csv_text(["parameter", "old", "new", "half", "unit"], [
            [getattr(n, field) for n in self.exported.numbers]
            for field in ("name", "old", "new", "half", "unit")])
        return {**super().tables(), self.TABLE: own}

    @property
    def warnings(self) -> list[str]:
        """What needs a look."""
        return list(self.findings)

    def told(self) -> Iterator[Told]:
        """Yield the numbers, and what they are worth."""
        return told(self.record, self.old is not None)

    def finished(self, written: Sequence[Path], asked: Any) -> Iterator[Told]:
        """Put the copy in the place of the controller's file, and yield where everything is."""
        yield from super().finished(written, asked)
        if self.old is not None:
            kept = self.put_in_place()
            yield (f"{self.old} has the new numbers; as it was before it is kept in {kept}. "
                   "Restart the controller.")

    def put_in_place(self) -> Path:
        """Replace the controller's file by its copy with the new numbers, and return the backup.

        Raises:
            BadInput: there is no copy, or the file is not what it was when it was read.
        """
        if self.old is None:
            raise BadInput("no copy of a controller's file was made", "write", "Pass write=True")
        refuse_other_file(Path(self.mechanism.source), self.old, unknown_too=True)
        return replace_kept(self.old, self.exported.files[self.exported.copy],
                            self.provenance["inputs"][str(self.old)])

    def headline(self) -> str:
        """Return what the controller holds of the machine."""
        return f"{self.record.name}: {self.record.summary}."


def run(asked: ExportArguments) -> ExportResult:
    """Write a machine as a controller's configuration takes it."""
    writer: Exporter = loaded(asked.form)
    machine = load(asked.model)
    warned = refuse_unfit(machine, regardless=asked.regardless)
    old, poses = asked.old, asked.poses
    copied = _copier(writer, asked.form, old) if asked.write else None
    made = writer.export(machine, None if old is None else Path(old),
                         None if poses is None else Path(poses))
    if copied is not None and old is not None:
        made = copied(made, Path(old))
        if made.copy:
            refuse_other_file(Path(machine.source), Path(old))
    notes = list[Note]()
    sure = secondary("how well the model is known", lambda: pose_uncertainty(
        machine, made.poses), UNKNOWN, notes)
    made = replace(made, uncertainty=replace(sure, reason=notes[0]) if notes else sure,
                   numbers=secondary("how well the numbers are known", lambda: with_intervals(
                       machine, made), made.numbers, notes))
    if old is None:
        made = made.as_seen(machine)
    known = evidence_of(machine)
    warned += refuse_worse(made, known, machine.source, asked.regardless)
    notes += doubts(known, machine.source, asked.write and not asked.regardless)
    read = known.there or made.uncertainty.frame
    beside = Path(machine.source).with_name(KNOWLEDGE) if read else None
    source = source_of("export", [*machine.inputs, *files_of(old, poses, beside)], None)
    record = record_of(made, machine.name, source)
    record = record.changed(**verdict_of(record, known, warned))
    return ExportResult(source, (*warned, *notes, *record.all_findings()), machine, made, record,
                        Path(old) if made.copy and old is not None else None)


def _copier(writer: Exporter, form: str, old: Path_ | None) -> Callable[[Exported, Path], Exported]:
    """Return what adds a copy of the controller's file to an export.

    Raises:
        BadInput: the format has no such copy, or there is no file.
    """
    patch: Callable[[Exported, Path], Exported] | None = getattr(writer, "patch", None)
    if patch is None:
        raise BadInput(f"{form} writes no copy of a controller's file", "--write", "Leave it out")
    if old is None:
        raise BadInput("there is no file to copy", "--write",
                       "Give the printer's own with --old printer.cfg")
    return patch


def refuse_other_file(model: Path, old: Path, unknown_too: bool = False) -> None:
    """Refuse to write into a controller's file that the machine was not read from.

    ``unknown_too``: nor where nothing recorded says from which it was.

    Raises:
        BadInput: it is another one, or has changed since.
    """
    found = list(imports_behind(model))
    if any(digest_of(old) in run.source.inputs.values() for run in found):
        return
    if found or unknown_too:
        raise BadInput(f"is not the file that {model} was read from, or has changed since" if found
                       else f"nothing recorded says that {model} was read from this file",
                       str(old), "Import it and fit anew, or leave out --write and paste the lines")
