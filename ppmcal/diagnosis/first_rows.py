"""The first rows of a file, before which nobody knows where a play stood.

Until a joint has crossed its play the rows may be off by half a width, all alike: a step at the
row where it has, which would be taken for an event. Where a fit has such an effect and these rows
are not as it says, they are left out, and everything is asked again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ppmcal.calibration.fit import Fit, Problem
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import setting
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset, Environment
from ppmcal.model.effects import EffectKind
from ppmcal.model.mechanism import Effect

FEWEST = 3
"""Fewer rows than an event needs before it do no harm."""
MOST = 0.25
"""Not more than this part of a file: what has not settled by then never does."""
PART = 0.5
"""A row's start is unknown where it may change du by this part of its RMS over the file."""
LEVEL = 0.01
"""The first rows are as the model says unless chance takes them so far from it this rarely."""
REASON = "where the play stood is not known here: no move yet has crossed it"


def without_first_rows(problem: Problem, fit: Fit) -> Problem:
    """Return the problem without the first rows in which an effect of ``fit`` has not settled.

    Args:
        problem: all rows.
        fit: of some of its rows, with the effects that were found.

    The problem itself where these rows are too few to matter, or are as the model says.
    """
    if all(e.kind.unsettled is None for e in fit.problem.mechanism.effects):
        return problem
    first = [mask if FEWEST <= mask.sum() <= MOST * mask.size else np.zeros_like(mask)
             for mask in _first(problem, fit)]
    if not any(mask.any() for mask in first) or not _strange(fit):
        return problem
    return replace(problem, given=None, datasets=tuple(
        d.without(mask, REASON) if mask.any() else d
        for d, mask in zip(problem.datasets, first, strict=True)))


def _first(problem: Problem, fit: Fit) -> list[Bools]:
    """Return the rows (N,) of each data set in which an effect of ``fit`` has not settled."""
    model = Model(fit.problem.mechanism, fit.state.g)
    memory = [e for e in fit.problem.mechanism.effects if e.kind.unsettled is not None]
    return [np.any([_unsettled(model, e, data, rows) for e in memory], axis=0)
            for data, rows in zip(problem.datasets, problem.environments, strict=True)]


def _strange(fit: Fit) -> bool:
    """Whether a fit does not explain its first rows, or has an event at their end."""
    mechanism, first = fit.problem.mechanism, _first(fit.problem, fit)
    onsets = [fit.state.g[e.parameters[e.kind.onset]] for e in mechanism.effects if e.kind.onset]
    for mask, out, rows in zip(first, fit.outliers, fit.problem.environments, strict=True):
        if (mask & out).any():
            return True
        ends = rows.row[mask].max(initial=-np.inf) + FEWEST
        if any(rows.row[mask].min(initial=np.inf) <= at <= ends for at in onsets):
            return True
    used = [mask & keep for mask, keep in zip(first, fit.keep, strict=True)]
    chunks = list(fit.problem.rows(fit.state, False, used))
    square = sum(float(np.sum(c.residual[c.observed] ** 2)) for c in chunks)
    count = sum(int(c.observed.sum()) for c in chunks)
    return count > 0 and bool(chdtrc(count, square / fit.noise_factor**2) < LEVEL)


def _unsettled(model: Model, effect: Effect, data: Dataset, rows: Environment) -> Bools:
    """Return the rows (N,) in which an effect is not known."""
    kind: EffectKind = effect.kind
    assert kind.unsettled is not None
    at = setting(model, rows, data.q, np.full((len(data), 8), np.nan))
    values = {name: float(model.parameters[p]) for name, p in effect.parameters.items()}
    on = np.array(effect.on)
    unknown = kind.unsettled(at, on, values)
    shift = kind.evaluate(at, on, values).shift.slots
    size = np.zeros_like(unknown)
    for (limb, _), du in shift.items():
        size[:, at.limbs[limb].actuator] = du
    return np.asarray((unknown > PART * _rms(size)).any(axis=1))


def _rms(size: Array) -> Array:
    """Return the RMS of each column's known rows (k,)."""
    known = np.where(np.isfinite(size), size, 0.0)
    return np.asarray(np.sqrt(np.mean(known**2, axis=0)))
