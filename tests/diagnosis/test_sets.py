"""Sets of effects and their odds, and which names would stand if the rest were explained."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import hidden
import numpy as np
import pytest

from ppmcal.api.compensate import Readings
from ppmcal.calibration.compensation.model_averaging import Reading, probabilities
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.adequacy import Remainder
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.effect_sets import effect_sets
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.diagnosis.rivals import rivals
from ppmcal.diagnosis.selection import bic
from ppmcal.diagnosis.stage import Stage
from ppmcal.diagnosis.survivors import survivals
from ppmcal.wording import rate


@cache
def campaign(machine: str, seed: int, kinds: tuple[str, ...], eta: float, poses: int) -> Problem:
    found = hidden.hide(machine, seed, list(kinds), eta, hidden.Options(poses=poses))
    return Problem(found.mechanism, (found.dataset,), found.mechanism.free)


@cache
def diagnosed(machine: str, seed: int, kinds: tuple[str, ...], eta: float = 1.5,
              poses: int = 60) -> Diagnosis:
    return diagnose(campaign(machine, seed, kinds, eta, poses), DiagnosisOptions(draws=500))


@cache
def stage() -> Stage:
    """Return the last tests of a campaign of a backlash and a gain."""
    return diagnosed("3-RPR", 1, ("backlash",), 1.5, 30).found.last


@pytest.mark.slow
def test_the_odds_of_a_set_are_those_of_its_bic() -> None:
    found = replace(stage(), search=replace(stage().search, detect=-0.5))
    sets = effect_sets(found, {i: rivals(found.search, found.chosen, i) for i in found.chosen})
    now = bic(found.search, found.chosen)
    assert sets
    for other in sets:
        assert other.odds == pytest.approx(np.exp((bic(other.search, other.chosen) - now) / 2.0))
        assert other.odds <= 1000.0
    assert [s.odds for s in sets] == sorted(s.odds for s in sets)


def test_an_effect_at_the_margin_is_in_a_set_and_a_sure_one_is_never_left_out() -> None:
    found = replace(stage(), search=replace(stage().search, detect=-0.5))
    sets = effect_sets(found, {})
    assert any(set(found.chosen) < set(s.chosen) for s in sets)
    assert all(s.effect and not s.instead for s in sets)
    assert not effect_sets(replace(found, search=replace(found.search, detect=-1e9)), {})


def test_an_effect_that_rests_on_little_is_left_out_in_one_set() -> None:
    found = stage()
    values = found.search.values(found.chosen)
    best = next(int(i) for i in np.argsort(values) if not found.hypotheses[i].anonymous)
    both = replace(found, chosen=(*found.chosen, best),
                   search=replace(found.search, detect=-1e9))
    without = [s for s in effect_sets(both, {}) if set(s.chosen) == set(found.chosen)]
    assert [s.instead for s in without] == [found.hypotheses[best].label]
    assert not any(s.instead == found.hypotheses[found.chosen[0]].label
                   for s in effect_sets(both, {}))


def test_probabilities_add_up_to_one() -> None:
    machine = campaign("3-RPR", 1, ("backlash",), 1.5, 30).mechanism
    others = [Reading("gain", "lag", 4.0, machine), Reading("", "lag", 2.0, machine)]
    assert probabilities(others) == pytest.approx([4 / 7, 1 / 7, 2 / 7])
    assert not any(r.bare for r in Readings(tuple(others), None).others)


def rest(follows: str) -> Remainder:
    return Remainder(2.0, 9.0, 1.0, "stated", follows, 1e-4, {follows: 1e-4})


def test_an_effect_of_another_input_than_the_rest_stands() -> None:
    found = stage()
    (one,) = survivals(found, rest("position")).values()
    assert one.stands and one.log_p < found.search.name and one.keeps > 0.9 and not one.fails


def test_what_only_some_rows_have_does_not_predict_the_others() -> None:
    """The backlash of the first third alone, and of the other sign in the rest."""
    found = stage()
    own = found.columns[:, list(found.hypotheses[found.chosen[0]].columns)]
    own = own - found.basis @ (found.basis.T @ own)
    value = np.linalg.lstsq(own, found.residual, rcond=None)[0]
    sign = np.where(np.arange(len(own)) < len(own) // 3, -1.5, 1.5)
    odd = replace(found, residual=found.residual + (sign - 1.0) * (own @ value))
    (one,) = survivals(odd, rest("position")).values()
    assert one.fails and not one.stands


@pytest.mark.slow
def test_a_true_effect_beside_an_unknown_one_is_named() -> None:
    found = diagnosed("delta-linear", 1, ("random_walk", "backlash"))
    assert found.verdict == "partial"
    assert [e.kind for e in found.effects] == ["backlash"] * len(found.effects)
    assert all(e.survives is not None and e.survives.stands for e in found.effects)


@pytest.mark.slow
def test_effects_that_imitate_an_unknown_one_are_not_named() -> None:
    """A frame that wanders: a drift and a shift of a joint's zero make up part of it."""
    found = diagnosed("6-UPS", 1266418396, ("random_walk",), 1.0, 90)
    assert found.verdict == "unnamed" and not found.effects
    assert {c.hypothesis.kind for c in found.possible} <= {"drift", "zero_shift"}
    assert {c.status for c in found.possible} <= {"imitation"}


def test_slow_rates_are_told_by_the_hour() -> None:
    assert rate("mm/s", 2.5e-6) == (3600.0, "mm/h")
    assert rate("mm/s", -0.5) == (1.0, "mm/s")
    assert rate("mm", 2.5e-6) == (1.0, "mm")


