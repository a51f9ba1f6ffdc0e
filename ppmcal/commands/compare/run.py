"""What changed between two calibrations of a machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from ppmcal.calibration.fit import Posterior, secondary
from ppmcal.calibration.sessions import Comparison, between
from ppmcal.commands.compare.fitted_again import reason, with_equal_freedoms
from ppmcal.commands.compare.options import CompareArguments
from ppmcal.commands.inputs import same_machine
from ppmcal.commands.result import Result
from ppmcal.errors import PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.io.results.batch import CampaignQuantity, change_quantities
from ppmcal.io.results.comparison import (
    ComparisonRecord,
    ParameterDifference,
    anew_sentence,
    apart_sentence,
    change_sentence,
    noise_sentence,
    platform_sentence,
    remainder_sentence,
    verdict_sentence,
)
from ppmcal.io.results.knowledge import read_knowledge, read_posterior
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import FINDING, NOTE, Note
from ppmcal.store.provenance import source_of
from ppmcal.wording import number
from ppmcal.wording.told import ShortTable, Told

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
        return dict(self.record.files())

    @property
    def warnings(self) -> list[str]:
        """What needs a look."""
        return list(self.findings)

    def told(self) -> Iterator[Told]:
        """Yield whether the machine has changed, how, and by which parameters."""
        record = self.record
        yield verdict_sentence(record)
        yield from map(change_sentence, record.changes)
        yield from filter(None, (remainder_sentence(record), apart_sentence(record),
                                 noise_sentence(record), anew_sentence(record)))
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
    paths = [p.with_name("identification.json") for p in (first, second)]
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
