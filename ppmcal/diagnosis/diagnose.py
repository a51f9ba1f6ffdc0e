"""Entry point: find what is missing in a machine's model, and how probable that is."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from ppmcal.calibration.fit import LEFT_OUT, Fit, Problem, bounded, identify, secondary
from ppmcal.calibration.interpretation import refuse_after_fit, refuse_other_machine
from ppmcal.calibration.knowledge import far_from_nominal
from ppmcal.calibration.validation import LeftOut, left_out, report
from ppmcal.diagnosis.findings import (
    absorbed_by_geometry,
    findings,
    hardly_visible,
    next_step,
    refuse_unconverged,
    refuse_unredundant,
)
from ppmcal.diagnosis.learned_terms import learned_beyond
from ppmcal.diagnosis.localization import localise
from ppmcal.diagnosis.misread_causes import refuse_misread
from ppmcal.diagnosis.naming import HeldOut, Told, held_out, told
from ppmcal.diagnosis.next_experiment import nothing
from ppmcal.diagnosis.onsets import refined, with_onsets
from ppmcal.diagnosis.options import DiagnosisOptions as DiagnosisOptions
from ppmcal.diagnosis.other_days import other_days, worse_days
from ppmcal.diagnosis.other_models import readings
from ppmcal.diagnosis.predictive_check import session_gap
from ppmcal.diagnosis.question import NO_CAUSES
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.refit import MOST_STEPS as REFIT_STEPS
from ppmcal.diagnosis.result import LEARNED_AFTER, SILENT, Diagnosis, LearnedTerms, Onset
from ppmcal.diagnosis.session_effects import with_sessions
from ppmcal.diagnosis.told_places import candidates, effects, left, suspected, unknown
from ppmcal.diagnosis.wrong_files import without, wrong_files
from ppmcal.notes import Note, about
from ppmcal.wording import pluralize
from ppmcal.wording.progress import start_stage

MOST_STEPS = 4000
"""Steps that all fits of one search may take together: several times what any search that
converges needs. Three freedoms and forty poses may need 500, an ill-conditioned hexapod 900."""
ENDED = Note(f"the search was stopped after {MOST_STEPS} steps, because its fits do not converge: "
             "effects named so far are reported as fitted at that point; rivals, learned terms and "
             "the next measurements may be missing; state what is known (stiffness, load) in the "
             "mechanism file, or try fewer kinds", topic="search")

CUT = ("{} with further effects did not converge within " + str(REFIT_STEPS)
       + " steps: effects that only a longer one would show may be missing")


def diagnose(problem: Problem, options: DiagnosisOptions | None = None) -> Diagnosis:
    """Find what is missing in the machine's model, add it, and say how probable that is.

    Args:
        problem: machine, data and free geometry.
        options: seed and the like.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.fit.identify`.
    """
    with bounded(MOST_STEPS) as work:
        found = _diagnosed(problem, options or DiagnosisOptions())
    said = [ENDED] if work.ended else [Note(
        CUT.format(pluralize(work.cut, "fit")), topic="search")] if work.cut else []
    return replace(found, findings=(*found.findings, *said))


def _diagnosed(problem: Problem, options: DiagnosisOptions) -> Diagnosis:
    """Fit, search for causes, judge on held-out poses, report: within the steps available."""
    notes = list[Note]()
    whole, what = _asked(with_whole_rows(problem), options)
    if gone := wrong_files(what.last):
        problem = without(problem, gone)
        whole, what = _asked(with_whole_rows(problem), options)
    refuse_misread(what.last)
    held = held_out(what, options, notes)
    found, named = held.found, held.named
    if not what.last.rows:  # rows left out as outliers show that geometry does not fit everything
        refuse_unredundant(found)
    final, events = _with_events(what.fit, options, notes) if named else (whole, {})
    own = with_onsets(effects(what, found.last), events) if named else ()
    start = left(found.first, what.rounds[0])
    rest = left(found.last, what.last) if named else start
    gap = session_gap(held.predictive) if options.by_session else held.gap
    out = secondary("what left-out rows have in common", partial(left_out, final),
                    LeftOut(0, 0, False, "", 0.0, 0.0), notes)
    if out.follows and held.verdict in SILENT:
        # something depends on position, though no cause fits it
        held = replace(held, verdict="unnamed")
    said = [*held.said, *what.given_up, *findings(whole, final, rest, own, gap, out)]
    own, apart = secondary("the size of effects in each session", partial(
        with_sessions, final, own), (own, []), notes) if own else (own, [])
    days = secondary("the prediction of each session", partial(
        other_days, final, options.fit, options.seed), (), notes)
    terms = _learned(what, held, final, options, notes)
    reported = report(terms.fit if terms else final, options.fit, 0.0, options.seed,
                      chosen=options.held)
    if reported.fit.converged:  # an abandoned fit says nothing about the machine
        refuse_other_machine(reported.fit)
    far = [] if named else far_from_nominal(reported.estimates, problem.mechanism.units)
    others = secondary("the machine under each other reading", partial(
        readings, what, terms, options, notes), (), notes) if (
            named or held.verdict == "weak") else ()
    bare = replace(found.first, chosen=())
    places = secondary("where residuals are", partial(
        localise, bare, found.last if named else bare, options.seed), (), notes)
    proposed = secondary("which measurements come next", partial(
        next_step, what, found.last, held.verdict, gap, options.seed), nothing(
            "these measurements do not show what to measure next",
            len(problem.mechanism.actuators)), notes)
    notes += about(reported.findings, (LEFT_OUT,))
    listed = candidates(what, found, named)
    return Diagnosis(
        held.verdict, own, suspected(listed, held.verdict), rest, start, gap, places, listed,
        found.last.library.untestable, absorbed_by_geometry(whole, final),
        before=reported.fit if final is whole and not terms else whole, identification=reported,
        found=found, proposal=proposed,
        findings=(*said, *apart, *worse_days(days), *far, *hardly_visible(listed), *notes),
        others=others, learned=terms, days=days,
        nothing=what.last.answer.nothing(NO_CAUSES),
        unknown=tuple(unknown(what, p) for p in what.last.unnamed), predictive=held.predictive)


def _asked(problem: Problem, options: DiagnosisOptions) -> tuple[Fit, Told]:
    """Return the fit of the geometry, and the causes found in its residuals."""
    start_stage("fitting geometry")
    whole = identify(problem, options.fit)
    refuse_unconverged(whole)
    refuse_after_fit(whole)
    start_stage("searching for causes in the data")
    return whole, told(whole, options.fit, options.kinds)


def _with_events(fit: Fit, options: DiagnosisOptions, notes: list[Note]
                 ) -> tuple[Fit, dict[str, Onset]]:
    """Return the fit with every event at its most probable row, and the rows."""
    return secondary("the rows of events", partial(refined, fit, options.fit), (fit, {}), notes)


def _learned(what: Told, held: HeldOut, final: Fit, options: DiagnosisOptions, notes: list[Note]
             ) -> LearnedTerms | None:
    """Return the terms learned from unexplained residuals, None if nothing is left to learn."""
    if held.verdict not in LEARNED_AFTER or not final.converged:
        return None
    start_stage("learning the remaining residuals")
    return secondary("the learned terms", partial(
        learned_beyond, what.last, held.found, held.named, final, held.poses, options), None, notes)
