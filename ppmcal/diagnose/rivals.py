"""What could take an effect's place: other families that explain as much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.diagnose.forms import Form, united
from ppmcal.diagnose.search import (
    Search,
    bic,
    columns_of,
    doubtful,
    own_log_p,
    possible,
)
from ppmcal.linalg import Array

NOTICEABLE = float(np.log(1e-3))
"""A rival has to explain something itself: log p."""
ADDS_NOTHING = 0.01
"""An effect adds nothing to its rival if its p-value exceeds this."""
AS_GOOD = 10.0
"""A rival's BIC may be this much worse: odds of e^5, beyond which it is out."""

DOUBTED = 23.0
"""The same where the effect itself is doubtful: odds of 1e5."""


@dataclass(frozen=True)
class Rival:
    """A form that could take another's place.

    ``angle``: between their columns, seen past geometry and the other effects, rad; ``odds``:
    how much likelier the chosen one is, e^(BIC difference/2).
    """

    form: Form
    angle: float
    odds: float


def rivals(search: Search, chosen: tuple[int, ...], effect: int) -> list[Rival]:
    """Return the best rival of each other family that these data cannot tell from ``effect``."""
    others = [i for i in chosen if i != effect]
    values = search.values(others)
    now, doubt = bic(search, chosen), doubtful(search, chosen, effect)
    form = search.forms[effect]
    taken = {search.forms[i].family for i in chosen}
    best: dict[str, Rival] = {}
    for rival in [*((int(i),) for i in np.argsort(values, kind="stable")
                    if values[i] <= NOTICEABLE), *_elsewhere(search, form)]:
        first = search.forms[rival[0]]
        if first.anonymous or first.family in taken or first.family in best:
            continue
        trial = (*others, *rival)
        worse = bic(search, trial) - now
        size = sum(search.forms[i].size for i in rival)
        limit = DOUBTED if doubt else AS_GOOD
        if first.shared:  # a kind is not out for having more parameters, unless one per joint
            limit += np.log(search.gram.freedom) * max(0, size - form.size)
        if worse > limit or not possible(search, trial):
            continue
        if own_log_p(search, [*trial, effect], effect) > (
                search.name if doubt else np.log(ADDS_NOTHING)):
            best[first.family] = Rival(united([search.forms[i] for i in rival]),
                                       _angle(search, others, effect, rival),
                                       float(np.exp(min(worse / 2.0, 50.0))))
    return list(best.values())


def _elsewhere(search: Search, form: Form) -> list[tuple[int, ...]]:
    """Return other kinds on just the actuators of ``form``, one value for each."""
    if len(form.on) < 2:
        return []
    single: dict[str, dict[str, int]] = {}
    for i, other in enumerate(search.forms):
        if len(other.on) == 1 and other.on[0] in form.on and not other.slot and (
                other.kind not in ("periodic", form.kind)):
            single.setdefault(other.kind, {}).setdefault(other.on[0], i)
    return [tuple(have.values()) for have in single.values() if len(have) == len(form.on)]


def _angle(search: Search, others: list[int], one: int, rival: Sequence[int]) -> float:
    """Return the smallest principal angle between two forms' columns."""
    rest = search.gram.given(columns_of(search, others))
    a = np.array(search.forms[one].columns)
    b = np.array(columns_of(search, rival))

    def root(block: Array) -> Array:
        w, v = np.linalg.eigh(block)
        use = w > 1e-10
        return np.asarray(v[:, use] / np.sqrt(w[use]))

    left, right = root(rest.block(a, a)), root(rest.block(b, b))
    s = np.linalg.svd(left.T @ rest.block(a, b) @ right, compute_uv=False)
    return float(np.arccos(np.clip(s.max(initial=0.0), 0.0, 1.0)))
