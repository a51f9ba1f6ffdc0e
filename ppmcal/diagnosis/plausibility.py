"""Effects of a size that no machine has: then it is the data that are read wrongly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.result import Found
from ppmcal.diagnosis.search import Search, columns_of
from ppmcal.diagnosis.selection import STARTS, bic, possible
from ppmcal.model.effects import find_effect

COLUMNS = {"load": "payload (kg) or fx ... mz (N, N m)", "wrench": "payload (kg) or fx ... mz",
           "vel": "the vel_ columns", "dir": "the dir_ columns", "temperature":
           "temperature (deg C)", "time": "time (s)"}
"""What to look at, by what an effect depends on."""


def fitted_values(search: Search, hypothesis: int) -> list[float]:
    """Return the coefficients of one hypothesis alone, SI."""
    return [float(v) for v in search.test.fit(columns_of(search, [hypothesis]))[0]]


def implausible(search: Search, named: Sequence[Hypothesis]) -> int | None:
    """Return a hypothesis that explains more than what was chosen, of a size that no machine has.

    Something else is wrong then, a unit perhaps, and what was chosen in its place imitates it.

    Args:
        search: the first one.
        named: what was chosen at last, perhaps hypotheses that a later search made.
    """
    values, chosen = search.values(), _nearest(search, named)
    now = bic(search, chosen)
    for i in np.argsort(values, kind="stable")[:STARTS]:
        hypothesis = search.hypotheses[i]
        if values[i] > search.name or hypothesis.anonymous or int(i) in chosen:
            continue
        if possible(search, [int(i)], False) and not possible(search, [int(i)]) and (
                bic(search, [int(i)]) < now):
            return int(i)
    return None


def _nearest(search: Search, named: Sequence[Hypothesis]) -> list[int]:
    """Return the hypotheses of a search most like others, which may be of another search.

    A group of joints that it does not have is taken joint by joint.
    """
    def like(hypothesis: Hypothesis, on: tuple[str, ...]) -> list[int]:
        same = [(hypothesis.apart(f), i) for i, f in enumerate(search.hypotheses)
                if (f.family, f.on) == (hypothesis.family, on)
                and (f.shared == hypothesis.shared or len(on) == 1)]
        return [min(same)[1]] if same else []

    out: list[int] = []
    for hypothesis in named:
        out += like(hypothesis, hypothesis.on) or [
            i for a in hypothesis.on for i in like(hypothesis, (a,))
        ]
    return list(dict.fromkeys(out))


def implausible_words(found: Found, index: int) -> str:
    """Return what a size outside the range of machines says about the data."""
    hypothesis = found.first.search.hypotheses[index]
    values = fitted_values(found.first.search, index)
    motion = found.before.problem.mechanism.motion
    kind = find_effect(hypothesis.kind)
    specs = {s.name: s for s in kind.parameters(motion)}
    told = []
    for name, value, (low, high) in zip(hypothesis.names, values, hypothesis.usual, strict=True):
        if low <= value <= high:
            continue
        spec = specs[name.split(":")[-1]]
        if spec.reciprocal:
            value, low, high = 1.0 / value, 1.0 / high, 1.0 / low
        told.append(f"{name.replace(':', ' ')} {value:.3g}, beyond {low:.2g} to {high:.2g} "
                    f"(SI; {spec.why})")
    column = kind.doubt or ", ".join(COLUMNS.get(n, n) for n in kind.needs) or (
        "the joint columns and of the rotations")
    return (
        f"{hypothesis.label} would explain most, but with {'; '.join(told[:2])}: no machine has "
        f"that; check the unit of {column}. Nothing is named in its place"
    )
