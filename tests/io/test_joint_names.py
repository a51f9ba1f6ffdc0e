"""Joints called x, y, z: whose direction of approach `dir_x` is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal.commands.inputs import load, shipped
from ppmcal.errors import BadInput
from ppmcal.model.dataset import Dataset

N = 12
SIDE = {"units": {"length": "mm", "angle": "deg"}, "target": "known", "frame": "unknown",
        "instrument": {"kind": "position", "sigma": {"position": 0.01}}}


def read(**columns: Any) -> Dataset:
    text = yaml.safe_load(shipped("delta-linear").read_text(encoding="utf-8"))
    for limb, name in zip(text["limbs"], "xyz", strict=True):
        limb["actuator"] = name
    text = yaml.safe_load(yaml.safe_dump(text).replace("q: {a:", "q: {x:"))
    if "q" in text["home"]:
        text["home"]["q"] = dict(zip("xyz", text["home"]["q"].values(), strict=True))
    if "limits" in text:
        text["limits"] = dict(zip("xyz", text["limits"].values(), strict=True))
    machine = load(text)
    rng = np.random.default_rng(1)
    table = {c: rng.uniform(0.0, 50.0, N) for c in ("q_x", "q_y", "q_z", "x", "y", "z")}
    way = np.where(np.arange(N) % 2, 1.0, -1.0)
    (data,) = ppmcal.read_data(machine, {**table, **dict.fromkeys(columns, way)}, sidecar=SIDE)
    return data


@pytest.mark.parametrize("some", [("dir_x",), ("dir_x", "dir_y")])
def test_a_direction_that_may_be_the_platforms_is_refused(some: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as refused:
        read(**dict.fromkeys(some))
    assert "the platform's direction of approach, or that of the joint" in refused.value.what
    assert "dir_x, dir_y, dir_z" in refused.value.hint and "q_joint_x: q_x" in refused.value.hint


def test_directions_of_all_joints_are_the_joints_and_that_is_said() -> None:
    found = read(dir_x=1, dir_y=1, dir_z=1).findings
    assert any("not for the platform's" in f for f in found)
    assert not read().findings
