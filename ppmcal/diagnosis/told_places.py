"""Reported results of the search: named effects, unknown causes, candidates, lack of fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.diagnosis.explanation import (
    CausePlace,
    Round,
)
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.lack_of_fit import LackOfFit, lack_of_fit, pure_error
from ppmcal.diagnosis.linearisation import Linearisation
from ppmcal.diagnosis.naming import Told, nearest
from ppmcal.diagnosis.result import (
    Candidate,
    Found,
    NamedEffect,
    UnknownFound,
)
from ppmcal.diagnosis.unknown_causes import UNKNOWN_FAMILY
from ppmcal.inference.priors import SURE


def unknown(what: Told, place: CausePlace) -> UnknownFound:
    """Return the description of an unnamed cause, and its alternatives.

    A cause that did not settle is described by the likeliest.
    """
    mine = [m for m in place.members if m.family == UNKNOWN_FAMILY] if place.settled else list(
        place.members[:1])
    others = [m for m in place.members if m not in mine]
    return UnknownFound(place.label, sum(m.probability for m in mine),
                        tuple(what.label(m) for m in others),
                        tuple(m.probability for m in others))


def candidates(what: Told, found: Found, named: bool) -> tuple[Candidate, ...]:
    """Return every hypothesis, a grid as one, with the probability that it is present."""
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
            best, min(sum(p for p, _ in some), 1.0), _visibility(found.last, best), status,
            () if place is None else tuple(what.label(m) for m in place.members[1:])))
    return tuple(sorted(out, key=lambda c: (c.status != "named", -c.probability)))


def suspected(listed: Sequence[Candidate], verdict: str) -> tuple[Candidate, ...]:
    """Return the candidates that may be present but are too weak to be named."""
    if verdict != "weak":
        return ()
    return tuple(replace(c, status="weak") for c in listed if c.probability >= 1.0 - SURE.value)[:3]


def _visibility(stage: Linearisation, h: Hypothesis) -> float:
    """Return the part of a hypothesis that the geometry leaves, nan if not in the library."""
    own = stage.library.hypotheses
    at = nearest(h, own)
    return np.nan if at is None else stage.visibility(own[at].columns)


def left(stage: Linearisation, asked: Round) -> LackOfFit:
    """Return the lack of fit, with the probability that it has no unknown cause."""
    places = asked.unnamed
    chance = float(np.prod([1.0 - sum(m.probability for m in p.members
                                      if UNKNOWN_FAMILY in m.family) for p in places]))
    return lack_of_fit(stage, pure_error(stage.system), places[0].label if places else "", chance)


def effects(what: Told, stage: Linearisation) -> tuple[NamedEffect, ...]:
    """Return the named effects, one entry for each effect added."""
    out = []
    for place, added in what.effects:
        first, *others = place.members
        assert place.hypothesis is not None
        visibility = _visibility(stage, place.hypothesis)
        out += [NamedEffect(
            place.hypothesis.kind, a.on, a.parameters, visibility, first.probability,
            tuple(what.label(m) for m in others),
            tuple(m.probability for m in others), place.hypothesis) for a in added]
    return tuple(out)
