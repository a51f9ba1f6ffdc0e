"""What was found, fitted: the machine with what has a name, and what held-out poses say of it."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ppmcal.calibration.fit import Fit, FitOptions, secondary
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.explanation import (
    UNFITTED,
    CausePlace,
    Round,
    explained,
    what_is_fitted,
)
from ppmcal.diagnosis.extended_model import Added, extended
from ppmcal.diagnosis.first_rows import without_first_rows
from ppmcal.diagnosis.held_out_gap import Gap, measure_gap, training_part
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.linearisation import Linearisation, linearisation_of, without
from ppmcal.diagnosis.next_experiment import record_more
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.predictive_check import predictions
from ppmcal.diagnosis.question import Source, WrongRows
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.result import NAMED, Found, LeftOutBlocks
from ppmcal.diagnosis.unknown_causes import UNKNOWN_FAMILY
from ppmcal.errors import PpmcalError
from ppmcal.inference.sets import Member
from ppmcal.model.dataset import Dataset
from ppmcal.notes import Note

NOT_PREDICTED = ("{} would explain these rows, but poses left out are surely predicted worse with "
                 "it than by geometry alone: it has no name here; measure more poses, or {}")


@dataclass(frozen=True, eq=False)
class Told:
    """What was found, and the fit of all rows with what has a name.

    ``effects``: of each place that has a name, those that were added for it; ``given_up``: what was
    not brought to its end.
    """

    whole: Fit
    rounds: Sequence[Round]
    fit: Fit
    effects: tuple[tuple[CausePlace, tuple[Added, ...]], ...]
    verdict: str
    given_up: tuple[Note, ...] = ()

    @property
    def last(self) -> Round:
        """The last question and its answer."""
        return self.rounds[-1]

    @property
    def added(self) -> tuple[Added, ...]:
        """All effects that were added."""
        return tuple(a for _, own in self.effects for a in own)

    @property
    def first_rows(self) -> frozenset[tuple[int, int]]:
        """Rows that only the fit left out, as what has a name is not known in them yet."""
        pairs = zip(self.whole.problem.datasets, self.fit.problem.datasets, strict=True)
        return frozenset((n, int(row)) for n, (old, new) in enumerate(pairs)
                         for row in np.flatnonzero(old.usable & ~new.usable))

    def label(self, member: Member) -> str:
        """Return what a member of a place is called, empty for nothing."""
        return " and ".join(sorted({_called(self.last.asked.sources[i]) for i in member.own}))

    def hypotheses(self, member: Member) -> list[Hypothesis]:
        """Return all that have a name in the likeliest set of a member."""
        sources = (self.last.asked.sources[i] for i in member.chosen)
        return [s for s in sources if isinstance(s, Hypothesis) and not s.anonymous]


def _called(source: Source) -> str:
    if isinstance(source, WrongRows):
        return source.label
    if isinstance(source, Hypothesis) and not source.anonymous:
        return source.label
    return f"{UNKNOWN_FAMILY} cause ({source.label})"


def told(whole: Fit, options: FitOptions, kinds: Sequence[str] | None) -> Told:
    """Ask what is in the rows of a fit, and fit what has a name."""
    rounds = explained(whole, options, kinds)
    last = rounds[-1]
    ended = tuple(dict.fromkeys(said for r in rounds for said in r.given_up))
    named = [p for p in last.places if p.named]
    if not named:
        return Told(whole, rounds, whole, (), last.verdict, ended)
    every = last.sized(last.told)
    mine = {id(p.hypothesis) for p in named}
    sized = [s for s in every if id(s.hypothesis) in mine]
    machine, added = extended(whole.problem.mechanism, sized)
    if [what_is_fitted([a.hypothesis]) for a in added] == [
            what_is_fitted([a.hypothesis]) for a in last.added]:
        fit, added = last.fit, tuple(replace(now, hypothesis=a.hypothesis)
                                     for now, a in zip(last.added, added, strict=True))
    else:
        try:
            fit = with_mechanism(whole, machine, options)
        except PpmcalError as error:
            what = ", ".join(s.hypothesis.label for s in sized)
            return Told(whole, rounds, whole, (), "unnamed",
                        (*ended, Note(UNFITTED.format(what, error.what), topic="search")))
    fit = without_first_rows(fit, options)
    effects = tuple((p, tuple(a for a in added if a.hypothesis is p.hypothesis)) for p in named)
    return Told(whole, rounds, fit, effects, last.verdict, ended)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What poses that no fit has seen say of what was found.

    ``found``: fits and questions of the others; ``poses``: those; ``gap``: None where none could be
    held out; ``predictive``: rows left out in turn; ``verdict``: what does surely not predict has
    no name; ``said``: so, in words.
    """

    found: Found
    poses: tuple[Dataset, ...]
    gap: Gap | None
    predictive: tuple[LeftOutBlocks, ...]
    verdict: str
    said: tuple[Note, ...] = ()

    @property
    def named(self) -> bool:
        """Whether something has a name."""
        return self.verdict in NAMED


def held_out(what: Told, options: DiagnosisOptions, notes: list[Note]) -> HeldOut:
    """Return what held-out poses say; ``notes``: to which is added what could not be had."""
    found, poses = _with_held_out(what, options, notes)
    gap = secondary("the gap on held-out poses", partial(
        measure_gap, found.before, found.after, poses, found.noise, options.seed), None,
        notes) if poses else None
    predictive = secondary("how rows left out are predicted", partial(predictions, what.last), (),
                           notes)
    if what.verdict in NAMED and predictive and predictive[0].surely_worse:
        names = ", ".join(dict.fromkeys(p.label for p, _ in what.effects))
        bare = replace(found, after=found.before, last=found.first, added=())
        return HeldOut(bare, poses, gap, predictive, "unnamed", (
            Note(NOT_PREDICTED.format(names, record_more(what.whole.problem.datasets)),
                 topic="held out"),))
    return HeldOut(found, poses, gap, predictive, what.verdict)


def _with_held_out(what: Told, options: DiagnosisOptions, beside: list[Note]
                   ) -> tuple[Found, tuple[Dataset, ...]]:
    """Return fits and questions, and the poses that they do not know.

    Where the others are too few for a fit, none are held out, which is noted.
    """
    def make() -> tuple[Found, tuple[Dataset, ...]]:
        training, held = training_part(what.whole, options)
        return _found(what, training, options), held

    found = secondary("what held-out poses say", make, None, beside)
    return (_found(what, what.whole, options), ()) if found is None else found


def _found(what: Told, training: Fit, options: DiagnosisOptions) -> Found:
    """Return the fits of the training rows, without and with what has a name, and the questions."""
    rows = what.last.rows | what.first_rows
    first = _stage(what.rounds[0], rows, ())
    if not what.added:
        return Found(training, training, first, first, ())
    last = what.last
    after = what.fit if training is what.whole else with_mechanism(
        training, what.fit.problem.mechanism.with_values(what.fit.state.g), options.fit)
    return Found(training, after, first,
                 _stage(last, rows, [p.hypothesis for p, _ in what.effects]), what.added)


def _stage(asked: Round, rows: Container[tuple[int, int]], chosen: Sequence[Hypothesis | None]
           ) -> Linearisation:
    """Return the linear problem of a question without ``rows`` that do not belong.

    What was chosen has no place in it where the rows that are left do not tell it.
    """
    system, keep = asked.asked.system, [np.zeros(len(d), dtype=bool)
                                        for d in asked.fit.problem.datasets]
    for at in zip(system.dataset.tolist(), system.row.tolist(), strict=True):
        keep[at[0]][at[1]] = at not in rows
    system = without(build(asked.fit.problem, asked.fit.state, keep), asked.columns)
    found = library(system, asked.kinds, [asked.fit.problem.free[c] for c in asked.columns],
                    apart=True)
    there = [nearest(h, found.hypotheses) for h in chosen if h is not None]
    return linearisation_of(system, found, [i for i in there if i is not None], asked.whitening,
                            asked.columns)


def nearest(h: Hypothesis, some: Sequence[Hypothesis]) -> int | None:
    """Return the number of the same hypothesis over other rows, whose grids differ.

    None where these rows do not tell it.
    """
    same = [i for i, f in enumerate(some)
            if f.names == h.names and f.shared == h.shared and f.label == h.label]
    return min(same, key=lambda i: h.apart(some[i]), default=None)
