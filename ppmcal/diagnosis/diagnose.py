"""The diagnosis from measurements to verdict, step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ppmcal.calibration.compensation import Reading
from ppmcal.calibration.fit import NOTE, Fit, Problem, bounded, identify, secondary
from ppmcal.calibration.fit import FitOptions as FitOptions
from ppmcal.calibration.interpretation import Misread, refuse_after_fit, refuse_other_machine
from ppmcal.calibration.knowledge import far_from_nominal
from ppmcal.calibration.validation import LeftOut, left_out, report
from ppmcal.diagnosis import result_tables as tables
from ppmcal.diagnosis.added_variable_test import probability
from ppmcal.diagnosis.adequacy import LEVEL, remainder
from ppmcal.diagnosis.candidates import look_alikes
from ppmcal.diagnosis.extended_model import Added
from ppmcal.diagnosis.first_rows import without_first_rows
from ppmcal.diagnosis.from_evidence import diagnosed
from ppmcal.diagnosis.held_out_blocks import SESSION, block_gaps
from ppmcal.diagnosis.hypotheses import Hypothesis, Untestable
from ppmcal.diagnosis.imitation import imitated, left_over
from ppmcal.diagnosis.inverted_directions import inverted_directions
from ppmcal.diagnosis.learned_terms import learned_beyond, with_learned
from ppmcal.diagnosis.localization import Place, localise
from ppmcal.diagnosis.next_experiment import nothing
from ppmcal.diagnosis.onsets import refined, with_onsets
from ppmcal.diagnosis.other_days import other_days, worse_days
from ppmcal.diagnosis.other_models import other_models
from ppmcal.diagnosis.plausibility import implausible, implausible_words, misread_column
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.refit import MOST_STEPS as REFIT_STEPS
from ppmcal.diagnosis.refit import nothing_named
from ppmcal.diagnosis.result import (
    LEARNED_AFTER,
    NAMED,
    Diagnosis,
    Found,
    LearnedTerms,
    NamedEffect,
    Onset,
    Survival,
)
from ppmcal.diagnosis.rivals import rivals
from ppmcal.diagnosis.search_rounds import DiagnosisOptions as DiagnosisOptions
from ppmcal.diagnosis.search_rounds import confirm, found_in, held_out_gap, training_part
from ppmcal.diagnosis.selection import own_log_p
from ppmcal.diagnosis.session_effects import with_sessions
from ppmcal.diagnosis.stage import Stage, named_only
from ppmcal.diagnosis.survivors import earned
from ppmcal.diagnosis.verdict import (
    Alternatives,
    decide,
    findings,
    next_step,
    not_predicted,
    refuse_unconverged,
    refuse_unredundant,
)
from ppmcal.wording import counted
from ppmcal.wording.progress import begin

MOST_STEPS = 4000
"""Steps that the fits of one search may try together: some times what any needs that ends by
itself. Three freedoms and forty poses may need 500, a hexapod that wanders 900."""
ENDED = (f"the search was ended after {MOST_STEPS} steps of its fits, which wander: what was named "
         "by then is told as far as its fit had got, and rivals, learned terms and what to measure "
         "next may be missing; state what is known (stiffness, load) in the mechanism file, or "
         "try fewer kinds")

CUT = ("{} with further effects wandered and went no farther than " + str(REFIT_STEPS)
       + " steps: effects that only a longer one would show may be missing")


def diagnose(problem: Problem, options: DiagnosisOptions | None = None
             ) -> Diagnosis:
    """Find what is missing in the machine's model, add it, and say how sure that is.

    Args:
        problem: machine, data and free geometry.
        options: seed and the like.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.fit.identify`.
    """
    with bounded(MOST_STEPS) as work:
        options = options or DiagnosisOptions()
        found = (diagnosed if options.evidence else _diagnosed)(problem, options)
    said = [ENDED] if work.ended else [CUT.format(counted(work.cut, "fit"))] if work.cut else []
    return replace(found, findings=(*found.findings, *said))


def _diagnosed(problem: Problem, options: DiagnosisOptions) -> Diagnosis:
    """Find what is missing, with as many steps of fits as there are."""
    begin("fitting geometry")
    whole = identify(with_whole_rows(problem), options.fit)
    refuse_unconverged(whole)
    refuse_after_fit(whole)
    training, held = training_part(whole, options)
    found = found_in(training, options)
    settled = without_first_rows(whole.problem, found.after)
    if settled is not whole.problem:
        begin("again without the first rows, before which nobody knows what was")
        whole = identify(settled, options.fit)
        training, held = training_part(whole, options)
        found = found_in(training, options)
    refuse_unredundant(found)
    wanders = found.last.wanders
    begin("confirming in all rows")
    found, final = confirm(found, whole, options)
    onsets: dict[str, Onset] = {}
    if final is not None:
        final, onsets = refined(final, options.fit)
    gap = held_out_gap(found, held, options)
    chosen = [found.last.hypotheses[i] for i in found.last.chosen]
    column = misread_column(found, chosen) or inverted_directions(found, chosen)
    if column is not None:
        raise Misread.of([column], whole.problem.mechanism.units)
    odd = implausible(found.first.search, chosen)
    if odd is not None or (gap is not None and gap.worse):
        found, final = nothing_named(found), None
        gap = held_out_gap(found, held, options)
    begin("judging what is left")
    left = left_over(found.last, options.seed)
    same = found.last.search is found.first.search and not found.last.chosen
    start = left if same or found.last is found.first else remainder(
        replace(found.first, chosen=()), options.seed)
    out = _rows_left_out(found, final or whole)
    lasting = earned(found, whole, final, left, out.suspicious, options.seed, options.fit)
    if lasting.lost:
        found, final, left = lasting.found, lasting.final, lasting.left
        gap, out = held_out_gap(found, held, options), _rows_left_out(found, final or whole)
    others = _alternatives(found.last)
    effects = with_onsets(_effects(found, others, lasting.each), onsets)
    # where what is left follows an input, that says more than a stretch of it
    if out.follows and not (out.of_travel and left.p_value < LEVEL):
        left = replace(left, follows=f"rows that {out.follows}", p_value=min(
            out.p_value, left.p_value))
    beside = list[str]()
    blocks = secondary("the gap on stretches of rows", partial(
        block_gaps, whole, final, found.noise, options.seed), (), beside) if (
            final and effects) else ()
    if options.by_session:
        gap = next((b.gap for b in blocks if b.by == SESSION), None)
    verdict = decide(found, left, start, effects, out, blocks,
                     lasting.nothing or imitated(found.last))
    told = findings(whole, final or whole, left, effects, gap, out,
                    not_predicted(blocks, left, start))
    if final is not None:
        effects, apart = secondary("the size of effects in each session",
                                   partial(with_sessions, final, effects), (effects, []), beside)
        told += apart
    if odd is not None:
        told.append(implausible_words(found, odd))
    named = verdict in NAMED
    if final is None or not named:
        final = whole
    days = secondary("the prediction of each session", partial(
        other_days, final, options.fit, options.seed), (), beside)
    told += worse_days(days)
    terms = None
    if verdict in LEARNED_AFTER and final.converged:
        begin("learning what is left")
        terms = secondary("what is left, learned", partial(
            learned_beyond, found, final, held, named, wanders, options.seed, options.fit),
            None, beside)
    reported = report(terms.fit if terms else final, options.fit, 0.0, options.seed,
                      chosen=options.held)
    if reported.fit.converged:  # where a fit that was given up has got to says nothing of a machine
        refuse_other_machine(reported.fit)
    far = "" if named else far_from_nominal(
        reported.estimates, whole.problem.mechanism.units)
    if far:
        told.append(far)
        # a geometry that nobody has built absorbs whatever is wrong
        verdict = "unnamed" if verdict == "none" else verdict
    beside += [f for f in reported.findings if f.startswith(NOTE)]
    readings = secondary("the machine under each other reading", partial(
        _others, whole, found, others, terms, options), (), beside) if (
            named or verdict == "weak") else ()
    places = secondary("where residuals are", partial(_places, found, named, options.seed), (),
                       beside)
    joints = len(whole.problem.mechanism.actuators)
    proposed = secondary("which measurements come next", partial(
        next_step, found.last, others, verdict, options.seed, gap),
        nothing("these measurements do not tell what to measure next", joints), beside)
    return Diagnosis(
        verdict, _over_all(found, effects) if named else (),
        tables.possible(found, effects, verdict, lasting.lost), left, start, gap, places,
        tables.candidates(found, effects if named else (), lasting.lost),
        _untestable(found), tables.swallowed(whole, final),
        reported.fit if final is whole and not terms else whole, reported, found, proposed,
        (*told, *beside), blocks, readings, terms, days)


def _rows_left_out(found: Found, fit: Fit) -> LeftOut:
    """Return what the rows that a fit of all rows left out say."""
    out = left_out(fit)
    if not out.suspicious:
        # the tests were made in the training rows: what they went without counts as much
        trained = left_out(found.after)
        out = trained if trained.suspicious else out
    return out


def _others(whole: Fit, found: Found, alternatives: Alternatives, terms: LearnedTerms | None,
            options: DiagnosisOptions) -> tuple[Reading, ...]:
    """Return the machine with each rival that was recorded, and without effects.

    What was learned is part of each of them.
    """
    return other_models(with_learned(whole, terms, options.fit), found.last,
                        {i: r for i, (r, _) in alternatives.items()}, options.fit)


def _untestable(found: Found) -> tuple[Untestable, ...]:
    """Return what could be tested at no fit: some kinds show only once another is in the model."""
    last = found.last
    tested = {f.effect.label for f in last.hypotheses if f.effect} - {
        u.kind for u in last.library.untestable}
    lacking = [u for u in found.first.library.untestable if u.kind not in tested]
    return tuple(dict.fromkeys(lacking))    # forms of a kind may lack the same


def _places(found: Found, named: bool, seed: int) -> tuple[Place, ...]:
    """Return where the residuals are without effects and with those that are named."""
    bare = replace(found.first, chosen=())
    with_them = replace(found.last, chosen=named_only(found.last)) if named else bare
    return localise(bare, with_them, seed)


def _alternatives(stage: Stage) -> Alternatives:
    """Return what could replace each named hypothesis: rivals, and what was not recorded."""
    return {i: (rivals(stage.search, stage.chosen, i),
                look_alikes(stage.search, stage.library.unrecorded, stage.chosen, i))
            for i in named_only(stage)}


def _effects(found: Found, alternatives: Alternatives, survive: Mapping[int, Survival]
             ) -> tuple[NamedEffect, ...]:
    """Return what was named, with its rivals, and whether it would stand."""
    out = []
    stage, left = found.last, list(found.added)
    for i, (others, alike) in alternatives.items():
        hypothesis = stage.hypotheses[i]
        value = own_log_p(stage.search, stage.chosen, i)
        for added in _of(hypothesis, left):
            left.remove(added)
            out.append(NamedEffect(
                hypothesis.kind, added.on, added.parameters, probability(value), value,
                stage.search.test.survival(hypothesis.columns),
                (*(r.hypothesis.label for r in others), *(f.label for f in alike)),
                (*(r.odds for r in others), *(np.nan for _ in alike)), hypothesis,
                survives=survive.get(i)))
    return tuple(out)


def _over_all(found: Found, effects: Sequence[NamedEffect]) -> tuple[NamedEffect, ...]:
    """Return the effects with the chance over all that was tried, not that of each alone."""
    told = found.first.search.over_all
    return tuple(replace(e, p_value=probability(told(e.log_p)), log_p=told(e.log_p),
                         survives=e.survives and replace(
                             e.survives, log_p=told(e.survives.log_p))) for e in effects)


def _of(hypothesis: Hypothesis, added: Sequence[Added]) -> list[Added]:
    """Return the effects added for a hypothesis; of two waves those of the nearer period."""
    mine = [
        a
        for a in added
        if (a.hypothesis.family, a.hypothesis.on) == (hypothesis.family, hypothesis.on)
    ]
    apart = [hypothesis.apart(a.hypothesis) for a in mine]
    return [a for a, d in zip(mine, apart, strict=True) if d <= min(apart)]
