"""The sizes of a set's causes, and whether the linearisation still holds for them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterator, Sequence

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, State
from ppmcal.diagnosis.extended_model import Sized, extended
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.question import Asked
from ppmcal.diagnosis.refit import started
from ppmcal.inference.block_sets import BlockSet, Numbers
from ppmcal.inference.question import Question
from ppmcal.inference.ranges import SIZES
from ppmcal.linalg import Array, Bools

LINEAR = 0.1
"""Added effects count as linear if linearisation errs by at most this times the noise, rms."""


def sizes(asked: Asked, at: BlockSet) -> list[Sized]:
    """Return the named hypotheses of a set, their coefficients and their standard uncertainties.

    Both are 0 where the geometry absorbs the effect: no fit could determine it.
    """
    joint, out = at.likeliest[2], []
    for k, i in enumerate(at.causes):
        source = asked.sources[i]
        if isinstance(source, Hypothesis) and not source.anonymous and not source.misread:
            seen = _seen(asked.question, source.columns)
            out.append(_together(source, *(seen * x[:source.size] for x in (
                joint.values[k], joint.sigmas[k],
                _prior(asked.question, i, int(joint.sizes[k]), int(joint.grid[k]))))))
    return in_proportion(list(_once(out)))


def _prior(asked: Question, block: int, size: int, root: int) -> Array:
    """Return the prior standard deviations (k,) of a block's coefficients at one size."""
    mine = asked.blocks[block]
    columns = asked.columns.some(mine.columns)
    roots = mine.own_roots(columns.T @ columns, asked.views[0].start.count)
    return np.asarray(SIZES[size] * np.linalg.norm(roots[root], axis=1))


def in_proportion(sized: Sequence[Sized]) -> list[Sized]:
    """Return hypotheses, those that require another one as a ratio to its size.

    Unchanged if the other one's size is 0.
    """
    size: dict[tuple[str, tuple[str, ...]], float] = defaultdict(float)
    for s in sized:
        size[s.hypothesis.kind, s.hypothesis.on] += float(np.mean(s.value))

    def of(s: Sized) -> float:
        return size[s.hypothesis.requires] if s.hypothesis.requires else 0.0

    return [Sized(s.hypothesis, s.value / of(s), *(x / abs(of(s)) for x in (s.sigma, s.prior)))
            if of(s) else s for s in sized]


def _together(h: Hypothesis, value: Array, sigma: Array, prior: Array) -> Sized:
    """Return a hypothesis with the values for the machine: the mean over its sessions, if any."""
    value, sigma, prior = (x.reshape(max(len(h.sessions), 1), -1) for x in (value, sigma, prior))
    return Sized(h, np.mean(value, axis=0), *(np.sqrt(np.mean(x**2, axis=0))
                                              for x in (sigma, prior)))


def _seen(asked: Question, columns: Sequence[int]) -> Bools:
    """Return which columns (k,) show past the geometry at the largest size considered."""
    given, which = asked.views[0].start, list(columns)
    whole = np.sum(given.columns.some(which) ** 2, axis=0)
    past = whole - np.sum(given.seen[which] ** 2, axis=1)
    return np.asarray(past > (SIZES[0] / SIZES[-1]) ** 2 * whole)


def _once(sized: Sequence[Sized]) -> Iterator[Sized]:
    """Yield hypotheses; of those at several grid constants only the most certain one.

    A constant between two grid points needs both points; a fit finds it. There may be several
    waves and events.
    """
    sure = {id(s.hypothesis): float(np.max(np.abs(s.value) / np.maximum(s.sigma, 1e-300)))
            for s in sized}
    for s in sized:
        h = s.hypothesis
        several = h.effect is None or h.effect.period or h.effect.onset or not h.constants
        others = [f for f in (o.hypothesis for o in sized)
                  if (f.family, f.on, f.shared) == (h.family, h.on, h.shared)]
        if several or h is max(others, key=lambda f: sure[id(f)]):
            yield s


def between_points(h: Hypothesis) -> bool:
    """Return whether a fit finds its constants between grid points; events have only whole rows."""
    return h.scanned and h.effect is not None and not h.effect.onset


class CauseSizes:
    """How far causes are from their linearisation at a fit; ``known`` ones are fitted already."""

    def __init__(self, fit: Fit, keep: Sequence[Bools], asked: Asked, known: Container[str]
                 ) -> None:
        self.fit, self.keep, self.asked, self.known = fit, keep, asked, known
        self.found = False
        self._small = set[Numbers]()

    def too_large(self, at: BlockSet) -> bool:
        """Return whether the named causes of a set, together, are too large to linearise."""
        some = [(i, h, value) for i, value in zip(at.causes, at.likeliest[2].values, strict=True)
                if isinstance(h := self.asked.sources[i], Hypothesis) and not h.anonymous
                and not (h.misread or h.sessions or between_points(h))
                and h.family not in self.known]
        own = frozenset(i for i, _, _ in some)
        if own and own not in self._small and not self.found:
            self._small.add(own)
            told = {id(h) for _, h, _ in some}
            sized = [s for s in sizes(self.asked, at) if id(s.hypothesis) in told]
            columns = [c for i, _, _ in some for c in self.asked.question.blocks[i].columns]
            linear = self.asked.question.columns.some(columns) @ np.concatenate(
                [value for _, _, value in some])
            self.found = self._apart(sized, linear) > LINEAR
        return self.found

    def _apart(self, sized: Sequence[Sized], linear: Array) -> float:
        """Return the rms difference, over the noise, of an extended machine from linearisation."""
        problem, at = started(self.fit, extended(self.fit.problem.mechanism, sized)[0])
        before = _residual(self.fit.problem, self.fit.state, self.keep)
        after = _residual(problem, problem.solve(at), self.keep)
        observed = self.asked.system.observed.reshape(-1)
        if not before.size == after.size == observed.sum():
            return np.inf       # some rows have no pose with it
        return float(np.sqrt(np.mean((after - before + linear[observed]) ** 2)))


def _residual(problem: Problem, at: State, keep: Sequence[Bools]) -> Array:
    """Return the whitened residuals of the observed values (n,)."""
    return np.concatenate([c.residual[c.observed] for c in problem.rows(at, False, keep)])
