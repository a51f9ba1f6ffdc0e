"""What a diagnosis is asked for, and the poses that its fits do not see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ppmcal.calibration.fit import Fit, coordinates, single_gross_rows
from ppmcal.calibration.fit import FitOptions as FitOptions
from ppmcal.calibration.validation import split
from ppmcal.diagnosis.held_out_gap import Gap, measure_gap
from ppmcal.diagnosis.recorded import usable
from ppmcal.diagnosis.refit import of_rows
from ppmcal.diagnosis.result import Found
from ppmcal.model.dataset import Dataset


@dataclass(frozen=True)
class DiagnosisOptions:
    """How to diagnose.

    ``holdout``: part of the poses kept back; ``kinds``: to try, or all; ``by_session``: the gap is
    that of sessions left out in turn; ``held``: names of parameters that a choice of freedoms
    holds, which the intervals count.
    """

    holdout: float = 0.27
    seed: int = 0
    kinds: tuple[str, ...] | None = None
    by_session: bool = False
    held: tuple[str, ...] = ()
    fit: FitOptions = field(default_factory=FitOptions)


def training_part(whole: Fit, options: DiagnosisOptions) -> tuple[Fit, tuple[Dataset, ...]]:
    """Put whole commanded poses aside, where that leaves enough to fit; fit the others."""
    problem = whole.problem
    out = split(problem.datasets, options.holdout, options.seed)
    values = sum(int((~o).sum()) * len(coordinates(d, problem.mechanism.motion))
                 for o, d in zip(out, problem.datasets, strict=True))
    if values < 2.0 * len(problem.columns) or not any(o.any() for o in out):
        return whole, ()
    held = tuple(d.take(o & usable(d) & ~typo) for d, o, typo in zip(
        problem.datasets, out, single_gross_rows(whole), strict=True))
    return of_rows(whole, [~o for o in out], options.fit), held


def held_out_gap(found: Found, held: Sequence[Dataset], options: DiagnosisOptions) -> Gap | None:
    """Return the gap of what was found in the training part on the other poses, if any."""
    if not held:
        return None
    return measure_gap(found.before, found.after, held, found.noise, options.seed)
