"""Choosing effects: the smallest p-value first, then what the others explain goes again.

The thresholds are those of :mod:`ppmcal.diagnosis.search`. Shared against single actuators is
settled by BIC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import gammaln

from ppmcal import linalg
from ppmcal.diagnosis.added_variable_test import log_p
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.search import Search, columns_of
from ppmcal.linalg import Array

MOST_EFFECTS = 6
STARTS = 6
OUT_OF_RANGE = 2.5
"""A coefficient may miss its physical range by so many standard deviations."""
MOST_PERIODS = 2
"""Screw and motor, gear and pinion."""
BETTER = 2.0
"""An exchange has to lower BIC by this."""
ANONYMOUS = 6.0
"""BIC that an anonymous shape must make up for before it is preferred to a kind."""
SWALLOWED, MOSTLY = 0.2, 0.75
"""See :func:`doubtful`."""
@dataclass(frozen=True)
class Choice:
    """Chosen hypotheses (indices) and their BIC."""

    chosen: tuple[int, ...]
    bic: float


def choose(search: Search) -> list[Choice]:
    """Return the best sets of effects, from several first guesses, best first.

    Every effect must reach the naming threshold. Against nothing that threshold decides; BIC
    only chooses between effects.
    """
    level = search.name
    values = search.values()
    starts: list[list[int]] = []
    for i in np.argsort(values, kind="stable"):
        if values[i] > level or len(starts) == STARTS:
            break
        start = _bearing(search, int(i))
        first = search.hypotheses[i]
        if possible(search, start) and all(
                first.family != search.hypotheses[j].family
                or first.size != search.hypotheses[j].size for *_, j in starts):
            starts.append(start)
    found: dict[frozenset[int], Choice] = {}
    for start in [*starts, *_there_and_back(search, level)]:
        chosen = _exchanged(search, _grown(search, start, level), level)
        if chosen:
            found[frozenset(chosen)] = Choice(tuple(chosen), bic(search, chosen))
    return sorted(found.values(), key=lambda c: c.bic)


def _there_and_back(search: Search, level: float) -> list[list[int]]:
    """Return pairs of an event and the one that undoes it, which alone may both be too small.

    Of each kind and place the best event and the best one beside it; the best such pairs, where
    both together reach the threshold although they were chosen from all pairs of rows.
    """
    events: dict[tuple[str, tuple[str, ...], bool], list[int]] = {}
    for i, f in enumerate(search.hypotheses):
        if f.effect is not None and f.effect.onset:
            events.setdefault((f.family, f.on, f.shared), []).append(i)
    pairs: list[tuple[float, list[int]]] = []
    values = search.values()
    for own in events.values():
        first = min(own, key=lambda i: values[i])
        columns = columns_of(search, own)
        place = {c: n for n, c in enumerate(columns)}
        test = search.test.only(columns)
        rest = test.given([place[c] for c in search.hypotheses[first].columns])
        groups = np.array([[place[c] for c in search.hypotheses[i].columns] for i in own])
        second = own[int(np.argmax(rest.explained(groups)[0]))]
        both = np.array([[place[c] for c in columns_of(search, (first, second))]])
        square, rank = test.explained(both)
        value = float(log_p(square, test.square, rank, test.freedom)[0])
        value = value / search.hypotheses[first].caution + np.log(len(own))
        if value <= level and second != first and possible(search, [first, second]):
            pairs.append((value, [first, second]))
    return [pair for _, pair in sorted(pairs)[:MOST_PAIRS]]


MOST_PAIRS = 2


def bic(search: Search, chosen: Sequence[int]) -> float:
    """Return n log(RSS/n) + k log n + 2 log C(families, effects), the extended BIC.

    Constants of a grid count as parameters; the last term pays for the search. To it comes what
    the sizes cost by their priors, :func:`size_costs`.
    """
    columns = columns_of(search, chosen)
    left = search.test.left(columns)
    n = search.test.freedom
    searched = sum(search.hypotheses[i].searched for i in chosen)
    hypotheses, k = search.distinct, len(chosen)
    looked = gammaln(hypotheses + 1) - gammaln(k + 1) - gammaln(max(hypotheses - k, 0) + 1)
    anonymous = sum(1 for i in chosen if search.hypotheses[i].anonymous)
    looked += sum(search.hypotheses[i].choices for i in chosen)
    seldom = sum(f.effect.seldom for i in chosen if (f := search.hypotheses[i]).effect is not None)
    return float(n * np.log(max(left, 1e-300) / n) + ANONYMOUS * anonymous + seldom
                 + (len(columns) + searched) * np.log(n) + 2.0 * looked
                 + sum(size_costs(search, chosen)))


def size_costs(search: Search, chosen: Sequence[int]) -> list[float]:
    """Return by how much each chosen hypothesis fits worse for the prior of its size, 0 without.

    Coefficients b are known with covariance V and have scales S. An error of slots has the
    normal prior that its tolerance is: b' (V + S S)^-1 b more. Tolerances say of an effect
    how large errors are in a machine that is built so, not how large it is itself: normal with a
    variance that is known as if from one value, so a Cauchy distribution (Gelman et al. 2008,
    doi:10.1214/08-AOAS191): (k + 1) log(1 + b' (S S)^-1 b) for k coefficients of one cause, and
    never more than b' V^-1 b, for which the fit does without it.
    """
    columns = columns_of(search, chosen)
    if not any(np.isfinite(search.hypotheses[i].scale).any() for i in chosen):
        return [0.0] * len(chosen)
    value, covariance = search.test.fit(columns)
    place = {c: j for j, c in enumerate(columns)}
    out = []
    for i in chosen:
        own = search.hypotheses[i]
        known = [(place[c], s) for c, s in zip(own.columns, own.scale, strict=bool(own.scale))
                 if np.isfinite(s)]
        at, scale = [j for j, _ in known], np.array([s for _, s in known])
        out.append(_size_cost(value[at] / scale, covariance[np.ix_(at, at)]
                              / np.outer(scale, scale), bool(own.slot)) if at else 0.0)
    return out


def _size_cost(b: Array, covariance: Array, normal: bool) -> float:
    """Return what coefficients (k,) with a covariance cost, all in scales."""
    spread = covariance + np.eye(b.size) if normal else covariance
    square = float(b @ linalg.pinv(spread, hermitian=True) @ b)
    return square if normal else min(square, (b.size + 1) * float(np.log1p(b @ b)))


def possible(search: Search, chosen: Sequence[int], usual: bool = True, named: bool = True
             ) -> bool:
    """Whether all coefficients of the chosen hypotheses are physical, and their waves too.

    ``usual``: they have to be in the range of machines too, not only to have a meaning; ``named``:
    and where they are named at last, if the search asks that.
    """
    hypotheses = [search.hypotheses[i] for i in chosen]
    if not _apart([f for f in hypotheses if f.turns]) or _twice(hypotheses) or (
            not _once(hypotheses) or len(borne(search, chosen)) < len(chosen)):
        return False
    columns = columns_of(search, chosen)
    value, covariance = search.test.fit(columns)
    slack = OUT_OF_RANGE * np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    place = {c: j for j, c in enumerate(columns)}
    for i in chosen:
        hypothesis = search.hypotheses[i]
        at = [place[c] for c in hypothesis.columns]
        if hypothesis.size == 1:
            slack = np.where(np.isin(np.arange(len(columns)), at), 0.0, slack)
        ranges: list[tuple[Sequence[float], Sequence[float]]] = [(hypothesis.low, hypothesis.high)]
        ranges += [([r[0] for r in rs], [r[1] for r in rs]) for rs, asked in (
            (hypothesis.usual, usual), (hypothesis.named, named)) if rs and asked]
        if any(np.any(value[at] < np.array(low) - slack[at])
               or np.any(value[at] > np.array(high) + slack[at]) for low, high in ranges):
            return False
        if not _of_one_sign(hypothesis, value[at], slack[at]):
            return False
    return True


def _of_one_sign(hypothesis: Hypothesis, value: Array, slack: Array) -> bool:
    """Whether coefficients (k,) of one cause on one joint pull the same way, if its kind asks."""
    if hypothesis.effect is None or not hypothesis.effect.one_sign:
        return True
    joints = np.array([name.rpartition(":")[0] for name in hypothesis.names])
    return all(any(np.all(way * value[own] >= -slack[own]) for way in (1.0, -1.0))
               for own in (joints == j for j in dict.fromkeys(joints)))


def _once(chosen: Sequence[Hypothesis]) -> bool:
    """Whether no joint has two of a kind with other constants: of one width, one time constant.

    Two of them make up for the steps of the grid. Waves and events may be several.
    """
    taken: set[tuple[str, str]] = set()
    for hypothesis in chosen:
        kind = hypothesis.effect
        if kind is None or kind.onset or kind.period or not hypothesis.scanned:
            continue
        own = {(hypothesis.family, joint) for joint in hypothesis.on or ("",)}
        if own & taken:
            return False
        taken |= own
    return True


def _apart(waves: Sequence[Hypothesis]) -> bool:
    """Whether no joint has more than :data:`MOST_PERIODS`, or two that are one between the grid.

    More waves are some other shape.
    """
    for n, wave in enumerate(waves):
        alike = [w for w in waves[:n] if set(w.on) & set(wave.on)]
        if len(alike) >= MOST_PERIODS or any(abs(w.turns - wave.turns) < 1.0 for w in alike):
            return False
    return True


def _twice(hypotheses: Sequence[Hypothesis]) -> bool:
    """Whether one cause is there twice on a joint, or in the machine, with different constants."""
    return any(a.family == b.family and (not a.on or set(a.on) & set(b.on)) and not a.alike(b)
               for a, b in combinations(hypotheses, 2)
               if a.effect is not None and (a.effect.may_be_plain or a.effect.one_by_one))


def borne(search: Search, chosen: Sequence[int]) -> list[int]:
    """Return the chosen hypotheses without those that show only through what is not chosen."""
    there = [(f.kind, f.on) for f in (search.hypotheses[i] for i in chosen) if f.shared]
    return [i for i in chosen if search.hypotheses[i].leans in (None, *there)]


def _grown(search: Search, chosen: list[int], level: float) -> list[int]:
    """Add the hypothesis of smallest p, drop what the others explain, until nothing changes."""
    for _ in range(2 * MOST_EFFECTS):
        added = _added(search, chosen, level) if len(chosen) < MOST_EFFECTS else None
        if added is None:
            break
        new = pruned(search, [*chosen, added], level)
        if set(new) == set(chosen):
            break
        chosen = new
    return chosen


def _added(search: Search, chosen: Sequence[int], level: float) -> int | None:
    values = search.values(chosen)
    for i in np.argsort(values, kind="stable"):
        if values[i] > level:
            return None
        if int(i) not in chosen and possible(search, [*chosen, int(i)]):
            return int(i)
    return None


def pruned(search: Search, chosen: Sequence[int], level: float) -> list[int]:
    """Drop hypotheses that add nothing to the others, weakest first."""
    left = list(chosen)
    while len(left) > 1:
        values = [own_log_p(search, left, i) + search.hypotheses[i].choices for i in left]
        weakest = int(np.argmax(values))
        if values[weakest] <= level:
            break
        left.pop(weakest)
        left = borne(search, left)
    return left


def stand(search: Search, chosen: Sequence[int]) -> bool:
    """Whether chosen hypotheses are physical, and each reaches the naming threshold."""
    return possible(search, chosen) and all(
        own_log_p(search, chosen, i) + search.hypotheses[i].choices <= search.name for i in chosen)


def own_log_p(search: Search, chosen: Sequence[int], hypothesis: int) -> float:
    """Return the log p of one chosen hypothesis given the others, with what leans on it."""
    own = search.hypotheses[hypothesis]
    leaning = [j for j in chosen if search.hypotheses[j].leans == (own.kind, own.on)]
    columns = columns_of(search, (hypothesis, *chosen))
    place = {c: j for j, c in enumerate(columns)}
    others = columns_of(search, [j for j in chosen if j not in (hypothesis, *leaning)])
    rest = search.test.only(columns).given([place[c] for c in others])
    mine = [place[c] for c in columns_of(search, [hypothesis, *leaning])]
    square, rank = rest.explained(np.array([mine]))
    return float(log_p(square, rest.square, rank, rest.freedom)[0]) / own.caution


def _bearing(search: Search, leaning: int) -> list[int]:
    """Return what a hypothesis leans on, at its simplest, and itself; itself where it stands."""
    leans = search.hypotheses[leaning].leans
    if leans is None:
        return [leaning]
    there = [i for i, f in enumerate(search.hypotheses)
             if (f.kind, f.on) == leans and f.shared and not f.searched]
    return [*there[:1], leaning]


def _exchanged(search: Search, chosen: list[int], level: float) -> list[int]:
    """Replace hypotheses one for one while that lowers BIC, then grow and prune again."""
    for _ in range(3 * MOST_EFFECTS):
        better = _best_exchange(search, chosen, level)
        if better is None:
            break
        chosen = _grown(search, pruned(search, better, level), level)
    return chosen


def _best_exchange(search: Search, chosen: Sequence[int], level: float) -> list[int] | None:
    now = bic(search, chosen)
    best: tuple[float, list[int]] | None = None
    for hypothesis in chosen:
        others = [j for j in chosen if j != hypothesis]
        values = search.values(others)
        for i in np.argsort(values, kind="stable")[:12]:
            trial = [*others, int(i)]
            if int(i) in chosen or values[i] > level or not possible(search, trial):
                continue
            value = bic(search, trial)
            if value < now - BETTER and (best is None or value < best[0]):
                best = value, trial
    return None if best is None else best[1]


def doubtful(search: Search, chosen: Sequence[int], effect: int) -> bool:
    """Whether a chosen hypothesis may only imitate something.

    What the geometry nearly swallows looks like much that it is not, and so does a kind
    with a value of its own on every actuator, unless most of its values stand out one by
    one. Any other family that explains as much is then a rival, whatever parameters it takes.
    """
    hypothesis = search.hypotheses[effect]
    if search.test.survival(hypothesis.columns) < SWALLOWED:
        return True
    if hypothesis.shared:
        return False
    size = hypothesis.size // len(hypothesis.on)
    parts = [list(hypothesis.columns[a:a + size]) for a in range(0, hypothesis.size, size)]
    others = columns_of(search, [j for j in chosen if j != effect])
    significant = 0
    for part in parts:
        rest = search.test.given([*others, *(c for p in parts if p is not part for c in p)])
        square, rank = rest.explained(np.array([part]))
        significant += bool(log_p(square, rest.square, rank, rest.freedom)[0] < np.log(0.01))
    return significant < MOSTLY * len(parts)
