"""Waves that turn more often along a stroke than there are poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.rounds import last_round
from hidden import Options, hide

from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.unknown_causes import UnknownCauses

FINE = "a function of travel too fine to resolve acting on "
SCATTER = "a scatter from row to row acting on "


def found(period: float) -> Round:
    """Return what is found where leg 1 is off by 5 sigma once per period; its stroke is 0.2 m."""
    hidden = hide("3-RPR", 7, [], 1.0, Options(poses=40), "all")
    q = hidden.dataset.q.copy()
    q[:, 0] += 5.0 * hidden.dataset.sigma_position.min() * np.sin(2.0 * np.pi * q[:, 0] / period)
    return last_round(hidden.mechanism, replace(hidden.dataset, q=q))


@pytest.mark.long
def test_a_screw_of_a_standard_lead_is_named() -> None:
    """Poses are not evenly spaced: they tell 100 turns from all that are fewer."""
    place, = found(0.002).places
    assert place.named and place.hypothesis is not None
    assert (place.hypothesis.kind, place.hypothesis.on) == ("periodic", ("leg1",))
    assert place.hypothesis.constants["period"] == pytest.approx(0.002, rel=1e-3)


@pytest.mark.slow
def test_a_pitch_that_nobody_listed_is_not_waves_of_other_periods() -> None:
    place, = found(0.0017).places
    assert place.label == FINE + "leg1"
    assert not place.named


@pytest.mark.slow
@pytest.mark.parametrize("visits", [1, 2])
def test_scatter_of_one_joint_is_no_waves_and_shifts_of_its_zero(visits: int) -> None:
    """Many of them explain any values of a joint, if nothing else may."""
    hidden = hide("3-RPR", 7, [], 1.0, Options(poses=50), "all")
    data = hidden.dataset
    if visits == 1:
        data = data.take(np.unique(data.groups, return_index=True)[1])
    scatter = np.abs(np.random.default_rng(1).normal(size=len(data)))
    q = data.q.copy()       # a campaign is made once, for all tests
    q[:, 1] += 20.0 * data.sigma_position.min() * scatter
    place, = last_round(hidden.mechanism, replace(data, q=q)).places
    assert place.label == SCATTER + "leg2"
    assert not place.named


@pytest.mark.parametrize("visits", [1, 2])
def test_what_is_visited_twice_or_seen_in_several_numbers_tells_a_joint_from_noise(
        visits: int) -> None:
    hidden = hide("3-RPR", 7, [], 1.0, Options(poses=30), "all")
    problem = Problem(hidden.mechanism, (hidden.dataset,), hidden.mechanism.free)
    fit = identify(with_whole_rows(problem), FitOptions())
    system = build(fit.problem, fit.state, fit.keep)
    first = np.unique(system.group, return_index=True)[1]
    keep = np.isin(np.arange(len(system.group)), first) if visits == 1 else fit.keep[0]
    system = build(fit.problem, fit.state, [keep])
    found = [c.label for c in UnknownCauses(system, [p.setting for p in system.firsts]).causes
             if c.label.startswith((FINE, SCATTER))]
    legs = ("leg1", "leg2", "leg3")
    fine = [FINE + leg for leg in (*legs, " ".join(legs))] if visits == 2 else []
    assert found == [*fine, *(SCATTER + leg for leg in legs)]
