"""A machine as a fit has it, and whether there is one such."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.knowledge import registered
from ppmcal.model.mechanism import Mechanism


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
