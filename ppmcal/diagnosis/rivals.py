"""What could take an effect's place: other families that explain as much."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln

from ppmcal import linalg
from ppmcal.diagnosis.hypotheses import Hypothesis, united
from ppmcal.diagnosis.search import Search, columns_of
from ppmcal.diagnosis.selection import (
    BETTER,
    Choice,
    bic,
    doubtful,
    own_log_p,
    possible,
    pruned,
    stand,
)
from ppmcal.linalg import Array

NOTICEABLE = float(np.log(1e-3))
"""A rival has to explain something itself: log p."""
ADDS_NOTHING = 0.01
"""An effect adds nothing to its rival if its p-value exceeds this."""
NOT_RARE = float(2.0 * np.log(100.0))
"""Nor is a rival out at odds that one name in a hundred would defy."""
AS_GOOD = 10.0
"""A rival's BIC may be this much worse: odds of e^5, beyond which it is out."""
LONG_ODDS = 1000.0
"""Odds beyond which a set of effects is not worth a fit."""

MORE = float(np.log(0.2))
"""A more general kind is a rival of a special one to which it adds something: log p, over all
constants of its grid."""

DOUBTED = 23.0
"""The same as AS_GOOD where the effect itself is doubtful, odds of 1e5: they are those of a linear
model, which says little of what the geometry nearly swallows."""


@dataclass(frozen=True)
class Rival:
    """A hypothesis that could take another's place.

    ``angle``: between their columns, seen past geometry and the other effects, rad; ``odds``:
    how much likelier the chosen one is, e^(BIC difference/2); ``members``: what it consists of in
    the search; ``allowed``: BIC that its further parameters cost, which says nothing against it.
    """

    hypothesis: Hypothesis
    angle: float
    odds: float
    members: tuple[int, ...] = ()
    allowed: float = 0.0


def odds_between(one: float, other: float) -> float:
    """Return the odds for a set of effects against another, from the BIC of both."""
    return float(np.exp(np.clip((other - one) / 2.0, -50.0, 50.0)))


def rivals(search: Search, chosen: tuple[int, ...], effect: int) -> list[Rival]:
    """Return the best rival of each other family that these data cannot tell from ``effect``."""
    others = [i for i in chosen if i != effect]
    values = search.values(others)
    now, doubt = bic(search, chosen), doubtful(search, chosen, effect)
    hypothesis = search.hypotheses[effect]
    taken = [search.hypotheses[i] for i in chosen]
    best: dict[str, Rival] = {}
    for rival in [*((int(i),) for i in np.argsort(values, kind="stable")
                    if values[i] <= NOTICEABLE), *_elsewhere(search, hypothesis)]:
        first = search.hypotheses[rival[0]]
        if first.anonymous or first.family in (hypothesis.family, *best) or any(
                f.family == first.family and (f.alike(first) or not _event(first)) for f in taken):
            continue
        trial = (*others, *rival)
        whole, index = as_one(search, rival)
        worse = bic(whole, (*others, index)) - now
        if _only_general(search, chosen, hypothesis, rival, worse < 0.0):
            continue
        size = sum(search.hypotheses[i].size for i in rival)
        # a kind is not less likely for having more parameters, unless one per joint: a body that
        # moves has all six coordinates
        allowed = np.log(search.test.freedom) * max(0, size - hypothesis.size) if (
            len(rival) == 1 and first.shared) else 0.0
        worse -= min(allowed, max(worse, 0.0))
        if worse > (DOUBTED if doubt else AS_GOOD) or not possible(search, trial):
            continue
        adds = own_log_p(search, [*trial, effect], effect)
        if adds > (search.name if doubt else np.log(ADDS_NOTHING)) or worse < NOT_RARE:
            best[first.family] = Rival(united([search.hypotheses[i] for i in rival]),
                                       _angle(search, others, effect, rival),
                                       odds_between(0.0, worse), rival, float(allowed))
    return list(best.values())


def as_one(search: Search, members: Sequence[int]) -> tuple[Search, int]:
    """Return a search that has members of one kind as one hypothesis, and where it is.

    A value for each of several actuators is one choice, as it is of what was chosen.
    """
    if len(members) == 1:
        return search, members[0]
    whole = united([search.hypotheses[i] for i in members])
    return replace(search, hypotheses=(*search.hypotheses, whole)), len(search.hypotheses)


def _event(hypothesis: Hypothesis) -> bool:
    """Whether it may happen several times: another row is another cause."""
    return hypothesis.effect is not None and bool(hypothesis.effect.onset)


def _only_general(search: Search, chosen: Sequence[int], hypothesis: Hypothesis,
                  rival: Sequence[int], better: bool) -> bool:
    """Whether a rival contains the hypothesis and adds nothing to it; ``better``: by BIC."""
    other = search.hypotheses[rival[0]]
    if other.effect is None or hypothesis.kind not in other.effect.contains:
        return False
    if _within(search, hypothesis.columns, columns_of(search, rival)):
        # what it adds is no name, see `simplified`, but it is not ruled out where BIC prefers it
        return not better
    tried = sum((f.family, f.on, f.shared) == (other.family, other.on, other.shared)
                for f in search.hypotheses)
    return bool(search.values(chosen)[rival[0]] + np.log(tried) > MORE)


def _elsewhere(search: Search, hypothesis: Hypothesis) -> list[tuple[int, ...]]:
    """Return other kinds on just the actuators of ``hypothesis``, one value for each."""
    if len(hypothesis.on) < 2:
        return []
    single: dict[str, dict[str, int]] = {}
    for i, other in enumerate(search.hypotheses):
        if len(other.on) == 1 and other.on[0] in hypothesis.on and not other.slot and (
                not other.searched and other.family != hypothesis.family):
            single.setdefault(other.family, {}).setdefault(other.on[0], i)
    return [tuple(have.values()) for have in single.values() if len(have) == len(hypothesis.on)]


def _angle(search: Search, others: list[int], one: int, rival: Sequence[int]) -> float:
    """Return the smallest principal angle between two hypotheses' columns."""
    rest = search.test.given(columns_of(search, others))
    a = np.array(search.hypotheses[one].columns)
    b = np.array(columns_of(search, rival))

    def root(block: Array) -> Array:
        w, v = linalg.eigh(block)
        use = w > 1e-10
        return np.asarray(v[:, use] / np.sqrt(w[use]))

    left, right = root(rest.block(a, a)), root(rest.block(b, b))
    s = linalg.singular_values(left.T @ rest.block(a, b) @ right)
    return float(np.arccos(np.clip(s.max(initial=0.0), 0.0, 1.0)))


FEW = 3
"""Choices of nearly the same BIC whose actuators are looked at."""


def settled(search: Search, choices: Sequence[Choice]) -> tuple[Search, tuple[int, ...]]:
    """Return the best of a few choices, once it is settled where each of its effects acts."""
    best: tuple[int, ...] = ()
    for choice in choices[:FEW]:
        search, chosen = merged(search, choice.chosen)
        if not best or bic(search, chosen) < bic(search, best):
            best = chosen
    return simplified(search, best)


def simplified(search: Search, chosen: Sequence[int]) -> tuple[Search, tuple[int, ...]]:
    """Replace kinds by such as they contain, unless what they add is worth a name itself.

    BIC takes a parameter more at p = 0.03 already; that much is no cause.
    """
    for i in chosen:
        general = search.hypotheses[i]
        for kind in general.effect.contains if general.effect else ():
            plain = [j for a in general.on for j, f in enumerate(search.hypotheses)
                     if (f.family, f.on) == (kind, (a,))]
            if not plain or len(plain) != len(general.on):
                continue
            if general.shared:
                search, together = _together(search, [search.hypotheses[j] for j in plain])
                plain = [together]
            if not _within(search, columns_of(search, plain), general.columns):
                continue
            trial = [*(j for j in chosen if j != i), *plain]
            more = own_log_p(search, [*trial, i], i) + general.choices
            if more > search.name and stand(search, trial):
                return simplified(search, trial)
    return search, tuple(chosen)


def _within(search: Search, columns: Sequence[int], others: Sequence[int]) -> bool:
    """Whether columns are combinations of others, seen past the geometry."""
    both = list(dict.fromkeys([*others, *columns]))
    rest = search.test.only(both).given(range(len(set(others))))
    return not rest.explained(np.array([[both.index(c) for c in columns]]))[1].any()


def merged(search: Search, chosen: Sequence[int]) -> tuple[Search, tuple[int, ...]]:
    """Settle, kind by kind, on which actuators an effect acts and with how many values.

    Tried are one value for a set of actuators and one for each of them, besides what was
    chosen: those that were named, and the strongest one, two, ... BIC decides.
    """
    kinds = list(
        dict.fromkeys(
            search.hypotheses[i].family
            for i in chosen
            if search.hypotheses[i].on
            and not search.hypotheses[i].slot
            and not search.hypotheses[i].anonymous
        )
    )
    best = tuple(chosen)
    for kind in kinds:
        mine = [i for i in best if search.hypotheses[i].family == kind]
        if not mine:
            continue
        others = [i for i in best if i not in mine]
        search, options = _options(search, kind, mine, others)
        sets = [tuple(pruned(search, [*others, *o], search.name)) for o in options]
        values = [(bic(search, s), n, s) for n, s in enumerate(sets) if stand(search, s)]
        if values:
            best = min(values)[2]
    return search, best


def _options(search: Search, kind: str, mine: Sequence[int], others: Sequence[int]
             ) -> tuple[Search, list[tuple[int, ...]]]:
    """Return sets of hypotheses of one kind that might replace ``mine``."""
    hypotheses = search.hypotheses
    options: list[tuple[int, ...]] = [tuple(mine)]
    constants = hypotheses[mine[0]].constants
    single = {f.on[0]: i for i, f in enumerate(hypotheses)
              if f.family == kind and len(f.on) == 1 and f.constants == constants}
    named = [a for a in single if any(a in hypotheses[i].on for i in mine)]
    for subset in _subsets(search, others, single, named):
        alone = [single[a] for a in subset]
        options.append(tuple(alone))
        if len(subset) > 1:
            search, together = _together(search, [hypotheses[single[a]] for a in subset])
            options.append((together,))
    return search, options


def _subsets(search: Search, others: Sequence[int], single: Mapping[str, int],
             named: Sequence[str]) -> list[list[str]]:
    """Return sets of actuators worth trying: those named, and the strongest one, two, ...

    Strong is what stands out when every actuator has a value of its own.
    """
    out = [list(named)]
    for among in (list(named), list(single)):
        alone = [single[a] for a in among]
        own = {a: own_log_p(search, [*others, *alone], single[a]) for a in among}
        order = sorted(among, key=lambda a: own[a])
        out += [[a for a in among if a in order[:k]] for k in range(1, len(order) + 1)]
    return [s for n, s in enumerate(out) if s and s not in out[:n]]


def _together(search: Search, parts: Sequence[Hypothesis]) -> tuple[Search, int]:
    """Return the hypothesis in which several actuators share one value, added where it is new."""
    wanted = {a for part in parts for a in part.on}
    for i, hypothesis in enumerate(search.hypotheses):
        if (hypothesis.family == parts[0].family and hypothesis.shared
                and set(hypothesis.on) == wanted and hypothesis.alike(parts[0])):
            return search, i
    total = search.test.right.size
    size = parts[0].size
    weights = np.zeros((total, size))
    for part in parts:
        for j, c in enumerate(part.columns):
            weights[c, j] = 1.0
    on = tuple(a for part in parts for a in part.on)
    hypothesis = replace(parts[0], on=on, columns=tuple(range(total, total + size)),
                   choices=_choices(search, len(on)))
    return replace(search, test=search.test.extended(weights),
                   hypotheses=(*search.hypotheses, hypothesis)), len(search.hypotheses)


def _choices(search: Search, some: int) -> float:
    """Return the logarithm of the number of sets of so many actuators."""
    total = max(len(f.on) for f in search.hypotheses)
    return float(gammaln(total + 1) - gammaln(some + 1) - gammaln(max(total - some, 0) + 1))


def held(search: Search, chosen: tuple[int, ...], hypotheses: Sequence[Hypothesis]
         ) -> tuple[Search, tuple[int, ...]]:
    """Return ``hypotheses``, chosen at an earlier fit, if they are as good as ``chosen``.

    Without this two effects that look alike would take turns for ever.
    """
    old: list[int] = []
    for hypothesis in hypotheses:
        search, index = find(search, hypothesis)
        if index is None:
            return search, chosen
        old.append(index)
    if not old or not stand(search, old):
        return search, chosen
    good = not chosen or bic(search, old) <= bic(search, chosen) + BETTER
    return search, tuple(old) if good else chosen


def find(search: Search, hypothesis: Hypothesis) -> tuple[Search, int | None]:
    """Return where a hypothesis of another search is in this one, made where it can be."""
    match = [i for i, f in enumerate(search.hypotheses)
             if (f.family, f.on, f.shared) == (hypothesis.family, hypothesis.on, hypothesis.shared)]
    if match:
        # of one kind there may be hypotheses with fewer and with more parameters
        return search, min(match, key=lambda i: (
            search.hypotheses[i].names != hypothesis.names, hypothesis.apart(search.hypotheses[i])))
    parts = [f for f in search.hypotheses if f.family == hypothesis.family and len(f.on) == 1
             and f.on[0] in hypothesis.on and f.alike(hypothesis)]
    if not parts or len(parts) != len(hypothesis.on):
        return search, None
    if hypothesis.shared:
        return _together(search, parts)
    return replace(search, hypotheses=(*search.hypotheses, united(parts))), len(search.hypotheses)
