"""The evidence of a set of blocks, for every correlation of the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ppmcal import linalg
from ppmcal.inference.blocks import Block
from ppmcal.inference.evidence import BatchOdds, most_of_all, odds_of_some
from ppmcal.inference.given import Conditioned
from ppmcal.inference.gross_rows import RowSize, sized_rows
from ppmcal.inference.joint import JointBlocks, joint, joint_of_each, taken_blocks
from ppmcal.inference.question import Question
from ppmcal.inference.ranges import LEAST, all_between, usual
from ppmcal.linalg import Array

NEGLIGIBLE = 14.0
"""Sets whose log probability is lower than the best by more are ignored: below one in a million."""

ROUNDS = 3
"""Maximum alternations between finding the sizes of causes and of outlying rows."""

Numbers = frozenset[int]
"""A set of blocks, by number."""


@dataclass(frozen=True, eq=False)
class BlockSet:
    """A set of blocks with its evidence.

    ``views``: for each probable correlation its number, log p and sizes of the causes, assuming
    that all required blocks are present; ``log_p``: -inf if they are not. ``rows``: the outliers.
    """

    question: Question
    chosen: tuple[int, ...]
    log_p: float
    views: tuple[tuple[int, float, JointBlocks], ...] = field(repr=False)
    rows: Mapping[int, RowSize] = field(repr=False)
    _known: list[tuple[float, Array]] = field(default_factory=list, repr=False)

    @property
    def causes(self) -> tuple[int, ...]:
        """The blocks that are not rows."""
        return self.question.apart_from_rows(self.chosen)[0]

    @property
    def likeliest(self) -> tuple[int, float, JointBlocks]:
        """The most probable of the views."""
        return max(self.views, key=lambda view: view[1])

    def about_without(self, cause: int) -> float:
        """Return log p without a cause, with the others at their present sizes: nearly exact.

        Except for outlying rows, whose sizes may change, and blocks that require the cause.
        """
        k, question = self.causes.index(cause), self.question
        prior = question.log_prior(i for i in self.chosen if i != cause) + sum(
            row.slack for row in self.rows.values())
        return prior + float(linalg.logsumexp(np.array([
            question.views[n].log_prior + found.without[k] for n, _, found in self.views])))

    @property
    def scored(self) -> bool:
        """Whether any scores have been computed."""
        return bool(self._known)

    def given(self, n: int, found: JointBlocks, but: int | None = None) -> Conditioned:
        """Return the data conditioned on the set, for the n-th correlation; ``but``: one cause."""
        view, sizes = self.question.views[n], {i: row.size for i, row in self.rows.items()}
        taken = [k for k, i in enumerate(self.causes) if i != but]
        return view.taking(sizes).taking(taken_blocks(
            view.start, [self.question.blocks[self.causes[k]] for k in taken],
            found.sizes[taken], found.grid[taken]))

    @property
    def scores(self) -> Array:
        """Log p of the set with each block added (B,); -inf for blocks already in it.

        Also -inf for blocks with which a required block is missing.
        """
        return self.scores_above(-np.inf)

    def scores_above(self, least: float) -> Array:
        """Return the scores (B,) above ``least``; others only as some value not above it."""
        if not any(bound <= least for bound, _ in self._known):
            self._known.append((least, self._scores_above(least)))
        return self._known[-1][1]

    def _scores_above(self, least: float) -> Array:
        question = self.question
        count, more = len(question.blocks), question.more(self.chosen)
        more = np.where(question.completes(self.chosen), more, -np.inf)
        more[list(self.chosen)] = -np.inf
        every = [(log_p, [BatchOdds.of(given, batch) for batch in question.views[n].batches])
                 for n, log_p, found in self.views for given in (self.given(n, found),)]
        out = np.asarray(more + linalg.logsumexp(
            [log_p + most_of_all(own, count) for log_p, own in every], axis=0))
        asked = out > least
        asked[question.with_ratio] = True
        out[asked] = (more + linalg.logsumexp(
            [log_p + odds_of_some(own, asked) for log_p, own in every], axis=0))[asked]
        rows = {i: row.size for i, row in self.rows.items()}
        for i in question.with_ratio:       # sizes bounded by that of another block
            if out[i] > self.log_p - NEGLIGIBLE:
                out[i] = state(question, (*self.chosen, i), [n for n, _, _ in self.views],
                               rows=rows).log_p
        return out


def state(question: Question, chosen: Sequence[int], likely: Sequence[int] = (),
          near: Mapping[int, tuple[int, int]] | None = None,
          rows: Mapping[int, int] | None = None) -> BlockSet:
    """Return a set of blocks with its evidence.

    Correlations smaller than the probable ones are kept too: with one more block, less correlated
    error remains.

    Args:
        question: the possible blocks.
        chosen: numbers of the blocks.
        likely: numbers of the correlations, default all.
        near: numbers of each cause's size and root at which the search starts.
        rows: numbers of sizes of outlying rows, as far as known.
    """
    causes, out = question.apart_from_rows(chosen)
    start = [(near or {}).get(i) for i in causes]
    blocks = [question.blocks[i] for i in causes]
    numbers = likely or range(len(question.views))
    few = {n: _Few.of(question.views[n].start, blocks, {i: question.blocks[i] for i in out})
           for n in numbers}
    own = few[numbers[0]].sized(start, rows or {})
    sizes = {i: row.size for i, row in own.items()}
    prior = question.log_prior(chosen) + sum(row.slack for row in own.values())
    found = list(zip(few, joint_of_each([f.without(sizes) for f in few.values()],
                                        [f.causes for f in few.values()], start), strict=True))
    each = [question.views[n].log_prior + j.log_evidence for n, j in found]
    most = max(n for (n, _), log_z in zip(found, each, strict=True)
               if log_z > max(each) - NEGLIGIBLE)
    views = tuple((n, log_z + prior, j) for (n, j), log_z in zip(found, each, strict=True)
                  if n <= most)
    kept = [z + few[n].in_ratio(j) for z, (n, j) in zip(each, found, strict=True)]
    log_p = float(linalg.logsumexp(kept)) + prior if question.complete(chosen) else -np.inf
    return BlockSet(question, tuple(chosen), log_p, views, own)


@dataclass(frozen=True, eq=False)
class _Few:
    """The data reduced to the columns of a set: blocks renumbered, with their own roots.

    ``causes`` in order, ``rows`` by their numbers in the question.
    """

    given: Conditioned
    causes: Sequence[Block]
    rows: Mapping[int, Block]

    @classmethod
    def of(cls, given: Conditioned, causes: Sequence[Block], rows: Mapping[int, Block]) -> _Few:
        every = [*causes, *rows.values()]
        ends = np.cumsum([0, *(len(b.columns) for b in every)]).tolist()
        columns = given.columns.some([c for b in every for c in b.columns]) if every else (
            np.zeros((given.values.size, 0)))
        own = [replace(b, columns=tuple(range(first, last)), roots=b.own_roots(
            mine.T @ mine, given.count)) for b, (first, last) in zip(
                every, pairwise(ends), strict=True) for mine in (columns[:, first:last],)]
        return cls(given.condensed(columns), own[:len(causes)],
                   dict(zip(rows, own[len(causes):], strict=True)))

    def without(self, sizes: Mapping[int, int]) -> Conditioned:
        """Return the data conditioned on the rows, at the numbers of their sizes."""
        return self.given.taking(taken_blocks(
            self.given, list(self.rows.values()), [sizes[i] for i in self.rows]))

    def in_ratio(self, found: JointBlocks) -> float:
        """Return the log evidence gained because dependent causes keep their ratio to another.

        With the other cause at its mean: posterior over prior probability of being within bounds.
        """
        out = 0.0
        for block, value, sigma in zip(self.causes, found.values, found.sigmas, strict=True):
            others = [float(np.mean(v[:len(b.columns) - len(b.starts)])) for b, v in
                      zip(self.causes, found.values, strict=True) if b.gives == block.needs]
            if block.ratio and others:
                low, high = np.sort(np.array(block.ratio) * sum(others), axis=1).T
                k = low.size
                inside = float(all_between(self.given.freedom, low - value[:k], high - value[:k],
                                           sigma[:k]))
                if inside <= np.log(LEAST):     # too far out to be represented
                    return -np.inf
                out += inside - float(usual(np.array(block.roots), low, high,
                                            self.given.known))
        return out

    def sized(self, start: Sequence[tuple[int, int] | None], near: Mapping[int, int]
              ) -> dict[int, RowSize]:
        """Return rows at sizes that are probable given the causes.

        Without the causes, their effect counts as noise and hides the size of row errors.
        """
        if not self.rows:
            return {}
        found = sized_rows(self.given, self.rows, near)
        for _ in range(ROUNDS if self.causes else 0):
            sizes = {i: row.size for i, row in found.items()}
            causes = joint(self.without(sizes), self.causes, start)
            taken = taken_blocks(self.given, self.causes, causes.sizes, causes.grid)
            found = sized_rows(self.given.taking(taken), self.rows, sizes)
            if sizes == {i: row.size for i, row in found.items()}:
                break
        return found
