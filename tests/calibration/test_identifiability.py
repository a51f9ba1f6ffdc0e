"""What the data cannot identify: scale, and parameters that act as one, before and after a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.instruments import data_of, joints, truth
from helpers.paths import ROOT
from helpers.printers import ROBUST, fitted, joints_at, printer, touches

from ppmcal import algebra as cga
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge.identifiability_report import (
    CALIPER,
    identifiability,
    predict_identifiability,
)
from ppmcal.codec import in_units
from ppmcal.io import read_mechanism
from ppmcal.io.results.identification_wording import open_sentences
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import POSITION
from ppmcal.model.registration import Registration

NAME = "delta-linear"


def test_touches_leave_scale_to_the_tolerances(tmp_path: Path) -> None:
    """Before the fit and after it; rods and drives are collinear to a flat bed."""
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(1)
    g = truth(mechanism, rng)
    data = touches(mechanism, g, rng)
    ahead = predict_identifiability(Problem(mechanism, (data,), mechanism.free), "prior")
    after = identifiability(fitted(mechanism, data))
    for found in (ahead, after):
        assert found.scale is not None and found.scale.prior_dominated and found.scale.open
        assert ("length", "ratio") in [(t.one, t.other) for t in found.collinear]
    assert ahead.scale and after.scale
    assert ahead.scale.sigma == pytest.approx(after.scale.sigma, rel=0.1)
    words = " ".join(open_sentences(after.collinear, in_units(after.scale, mechanism.units)))
    assert "constrained by the prior; the data alone leave" in words and "One distance of" in words


def test_the_promised_distance_halves_it(tmp_path: Path) -> None:
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(2)
    g = truth(mechanism, rng)
    data = touches(mechanism, g, rng)
    before = identifiability(fitted(mechanism, data)).scale
    assert before is not None and before.needed < before.length
    ends = np.zeros((2, 6))
    ends[:, 0] = -before.needed / 2, before.needed / 2
    q = joints_at(mechanism, g, ends)
    one = data_of(mechanism, "distance", q[:1], q[1:], g, rng, CALIPER, False)
    one = replace(one, name="caliper", sigma_value=np.full(1, CALIPER))
    after = identifiability(fitted(mechanism, data, one)).scale
    assert after is not None
    assert after.sigma / after.length == pytest.approx(0.5 * before.sigma / before.length, rel=0.1)


@pytest.mark.long
def test_the_uncertainty_of_a_distance_is_true(tmp_path: Path) -> None:
    """Over machines drawn from the tolerances, the error of the distance has that sigma."""
    mechanism = printer(tmp_path)
    ratio = []
    for seed in range(30):
        rng = np.random.default_rng([3, seed])
        g = truth(mechanism, rng)
        data = touches(mechanism, g, rng, 30)
        fit = fitted(mechanism, data)
        found = identifiability(fit).scale
        assert found is not None
        # the two touches that lie farthest apart
        at = cga.translation(forward(Model(mechanism, fit.state.g), data.q).pose)
        away = np.linalg.norm(at[:, None] - at[None], axis=-1)
        a, b = np.unravel_index(int(np.argmax(away)), away.shape)
        assert away[a, b] == pytest.approx(found.length, rel=1e-9)
        real = cga.translation(forward(Model(mechanism, g), data.q[[a, b]]).pose)
        ratio.append((found.length - np.linalg.norm(real[0] - real[1])) / found.sigma)
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1.0, abs=0.25)


def test_positions_tell_scale() -> None:
    mechanism = read_mechanism(ROOT / "configs"
                               / f"{NAME}.yaml")
    rng = np.random.default_rng(4)
    q = joints(mechanism, NAME, 40, rng)
    g = truth(mechanism, rng, 0.3)
    pose = np.concatenate([cga.translation(forward(Model(mechanism, g), q).pose),
                           np.full((len(q), 3), np.nan)], axis=1)
    data = replace(Dataset.of_poses("camera", q, pose, (1e-5, 1.0), False), kind=POSITION)
    found = identifiability(fitted(mechanism, data))
    assert found.scale is not None and not found.scale.open
    assert not any("Scale" in s for s in open_sentences(
        found.collinear, in_units(found.scale, mechanism.units)))


@pytest.mark.parametrize("name", [
    "6-UPS", "3-RPR", pytest.param("linapod", marks=pytest.mark.slow)])
def test_poses_tell_scale_whatever_is_open(name: str) -> None:
    """Frame and target unknown, flat prior: the measured points' distances are measured."""
    mechanism = read_mechanism(ROOT / "configs"
                               / f"{name}.yaml")
    rng = np.random.default_rng(8)
    q = joints(mechanism, name, 40, rng)
    g = truth(mechanism, rng, 0.3)
    registration = Registration.of_pose(np.array([0.1, 0.2, 0, 0, 0, 0.3]),
                                        np.array([0.05, 0.1, 0.0]))
    seen = measured_pose(registration, forward(Model(mechanism, g), q).pose)
    data = Dataset.of_poses("tracker", q, seen, (1e-5, 1e-5), True)
    problem = Problem(mechanism, (data,), mechanism.free)
    for found in (
        predict_identifiability(problem, "flat"),
        predict_identifiability(problem, "prior"),
        identifiability(identify(problem, ROBUST)),
    ):
        assert found.scale is not None and not found.scale.unobservable and not found.scale.open
        assert found.scale.sigma_data < 5e-5


def test_fixed_drives_tell_scale_a_little(tmp_path: Path) -> None:
    """With rods and drives as drawn the curvature of the bed's touches holds the size."""
    mechanism = printer(tmp_path, ratio=-0.0125, length={"value": 300, "fixed": True})
    rng = np.random.default_rng(5)
    g = truth(mechanism, rng)
    found = predict_identifiability(
        Problem(mechanism, (touches(mechanism, g, rng),), mechanism.free), "flat"
    )
    assert found.scale is not None and not found.scale.unobservable


@pytest.mark.slow
def test_a_flat_fit_that_would_run_off_is_refused(tmp_path: Path) -> None:
    """288 mm rods became 269 or 320 mm that way; with tolerances they stay."""
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(6)
    g = truth(mechanism, rng)
    data = touches(mechanism, g, rng)
    table = "height," + ",".join(f"q_{n}" for n in mechanism.actuators) + "\n" + "\n".join(
        ",".join(repr(float(v)) for v in (h * 1e3, *q))
        for h, q in zip(data.value, data.q, strict=True))
    (tmp_path / "bed.csv").write_text(table + "\n")
    (tmp_path / "bed.yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/dataset/1", "name": "bed", "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "plane", "sigma": {"height": 0.01}}, "frame": "known",
        "target": "known"}))
    run = ppmcal("identify", "printer.yaml", "bed.csv", "--prior", "flat", cwd=tmp_path, expect=2)
    assert "do not hold the machine's size" in run.err and "measured distance" in run.err
    run = ppmcal("identify", "printer.yaml", "bed.csv", cwd=tmp_path, expect=0)
    assert "length and ratio, limb by limb, are exactly correlated" in " ".join(run.out.split())
    run = ppmcal("identify", "printer.yaml", "bed.csv", "--json", cwd=tmp_path, expect=0)
    lengths = [p["value"] for p in run.json["parameters"] if p["name"].endswith(".length")]
    assert np.max(np.abs(np.array(lengths) - 300.0)) < 1.0
    assert run.json["identifiability"]["scale"]["open"]
    run = ppmcal("check", "printer.yaml", "bed.csv", cwd=tmp_path, expect=0)
    assert "Scale: a distance of" in run.out


def test_nothing_free_leaves_nothing_to_say(tmp_path: Path) -> None:
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(7)
    data = touches(mechanism, mechanism.values, rng)
    found = predict_identifiability(Problem(mechanism, (data,), ()), "prior")
    assert found.scale is None and found.collinear == ()
