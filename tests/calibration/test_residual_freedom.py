"""How many degrees of freedom residuals have where rank and prior hold columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ppmcal
from ppmcal.calibration.fit.added_columns import added_columns
from ppmcal.calibration.fit.fit_result import FitOptions, residual_freedom, values_fitted
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.gauss_newton import linearised
from ppmcal.calibration.fit.homing_shift import _fitted, _sessions
from ppmcal.calibration.fit.problem import Problem
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

SEEDS = 12


@pytest.fixture(scope="module")
def hexapod() -> Mechanism:
    return ppmcal.load(ppmcal.shipped("6-UPS"))


@pytest.fixture(scope="module")
def fits(hexapod: Mechanism) -> list:
    """Twenty poses each of machines drawn from the tolerances: 120 values, 51 columns."""
    return [identify(Problem(hexapod, (campaign(hexapod, seed),), hexapod.free),
                     FitOptions(robust=False)) for seed in range(SEEDS)]


def campaign(hexapod: Mechanism, seed: int) -> Dataset:
    home = {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0}
    data: Dataset = ppmcal.simulate(hexapod, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": home, "half_range": {
            "x": 100, "y": 100, "z": 100, "rx": 8, "ry": 8, "rz": 8}, "count": 20}},
        "errors": {"random": {"scale": 1.0}},
        "frame": {"x": 5, "y": -3, "z": 2, "rx": 0, "ry": 0, "rz": 1},
        "instrument": {"kind": "pose", "sigma": {"position": 0.05, "rotation": 0.01}},
        "seed": seed}).data[0]
    return data


@pytest.mark.slow
def test_mean_square_of_residuals_over_their_freedom_is_the_noise(fits: list) -> None:
    variance = np.mean([f.information.square / residual_freedom(f) for f in fits])
    values = sum(residual_freedom(f) for f in fits)
    assert variance == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / values))
    # columns as they are would make the noise look larger than it is
    columns = np.mean([f.information.square / (f.information.count - f.scale.size) for f in fits])
    assert columns > 1.0 + 8.0 * np.sqrt(2.0 / values)


def test_values_fitted_are_the_trace_of_the_hat_matrix() -> None:
    rng = np.random.default_rng(2)
    columns, prior = rng.normal(size=(30, 5)), np.array([0.0, 0.0, 1.0, 10.0, 100.0])
    covariance = np.linalg.inv(columns.T @ columns + np.diag(prior**2))
    hat = columns @ covariance @ columns.T
    assert values_fitted(5, np.diagonal(covariance), prior) == pytest.approx(np.trace(hat))


@pytest.mark.slow
def test_both_ways_to_solve_agree(fits: list) -> None:
    fit = fits[0]
    own = fit.information.count - residual_freedom(fit)
    for by_sums in (True, False):
        small = linearised(fit.problem, fit.state, fit.keep, fit.prior, by_sums=by_sums).small
        assert values_fitted(*small.seen(), fit.prior) == pytest.approx(own, rel=1e-6)


@pytest.mark.slow
def test_noise_of_a_zero_s_shift_is_that_of_the_rows(hexapod: Mechanism) -> None:
    """With noise stated three times too small, variances are nine times as large."""
    variance = []
    for seed in range(SEEDS // 2):
        data = replace(campaign(hexapod, seed), sessions=("a", "b") * 10).noisier(1.0 / 3.0)
        fit = identify(Problem(hexapod, (data,), hexapod.free), FitOptions(robust=False))
        homed = replace(fit.problem, datasets=(replace(data, homing="alone"),))
        second = _sessions(fit.problem)[1][1][0]
        found = added_columns(fit.problem, fit.state, fit.keep, fit.prior, homed,
                              [{0: (homed.opens[0].homing, second)}])
        # residuals of no size: the noise is as stated
        quiet = replace(found, right=0.0 * found.right, away=0.0 * found.away)
        own, stated = (np.array([sigma for _, sigma, _ in _fitted(f, range(6))])
                       for f in (found, quiet))
        variance.append(np.mean((own / stated) ** 2))
    assert np.mean(variance) == pytest.approx(9.0, rel=0.2)
