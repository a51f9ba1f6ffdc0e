"""A scale of one file: derivatives, what it takes up, and what it leaves open."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.instruments import SIGMA, data_of, joints, truth
from helpers.paths import ROOT

from ppmcal.calibration.fit.fit_result import FitOptions, prediction_covariance
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.sidecar_values import scale_of
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.registration import carried_back, measured_pose
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

SCALE = 0.9975
OPEN = Unknown(True, np.ones(1))


def session(name: str, kind: str, n: int, seed: int, noise: float = 0.0
            ) -> tuple[Mechanism, Dataset, np.ndarray]:
    """A machine off its nominal, measured by an instrument that shows SCALE of every length."""
    rng = np.random.default_rng(seed)
    mechanism = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    g = truth(mechanism, rng, 0.3)
    q = joints(mechanism, name, n, rng)
    if kind in ("pose", "position"):
        pose = pose_vector(forward(Model(mechanism, g), q).pose)
        data = Dataset.of_poses("tracker", q, pose, (SIGMA, SIGMA), True)
        data = replace(data, kind=find_instrument(kind))
        moved = data.position + rng.normal(0.0, max(noise, 1e-300), data.position.shape)
        return mechanism, replace(data, position=SCALE * moved, scale=OPEN), g
    second = joints(mechanism, name, n, rng) if kind == "pair" else None
    data = data_of(mechanism, "distance", q, second, g, rng, noise, True)
    return mechanism, replace(data, value=SCALE * data.value, scale=OPEN), g


@pytest.mark.long_cases(
    "True-6-UPS-point", "False-6-UPS-pose", "True-6-UPS-pair", "True-linapod-position")
@pytest.mark.slow_cases(
    "False-6-UPS-point", "False-6-UPS-pair", "True-6-UPS-pose", "False-linapod-position",
    "True-delta-linear-pair")
@pytest.mark.parametrize(("name", "kind"), [
    ("3-RPR", "point"), ("3-RPR", "position"), ("delta-linear", "pair"), ("delta-linear", "pose"),
    ("6-UPS", "point"), ("6-UPS", "pair"), ("6-UPS", "pose"), ("linapod", "position")])
@pytest.mark.parametrize("effect", [False, True])
def test_derivatives(name: str, kind: str, effect: bool, tmp_path: Path) -> None:
    """Every column against central differences, poses solved anew, away from a scale of 1."""
    mechanism, data, _ = session(name, kind, 6, 3)
    if effect:
        content = yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text())
        content["effects"] = [{"kind": "sensor_scale", "parameters": {
            "scale": {"value": 0.003, "free": True}}}]
        (tmp_path / "m.yaml").write_text(yaml.safe_dump(content))
        mechanism = read_mechanism(tmp_path / "m.yaml")
    problem = Problem(mechanism, (data,), mechanism.free)
    assert problem.columns[-1] == f"scale of {data.name}"
    state = problem.start()
    state = replace(state, registrations=(replace(state.registrations[0], scale=1.02),))
    (exact,) = problem.rows(state)
    scale = np.concatenate([np.full(len(problem.free), 1e-5), 1e-2 * problem.open_scale()])
    for c in range(len(problem.columns)):
        step = np.zeros(len(problem.columns))
        step[c] = scale[c]
        (up,) = problem.rows(problem.moved(state, step), False)
        (down,) = problem.rows(problem.moved(state, -step), False)
        slope = -(up.raw - down.raw) / (2.0 * scale[c])
        found = (np.linalg.inv(exact.whitener) @ exact.jacobian[..., c][..., None])[..., 0]
        assert np.max(np.abs(found - slope)) < 1e-5 * max(
            1.0, np.max(np.abs(slope))), problem.columns[c]


@pytest.mark.parametrize("kind", ["pose", "point"])
def test_the_scale_is_found_with_its_sigma(kind: str) -> None:
    mechanism, data, _ = session("6-UPS", kind, 80, 5, SIGMA)
    lengths = tuple(p for p in mechanism.free if mechanism.names[p].endswith(".offset"))
    fit = identify(Problem(mechanism, (data,), lengths), FitOptions(robust=False))
    # the machine's size is in its joint centres, which stay: the scale is observable
    found = fit.state.registrations[0].scale
    sigma = float(np.sqrt(prediction_covariance(fit)[-1, -1]))
    assert sigma < 3e-3 and abs(found - SCALE) < 2e-3 + 4.0 * sigma
    frozen = identify(Problem(mechanism, (replace(data, scale=Unknown(False, np.ones(1))),),
                              lengths), FitOptions(robust=False))
    assert fit.information.square < frozen.information.square


def test_forward_and_back_agree() -> None:
    mechanism, _, g = session("6-UPS", "pose", 5, 1)
    q = joints(mechanism, "6-UPS", 5, np.random.default_rng(2))
    pose = forward(Model(mechanism, g), q).pose
    registration = Registration.of_pose(np.array([0.1, 0.2, 0.3, 0.1, 0.0, 0.2]), scale=SCALE)
    seen = measured_pose(registration, pose)
    plain = measured_pose(replace(registration, scale=1.0), pose)
    np.testing.assert_allclose(seen[:, :3], SCALE * plain[:, :3], rtol=1e-14)
    np.testing.assert_allclose(pose_vector(carried_back(mechanism, registration, seen)),
                               pose_vector(pose), atol=1e-12)


@pytest.mark.parametrize(("raw", "kind", "words"), [
    ("unknown", "plane", "heights"), ("unkown", "pose", "unknown"), (25.4, "pose", "0.5 to 2"),
    (True, "distance", "0.5 to 2"), ([1], "distance", "0.5 to 2")])
def test_a_wrong_scale_is_refused(raw: object, kind: str, words: str) -> None:
    with pytest.raises(BadInput) as error:
        scale_of(raw, find_instrument(kind), "side.yaml")
    assert "side.yaml: scale" in error.value.where and words in str(error.value)


@pytest.mark.long
def test_identify_writes_the_scale_and_reads_it_back(tmp_path: Path) -> None:
    ppmcal("init", "6-UPS", "--out", "m.yaml", cwd=tmp_path, expect=0)
    ppmcal("simulate", "m.yaml", "m.scenario.yaml", "--out", "d", cwd=tmp_path)
    side = tmp_path / "d" / "measurements.yaml"
    content = yaml.safe_load(side.read_text())
    side.write_text(yaml.safe_dump(content | {"scale": "unknown"}))
    run = ppmcal("identify", "m.yaml", "d/measurements.csv", "--free", "*.offset", "--out", "i",
                 cwd=tmp_path)
    assert run.code in (0, 1)
    found = yaml.safe_load((tmp_path / "i" / "identified.yaml").read_text())
    (entry,) = found["measurement"]["datasets"].values()
    machine = read_mechanism(tmp_path / "i" / "identified.yaml")
    (registration,) = machine.registrations.values()
    assert registration.scale == entry["scale"] and abs(entry["scale"] - 1.0) < 0.02
    side.write_text(yaml.safe_dump(content | {"scale": entry["scale"]}))
    again = ppmcal("identify", "m.yaml", "d/measurements.csv", "--free", "*.offset", "--out", "k",
                   cwd=tmp_path)
    assert again.code == run.code
