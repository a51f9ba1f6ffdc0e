"""When a diagnosis is refused, findings for the user, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.calibration.fit import OVERSTATED, Fit
from ppmcal.calibration.validation import LeftOut, rows_left_out, unused
from ppmcal.diagnosis.held_out_gap import Gap
from ppmcal.diagnosis.lack_of_fit import LackOfFit
from ppmcal.diagnosis.linearisation import WEAK_VISIBILITY, Linearisation
from ppmcal.diagnosis.naming import Told, nearest
from ppmcal.diagnosis.next_experiment import Proposal, nothing, propose, record_more
from ppmcal.diagnosis.other_models import others
from ppmcal.diagnosis.result import NAMED, Candidate, Found, NamedEffect, Swallowed
from ppmcal.diagnosis.unknown_causes import UnknownCause
from ppmcal.errors import NoResult
from ppmcal.inference.priors import SURE_SIGMAS
from ppmcal.model.dataset import Dataset
from ppmcal.notes import NOTE, Note
from ppmcal.wording import pluralize


def refuse_unconverged(fit: Fit) -> None:
    """Refuse a diagnosis based on a fit that did not reach its minimum.

    Raises:
        NoResult: with the state of the fit.
    """
    if fit.converged:
        return
    raise NoResult(
        f"the fit of the geometry did not converge: {fit.reached}, so effects cannot be separated "
        "from geometry", ", ".join(d.source for d in fit.problem.datasets),
        "These poses hardly separate the parameters: measure poses that differ in every "
        "coordinate, or free fewer parameters (--free)")


def refuse_unredundant(found: Found) -> None:
    """Refuse a diagnosis of values that geometry alone always reproduces.

    Raises:
        NoResult: no degree of freedom is left to show a missing effect.
    """
    if found.first.freedom > 0:
        return
    data = found.before.problem.datasets
    raise NoResult(
        f"geometry alone fits any {pluralize(found.first.system.count, 'value')} of this kind "
        "exactly: no degree of freedom is left to show a missing effect",
        ", ".join(d.source for d in data), "Measure more poses, or free fewer parameters (--free)")


def findings(before: Fit, after: Fit, left: LackOfFit, effects: Sequence[NamedEffect],
             gap: Gap | None, out: LeftOut) -> list[Note]:
    """Return the findings and notes for the user."""
    said = [f for d in after.problem.datasets for f in d.findings]
    for data, reasons, old in zip(after.problem.datasets, after.reasons, before.reasons,
                                  strict=True):
        if reasons:
            said.append(rows_left_out(data, reasons))
        back = sorted(set(old) - set(reasons))
        if back:
            said.append(Note(f"{data.name}: {pluralize(len(back), 'row')} left out by the fit of "
                             f"geometry alone {'are' if len(back) > 1 else 'is'} explained by the "
                             "effects, and in use", NOTE, topic="row weights"))
    if out.sentence:
        said.append(Note(out.sentence, topic="row weights"))
    if left.excess >= SURE_SIGMAS:
        said.append(Note(f"residuals are {left.ratio:.2f} times the {left.source} noise: an "
                         "unrecorded influence, or sigma is too small", topic="noise"))
    if left.ratio < OVERSTATED:
        said.append(Note(f"residuals are only {left.ratio:.3g} times the {left.source} noise: "
                         "sigma is too large, perhaps in a wrong unit; correct it, because it "
                         "decides how strongly the data constrain the geometry", topic="noise"))
    weak = [e.hypothesis.called for e in effects if e.visibility < WEAK_VISIBILITY]
    if weak:
        said.append(Note(f"{', '.join(dict.fromkeys(weak))}: geometry absorbs most of it (weakly "
                         "testable), so its size is uncertain", topic="visibility"))
    said += _sides(after, effects)
    if effects and gap is not None and not gap.confirmed:
        said.append(Note("the held-out poses do not confirm the improvement: too few poses, or too "
                         "small an effect", topic="held out"))
    if not after.converged:
        said.append(Note("the fit had not converged after "
                         f"{pluralize(after.iterations, 'iteration')}", topic="convergence"))
    return said


def hardly_visible(candidates: Sequence[Candidate]) -> list[Note]:
    """Return the kinds that no data at these poses would show: geometry absorbs most of each."""
    seen: dict[str, float] = {}
    for c in candidates:
        kind = c.hypothesis.effect
        if kind is not None and np.isfinite(c.visibility):
            seen[kind.label] = max(seen.get(kind.label, 0.0), c.visibility)
    hidden = [kind for kind, most in seen.items() if most < WEAK_VISIBILITY]
    return [Note(f"Geometry absorbs most of {', '.join(hidden)} in these poses: such errors would "
                 "hardly show, and may appear as errors of points and lengths instead", NOTE,
                 topic="visibility")] if hidden else []


def _sides(fit: Fit, effects: Sequence[NamedEffect]) -> list[Note]:
    """Return notes on effects in which some joints lag their readings and others lead them.

    The side depends on convention as much as on the encoder's position, so files are accepted.
    """
    if not effects:
        return []
    mechanism = fit.problem.mechanism.with_values(fit.state.g)
    joints: dict[str, dict[str, list[str]]] = {}
    for effect in effects:
        if side := effect.side(mechanism):
            joints.setdefault(effect.hypothesis.called, {}).setdefault(side, []).extend(
                effect.on or mechanism.actuators)
    return [Note(f"{kind} has one sign on {', '.join(ways['lags'])} and the other on "
                 f"{', '.join(ways['leads'])}: their encoders are on different sides of it, or the "
                 "directions of some are recorded with the opposite sign", topic="approach")
            for kind, ways in joints.items() if len(ways) > 1]


def absorbed_by_geometry(before: Fit, after: Fit) -> tuple[Swallowed, ...]:
    """Return the parameters that were shifted by more than their tolerance to mimic effects."""
    out = []
    nominals = after.problem.mechanism.nominals
    for p in before.problem.free:
        parameter = before.problem.mechanism.parameters[p]
        tau = parameter.tolerance
        moved = float(before.state.g[p] - after.state.g[p])
        if before is not after and tau and np.isfinite(tau) and abs(moved) > tau:
            out.append(Swallowed(parameter.name, float(before.state.g[p] - nominals[p]),
                                 float(after.state.g[p] - nominals[p]), tau, parameter.quantity))
    return tuple(sorted(out, key=lambda s: -abs(s.before - s.after) / s.tolerance))


def advice(verdict: str, joints: int, datasets: Sequence[Dataset], gap: Gap | None = None
           ) -> Proposal:
    """Return the advice if no rivals have to be separated; ``gap``: on held-out poses."""
    if verdict == "named" and gap is not None and not gap.confirmed:
        return nothing("repeat the campaign, or measure more poses: held-out poses do not confirm "
                       "the named effects yet", joints)
    return nothing({"none": "nothing more to measure: no missing effect is detectable",
                    "weak": "repeat the campaign: more rows confirm the suspicion or remove it",
                    "named": "nothing more to measure: the named effects explain the residuals",
                    }.get(verdict) or record_more(datasets), joints)


def next_step(what: Told, stage: Linearisation, verdict: str, gap: Gap | None,
              seed: int) -> Proposal:
    """Return measurements that separate the two most probable causes, or other advice."""
    every = stage.library.hypotheses
    for place, member, odds in others(what) if verdict in NAMED else ():
        other = [h for h in what.hypotheses(member) if not any(
            h is p.hypothesis for p, _ in what.effects)]
        if place.hypothesis and not place.hypothesis.slot and len(other) == 1:
            one, two = nearest(place.hypothesis, every), nearest(other[0], every)
            if one is not None and two is not None:
                return propose(stage, every[one], every[two], odds, seed)
    joints = len(what.whole.problem.mechanism.actuators)
    for p in what.last.unnamed:
        source = what.last.asked.sources[p.leader]
        if isinstance(source, UnknownCause) and source.remedy:
            return nothing(source.remedy, joints)
    if none := unused(what.whole):
        datasets = what.whole.problem.datasets
        return nothing(f"find out why {' and '.join(datasets[i].name for i in none)} contradicts "
                       "the other files, and diagnose again", joints)
    return advice(verdict, joints, what.whole.problem.datasets, gap)
