"""The tables of a diagnosis: candidates and their fate, parameters that had imitated effects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.diagnosis.added_variable_test import log_p
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.result import Candidate, Found, NamedEffect, Swallowed
from ppmcal.diagnosis.search import columns_of, scan
from ppmcal.diagnosis.stage import WEAK_SURVIVAL, Stage, named_only

POWER = 1.2816
"""Standard normal quantile of 90 %."""


def candidates(found: Found, effects: Sequence[NamedEffect], lost: Sequence[Hypothesis] = ()
               ) -> tuple[Candidate, ...]:
    """Return every hypothesis, the best of each grid, with what became of it.

    Each effect that is named has a row of its own, be it on a few actuators or one of several
    values of one hypothesis. ``lost``: as for :func:`possible`.
    """
    first = found.first
    named = {k for e in effects for k in (_key(e.hypothesis), _key(replace(e.hypothesis, on=e.on)))}
    families = {e.hypothesis.family for e in effects}
    rivals = {a.split(" on ")[0] for e in effects for a in e.alternatives}
    left = first.search.test.given(columns_of(first.search, named_only(first)))
    after = scan(left, first.library.hypotheses)
    best: dict[Key, int] = {}
    for i, hypothesis in enumerate(first.library.hypotheses):
        if hypothesis.anonymous:
            continue
        key = _key(hypothesis)
        if key in named:
            continue
        if key not in best or first.log_p[i] < first.log_p[best[key]]:
            best[key] = i
    out = [_named(found, e) for e in effects]
    consistent = {_key(f) for f in lost}
    for key, i in best.items():
        hypothesis = first.library.hypotheses[i]
        survival = first.search.test.survival(hypothesis.columns)
        significant = first.log_p[i] < first.search.name
        status = "not needed"
        if survival < 1e-3:
            status = "not testable"
        elif key in consistent:
            status = "consistent"
        elif hypothesis.family in rivals:
            status = "alternative"
        elif significant:
            status = "explained" if after[i] > first.search.name or families else "significant"
        elif survival < WEAK_SURVIVAL:
            status = "weakly testable"
        log_p = float(first.log_p[i])
        out.append(Candidate(hypothesis, log_p, log_p, survival, status, (), _detectable(first, i)))
    return _over_all(first, sorted(out, key=lambda c: (c.status != "named", c.log_p)))


def _over_all(stage: Stage, found: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Return the same with the chance over all hypotheses that were tried."""
    told = stage.search.over_all
    return tuple(replace(c, log_p=told(c.log_p), log_p_alone=told(c.log_p_alone)) for c in found)


Key = tuple[str, frozenset[str], bool]
"""Kind or slot, actuators, and whether they share one value: a hypothesis but for its constants."""


def _key(hypothesis: Hypothesis) -> Key:
    return hypothesis.family, frozenset(hypothesis.on), hypothesis.shared or len(hypothesis.on) == 1


def _named(found: Found, effect: NamedEffect) -> Candidate:
    """Return the row of an effect that was named, its hypothesis perhaps made while choosing."""
    hypothesis, last = effect.hypothesis, found.last
    alone = float(last.search.values()[last.hypotheses.index(hypothesis)])
    same = [i for i, f in enumerate(found.first.library.hypotheses) if _key(f) == _key(hypothesis)]
    like = min(
        same, key=lambda i: hypothesis.apart(found.first.library.hypotheses[i]), default=None
    )
    return Candidate(replace(hypothesis, on=effect.on), effect.log_p, alone, effect.survival,
                     "named", effect.alternatives,
                     0.0 if like is None else _detectable(found.first, like))


def _detectable(stage: Stage, index: int) -> float:
    """Return the smallest value of a single-column hypothesis that would be named 9 times in 10."""
    hypothesis = stage.library.hypotheses[index]
    if hypothesis.size != 1:
        return 0.0
    c = hypothesis.columns[0]
    test = stage.search.test
    seen = test.length[c] * test.survival([c])
    if seen <= 0.0:
        return 0.0
    # two-sided normal quantile of the naming threshold
    need = np.sqrt(max(-2.0 * stage.search.name - np.log(-2.0 * stage.search.name) - 0.45, 1.0))
    sigma = np.sqrt(test.square / max(test.freedom, 1)) if not stage.chosen else 1.0
    return float((need + POWER) * sigma / seen)


def possible(found: Found, effects: Sequence[NamedEffect], verdict: str,
             lost: Sequence[Hypothesis] = ()) -> tuple[Candidate, ...]:
    """Return what is there but cannot be named: too weak, or no more than an imitation.

    ``lost``: what the data are consistent with, and would not stand if the rest were explained.
    """
    return _over_all(found.first, _possible(found.first, effects, verdict, lost))


def _possible(stage: Stage, effects: Sequence[NamedEffect], verdict: str,
              lost: Sequence[Hypothesis]) -> tuple[Candidate, ...]:
    gone = tuple(_consistent(stage, f) for f in lost)
    if verdict == "unnamed":
        gone += tuple(measured_against(stage))
        return (*(Candidate(replace(e.hypothesis, on=e.on), e.log_p, e.log_p, e.survival,
                            "imitation", e.alternatives, 0.0) for e in effects), *gone)
    if verdict != "weak":
        return gone
    out = []
    for i in np.argsort(stage.log_p, kind="stable")[:3]:
        if stage.log_p[i] < stage.search.detect:
            hypothesis = stage.library.hypotheses[i]
            log_p = float(stage.log_p[i])
            survival = stage.search.test.survival(hypothesis.columns)
            out.append(Candidate(hypothesis, log_p, log_p, survival, "weak", (), 0.0))
    return tuple(out)


def measured_against(stage: Stage) -> Iterator[Candidate]:
    """Yield what the machine is measured against, a flat's shape, where that explains much."""
    test = stage.search.test
    for f in stage.library.measured_against:
        square, rank = test.explained(np.array([f.columns]))
        value = float(log_p(square, test.square, rank, test.freedom)[0])
        if value < stage.search.detect:
            yield Candidate(f, value, value, test.survival(f.columns), "consistent", (), 0.0)


def _consistent(stage: Stage, hypothesis: Hypothesis) -> Candidate:
    """Return the row of an effect that the data are consistent with and that is not named."""
    same = [i for i, f in enumerate(stage.library.hypotheses) if _key(f) == _key(hypothesis)]
    alone = float(min((stage.log_p[i] for i in same), default=0.0))
    survival = stage.search.test.survival(stage.hypotheses[same[0]].columns) if same else np.nan
    return Candidate(hypothesis, alone, alone, survival, "consistent", (), 0.0)


def swallowed(before: Fit, after: Fit) -> tuple[Swallowed, ...]:
    """Return the parameters that had moved by more than their tolerance to imitate effects."""
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
