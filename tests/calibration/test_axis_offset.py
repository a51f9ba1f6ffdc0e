"""Axis offsets of universal joints through the commands: found, told, compensated, judged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers import machines
from helpers.commands import number, ppmcal, rows, write_csv
from helpers.diagnoses import found_in
from helpers.machines import OFFSET_JOINTS

import ppmcal as face
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.partial_pose import pose_motor

each = pytest.mark.parametrize(("kind", "body"), OFFSET_JOINTS)
SIZES = (1.0, -0.7, 0.4, -1.3, 0.9, 0.6)


def machine(folder: Path, kind: str, body: str, slot: Any = None) -> None:
    """Write m.yaml, first axes given and maybe the offsets, and a session of 60 poses s.yaml."""
    def change(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        own = dict(limb[body])
        if (kind, body) != ("(R)US", "base"):
            own["axis"] = [float(np.cos(i)), float(np.sin(i)), 0.2]
        return {**limb, body: own if slot is None else {**own, "axis_offset": slot}}

    (folder / "m.yaml").write_text(machines.plain_text(kind, change))
    home = machines.CASES[kind].home
    half = {c: (0.06 if kind == "(R)US" else 0.1) * 600.0 if c in "xyz" else 8.0 for c in home}
    (folder / "s.yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": dict(home), "half_range": half, "count": 60}},
        "instrument": {"kind": "pose", "sigma": {"position": 0.0005, "rotation": 0.0001}},
        "frame": {"x": 5, "y": -3, "z": 2, "rx": 0.2, "ry": -0.1, "rz": 1}, "seed": 3}))


def simulated(folder: Path, errors: dict[str, float]) -> None:
    scenario = yaml.safe_load((folder / "s.yaml").read_text()) | {"errors": errors}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder, expect=0)


@pytest.mark.long
@each
def test_identify_finds_the_offsets_and_compensate_undoes_them(kind: str, body: str,
                                                               tmp_path: Path) -> None:
    machine(tmp_path, kind, body, {"value": 0, "tolerance": 2})
    truth = {f"leg{i + 1}.{body}.axis_offset": e for i, e in enumerate(SIZES)}
    simulated(tmp_path, truth | {"leg1.offset": 0.2, "leg4.base.point.x": -0.3})
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=tmp_path, expect=0)
    found = {r["name"]: r for r in rows(tmp_path / "i/parameters.csv")}
    for name, size in truth.items():
        value, sigma = (number(found[name], k) for k in ("value", "sigma"))
        assert abs(value - size) < 4.0 * sigma
        assert sigma < 0.5
    noise = json.loads((tmp_path / "i/identification.json").read_text())["noise"]
    assert noise["chi2_p"] > 1e-3
    home = machines.CASES[kind].home
    targets = [{**home, "x": home["x"] + d, "z": home["z"] + d} for d in (0.0, 10.0, -15.0)]
    write_csv(tmp_path / "t.csv", targets)
    ppmcal("compensate", "i/identified.yaml", "t.csv", "--frame", "base", "--out", "c",
           cwd=tmp_path, expect=0)
    sent = np.array([[number(r, f"q_leg{i}") for i in range(1, 7)]
                     for r in rows(tmp_path / "c/commands.csv")])
    real = read_mechanism(tmp_path / "i/identified.yaml")
    at = forward(Model(real), sent * real.joint_factors()).pose
    wanted = pose_motor(np.array([[t[c] for c in home] for t in targets]) * [
        *[1e-3] * 3, *[np.pi / 180.0] * 3])
    assert np.abs(machines.difference(at, wanted)).max() < 1e-9


@pytest.mark.long
def test_diagnose_names_one_hidden_millimetre(tmp_path: Path) -> None:
    """The file gives the first axes and no offset; one leg's axes are 1 mm apart."""
    kind, body = "U(P)S", "platform"
    machine(tmp_path, kind, body)
    hidden = f"leg2.{body}.axis_offset"
    simulated(tmp_path, {hidden: 1.0, "leg1.offset": 0.2, "leg4.base.point.x": -0.3})
    ppmcal("diagnose", "m.yaml", "s/measurements.csv", "--out", "d",
           cwd=tmp_path)
    found = found_in(tmp_path)
    assert found["verdict"] == "named"
    (only,) = found["effects"]
    assert (only["kind"], only["on"], list(only["parameters"])) == ("geometry", ["leg2"], [hidden])
    size = only["parameters"][hidden]
    assert size["unit"] == "mm"
    assert abs(size["value"] - 1.0) < 4.0 * size["sigma"] < 0.8


@pytest.mark.long
@pytest.mark.parametrize(("kind", "body"), [("U(P)S", "base"), ("(P)US", "platform")])
def test_the_other_commands_take_such_a_machine(kind: str, body: str, tmp_path: Path) -> None:
    """Check, sensitivity, stiffness, tolerances and workspace: sound, and with the slot in them."""
    machine(tmp_path, kind, body, 3.0)
    (tmp_path / "m.yaml").write_text((tmp_path / "m.yaml").read_text() + (
        "stiffness: {bar: 5.0e+4, drive: 2.0e+5}\n"))
    ppmcal("check", "m.yaml", cwd=tmp_path, expect=0)
    ppmcal("sensitivity", "m.yaml", "--out", "v", cwd=tmp_path)
    named = {r["name"] for r in rows(tmp_path / "v/sensitivity.csv")}
    assert f"leg3.{body}.axis_offset" in named
    few, grid = ["--machines", "20", "--cores", "1"], ["--grid", "x=-20:20:3,y=-20:20:3"]
    for command in (["stiffness", *grid], ["tolerances", "--accuracy", "0.5", *few],
                    ["workspace", *grid]):
        run = ppmcal(command[0], "m.yaml", *command[1:], "--out", command[0], cwd=tmp_path)
        assert run.code in (0, 1), run.err


@pytest.mark.slow
def test_sensitivity_is_what_the_machine_does(tmp_path: Path) -> None:
    """The platform's motion per mm of an offset, against forward kinematics with it changed."""
    machine(tmp_path, "U(P)S", "base", 3.0)
    model = Model(face.load(str(tmp_path / "m.yaml")))
    mechanism = model.mechanism
    index = mechanism.names.index("leg2.base.axis_offset")
    q, pose = machines.spread(model)
    ends = []
    for step in (1e-5, -1e-5):
        g = model.parameters.copy()
        g[index] += step
        ends.append(forward(Model(mechanism, g), q, start=pose, start_q=q).pose)
    closure = model.closure(q, [index])
    moved = -np.linalg.solve(closure.pose_matrix(pose), closure.error_matrix(pose, [index]))[..., 0]
    np.testing.assert_allclose(moved, machines.difference(*ends) / 2e-5, rtol=1e-6, atol=1e-9)
    assert np.abs(moved).max() > 0.1
