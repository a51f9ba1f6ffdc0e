"""The tables of a diagnosis: candidates and their fate, parameters that had imitated effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.diagnose.gram import probability
from ppmcal.diagnose.result import Candidate, Found, NamedEffect, Swallowed
from ppmcal.diagnose.search import columns_of, scan
from ppmcal.diagnose.stage import WEAK_SURVIVAL, Stage, named_only
from ppmcal.fit import Fit

POWER = 1.2816
"""Standard normal quantile of 90 %."""


def candidates(found: Found, effects: Sequence[NamedEffect]) -> tuple[Candidate, ...]:
    """Return every hypothesis, the best of each grid, with what became of it."""
    first = found.first
    chosen = found.last.named if effects else ()
    named = {(f.family, f.on, f.shared) for f in chosen}
    families = {f.family for f in chosen}
    rivals = {a.split(" on ")[0] for e in effects for a in e.alternatives}
    left = first.search.gram.given(columns_of(first.search, named_only(first)))
    after = scan(left, first.library.forms)
    best: dict[tuple[str, tuple[str, ...], bool], int] = {}
    for i, form in enumerate(first.library.forms):
        if form.anonymous:
            continue
        key = (form.family, form.on, form.shared)
        if key not in best or first.log_p[i] < first.log_p[best[key]]:
            best[key] = i
    out = []
    for key, i in best.items():
        form = first.library.forms[i]
        survival = first.search.gram.survival(form.columns)
        significant = first.log_p[i] < first.search.name
        status = "not needed"
        if key in named:
            status = "named"
        elif survival < 1e-3:
            status = "not testable"
        elif form.family in rivals:
            status = "alternative"
        elif significant:
            status = "explained" if after[i] > first.search.name or families else "significant"
        elif survival < WEAK_SURVIVAL:
            status = "weakly testable"
        also = tuple(a for e in effects if e.kind == form.kind for a in e.alternatives) if (
            status == "named") else ()
        out.append(Candidate(form, probability(first.log_p[i]), survival, status,
                             also, _detectable(first, i)))
    return tuple(sorted(out, key=lambda c: (c.status != "named", c.p_value)))


def _detectable(stage: Stage, index: int) -> float:
    """Return the smallest value of a single-column form that would be named 9 times in 10."""
    form = stage.library.forms[index]
    if form.size != 1:
        return 0.0
    c = form.columns[0]
    gram = stage.search.gram
    seen = gram.length[c] * np.sqrt(max(gram.gram[c, c], 0.0))
    if seen <= 0.0:
        return 0.0
    # two-sided normal quantile of the naming threshold
    need = np.sqrt(max(-2.0 * stage.search.name - np.log(-2.0 * stage.search.name) - 0.45, 1.0))
    sigma = np.sqrt(gram.square / max(gram.freedom, 1)) if not stage.chosen else 1.0
    return float((need + POWER) * sigma / seen)


def possible(found: Found, effects: Sequence[NamedEffect], verdict: str
             ) -> tuple[Candidate, ...]:
    """Return what is there but cannot be named: too weak, or no more than an imitation."""
    stage = found.first
    if verdict == "unnamed":
        return tuple(Candidate(f, e.p_value, e.survival, "imitation", e.alternatives, 0.0)
                     for e in effects for f in found.last.named if f.kind == e.kind)
    if verdict != "weak":
        return ()
    out = []
    for i in np.argsort(stage.log_p, kind="stable")[:3]:
        if stage.log_p[i] < stage.search.detect:
            form = stage.library.forms[i]
            out.append(Candidate(form, float(np.exp(stage.log_p[i])),
                                 stage.search.gram.survival(form.columns), "weak", (), 0.0))
    return tuple(out)


def swallowed(before: Fit, after: Fit) -> tuple[Swallowed, ...]:
    """Return the parameters that had moved by more than their tolerance to imitate effects."""
    out = []
    nominals = after.problem.mechanism.nominals
    for p in before.problem.free:
        parameter = before.problem.mechanism.parameters[p]
        tau = parameter.tolerance
        moved = float(before.state.g[p] - after.state.g[p])
        if before is not after and tau and np.isfinite(tau) and abs(moved) > tau:
            out.append(Swallowed(parameter.name, parameter.quantity,
                                 float(before.state.g[p] - nominals[p]),
                                 float(after.state.g[p] - nominals[p]), tau))
    return tuple(sorted(out, key=lambda s: -abs(s.before - s.after) / s.tolerance))
