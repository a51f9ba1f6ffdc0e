"""What could take an effect's place: other families that explain as much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal.diagnose.search import (
    Search,
    bic,
    columns_of,
    doubtful,
    own_log_p,
    possible,
    scan,
)

Array = NDArray[np.float64]
NOTICEABLE = float(np.log(1e-3))
"""A rival has to explain something itself: log p."""
ADDS_NOTHING = 0.01
"""An effect adds nothing to its rival if its p-value exceeds this."""
AS_GOOD = 10.0
"""A rival's BIC may be this much worse: odds of e^5, beyond which it is out."""


@dataclass(frozen=True)
class Rival:
    """A form that could take the place of another.

    ``angle``: between their columns, seen past geometry and the other effects, rad; ``odds``:
    how much likelier the chosen one is, e^(BIC difference/2).
    """

    form: int
    angle: float
    odds: float


def rivals(search: Search, chosen: tuple[int, ...], effect: int) -> list[Rival]:
    """Return the best rival of each other family that these data cannot tell from ``effect``."""
    others = [i for i in chosen if i != effect]
    rest = search.gram.given(columns_of(search, others))
    values = scan(rest, search.forms)
    now = bic(search, chosen)
    doubt = doubtful(search, chosen, effect)
    mine = search.forms[effect].family
    taken = {search.forms[i].family for i in chosen}
    best: dict[str, Rival] = {}
    for i in np.argsort(values, kind="stable"):
        form = search.forms[int(i)]
        if values[i] > NOTICEABLE:
            break
        if form.anonymous or form.family == mine or form.family in taken or form.family in best:
            continue
        trial = (*others, int(i))
        worse = bic(search, trial) - now
        limit = np.inf if doubt else AS_GOOD
        if form.shared:  # a kind is not out for having more parameters, unless one per joint
            limit += np.log(search.gram.freedom) * max(0, form.size - search.forms[effect].size)
        if worse > limit or not possible(search, trial):
            continue
        if own_log_p(search, [*trial, effect], effect) > np.log(ADDS_NOTHING):
            best[form.family] = Rival(int(i), _angle(search, others, effect, int(i)),
                                      float(np.exp(min(worse / 2.0, 50.0))))
    return list(best.values())


def _angle(search: Search, others: list[int], one: int, two: int) -> float:
    """Return the smallest principal angle between two forms' columns."""
    rest = search.gram.given(columns_of(search, others))
    a, b = list(search.forms[one].columns), list(search.forms[two].columns)

    def root(block: Array) -> Array:
        w, v = np.linalg.eigh(block)
        use = w > 1e-10
        return np.asarray(v[:, use] / np.sqrt(w[use]))

    left, right = root(rest.gram[np.ix_(a, a)]), root(rest.gram[np.ix_(b, b)])
    s = np.linalg.svd(left.T @ rest.gram[np.ix_(a, b)] @ right, compute_uv=False)
    return float(np.arccos(np.clip(s.max(initial=0.0), 0.0, 1.0)))
