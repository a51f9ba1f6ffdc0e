"""A machine with a passive limb through the commands: only joints with a drive are listed."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.machines import read_text
from helpers.paths import ROOT

import ppmcal as face
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import setting, shifted
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.dataset import unknown_environment

CONFIG = ROOT / "configs" / "tricept.yaml"
SCENARIO = ROOT / "configs" / "scenarios" / "tricept.yaml"
JOINTS = ["leg1", "leg2", "leg3"]


def columns(path: Path, start: str) -> list[str]:
    with path.open(encoding="utf-8", newline="") as file:
        return [name.removeprefix(start) for name in next(csv.reader(file))
                if name.startswith(start)]


@pytest.mark.long
def test_tables_and_exports_have_driven_joints_alone(tmp_path: Path) -> None:
    ppmcal("simulate", CONFIG, SCENARIO, "--out", "sim", cwd=tmp_path, expect=0)
    assert columns(tmp_path / "sim" / "measurements.csv", "q_") == JOINTS
    ppmcal("identify", CONFIG, "sim/measurements.csv", "--out", "id", cwd=tmp_path, expect=0)
    tree = yaml.safe_load((tmp_path / "id" / "identified.yaml").read_text(encoding="utf-8"))
    assert tree["limbs"][3]["actuator"] == "none" and "offset" not in tree["limbs"][3]
    (tmp_path / "t.csv").write_text("x,y,z,rx,ry,rz\n10,5,-880,,,\n", encoding="utf-8")
    ppmcal("compensate", "id/identified.yaml", "t.csv", "--frame", "base", "--out", "c",
           cwd=tmp_path, expect=0)
    assert columns(tmp_path / "c" / "commands.csv", "q_")[:3] == JOINTS
    run = ppmcal("export", "joints", "id/identified.yaml", "--out", "e", cwd=tmp_path)
    assert run.code in (0, 1)
    assert sorted(p.stem for p in (tmp_path / "e").glob("*.comp")) == JOINTS


def test_springs_of_a_passive_limb_are_those_of_its_joints() -> None:
    tree = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    tree["stiffness"] = {"bar": 5e4, "drive": 2e5, "joint1": 1e5}
    machine = read_text(yaml.safe_dump(tree))
    assert [sorted(parts) for parts in machine.stiffness] == [
        ["bar", "drive", "joint1.x", "joint1.y", "joint1.z"]] * 3 + [
        ["joint1.x", "joint1.y", "joint1.z"]]


def test_effects_of_joints_are_of_the_driven_and_heat_is_of_all() -> None:
    tree = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    tree["limbs"][2]["ratio"], tree["limbs"][3]["base"]["point"] = 10, [20, 0, 0]
    tree["home"]["pose"]["x"] = 20
    tree["effects"] = [{"kind": "base_thermal", "parameters": {"expansion": 2e-5}}]
    del tree["limits"]
    machine = read_text(yaml.safe_dump(tree))
    model, q = Model(machine), home_state(machine).q[None]
    warm = replace(unknown_environment(1, 3), temperature=np.array([5.0]))
    at = setting(replace(model, mechanism=replace(machine, effects=())), warm, q,
                 machine.home[None])
    assert at.ratio.tolist() == [1.0, 1.0, 0.01]
    change = shifted(model, warm, q, machine.home[None]).shift.slots
    np.testing.assert_allclose(change[3, "base.point.x"], 0.02 * 2e-5 * 5.0, rtol=1e-12)


@pytest.mark.long
def test_an_error_of_a_passive_limb_is_named_and_of_no_joint() -> None:
    tree = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    scenario = yaml.safe_load(SCENARIO.read_text(encoding="utf-8"))
    scenario["errors"] = {"centre.platform.axis.rx": 0.15}
    machine = face.load({**tree, "free": ["leg*"]})
    found = face.diagnose(machine, face.simulate(machine, scenario).data)
    (effect,) = found.record.effects
    assert (effect.kind, list(effect.on)) == ("geometry", [])
    (value,) = effect.parameters.values()
    assert abs(value.value - 0.15) < 5.0 * value.sigma
    assert read_mechanism(CONFIG).driven == (0, 1, 2)
