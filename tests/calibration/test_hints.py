"""A finding says what to do about it, where something can be done."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from helpers.campaigns_in_files import run
from helpers.paths import ROOT

import ppmcal
from ppmcal.io import read_mechanism, read_scenario


def campaign(seed: int = 3) -> tuple[Any, Any]:
    mechanism = read_mechanism(ROOT / "configs" / "3-RPR.yaml")
    scenario = read_scenario(ROOT / "configs" / "scenarios" / "3-RPR.yaml", mechanism)
    return mechanism, run(mechanism, scenario, seed).data


def finer(data: Any, name: str = "day") -> Any:
    """Return the data with a noise stated a hundredth of what it is."""
    return replace(data, name=name, sigma_position=data.sigma_position / 100.0,
                   sigma_rotation=data.sigma_rotation / 100.0)


@pytest.mark.slow_cases("sessions", "model", "noise")
@pytest.mark.parametrize(("given", "options", "found", "hint"), [
    (lambda d: [finer(d)], {}, "times the stated noise", "--sigma estimated"),
    (lambda d: [finer(d)], {}, "times the stated noise", "`ppmcal diagnose`"),
    (lambda d: [d], {"iterations": 1, "keep_outliers": True}, "had not converged",
     "--iterations"),
    (lambda d: [d], {"method": "damped", "iterations": 2}, "the fit was stopped",
     "--method prior"),
    (lambda d: [replace(d, name="one"), replace(campaign(4)[1], name="two")], {},
     "sessions disagree", "`ppmcal compare`")],
    ids=["noise", "model", "iterations", "damped", "sessions"])
def test_identify_says_what_to_do(given: Any, options: dict[str, Any], found: str, hint: str
                                  ) -> None:
    mechanism, data = campaign()
    told = [f for f in ppmcal.identify(mechanism, given(data), **options).findings if found in f]
    assert told and all(hint in f for f in told)


@pytest.mark.slow
def test_validate_says_what_to_do() -> None:
    mechanism, data = campaign()
    model = ppmcal.identify(mechanism, [data])
    own = [f for f in ppmcal.validate(model, [data]).findings if "was fitted to" in f]
    assert own and all("rows that no fit has seen" in f for f in own)
