"""The diagnosis from the probabilities of causes: asked in all rows, fitted, told."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ppmcal.calibration.compensation import Reading
from ppmcal.calibration.fit import NOTE, Fit, FitOptions, Problem, bounded, identify, secondary
from ppmcal.calibration.interpretation import (
    refuse_after_fit,
    refuse_other_machine,
)
from ppmcal.calibration.validation import LeftOut, left_out, report
from ppmcal.diagnosis import result_tables as tables
from ppmcal.diagnosis.adequacy import Remainder, against_noise
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.explanation import (
    UNFITTED,
    CausePlace,
    Round,
    explained,
    what_is_fitted,
)
from ppmcal.diagnosis.extended_model import Added, extended
from ppmcal.diagnosis.held_out_blocks import SESSION, block_gaps
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.learned_terms import learned_beyond, with_learned
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.localization import localise
from ppmcal.diagnosis.misread_causes import refuse_misread
from ppmcal.diagnosis.next_experiment import Proposal, nothing, propose
from ppmcal.diagnosis.onsets import refined, with_onsets
from ppmcal.diagnosis.other_days import other_days, worse_days
from ppmcal.diagnosis.other_models import beyond_physics, fitted
from ppmcal.diagnosis.question import ROW_FAMILY
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.refit import MOST_STEPS, with_mechanism
from ppmcal.diagnosis.result import (
    LEARNED_AFTER,
    NAMED,
    Candidate,
    Diagnosis,
    Found,
    LearnedTerms,
    NamedEffect,
    UnknownFound,
)
from ppmcal.diagnosis.search_rounds import DiagnosisOptions, held_out_gap, training_part
from ppmcal.diagnosis.session_effects import with_sessions
from ppmcal.diagnosis.stage import Stage, bare_stage, without
from ppmcal.diagnosis.unknown_causes import UNKNOWN_FAMILY, UnknownCause
from ppmcal.diagnosis.verdict import advice, findings, refuse_unconverged, refuse_unredundant
from ppmcal.errors import PpmcalError
from ppmcal.inference.block_sets import Numbers
from ppmcal.inference.sets import Member
from ppmcal.model.dataset import Dataset
from ppmcal.wording.progress import begin

WEAK = 0.05
"""Causes of this probability are suspected."""
LONG_ODDS = 1000.0
"""Odds beyond which a set of effects is not worth a fit."""
MOST_READINGS = 8
NOT_PREDICTED = ("{} would explain these rows, but poses held out are surely predicted worse with "
                 "it than by geometry alone: it has no name here; measure more poses, or record "
                 "more of what might matter (load, temperature, time)")


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
    given_up: tuple[str, ...] = ()

    @property
    def last(self) -> Round:
        """The last question and its answer."""
        return self.rounds[-1]

    @property
    def added(self) -> tuple[Added, ...]:
        """All effects that were added."""
        return tuple(a for _, own in self.effects for a in own)

    @property
    def wanders(self) -> bool:
        """Whether something wanders in time, in no way that has a name."""
        return any(isinstance(s := self.last.asked.sources[p.leader], UnknownCause) and s.way
                   for p in self.last.unnamed)

    def label(self, member: Member, place: CausePlace) -> str:
        """Return what a member of a place is called, empty for nothing."""
        own = member.chosen - (frozenset(self.last.answer.best.chosen) - {place.block})
        return " and ".join(sorted({_called(self.last.asked.sources[i]) for i in own}))

    def hypotheses(self, member: Member) -> list[Hypothesis]:
        """Return all that have a name in the likeliest set of a member."""
        sources = (self.last.asked.sources[i] for i in member.chosen)
        return [s for s in sources if isinstance(s, Hypothesis) and not s.anonymous]


def _called(source: Hypothesis | UnknownCause | int) -> str:
    if isinstance(source, int):
        return f"row {source}"
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
    sized = [s for s in every if id(s[0]) in mine]
    machine, added = extended(whole.problem.mechanism, sized)
    if [what_is_fitted([a.hypothesis]) for a in added] == [
            what_is_fitted([a.hypothesis]) for a in last.added]:
        fit, added = last.fit, tuple(replace(now, hypothesis=a.hypothesis)
                                     for now, a in zip(last.added, added, strict=True))
    else:
        try:
            fit = with_mechanism(whole, machine, options)
        except PpmcalError as error:
            what = ", ".join(h.label for h, _, _ in sized)
            return Told(whole, rounds, whole, (), "unnamed",
                        (*ended, UNFITTED.format(what, error.what)))
    effects = tuple((p, tuple(a for a in added if a.hypothesis is p.hypothesis)) for p in named)
    return Told(whole, rounds, fit, effects, last.verdict, ended)


def diagnosed(problem: Problem, options: DiagnosisOptions) -> Diagnosis:
    """Find what is missing in the machine's model, and how probable that is.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.fit.identify`.
    """
    begin("fitting geometry")
    whole = identify(with_whole_rows(problem), options.fit)
    refuse_unconverged(whole)
    refuse_after_fit(whole)
    begin("asking which causes are in the data")
    what = told(whole, options.fit, options.kinds)
    refuse_misread(what.last)
    beside = list[str]()
    found, held = _with_held_out(what, options, beside)
    refuse_unredundant(found)
    gap = secondary("the gap on held-out poses", partial(held_out_gap, found, held, options), None,
                    beside)
    verdict, taken_back = what.verdict, list[str]()
    if verdict in NAMED and gap is not None and gap.worse:
        verdict = "unnamed"    # what does surely not predict is no name
        taken_back.append(NOT_PREDICTED.format(", ".join(dict.fromkeys(
            p.label for p, _ in what.effects))))
    named = verdict in NAMED
    if not named:
        found = replace(found, after=found.before, last=found.first, added=())
    final = what.fit if named else whole
    effects: tuple[NamedEffect, ...] = ()
    if named:
        final, onsets = secondary("the rows of events", partial(refined, final, options.fit),
                                  (final, {}), beside)
        effects = with_onsets(_effects(what, found.last), onsets)
    start = _left(found.first, what.rounds[0])
    left = _left(found.last, what.last) if named else start
    blocks = secondary("the gap on stretches of rows", partial(
        block_gaps, whole, final, found.noise, options.seed), (), beside) if effects else ()
    if options.by_session:
        gap = next((b.gap for b in blocks if b.by == SESSION), None)
    out = secondary("what left-out rows have in common", partial(left_out, final),
                    LeftOut(0, 0, False, "", 0.0, 1.0), beside)
    said = [*taken_back, *what.given_up, *findings(whole, final, left, effects, gap, out, ())]
    if effects:
        effects, apart = secondary("the size of effects in each session",
                                   partial(with_sessions, final, effects), (effects, []), beside)
        said += apart
    days = secondary("the prediction of each session", partial(
        other_days, final, options.fit, options.seed), (), beside)
    said += worse_days(days)
    terms = None
    if verdict in LEARNED_AFTER and final.converged:
        begin("learning what is left")
        terms = secondary("what is left, learned", partial(
            learned_beyond, found, final, held, named, what.wanders, options.seed, options.fit),
            None, beside)
    reported = report(terms.fit if terms else final, options.fit, 0.0, options.seed,
                      chosen=options.held)
    if reported.fit.converged:
        refuse_other_machine(reported.fit)
    beside += [f for f in reported.findings if f.startswith(NOTE)]
    readings = secondary("the machine under each other reading", partial(
        _readings, what, terms, options, beside), (), beside) if named or verdict == "weak" else ()
    places = secondary("where residuals are", partial(
        localise, replace(found.first, chosen=()), found.last if named else replace(
            found.first, chosen=()), options.seed), (), beside)
    proposed = secondary("which measurements come next", partial(
        _next, what, found.last, verdict, options.seed),
        nothing("these measurements do not tell what to measure next",
                len(whole.problem.mechanism.actuators)), beside)
    listed = _candidates(what, found, named)
    return Diagnosis(
        verdict, effects, _possible(listed, verdict), left, start, gap, places, listed,
        found.last.library.untestable,
        tables.swallowed(whole, final), reported.fit if final is whole and not terms else whole,
        reported, found, proposed, (*said, *beside), blocks, readings, terms, days,
        what.last.answer.nothing((ROW_FAMILY,)), tuple(
            _unknown(what, p) for p in what.last.unnamed))


def _unknown(what: Told, place: CausePlace) -> UnknownFound:
    """Return what a place without a name looks like, and what may be there instead."""
    mine = [m for m in place.members if m.family == UNKNOWN_FAMILY]
    others = [m for m in place.members if m not in mine]
    return UnknownFound(place.label, sum(m.probability for m in mine),
                        tuple(what.label(m, place) for m in others),
                        tuple(m.probability for m in others))


def _candidates(what: Told, found: Found, named: bool) -> tuple[Candidate, ...]:
    """Return every hypothesis, a grid as one, with the probability that it is there."""
    last = what.last
    names = {id(p.hypothesis) for p, _ in what.effects} if named else set()
    families = {h.family for p, _ in what.effects for m in p.members for h in what.hypotheses(m)}
    groups: dict[tuple[object, ...], list[tuple[float, Hypothesis]]] = {}
    for source, p in zip(last.asked.sources, last.answer.probability, strict=True):
        if isinstance(source, Hypothesis) and not (source.anonymous or source.misread):
            key = (source.family, source.on, source.shared, source.sessions)
            groups.setdefault(key, []).append((float(p), source))
    out = []
    for some in groups.values():
        there = [h for _, h in some if id(h) in names]
        best = there[0] if there else max(some, key=lambda o: o[0])[1]
        place = next((p for p, _ in what.effects if p.hypothesis is best), None)
        status = ("named" if there else "alternative" if named and best.family in families
                  else "not needed")
        out.append(Candidate(
            best, np.nan, np.nan, _survival(found.last, best), status,
            () if place is None else tuple(what.label(m, place) for m in place.members[1:]), 0.0,
            min(sum(p for p, _ in some), 1.0)))
    return tuple(sorted(out, key=lambda c: (c.status != "named", -c.probability)))


def _possible(listed: Sequence[Candidate], verdict: str) -> tuple[Candidate, ...]:
    """Return what may be there but is too weak to be named."""
    if verdict != "weak":
        return ()
    return tuple(replace(c, status="weak") for c in listed if c.probability >= WEAK)[:3]


def _with_held_out(what: Told, options: DiagnosisOptions, beside: list[str]
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
    first = _stage(what.rounds[0], what.last.rows, ())
    if not what.added:
        return Found(training, training, first, first, ())
    last = what.last
    after = what.fit if training is what.whole else with_mechanism(
        training, what.fit.problem.mechanism.with_values(what.fit.state.g), options.fit)
    return Found(training, after, first,
                 _stage(last, last.rows, [p.hypothesis for p, _ in what.effects]), what.added)


def _stage(asked: Round, rows: Container[tuple[int, int]], chosen: Sequence[Hypothesis | None]
           ) -> Stage:
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
    there = [_nearest(h, found.hypotheses) for h in chosen if h is not None]
    return bare_stage(system, found, [i for i in there if i is not None], asked.columns)


def _survival(stage: Stage, h: Hypothesis) -> float:
    """Return the part of a hypothesis that the geometry of a stage leaves, nan of what it lacks."""
    own = stage.library.hypotheses
    at = _nearest(h, own)
    return np.nan if at is None else stage.search.test.survival(own[at].columns)


def _nearest(h: Hypothesis, some: Sequence[Hypothesis]) -> int | None:
    """Return the number of the same hypothesis over other rows, of which grids are others.

    None where these rows do not tell it.
    """
    same = [i for i, f in enumerate(some)
            if f.names == h.names and f.shared == h.shared and f.label == h.label]
    return min(same, key=lambda i: h.apart(some[i]), default=None)


def _left(stage: Stage, asked: Round) -> Remainder:
    """Return what a stage leaves, and the probability that none of it has an unknown cause."""
    unknown = asked.unnamed
    chance = float(np.prod([1.0 - sum(m.probability for m in p.members
                                      if UNKNOWN_FAMILY in m.family) for p in unknown]))
    return Remainder(*against_noise(stage), unknown[0].label if unknown else "", chance, {})


def _effects(what: Told, stage: Stage) -> tuple[NamedEffect, ...]:
    out = []
    for place, added in what.effects:
        first, *others = place.members
        assert place.hypothesis is not None
        survival = _survival(stage, place.hypothesis)
        out += [NamedEffect(
            place.hypothesis.kind, a.on, a.parameters, np.nan, np.nan, survival,
            tuple(what.label(m, place) for m in others),
            tuple(first.probability / m.probability for m in others), place.hypothesis,
            probability=first.probability,
            probabilities=tuple(m.probability for m in others)) for a in added]
    return tuple(out)


def _readings(what: Told, terms: LearnedTerms | None, options: DiagnosisOptions,
              notes: list[str]) -> tuple[Reading, ...]:
    """Return the machine under each other set of causes at odds that count, and without any.

    ``notes``: to which those are added that have no machine; commands do not count with them.
    """
    whole, out = with_learned(what.whole, terms, options.fit), []
    with bounded(MOST_STEPS):
        for place, member, odds in _others(what)[:MOST_READINGS]:
            wanted = {id(h) for h in what.hypotheses(member)}
            label = what.label(member, place)
            try:
                sized = [s for s in what.last.sized(member.chosen) if id(s[0]) in wanted]
                machine, _ = extended(whole.problem.mechanism, sized)
                fit = with_mechanism(whole, machine, options.fit) if sized else whole
            except PpmcalError as error:
                notes.append(f"{NOTE}the machine with {label} ({error.what})")
                continue
            if (sized and not fit.converged) or beyond_physics(fit):
                notes.append(f"{NOTE}the machine with {label} (" + (
                    "sizes that no machine has)" if fit.converged else "its fit has no end)"))
                continue
            named = place.hypothesis.label if place.hypothesis is not None else ""
            kept = [h.label for h in what.hypotheses(member)]
            out.append(Reading(label, named, odds, fitted(fit),
                               (*kept, *([label] if UNKNOWN_FAMILY in member.family else []))))
    return (*out, Reading("", "", 1.0, fitted(whole)))


def _others(what: Told) -> list[tuple[CausePlace, Member, float]]:
    """Return what may be in the place of what is named, likeliest first, and the odds against.

    A set that has one cause in the place of several is told once.
    """
    out = [(place, m, place.members[0].probability / m.probability)
           for place, _ in what.effects for m in place.members[1:]]
    once = dict[Numbers, tuple[CausePlace, Member, float]]()
    for other in sorted(out, key=lambda o: o[2]):
        if other[2] <= LONG_ODDS:
            once.setdefault(other[1].chosen, other)
    return list(once.values())


def _next(what: Told, stage: Stage, verdict: str, seed: int) -> Proposal:
    """Return measurements that tell the likeliest two apart, or what else to do."""
    every = stage.library.hypotheses
    for place, member, odds in _others(what) if verdict in NAMED else ():
        other = [h for h in what.hypotheses(member) if not any(
            h is p.hypothesis for p, _ in what.effects)]
        if place.hypothesis and not place.hypothesis.slot and len(other) == 1:
            one, two = _nearest(place.hypothesis, every), _nearest(other[0], every)
            if one is not None and two is not None:
                return propose(stage, every[one], every[two], odds, seed)
    return advice(verdict, len(what.whole.problem.mechanism.actuators))
