"""What is in a fit's residuals: asked, fitted, asked again at the new fit, until the sets agree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.fit import Fit, FitOptions
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.extended_model import Added, extended
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.question import ROW_FAMILY, Asked, question
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.stage import without
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.thinning import thinned
from ppmcal.diagnosis.unknown_causes import UNKNOWN_FAMILY, UnknownCauses
from ppmcal.errors import BadInput, NoResult
from ppmcal.inference.sets import SetPosterior, posterior
from ppmcal.linalg import Array

ROUNDS = 4
MASS = 0.95
"""Of the probability, what the families that are told in one place have together."""


@dataclass(frozen=True, eq=False)
class Place:
    """One cause that is there, and what it may be.

    ``families``: probability of each that is needed for 95 %, likeliest first; "" stands for
    nothing. ``hypothesis``: the likeliest one with a name, None if that is unknown.
    """

    families: dict[str, float]
    label: str
    hypothesis: Hypothesis | None

    @property
    def named(self) -> bool:
        """Whether a name stands: nothing is not among what is likely, unknown does not lead."""
        return "" not in self.families and next(iter(self.families)) != UNKNOWN_FAMILY


@dataclass(frozen=True, eq=False)
class Explanation:
    """What is in the data: the last question, its answer, and the fit with it."""

    asked: Asked
    found: SetPosterior
    fit: Fit
    added: tuple[Added, ...]
    places: tuple[Place, ...]
    rows: tuple[int, ...]

    @property
    def verdict(self) -> str:
        """none, weak, named, named-set, partial or unnamed."""
        nothing = self.found.nothing((ROW_FAMILY,))
        if not self.places:
            return "none" if nothing > 0.5 else "weak"
        sure = [p for p in self.places if "" not in p.families]
        if not sure:
            return "none" if nothing > 0.5 else "weak"
        named = [p for p in sure if p.named]
        if not named:
            return "unnamed"
        if len(named) < len(sure):
            return "partial"
        return "named-set" if any(len(p.families) > 1 for p in named) else "named"


def explained(fit: Fit, options: FitOptions, kinds: Sequence[str] | None = None) -> Explanation:
    """Return what is in the data that a fit of the geometry leaves."""
    keep = thinned(fit.problem, [k | o for k, o in zip(fit.keep, fit.outliers, strict=True)])
    everywhere = all_settings(fit)
    now, added, before = fit, (), None
    for _ in range(ROUNDS):
        mechanism = now.problem.mechanism
        names = {n for a in added for n in a.parameters}
        own = [c for c, p in enumerate(now.problem.free) if mechanism.parameters[p].name in names]
        system = without(build(now.problem, now.state, keep), own)
        found = library(system, kinds, [now.problem.free[c] for c in own])
        asked = question(system, found, UnknownCauses(system, everywhere), own)
        answer = posterior(asked.question)
        result = _told(asked, answer, now, added)
        chosen = {(p.label, p.hypothesis is None) for p in result.places}
        if chosen == before:
            break
        before = chosen
        sized = _sized(asked, answer)
        if not sized:
            if now is fit:
                break
            now, added = fit, ()
            continue
        try:
            machine, added = extended(fit.problem.mechanism, sized)
            now = with_mechanism(fit, machine, options)
        except (BadInput, NoResult):
            break
    return result


def _sized(asked: Asked, answer: SetPosterior) -> list[tuple[Hypothesis, Array, Array]]:
    """Return the hypotheses with a name, their coefficients and standard deviations."""
    best = answer.best
    _, _, joint = max(best.views, key=lambda v: v[1])
    out = [(source, value, sigma) for i, value, sigma in
           zip(best.chosen, joint.values, joint.sigmas, strict=True)
           if isinstance(source := asked.sources[i], Hypothesis) and not source.anonymous]
    size: dict[tuple[str, tuple[str, ...]], float] = defaultdict(float)
    for h, value, _ in out:
        size[h.kind, h.on] += float(np.mean(value))
    return [(h, value / size[h.leans], sigma / abs(size[h.leans])) if h.leans else (h, value, sigma)
            for h, value, sigma in out]


def _told(asked: Asked, answer: SetPosterior, fit: Fit, added: tuple[Added, ...]) -> Explanation:
    places, rows = [], []
    blocks = asked.question.blocks
    for n, i in enumerate(answer.best.chosen):
        if blocks[i].family == ROW_FAMILY:
            rows.append(asked.sources[i])
            continue
        families, total = {}, 0.0
        for family, p in answer.families(n).items():
            families[family] = p
            total += p
            if total >= MASS:
                break
        source = asked.sources[i]
        h = source if isinstance(source, Hypothesis) and not source.anonymous else None
        places.append(Place(families, blocks[i].name, h))
    return Explanation(asked, answer, fit, added, tuple(places), tuple(rows))
