"""The first rows of a file, in which the state of a play is still unknown.

Until a joint has crossed its play, all its rows may be off by the same amount, up to half a width.
The inference has columns for it; the model does not, so its fit leaves these rows out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit, FitOptions
from ppmcal.diagnosis.refit import near
from ppmcal.inference.priors import MOST_GROSS, UNSETTLED
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import setting
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset, Environment
from ppmcal.model.mechanism import Effect

REASON = "the state of the play is unknown here: no move has crossed it yet"


def without_first_rows(fit: Fit, options: FitOptions) -> Fit:
    """Return a fit without the first rows, in which one of its effects has not settled.

    An effect that has not settled in a quarter of a file never does: such a file keeps its rows.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.fit.identify`.
    """
    problem = fit.problem
    model = Model(problem.mechanism, fit.state.g)
    memory = [e for e in problem.mechanism.effects if e.kind.unsettled is not None]
    first = [np.any([np.zeros(len(data), dtype=bool),
                     *(_unsettled(model, e, data, rows) for e in memory)], axis=0)
             for data, rows in zip(problem.datasets, problem.environments, strict=True)]
    first = [mask & (mask.mean() <= float(MOST_GROSS)) for mask in first]
    if not any(mask.any() for mask in first):
        return fit
    settled = tuple(d.without(mask, REASON) if mask.any() else d
                    for d, mask in zip(problem.datasets, first, strict=True))
    return near(replace(problem, datasets=settled, given=None), fit.state, options)


def _unsettled(model: Model, effect: Effect, data: Dataset, rows: Environment) -> Bools:
    """Return the rows (N,) in which the state of an effect is unknown."""
    kind = effect.kind
    assert kind.unsettled is not None
    at = setting(model, rows, data.q, np.full((len(data), 8), np.nan))
    values = {name: float(model.parameters[p]) for name, p in effect.parameters.items()}
    on = np.array(effect.on)
    unknown = kind.unsettled(at, on, values)
    size = np.zeros_like(unknown)
    for (limb, _), du in kind.evaluate(at, on, values).shift.slots.items():
        size[:, at.limbs[limb].actuator] = du
    return np.asarray((unknown > UNSETTLED.value * _rms(size)).any(axis=1))


def _rms(size: Array) -> Array:
    """Return the RMS of each column's known rows (k,)."""
    known = np.where(np.isfinite(size), size, 0.0)
    return np.asarray(np.sqrt(np.mean(known**2, axis=0)))
