"""Standard deviations of kinematics are what drawn machines scatter by."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal as command
from helpers.commands import rows
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.compensation.kinematics_sigma import PoseRows, independent, joint_sigma
from ppmcal.io.results.kinematics import COVARIANCE, NONE, SIGMAS, TOLERANCES
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import inverse_partial, pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.kinematics.tables import inverse_table, velocity_table
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.registration import Registration

DRAWS = 400


def loaded(name):
    """A machine of configs/ whose file carries a sigma for every free parameter: half a tolerance.
    """
    machine = ppmcal.load(ROOT / "configs" / f"{name}.yaml")
    return replace(machine, parameters=tuple(
        replace(p, sigma=0.5 * p.tolerance) if i in machine.free else p
        for i, p in enumerate(machine.parameters)))


def drawn(machine, count):
    """DRAWS machines for each of so many rows, one after the other (DRAWS * count)."""
    rng, free = np.random.default_rng(1), list(machine.free)
    sigma = np.array([machine.parameters[i].sigma for i in free])
    g = np.tile(machine.values, (DRAWS, 1))
    g[:, free] += sigma * rng.standard_normal((DRAWS, len(free)))
    return Model(machine, np.repeat(g, count, axis=0))


def again(rows):
    """The rows (N, m) for every draw."""
    return np.tile(rows, (DRAWS, 1))


def poses_near_home(machine):
    """Three poses (3, d) in file units."""
    home = np.array([machine.home_pose[c] / machine.units.factor("length" if c < 3 else "angle")
                     for c in machine.dof])
    step = 1e-2 * machine.reach / machine.units.factor("length")
    away = np.array([[step if c < 3 else 1.0 for c in machine.dof]])
    return home + np.array([[0.0], [1.0], [-1.5]]) * away


def agree(told, values, units=1.0):
    """Whether standard deviations (N, k) are those of draws (DRAWS * N, k), but for chance."""
    values = values.reshape(DRAWS, -1, values.shape[1]) / units
    np.testing.assert_allclose(told, np.std(values, axis=0, ddof=1),
                               rtol=4.0 / np.sqrt(2.0 * (DRAWS - 1)))


def alike(told, values):
    """The same of vectors: standard deviations (N,) of the length of the error."""
    values = values.reshape(DRAWS, -1, 3)
    np.testing.assert_allclose(told, np.sqrt(np.var(values, axis=0).sum(axis=1)),
                               rtol=4.0 / np.sqrt(2.0 * (DRAWS - 1)))


def joint_sigmas(found, pattern="sigma_q_{}"):
    return np.stack([found.sure.columns[pattern.format(a)] for a in found.mechanism.actuators],
                    axis=1)


@pytest.mark.parametrize("name", ["3-RPR", "delta-linear", "6-UPS"])
def test_forward_and_inverse_scatter_as_they_say(name):
    machine = loaded(name)
    length, angle = machine.units.factor("length"), machine.units.factor("angle")
    poses = poses_near_home(machine)
    tool = np.array([10.0, 5.0] if machine.motion.planar else [10.0, 5.0, 20.0])
    found = ppmcal.inverse(machine, poses)
    per = [f for f, _ in machine.joint_units]
    onward = ppmcal.forward(machine, found.q / per, tool=tool)
    assert found.sure.entry.source == onward.sure.entry.source == SIGMAS
    many = drawn(machine, len(poses))
    agree(joint_sigmas(found), inverse(many, pose_motor(again(found.pose))).q, per)
    seen = measured_pose(Registration(target=np.append(tool, np.zeros(3 - tool.size)) * length),
                         forward(many, again(found.q)).pose)
    alike(onward.sure.columns["sigma_position"], seen[:, :3] / length)
    if not machine.motion.turns:
        assert "sigma_rotation" not in onward.sure.columns
    else:
        alike(onward.sure.columns["sigma_rotation"], seen[:, 3:] / angle)


@pytest.mark.long
def test_a_machine_that_decides_some_coordinates_itself_scatters_as_it_says():
    """A tripod: three coordinates named, three left open."""
    machine = loaded("3-RPS")
    z = machine.home_pose[2] / machine.units.factor("length")
    found = ppmcal.inverse(machine, {"z": [z, 1.01 * z], "rx": [0.0, 2.0], "ry": [0.0, -1.0]})
    asked = np.full((2, 6), np.nan)
    asked[:, 2:5] = found.pose[:, 2:5]
    q = inverse_partial(drawn(machine, 2), again(asked)).q
    agree(joint_sigmas(found), q, [f for f, _ in machine.joint_units])


@pytest.mark.parametrize("unit", ["um", "m"])
def test_the_nearest_pose_is_the_same_of_a_small_and_of_a_large_machine(tmp_path, unit):
    """A full pose of a tripod: metres and radians are weighed by the machine's own size."""
    text = (ROOT / "configs" / "3-RPS.yaml").read_text()
    (tmp_path / "other.yaml").write_text(text.replace("length: mm", f"length: {unit}"))
    told = []
    for machine in (loaded("3-RPS"), ppmcal.load(tmp_path / "other.yaml")):
        length = machine.units.factor("length")
        asked = np.full((2, 6), np.nan)
        asked[:, 2:5] = [[100.0 * length, 0.1, -0.02], [105.0 * length, 0.0, -0.02]]
        table = inverse_table(Model(machine), asked)
        at = PoseRows(table.pose, table.q, unknown_environment(*table.q.shape))
        sigma = {f"leg{n}.platform.point.radius": 0.05 * length for n in (1, 2, 3)}
        told.append(joint_sigma(Model(machine), at, independent(machine, sigma)) / length)
    np.testing.assert_allclose(told[1], told[0], rtol=1e-9)


@pytest.mark.slow
def test_rates_scatter_as_they_say():
    machine = loaded("3-RPR")
    found = ppmcal.velocity(machine, {
        "x": [480.0, 520.0], "y": [250.0, 280.0], "rz": [20.0, 25.0], "vx": [100.0, -50.0],
        "vy": [10.0, 80.0], "wz": [5.0, -20.0]})
    twist = np.zeros((2, 6))
    twist[:, :2] = [[0.1, 0.01], [-0.05, 0.08]]
    twist[:, 5] = np.radians([5.0, -20.0])
    many = velocity_table(drawn(machine, 2), again(found.pose), again(twist))
    agree(joint_sigmas(found, "sigma_rate_{}"), many.rate, 1e-3)
    units = json.loads(found.files()["kinematics.json"])["units"]
    assert units["sigma_rate_leg1"] == "mm/s" and units["sigma_q_leg1"] == "mm"


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A planar machine identified in an unknown frame, in files."""
    folder = tmp_path_factory.mktemp("calibrated")
    (folder / "m.yaml").write_bytes((ROOT / "configs" / "3-RPR.yaml").read_bytes())
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 288, "rz": 30}, "half_range": {
                    "x": 60, "y": 60, "rz": 8}, "count": 20}},
                "errors": {"random": {"scale": 1.0}}, "seed": 3,
                "instrument": {"kind": "pose", "sigma": {"position": 0.02, "rotation": 0.004}},
                "frame": {"x": 4, "y": -3, "rz": 1}, "target": [3, -2]}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario))
    command("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder, expect=0)
    command("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=folder)
    return folder


@pytest.mark.slow
def test_a_calibrated_machine_is_as_sure_as_compensate_says(calibrated):
    """The same joints in the same frame: the same standard deviation, from the whole covariance."""
    (calibrated / "t.csv").write_text("x,y,rz\n510,290,30\n540,260,27\n")
    command("compensate", "i/identified.yaml", "t.csv", "--out", "c", cwd=calibrated, expect=0)
    run = command("kinematics", "forward", "i/identified.yaml", "c/commands.csv", "--dataset", "s",
                  "--out", "k", cwd=calibrated, expect=0)
    there, here = (rows(calibrated / f) for f in ("c/commands.csv", "k/kinematics.csv"))
    for name in ("sigma_position", "sigma_rotation"):
        assert [float(r[name]) for r in here] == pytest.approx(
            [float(r[name]) for r in there], rel=1e-9)
    said = " ".join(run.out.split())
    assert "The model's own uncertainty: one standard deviation of 0.0" in said
    assert "in the frame of s (rms over rows; covariance of the calibration)" in said
    told = json.loads((calibrated / "k" / "kinematics.json").read_text())
    assert told["uncertainty"]["source"] == COVARIANCE and told["uncertainty"]["frame"] == "s"
    assert told["uncertainty"]["sizes"]["sigma_position"]["unit"] == "mm"
    assert any(p.endswith("identification.json") for p in told["provenance"]["inputs"])


@pytest.mark.slow
def test_the_base_frame_is_less_sure_than_the_measured_one(calibrated):
    """Offsets and an unknown frame stand in for each other."""
    table = {"q_leg1": [450.0], "q_leg2": [330.0], "q_leg3": [340.0]}
    model = calibrated / "i" / "identified.yaml"
    base, seen = (ppmcal.forward(model, table, dataset=d) for d in (None, "s"))
    assert base.sure.columns["sigma_position"] > 3.0 * seen.sure.columns["sigma_position"]
    alone = calibrated / "alone.yaml"
    alone.write_bytes(model.read_bytes())
    found = ppmcal.forward(alone, table)
    assert found.sure.entry.source == SIGMAS
    assert np.isfinite(found.sure.columns["sigma_position"]).all()


@pytest.mark.slow
def test_a_nominal_file_says_what_its_tolerances_allow(calibrated):
    """No column is called sigma; a stray identification.json beside it does not change that."""
    (calibrated / "i" / "nominal.yaml").write_bytes((calibrated / "m.yaml").read_bytes())
    run = command("kinematics", "forward", "i/nominal.yaml", "s/measurements.csv", "--out", "n",
                  cwd=calibrated, expect=0)
    assert "The file is nominal, without sigmas: its tolerances" in " ".join(run.out.split())
    assert not [c for c in rows(calibrated / "n" / "kinematics.csv")[0] if c.startswith("sigma")]
    told = json.loads((calibrated / "n" / "kinematics.json").read_text())["uncertainty"]
    assert told["source"] == TOLERANCES and told["sizes"]["sigma_position"]["rms"] > 0.1


def test_a_file_without_sigmas_and_tolerances_says_that_it_has_none():
    tree = yaml.safe_load((ROOT / "configs" / "3-RPR.yaml").read_text())
    tree["tolerances"] = dict.fromkeys(tree["tolerances"], 0.0)
    found = ppmcal.forward(ppmcal.load(tree), [[450.0, 330.0, 340.0]])
    assert found.sure.entry.source == NONE
    assert found.headline().endswith("carries neither sigmas nor tolerances.")


def test_rows_without_a_pose_have_no_sigma_and_singular_ones_no_traceback():
    machine = loaded("3-RPR")
    found = ppmcal.forward(machine, [[450.0, 330.0, 340.0], [5000.0, 1.0, 1.0],
                                     [float("nan"), 330.0, 340.0]])
    assert np.isfinite(found.sure.columns["sigma_position"]).tolist() == [True, False, False]
    stuck = ppmcal.inverse(machine, [[500.0, 280.0, 25.0], [1e5, 0.0, 0.0]])
    assert np.isfinite(stuck.sure.columns["sigma_q_leg1"])[0]


def test_every_assembly_mode_has_its_own_sigma():
    machine = loaded("3-RPR")
    found = ppmcal.forward(machine, [[450.0, 330.0, 340.0]], all_modes=True)
    sigma = found.sure.columns["sigma_position"]
    assert len(sigma) == len(found.table.status) > 1 and np.isfinite(sigma).all()
    assert np.unique(np.round(sigma, 6)).size == len(sigma)
