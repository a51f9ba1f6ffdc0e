"""What compensate promises: with readings that data cannot tell apart, with what is unexplained."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import ppmcal
from helpers.paths import ROOT
from numpy.typing import NDArray

from ppmcal.io import read_mechanism, read_scenario
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.registration import predict
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.registration import Registration
from ppmcal.simulation.simulate import simulate

Array = NDArray[np.float64]
MACHINE = ROOT / "sample_data" / "hexapod.yaml"
SCENARIO = """
format: ppmcal/scenario/1
units: {{length: mm, angle: deg}}
poses:
  random:
    center: {{x: 0, y: 0, z: 400, rx: 0, ry: 0, rz: 0}}
    half_range: {{x: 40, y: 40, z: 35, rx: 7, ry: 7, rz: 9}}
    count: 100
errors: {{random: {{scale: 1.0}}}}
effects: [{effect}]
instrument: {{kind: pose, sigma: {{position: 0.005, rotation: 0.001}}}}
frame: {{x: 1850, y: -420, z: 730, rx: 2, ry: -3, rz: 118}}
target: [12, -7, 55]
seed: 5
"""
GAIN = "{kind: gain, parameters: {gain: 3e-4}}"
SCALE = "{kind: sensor_scale, parameters: {scale: 3e-4}}"


def campaign(folder: Path, effect: str) -> None:
    """Simulate a hexapod with something hidden, and want some of its poses again."""
    (folder / "s.yaml").write_text(SCENARIO.format(effect=effect), encoding="utf-8")
    ppmcal("simulate", MACHINE, "s.yaml", "--out", "sim", cwd=folder, expect=0)
    with (folder / "sim" / "measurements.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))[::4]
    names = ["x", "y", "z", "rx", "ry", "rz"]
    lines = [",".join(names), *(",".join(row[n] for n in names) for row in rows)]
    (folder / "targets.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def true_error(folder: Path, commands: Path) -> float:
    """Return where the true machine goes, against what was wanted, rms, mm."""
    mechanism = read_mechanism(MACHINE)
    scenario = read_scenario(folder / "s.yaml", mechanism)
    made = simulate(mechanism, scenario, scenario.seed)
    with commands.open(newline="") as file:
        rows = list(csv.DictReader(file))
    q = np.array([[float(r[f"q_leg{n}"]) for n in range(1, 7)] for r in rows]) * 1e-3
    wanted = np.array([[float(r[c]) for c in "xyz"] for r in rows])
    pose = reached_poses(Model(made.with_effects, made.g), q, unknown_environment(*q.shape)).pose
    registration = Registration.of_pose(scenario.frame, scenario.target,
                                        scenario.target_rotation)
    away = predict(registration, pose)[0] * 1e3 - wanted
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def promised(commands: Path) -> float:
    with commands.open(newline="") as file:
        sigma = [float(r["sigma_position"]) for r in csv.DictReader(file)]
    return float(np.sqrt(np.mean(np.square(sigma))))


@pytest.fixture(scope="module")
def gain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gain")
    campaign(folder, GAIN)
    ppmcal("diagnose", MACHINE, "sim/measurements.csv", "--out", "d", cwd=folder, expect=1)
    return folder


@pytest.mark.slow
def test_other_readings_are_written_as_machines(gain: Path) -> None:
    found = json.loads((gain / "d" / "diagnosis.json").read_text())
    assert found["verdict"] == "named-set"
    effects = {e["effect"].split(" on ")[0]: e for e in found["other_models"]}
    # either leads: these data give both the same odds, to the last digit
    assert {"gain", "sensor_scale", ""} <= {*effects, *(e["kind"] for e in found["effects"])}
    for e in effects.values():
        ppmcal("check", e["file"], "--quiet", cwd=gain / "d")
        read_mechanism(gain / "d" / e["file"])


@pytest.mark.slow
def test_readings_that_agree_at_the_targets_promise_what_is_true(gain: Path) -> None:
    done = ppmcal("compensate", "d/model.yaml", "targets.csv", "--out", "c", cwd=gain, expect=0)
    words = " ".join(done.out.split())
    assert "cannot tell" in words and "gain" in words
    true = true_error(gain, gain / "c" / "commands.csv")
    assert true < 2.0 * promised(gain / "c" / "commands.csv")
    assert true < 0.02


@pytest.mark.slow
def test_a_reading_that_would_send_the_machine_astray_is_left_out(gain: Path) -> None:
    """The wrong member first: commands made with a scale of the instrument that is none."""
    found = json.loads((gain / "d" / "diagnosis.json").read_text())
    wrong = gain / "wrong"
    wrong.mkdir()
    files = {e["effect"].split(" on ")[0]: e["file"] for e in found["other_models"]}
    bare = {"file": files.pop("")}
    files |= {e["kind"]: "model.yaml" for e in found["effects"]}
    (wrong / "model.yaml").write_bytes((gain / "d" / files["sensor_scale"]).read_bytes())
    (wrong / "rival.yaml").write_bytes((gain / "d" / files["gain"]).read_bytes())
    (wrong / "bare.yaml").write_bytes((gain / "d" / bare["file"]).read_bytes())
    (wrong / "diagnosis.json").write_text(json.dumps({
        "format": "ppmcal/diagnosis/1", "other_models": [
            {"file": "rival.yaml", "effect": "gain", "instead_of": "sensor_scale", "odds": 1.0},
            {"file": "bare.yaml", "effect": "", "instead_of": "", "odds": 1.0}]}))
    done = ppmcal("compensate", "wrong/model.yaml", "targets.csv", "--out", "cw", cwd=gain,
                  expect=0)
    assert "left out of these commands" in " ".join(done.out.split())
    with_it = gain / "alone"
    with_it.mkdir()
    (with_it / "model.yaml").write_bytes((wrong / "model.yaml").read_bytes())
    ppmcal("compensate", "alone/model.yaml", "targets.csv", "--out", "ca", cwd=gain, expect=0)
    assert true_error(gain, gain / "ca" / "commands.csv") > 0.1
    assert true_error(gain, gain / "cw" / "commands.csv") < 0.02


@pytest.mark.long
def test_what_is_unexplained_is_in_the_promise(tmp_path: Path) -> None:
    """A leg's zero jumps in mid-run: no effect of the library, and the fit shares it out."""
    campaign(tmp_path, "")
    path = tmp_path / "sim" / "measurements.csv"
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows[len(rows) // 2:]:
        row["q_leg2"] = str(float(row["q_leg2"]) - 0.06)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    ppmcal("identify", MACHINE, path, "--out", "i", cwd=tmp_path, expect=1)
    left = json.loads((tmp_path / "i" / "identification.json").read_text())["unexplained"]
    assert left["position"]["rms"] > 0.005
    ppmcal("compensate", "i/identified.yaml", "targets.csv", "--out", "c", cwd=tmp_path, expect=0)
    promise = promised(tmp_path / "c" / "commands.csv")
    assert promise >= left["position"]["rms"]
    assert true_error(tmp_path, tmp_path / "c" / "commands.csv") < 1.5 * promise


@pytest.mark.slow
def test_a_fit_at_the_noise_leaves_nothing_unexplained(tmp_path: Path) -> None:
    campaign(tmp_path, "")
    ppmcal("identify", MACHINE, "sim/measurements.csv", "--out", "i", cwd=tmp_path)
    found = json.loads((tmp_path / "i" / "identification.json").read_text())
    assert found["unexplained"] == {}


@pytest.mark.slow
def test_what_poor_measurements_do_not_know_is_in_both_errors(tmp_path: Path) -> None:
    """Almost perfect machine: that, the tolerances and these data do not know of either command."""
    campaign(tmp_path, "")
    text = (tmp_path / "s.yaml").read_text().replace("scale: 1.0", "scale: 1e-3").replace(
        "position: 0.005, rotation: 0.001", "position: 1, rotation: 0.1").replace(
        "count: 100", "count: 12")
    (tmp_path / "s.yaml").write_text(text)
    ppmcal("simulate", MACHINE, "s.yaml", "--out", "poor", cwd=tmp_path, expect=0)
    ppmcal("identify", MACHINE, "poor/measurements.csv", "--out", "i", cwd=tmp_path)
    ppmcal("compensate", "i/identified.yaml", "targets.csv", "--out", "c", cwd=tmp_path, expect=0)
    predicted = json.loads((tmp_path / "c" / "commands.json").read_text())["predicted"]
    for size in predicted.values():
        assert size["sigma"] == pytest.approx(size["after"])
        assert size["after"] < size["before"] < 1.2 * size["after"]
