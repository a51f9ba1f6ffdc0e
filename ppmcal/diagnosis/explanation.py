"""What is in a fit's residuals: asked, fitted, asked again at the new fit, until the sets agree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ppmcal.calibration.fit import Fit, FitOptions
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.extended_model import Added, columns_added, extended
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.linear_system import System, build
from ppmcal.diagnosis.question import ROW_FAMILY, Asked, Source, question
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.stage import without
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.thinning import thinned
from ppmcal.diagnosis.unknown_causes import UnknownCause, UnknownCauses
from ppmcal.errors import BadInput, NoResult
from ppmcal.inference.block_sets import Numbers, state
from ppmcal.inference.sets import Member, SetPosterior, posterior
from ppmcal.linalg import Array, Bools
from ppmcal.model.effects import Setting

Sized = tuple[Hypothesis, Array, Array]
"""A hypothesis, its coefficients and their standard deviations."""
ROUNDS = 4
LINEAR = 0.1
"""What was added is linear where its derivatives say the same within so much of the noise, rms."""
MASS = 0.95
"""Of the probability, what the families that are told in one place have together."""


@dataclass(frozen=True, eq=False)
class CausePlace:
    """One cause that is there, and what it may be.

    ``members``: those that are needed for 95 %, likeliest first. ``block``: of the best set;
    ``hypothesis``: what it stands for, None if that is unknown. ``only_misread``: whether all of
    the members are columns that are read wrongly.
    """

    members: tuple[Member, ...]
    block: int
    label: str
    hypothesis: Hypothesis | None
    only_misread: bool = False

    @property
    def sure(self) -> bool:
        """Whether something is there: nothing is not among what is likely."""
        return all(m.family for m in self.members)

    @property
    def named(self) -> bool:
        """Whether a name stands: something is there, and unknown does not lead."""
        return self.sure and self.hypothesis is not None and not self.misread

    @property
    def misread(self) -> str:
        """How columns would have to be read for it, in words; empty: as they are."""
        return self.hypothesis.misread if self.hypothesis is not None else ""


@dataclass(frozen=True, eq=False)
class Round:
    """What was asked at one fit, and the answer."""

    fit: Fit
    added: tuple[Added, ...]
    columns: tuple[int, ...]
    kinds: Sequence[str] | None
    library: Library
    asked: Asked
    answer: SetPosterior

    @cached_property
    def keys(self) -> frozenset[object]:
        """What the best set is made of, by what is the same in the question of another round."""
        return frozenset(_key(self.asked.sources[i]) for i in self.answer.best.chosen)

    @cached_property
    def places(self) -> tuple[CausePlace, ...]:
        """Causes that are there, rows that do not belong left out."""
        blocks, out = self.asked.question.blocks, []
        misread = {b.family for b, s in zip(blocks, self.asked.sources, strict=True)
                   if isinstance(s, Hypothesis) and s.misread}
        for n, i in enumerate(self.answer.best.chosen):
            if blocks[i].family == ROW_FAMILY:
                continue
            source = self.asked.sources[i]
            h = source if isinstance(source, Hypothesis) and not source.anonymous else None
            members = tuple(_likely(self.answer.members(n)))
            out.append(CausePlace(members, i, blocks[i].name, h,
                                  all(m.family in misread for m in members)))
        return tuple(out)

    @property
    def unnamed(self) -> tuple[CausePlace, ...]:
        """Places where something is that has no name."""
        return tuple(p for p in self.places if p.sure and not p.named)

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of the system that do not belong."""
        blocks = self.asked.question.blocks
        return tuple(source for i in self.answer.best.chosen if blocks[i].family == ROW_FAMILY
                     if isinstance(source := self.asked.sources[i], int))

    @property
    def verdict(self) -> str:
        """none, weak, named, named-set, partial or unnamed."""
        sure = [p for p in self.places if p.sure]
        named = [p for p in sure if p.named]
        if not sure:
            return "none" if self.answer.nothing((ROW_FAMILY,)) > 0.5 else "weak"
        if not named:
            return "unnamed"
        if len(named) < len(sure):
            return "partial"
        return "named-set" if any(len(p.members) > 1 for p in named) else "named"

    def sized(self, chosen: Numbers) -> list[Sized]:
        """Return the hypotheses of a set that have a name, their coefficients and their sigmas."""
        best = self.answer.best
        at = best if chosen == frozenset(best.chosen) else state(
            self.asked.question, sorted(chosen), [n for n, _, _ in best.views])
        joint = at.likeliest[2]
        out = list(_once([
            (source, value[:source.size], sigma[:source.size]) for i, value, sigma in
            zip(at.causes, joint.values, joint.sigmas, strict=True)
            if isinstance(source := self.asked.sources[i], Hypothesis)
            and not source.anonymous and not source.misread]))
        return in_proportion(out)


def in_proportion(sized: Sequence[Sized]) -> list[Sized]:
    """Return hypotheses, those that lean on another in proportion to that one's size.

    Where that one has no size there is no proportion: they stay as they are.
    """
    size: dict[tuple[str, tuple[str, ...]], float] = defaultdict(float)
    for h, value, _ in sized:
        size[h.kind, h.on] += float(np.mean(value))
    return [(h, value / size[h.leans], sigma / abs(size[h.leans])) if h.leans and size[h.leans]
            else (h, value, sigma) for h, value, sigma in sized]


def _once(sized: Sequence[Sized]) -> Iterator[Sized]:
    """Yield hypotheses, those at several constants of a grid once, the one that is surest.

    Between two points of a grid both are needed; a fit finds the point. Of waves and events there
    may be several.
    """
    sure = {id(h): float(np.max(np.abs(value) / np.maximum(sigma, 1e-300)))
            for h, value, sigma in sized}
    for h, value, sigma in sized:
        several = h.effect is None or h.effect.period or h.effect.onset or not h.constants
        others = [f for f, _, _ in sized
                  if (f.family, f.on, f.shared) == (h.family, h.on, h.shared)]
        if several or h is max(others, key=lambda f: sure[id(f)]):
            yield h, value, sigma


def _surest(sized: Sequence[Sized]) -> Sized | None:
    """Return the surest of several if it was found at a point of a grid, else None.

    Beside it others may only make up for what is between the points: they are asked for again
    once a fit has found its constants.
    """
    if len(sized) < 2:
        return None
    most = max(sized, key=lambda s: float(np.sum((s[1] / np.maximum(s[2], 1e-300)) ** 2)))
    return most if _between_points(most[0]) else None


def _between_points(h: Hypothesis) -> bool:
    """Return whether a fit finds constants of it that stand in no grid; an event has a row."""
    return h.scanned and h.effect is not None and not h.effect.onset


def _key(source: Source) -> object:
    """Return what a block is, whatever its number."""
    if isinstance(source, Hypothesis):
        return (source.label, source.shared, source.follows, *sorted(source.constants.items()))
    return source.label if isinstance(source, UnknownCause) else source


def _likely(members: Sequence[Member]) -> Iterator[Member]:
    total = 0.0
    for member in members:
        yield member
        total += member.probability
        if total >= MASS:
            break


def explained(fit: Fit, options: FitOptions, kinds: Sequence[str] | None = None) -> list[Round]:
    """Return what is in the data that a fit of the geometry leaves, round by round.

    What was found is fitted with the geometry, and asked again at that fit, until it stays.
    """
    keep = thinned(fit.problem, [k | o for k, o in zip(fit.keep, fit.outliers, strict=True)])
    everywhere = all_settings(fit)
    rounds = [_asked(fit, fit, (), keep, everywhere, kinds)]
    for _ in range(ROUNDS - 1):
        last = rounds[-1]
        sized = last.sized(frozenset(last.answer.best.chosen))
        if not sized and last.fit is fit:
            break
        alone = _surest(sized) if last.fit is fit else None
        if alone is not None:
            sized = [alone]
        try:
            machine, added = extended(fit.problem.mechanism, sized)
            now = with_mechanism(fit, machine, options) if sized else fit
        except (BadInput, NoResult):
            break
        rounds.append(_asked(fit, now, added, keep, everywhere, kinds, last.keys))
        if alone is None and _same(*rounds[-2:]):
            break
    return rounds


def _same(before: Round, after: Round) -> bool:
    return {(p.label, p.hypothesis is None) for p in before.places} == {
        (p.label, p.hypothesis is None) for p in after.places}


def _asked(whole: Fit, fit: Fit, added: tuple[Added, ...], keep: Sequence[Bools],
           everywhere: Sequence[Setting], kinds: Sequence[str] | None,
           before: Container[object] = ()) -> Round:
    """Ask what is in the data of the ``whole``, its geometry as in a fit with what was ``added``.

    Residuals hold all that was added. ``before``: of what the best set was made in the round
    before; from there the search goes on. Where what was added is not linear, or stands at no
    point of a grid, that counts of two ways to ask in which this set is likelier.
    """
    ways = []
    own = columns_added(fit.problem, added)
    moved = [a.hypothesis for a in added if _between_points(a.hypothesis)]
    for system, columns in _systems(whole, fit, own, keep, bool(moved)):
        tried = [fit.problem.free[c] for c in columns]
        found = library(system, kinds, tried, misread=True)
        asked = question(system, found, UnknownCauses(system, everywhere), columns)
        # shapes without a cause have one name, and what a fit has stands in a grid twice
        first: dict[object, int] = {}
        for n, source in enumerate(asked.sources):
            first.setdefault(_key(source), n)
        start = [n for key, n in first.items() if key in before]
        if columns:
            start = _at_fitted(asked.sources, start, moved)
        ways.append((asked, found, start))
    asked, found, start = ways[0] if len(ways) == 1 else max(
        ways, key=lambda way: state(way[0].question, way[2]).log_p)
    return Round(fit, added, tuple(own), kinds, found, asked, posterior(asked.question, start))


def _at_fitted(sources: Sequence[Source], start: Sequence[int], moved: Sequence[Hypothesis]
               ) -> list[int]:
    """Return a set with what was ``moved`` by a fit at its constants, and at no other point.

    Those stand first in a grid of the machine that was fitted.
    """
    out = list(start)
    for h in moved:
        own = [n for n, s in enumerate(sources) if isinstance(s, Hypothesis) and _between_points(s)
               and (s.label, s.shared, s.misread) == (h.label, h.shared, "")]
        out = [n for n in out if n not in own] + own[:1]
    return out


def _systems(whole: Fit, fit: Fit, own: Sequence[int], keep: Sequence[Bools], moved: bool
             ) -> Iterator[tuple[System, Sequence[int]]]:
    """Yield the machine without what a fit has in columns ``own``, and those still to be left out.

    First as it is at the fit's geometry, what was added in no slot and no load; then, where that
    is not the same, as its derivatives at the fit say, which know of motions that are no more
    small. ``moved``: what was added stands at constants that only the fitted machine knows.
    """
    problem = whole.problem
    g = fit.state.g[:whole.state.g.size].copy()
    rest = np.setdiff1d(np.arange(g.size), problem.free)
    g[rest] = whole.state.g[rest]
    bare = build(problem, problem.solve(replace(fit.state, g=g)) if own else fit.state, keep)
    yield bare, ()
    if own:
        linear = without(build(fit.problem, fit.state, keep), own)
        # a row that one of them loses has no partner in the other
        if linear.residual.shape == bare.residual.shape:
            apart = (linear.residual - bare.residual)[bare.observed]
            if moved or float(np.sqrt(np.mean(apart**2))) > LINEAR:
                yield linear, own
