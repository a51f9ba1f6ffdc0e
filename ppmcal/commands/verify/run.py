"""Results made again from what was recorded of them, and compared value by value."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.commands.face import carry_out, recorded, refused
from ppmcal.commands.result import Result
from ppmcal.commands.spec import CONSOLE, Arguments, Command, taken
from ppmcal.commands.verify.options import VerifyArguments
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.io.results.verification import (
    FAILED,
    INPUT,
    UNKNOWN,
    RunCheck,
    VerificationRecord,
    environment_words,
    status_of,
)
from ppmcal.notes import Note
from ppmcal.store.differences import compared
from ppmcal.store.folder import RECORD, read_record, running
from ppmcal.store.inputs import digest_of
from ppmcal.store.runs import (
    RESULTS,
    FoundInputs,
    InputCheck,
    RecordedRun,
    Sandbox,
    folders_within,
    recorded_runs,
    runs_of,
    sandbox,
)
from ppmcal.store.tally import BOUNDS, DIFFERS, LATER, FileCheck, ValueDifference, is_later
from ppmcal.wording.progress import stage
from ppmcal.wording.told import ShortTable


@dataclass(frozen=True)
class VerificationResult:
    """What came of running results again.

    Attributes:
        record: each run with its files, as ``ppmcal verify --json`` prints it.
    """

    record: VerificationRecord

    @property
    def exit_code(self) -> int:
        """0 same, 1 differs, 2 an input is missing or has changed, 3 a run failed."""
        return self.record.exit_code

    @property
    def findings(self) -> tuple[Note, ...]:
        """Return a sentence for each run that does not come out as it was."""
        return tuple(Note(r.sentence()) for r in self.record.runs if r.exit_code)

    def told(self) -> Iterator[str | ShortTable]:
        """Yield what became of each run."""
        for run in self.record.runs:
            yield run.sentence()
            if run.environment:
                yield ("Not as it was, so numbers may be off by a little: "
                       f"{'; '.join(run.environment)}.")
            if run.files:
                yield ShortTable(["file", "", "values that differ"], [
                    [f.file, f.status, str(f.count or "")] for f in run.files], (2,))
            for file in run.files:
                if file.words():
                    yield f"{file.file}: {file.words()}."

    warnings: ClassVar[tuple[str, ...]] = ()
    row_failures: ClassVar[tuple[str, ...]] = ()

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        return self.record.entries(whole=True)


def run(asked: VerifyArguments) -> VerificationResult:
    """Make results again from the same inputs and options, and compare them value by value.

    Nothing is written but into a temporary folder. Where version, libraries and processor are as
    they were, every byte must be the same; elsewhere numbers may be off by a little, and
    everything else not at all, but for the wording of another version: see
    :mod:`ppmcal.store.tally`.
    """
    folders, inputs = asked.folders, asked.inputs
    if inputs is not None and not Path(inputs).is_dir():
        raise BadInput("is not a folder", f"--inputs: {inputs}", "Name the folder of the inputs")
    checks: list[RunCheck] = []
    for folder in folders:
        found = list(recorded_runs(Path(folder)))
        if not found:
            raise BadInput("holds no results that ppmcal has recorded", str(folder),
                           "Give a folder that a command wrote")
        with stage(str(folder), len(found)) as work:
            for run in found:
                checks += _checked(run, None if inputs is None else Path(inputs))
                work.done()
    code = max((c.exit_code for c in checks), default=0)
    return VerificationResult(VerificationRecord(
        format=VerificationRecord.FORMAT, bounds=BOUNDS, runs=tuple(checks), exit_code=code))


def _checked(run: RecordedRun, inputs: Path | None) -> list[RunCheck]:
    """Do a run again and compare; its own check first, then those of the folders within."""
    spec = recorded(run.source.function)
    if spec is None or run.in_memory:
        why = ("a machine or data were given to Python in memory" if spec else
               "it is not recorded how it was written, or by another version")
        return [_ended(run, UNKNOWN, f"cannot be run again, {why}.")]
    found = FoundInputs(run, inputs)
    if found.wrong:
        return [_ended(run, INPUT, inputs=found.wrong)]
    with sandbox(run.working_folder) as box:
        try:
            source = _run_again(run, spec, box, found.places)
        except (MemoryError, RecursionError):
            return [_ended(run, FAILED, "the run itself needs more memory than there is.")]
        except Exception as error:    # whatever a record that was made up leads to
            own = "" if isinstance(error, PpmcalError) else f"{type(error).__name__}: "
            return [_ended(run, FAILED, f"the run itself fails: {own}{error}")]
        return list(_compared(run, source, box))


def _run_again(run: RecordedRun, spec: Command, box: Sandbox, inputs: Mapping[str, Path]
               ) -> Mapping[str, Any]:
    """Write the results into the sandbox; return where they come from."""
    box.lay_out(inputs)
    options = {k: box.inside(v) for k, v in run.source.options.items()}
    asked = _arguments(spec, options)
    out = Path(options["out"]) if run.whole else _results(run, box)
    with contextlib.chdir(box.cwd), running(run.command, out, typed=run.source.command) as own:
        try:
            result: Result = carry_out(spec, asked)
        except PpmcalError as error:
            left = refused(spec, error, asked, out)
            if left is None or not left.written:
                raise
        else:
            result.save(out)
    return own.source


def _results(run: RecordedRun, box: Sandbox) -> Path:
    """Return where results go within, in a folder of the name that they had."""
    return box.root / RESULTS / run.name


def _compared(run: RecordedRun, source: Mapping[str, Any], box: Sandbox) -> Iterator[RunCheck]:
    """Yield what came out, folder by folder."""
    apart = environment_words({"version": run.source.version, **run.source.environment},
                              {"version": source["version"], **source["environment"]})
    compare = partial(compared, exact=not apart, root=os.fsencode(box.root),
                      reword=run.source.version != source["version"],
                      later=is_later(run.source.version, source["version"]))
    out = box.place(run.source.options["out"]) if run.whole else _results(run, box)
    yield _files(run, out, apart, compare)
    for within in folders_within(run.folder) if run.whole else ():
        other = out / within.relative_to(run.folder)
        for one in runs_of(within):
            yield _files(one, other, apart, compare) if (other / RECORD).is_file() else _ended(
                one, DIFFERS, "is not written any more.")


def _files(run: RecordedRun, other: Path, apart: tuple[str, ...], compare: partial[FileCheck]
           ) -> RunCheck:
    """Compare the files of a run with those of ``other``."""
    names = dict.fromkeys([*run.digests, *read_record(other).files])
    files = [_file(name, run.folder / name, other / name, run.digests.get(name, ""), compare)
             for name in names]
    return RunCheck(folder=str(run.folder), command=run.command, status=status_of(files),
                    environment=apart, files=tuple(files))


def _ended(run: RecordedRun, status: str, message: str = "", inputs: Sequence[InputCheck] = ()
           ) -> RunCheck:
    return RunCheck(folder=str(run.folder), command=run.command, status=status, message=message,
                    inputs=tuple(inputs))


def _file(name: str, there: Path, again: Path, digest: str, compare: partial[FileCheck]
          ) -> FileCheck:
    """Compare one file with what came out.

    Args:
        name: of the file.
        there: where it is.
        again: where it was written again.
        digest: its SHA-256 when it was written, empty where that is not recorded.
        compare: how both are compared.
    """
    now, then = digest_of(again), digest_of(there)
    if then and not now and compare.keywords["later"]:
        return FileCheck(file=name, status=LATER, worst=ValueDifference(
            place="made by a later version: the file is not understood"))
    if not (now and then):
        gone = "is not there" if now else "is not written any more"
        return FileCheck(file=name, status=DIFFERS, count=1, worst=ValueDifference(place=gone))
    if now == then:
        return FileCheck(file=name)
    found = compare(name, there.read_bytes(), again.read_bytes())
    if digest and then != digest:
        return replace(found, edited=True, status=DIFFERS)
    return found


def _arguments(spec: Command, options: Mapping[str, Any]) -> Arguments:
    """Return the arguments of a run.

    Raises:
        BadInput: the command has no such argument.
    """
    known = {one.name for one in taken(spec.arguments, CONSOLE) if one.option.recorded}
    if strange := [k for k in options if k not in known]:
        raise BadInput(f"the option '{strange[0]}' is of another version of ppmcal", "",
                       "Run it again with the version that is recorded")
    return spec.arguments(**options)
