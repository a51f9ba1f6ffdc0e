"""Universal joints whose axes do not meet: ppmcal against the independent simulator."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.machines import motors
from wild import kinematics as other
from wild.catalogue import write
from wild.files import mechanism_record, yaml_text
from wild.machines import Machine, build, pose_of

import ppmcal
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse

SPATIAL = ("hexapod", "delta-linear", "delta-rotary", "crank-hexapod")


def with_gaps(name: str, seed: int, folder: Path) -> tuple[Machine, other.Geometry, Model]:
    """Return a machine with drawn first axes and offsets, mm, as both programs have it.

    On a crank the first axis is parallel to the crank's.
    """
    machine, rng = build(name, seed), np.random.default_rng(seed)
    record: dict[str, Any] = mechanism_record(machine)
    geo, legs = machine.geometry, len(machine.legs)
    axes = rng.normal(size=(legs, 3)) * [1.0, 1.0, 0.2]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    gaps = rng.uniform(-8.0, 8.0, legs)
    for leg, limb in enumerate(record["limbs"]):
        limb["base"]["axis_offset"] = float(gaps[leg])
        if geo.closure == "crank":
            axes[leg] = geo.axis[0, leg]
        else:
            limb["base"]["axis"] = axes[leg].tolist()
    path = folder / "m.yaml"
    path.write_text(yaml_text(record), encoding="utf-8")
    return machine, replace(geo, u_axis=axes[None], u_gap=gaps[None]), Model(read_mechanism(path))


@pytest.mark.slow
@pytest.mark.parametrize("name", SPATIAL)
def test_closure_and_kinematics_agree(name: str, tmp_path: Path) -> None:
    """At random poses, with joints that close and that do not; and the way back."""
    for seed in (1, 2):
        machine, geo, model = with_gaps(name, seed, tmp_path)
        rng = np.random.default_rng(seed)
        values = machine.home + 0.8 * machine.half * rng.uniform(-1, 1, (30, len(machine.home)))
        pos, rot = pose_of(machine.motion, values)
        pose = motors(rot, 1e-3 * pos)
        u = other.inverse(geo, pos, rot)
        si = u if machine.rotary else 1e-3 * u
        np.testing.assert_allclose(np.abs(inverse(model, pose).q - si).max(), 0.0, atol=1e-11)
        away = u + (0.01 if machine.rotary else 2.0) * rng.uniform(-1, 1, u.shape)
        gap = other.closure(geo, away, pos, rot)[0]
        found = model.closure(away if machine.rotary else 1e-3 * away).misclosure(pose)
        np.testing.assert_allclose(1e3 * found, gap, rtol=1e-9, atol=1e-9)
        assert np.abs(gap).max() > 0.1
        there = forward(model, si)
        assert there.converged.all()
        at = other.forward(geo, u, *pose_of(machine.motion, np.tile(machine.home, (30, 1))),
                           machine.motion)
        gap = model.closure(si).misclosure(motors(at[1], 1e-3 * at[0]))
        assert np.abs(gap).max() < 1e-12


def diagnosed(case: str, machine: str, rows: int, seed: int, folder: Path
              ) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what diagnose says of a campaign whose file gives the first axes, and the truth."""
    write(case, machine, rows, seed, folder, 2.0)
    tree = yaml.safe_load((folder / "mechanism.yaml").read_text(encoding="utf-8"))
    for limb in tree["limbs"]:
        limb["base"]["axis"] = [1.0, 0.0, 0.0]
    (folder / "m.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    ppmcal.diagnose(str(folder / "m.yaml"), str(folder / "data.csv")).save(str(folder / "out"))
    return (json.loads((folder / "out/diagnosis.json").read_text(encoding="utf-8")),
            json.loads((folder / "truth.json").read_text(encoding="utf-8")))


@pytest.mark.long
def test_a_gap_of_one_leg_is_named(tmp_path: Path) -> None:
    found, truth = diagnosed("joint-gap-one", "delta-linear", 90, 1, tmp_path / "c")
    (hidden,) = truth["effects"]
    assert found["verdict"] == "named"
    (only,) = found["effects"]
    assert only["kind"] == "geometry"
    assert only["on"] == hidden["on"]
    ((name, size),) = only["parameters"].items()
    assert name == f"{hidden['on'][0]}.base.axis_offset"
    assert abs(size["value"] - hidden["parameters"]["axis_offset"]) < 4.0 * size["sigma"]
    model = yaml.safe_load((tmp_path / "c/out/model.yaml").read_text(encoding="utf-8"))
    (limb,) = [limb for limb in model["limbs"] if limb["name"] == hidden["on"][0]]
    assert limb["base"]["axis_offset"]["value"] == pytest.approx(size["value"], rel=1e-6)


@pytest.mark.long
def test_no_gap_is_named_where_axes_meet(tmp_path: Path) -> None:
    """How often nothing is named of the other machines is in docs/rates."""
    found, _ = diagnosed("none", "delta-linear", 90, 1, tmp_path / "c")
    assert not found["effects"]
