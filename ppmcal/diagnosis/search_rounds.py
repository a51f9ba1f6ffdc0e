"""Search, fit what was found, search again, until the choice stands; in part of the poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from ppmcal.calibration.fit import Fit, coordinates, single_gross_rows
from ppmcal.calibration.fit import FitOptions as FitOptions
from ppmcal.calibration.validation import split
from ppmcal.diagnosis.extended_model import Added, columns_added, with_named
from ppmcal.diagnosis.held_out_gap import Gap, measure_gap
from ppmcal.diagnosis.recorded import usable
from ppmcal.diagnosis.refit import (
    Key,
    key_of,
    lasting_values,
    never_named,
    nothing_named,
    of_rows,
    with_mechanism,
)
from ppmcal.diagnosis.result import Found
from ppmcal.diagnosis.selection import borne, own_log_p
from ppmcal.diagnosis.stage import DRAWS, Stage, named_only, run_stage
from ppmcal.errors import BadInput, NoResult
from ppmcal.linalg import Bools
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import begin, note

ROUNDS = 3


MANY_OUT = 0.02
"""More outliers than this part of the rows may be an effect."""


@dataclass(frozen=True)
class DiagnosisOptions:
    """How to diagnose.

    ``holdout``: part of the poses kept back; ``draws``: of noise; ``kinds``: to try, or all;
    ``by_session``: the gap is that of sessions left out in turn; ``held``: names of parameters that
    a choice of freedoms holds, which the intervals count; ``evidence``: by the probabilities of
    causes in the place of tests one by one.
    """

    holdout: float = 0.27
    seed: int = 0
    draws: int = DRAWS
    kinds: tuple[str, ...] | None = None
    by_session: bool = False
    held: tuple[str, ...] = ()
    evidence: bool = False
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


def found_in(before: Fit, options: DiagnosisOptions) -> Found:
    """Fit, test, add what was chosen, and again at the new fit until the choice stands.

    Rows that look like outliers may be the effect itself: where there are many, the search
    is made with them too, and holds if its effects explain most of them.
    """
    begin("testing effects against simulated noise")
    found = _searched(before, before.keep, options)
    out = sum(len(r) for r in before.reasons)
    if out <= MANY_OUT * sum(k.size for k in before.keep):
        return found
    begin("testing effects with the outliers")
    everything = [k | (o & ~typo) for k, o, typo in zip(
        before.keep, before.outliers, single_gross_rows(before), strict=True)]
    other = _searched(before, everything, options)
    explained = sum(len(r) for r in other.after.reasons) < 0.5 * sum(
        len(r) for r in found.after.reasons)
    return other if other.added and explained else found


def confirm(found: Found, whole: Fit, options: DiagnosisOptions) -> tuple[Found, Fit | None]:
    """Drop effects that do not stand in all rows; return what is left and its fit to them.

    Args:
        found: on the training rows.
        whole: fit of all rows without effects.
        options: of the diagnosis.
    """
    while found.added:
        fit = with_mechanism(whole, found.after.problem.mechanism, options.fit)
        values = lasting_values(fit, found)
        weakest = max(values, key=lambda key: values[key])
        if values[weakest] <= found.first.search.name:
            return found, fit
        last = replace(found.last, chosen=_without(found.last, weakest))
        if not named_only(last):
            break
        smaller = _refitted(found, last, options)
        if smaller is None:
            break
        found = smaller
    return nothing_named(found), None


def _without(last: Stage, key: Key) -> tuple[int, ...]:
    """Return the chosen hypotheses without those of ``key``; of two waves the weaker one goes."""
    mine = [i for i in last.chosen if key_of(last.hypotheses[i]) == key]
    if len(mine) > 1:
        mine = [max(mine, key=lambda i: own_log_p(last.search, last.chosen, i))]
    return tuple(borne(last.search, [i for i in last.chosen if i not in mine]))


def _refitted(found: Found, last: Stage, options: DiagnosisOptions) -> Found | None:
    """Fit the training rows with what a stage still names, and judge that at its own fit.

    None where that is no machine.
    """
    before, first = found.before, found.first
    mechanism, added = with_named(before.problem.mechanism, last.search, named_only(last))
    after = _machine(before, mechanism, options)
    if after is None:
        return None
    again = _at_fit(after, first, last, added, options)
    same = sorted(map(key_of, again.named)) == sorted(map(key_of, last.named))
    return Found(before, after, first, again if same else last, added)


def _searched(before: Fit, keep: Sequence[Bools], options: DiagnosisOptions) -> Found:
    """Search in some rows, and again where that ends at a value at which no effect is named."""
    for as_named in (False, True):
        first = run_stage(before.problem, before.state, keep, options.seed, options.kinds,
                          options.draws, as_named=as_named)
        found = _settled(before, first, options)
        if not never_named(found):
            break
    return found


def _settled(before: Fit, first: Stage, options: DiagnosisOptions) -> Found:
    """Add what a stage chose, refit, test again, until the choice stands."""
    after, last = before, first
    added: tuple[Added, ...] = ()
    for _ in range(ROUNDS):
        if not named_only(last):
            return Found(before, before, first, last, ())
        mechanism, added = with_named(before.problem.mechanism, last.search, named_only(last))
        begin("fitting effects with the geometry")
        note(", ".join(f.label for f in last.named))
        new = _machine(before, mechanism, options)
        if new is None:
            return nothing_named(Found(before, before, first, last, ()))
        after = new
        again = _at_fit(after, first, last, added, options)
        same = {(f.family, f.on) for f in again.named} == {(f.family, f.on) for f in last.named}
        last = again
        if same:
            break
    return Found(before, after, first, last, added)


def _machine(before: Fit, mechanism: Mechanism, options: DiagnosisOptions) -> Fit | None:
    """Fit the training rows with what a search found; None where they have no pose with it.

    A tower that leans by more than a right angle is found where a shape looks like that of one.
    """
    try:
        return with_mechanism(before, mechanism, options.fit)
    except (BadInput, NoResult):
        return None


def _at_fit(after: Fit, first: Stage, last: Stage, added: Sequence[Added],
            options: DiagnosisOptions) -> Stage:
    """Test again at the fit with what a stage chose, which stays unless something is better."""
    return run_stage(after.problem, after.state, after.keep, options.seed, options.kinds,
                     options.draws, columns_added(after.problem, added), first.search,
                     [last.hypotheses[i] for i in last.chosen], first.as_named)
