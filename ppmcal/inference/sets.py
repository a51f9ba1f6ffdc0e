"""Which blocks are in the data: the posterior over sets of blocks.

log p(H | y) = log Z(H) + log pi(H), for every correlation of the noise, summed over these.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ppmcal import linalg
from ppmcal.inference.block_sets import NEGLIGIBLE, BlockSet, Numbers
from ppmcal.inference.moves import MOST, SetSearch
from ppmcal.inference.priors import WITHIN
from ppmcal.inference.question import Question
from ppmcal.linalg import Array

Answer = frozenset[tuple[str, str]]
"""What may occupy a place: families, and what they act on."""
MOVES = 100
"""Maximum changes of the set; more would mean a cycle."""


@dataclass(frozen=True)
class Member:
    """A possible occupant of a place: its families, "" for none, and the most probable set with it.

    ``own``: the blocks of that set that occupy the place.
    """

    family: str
    probability: float
    chosen: Numbers
    own: Numbers


@dataclass(frozen=True, eq=False)
class SetPosterior:
    """The posterior over sets.

    The most probable set, and sets in which one of its blocks is replaced or missing, are counted
    individually. Further blocks are treated one by one: barely visible blocks are present or not
    independently of each other.

    Attributes:
        best: the most probable set.
        log_p: log probability of the counted sets, whatever further blocks are present.
        beside: log odds of each further block given the best set (B,).
        ended: whether the search was stopped before it reached a maximum.
    """

    best: BlockSet
    log_p: dict[Numbers, float]
    beside: Array
    ended: bool = False

    @cached_property
    def _beside(self) -> Array:
        """Probability of each further block given the best set (B,): at most one per family."""
        blocks = self.best.question.blocks
        families = {name: i for i, name in enumerate(dict.fromkeys(b.family for b in blocks))}
        home = np.array([families[b.family] for b in blocks], dtype=np.int64)
        odds = np.exp(np.minimum(self.beside, 700.0))
        total = np.bincount(home, odds, len(families))
        return np.asarray(odds / (1.0 + total[home]))

    @cached_property
    def probability(self) -> Array:
        """Probability that each block is in the data (B,)."""
        counted = np.zeros(len(self.best.question.blocks))
        for key, log_p in self.log_p.items():
            counted[list(key)] += np.exp(log_p)
        return np.asarray(np.minimum(counted + (1.0 - counted) * self._beside, 1.0))

    def nothing(self, beside: Container[str] = ()) -> float:
        """Return the probability that the data contain only geometry.

        ``beside``: families that do not count, such as outlying rows.
        """
        blocks = self.best.question.blocks
        of_family: dict[str, float] = defaultdict(float)
        for block, p in zip(blocks, self._beside, strict=True):
            of_family[block.family] += float(p) * (block.family not in beside)
        empty = sum(float(np.exp(log_p)) for key, log_p in self.log_p.items()
                    if all(blocks[i].family in beside for i in key))
        return empty * float(np.prod([1.0 - min(p, 1.0) for p in of_family.values()]))

    def families(self, place: int) -> dict[str, float]:
        """Return the probability of each family in a place, whatever it acts on, largest first.

        "" stands for none; several blocks in the place are reported together.
        """
        found: dict[str, float] = defaultdict(float)
        for member in self.members(place):
            found[member.family] = min(found[member.family] + member.probability, 1.0)
        return dict(sorted(found.items(), key=lambda f: -f[1]))

    def members(self, place: int) -> list[Member]:
        """Return the possible occupants of a place of the best set, most probable first.

        A member is a cause acting on something, at any grid value; acting elsewhere is another.
        """
        return list(self._members(place, self.log_p).values())

    def likely(self, place: int, mass: float) -> tuple[Member, ...]:
        """Return the members needed for a mass of the probability, most probable first.

        Including those needed if each family's prior were :data:`WITHIN` times larger or smaller: a
        member excluded only by its prior is kept.
        """
        needed = set[Answer]()
        for log_p in (self.log_p, *self._at_other_priors):
            total = 0.0
            for what, member in self._members(place, log_p).items():
                needed.add(what)
                total += member.probability
                if total >= mass:
                    break
        return tuple(member for what, member in self._members(place, self.log_p).items()
                     if what in needed)

    @cached_property
    def _what(self) -> tuple[tuple[str, str], ...]:
        """The family of each block, and what it acts on."""
        return tuple((b.family, b.where) for b in self.best.question.blocks)

    @cached_property
    def _at_other_priors(self) -> tuple[dict[Numbers, float], ...]:
        """Log probability of the sets with larger, and with smaller, priors of families."""
        prior, times = self.best.question.log_prior, float(np.log(float(WITHIN)))
        out = []
        for more_often in (times, -times):
            log_p = {key: p + prior(key, more_often) - prior(key) for key, p in self.log_p.items()}
            total = float(linalg.logsumexp(list(log_p.values())))
            out.append({key: p - total for key, p in log_p.items()})
        return tuple(out)

    def _members(self, place: int, log_p: Mapping[Numbers, float]) -> dict[Answer, Member]:
        """Return the possible occupants of a place, most probable first; ``log_p``: of sets."""
        found: dict[Answer, list[tuple[float, Numbers, Numbers]]] = defaultdict(list)
        for key, p in log_p.items():
            own = self._in_place(self.best.chosen[place], key)
            found[frozenset(self._what[i] for i in own)].append((p, key, own))
        members = {}
        for what, some in found.items():
            _, key, own = max(some, key=lambda o: o[0])
            members[what] = Member(
                " and ".join(sorted({family for family, _ in what})),
                min(float(np.exp(linalg.logsumexp([p for p, _, _ in some]))), 1.0), key, own)
        return dict(sorted(members.items(), key=lambda m: -m[1].probability))

    def _in_place(self, mine: int, key: Numbers) -> Numbers:
        """Return the blocks of a set that take the place of a block of the best set."""
        best, what = frozenset(self.best.chosen), self._what
        if mine in key:
            return frozenset({mine})
        alike = frozenset(i for i in key if what[i] == what[mine])
        if len(alike) >= sum(what[i] == what[mine] for i in best):
            return alike - best
        return frozenset(i for i in key - best if what[i][0] not in self.best.question.alone)


def posterior(question: Question, start: Sequence[int] = (),
              enough: Callable[[BlockSet], bool] | None = None,
              known: Sequence[Numbers] = (), beside: Sequence[Numbers] = ()) -> SetPosterior:
    """Return which blocks are in the data: search from a set, then evaluate neighbours of the best.

    Args:
        question: the possible blocks.
        start: the set at which the search begins, in addition to the empty set.
        enough: whether the search is to end at a set; called for each set reached.
        known: sets that were probable when a search of almost the same question ended at
            ``start``: from there only single moves are tried again.
        beside: sets of several blocks that belong together and that no single move reaches.
    """
    seen = SetSearch(question)
    best = seen.whole(seen.visit(()))
    if start:
        others = [seen.settle(tuple(sorted(key))) for key in known]
        best = seen.whole(max(best, seen.settle(tuple(start)), *others, key=lambda at: at.log_p))
    if beside:
        best = seen.whole(max(best, *(seen.settle(tuple(sorted(key))) for key in beside),
                              key=lambda at: at.log_p))
    for _ in range(MOVES):
        again = known and frozenset(best.chosen) == frozenset(start)
        better = None if enough is not None and enough(best) else (
            seen.better(best) or (None if again else seen.far(best)) or seen.overlooked(best))
        if better is None:
            break
        best = seen.whole(better)
    else:
        seen.left = 0
    mine = frozenset(best.chosen)
    rests = [seen.settle(tuple(j for j in best.chosen if j != i)) for i in best.causes]
    counted = _scored([*rests, *seen.scored], best)
    counted |= {key: at.log_p for key, at in seen.states.items()
                if at.log_p > best.log_p - NEGLIGIBLE or not key}
    # supersets of the best by one block are counted as further blocks only
    counted = {key: log_p for key, log_p in counted.items()
               if not (key > mine and len(key) == len(mine) + 1)}
    total = float(linalg.logsumexp(list(counted.values())))
    return SetPosterior(best, {key: log_p - total for key, log_p in counted.items()},
                        best.scores - best.log_p, seen.left <= 0 or len(best.causes) >= MOST)


def _scored(some: Iterable[BlockSet], best: BlockSet) -> dict[Numbers, float]:
    """Return the log probability of sets with one more block than those scored.

    For sets other than the best and its subsets, only blocks needed there: the rest counts as
    further blocks, as for the best.
    """
    found: dict[Numbers, float] = {}
    for at in some:
        key, least = frozenset(at.chosen), best.log_p - NEGLIGIBLE
        if not key < frozenset(best.chosen):
            least = max(least, at.log_p)
        scores = at.scores_above(least)
        for j in np.flatnonzero(scores > least).tolist():
            more = key | {j}
            found[more] = max(found.get(more, -np.inf), float(scores[j]))
    return found
