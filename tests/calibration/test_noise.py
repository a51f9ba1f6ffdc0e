"""Noise that is stated ten times too small: what is known after the fit, and what is written."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import hidden
import numpy as np
import pytest
from helpers.posteriors import sigma_of

from ppmcal.calibration.fit.fit_result import FitOptions, posterior
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import _scaled
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.sessions.change_detection import posterior_of
from ppmcal.calibration.validation.summary import Identification, report
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.knowledge import read_knowledge, read_posterior

TIMES = 10.0
METHOD = FitOptions(robust=False)


@cache
def problem(times: float) -> Problem:
    """Thirty rows of a platform, their noise stated ``times`` too small."""
    made = hidden.campaign("6-UPS", 2, [], hidden.Options(poses=15, sigma=(1e-4, 2e-4)))
    data = _scaled((made.dataset,), np.array([1.0 / times]))
    return Problem(made.mechanism, data, made.mechanism.free)


@cache
def found(times: float) -> Identification:
    return report(identify(problem(times), METHOD), METHOD, 0.0, 0)


@pytest.mark.slow
def test_no_parameter_is_less_certain_than_its_tolerance() -> None:
    result = found(TIMES)
    assert result.noise.failed
    assert result.inflation == pytest.approx(TIMES, rel=0.2)
    free = [e for e in result.estimates if e.status != "fixed"]
    assert len(free) > 40
    for e in free:
        assert e.sigma is not None
        assert e.tolerance is not None
        assert e.sigma <= e.tolerance * (1.0 + 1e-9), e.name


@pytest.mark.slow
def test_it_is_the_fit_with_the_noise_that_the_residuals_show() -> None:
    """Values and uncertainties are those of a campaign that states that noise to begin with."""
    result = found(TIMES)
    noise = result.inflation / TIMES
    data = _scaled(problem(1.0).datasets, np.array([noise]))
    fit = identify(replace(problem(1.0), datasets=data), METHOD)
    wanted = np.sqrt(np.diagonal(posterior(fit)))
    for c, p in enumerate(fit.problem.free):
        e = result.estimates[p]
        assert e.sigma == pytest.approx(wanted[c], rel=1e-4), e.name
        assert abs(e.value - fit.state.g[p]) < 1e-3 * wanted[c], e.name
    assert np.sqrt(np.diagonal(result.covariance)) == pytest.approx(wanted, rel=1e-4)


@pytest.mark.slow
def test_what_is_written_says_the_same(tmp_path: Path) -> None:
    """compensate, compare and --keep read one covariance out of identification.json."""
    result = found(TIMES)
    name = result.fit.problem.datasets[0].source
    record = IdentificationRecord.of(result, {"inputs": {name: "0" * 64}}, "prior")
    path = tmp_path / "identification.json"
    path.write_text(record.text(), encoding="utf-8")
    count = len(result.fit.problem.free)
    sigma = np.sqrt(np.diagonal(result.covariance))[:count]
    assert np.sqrt(np.diagonal(read_knowledge(path, result.mechanism).covariance))[:count] == (
        pytest.approx(sigma, rel=1e-9))
    read = read_posterior(path, result.mechanism)
    for one in (read, posterior_of(result.fit)):
        assert one.inflation == pytest.approx(result.inflation)
        assert sigma_of(one) == pytest.approx(sigma, rel=1e-3)
