"""What changed between two calibrations of a machine."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from ppmcal.calibration.fit import Fit, FitOptions, Posterior, Problem, secondary
from ppmcal.calibration.sessions import Comparison, between, fitted_together
from ppmcal.commands.compare.options import CompareArguments
from ppmcal.commands.identify.run import fitted_rows
from ppmcal.commands.inputs import prepared, same_machine
from ppmcal.commands.result import Result
from ppmcal.errors import BadInput, NoResult, PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.io.results.batch import CampaignQuantity, change_quantities
from ppmcal.io.results.comparison import (
    ComparisonRecord,
    ParameterDifference,
    about_changes,
    change_sentence,
    platform_sentence,
    verdict_sentence,
)
from ppmcal.io.results.knowledge import KNOWLEDGE, read_knowledge, read_posterior
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import FINDING, NOTE, Note
from ppmcal.store.inputs import digest_of
from ppmcal.store.provenance import source_of
from ppmcal.store.runs import FoundInputs, RecordedRun, runs_of
from ppmcal.wording import abbreviate_list, number
from ppmcal.wording.told import ShortTable, Told

FUNCTION = "identify.identify"


def with_equal_freedoms(mechanism: Mechanism, folders: Sequence[Path],
                        known: tuple[Posterior, Posterior]
                        ) -> tuple[tuple[Posterior, Posterior], list[str]]:
    """Return two calibrations with all parameters free that either had, and the files behind.

    Both are fitted anew to their own rows, which are read again.

    Args:
        mechanism: the newer machine.
        folders: of the older and the newer calibration.
        known: what the two knew with their own parameters free.

    Raises:
        BadInput, NoResult: why that cannot be done.
    """
    free = sorted({*known[0].places, *known[1].places})
    runs = [_run(folder) for folder in folders]
    # the newer machine has every effect that the older one had
    run, places = runs[1]
    machine = _path(places, run.source.options["mechanism"])
    old, new = (_fitted(*one, machine, free, mechanism.names) for one in runs)
    methods = {_method(run) for run, _ in runs}
    both = fitted_together(old, new, known, FitOptions(
        methods.pop() if len(methods) == 1 else "prior"))
    return both, sorted({_path(places, p) for _, places in runs for p in places})


def _run(folder: Path) -> tuple[RecordedRun, Mapping[str, Path]]:
    """Return the run that wrote a calibration, and where each of its inputs is, unchanged.

    Raises:
        BadInput: it is not known how it was made, or its inputs have changed.
    """
    where = str(folder)
    run = next((r for r in runs_of(folder) if r.source.function == FUNCTION), None)
    # neither of them may have been an object of Python
    if run is None or not run.data or not all(
            isinstance(v, str) for v in (run.source.options.get("mechanism"), *run.data)):
        raise BadInput("it is not recorded from which files it was made", where)
    if run.source.options.get("keep"):
        raise BadInput("carries on an earlier calibration, whose rows it does not have", where)
    found = FoundInputs(run, None)
    if wrong := found.wrong:
        state = "has changed since" if wrong[0].now else "is not there any more"
        raise BadInput(f"{wrong[0].file}, behind it, {state}", where)
    _refuse_other_sidecars(run, found.places)
    return run, found.places


def _refuse_other_sidecars(run: RecordedRun, places: Mapping[str, Path]) -> None:
    """Refuse a table beside which, where it is read, stands another sidecar than was recorded.

    Raises:
        BadInput: with the sidecar's name.
    """
    stems = {os.path.splitext(path)[0]: places[path] for path in run.data if path in places}
    for other, digest in run.source.inputs.items():
        table = stems.get(os.path.splitext(other)[0])
        if table is not None and digest != digest_of(table.with_name(os.path.basename(other))):
            raise BadInput(f"{other}, behind it, has changed since beside {table}", str(run.folder))


def _path(places: Mapping[str, Path], path: str) -> str:
    """Return where an input is, as seen from here.

    A path that is not a recorded input is returned as it is, and so is one that still leads to it:
    whoever runs this again, elsewhere, finds and names the same file.
    """
    there = places.get(path, Path(path))
    return path if there == Path(path) else os.path.relpath(there)


def _method(run: RecordedRun) -> str:
    own = run.source.options
    return "flat" if own.get("prior") == "flat" else str(own.get("method", "prior"))


def _fitted(run: RecordedRun, places: Mapping[str, Path], machine: str, free: Sequence[int],
            names: Sequence[str]) -> Fit:
    """Return a fit of a run's own rows, whose inputs are at ``places``, with these free.

    Raises:
        BadInput, NoResult: as ``identify``; or the machine's file has other parameters.
    """
    own = run.source.options
    found, datasets = prepared(machine, [_path(places, d) for d in run.data])
    if list(found.names) != list(names):
        raise BadInput(f"{machine} has other parameters than the calibration", str(run.folder))
    method = _method(run)
    options = FitOptions("prior" if method == "damped" else method,
                         robust=not own.get("keep_outliers"))
    found = replace(found, free=tuple(free), optional=())
    return fitted_rows(Problem(found, datasets, found.free), options,
                       str(own.get("sigma", "stated")))[0]


def reason(error: PpmcalError, only: Sequence[str]) -> str:
    """Return why calibrations with other parameters free could not be compared."""
    assert isinstance(error, BadInput | NoResult)
    where = f"{error.where}: " if error.where else ""
    return (f"{abbreviate_list(only)} {'were' if len(only) > 1 else 'was'} free in only one of "
            "the two, and they could not be fitted anew with the same ones free "
            f"({where}{error.what}); identify both with the same --free")


SHOWN = 12
"""Parameters that the console shows."""
CONFIRMED = "whether one fit to the rows of both confirms the change"


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonResult(Result):
    """What changed.

    Attributes:
        mechanism: the machine as it was calibrated last.
        comparison: the test of all parameters together and the changes it names, SI.
        record: the content of comparison.json.
    """

    COMMAND: ClassVar[str] = "compare"
    TABLE: ClassVar[str] = "compare.csv"

    mechanism: Mechanism
    comparison: Comparison
    record: ComparisonRecord

    def remarks(self) -> Sequence[str]:
        """Return the findings, and how the two compare: a note where the machine is the same."""
        found = self.comparison
        same = not (found.changed or found.why_not)
        return [Note(self.headline(), NOTE if same else FINDING), *self.findings]

    def files(self) -> Mapping[str, str | bytes]:
        """Return compare.csv and comparison.json."""
        return self.record.files()

    @property
    def warnings(self) -> list[str]:
        """What needs a look."""
        return list(self.findings)

    def told(self) -> Iterator[Told]:
        """Yield whether the machine has changed, how, and by which parameters."""
        record = self.record
        yield verdict_sentence(record)
        yield from map(change_sentence, record.changes)
        yield from about_changes(record)
        if not record.parameters:
            return
        rows = sorted(record.parameters, key=lambda r: r.p_alone or 0.0)
        yield ShortTable(
            ["parameter", "new", "new - old", "+- 95 %", "unit", "changed"],
            [[r.name, number(r.new, 6), f"{r.difference:+.3g}", number(r.wide or 0.0, 2), r.unit,
              _changed(r)] for r in rows[:SHOWN]], (1, 2, 3))
        if len(rows) > SHOWN:
            yield f"The {SHOWN} likeliest to have changed; all {len(rows)} in compare.csv."
        if moved := platform_sentence(record):
            yield moved

    @property
    def verdict(self) -> str:
        """Whether the machine has changed, in a word."""
        return self.record.verdict

    def quantities(self) -> Iterator[CampaignQuantity]:
        """Yield the changes."""
        return change_quantities(self.record)

    def headline(self) -> str:
        """Return whether the machine has changed."""
        return verdict_sentence(self.record)


def _changed(row: ParameterDifference) -> str:
    """Return by how much the named changes say that a parameter changed."""
    if row.status == "changed":
        return f"{row.explained:+.3g}" if row.explained else "yes"
    return "" if row.status == "unchanged" else row.status


def run(asked: CompareArguments) -> ComparisonResult:
    """Tell what changed between two calibrations of one machine."""
    first, second = (p / "identified.yaml" if p.is_dir() else p for p in (
        Path(asked.old), Path(asked.new)))
    mechanism = read_mechanism(second)
    earlier = read_mechanism(first)
    paths = [p.with_name(KNOWLEDGE) for p in (first, second)]
    before, after = (read_posterior(p, mechanism) for p in paths)
    knowledge = read_knowledge(paths[0], mechanism)
    # what either had free is not a fixed value
    both = replace(mechanism, free=tuple({*before.places, *after.places}))
    odd = same_machine(both, earlier, first)
    only = sorted(mechanism.names[p] for p in {*before.places} ^ {*after.places})
    found, notes, again, more = _found(mechanism, (before, after), only,
                                       (first.parent, second.parent), knowledge.volume)
    findings = (*odd, *notes)
    source = source_of("compare", [*mechanism.inputs, *(str(p) for p in paths), *more], None)
    return ComparisonResult(source, findings, mechanism, found, ComparisonRecord.of(
        found, mechanism, source, findings, only, again=again))


def _found(mechanism: Mechanism, known: tuple[Posterior, Posterior], only: Sequence[str],
           folders: Sequence[Path], volume: Mapping[str, tuple[float, float]]
           ) -> tuple[Comparison, list[Note], bool, list[str]]:
    """Return the comparison, what makes it doubtful, and of what files it is.

    A change that one fit to the rows of both does not confirm is none: in directions that a
    session hardly sees, the two may be too far apart for a linear step.

    Args:
        mechanism: the newer machine.
        known: what both calibrations know.
        only: parameters that one of the two had free.
        folders: of both.
        volume: as :func:`ppmcal.calibration.sessions.between`.

    Returns:
        The comparison, notes, whether its values are of fits anew, and the files behind these.
    """
    more, beside, again = list[str](), list[Note](), bool(only)
    if only:
        try:
            known, more = with_equal_freedoms(mechanism, folders, known)
        except PpmcalError as error:
            return Comparison.impossible(reason(error, only)), [], False, []
    elif _between(mechanism, known)[0].changed:
        closer, more = secondary(CONFIRMED, lambda: with_equal_freedoms(
            mechanism, folders, known), (None, []), beside)
        again = closer is not None and not _between(mechanism, closer)[0].changed
        known = closer if closer is not None and again else known
    found, notes = _between(mechanism, known, volume)
    return found, [*notes, *beside], again, more


def _between(mechanism: Mechanism, known: tuple[Posterior, Posterior],
             volume: Mapping[str, tuple[float, float]] | None = None
             ) -> tuple[Comparison, list[Note]]:
    values = mechanism.values.copy()
    values[list(known[1].places)] = known[1].estimate(mechanism)
    return between(mechanism.with_values(values), *known, volume or {}, np.random.default_rng(0))
