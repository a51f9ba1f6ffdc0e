"""What a day is judged by: the noise as stated, or as the day itself shows it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal as command

import ppmcal
from ppmcal.calibration.sessions.day_noise import (
    REPEATS,
    RESIDUALS,
    STATED,
    day_noise,
    with_day_noise,
)
from ppmcal.calibration.validation.frozen_models import FrozenModel, validated
from ppmcal.io import write_mechanism

SIGMA = 5e-6


def scenario(seed, **more):
    return {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": {"center": {"x": 500, "y": 260, "rz": 25},
                                 "half_range": {"x": 70, "y": 70, "rz": 8}, "count": 40}},
            "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
            "frame": {"x": 5, "y": -3, "rz": 10}, "target": [1, 2], "seed": seed} | more


@pytest.fixture(scope="module")
def stage():
    return ppmcal.load(ppmcal.shipped("3-RPR"))


@pytest.fixture(scope="module")
def day(stage):
    return ppmcal.simulate(stage, scenario(5)).data[0]


@pytest.fixture(scope="module")
def bent(stage):
    """A day of a machine whose drives are curved, ten times the noise."""
    curved = [{"kind": "curvature", "on": ["leg1", "leg2", "leg3"],
               "parameters": {"p2": 0.3, "p3": 0.2, "p4": 0.1}}]
    return ppmcal.simulate(stage, scenario(6, effects=curved)).data[0]


def test_right_noise_stays_as_stated(stage, day):
    found = day_noise([stage], day)
    assert (found.source, found.factor) == (STATED, 1.0)
    assert found.sigma == pytest.approx(SIGMA, rel=1e-6)


@pytest.mark.parametrize("times", [8.0, 0.2])
def test_noise_that_only_begins_an_estimate_is_found(stage, day, times):
    began = replace(day.noisier(times), estimated=True)
    found = day_noise([stage], began)
    assert found.source == RESIDUALS
    # 3 x 40 values less what is fitted, and five that count as what the estimate begins with
    values = 3 * 40 - len(stage.free) - 6
    expected = SIGMA * np.sqrt((values + 5 * times**2) / (values + 5))
    assert found.sigma == pytest.approx(expected, rel=0.15)


def test_noise_stated_far_too_large_gives_way(stage, day):
    found = day_noise([stage], day.noisier(8.0))
    assert found.source == RESIDUALS and found.sigma == pytest.approx(SIGMA, rel=0.15)


@pytest.mark.slow
def test_what_a_model_misses_is_no_noise(stage, bent):
    """Curved drives leave much more than the noise, which is stated rightly."""
    found = day_noise([stage], bent)
    assert (found.source, found.factor) == (STATED, 1.0)
    began = day_noise([stage], replace(bent, estimated=True))
    assert began.factor > 2.0    # one visit of each pose does not tell one from the other


@pytest.mark.slow
def test_repeats_tell_what_noise_is_and_what_the_model_misses(stage, bent):
    curved = [{"kind": "curvature", "on": ["leg1", "leg2", "leg3"],
               "parameters": {"p2": 0.3, "p3": 0.2, "p4": 0.1}}]
    data = ppmcal.simulate(stage, scenario(7, effects=curved, repeats=3)).data[0]
    for given in (replace(data, estimated=True), data.noisier(0.2)):
        found = day_noise([stage], given)
        assert found.source == REPEATS
        assert found.sigma == pytest.approx(SIGMA, rel=0.15)


def test_a_day_that_cannot_be_fitted_keeps_its_noise(stage, day):
    found = day_noise([stage], replace(day.take(np.arange(2)), estimated=True))
    assert (found.source, found.factor) == (STATED, 1.0)


@pytest.mark.slow
def test_what_data_demand_rests_on_the_noise_of_the_day(stage, day):
    """Zeros moved by some 0.02 mm; the file begins with noise eight times too large."""
    shifted = replace(day.noisier(8.0), estimated=True, q=day.q + np.array([16e-6, -16e-6, 24e-6]))
    (blind,) = validated([FrozenModel("model", stage)], [shifted])
    assert blind.demanded == ()
    result = ppmcal.validate(stage, [shifted])
    assert result.validated[0].demanded == ("homing",)
    assert result.record.datasets[0].judged_by == RESIDUALS
    assert result.validated[0].errors[0].noise < 1.0
    days, _ = with_day_noise([stage], [shifted], [])
    assert not days[0].estimated


@pytest.mark.slow
def test_the_console_prints_the_noise_with_its_source(tmp_path):
    printer = ppmcal.load(ppmcal.shipped("delta-linear"))
    bed = ppmcal.simulate(printer, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 0, "y": 0, "z": 1e3 * printer.home_pose[2]},
                             "half_range": {"x": 60, "y": 60, "z": 0}, "count": 40}},
        "instrument": {"kind": "plane", "sigma": {"height": 0.005}}, "frame": "known", "seed": 4})
    bed.save(tmp_path / "bed")
    (table,) = (tmp_path / "bed").glob("*.csv")
    sidecar = table.with_suffix(".yaml")
    tree = yaml.safe_load(sidecar.read_text(encoding="utf-8"))
    tree["instrument"]["sigma"] = {"height": 0.04, "estimated": True}
    sidecar.write_text(yaml.safe_dump(tree), encoding="utf-8")
    (tmp_path / "machine.yaml").write_text(write_mechanism(printer, "x"), encoding="utf-8")
    ran = command("validate", "machine.yaml", str(table), cwd=tmp_path, expect=None)
    told = " ".join((ran.out + ran.err).split())
    assert "estimated from what a fit of that day alone leaves (its sidecar: 0.04 mm)" in told
    record = json.loads((tmp_path / "validated" / "validation.json").read_text(encoding="utf-8"))
    noise = record["datasets"][0]["noise"]
    assert noise["source"] == RESIDUALS and noise["stated"] == pytest.approx(0.04)
    # 40 values against the five that the 0.04 count as, of which the fit takes some
    assert 0.003 < noise["value"] < 0.02
