"""The machine fitted under each alternative set of causes.

Two effects that look alike in the measurements can send a machine to different places: a scale
error belongs to the instrument, a gain of the drives to the machine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.compensation import CandidateModel
from ppmcal.calibration.fit import Fit, bounded, left_out_note
from ppmcal.calibration.knowledge import measuring_frames
from ppmcal.diagnosis.explanation import (
    CausePlace,
)
from ppmcal.diagnosis.extended_model import extended
from ppmcal.diagnosis.learned_terms import with_learned
from ppmcal.diagnosis.naming import Told
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.refit import MOST_STEPS, outside, with_mechanism
from ppmcal.diagnosis.result import (
    LearnedTerms,
)
from ppmcal.diagnosis.unknown_causes import UNKNOWN_FAMILY
from ppmcal.errors import PpmcalError
from ppmcal.inference.block_sets import Numbers
from ppmcal.inference.priors import COUNTS
from ppmcal.inference.sets import Member
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

MOST_READINGS = 8


def readings(what: Told, terms: LearnedTerms | None, options: DiagnosisOptions,
              notes: list[Note]) -> tuple[CandidateModel, ...]:
    """Return the machine under each other set of causes with significant odds, and without any.

    ``notes``: sets without a usable fit are added; commands do not consider them.
    """
    whole, out = with_learned(what.whole, terms, options.fit), []
    with bounded(MOST_STEPS):
        for place, member, odds in others(what)[:MOST_READINGS]:
            wanted = {id(h) for h in what.hypotheses(member)}
            label = what.label(member)
            try:
                sized = [s for s in what.last.sized(member.chosen) if id(s.hypothesis) in wanted]
                machine, _ = extended(whole.problem.mechanism, sized)
                fit = with_mechanism(whole, machine, options.fit) if sized else whole
            except PpmcalError as error:
                notes.append(left_out_note(f"the machine with {label} ({error.what})"))
                continue
            if (sized and not fit.converged) or outside(fit.problem, fit.state):
                notes.append(left_out_note(f"the machine with {label} (" + (
                    "sizes are implausible)" if fit.converged else "its fit did not converge)")))
                continue
            named = place.hypothesis.label if place.hypothesis is not None else ""
            kept = [h.label for h in what.hypotheses(member)]
            out.append(CandidateModel(label, named, odds, fitted(fit),
                                      (*kept,
                                       *([label] if UNKNOWN_FAMILY in member.family else []))))
    return (*out, CandidateModel("", "", 1.0, fitted(whole)))


def others(what: Told) -> list[tuple[CausePlace, Member, float]]:
    """Return alternatives to the named causes, most probable first, and the odds against them.

    A set with one cause in place of several is reported once.
    """
    out = [(place, m, place.members[0].probability / m.probability)
           for place, _ in what.effects for m in place.members[1:]]
    once = dict[Numbers, tuple[CausePlace, Member, float]]()
    for other in sorted(out, key=lambda o: o[2]):
        if other[2] * COUNTS.value <= 1.0:
            once.setdefault(other[1].chosen, other)
    return list(once.values())


def fitted(fit: Fit) -> Mechanism:
    """Return the machine at the fitted values, with the registrations."""
    mechanism = fit.problem.mechanism.with_values(fit.state.g)
    return replace(mechanism, home_q=np.full_like(mechanism.home_q, np.nan), registrations={
        **mechanism.registrations, **measuring_frames(fit.problem, fit.state)})
