"""Quantities derived from a named effect's parameters, with uncertainty: amplitude, phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.validation import Identification
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import setting
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.mechanism import Effect, joint_quantity, resolved

SMALL = 1e-3
"""Slopes are differenced over this part of a standard deviation."""


@dataclass(frozen=True)
class DerivedError:
    """A figure of one effect, SI; ``sigma`` None if unknown."""

    name: str
    quantity: str
    value: float
    sigma: float | None


@dataclass(frozen=True)
class DerivedErrors:
    """Figures of one effect, at the middle of its joints' measured stroke, m or rad."""

    middle: float
    quantity: str
    all: tuple[DerivedError, ...]


def derived(identification: Identification, parameters: Sequence[str]) -> DerivedErrors | None:
    """Return the figures that an effect's kind derives from its parameters; None if there are none.

    Args:
        identification: the fit with the effect.
        parameters: names of the effect's parameters in the model.
    """
    mechanism = identification.mechanism
    place = {n: i for i, n in enumerate(mechanism.names)}
    mine = {place[n] for n in parameters}
    effect = next((e for e in mechanism.effects if mine & set(e.parameters.values())), None)
    if effect is None or not effect.kind.derived:
        return None
    values = {n: float(mechanism.values[p]) for n, p in effect.parameters.items()}
    column = {name: c for c, name in enumerate(identification.columns)}
    fitted = {n: column[name] for n, p in effect.parameters.items()
              if (name := mechanism.names[p]) in column}
    names, at = list(fitted), list(fitted.values())
    covariance = identification.covariance[np.ix_(at, at)]
    middle, joint = _middle(identification, effect), joint_quantity(mechanism, effect.on)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).tolist()
    out = []
    for d in effect.kind.derived:
        slope = np.zeros(len(names))
        for k, (n, s) in enumerate(zip(names, sigma, strict=True)):
            up, down = (d.value({**values, n: values[n] + sign * SMALL * s}, middle)
                        for sign in (1.0, -1.0))
            change = np.remainder(up - down + np.pi, 2.0 * np.pi) - np.pi if (
                d.quantity == "angle") else up - down
            slope[k] = change / (2.0 * SMALL * s) if s > 0.0 else 0.0
        known_to = float(np.sqrt(max(float(slope @ covariance @ slope), 0.0)))
        out.append(DerivedError(d.name, resolved(d.quantity, joint), d.value(values, middle),
                          known_to if names and np.isfinite(known_to) else None))
    return DerivedErrors(middle, joint, tuple(out))


def _middle(identification: Identification, effect: Effect) -> float:
    """Return the middle of the travel of the effect's joints in the rows used, m or rad."""
    fit = identification.fit
    q = np.concatenate([ends[0] for i, keep in enumerate(fit.keep) for ends in
                        fit.problem.ends(i, fit.state, np.flatnonzero(keep))])
    travel = setting(Model(identification.mechanism), unknown_environment(*q.shape), q,
                     np.full((len(q), 8), np.nan)).travel[:, np.array(effect.on)]
    return 0.5 * float(np.nanmin(travel) + np.nanmax(travel))
