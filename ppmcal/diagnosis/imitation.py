"""What chosen effects leave, and whether they only make up a shape that none of them is."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

from ppmcal.diagnosis.added_variable_test import probability
from ppmcal.diagnosis.adequacy import Remainder, remainder
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.selection import own_log_p
from ppmcal.diagnosis.stage import Stage, named_only

FEW_PERIODS = 4.0
"""A wave of fewer periods over the stroke is as smooth as any other shape."""


def left_over(stage: Stage, seed: int) -> Remainder:
    """Return what named effects leave; an anonymous shape that was chosen says what it follows."""
    left = remainder(replace(stage, chosen=named_only(stage)), seed)
    for i in stage.chosen:
        hypothesis = stage.hypotheses[i]
        if hypothesis.anonymous:
            p = probability(own_log_p(stage.search, stage.chosen, i))
            left = replace(left, follows=hypothesis.follows,
                           p_value=min(p, left.p_value))
    for joint, j in _neither(stage):
        p = probability(own_log_p(stage.search, stage.chosen, j))
        left = replace(left, follows=joint, p_value=min(p, left.p_value))
    return left


def _neither(stage: Stage) -> list[tuple[str, int]]:
    """Return joints with two smooth kinds, a shape that is neither, and the second's hypothesis."""
    out = []
    for i, j in combinations(named_only(stage), 2):
        a, b = stage.hypotheses[i], stage.hypotheses[j]
        joint = set(a.on) & set(b.on)
        if joint and _slow(stage, a) and _slow(stage, b) and a.kind != b.kind:
            out.append((min(joint), j))
    return out


def imitated(stage: Stage) -> bool:
    """Whether all that is named only makes up a shape along joints that none of it is."""
    joints = {joint for joint, _ in _neither(stage)}
    return bool(joints) and all(
        f.on and set(f.on) <= joints and f.effect is not None
        and (f.effect.smooth or f.effect.period) for f in stage.named)


def _slow(stage: Stage, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis is smooth over the stroke; a wave is if it has few periods there."""
    kind = hypothesis.effect
    if kind is None:
        return False
    if kind.period:
        return stage.system.stroke < FEW_PERIODS * hypothesis.constants[kind.period]
    return kind.smooth
