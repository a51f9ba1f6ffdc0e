"""The machine under each set of effects that the data cannot tell from the named one, fitted.

Two effects that look alike in the measurements can send a machine to different places: a scale
error of the instrument is none of the machine, a gain of its drives is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.compensation import Reading
from ppmcal.calibration.fit import Fit, FitOptions, bounded
from ppmcal.calibration.knowledge import registered
from ppmcal.diagnosis.effect_sets import effect_sets
from ppmcal.diagnosis.extended_model import with_named
from ppmcal.diagnosis.refit import MOST_STEPS, with_mechanism
from ppmcal.diagnosis.rivals import Rival
from ppmcal.diagnosis.stage import Stage
from ppmcal.errors import PpmcalError
from ppmcal.model.mechanism import Mechanism


def other_models(
    whole: Fit, stage: Stage, rivals: Mapping[int, Sequence[Rival]], options: FitOptions
) -> tuple[Reading, ...]:
    """Return the machine under each other set of effects, and last without effects.

    Args:
        whole: the fit of all rows without effects.
        stage: where the effects were chosen.
        rivals: by named hypothesis; sets that cannot be fitted are left out, those whose fit was
            given up, and those at whose fit an effect is beyond its physical range: no machine is
            so, and none is commanded so.
        options: of the fits, which share the steps of one.
    """
    out = []
    with bounded(MOST_STEPS):
        for other in effect_sets(stage, rivals):
            named = [i for i in other.chosen if not other.search.hypotheses[i].anonymous]
            try:
                mechanism, _ = with_named(whole.problem.mechanism, other.search, named)
                fit = with_mechanism(whole, mechanism, options) if named else whole
            except PpmcalError:
                continue
            if (named and not fit.converged) or beyond_physics(fit):
                continue
            out.append(Reading(other.effect, other.instead, other.odds, fitted(fit), other.labels))
    return (*out, Reading("", "", 1.0, fitted(whole)))


def beyond_physics(fit: Fit) -> bool:
    """Whether an effect that a fit was free to size has a value outside its physical range."""
    mechanism, free = fit.problem.mechanism, set(fit.problem.free)
    return any(
        not spec.low <= fit.state.g[effect.parameters[spec.name]] <= spec.high
        for effect in mechanism.effects for spec in effect.kind.parameters(mechanism.motion)
        if effect.parameters[spec.name] in free)


def fitted(fit: Fit) -> Mechanism:
    """Return the machine at the fitted values, with the registrations."""
    mechanism = fit.problem.mechanism.with_values(fit.state.g)
    return replace(mechanism, home_q=np.full_like(mechanism.home_q, np.nan), registrations={
        **mechanism.registrations, **registered(fit.problem, fit.state)})
