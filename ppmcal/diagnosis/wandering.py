"""Machines and instruments that wander: any slow course in time, against events and drift.

Steps and a steady drift can make up a warm-up or an unsteady tripod of which nothing was recorded.
Where courses without a cause explain the rows better, they have to be a part of the model, and an
event is one only if it is as sudden as that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.added_variable_test import AddedVariableTest
from ppmcal.diagnosis.hypotheses import Collector, Hypothesis
from ppmcal.diagnosis.search import Search, columns_of
from ppmcal.diagnosis.selection import ANONYMOUS, bic, own_log_p, possible
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift
from ppmcal.model.effects.setting import COORDINATES, PLACE

WANDERING = "wandering"
COURSES = (3, 4, 6, 8, 12)
"""Half waves that a course may have over the campaign."""
LENGTHS = (0.1, 0.2, 0.4, 0.8)
"""How fast it may turn, in parts of the campaign."""
SIZES = np.geomspace(1.0, 1e3, 7)
"""Its size: what all of it does, in sigmas."""
MOST = 6
LIKELIER = 2.0
"""Events have to be likelier than courses by this BIC, odds of e, to be named."""
CLOCK = frozenset(("row", "time", "temperature", "past"))
"""What mostly goes with the clock: a hall warms up slowly."""


def add_courses(to: Collector) -> None:
    """Add courses of the base in each coordinate, and of each joint's zero."""
    parts = to.system.parts
    row = np.concatenate([p.response.rows.row for p in to.system.firsts])
    if np.unique(row).size < 2 * max(COURSES):
        return
    waves = slow_waves(row)
    ways = {c: [Shift(frame=np.tile(np.eye(6)[PLACE[c]], (len(p.response.pose), 1)))
                for p in parts] for c in COORDINATES[to.motion]}
    for a, name in enumerate(to.actuators):
        one = np.arange(to.turning.size) == a
        ways[name] = [p.setting.at_joints(np.ones_like(p.setting.travel), one) for p in parts]
    for way, shifts in ways.items():
        unit = to.system.column(shifts)
        columns = tuple(to.columns.add(unit * wave[:, None]) for wave in waves.T)
        to.courses += [Hypothesis(
            WANDERING, (), True, tuple(f"wave{k}" for k in range(1, count + 1)),
            (-np.inf,) * count, (np.inf,) * count, columns[:count], anonymous=True,
            follows="time", part=f"time, of {way}", searched=2) for count in COURSES]


def slow_waves(row: Array) -> Array:
    """Return half waves (N, k) over rows in the order of their numbers (N,)."""
    place = np.argsort(np.argsort(row, kind="stable"), kind="stable") / max(row.size - 1.0, 1.0)
    return np.asarray(np.cos(np.pi * place[:, None] * np.arange(1, max(COURSES) + 1)))


def of_the_clock(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis is a kind that needs to know nothing but when, and how warm it was."""
    kind = hypothesis.effect
    return kind is not None and bool(kind.needs) and CLOCK.issuperset(kind.needs)


def _steady(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis of the clock is a drift: a course as any other."""
    kind = hypothesis.effect
    return kind is not None and not kind.onset and kind.needs == ("time",)


def instead(search: Search, chosen: Sequence[int], courses: Sequence[Hypothesis]) -> list[int]:
    """Return the columns of courses that could explain what events and drift were chosen for.

    Unless they are left out of it, what wanders is taken for correlated noise.
    """
    timed = [i for i in chosen if of_the_clock(search.hypotheses[i])]
    if not timed:
        return []
    rest = search.test.given(columns_of(search, [i for i in chosen if i not in timed]))
    return [c for h in _likeliest(rest, courses)[1] for c in h.columns]


def wandered(search: Search, chosen: tuple[int, ...], courses: Sequence[Hypothesis]
             ) -> tuple[Search, tuple[int, ...]]:
    """Return what was chosen, with courses in place of events and heat that are not likelier.

    These stay beside them if they still reach the naming threshold. A drift does not where there
    is more to the course than a straight line.
    """
    timed = [i for i in chosen if of_the_clock(search.hypotheses[i])]
    if not timed or not courses:
        return search, chosen
    steady = [i for i in chosen if i not in timed or _steady(search.hypotheses[i])]
    events = [i for i in chosen if i not in steady]
    now, best = bic(search, chosen), (np.inf, list(chosen), list[Hypothesis]())
    # a drift alone is as good as half a wave; one beside events may be a part of what wanders
    bare = [i for i in steady if i not in timed] if events else steady
    trials = [bare, *([*steady, *kept] for kept in ((), *((e,) for e in events), tuple(events)))]
    for with_them in trials:
        gain, found = _likeliest(search.test.given(columns_of(search, with_them)), courses)
        value = bic(search, with_them) + gain - LIKELIER * (len(with_them) < len(chosen))
        if found and value < best[0]:
            best = value, with_them, found
    if best[0] >= now:
        return search, chosen
    first = len(search.hypotheses)
    wider = replace(search, hypotheses=(*search.hypotheses, *best[2]))
    left = [*(i for i in best[1] if i not in timed or i in events),
            *range(first, first + len(best[2]))]
    return wider, _standing(wider, left)


def _standing(search: Search, chosen: Sequence[int]) -> tuple[int, ...]:
    """Return what reaches the naming threshold beside the others, the weakest out first."""
    left = list(chosen)
    while left:
        values = [own_log_p(search, left, i) + search.hypotheses[i].choices for i in left]
        weakest = int(np.argmax(values))
        if values[weakest] <= search.name and possible(search, left):
            break
        left.pop(weakest)
    return tuple(left)


def _likeliest(rest: AddedVariableTest, courses: Sequence[Hypothesis]
               ) -> tuple[float, list[Hypothesis]]:
    """Return the courses that the rows ask for, and what they change in BIC.

    Their waves have a normal prior, smooth as a Matern process (5/2) is; minus twice the marginal
    likelihood with sigma taken out stands for BIC (Rasmussen & Williams 2006, 5.4.1).
    """
    ways = {c.part: c for c in courses if c.size == max(COURSES)}
    columns = np.array([c for h in ways.values() for c in h.columns], dtype=np.int64)
    gram, right = rest.block(columns, columns), rest.right[columns]
    place = {way: n * max(COURSES) + np.arange(max(COURSES)) for n, way in enumerate(ways)}

    def trials(priors: Mapping[str, Array], way: str) -> list[tuple[float, str, Array]]:
        at = np.concatenate([place[w] for w in (*priors, way)])
        size = np.stack([np.concatenate([*priors.values(), own]) for own in _priors()])
        found = _evidence(gram[np.ix_(at, at)], right[at], size, rest)
        return [(float(v), way, own) for v, own in zip(found, _priors(), strict=True)]

    priors: dict[str, Array] = {}
    value = 0.0
    cost = ANONYMOUS + 2.0 * np.log(max(len(ways), 1))
    while len(priors) < MOST:
        best = min((t for way in ways if way not in priors for t in trials(priors, way)),
                   key=lambda t: t[0], default=(np.inf, "", np.zeros(0)))
        if best[0] + cost * (len(priors) + 1) >= value:
            break
        value = best[0] + cost * (len(priors) + 1)
        priors[best[1]] = best[2]
    return value, [_long_enough(rest, [c for c in courses if c.part == way]) for way in priors]


@cache
def _priors() -> list[Array]:
    """Return standard deviations of the waves, for every length and size."""
    wave = np.pi * np.arange(1, max(COURSES) + 1)
    out = []
    for length in LENGTHS:
        density = (1.0 + (length * wave) ** 2 / 5.0) ** -3.0
        out += [size * np.sqrt(density / density.sum()) for size in SIZES]
    return out


def _evidence(gram: Array, right: Array, size: Array, rest: AddedVariableTest) -> Array:
    """Return minus twice the log marginal likelihood of waves, less that of none (P,).

    ``gram`` (w, w), ``right`` (w,): of their columns; ``size`` (P, w): their standard deviations.
    """
    root = linalg.cholesky(np.eye(right.size) + size[:, :, None] * gram * size[:, None, :])
    gone = np.sum(linalg.solve(root, (size * right)[..., None]) ** 2, axis=(1, 2))
    left = np.maximum(1.0 - gone / rest.square, 1e-9)
    lost = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.asarray(lost + rest.freedom * np.log(left))


def _long_enough(rest: AddedVariableTest, courses: Sequence[Hypothesis]) -> Hypothesis:
    """Return the course of one way with as many waves as BIC asks for."""
    n = rest.freedom
    return min(courses, key=lambda c: n * np.log(max(1.0 - float(rest.explained(np.array(
        [c.columns]))[0][0]) / rest.square, 1e-9)) + c.size * np.log(n))
