"""Pulleys as another simulator has them: MuJoCo's tendons, wrapped around cylinders.

A rope comes from far off, straight onto its pulley; in space the pulley has turned towards the
platform. The campaign's lengths, and those of poses that it has not, come from MuJoCo alone.
"""

from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.machines import matrices
from helpers.paths import ROOT
from helpers.redundant import apart

import ppmcal
from ppmcal import algebra as cga
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse

mujoco = pytest.importorskip("mujoco")

FEW, FRESH, FAR = 60, 20, 0.4
HALF = {"planar": (0.9, 0.7, 0.0, 0.0, 0.0, 0.3), "swivel": (0.8, 0.6, 0.5, 0.25, 0.25, 0.25)}


def tree(name):
    """Return the file of a machine of one kind of pulleys, mm."""
    file = "cable-4-pulleys" if name == "planar" else "cable-8-pulleys"
    out = yaml.safe_load((ROOT / "configs" / f"{file}.yaml").read_text(encoding="utf-8"))
    if name == "swivel":
        for i, limb in enumerate(out["limbs"][:4]):
            x, y = ((0, 0), (3000, 0), (3000, 2500), (0, 2500))[i]
            # from above, and turned towards the platform
            limb["base"] = {"swivel_pulley": {"point": [x, y, 0], "axis": [0, 0, -1], "radius": 55}}
        # axes have errors of their own in another test; here they are true
        for limb in out["limbs"]:
            limb["base"]["swivel_pulley"]["axis"] = {
                "value": limb["base"]["swivel_pulley"]["axis"], "fixed": True}
    del out["limits"]
    return out


def pulley(limb, v, end):
    """Return centre, axis, radius, where the rope comes onto it, and which way: for one pose."""
    if "base.pulley.radius" in v:
        centre = np.array([v["base.pulley.center.x"], v["base.pulley.center.y"], 0.0])
        axis, r = limb.constants["base.pulley.axis"], v["base.pulley.radius"]
        start = centre + r * limb.constants["base.pulley.zero"]
        return centre, axis, r, start, np.cross(axis, start - centre) / r
    point = np.array([v[f"base.swivel_pulley.point.{a}"] for a in "xyz"])
    way, r = limb.constants["base.swivel_pulley.axis"], v["base.swivel_pulley.radius"]
    out = end - point
    out = out - (out @ way) * way
    out = out / np.linalg.norm(out)
    return point + r * out, np.cross(-out, way), r, point, way


def tendon(parts, end):
    """Return the length of a rope to a point, without what is before its pulley, m."""
    centre, axis, r, start, way = parts
    far = start - FAR * way
    side = centre + 2.0 * (start - centre + r * way)    # on which side of the pulley it runs
    turn = np.linalg.svd(axis[None])[2]
    frame = np.stack([turn[1], np.cross(axis, turn[1]), axis], axis=1)
    sites = "".join(f'<site name="{n}" pos="{" ".join(f"{c:.17g}" for c in at)}"/>'
                    for n, at in (("far", far), ("end", end), ("side", side)))
    own = " ".join(f"{c:.17g}" for c in [*frame[:, 0], *frame[:, 1]])
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{sites}<geom name="sheave" type="cylinder" size="{r:.17g} 0.01" '
        f'pos="{" ".join(f"{c:.17g}" for c in centre)}" xyaxes="{own}"/></worldbody><tendon>'
        '<spatial><site site="far"/><geom geom="sheave" sidesite="side"/><site site="end"/>'
        "</spatial></tendon></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_tendon(model, data)
    assert data.ten_wrapnum[0] == 4       # it touches the sheave
    return float(data.ten_length[0]) - FAR


def lengths(mechanism, g, pose):
    """Return the joint values (N, k) that MuJoCo's tendons say at motors (N, 8), m."""
    turn, origin = matrices(pose)
    out = np.empty((len(pose), len(mechanism.limbs)))
    for i, limb in enumerate(mechanism.limbs):
        v = limb.slots.values(g)
        ends = origin + turn @ np.array([v.get(f"platform.point.{a}", 0.0) for a in "xyz"])
        out[:, i] = [tendon(pulley(limb, v, end), end) - v["offset"] for end in ends]
    return out


@pytest.mark.parametrize("name", HALF)
@pytest.mark.long
def test_tendons_around_cylinders_calibrate_the_machine(name, tmp_path):
    """Poses of which no row tells come out to less than 1e-9 m, in frames laid together."""
    path = Path(tmp_path) / "machine.yaml"
    path.write_text(yaml.safe_dump(tree(name)), encoding="utf-8")
    machine = read_mechanism(path)
    rng = np.random.default_rng(8)
    size = np.array([{"point": 1e-3, "length": 5e-4, "offset": 1e-3}.get(p.tolerance_class, 0.0)
                     for p in machine.parameters])
    g = machine.values + size * rng.normal(size=size.size)
    poses = machine.home_pose + np.array(HALF[name]) * rng.uniform(-1.0, 1.0, (FEW + FRESH, 6))
    true = cga.motor_from_rotation_vector(poses[:, 3:], poses[:, :3])
    read = lengths(machine, g, true)
    np.testing.assert_allclose(inverse(Model(machine, g), true).q, read, rtol=0.0, atol=1e-12)
    table = {f"q_{n}": 1e3 * c for n, c in zip(machine.actuators, read[:FEW].T, strict=True)}
    side = {"units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "none", "sigma": {"actuator": 1e-7}}}
    data = ppmcal.read_data(path, table, sidecar=side, name="tendons")
    found = ppmcal.identify(path, data, holdout=0.0)
    fitted = found.identification.mechanism
    ours = forward(Model(fitted), read[FEW:])
    assert ours.converged.all()
    assert apart(fitted, ours.pose, true[FEW:]) < 1e-9
