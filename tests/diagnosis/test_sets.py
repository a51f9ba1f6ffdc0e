"""Sets of effects and their odds, and names beside something that has none."""

from __future__ import annotations

from functools import cache

import hidden
import pytest

from ppmcal.calibration.compensation import Readings
from ppmcal.calibration.compensation.model_averaging import CandidateModel, probabilities
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.diagnose import diagnose
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.wording import rate


@cache
def campaign(machine: str, seed: int, kinds: tuple[str, ...], eta: float, poses: int) -> Problem:
    found = hidden.hide(machine, seed, list(kinds), eta, hidden.Options(poses=poses))
    return Problem(found.mechanism, (found.dataset,), found.mechanism.free)


@cache
def diagnosed(machine: str, seed: int, kinds: tuple[str, ...], eta: float = 1.5,
              poses: int = 60) -> Diagnosis:
    return diagnose(campaign(machine, seed, kinds, eta, poses))


def test_probabilities_add_up_to_one() -> None:
    machine = campaign("3-RPR", 1, ("backlash",), 1.5, 30).mechanism
    others = [CandidateModel("gain", "lag", 4.0, machine), CandidateModel("", "lag", 2.0, machine)]
    assert probabilities(others) == pytest.approx([4 / 7, 1 / 7, 2 / 7])
    assert not any(r.bare for r in Readings(tuple(others), None).others)


@pytest.mark.long
def test_a_true_effect_beside_an_unknown_one_is_named() -> None:
    found = diagnosed("delta-linear", 1, ("random_walk", "backlash"))
    assert found.verdict == "partial"
    assert [e.kind for e in found.effects] == ["backlash"] * len(found.effects)
    assert found.unknown and all(u.probability > 0.5 for u in found.unknown)


@pytest.mark.long
def test_odds_against_an_alternative_are_those_of_the_probabilities() -> None:
    found = diagnosed("3-RPR", 1, ("backlash",), 0.5, 30)
    for effect in found.effects:
        assert effect.probability + sum(effect.probabilities) <= 1.0 + 1e-9
        assert effect.odds == pytest.approx([effect.probability / p for p in effect.probabilities])


def test_slow_rates_are_told_by_the_hour() -> None:
    assert rate("mm/s", 2.5e-6) == (3600.0, "mm/h")
    assert rate("mm/s", -0.5) == (1.0, "mm/s")
    assert rate("mm", 2.5e-6) == (1.0, "mm")
