"""From chosen hypotheses to a machine that includes them, ready to fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import Problem
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.linalg import Array
from ppmcal.model.effects import EffectParameter
from ppmcal.model.mechanism import Given, Mechanism, with_effect

SMALLEST = 1e-3
"""A coefficient outside its range starts at this part of its standard deviation inside."""


@dataclass(frozen=True, eq=False)
class Sized:
    """A hypothesis with its coefficients (k,), their sigmas, and those of their ``prior``.

    The prior is that of the block's most probable size: without it, a fit would diverge along
    directions that the rows hardly determine.
    """

    hypothesis: Hypothesis
    value: Array
    sigma: Array
    prior: Array


@dataclass(frozen=True)
class Added:
    """One added effect: the hypothesis it came from and its parameters' names."""

    hypothesis: Hypothesis
    on: tuple[str, ...]
    parameters: tuple[str, ...]


def columns_added(problem: Problem, added: Sequence[Added]) -> list[int]:
    """Return the free columns of a problem that belong to added effects."""
    names, mechanism = {n for a in added for n in a.parameters}, problem.mechanism
    return [c for c, p in enumerate(problem.free) if mechanism.parameters[p].name in names]


def extended(mechanism: Mechanism, sized: Sequence[Sized]) -> tuple[Mechanism, tuple[Added, ...]]:
    """Return the machine with hypotheses as free effects.

    A coefficient without a standard deviation is not identifiable: it stays at its default, since
    a fit of it would diverge.
    """
    added: list[Added] = []
    for one in sized:
        hypothesis, value, sigma = one.hypothesis, one.value, one.sigma
        if hypothesis.slot and not sigma[0] > 0.0:
            continue
        if hypothesis.slot:
            mechanism = _freed(mechanism, hypothesis.slot, float(value[0]))
            added.append(Added(hypothesis, hypothesis.on, (hypothesis.slot,)))
            continue
        count = 1 if hypothesis.shared else len(hypothesis.on)
        size = hypothesis.size // count
        for part in range(count):
            on = hypothesis.on if hypothesis.shared else (hypothesis.on[part],)
            mine = slice(part * size, (part + 1) * size)
            if not sigma[mine].any():
                continue
            mechanism, names = _with(mechanism, hypothesis, on, value[mine], sigma[mine],
                                     one.prior[mine])
            added.append(Added(hypothesis, on, names))
    return mechanism, tuple(added)


def _with(mechanism: Mechanism, hypothesis: Hypothesis, on: Sequence[str], value: Array,
          sigma: Array, prior: Array) -> tuple[Mechanism, tuple[str, ...]]:
    kind = hypothesis.effect
    assert kind is not None
    specs = {s.name: s for s in kind.parameters(mechanism.motion)}
    names = [n.split(":")[-1] for n in hypothesis.names[:value.size]]
    given = {n: Given(_start(specs[n], float(v), float(s)), free=True) if specs[n].reciprocal else
             Given(_start(specs[n], float(v), float(s)), float(size), free=True, nominal=0.0)
             for n, v, s, size in zip(names, value, sigma, prior, strict=True) if s > 0.0}
    for n, v in hypothesis.constants.items():
        if not specs[n].scaling:
            given[n] = Given(v, free=not specs[n].constant)
    acts = tuple(not on or a in on for a in mechanism.actuators)
    before = len(mechanism.parameters)
    mechanism = with_effect(mechanism, kind, acts, given)
    return mechanism, tuple(p.name for p in mechanism.parameters[before:]
                            if p.free or not (p.value == 0.0 or np.isnan(p.value)))


def _start(spec: EffectParameter, value: float, sigma: float) -> float:
    if spec.reciprocal:
        return 1.0 / max(value, SMALLEST * sigma, 1e-300)
    return float(np.clip(value, spec.low, spec.high))


def _freed(mechanism: Mechanism, slot: str, error: float) -> Mechanism:
    """Return the machine with a frozen slot free, started at its estimated error."""
    parameters = list(mechanism.parameters)
    i = mechanism.names.index(slot)
    p = parameters[i]
    parameters[i] = replace(p, free=True, fixed=False, value=p.value + error)
    return replace(mechanism, parameters=tuple(parameters),
                   free=tuple(sorted({*mechanism.free, i})))
