"""Search, fit what was found, search again, until the choice stands; in part of the poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.fit import FitOptions as FitOptions
from ppmcal.calibration.gross_rows import gross_errors
from ppmcal.calibration.observation import coordinates
from ppmcal.calibration.validation import split
from ppmcal.diagnosis.extended_model import Added, with_named
from ppmcal.diagnosis.recorded import usable
from ppmcal.diagnosis.refit import of_rows, with_mechanism
from ppmcal.diagnosis.result import Found
from ppmcal.diagnosis.stage import DRAWS, Stage, named_only, run_stage
from ppmcal.linalg import Bools
from ppmcal.model.dataset import Dataset

Say = Callable[[str], None]
ROUNDS = 3


MANY_OUT = 0.02
"""More outliers than this part of the rows may be an effect."""


@dataclass(frozen=True)
class DiagnosisOptions:
    """How to diagnose.

    ``holdout``: part of the poses kept back; ``draws``: of noise; ``kinds``: to try, or all;
    ``by_session``: the gap is that of sessions left out in turn.
    """

    holdout: float = 0.27
    seed: int = 0
    draws: int = DRAWS
    kinds: tuple[str, ...] | None = None
    by_session: bool = False
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
        problem.datasets, out, _typed_wrong(whole), strict=True))
    return of_rows(whole, [~o for o in out], options.fit), held


def found_in(before: Fit, options: DiagnosisOptions, say: Say) -> Found:
    """Fit, test, add what was chosen, and again at the new fit until the choice stands.

    Rows that look like outliers may be the effect itself: where there are many, the search
    is made with them too, and holds if its effects explain most of them.
    """
    training = before.problem
    say("testing effects against simulated noise")
    first = run_stage(training, before.state, before.keep, options.seed,
                      options.kinds, options.draws)
    found = _settled(before, first, options, say)
    out = sum(len(r) for r in before.reasons)
    if out <= MANY_OUT * sum(k.size for k in before.keep):
        return found
    say("testing effects with the outliers")
    everything = [k | (o & ~typo) for k, o, typo in zip(
        before.keep, before.outliers, _typed_wrong(before), strict=True)]
    second = run_stage(training, before.state, everything, options.seed,
                       options.kinds, options.draws)
    other = _settled(before, second, options, say)
    explained = sum(len(r) for r in other.after.reasons) < 0.5 * sum(
        len(r) for r in found.after.reasons)
    return other if other.added and explained else found


def _typed_wrong(fit: Fit) -> list[Bools]:
    """Return rows (N,) of each data set that are gross errors while their neighbours are not."""
    rows = [k | o for k, o in zip(fit.keep, fit.outliers, strict=True)]
    out = []
    for gross in gross_errors(fit.problem, fit.state, rows):
        beside = np.convolve(gross, [1, 0, 1], mode="same") > 0 if gross.size > 1 else gross
        out.append(gross & ~beside)
    return out


def _settled(before: Fit, first: Stage, options: DiagnosisOptions, say: Say) -> Found:
    """Add what a stage chose, refit, test again, until the choice stands."""
    after, last = before, first
    added: tuple[Added, ...] = ()
    for _ in range(ROUNDS):
        if not named_only(last):
            return Found(before, before, first, last, ())
        mechanism, added = with_named(before.problem.mechanism, last.search, named_only(last))
        say("fitting geometry and " + ", ".join(f.label for f in last.named))
        after = with_mechanism(before, mechanism, options.fit)
        names = {n for a in added for n in a.parameters}
        columns = [c for c, p in enumerate(after.problem.free)
                   if mechanism.parameters[p].name in names]
        again = run_stage(after.problem, after.state, after.keep, options.seed,
                          options.kinds, options.draws, columns, first.search,
                          [last.hypotheses[i] for i in last.chosen])
        same = {(f.family, f.on) for f in again.named} == {(f.family, f.on) for f in last.named}
        last = again
        if same:
            break
    return Found(before, after, first, last, added)
