"""The question: values, geometry, and the blocks that may be in the data, with their priors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain

import numpy as np

from ppmcal import linalg
from ppmcal.inference.blocks import Batch, Block, batches
from ppmcal.inference.columns import ColumnSource
from ppmcal.inference.correlation import RowNoise, Whitened
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import taken_blocks
from ppmcal.inference.pairs import Events
from ppmcal.inference.priors import CORRELATED, CORRELATIONS, FURTHER, NOISE_FREEDOM
from ppmcal.linalg import Array, Bools, Ints

KEPT = 6
"""Sets of outlying rows for which conditioned data are cached."""


@dataclass(frozen=True, eq=False)
class NoiseView:
    """The data whitened for one correlation of the noise."""

    log_prior: float
    rho: float
    start: Conditioned
    blocks: tuple[Block, ...]
    _with_rows: dict[frozenset[tuple[int, int]], Conditioned] = field(default_factory=dict,
                                                                          repr=False)

    @cached_property
    def batches(self) -> tuple[Batch, ...]:
        """The blocks, in batches of one shape."""
        return tuple(batches(self.blocks, self.start.columns, self.start.count,
                             self.start.known))

    def taking(self, rows: Mapping[int, int]) -> Conditioned:
        """Return the data conditioned on outlying rows, at their sizes."""
        key = frozenset(rows.items())
        if not key:
            return self.start
        if key not in self._with_rows:
            near = max((k for k in self._with_rows if k < key), key=len, default=frozenset())
            more = dict(key - near)
            base = self._with_rows.get(near, self.start)
            self._with_rows[key] = base.taking(taken_blocks(
                base, [self.blocks[i] for i in more], list(more.values())))
            while len(self._with_rows) > KEPT:
                self._with_rows.pop(next(iter(self._with_rows)))
        return self._with_rows[key]

    @cached_property
    def events(self) -> dict[str, Events]:
        """The events of each group, filled as needed."""
        return {}


@dataclass(frozen=True, eq=False)
class Question:
    """Values, geometry, and the blocks that may be present in addition.

    Attributes:
        columns: whitened for uncorrelated noise (T).
        values: y (n,), zero where ``observed`` (N, m) is not.
        geometry: Jacobian times the root of its prior (n, c).
        apart: rows from each to the next (N - 1,), 0 where another sequence begins.
        alone: families that never represent several others: outlying rows.
        known: degrees of freedom of the noise prior.
        measured: number of measured values, if rows were reduced to fewer; 0: not reduced.
    """

    columns: ColumnSource
    values: Array
    geometry: Array
    blocks: tuple[Block, ...]
    observed: Bools
    apart: Ints
    alone: frozenset[str] = frozenset()
    known: float = float(NOISE_FREEDOM)
    measured: int = 0

    @cached_property
    def views(self) -> tuple[NoiseView, ...]:
        """The data whitened for every correlation."""
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
        count = self.measured or int(self.observed.sum())
        values = noise.apply(self.values[:, None])[:, 0]
        start = Conditioned.nothing(columns, values, count, self.known).taking(
            noise.apply(self.geometry))
        return NoiseView(log_prior - noise.log_det, rho, start, self.blocks)

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
        """For each block the grouped blocks of its family that have a subset of its columns."""
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
        """Log prior of each group: that one of its blocks is present."""
        return {group: float(linalg.logsumexp([self.blocks[i].log_prior for i in own]))
                for group, own in self.groups.items()}

    @cached_property
    def _looks(self) -> dict[str, tuple[list[int], float]]:
        """The blocks of each subject, and the gain in log prior of each given another."""
        own: dict[str, list[int]] = defaultdict(list)
        for i, block in enumerate(self.blocks):
            if block.subject:
                own[block.subject].append(i)
        further = float(np.log(float(FURTHER)))
        return {subject: (every, further - float(linalg.logsumexp(self._each[every])))
                for subject, every in own.items()}

    @cached_property
    def _places(self) -> dict[str, int]:
        """Number of groups of each family."""
        found: dict[str, set[str]] = defaultdict(set)
        for block in self.blocks:
            if block.group:
                found[block.family].add(block.group)
        return {family: len(groups) for family, groups in found.items()}

    def _further(self, i: int, there: Iterable[int], more_often: float) -> float:
        """Return the log prior of block i given others: one more of a group costs less."""
        block = self.blocks[i]
        alone = block.log_prior + more_often * (block.family not in self.alone)
        if block.subject and any(self.blocks[j].subject == block.subject for j in there):
            alone = max(alone, block.log_prior + self._looks[block.subject][1])
        like = [j for j in there if self.blocks[j].group and (
            self.blocks[j].family == block.family or self.blocks[j].group == block.group)]
        if not block.group or not like:
            return alone
        count = len(self.groups[block.group])
        same = sum(self.blocks[j].group == block.group for j in like)
        # all choices of m out of n are equally probable, in any order
        more = (np.log(float(FURTHER) * (len(like) + 1) * count / (count - same))
                + block.log_prior - self._of_group[block.group])
        if not same:
            more -= np.log(self._places[block.family])
        return float(max(alone, more))

    def log_prior(self, chosen: Iterable[int], more_often: float = 0.0) -> float:
        """Return the log prior of a set, in any order, assuming required blocks are present.

        ``more_often``: logarithm of a factor on the prior of each family, except outlying rows.
        """
        total, there = 0.0, list[int]()
        for i in sorted(chosen, key=lambda i: (
                -self.blocks[i].log_prior, len(self.groups.get(self.blocks[i].group, ())), i)):
            total += self._further(i, there, more_often)
            there.append(i)
        return total

    @cached_property
    def _each(self) -> Array:
        """Log prior of each block alone (B,)."""
        return np.array([b.log_prior for b in self.blocks], dtype=float)

    def more(self, chosen: Sequence[int]) -> Array:
        """Return the gain in log prior of a set by adding each block (B,).

        The values for blocks already in it are meaningless.
        """
        out, base = self._each.copy(), self.log_prior(chosen)
        families = {self.blocks[i].family for i in chosen if self.blocks[i].group}
        groups = {self.blocks[i].group for i in chosen} - {""}
        for subject in {self.blocks[i].subject for i in chosen} - {""}:
            own, gain = self._looks[subject]
            out[own] = np.maximum(out[own], self._each[own] + gain)
        for group, own in self.groups.items():
            if group in groups or self.blocks[own[0]].family in families:
                alike = dict[tuple[str, str, float], list[int]]()
                for i in own:
                    if i not in chosen:
                        block = self.blocks[i]
                        alike.setdefault((block.family, block.subject, block.log_prior),
                                         []).append(i)
                for some in alike.values():
                    out[some] = self.log_prior((*chosen, some[0])) - base
        return out

    @cached_property
    def with_ratio(self) -> list[int]:
        """The blocks with a bounded ratio to another."""
        return [i for i, b in enumerate(self.blocks) if b.ratio]

    @cached_property
    def _leaning(self) -> tuple[Ints, Ints]:
        """The needs and gives of each block (B,), as numbers; 0: none."""
        names = ["", *sorted({b.needs for b in self.blocks} - {""})]
        place = {name: n for n, name in enumerate(names)}
        return (np.array([place[b.needs] for b in self.blocks], dtype=np.int64),
                np.array([place.get(b.gives, 0) for b in self.blocks], dtype=np.int64))

    def apart_from_rows(self, chosen: Iterable[int]) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the causes and the outlying rows among some blocks."""
        every = tuple(chosen)
        rows = tuple(i for i in every if self.blocks[i].family in self.alone)
        return tuple(i for i in every if self.blocks[i].family not in self.alone), rows

    @cached_property
    def _readings(self) -> tuple[Ints, dict[str, Bools]]:
        """How each block interprets its inputs (B,), as numbers, and which blocks use an input."""
        ways = {way: n for n, way in enumerate(dict.fromkeys(["", *(b.way for b in self.blocks)]))}
        return (np.array([ways[b.way] for b in self.blocks], dtype=np.int64),
                {name: np.array([name in b.reads for b in self.blocks], dtype=bool)
                 for name in {name for b in self.blocks if b.way for name in b.reads}})

    def _contradicts(self, chosen: Iterable[int]) -> Bools:
        """Whether each block interprets an input differently from a set (B,)."""
        way, reading = self._readings
        out = np.zeros(len(self.blocks), dtype=bool)
        for i in chosen:
            for name in self.blocks[i].reads & reading.keys():
                out |= reading[name] & (way != way[i])
        return out

    def complete(self, chosen: Sequence[int]) -> bool:
        """Whether a set has all that its blocks require, and one interpretation of each input."""
        needs, gives = self._leaning
        own = list(chosen)
        lacking = set(needs[own].tolist()) - {0, *gives[own].tolist()}
        return not (lacking or self._contradicts(own)[own].any())

    def completes(self, chosen: Sequence[int]) -> Bools:
        """Whether a set is complete with each block added (B,)."""
        needs, gives = self._leaning
        there = {0, *gives[list(chosen)].tolist()}
        lack = set(needs[list(chosen)].tolist()) - there
        able = np.isin(needs, list(there)) | (needs == gives)
        if lack:
            able &= (gives == min(lack)) & (len(lack) == 1)
        return np.asarray(able & ~self._contradicts(chosen))
