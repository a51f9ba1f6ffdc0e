"""Which blocks are in the data: the posterior over sets of them.

log p(H | y) = log Z(H) + log pi(H), for every correlation of the noise, and the sum over them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from ppmcal.inference.blocks import Batch, Block, batches
from ppmcal.inference.columns import ColumnSource
from ppmcal.inference.correlation import RowNoise, Whitened
from ppmcal.inference.evidence import odds_of_all
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import JointBlocks, joint
from ppmcal.inference.priors import CORRELATED, CORRELATIONS, FURTHER_EVENT
from ppmcal.linalg import Array, Bools, Ints

NEGLIGIBLE = 14.0
"""Sets less likely than the best by this logarithm are not counted: less than one in a million."""
MOST = 40
"""Blocks in a set at most, rows that do not belong among them."""
MOVES = 100
"""Changes of the set at most; more would be a circle."""

Numbers = frozenset[int]
"""A set of blocks, by their numbers."""


@dataclass(frozen=True, eq=False)
class NoiseView:
    """The data as they are for one correlation of the noise."""

    log_prior: float
    start: Conditioned
    batches: tuple[Batch, ...]


@dataclass(frozen=True, eq=False)
class Question:
    """Values, geometry, and the blocks that may be in the data beside it.

    Attributes:
        columns: white for noise without correlation (T).
        values: y (n,), zero where ``observed`` (N, m) is not.
        geometry: Jacobian times the root of its prior (n, c).
        apart: rows from each to the next (N - 1,), 0 where another sequence begins.
    """

    columns: ColumnSource
    values: Array
    geometry: Array
    blocks: tuple[Block, ...]
    observed: Bools
    apart: Ints

    @cached_property
    def views(self) -> tuple[NoiseView, ...]:
        """The data for every correlation."""
        rhos = (0.0, *CORRELATIONS) if self.apart.any() else (0.0,)
        return tuple(self._view(rho, self._log_prior(rho, len(rhos) - 1)) for rho in rhos)

    @staticmethod
    def _log_prior(rho: float, others: int) -> float:
        if not others:
            return 0.0
        share = float(CORRELATED) / others if rho else 1.0 - float(CORRELATED)
        return float(np.log(share))

    def _view(self, rho: float, log_prior: float) -> NoiseView:
        noise = RowNoise(rho, self.apart, self.observed)
        columns = Whitened(self.columns, noise) if rho else self.columns
        count = int(self.observed.sum())
        values = noise.apply(self.values[:, None])[:, 0]
        start = Conditioned.nothing(columns, values, count).taking(noise.apply(self.geometry))
        return NoiseView(log_prior - noise.log_det, start,
                    tuple(batches(self.blocks, columns, count)))

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """The blocks of each group of events."""
        out: dict[str, list[int]] = defaultdict(list)
        for i, block in enumerate(self.blocks):
            if block.group:
                out[block.group].append(i)
        return out

    @cached_property
    def _places(self) -> dict[str, int]:
        """How many groups each family has."""
        found: dict[str, set[str]] = defaultdict(set)
        for block in self.blocks:
            if block.group:
                found[block.family].add(block.group)
        return {family: len(groups) for family, groups in found.items()}

    def further(self, i: int, there: Iterable[int]) -> float:
        """Return the log prior of block i beside others: of an event, one more costs less."""
        block = self.blocks[i]
        groups = {self.blocks[j].group for j in there if self.blocks[j].family == block.family}
        groups.discard("")
        if not block.group or not groups:
            return block.log_prior
        more = float(np.log(float(FURTHER_EVENT))) - np.log(len(self.groups[block.group]))
        if block.group not in groups:
            more -= np.log(self._places[block.family])
        return float(max(block.log_prior, more))

    def log_prior(self, chosen: Iterable[int]) -> float:
        """Return the log prior of a set, whatever its order."""
        total, there = 0.0, list[int]()
        for i in sorted(chosen, key=lambda i: (-self.blocks[i].log_prior, i)):
            total += self.further(i, there)
            there.append(i)
        return total


@dataclass(frozen=True, eq=False)
class BlockSet:
    """A set of blocks as it is in the data.

    ``views``: for each correlation that is likely its number, log p and blocks' sizes.
    """

    question: Question
    chosen: tuple[int, ...]
    log_p: float
    views: tuple[tuple[int, float, JointBlocks], ...] = field(repr=False)

    @cached_property
    def given(self) -> tuple[tuple[NoiseView, float, Conditioned], ...]:
        """For each likely correlation: what the values are past the set, and its log p."""
        return tuple((view, log_p, view.start.taking(found.taken)) for n, log_p, found in self.views
                     for view in (self.question.views[n],))

    @cached_property
    def scores(self) -> Array:
        """Log p of the set with each block more (B,); -inf for those that are in it."""
        question = self.question
        count = len(question.blocks)
        every = np.array([log_p + odds_of_all(given, view.batches, count)
                          for view, log_p, given in self.given])
        more = np.array([question.further(i, self.chosen) for i in range(count)])
        out = np.asarray(logsumexp(every, axis=0) + more)
        out[list(self.chosen)] = -np.inf
        return out


def state(question: Question, chosen: Sequence[int]) -> BlockSet:
    """Return a set of blocks in the data."""
    blocks = [question.blocks[i] for i in chosen]
    prior = question.log_prior(chosen)
    found = [(n, joint(view.start, blocks)) for n, view in enumerate(question.views)]
    each = [question.views[n].log_prior + j.log_evidence + prior for n, j in found]
    views = tuple((n, log_p, j) for (n, j), log_p in zip(found, each, strict=True)
                  if log_p > max(each) - NEGLIGIBLE)
    return BlockSet(question, tuple(chosen), float(logsumexp(each)), views)


@dataclass(frozen=True, eq=False)
class SetPosterior:
    """What is in the data.

    The likeliest set, and those where one of its blocks is another, or missing, are counted one by
    one. What else may be there beside them is taken block by block: what is hardly seen is there or
    not, whatever else is hardly seen.

    Attributes:
        best: the likeliest set.
        log_p: log probability of the sets that were counted, whatever is beside them.
        places: for each of the best set's blocks, log probability of every block in its place, and
            last of nothing there (B + 1,).
        beside: log odds of each block beside the best set (B,).
    """

    best: BlockSet
    log_p: dict[Numbers, float]
    places: tuple[Array, ...]
    beside: Array

    @cached_property
    def _beside(self) -> Array:
        """Probability of each block beside the best set (B,): of one family one, or none."""
        blocks = self.best.question.blocks
        families = {name: i for i, name in enumerate(dict.fromkeys(b.family for b in blocks))}
        home = np.array([families[b.family] for b in blocks])
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
        """Return the probability that nothing is in the data beside the geometry.

        ``beside``: families that do not count, rows that do not belong.
        """
        blocks = self.best.question.blocks
        of_family: dict[str, float] = defaultdict(float)
        for block, p in zip(blocks, self._beside, strict=True):
            of_family[block.family] += float(p) * (block.family not in beside)
        empty = sum(float(np.exp(log_p)) for key, log_p in self.log_p.items()
                    if all(blocks[i].family in beside for i in key))
        return empty * float(np.prod([1.0 - min(p, 1.0) for p in of_family.values()]))

    def families(self, place: int) -> dict[str, float]:
        """Return the probability of each family in a place, largest first; "" of nothing."""
        out: dict[str, float] = defaultdict(float)
        blocks = self.best.question.blocks
        for name, p in zip([*(b.family for b in blocks), ""], np.exp(self.places[place]),
                           strict=True):
            out[name] += float(p)
        return dict(sorted(out.items(), key=lambda item: -item[1]))


def posterior(question: Question) -> SetPosterior:
    """Return which blocks are in the data: search from nothing, then what is near the best."""
    seen = _Visited(question)
    best = seen.visit(())
    for _ in range(MOVES):
        better = seen.better(best)
        if better is None:
            break
        best = better
    counted, places = {frozenset(best.chosen): best.log_p}, []
    for i in best.chosen:
        rest = seen.visit(tuple(j for j in best.chosen if j != i))
        every = np.append(rest.scores, rest.log_p)
        every[i] = best.log_p
        places.append(every - logsumexp(every))
        key = frozenset(rest.chosen)
        counted[key] = rest.log_p
        for j in np.flatnonzero(rest.scores > best.log_p - NEGLIGIBLE).tolist():
            counted.setdefault(key | {j}, float(rest.scores[j]))
    total = float(logsumexp(list(counted.values())))
    return SetPosterior(best, {key: log_p - total for key, log_p in counted.items()}, tuple(places),
                     best.scores - best.log_p)


class _Visited:
    """Sets that the search has come to."""

    def __init__(self, question: Question) -> None:
        self.question = question
        self.states: dict[Numbers, BlockSet] = {}

    def visit(self, chosen: tuple[int, ...]) -> BlockSet:
        """Return a set, which is looked at once."""
        key = frozenset(chosen)
        if key not in self.states:
            self.states[key] = state(self.question, chosen)
        return self.states[key]

    def better(self, now: BlockSet) -> BlockSet | None:
        """Return a set that is likelier and one move away, None where there is none.

        One more is tried first, then each in turn gone, or another in its place.
        """
        if len(now.chosen) < MOST:
            more = self._likelier(now, [self._best(now)])
            if more is not None:
                return more
        moves: list[tuple[float, tuple[int, ...]]] = []
        for i in now.chosen:
            rest = self.visit(tuple(j for j in now.chosen if j != i))
            moves += [(rest.log_p, rest.chosen), self._best(rest)]
        return self._likelier(now, moves)

    def _likelier(self, now: BlockSet, moves: Iterable[tuple[float, tuple[int, ...]]]
                  ) -> BlockSet | None:
        """Return the first of the moves, likeliest first, that holds once sizes are chosen anew."""
        for log_p, chosen in sorted(moves, reverse=True):
            if log_p <= now.log_p:
                return None
            found = self.visit(chosen)
            if found.log_p > now.log_p:
                return found
        return None

    @staticmethod
    def _best(at: BlockSet) -> tuple[float, tuple[int, ...]]:
        if not at.scores.size:
            return -np.inf, at.chosen
        i = int(np.argmax(at.scores))
        return float(at.scores[i]), (*at.chosen, i)
