"""What is in a fit's residuals: asked, fitted, asked again at the new fit, until the sets agree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ppmcal.calibration.fit import Fit, FitOptions, rows_with_outliers
from ppmcal.diagnosis.at_sessions import with_sessions
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.cause_sizes import LINEAR, CauseSizes, between_points, sizes
from ppmcal.diagnosis.extended_model import Added, Sized, columns_added, extended
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.linear_system import System, Whitening, build
from ppmcal.diagnosis.linearisation import without
from ppmcal.diagnosis.question import NO_CAUSES, Asked, Source, WrongRows, question
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.thinning import thinned
from ppmcal.diagnosis.unknown_causes import PULLS, UNKNOWN_FAMILY, UnknownCause, UnknownCauses
from ppmcal.errors import BadInput, NoResult
from ppmcal.inference.block_sets import BlockSet, Numbers, state
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.moves import CLOSE
from ppmcal.inference.priors import SURE
from ppmcal.inference.sets import Member, SetPosterior, posterior
from ppmcal.linalg import Bools
from ppmcal.model.effects import Setting
from ppmcal.notes import Note

ROUNDS = 4
BESIDE = 12
"""Causes that are tried beside what limbs pull at each place, likeliest first."""
TRY = ("state what is known (stiffness, load, directions) in the mechanism file, or try fewer "
       "kinds (--kind)")
ENDED = Note("the search among sets of causes was stopped early: the likeliest set so far is "
             f"reported, others may be likelier; {TRY}", topic="search")
UNSETTLED = Note(f"the causes did not settle in {ROUNDS} rounds of fitting and asking again: those "
                 "of the last round are reported; only what the round before named too has a name; "
                 f"{TRY}", topic="search")
UNFITTED = ("the fit with {} failed ({}): results are from the fit without, where their "
            f"derivatives may be far off; {TRY}")


@dataclass(frozen=True, eq=False)
class CausePlace:
    """One cause that is there, and what it may be.

    ``members``: those that are needed for 95 %, or would be at other priors, first the one of the
    family that leads, with all members in which it is; the others likeliest first. ``block``: of
    the best set; ``leader``: what is reported in its place; ``hypothesis``: what that stands for,
    None if it is unknown.
    ``only_misread``: whether all of the members are columns that are read wrongly; ``settled``:
    whether the round before found the same, where rounds did not come to agree.
    """

    members: tuple[Member, ...]
    block: int
    leader: int
    label: str
    hypothesis: Hypothesis | None
    only_misread: bool = False
    settled: bool = True

    @property
    def sure(self) -> bool:
        """Whether something is there: nothing is not among what is likely."""
        return all(m.family for m in self.members)

    @property
    def named(self) -> bool:
        """Whether a name stands: something is there, unknown does not lead, and it settled."""
        return self.settled and self.sure and self.hypothesis is not None and not self.misread

    @property
    def misread(self) -> str:
        """How columns would have to be read for it, in words; empty: as they are."""
        return self.hypothesis.misread if self.hypothesis is not None else ""


@dataclass(frozen=True, eq=False)
class Round:
    """What was asked at one fit, and the answer.

    ``whitening``: the correlation of the noise beside the best set, with its standard deviation;
    ``cut``: whether the search ended at what was too large for its derivatives; ``given_up``: what
    was not brought to its end, and what to do, in words; ``before``: what the round before named,
    None where rounds came to agree: no name rests on derivatives that another fit contradicts.
    """

    fit: Fit
    added: tuple[Added, ...]
    columns: tuple[int, ...]
    kinds: Sequence[str] | None
    library: Library
    asked: Asked
    answer: SetPosterior
    whitening: Whitening
    cut: bool = False
    given_up: tuple[Note, ...] = ()
    before: frozenset[object] | None = None

    def without_columns(self) -> Round:
        """Return what it says alone: nothing can be asked of it any more, and it takes no room."""
        question = replace(self.asked.question, columns=MatrixColumns(np.zeros((0, 0))))
        return replace(self, asked=replace(self.asked, question=question), answer=replace(
            self.answer, best=replace(self.answer.best, question=question)))

    @cached_property
    def keys(self) -> frozenset[object]:
        """What the best set is made of, by what is the same in the question of another round."""
        return self._what(self.answer.best.chosen)

    @cached_property
    def likely(self) -> list[frozenset[object]]:
        """What the best set is made of, and others close to it that are more than one move away.

        Nothing of a search that was cut short.
        """
        best, log_p = frozenset(self.answer.best.chosen), self.answer.log_p
        close = [] if self.cut else [best, *(some for some, p in log_p.items()
                                             if p > log_p[best] - CLOSE and len(some ^ best) > 2)]
        return [self._what(some) for some in close]

    def _what(self, some: Iterable[int]) -> frozenset[object]:
        return frozenset(_key(self.asked.sources[i]) for i in some)

    @cached_property
    def places(self) -> tuple[CausePlace, ...]:
        """Causes that are there, rows that do not belong left out."""
        blocks, out = self.asked.question.blocks, []
        misread = {b.family for b, s in zip(blocks, self.asked.sources, strict=True)
                   if isinstance(s, Hypothesis) and s.misread}
        for n, i in enumerate(self.answer.best.chosen):
            if blocks[i].family in NO_CAUSES:
                continue
            members, leader = self._leading(self.answer.likely(n, SURE.value), i)
            source = self.asked.sources[leader]
            h = source if isinstance(source, Hypothesis) and not source.anonymous else None
            out.append(CausePlace(members, i, leader, blocks[leader].name, h,
                                  all(m.family in misread for m in members),
                                  self.before is None or _name(h) in self.before))
        return tuple(out)

    def _leading(self, members: tuple[Member, ...], block: int) -> tuple[tuple[Member, ...], int]:
        """Return members, those first whose family leads, and the block that stands for it.

        A family leads by all members in which it is, whatever stands beside it there; of two that
        are in the same ones that of the best set.
        """
        blocks = self.asked.question.blocks
        mass: dict[str, float] = defaultdict(float)
        for m in members:
            for family in dict.fromkeys(blocks[i].family for i in sorted(m.own)):
                mass[family] += m.probability
        leader = max(mass, key=lambda f: (mass[f], f == blocks[block].family), default="")
        for alone in (True, False):
            for m in members:
                mine = [i for i in sorted(m.own) if blocks[i].family == leader]
                # a name does not stand for two, unknown does
                if mine and (len(m.own) == 1 if alone else leader == UNKNOWN_FAMILY):
                    return (m, *(o for o in members if o is not m)), mine[0]
        return members, block

    @cached_property
    def told(self) -> Numbers:
        """The best set, in each place what has a name and leads there."""
        out = set(self.answer.best.chosen)
        for place in self.places:
            if place.hypothesis is not None:
                out = out - {place.block} | {place.leader}
        return frozenset(out)

    @property
    def unnamed(self) -> tuple[CausePlace, ...]:
        """Places where something is that has no name."""
        return tuple(p for p in self.places if p.sure and not p.named)

    @property
    def wrong(self) -> dict[int, tuple[int, ...]]:
        """Of the likeliest set the blocks whose rows do not belong, and these rows."""
        return {i: source.rows for i in self.answer.best.chosen
                if isinstance(source := self.asked.sources[i], WrongRows)}

    @property
    def rows(self) -> frozenset[tuple[int, int]]:
        """Rows that do not belong: data set and number in it, whatever rows a system has lost."""
        system = self.asked.system
        return frozenset((int(system.dataset[n]), int(system.row[n]))
                         for own in self.wrong.values() for n in own)

    @property
    def verdict(self) -> str:
        """none, weak, named, named-set, partial or unnamed."""
        sure = [p for p in self.places if p.sure]
        named = [p for p in sure if p.named]
        if not sure:
            return "none" if self.answer.nothing(NO_CAUSES) > 0.5 else "weak"
        if not named:
            return "unnamed"
        if len(named) < len(sure):
            return "partial"
        return "named-set" if any(len(p.members) > 1 for p in named) else "named"

    def sized(self, chosen: Numbers) -> list[Sized]:
        """Return the hypotheses of a set that have a name, as :func:`sizes`."""
        best = self.answer.best
        return sizes(self.asked, best if chosen == frozenset(best.chosen) else state(
            self.asked.question, sorted(chosen), [n for n, _, _ in best.views]))


def _surest(sized: Sequence[Sized]) -> Sized | None:
    """Return the surest of several if it was found at a point of a grid, else None.

    Beside it others may only make up for what is between the points: they are asked for again
    once a fit has found its constants.
    """
    if len(sized) < 2:
        return None
    most = max(sized, key=lambda s: float(np.sum((s.value / np.maximum(s.sigma, 1e-300)) ** 2)))
    return most if between_points(most.hypothesis) else None


def _key(source: Source) -> object:
    """Return what a block is, whatever its number, and whatever the strokes that were measured."""
    if isinstance(source, Hypothesis):
        own = {n: v for n, v in source.constants.items() if n not in source.strokes}
        return (source.label, source.shared, source.names, source.follows, *sorted(own.items()))
    return source.label if isinstance(source, UnknownCause) else source


def explained(fit: Fit, options: FitOptions, kinds: Sequence[str] | None = None) -> list[Round]:
    """Return what is in the data that a fit of the geometry leaves, round by round.

    What was found is fitted with the geometry, and asked again at that fit, until it stays. What is
    too large for its derivatives is fitted before another cause is asked for.
    """
    keep = thinned(fit.problem, rows_with_outliers(fit))
    ask = partial(_asked, fit, keep=keep, everywhere=all_settings(fit), kinds=kinds)
    rounds = [ask(fit, (), large=True)]
    while True:
        last = rounds[-1]
        sized = last.sized(last.told)
        alone = _surest(sized) if last.fit is fit else None
        if alone is not None:
            sized = [alone]
        # what was fitted before is asked as it was then
        new = what_is_fitted(s.hypothesis for s in sized)
        if any(new == what_is_fitted(a.hypothesis for a in r.added) for r in rounds):
            if not last.cut:
                break
            rounds[-1] = ask(last.fit, last.added, before=last)
            continue
        if len(rounds) == ROUNDS:
            rounds[-1] = _unsettled(rounds)
            break
        try:
            machine, added = extended(fit.problem.mechanism, sized)
            now = with_mechanism(fit, machine, options) if sized else fit
        except (BadInput, NoResult) as error:
            if last.cut:
                last = ask(last.fit, last.added, before=last)
            what = ", ".join(s.hypothesis.label for s in sized)
            rounds[-1] = replace(last, given_up=(
                *last.given_up, Note(UNFITTED.format(what, error.what), topic="search")))
            break
        last = rounds[-1] = last.without_columns()
        rounds.append(ask(now, added, before=last, large=len(rounds) < ROUNDS // 2))
    return rounds


def _unsettled(rounds: Sequence[Round]) -> Round:
    """Return the last of rounds that end before they agree; what only it found has no name.

    Names alone count: rounds that differ by the rows of events agree.
    """
    now, *earlier = (frozenset(_name(p.hypothesis) for p in r.places if p.named)
                     for r in rounds[-1:-3:-1])
    before = earlier[0] if earlier else frozenset[object]()
    if before == now:
        return rounds[-1]
    return replace(rounds[-1], given_up=(*rounds[-1].given_up, UNSETTLED), before=before)


def _name(h: Hypothesis | None) -> object:
    """Return what a cause is called, whatever its constants; None of what has no name."""
    return None if h is None else (h.label, h.shared, h.names)


def what_is_fitted(some: Iterable[Hypothesis]) -> frozenset[object]:
    """Return what a fit has with some hypotheses: constants that it finds itself do not count."""
    return frozenset(_name(h) if between_points(h) else _key(h) for h in some)


def _asked(whole: Fit, fit: Fit, added: tuple[Added, ...], keep: Sequence[Bools],
           everywhere: Sequence[Setting], kinds: Sequence[str] | None,
           before: Round | None = None, large: bool = False) -> Round:
    """Ask what is in the data of the ``whole``, its geometry as in a fit with what was ``added``.

    Residuals hold all that was added. ``before``: the round before; from its best set the search
    goes on. Where what was added is not linear, or stands at no
    point of a grid, that counts of two ways to ask in which this set is likelier. ``large``:
    whether the search ends at what is too large for its derivatives.
    """
    ways = []
    own = columns_added(fit.problem, added)
    moved = [a.hypothesis for a in added if between_points(a.hypothesis)]
    for system, columns in _systems(whole, fit, own, keep, bool(moved)):
        tried = [fit.problem.free[c] for c in columns]
        found = library(system, kinds, tried, misread=True, apart=True)
        asked = question(system, found, UnknownCauses(system, everywhere), columns)
        # shapes without a cause have one name, and what a fit has stands in a grid twice
        first: dict[object, int] = {}
        for n, source in enumerate(asked.sources):
            first.setdefault(_key(source), n)
        start = [n for key, n in first.items() if before is not None and key in before.keys]
        known = [frozenset(first[key] for key in some) for some in (before.likely if before else ())
                 if some <= first.keys()]
        if columns:
            start = _at_fitted(asked.sources, start, moved)
        ways.append((asked, found, start, known))
    asked, found, start, known = ways[0] if len(ways) == 1 else max(
        ways, key=lambda way: state(way[0].question, way[2]).log_p)
    ask = partial(CauseSizes, fit, keep, asked, {a.hypothesis.family for a in added})
    size = ask()
    start = _pulled(asked, start)
    answer = posterior(asked.question, start, size.too_large if large else None, known,
                       with_sessions(asked.sources))
    # where one cause bends to several wrong rows at a time, the search may have begun with it
    rows = _left_out(fit, asked)
    if rows and state(asked.question, rows).log_p > answer.best.log_p:
        size = ask()
        answer = posterior(asked.question, rows, size.too_large if large else None)
    return Round(fit, added, tuple(own), kinds, found, asked, answer, _whitening(answer.best),
                 size.found, (ENDED,) if answer.ended else ())


def _pulled(asked: Asked, start: Sequence[int]) -> list[int]:
    """Return a set to begin with, what limbs pull at each place with it where that is likelier.

    Steps from place to place can stand for that, and hide it from the search. With it goes the one
    cause with which it is likeliest: beside that less is left to be another at each place, which a
    search that keeps sizes does not see.
    """
    question, begin = asked.question, [*start]
    pulls = [n for n, s in enumerate(asked.sources)
             if isinstance(s, UnknownCause) and s.label == PULLS and n not in begin]
    if pulls:
        now, with_it = state(question, begin), state(question, [*begin, *pulls])
        if with_it.log_p > now.log_p:
            more = [state(question, (*with_it.chosen, int(i)))
                    for i in np.argsort(-with_it.scores)[:BESIDE]]
            begin = list(max(with_it, *more, key=lambda at: at.log_p).chosen)
    return begin


def _whitening(best: BlockSet) -> Whitening:
    rhos = np.array([best.question.views[n].rho for n, _, _ in best.views])
    log_p = np.array([p for _, p, _ in best.views])
    weight = np.exp(log_p - log_p.max())
    mean = float(rhos @ weight / weight.sum())
    return Whitening(mean, float(np.sqrt((rhos - mean) ** 2 @ weight / weight.sum())))


def _left_out(fit: Fit, asked: Asked) -> list[int]:
    """Return the blocks of the rows, and of whole files, that a fit has left out as outliers."""
    at, out, found = asked.system, set[int](), list[int]()
    gone = [bool(fit.outliers[d][r]) for d, r in zip(at.dataset, at.row, strict=True)]
    wrong = [(n, s.rows) for n, s in enumerate(asked.sources) if isinstance(s, WrongRows)]
    for n, rows in sorted(wrong, key=lambda w: -len(w[1])):
        if not out.issuperset(rows) and all(gone[r] for r in rows):
            out.update(rows)
            found.append(n)
    return found


def _at_fitted(sources: Sequence[Source], start: Sequence[int], moved: Sequence[Hypothesis]
               ) -> list[int]:
    """Return a set with what was ``moved`` by a fit at its constants, and at no other point.

    Those stand first in a grid of the machine that was fitted.
    """
    out = list(start)
    for h in moved:
        own = [n for n, s in enumerate(sources) if isinstance(s, Hypothesis) and between_points(s)
               and (s.label, s.shared, s.names, s.misread) == (h.label, h.shared, h.names, "")]
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
