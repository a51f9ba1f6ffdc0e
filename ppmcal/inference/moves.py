"""The search for the most probable set of blocks: from each set to a more probable neighbour."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, combinations

import numpy as np

from ppmcal import linalg
from ppmcal.inference.block_sets import NEGLIGIBLE, BlockSet, Numbers, state
from ppmcal.inference.pairs import Events
from ppmcal.inference.priors import MOST_GROSS
from ppmcal.inference.question import Question
from ppmcal.inference.ranges import LEAST, SIZES
from ppmcal.linalg import Array, Bools

CLOSE = 8.0
"""Sets whose log probability is within this of the best are evaluated for every correlation."""
SETS = 3000
"""Most sets evaluated: several times what any converging search needs."""
MOST = 40
"""Most causes in a set."""
DEEP = 3
"""Most blocks that replace one."""
FIRSTS = 3
"""Forms of blocks with which a replacement of one may begin, after the first only if close."""
MOST_FORMS = 6
"""Forms of blocks that are tried as replacement of several."""
LEAST_GAIN = 1e-6
"""A more probable set has to gain more log probability than this round-off."""


class SetSearch:
    """Sets visited by the search; ``left``: how many more it may evaluate."""

    def __init__(self, question: Question) -> None:
        self.question = question
        self.left = SETS
        self.states: dict[Numbers, BlockSet] = {}
        self.settled = set[Numbers]()
        self.replaced: list[BlockSet] = []
        self.near: dict[int, tuple[int, int]] = {}
        self.rows: dict[Numbers, dict[int, int]] = {}
        self.likely: list[int] = []
        self.best: tuple[Numbers, float] = (frozenset(), -np.inf)

    def visit(self, chosen: tuple[int, ...]) -> BlockSet:
        """Return a set, evaluated once, for the correlations that are probable now."""
        key = frozenset(chosen)
        if key not in self.states:
            if len(self.likely) == len(self.question.views):
                return self.settle(chosen)
            self.states[key] = self._state(chosen, self.likely)
        return self.states[key]

    def settle(self, chosen: tuple[int, ...]) -> BlockSet:
        """Return a set evaluated for every correlation."""
        key = frozenset(chosen)
        if key not in self.settled:
            self.replaced += [self.states[key]] if key in self.states else []
            self.states[key] = self._state(chosen, ())
            self.settled.add(key)
        return self.states[key]

    @property
    def scored(self) -> list[BlockSet]:
        """Sets with known scores for adding each block."""
        return [at for at in (*self.states.values(), *self.replaced) if at.scored]

    def _state(self, chosen: tuple[int, ...], likely: Sequence[int]) -> BlockSet:
        """Return a set; the sizes of its rows are the start of the search in other sets."""
        self.left -= 1
        out = frozenset(self.question.apart_from_rows(chosen)[1])
        near = max((k for k in self.rows if k <= out), key=len, default=out)
        at = state(self.question, chosen, likely, self.near, self.rows.get(near))
        self.rows[out] = {i: row.size for i, row in at.rows.items()}
        return at

    def overlooked(self, now: BlockSet) -> BlockSet | None:
        """Return a set that is more probable over all correlations, None if there is none."""
        close = [at for key, at in self.states.items()
                 if key not in self.settled and at.log_p > now.log_p - CLOSE]
        best = max((self.settle(at.chosen) for at in close), key=lambda at: at.log_p, default=now)
        return best if best.log_p > now.log_p + LEAST_GAIN else None

    def whole(self, found: BlockSet) -> BlockSet:
        """Return a set for every correlation; those probable with it are used from now on."""
        found = self.settle(found.chosen)
        self.best = frozenset(found.chosen), found.log_p
        sized = found.likeliest[2]
        self.near |= {i: (int(size), int(root)) for i, size, root in
                      zip(found.causes, sized.sizes, sized.grid, strict=True)}
        if (likely := [n for n, _, _ in found.views]) != self.likely:
            self.likely = likely
            self.replaced += [v for k, v in self.states.items() if k not in self.settled]
            self.states = {k: v for k, v in self.states.items() if k in self.settled}
        return found

    def better(self, now: BlockSet) -> BlockSet | None:
        """Return a more probable set that is one move away, None if there is none.

        Adding a block is tried first; then removing each in turn, or replacing it.
        """
        if self.left <= 0:
            return None
        if len(now.causes) < MOST:
            more = self._likelier(now, [self._best(now, self._full(now))])
            if more is not None:
                return self._with_others(now, more)
        moves: list[tuple[float, tuple[int, ...]]] = []
        for i in now.chosen:
            rest = tuple(j for j in now.chosen if j != i)
            if i in now.rows:
                gain = now.rows[i].log_odds + self.question.blocks[i].log_prior
                moves.append((now.log_p - gain, rest))
                continue
            at = self.settle(rest)
            moves += [(at.log_p, rest), self._best(at, self._full(at))]
        return self._likelier(now, moves)

    def far(self, now: BlockSet) -> BlockSet | None:
        """Return a more probable set that is more than one move away, None if there is none.

        Many rows at once, a block with one that it requires, parts or several replacing one, one
        replacing several, two events at once, added or replacing two others.
        """
        for far in chain(self._masked(now), self._leaning(now), self._parted(now), self._whole(now),
                         self._reshaped(now), self._split(now), self._merged(now),
                         self._renamed(now), self._pairs(now, now.log_p)):
            if far.log_p > now.log_p + LEAST_GAIN:
                return far
            if self.left <= 0:
                break
        return None

    def _room(self, now: BlockSet) -> int:
        """Return how many more rows may be outliers."""
        return max(int(float(MOST_GROSS) * len(self.question.observed)) - len(now.rows), 0)

    def _full(self, now: BlockSet) -> Bools | None:
        """Return which blocks cannot be added because outlying rows are at their limit (B,)."""
        if self._room(now):
            return None
        return np.array([b.family in self.question.alone for b in self.question.blocks])

    def _with_others(self, now: BlockSet, more: BlockSet) -> BlockSet:
        """Return a set to which a row was added, extended by the more probable half of such rows.

        There may be many outlying rows; each is reconsidered individually later.
        """
        question = self.question
        if question.blocks[more.chosen[-1]].family not in question.alone:
            return more
        gains = self._scores(now) - now.log_p
        rows = [i for i in np.argsort(-gains).tolist() if gains[i] > 0.0
                and question.blocks[i].family in question.alone]
        many = self.visit((*now.chosen, *rows[:min(len(rows) // 2 + 1, self._room(now))]))
        return many if many.log_p > more.log_p else more

    def _masked(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with outlying rows added, twice as many each time.

        If there are many outliers, no single one improves the set: the others mask it as noise.
        With each one present the next gains more; once it gains less, there are no others.
        """
        blocks = self.question.blocks
        rows = [i for i in np.argsort(-self._scores(now)).tolist()
                if blocks[i].family in self.question.alone and i not in now.chosen]
        last, each, count = now, -np.inf, 2
        while count <= min(len(rows), self._room(now)):
            at = self.visit((*now.chosen, *rows[:count]))
            yield at
            gain = (at.log_p - last.log_p) / (len(at.chosen) - len(last.chosen))
            if gain < each:
                return
            last, each, count = at, gain, 2 * count

    def _leaning(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with a dependent block and the simplest block that it requires.

        Added, or replacing a block. A compliance under a weight that acts elsewhere explains
        nothing by itself.
        """
        blocks = self.question.blocks
        leaning = [j for j, b in enumerate(blocks) if b.needs]
        for place in (now.chosen, *(tuple(j for j in now.chosen if j != i) for i in now.causes)):
            there = {blocks[i].gives for i in place}
            for j in leaning:
                bearing = [i for i, b in enumerate(blocks) if b.gives == blocks[j].needs]
                if bearing and blocks[j].needs not in there and j not in place:
                    yield self.visit((*place, max(bearing, key=lambda i: blocks[i].log_prior), j))

    def _parted(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield the most probable set with one block replaced by parts of it.

        Of an effect with a value for each joint, perhaps only two joints are affected: the part
        needed least given the others is removed first, as long as the set becomes more probable.
        """
        for i in now.causes:
            rest, best = tuple(j for j in now.chosen if j != i), None
            parts = self._by_need(now, i) if self.question.parts.get(i) else []
            while len(parts) > 1:
                parts = parts[1:]
                at = self.visit((*rest, *parts))
                if best is not None and at.log_p <= best.log_p:
                    break
                best = at
            if best is not None:
                yield best

    def _by_need(self, now: BlockSet, i: int) -> list[int]:
        """Return the parts of a block, each the one needed least given those after it.

        If errors of joints look alike, each one is uncertain, but that one is present is certain.
        """
        blocks, (number, _, found) = self.question.blocks, now.likeliest
        block, n = blocks[i], now.causes.index(i)
        past, own = now.given(number, found, i), list(block.columns)
        values, seen = past.columns.some(own), past.seen[own]
        gram = values.T @ values
        root = SIZES[found.sizes[n]] * block.own_roots(gram, past.count)[found.grid[n]]
        inner = root.T @ (gram - seen @ seen.T) @ root + np.eye(root.shape[1])
        right, place = root.T @ past.right[own], {c: k for k, c in enumerate(own)}
        mine = {j: [place[c] for c in blocks[j].columns] for j in self.question.parts[i]}
        order = list[int]()
        while mine:
            left = sorted({k for columns in mine.values() for k in columns})
            known = linalg.inv(inner[np.ix_(left, left)])
            value = dict(zip(left, known @ right[left], strict=True))
            sure = {}
            for j, columns in mine.items():
                each, at = np.array([value[k] for k in columns]), np.searchsorted(left, columns)
                sure[j] = float(each @ linalg.solve(known[np.ix_(at, at)], each))
            order.append(min(mine, key=lambda j: (sure[j], j)))
            del mine[order[-1]]
        return order

    def _whole(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with a block replacing those that are parts of it."""
        for i, parts in self.question.parts.items():
            rest = tuple(j for j in now.chosen if j not in parts)
            if i not in rest and len(rest) < len(now.chosen) - 1:
                yield self.visit((*rest, i))

    def _reshaped(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with one block replaced by another form of its family, and one more block.

        An effect with a value for each joint may instead be one value for all plus another cause.
        """
        blocks = self.question.blocks
        for i in now.causes:
            rest = self.settle(tuple(j for j in now.chosen if j != i))
            other = np.array([b.family != blocks[i].family or len(b.columns) == len(
                blocks[i].columns) for b in blocks])
            log_p, chosen = self._best(rest, other, surely=True)
            if log_p > -np.inf:
                more, both = self._best(self.visit(chosen))
                if more > now.log_p:
                    yield self.visit(both)

    def _split(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with one block replaced by others, of other families.

        A block that explains most by itself may leave nothing to two others that explain more.
        """
        blocks = self.question.blocks
        for i in now.causes:
            rest = self.settle(tuple(j for j in now.chosen if j != i))
            gone = np.array([b.family == blocks[i].family for b in blocks])
            for n in range(FIRSTS):
                at, (score, start) = rest, self._best(rest, gone)
                if n and score < now.log_p - NEGLIGIBLE:
                    break
                for _ in range(DEEP):
                    log_p, chosen = self._best(at, gone)
                    if log_p <= at.log_p:
                        break
                    at = self.visit(chosen)
                    yield at
                form = blocks[start[-1]].form or blocks[start[-1]].family if start else ""
                gone = gone | np.array([(b.form or b.family) == form for b in blocks])
            yield from self._pairs(rest, now.log_p)

    def _renamed(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with two events of one group replaced by two of another.

        Such as a base that moved twice: a target's move does not combine with only one of them.
        """
        where: dict[str, list[int]] = defaultdict(list)
        for i in now.causes:
            where[self.question.blocks[i].group].append(i)
        for group, events in where.items():
            for two in combinations(events if group else (), 2):
                rest = self.settle(tuple(j for j in now.chosen if j not in two))
                for at in self._pairs(rest, now.log_p - CLOSE):
                    yield at
                    if at.log_p > now.log_p - CLOSE:
                        for other in at.chosen[-2:]:    # so that each at other rows is scored
                            self._best(self.settle((*rest.chosen, other)))

    def _merged(self, now: BlockSet) -> Iterator[BlockSet]:
        """Yield sets with one more block, without those not needed next to it.

        Blocks that explain most by themselves, and most given the present ones.
        """
        if len(now.causes) < 2:
            return
        tried = dict.fromkeys((*self._strongest(self.visit(()).scores, now),
                               *self._strongest(now.scores, now)))
        for i in tried:
            yield self._pruned(self.visit((*now.chosen, i)), i)

    def _strongest(self, scores: Array, now: BlockSet) -> list[int]:
        """Return the most probable block of each of a few forms, except blocks already present."""
        blocks, found = self.question.blocks, dict[str, int]()
        for i in np.argsort(-scores).tolist():
            form = blocks[i].form or blocks[i].family
            if i not in now.chosen and blocks[i].family not in self.question.alone:
                found.setdefault(form, i)
            if len(found) == MOST_FORMS:
                break
        return list(found.values())

    def _pruned(self, at: BlockSet, held: int) -> BlockSet:
        """Return the most probable of a set and its subsets, ``held`` in all of them.

        A block needed at the present sizes of the others is nearly as much needed at any sizes.
        """
        while True:
            fewer = [self.visit(tuple(j for j in at.chosen if j != k)) for k in at.causes
                     if k != held and at.about_without(k) > at.log_p - CLOSE]
            best = max(fewer, key=lambda s: s.log_p, default=at)
            if best.log_p <= at.log_p:
                return at
            at = best

    def _pairs(self, at: BlockSet, least: float) -> Iterator[BlockSet]:
        """Yield sets with two more events of one group that may be more probable than ``least``.

        For every correlation: without both events, correlated noise seems more probable than it is.
        """
        parts = {i for own in self.question.parts.values() for i in own}
        # parts of another block are reached from that block, one by one
        free = {group: own for group, every in self.question.groups.items() if len(
            own := [i for i in every if i not in at.chosen and i not in parts]) > 1}
        most: dict[tuple[int, int], float] = {}
        for number, log_p, found in at.views if free else ():
            past, view = at.given(number, found), self.question.views[number]
            for group, own in free.items():
                if group not in view.events:
                    view.events[group] = Events.of(
                        view.blocks, self.question.groups[group], view.start.columns)
                i, j, gain = view.events[group].most(past, own)
                left = max(1.0 - gain / past.spread, LEAST)
                most[i, j] = max(most.get((i, j), -np.inf),
                                 log_p - 0.5 * past.freedom * float(np.log(left)))
        prior = self.question.log_prior(at.chosen) - float(np.log(len(at.views)))
        for pair, log_p in sorted(most.items(), key=lambda found: -found[1]):
            chosen = (*at.chosen, *pair)
            if log_p + self.question.log_prior(chosen) - prior > least:
                yield self.visit(chosen)

    def _likelier(self, now: BlockSet, moves: Iterable[tuple[float, tuple[int, ...]]]
                  ) -> BlockSet | None:
        """Return the first move, by probability, that still improves with sizes chosen again."""
        for log_p, chosen in sorted(moves, reverse=True):
            if log_p <= now.log_p:
                return None
            found = self.visit(chosen)
            if found.log_p > now.log_p:
                return found
        return None

    def _scores(self, at: BlockSet) -> Array:
        """Return the scores of a set (B,), as far as they matter to any move or the posterior.

        For the most probable set all matter. For others only those that improve the set, or, for
        subsets of the most probable set, those nearly as probable as that.
        """
        key, (best, log_p) = frozenset(at.chosen), self.best
        if key == best:
            return at.scores
        return at.scores_above(min(at.log_p, log_p - NEGLIGIBLE) if key < best else at.log_p)

    def _best(self, at: BlockSet, gone: Bools | None = None, surely: bool = False
              ) -> tuple[float, tuple[int, ...]]:
        """Return the most probable set with one more block, none of those ``gone``.

        ``surely``: even if none is more probable than the set.
        """
        if not self.question.blocks:
            return -np.inf, at.chosen
        free = np.ones(len(self.question.blocks), dtype=bool) if gone is None else ~gone
        scores = np.where(free, self._scores(at), -np.inf)
        if surely and -np.inf < scores.max() <= at.log_p:
            scores = np.where(free, at.scores, -np.inf)
        i = int(np.argmax(scores))
        return float(scores[i]), (*at.chosen, i)
