"""The machine under each reading that the data cannot tell apart, fitted, for compensation.

Two effects that look alike in the measurements can send a machine to different places: a scale
error of the instrument is none of the machine, a gain of its drives is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit, FitOptions
from ppmcal.calibration.model_averaging import Reading
from ppmcal.calibration.summary import registered
from ppmcal.diagnosis.extended_model import with_named
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.rivals import Rival
from ppmcal.diagnosis.stage import Stage, named_only
from ppmcal.errors import PpmcalError
from ppmcal.model.mechanism import Mechanism

MOST = 4
"""Rivals of one effect that are fitted, the likeliest first."""


def other_models(
    whole: Fit, stage: Stage, rivals: Mapping[int, Sequence[Rival]], options: FitOptions
) -> tuple[Reading, ...]:
    """Return the machine with each rival in place of its effect, and last without effects.

    Args:
        whole: the fit of all rows without effects.
        stage: where the effects were chosen.
        rivals: by named hypothesis; those that cannot be fitted are left out.
        options: of the fits.
    """
    out = []
    for i, others in rivals.items():
        for rival in sorted(others, key=lambda r: r.odds)[:MOST]:
            search = replace(stage.search, hypotheses=(*stage.search.hypotheses, rival.hypothesis))
            chosen = [j for j in named_only(stage) if j != i] + [len(stage.search.hypotheses)]
            try:
                mechanism, _ = with_named(whole.problem.mechanism, search, chosen)
                fit = with_mechanism(whole, mechanism, options)
            except PpmcalError:
                continue
            out.append(Reading(rival.hypothesis.label, stage.hypotheses[i].label, rival.odds,
                                  fitted(fit)))
    return (*out, Reading("", "", 1.0, fitted(whole)))


def fitted(fit: Fit) -> Mechanism:
    """Return the machine at the fitted values, with the registrations."""
    mechanism = fit.problem.mechanism.with_values(fit.state.g)
    return replace(mechanism, home_q=np.full_like(mechanism.home_q, np.nan), registrations={
        **mechanism.registrations, **registered(fit.problem, fit.state)})
