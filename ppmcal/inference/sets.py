"""Which blocks are in the data: the posterior over sets of them.

log p(H | y) = log Z(H) + log pi(H), for every correlation of the noise, and the sum over them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.special import logsumexp

from ppmcal import linalg
from ppmcal.inference.blocks import Batch, Block, batches
from ppmcal.inference.columns import ColumnSource
from ppmcal.inference.correlation import RowNoise, Whitened
from ppmcal.inference.evidence import odds_of_all
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import JointBlocks, joint
from ppmcal.inference.priors import CORRELATED, CORRELATIONS, FURTHER
from ppmcal.linalg import Array, Bools, Ints

NEGLIGIBLE = 14.0
"""Sets less likely than the best by this logarithm are not counted: less than one in a million."""
CLOSE = 8.0
"""Sets that are so much less likely than the best are looked at for every correlation."""
MOST = 40
"""Blocks in a set at most, rows that do not belong among them."""
MOVES = 100
"""Changes of the set at most; more would be a circle."""

DEEP = 3
"""Blocks that take the place of one at most."""
MOST_FORMS = 6
"""Forms of blocks that are tried in the place of several."""
LEAST_GAIN = 1e-6
"""A set is likelier by more than round-off."""

Numbers = frozenset[int]
"""A set of blocks, by their numbers."""


@dataclass(frozen=True, eq=False)
class NoiseView:
    """The data as they are for one correlation of the noise."""

    log_prior: float
    start: Conditioned
    blocks: tuple[Block, ...]

    @cached_property
    def batches(self) -> tuple[Batch, ...]:
        """The blocks of one shape each together."""
        return tuple(batches(self.blocks, self.start.columns, self.start.count))

    @cached_property
    def events(self) -> dict[str, Array]:
        """Inner products of the columns of each group's events, (E k, E k)."""
        return {}


@dataclass(frozen=True, eq=False)
class Question:
    """Values, geometry, and the blocks that may be in the data beside it.

    Attributes:
        columns: white for noise without correlation (T).
        values: y (n,), zero where ``observed`` (N, m) is not.
        geometry: Jacobian times the root of its prior (n, c).
        apart: rows from each to the next (N - 1,), 0 where another sequence begins.
        alone: families of which none stands for several others: rows that do not belong.
    """

    columns: ColumnSource
    values: Array
    geometry: Array
    blocks: tuple[Block, ...]
    observed: Bools
    apart: Ints
    alone: frozenset[str] = frozenset()

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
        return NoiseView(log_prior - noise.log_det, start, self.blocks)

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """The blocks of each group."""
        out: dict[str, list[int]] = defaultdict(list)
        for i, block in enumerate(self.blocks):
            if block.group:
                out[block.group].append(i)
        return out

    @cached_property
    def parts(self) -> dict[int, list[int]]:
        """Of each block those of its family, in a group, that have some of its columns each."""
        with_column: dict[tuple[str, int], set[int]] = defaultdict(set)
        for i in chain(*self.groups.values()):
            for c in self.blocks[i].columns:
                with_column[self.blocks[i].family, c].add(i)
        found = {i: set[int]().union(*(with_column.get((b.family, c), ()) for c in b.columns))
                 for i, b in enumerate(self.blocks) if not b.group and len(b.columns) > 1}
        return {i: sorted(j for j in some
                          if set(self.blocks[j].columns) < set(self.blocks[i].columns))
                for i, some in found.items() if some}

    @cached_property
    def _of_group(self) -> dict[str, float]:
        """Log prior of each group: that one of its blocks is there."""
        return {group: float(logsumexp([self.blocks[i].log_prior for i in own]))
                for group, own in self.groups.items()}

    @cached_property
    def _places(self) -> dict[str, int]:
        """How many groups each family has."""
        found: dict[str, set[str]] = defaultdict(set)
        for block in self.blocks:
            if block.group:
                found[block.family].add(block.group)
        return {family: len(groups) for family, groups in found.items()}

    def _further(self, i: int, there: Iterable[int]) -> float:
        """Return the log prior of block i beside others: of a group, one more costs less."""
        block = self.blocks[i]
        like = [j for j in there if self.blocks[j].group and (
            self.blocks[j].family == block.family or self.blocks[j].group == block.group)]
        if not block.group or not like:
            return block.log_prior
        count = len(self.groups[block.group])
        same = sum(self.blocks[j].group == block.group for j in like)
        # any m of n are as likely as any others, in whatever order they are told
        more = (np.log(float(FURTHER) * (len(like) + 1) * count / (count - same))
                + block.log_prior - self._of_group[block.group])
        if not same:
            more -= np.log(self._places[block.family])
        return float(max(block.log_prior, more))

    def log_prior(self, chosen: Iterable[int]) -> float:
        """Return the log prior of a set, whatever its order, as if what it needs were there."""
        total, there = 0.0, list[int]()
        for i in sorted(chosen, key=lambda i: (
                -self.blocks[i].log_prior, len(self.groups.get(self.blocks[i].group, ())), i)):
            total += self._further(i, there)
            there.append(i)
        return total

    @cached_property
    def _each(self) -> Array:
        """Log prior of each block by itself (B,)."""
        return np.array([b.log_prior for b in self.blocks], dtype=float)

    def more(self, chosen: Sequence[int]) -> Array:
        """Return the log prior of a set with each block more, less that of the set (B,)."""
        out, base = self._each.copy(), self.log_prior(chosen)
        families = {self.blocks[i].family for i in chosen if self.blocks[i].group}
        groups = {self.blocks[i].group for i in chosen} - {""}
        for group, own in self.groups.items():
            if group in groups or self.blocks[own[0]].family in families:
                out[own] = [self.log_prior((*chosen, i)) - base for i in own]
        return out

    @cached_property
    def _leaning(self) -> tuple[Ints, Ints]:
        """What each block needs and gives (B,), by number; 0: nothing."""
        names = ["", *sorted({b.needs for b in self.blocks} - {""})]
        place = {name: n for n, name in enumerate(names)}
        return (np.array([place[b.needs] for b in self.blocks], dtype=np.int64),
                np.array([place.get(b.gives, 0) for b in self.blocks], dtype=np.int64))

    def complete(self, chosen: Sequence[int]) -> bool:
        """Whether a set has all that its blocks need."""
        needs, gives = self._leaning
        own = list(chosen)
        return not set(needs[own].tolist()) - {0, *gives[own].tolist()}

    def completes(self, chosen: Sequence[int]) -> Bools:
        """Whether a set has all that its blocks need with each block more (B,)."""
        needs, gives = self._leaning
        there = {0, *gives[list(chosen)].tolist()}
        lack = set(needs[list(chosen)].tolist()) - there
        able = np.isin(needs, list(there)) | (needs == gives)
        if lack:
            able &= (gives == min(lack)) & (len(lack) == 1)
        return np.asarray(able)


@dataclass(frozen=True, eq=False)
class BlockSet:
    """A set of blocks as it is in the data.

    ``views``: for each correlation that is likely its number, log p and blocks' sizes, as if what
    they need were there; ``log_p``: -inf where it is not.
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
        """Log p of the set with each block more (B,); -inf for those that are in it.

        And for those with which something that is needed is not there.
        """
        question = self.question
        count = len(question.blocks)
        every = np.array([log_p + odds_of_all(given, view.batches, count)
                          for view, log_p, given in self.given])
        out = np.where(question.completes(self.chosen),
                       logsumexp(every, axis=0) + question.more(self.chosen), -np.inf)
        out[list(self.chosen)] = -np.inf
        return out


def state(question: Question, chosen: Sequence[int], likely: Sequence[int] = (),
          near: Mapping[int, tuple[int, int]] | None = None) -> BlockSet:
    """Return a set of blocks in the data.

    Smaller correlations than those that are likely with it are kept too: with one block more in the
    data, less is left that goes on from row to row.

    Args:
        question: what may be there.
        chosen: numbers of the blocks.
        likely: numbers of the correlations, default all.
        near: of each block's size and root, from which the search for the likeliest starts.
    """
    start = [(near or {}).get(i) for i in chosen]
    blocks = [question.blocks[i] for i in chosen]
    prior = question.log_prior(chosen)
    found = [(n, joint(question.views[n].start, blocks, start))
             for n in likely or range(len(question.views))]
    each = [question.views[n].log_prior + j.log_evidence for n, j in found]
    most = max(n for (n, _), log_z in zip(found, each, strict=True)
               if log_z > max(each) - NEGLIGIBLE)
    views = tuple((n, log_z + prior, j) for (n, j), log_z in zip(found, each, strict=True)
                  if n <= most)
    log_p = float(logsumexp(each)) + prior if question.complete(chosen) else -np.inf
    return BlockSet(question, tuple(chosen), log_p, views)


@dataclass(frozen=True)
class Member:
    """What may be in a place: a family, "" of nothing, and the likeliest set in which it is."""

    family: str
    probability: float
    chosen: Numbers


@dataclass(frozen=True, eq=False)
class SetPosterior:
    """What is in the data.

    The likeliest set, and those where one of its blocks is another, or missing, are counted one by
    one. What else may be there beside them is taken block by block: what is hardly seen is there or
    not, whatever else is hardly seen.

    Attributes:
        best: the likeliest set.
        log_p: log probability of the sets that were counted, whatever is beside them.
        beside: log odds of each block beside the best set (B,).
    """

    best: BlockSet
    log_p: dict[Numbers, float]
    beside: Array

    @cached_property
    def _beside(self) -> Array:
        """Probability of each block beside the best set (B,): of one family one, or none."""
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
        """Return the probability of each family in a place, largest first.

        "" is of nothing; where other sets have several in its place, these are told together.
        """
        return {m.family: m.probability for m in self.members(place)}

    def members(self, place: int) -> list[Member]:
        """Return what may be in a place of the best set, likeliest first."""
        question = self.best.question
        mine, best = self.best.chosen[place], frozenset(self.best.chosen)
        found: dict[str, list[tuple[float, Numbers]]] = defaultdict(list)
        for key, log_p in self.log_p.items():
            other = {question.blocks[i].family for i in key - best} - question.alone
            family = question.blocks[mine].family if mine in key else " and ".join(sorted(other))
            found[family].append((log_p, key))
        members = [Member(family, float(np.exp(logsumexp([p for p, _ in own]))),
                          max(own, key=lambda o: o[0])[1]) for family, own in found.items()]
        return sorted(members, key=lambda m: -m.probability)


def posterior(question: Question) -> SetPosterior:
    """Return which blocks are in the data: search from nothing, then what is near the best."""
    seen = _Visited(question)
    best = seen.whole(seen.visit(()))
    for _ in range(MOVES):
        better = seen.better(best) or seen.overlooked(best)
        if better is None:
            break
        best = seen.whole(better)
    for i in best.chosen:
        if question.blocks[i].family in question.alone:
            continue
        rest = seen.settle(tuple(j for j in best.chosen if j != i))
        key = frozenset(rest.chosen)
        for j in np.flatnonzero(rest.scores > best.log_p - NEGLIGIBLE).tolist():
            seen.nearby.setdefault(key | {j}, float(rest.scores[j]))
    counted = {key: at.log_p for key, at in seen.states.items()
               if at.log_p > best.log_p - NEGLIGIBLE or not key}
    mine = frozenset(best.chosen)       # what is beside it is counted there, and once
    counted = {key: log_p for key, log_p in (seen.nearby | counted).items()
               if not (key > mine and len(key) == len(mine) + 1)}
    total = float(logsumexp(list(counted.values())))
    return SetPosterior(best, {key: log_p - total for key, log_p in counted.items()},
                        best.scores - best.log_p)


class _Visited:
    """Sets that the search has come to."""

    def __init__(self, question: Question) -> None:
        self.question = question
        self.states: dict[Numbers, BlockSet] = {}
        self.nearby: dict[Numbers, float] = {}
        self.settled = set[Numbers]()
        self.near: dict[int, tuple[int, int]] = {}
        self.likely: list[int] = []

    def visit(self, chosen: tuple[int, ...]) -> BlockSet:
        """Return a set, which is looked at once, for the correlations that are likely now."""
        key = frozenset(chosen)
        if key not in self.states:
            self.states[key] = state(self.question, chosen, self.likely, self.near)
        return self.states[key]

    def settle(self, chosen: tuple[int, ...]) -> BlockSet:
        """Return a set for every correlation."""
        key = frozenset(chosen)
        if key not in self.settled:
            self.states[key] = state(self.question, chosen, (), self.near)
            self.settled.add(key)
        return self.states[key]

    def overlooked(self, now: BlockSet) -> BlockSet | None:
        """Return a set that is likelier once every correlation counts, None where there is none."""
        close = [at for key, at in self.states.items()
                 if key not in self.settled and at.log_p > now.log_p - CLOSE]
        best = max((self.settle(at.chosen) for at in close), key=lambda at: at.log_p, default=now)
        return best if best.log_p > now.log_p + LEAST_GAIN else None

    def whole(self, found: BlockSet) -> BlockSet:
        """Return a set for every correlation; those that are likely with it are from now on."""
        found = self.settle(found.chosen)
        _, _, sized = max(found.views, key=lambda view: view[1])
        self.near |= {i: (int(size), int(root)) for i, size, root in
                      zip(found.chosen, sized.sizes, sized.grid, strict=True)}
        if (likely := [n for n, _, _ in found.views]) != self.likely:
            self.likely = likely
            self.states = {k: v for k, v in self.states.items() if k in self.settled}
        return found

    def better(self, now: BlockSet) -> BlockSet | None:
        """Return a set that is likelier and one move away, None where there is none.

        One more is tried first; then each in turn gone, or another in its place; then what a
        single step does not come to: many rows at once, several in the place of one, one in the
        place of several, two events at once.
        """
        if len(now.chosen) < MOST:
            more = self._likelier(now, [self._best(now)])
            if more is not None:
                return self._with_others(now, more)
        moves: list[tuple[float, tuple[int, ...]]] = []
        for i in now.chosen:
            rest = self.settle(tuple(j for j in now.chosen if j != i))
            moves.append((rest.log_p, rest.chosen))
            if self.question.blocks[i].family not in self.question.alone:
                moves.append(self._best(rest))
        found = self._likelier(now, moves)
        if found is not None:
            return found
        for far in chain(self._masked(now), self._parted(now), self._split(now),
                         self._merged(now), self._pairs(now, now.log_p)):
            if far.log_p > now.log_p + LEAST_GAIN:
                return far
        return None

    def _with_others(self, now: BlockSet, more: BlockSet) -> BlockSet:
        """Return a set with one more that stands alone, and the likelier half of all of its kind.

        Rows that do not belong are many at times; each is looked at again by itself.
        """
        question = self.question
        if question.blocks[more.chosen[-1]].family not in question.alone:
            return more
        gains = now.scores - now.log_p
        rows = [i for i in np.argsort(-gains).tolist() if gains[i] > 0.0
                and question.blocks[i].family in question.alone]
        many = self.visit((*now.chosen, *rows[:min(len(rows) // 2 + 1, MOST - len(now.chosen))]))
        return many if many.log_p > more.log_p else more

    def _masked(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with twice as many more each time of those that stand alone.

        Where many rows do not belong, none is likelier by itself: the others are noise to it. With
        each that is there the next costs less; where it costs more, there are no others.
        """
        blocks = self.question.blocks
        rows = [i for i in np.argsort(-now.scores).tolist()
                if blocks[i].family in self.question.alone and i not in now.chosen]
        last, each, count = now, -np.inf, 2
        while count <= min(len(rows), MOST - len(now.chosen)):
            at = self.visit((*now.chosen, *rows[:count]))
            yield at
            gain = (at.log_p - last.log_p) / (len(at.chosen) - len(last.chosen))
            if gain < each:
                return
            last, each, count = at, gain, 2 * count

    def _parted(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with parts of one block in its place, those first that it needs most.

        What all joints have a value of their own for, perhaps two of them have.
        """
        blocks, log_z = self.question.blocks, [log_p for _, log_p, _ in now.views]
        sized = now.views[int(np.argmax(log_z))][2]
        for n, i in enumerate(now.chosen):
            mine = {c: k for k, c in enumerate(blocks[i].columns)}
            parts = list(self.question.parts.get(i, ()))
            sure = np.abs(sized.values[n]) / np.maximum(sized.sigmas[n], 1e-300)
            parts.sort(key=lambda j: -max(sure[mine[c]] for c in blocks[j].columns))
            rest = tuple(j for j in now.chosen if j != i)
            for count in range(1, len(parts)):
                yield self.visit((*rest, *parts[:count]))

    def _split(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with one block gone, and others, of other families, in its place."""
        blocks = self.question.blocks
        for i in now.chosen:
            if blocks[i].family in self.question.alone:
                continue
            at = self.settle(tuple(j for j in now.chosen if j != i))
            gone = np.array([b.family == blocks[i].family for b in blocks])
            for _ in range(DEEP):
                log_p, chosen = self._best(at, gone)
                if log_p <= at.log_p:
                    break
                at = self.visit(chosen)
                yield at
            yield from self._pairs(self.settle(tuple(j for j in now.chosen if j != i)), now.log_p)

    def _merged(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with one more block, and without those that are not needed beside it.

        What explains most by itself, and most beside what is there.
        """
        if sum(self.question.blocks[i].family not in self.question.alone for i in now.chosen) < 2:
            return
        tried = dict.fromkeys((*self._strongest(self.visit(()).scores, now),
                               *self._strongest(now.scores, now)))
        for i in tried:
            yield self._pruned(self.visit((*now.chosen, i)), i)

    def _strongest(self, scores: Array, now: BlockSet) -> list[int]:
        """Return the likeliest block of each of a few forms, those that are there left out."""
        blocks, found = self.question.blocks, dict[str, int]()
        for i in np.argsort(-scores).tolist():
            form = blocks[i].form or blocks[i].family
            if i not in now.chosen and blocks[i].family not in self.question.alone:
                found.setdefault(form, i)
            if len(found) == MOST_FORMS:
                break
        return list(found.values())

    def _pruned(self, at: BlockSet, held: int) -> BlockSet:
        """Return the likeliest of a set and those with less, ``held`` in all of them."""
        while True:
            fewer = [self.visit(tuple(j for j in at.chosen if j != k)) for k in at.chosen
                     if k != held and self.question.blocks[k].family not in self.question.alone]
            best = max(fewer, key=lambda s: s.log_p, default=at)
            if best.log_p <= at.log_p:
                return at
            at = best

    def _pairs(self, at: BlockSet, least: float) -> Iterator[BlockSet]:
        """Yield sets with two events of one group more that may be likelier than ``least``."""
        parts = {i for own in self.question.parts.values() for i in own}
        for group, every in self.question.groups.items():
            # parts of another block are come to from there, one by one
            free = [i for i in every if i not in at.chosen and i not in parts]
            if len(free) > 1:
                i, j, most = self._likeliest_pair(at, group, free)
                prior = (self.question.log_prior((*at.chosen, i, j))
                         - self.question.log_prior(at.chosen))
                if at.log_p + most + prior > least:
                    yield self.visit((*at.chosen, i, j))

    def _likeliest_pair(self, at: BlockSet, group: str, free: Sequence[int]
                        ) -> tuple[int, int, float]:
        """Return the two events whose columns explain most, and how much likelier at most."""
        view, _, given = max(at.given, key=lambda g: g[1])
        columns = np.array([self.question.blocks[i].columns for i in free])   # (E, k)
        whole = self.question.groups[group]
        if group not in view.events:
            values = given.columns.some([c for i in whole for c in self.question.blocks[i].columns])
            view.events[group] = values.T @ values
        width, places = columns.shape[1], {i: n for n, i in enumerate(whole)}
        own = np.concatenate([np.arange(width) + places[i] * width for i in free])
        seen = given.seen[columns.ravel()]
        gram = (view.events[group][np.ix_(own, own)] - seen @ seen.T).reshape(
            *columns.shape, *columns.shape)
        right, each = given.right[columns], np.arange(len(free))
        alone = gram[each, :, each]
        first, second = np.triu_indices(len(free), 1)
        block = np.concatenate([
            np.concatenate([alone[first], gram[first, :, second]], axis=2),
            np.concatenate([gram[second, :, first], alone[second]], axis=2)], axis=1)
        wanted = np.concatenate([right[first], right[second]], axis=1)
        ridge = 1e-6 * np.trace(block, axis1=1, axis2=2)[:, None, None] + 1e-300
        found = linalg.solve_blocks(block + ridge * np.eye(2 * width), wanted[..., None])[..., 0]
        gains = np.sum(found * wanted, axis=1)
        best = int(np.argmax(gains))
        left = max(1.0 - float(gains[best]) / given.spread, 1e-9)
        return free[first[best]], free[second[best]], -0.5 * given.freedom * float(np.log(left))

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
    def _best(at: BlockSet, gone: Bools | None = None) -> tuple[float, tuple[int, ...]]:
        """Return the likeliest set with one block more, none of those ``gone``."""
        if not at.scores.size:
            return -np.inf, at.chosen
        scores = at.scores if gone is None else np.where(gone, -np.inf, at.scores)
        i = int(np.argmax(scores))
        return float(scores[i]), (*at.chosen, i)
