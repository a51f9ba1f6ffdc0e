"""Which sets of effects explain the measurements, and the odds between them.

Tried are the named set; each of its effects, or two at once, in exchange for a rival; each that
rests on little left out; and each at the margin, found but too weak to be named, added.
Odds are e^(BIC difference/2), as between rivals (Hoeting et al. 1999, Bayesian model averaging).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from ppmcal.diagnosis.rivals import LONG_ODDS, Rival, as_one, odds_between
from ppmcal.diagnosis.search import Search, columns_of
from ppmcal.diagnosis.selection import bic, borne, possible
from ppmcal.diagnosis.stage import Stage, named_only

MOST = 4
"""Rivals of one effect that are tried, the likeliest first."""
MOST_SETS = 8
"""Sets besides the named one that are fitted, the likeliest first."""
MARGINAL = 3
"""Effects at the margin that are tried."""


@dataclass(frozen=True)
class EffectSet:
    """Another set of effects.

    ``chosen``: hypotheses of ``search``; ``effect``: what it has ``instead`` of what the named set
    has, either empty where it has only less, or more; ``labels``: of all its effects; ``odds``
    for the named set against it.
    """

    search: Search
    chosen: tuple[int, ...]
    effect: str
    instead: str
    labels: tuple[str, ...]
    odds: float


def effect_sets(stage: Stage, rivals: Mapping[int, Sequence[Rival]]) -> list[EffectSet]:
    """Return the other sets of effects at odds that count, the likeliest first.

    Args:
        stage: where the effects were chosen.
        rivals: by named hypothesis.
    """
    now = bic(stage.search, stage.chosen)
    found: dict[frozenset[int], EffectSet] = {}
    for search, chosen, effect, instead, allowed in _tried(stage, rivals):
        worse = bic(search, chosen) - now
        odds = odds_between(0.0, worse - min(allowed, max(worse, 0.0)))
        columns = frozenset(columns_of(search, chosen))
        if odds <= LONG_ODDS and columns not in found:
            found[columns] = EffectSet(search, chosen, "; ".join(effect), "; ".join(instead),
                                       _labels(stage, chosen, effect), odds)
    return sorted(found.values(), key=lambda s: s.odds)[:MOST_SETS]


def labels(stage: Stage) -> tuple[str, ...]:
    """Return the labels of the named set."""
    return tuple(f.label for f in stage.named)


Change = tuple[Search, tuple[int, ...], list[str], list[str], float]
"""A search and a set in it, what it has instead of the named one, what that has instead, and BIC
that says nothing against it."""


def _tried(stage: Stage, rivals: Mapping[int, Sequence[Rival]]) -> Iterator[Change]:
    """Yield the sets that are possible; the rivals alone were found so when they were sought."""
    search, chosen, label = stage.search, stage.chosen, [f.label for f in stage.hypotheses]
    some = {i: sorted(r, key=lambda r: r.odds)[:MOST] for i, r in rivals.items()}
    for i, others in some.items():
        for r in others:
            whole, one = as_one(search, r.members)
            yield (whole, (*_without(chosen, i), one), [r.hypothesis.label], [label[i]],
                   r.allowed)
    for i, j in combinations(some, 2):
        for r, s in product(some[i], some[j]):
            whole, one = as_one(search, r.members)
            whole, two = as_one(whole, s.members)
            trial = (*(k for k in chosen if k not in (i, j)), one, two)
            if r.hypothesis.family != s.hypothesis.family and possible(whole, trial):
                yield (whole, trial, [r.hypothesis.label, s.hypothesis.label],
                       [label[i], label[j]], r.allowed + s.allowed)
    for i in named_only(stage):
        rest = tuple(borne(search, _without(chosen, i)))
        gone = [label[k] for k in named_only(stage) if k not in rest]
        yield search, rest, [], gone, 0.0
    for i in _marginal(search, chosen):
        yield search, (*chosen, i), [label[i]], [], 0.0


def _marginal(search: Search, chosen: Sequence[int]) -> list[int]:
    """Return the effects that are found but too weak to be named, the strongest of each family."""
    values = search.values(chosen)
    out: dict[str, int] = {}
    for i in np.argsort(values, kind="stable").tolist():
        if values[i] > search.detect or len(out) == MARGINAL:
            break
        f = search.hypotheses[i]
        if i not in chosen and not f.anonymous and f.family not in out and possible(
                search, [*chosen, i]):
            out[f.family] = i
    return list(out.values())


def _without(chosen: Sequence[int], i: int) -> tuple[int, ...]:
    return tuple(j for j in chosen if j != i)


def _labels(stage: Stage, chosen: Sequence[int], effect: Sequence[str]) -> tuple[str, ...]:
    kept = [stage.hypotheses[i].label for i in named_only(stage) if i in chosen]
    return (*kept, *effect)
