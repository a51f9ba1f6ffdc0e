"""The first rows of a file, before which nobody knows where a play stood.

Until a joint has crossed its play the rows may be off by half a width, all alike: a step at the
row where it has, which would be taken for an event. Once a fit has such an effect these rows are
left out, and everything is asked again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.problem import Problem
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
REASON = "{} is not known before the first moves"


def without_first_rows(problem: Problem, fit: Fit) -> Problem:
    """Return the problem without the first rows in which an effect of ``fit`` has not settled.

    Args:
        problem: all rows.
        fit: of some of its rows, with the effects that were found.

    The problem itself where these rows are too few to matter.
    """
    mechanism, g = fit.problem.mechanism, fit.state.g
    memory = [e for e in mechanism.effects if e.kind.unsettled is not None]
    if not memory:
        return problem
    model = Model(mechanism, g)
    datasets = list(problem.datasets)
    for i, (data, rows) in enumerate(zip(problem.datasets, problem.environments, strict=True)):
        for effect in memory:
            first = _unsettled(model, effect, data, rows)
            if FEWEST <= first.sum() <= MOST * len(data):
                datasets[i] = datasets[i].without(first, REASON.format(effect.kind.label))
    if all(a is b for a, b in zip(datasets, problem.datasets, strict=True)):
        return problem
    return replace(problem, datasets=tuple(datasets), given=None)


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
