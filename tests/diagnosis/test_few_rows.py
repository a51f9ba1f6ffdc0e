"""Residuals far above the stated noise are never "nothing missing", however few the rows."""

from __future__ import annotations

from dataclasses import replace

import hidden
import pytest

from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.inference.priors import SURE_SIGMAS

TIMES = 4.9


def small_campaign(seed: int, times: float) -> Diagnosis:
    """Sixteen rows of a planar machine, their noise stated ``times`` too small."""
    made = hidden.campaign("3-RPR", seed, [], hidden.Options(poses=8))
    data = replace(made.dataset, sigma_position=made.dataset.sigma_position / times,
                   sigma_rotation=made.dataset.sigma_rotation / times)
    return diagnose(
        Problem(made.mechanism, (data,), made.mechanism.free), DiagnosisOptions()
    )


@pytest.mark.long
def test_too_small_a_sigma_is_not_nothing() -> None:
    result = small_campaign(2, TIMES)
    assert result.start.ratio > 2.5
    assert not result.remainder.adequate
    assert result.verdict != "none"


@pytest.mark.slow
def test_noise_as_stated_is_not_too_much() -> None:
    """The other side of the same rule: the excess of noise as stated stays below its limit."""
    assert small_campaign(2, 1.0).remainder.excess < SURE_SIGMAS
