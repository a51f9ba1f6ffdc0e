"""What changed between two calibrations of a machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from ppmcal.api.fitted_again import reason, with_equal_freedoms
from ppmcal.api.inputs import Path_, recorded, same_machine, source_of
from ppmcal.api.result import Result
from ppmcal.calibration.fit import Posterior, secondary
from ppmcal.calibration.sessions import Comparison, between
from ppmcal.errors import PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.io.results.comparison import ComparisonRecord, verdict_sentence
from ppmcal.io.results.knowledge import read_knowledge, read_posterior
from ppmcal.model.mechanism import Mechanism

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

    @property
    def needs_a_look(self) -> bool:
        """Whether the machine has changed, or there are findings."""
        return (self.comparison.changed or bool(self.comparison.why_not)
                or bool(self.findings))

    def files(self) -> Mapping[str, str | bytes]:
        """Return compare.csv and comparison.json."""
        return dict(self.record.files())

    def headline(self) -> str:
        """Return whether the machine has changed."""
        return verdict_sentence(self.record)


@recorded
def compare(old: Path_, new: Path_) -> ComparisonResult:
    """Tell what changed between two calibrations of one machine.

    Args:
        old: folder that ``identify`` wrote, or the identified.yaml in it.
        new: the same of the later calibration, from other measurements.

    Raises:
        BadInput: anything wrong in the files, or another machine.
    """
    first, second = (p / "identified.yaml" if p.is_dir() else p for p in (Path(old), Path(new)))
    mechanism = read_mechanism(second)
    earlier = read_mechanism(first)
    paths = [p.with_name("identification.json") for p in (first, second)]
    before, after = (read_posterior(p, mechanism) for p in paths)
    knowledge = read_knowledge(paths[0], mechanism)
    # what either had free is no fixed value
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
           ) -> tuple[Comparison, list[str], bool, list[str]]:
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
    more, beside, again = list[str](), list[str](), bool(only)
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
             ) -> tuple[Comparison, list[str]]:
    values = mechanism.values.copy()
    values[list(known[1].places)] = known[1].estimate(mechanism)
    return between(mechanism.with_values(values), *known, volume or {}, np.random.default_rng(0))
