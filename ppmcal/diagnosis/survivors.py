"""Which named effects would stand if what is left were explained too.

What the library lacks is imitated by what it has, and then part of it is left. Each named effect is
tested again with an anonymous shape, in the input that the rest follows, beside it: a random
effect of the likeliest size. It stands if it keeps its size there, is significant, and both are
far likelier than a larger shape alone: what only begins a series of terms for it is no cause.
It also has to predict thirds of the rows, by time and by condition, from the others.

Touches of a flat hold the flat's own shape, whatever is left: there each effect is tested with a
shape over the place beside it, unless the flat is among what it is told to be tied with.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Fit, FitOptions
from ppmcal.calibration.validation import thirds
from ppmcal.diagnosis.added_variable_test import log_p
from ppmcal.diagnosis.adequacy import Remainder, inputs
from ppmcal.diagnosis.candidates import look_alikes
from ppmcal.diagnosis.extended_model import with_named
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.imitation import left_over
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.result import Found, Survival
from ppmcal.diagnosis.rivals import LONG_ODDS
from ppmcal.diagnosis.selection import borne
from ppmcal.diagnosis.stage import Stage, explained, form_columns, named_only
from ppmcal.linalg import Array, Bools, range_basis, unit_columns

MOST_SHAPES = 24
"""Shapes in one input, for each measured coordinate; the slowest."""
SIZES = np.geomspace(0.03, 300.0, 41)
"""Of the shape, over the noise, in one value."""
KEEPS = 0.5
"""With the shape beside it an effect keeps at least this part of its size."""
PLACE = "position"
"""The input that a flat's shape follows."""
WORSE = 9.0
"""Left-out rows are surely worse predicted with an effect where their square rises by so many
times the mean square of what is left."""


@dataclass(frozen=True, eq=False)
class Earned:
    """What was found, with names that would stand only.

    ``left``: what they leave; ``each``: of the named hypotheses; ``lost``: the others.
    """

    found: Found
    final: Fit | None
    left: Remainder
    each: dict[int, Survival]
    lost: tuple[Hypothesis, ...]

    @property
    def nothing(self) -> bool:
        """Whether none of the names would stand."""
        return bool(self.each) and not any(s.stands for s in self.each.values())


def survivals(stage: Stage, left: Remainder) -> dict[int, Survival]:
    """Return for each named hypothesis whether it survives.

    Args:
        stage: of the last tests.
        left: what its effects leave.
    """
    touches = of_touches(stage)
    follows, shape = _absorber(stage, left, (PLACE,) if touches else ())
    named = named_only(stage)
    out = {}
    for i in named:
        if touches and tied_with_nuisance(stage, i):
            continue
        alone = replace(stage, chosen=tuple(j for j in named if j != i))
        basis, rest = explained(alone)
        own = form_columns(stage, stage.hypotheses[i])
        own = own - basis @ (basis.T @ own)
        value, keeps, odds = _beside(own, rest, shape - basis @ (basis.T @ shape),
                                     stage.system.count - basis.shape[1])
        value /= stage.hypotheses[i].caution
        fails = _fails(stage, stage.hypotheses[i], own, rest)
        out[i] = Survival(value, follows, keeps, odds, fails, bool(
            value <= stage.search.name and keeps >= KEEPS and odds >= np.log(LONG_ODDS)
            and not fails))
    return out


def of_touches(stage: Stage) -> bool:
    """Whether all measurements are touches of a flat."""
    return all(d.kind == "plane" for d in stage.system.problem.datasets)


def tied_with_nuisance(stage: Stage, effect: int) -> bool:
    """Whether a shape of what the machine is measured against does most of what an effect does."""
    return bool(look_alikes(stage.search, stage.library.measured_against, stage.chosen, effect))


def _absorber(stage: Stage, left: Remainder, given: Sequence[str]) -> tuple[str, Array]:
    """Return the input that the rest follows, and shapes in it (n, s) of unit size in a value.

    ``given``: the inputs, in place of those that the rest follows.
    """
    known = inputs(stage.system)
    joints = [w for w in left.follows.split() if w in known]
    names = list(given) or [left.follows] if left.follows in known else joints or [
        min(left.by_input, key=lambda k: left.by_input[k])]
    n, m = stage.system.residual.shape
    rows = []
    for name in names:
        w, v = linalg.eigh(_wandering(known[name][0]))
        top = np.argsort(-w, kind="stable")[:MOST_SHAPES]
        rows.append(v[:, top] * np.sqrt(np.maximum(w[top], 0.0)))
    shape = np.kron(np.concatenate(rows, axis=1), np.eye(m)).reshape(n * m, -1)
    return " ".join(names), shape / np.sqrt(np.mean(np.sum(shape**2, axis=1)))


def _wandering(values: Array) -> Array:
    """Return the centred kernel (N, N) of inputs (N, p) of what wanders with them, as a walk does.

    It has shapes of every fineness, slow ones most: -|x - x'|, centred (Szekely & Rizzo 2013).
    """
    spread = values.std(axis=0)
    x = (values - values.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    square = np.sum(x**2, axis=1)
    near = -np.sqrt(np.maximum(square[:, None] + square[None, :] - 2.0 * x @ x.T, 0.0))
    near -= near.mean(axis=0)
    return np.asarray(near - near.mean(axis=1, keepdims=True))


def _beside(own: Array, rest: Array, shape: Array, freedom: int) -> tuple[float, float, float]:
    """Return the log p of columns beside shapes, the part that is kept, the log odds for them.

    Generalised least squares with noise of covariance I + size^2 Z Z^T, up to a factor, at the
    likeliest size. The odds are against the shapes alone, at the size that is likeliest then.
    """
    plane = range_basis(unit_columns(own))
    w, v = linalg.eigh(shape.T @ shape)
    seen = np.concatenate([plane, rest[:, None]], axis=1)
    cross, whole = v.T @ (shape.T @ seen), seen.T @ seen
    rank, before = plane.shape[1], plane.T @ rest
    alone, best = -np.inf, (-np.inf, 0.0, 0.0)
    for size in np.append(0.0, SIZES):
        spread = 1.0 + size**2 * np.maximum(w, 0.0)
        inner = whole - (cross.T * (size**2 / spread)) @ cross
        value = linalg.pinv(inner[:-1, :-1], hermitian=True) @ inner[:-1, -1]
        square, gain = float(inner[-1, -1]), float(inner[:-1, -1] @ value)
        lost = -0.5 * float(np.sum(np.log(spread)))
        alone = max(alone, lost - 0.5 * freedom * np.log(square))
        likely = lost - 0.5 * freedom * np.log(max(square - gain, 1e-9 * square))
        if likely > best[0]:
            p = float(log_p(np.array([gain]), square, rank, freedom)[0])
            best = likely, p, float(value @ before / max(float(before @ before), 1e-300))
    return best[1], best[2], float(best[0] - 0.5 * rank * np.log(freedom) - alone)


def _fails(stage: Stage, hypothesis: Hypothesis, own: Array, rest: Array) -> str:
    """Return by what a third of the rows is surely worse predicted with the effect, if any."""
    m = stage.system.residual.shape[1]
    plane = range_basis(unit_columns(own))
    square = float(np.sum((rest - plane @ (plane.T @ rest)) ** 2)) / max(stage.system.count, 1)
    for by, mask in _thirds(stage, hypothesis):
        held = np.repeat(mask, m)
        value = linalg.lstsq(plane[~held], rest[~held], rcond=1e-6)[0]
        worse = np.sum((rest[held] - plane[held] @ value) ** 2) - np.sum(rest[held] ** 2)
        if worse > WORSE * square * plane.shape[1]:
            return by
    return ""


def _thirds(stage: Stage, hypothesis: Hypothesis) -> Iterator[tuple[str, Bools]]:
    """Yield what rows are left out by, and which (N,); an event is known from its own rows."""
    known = inputs(stage.system)
    event = hypothesis.effect is not None and bool(hypothesis.effect.onset)
    for by in ("time", "temperature", "payload"):
        if by not in known or event:
            continue
        values = np.linalg.norm(known[by][0], axis=1) if by == "payload" else known[by][0][:, 0]
        if by == "payload" and np.unique(np.round(values, 9)).size < 3:
            continue
        yield from ((by, mask) for mask in thirds(values))


def earned(found: Found, whole: Fit, final: Fit | None, left: Remainder, outliers: bool,
           seed: int, options: FitOptions) -> Earned:
    """Return what was found without the effects that would not stand, fitted again.

    Where none would stand, nothing is taken out: all of them are an imitation.

    Args:
        found: on the training rows.
        whole: fit of all rows without the effects.
        final: the same with them, None where there are none.
        left: what they leave.
        outliers: whether they leave rows that are no chance outliers.
        seed: of the tests of what is left.
        options: of the fits.
    """
    lost: list[Hypothesis] = []
    while True:
        nothing = final is None or (left.adequate and not outliers and not of_touches(found.last))
        each = {} if nothing else survivals(found.last, left)
        gone = [i for i, s in each.items() if not s.stands]
        kept = borne(found.last.search, [i for i in found.last.chosen if i not in gone])
        last = replace(found.last, chosen=tuple(kept))
        if not gone or not named_only(last):
            return Earned(found, final, left, each, tuple(lost))
        lost += [found.last.hypotheses[i] for i in named_only(found.last) if i not in kept]
        mechanism, added = with_named(whole.problem.mechanism, last.search, named_only(last))
        found = Found(found.before, with_mechanism(found.before, mechanism, options), found.first,
                      last, added)
        final = with_mechanism(whole, mechanism, options)
        left = left_over(last, seed)
