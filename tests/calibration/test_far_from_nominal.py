"""Sizes that no machine within its tolerances has are told, and hardly ever those that one has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import bdtrc

import ppmcal
from ppmcal.calibration.fit.noise_estimate import FAILED_NOISE
from ppmcal.calibration.knowledge.parameter_estimates import (
    FAR,
    IMPLAUSIBLE,
    expected_errors,
    farthest,
)
from ppmcal.model.mechanism import Mechanism

OFFSET = "leg2.offset"


@pytest.fixture(scope="module")
def stage() -> Mechanism:
    return ppmcal.load(ppmcal.shipped("3-RPR"))


def data(stage: Mechanism, errors: dict[str, Any], seed: int = 1, sigma: float = 0.01
         ) -> Any:
    return ppmcal.simulate(stage, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 500, "y": 260, "rz": 25},
                             "half_range": {"x": 70, "y": 70, "rz": 8}, "count": 12}},
        "errors": errors, "frame": {"x": 5, "y": -3, "rz": 10}, "seed": seed,
        "instrument": {"kind": "pose", "sigma": {"position": sigma, "rotation": 0.2 * sigma}}}).data


def tolerance(stage: Mechanism, name: str) -> float:
    return float(stage.parameters[stage.names.index(name)].tolerance or np.nan)


@pytest.mark.parametrize(("times", "sigma", "part"), [(6.0, 0.03, 0.52), (9.0, 0.01, 0.75)])
@pytest.mark.slow_cases("9.0-0.01-0.75")
def test_a_size_that_no_machine_has_is_told_with_its_tolerance(
        stage: Mechanism, times: float, sigma: float, part: float) -> None:
    """What data as good as these show of an error of a drive: far from what refuses, and told.

    All rows are right, and none is left out because the tolerances do not explain it.
    """
    tau = tolerance(stage, OFFSET)
    rows = data(stage, {OFFSET: 1e3 * times * tau}, sigma=sigma)
    result = ppmcal.identify(stage, rows, holdout=0)
    (e,) = (e for e in result.identification.estimates if e.name == OFFSET)
    assert all(keep.all() for keep in result.identification.fit.keep)
    assert e.far and e.error / tau == pytest.approx(part * times, rel=0.1)
    assert e.error / tau < IMPLAUSIBLE
    (said,) = (f for f in result.findings if FAR in f)
    assert f"{OFFSET} by {e.error / tau:.2g} times its tolerance of {1e3 * tau:g} mm" in said
    # the least that a machine within its tolerance would never show needs no more words
    seen = f"and these data would show only {1e3 * (e.expected or 0.0):.2g}"
    assert (seen in said) == (e.error / tau < farthest(1))
    flags = {p.name: p.far for p in result.record.parameters}
    assert flags[OFFSET] and flags["leg1.platform.point.angle"] is None


@pytest.mark.parametrize("prior", ["tolerances", "flat"])
def test_an_estimate_is_judged_by_what_such_data_find(stage: Mechanism, prior: str) -> None:
    """Pulled to nominal it finds less than a tolerance, without a prior noise comes on top."""
    result = ppmcal.identify(stage, data(stage, {"random": {"scale": 1.0}}), prior=prior,
                             holdout=0)
    sign = -1.0 if prior == "tolerances" else 1.0
    fit = result.identification.fit
    found = dict(zip(fit.problem.free, expected_errors(fit), strict=True))
    judged = 0
    for p, e in enumerate(result.identification.estimates):
        if e.status == "identified" and e.sigma and e.tolerance and np.isfinite(e.tolerance):
            square = e.tolerance**2 + sign * e.sigma**2
            assert found[p] == pytest.approx(np.sqrt(square), rel=1e-3)
            judged += 1
    assert judged > 5


@pytest.mark.long
def test_machines_within_their_tolerances_are_hardly_ever_told(stage: Mechanism) -> None:
    """Of 20 more than one has a chance below 1e-3; what they find is as large as expected."""
    told, away = 0, []
    for seed in range(20):
        rows = data(stage, {"random": {"scale": 1.0}}, 100 + seed)
        result = ppmcal.identify(stage, rows, holdout=0)
        told += any(FAR in f for f in result.findings)
        away += [e.error / e.expected for e in result.identification.estimates if e.expected]
    assert bdtrc(1, 20, FAILED_NOISE) < 1e-3
    assert told <= 1
    assert np.sqrt(np.mean(np.square(away))) == pytest.approx(1.0, abs=0.1)
