"""Machines on ropes over pulleys are found again from lengths that plain NumPy says."""

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from helpers.pulleys import rope_lengths
from helpers.redundant import alone

import ppmcal
from ppmcal import algebra as cga
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward

HALF = np.array([0.7, 0.6, 0.5, 0.2, 0.2, 0.2])


def tree(name):
    return yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))


@pytest.mark.long
def test_sheaves_and_swivels_are_identified_without_noise():
    """With poses measured, radii and axes free: fresh poses to 1e-9 m."""
    path = ROOT / "configs" / "cable-8-pulleys.yaml"
    machine = read_mechanism(path)
    rng = np.random.default_rng(3)
    size = np.array([{"point": 1e-3, "length": 5e-4, "offset": 1e-3}.get(p.tolerance_class, 0.0)
                     for p in machine.parameters])
    g = machine.values + size * rng.normal(size=size.size)
    poses = machine.home_pose + HALF * rng.uniform(-1.0, 1.0, (50, 6))
    true = cga.motor_from_rotation_vector(poses[:, 3:], poses[:, :3])
    q = rope_lengths(machine, g, true)
    table = {f"q_{n}": 1e3 * c for n, c in zip(machine.actuators, q[:35].T, strict=True)}
    table |= {n: (1e3 if n in "xyz" else 180.0 / np.pi) * c
              for n, c in zip(("x", "y", "z", "rx", "ry", "rz"), poses[:35].T, strict=True)}
    side = {"units": {"length": "mm", "angle": "deg"}, "frame": "known", "target": "known",
            "instrument": {"kind": "pose", "sigma": {"position": 1e-7, "rotation": 1e-8,
                                                     "actuator": 1e-7}}}
    data = ppmcal.read_data(path, table, sidecar=side, name="poses")
    found = ppmcal.identify(path, data, holdout=0.0)
    ours = forward(Model(found.identification.mechanism), q[35:])
    assert ours.converged.all()
    np.testing.assert_allclose(cga.translation(ours.pose), poses[35:, :3], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(cga.rotation_vector(ours.pose), poses[35:, 3:], rtol=0.0,
                               atol=1e-9)


@pytest.mark.long
def test_pulleys_in_the_plane_define_the_frame_of_their_base(tmp_path):
    """Three coordinates of pulleys are the gauge: the zeros turn with them, by the offsets."""
    own = tree("cable-4-pulleys")
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(own), encoding="utf-8")
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(yaml.safe_dump(alone(own, {"x": 900, "y": 700, "rz": 15})),
                        encoding="utf-8")
    data = ppmcal.simulate(path, scenario).save(tmp_path / "data")
    found = ppmcal.identify(path, data[0])
    fitted = found.identification.mechanism
    assert [fitted.names[p] for p in fitted.defining] == [
        "c1.base.pulley.center.x", "c1.base.pulley.center.y", "c2.base.pulley.center.y",
        "c1.platform.point.x", "c1.platform.point.y", "c2.platform.point.y"]
