"""Ropes as another simulator has them: MuJoCo's tendons between sites, and poses of a body.

The campaign's lengths, and those of poses that it has not, come from MuJoCo alone.
"""

import numpy as np
import pytest
from helpers.redundant import apart, belts, rope_cage, written

import ppmcal
from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward

mujoco = pytest.importorskip("mujoco")

HALF = {"belts": (0.9, 0.7, 0.0, 0.0, 0.0, 0.0), "cage": (0.8, 0.6, 0.5, 0.25, 0.25, 0.25)}
FEW, FRESH = 60, 20


def points(tree, end):
    """Return the joint centres of a file (m, 3), m."""
    def value(v):
        return v["value"] if isinstance(v, dict) else v

    found = [limb[end]["point"] for limb in tree["limbs"]]
    rows = [[value(v) for v in (p.values() if isinstance(p, dict) else p)] for p in found]
    return 1e-3 * np.array([r + [0.0] * (3 - len(r)) for r in rows])


def lengths(anchors, hooks, poses):
    """Return what MuJoCo says that the ropes are long (N, m) at poses (N, 6), m and rad."""
    text = "".join(f'<site name="a{i}" pos="{x:.17g} {y:.17g} {z:.17g}"/>'
                   for i, (x, y, z) in enumerate(anchors))
    own = "".join(f'<site name="b{i}" pos="{x:.17g} {y:.17g} {z:.17g}"/>'
                  for i, (x, y, z) in enumerate(hooks))
    ropes = "".join(f'<spatial><site site="a{i}"/><site site="b{i}"/></spatial>'
                    for i in range(len(anchors)))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{text}<body><freejoint/><geom size="0.01"/>{own}</body></worldbody>'
        f"<tendon>{ropes}</tendon></mujoco>")
    data = mujoco.MjData(model)
    out = []
    for pose in poses:
        angle = float(np.linalg.norm(pose[3:]))
        axis = pose[3:] / (angle or 1.0)
        data.qpos[:] = [*pose[:3], np.cos(angle / 2.0), *(np.sin(angle / 2.0) * axis)]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_tendon(model, data)
        out.append(data.ten_length.copy())
    return np.array(out)


@pytest.mark.long_cases("rope_cage")
@pytest.mark.parametrize("tree", [belts, rope_cage], ids=lambda t: t.__name__)
@pytest.mark.slow
def test_lengths_of_another_simulator_calibrate_the_machine(tree, tmp_path):
    """Poses of which no row tells come out to less than 1e-9 m, in frames laid together."""
    file = tree()
    path = written(tmp_path, file)
    rng = np.random.default_rng(8)
    anchors, hooks = points(file, "base"), points(file, "platform")
    flat = file["motion"] == "planar-point"
    anchors += rng.normal(size=anchors.shape) * [4e-3, 4e-3, 0.0 if flat else 4e-3]
    hooks += 0.0 if flat else rng.normal(size=hooks.shape) * 4e-3
    home = np.array([1.5, 1.05, 0, 0, 0, 0] if flat else [1.5, 1.25, 1.0, 0, 0, 0])
    poses = home + np.array(HALF[file["name"]]) * rng.uniform(-1.0, 1.0, (FEW + FRESH, 6))
    read = lengths(anchors, hooks, poses)
    names = [limb["name"] for limb in file["limbs"]]
    table = {f"q_{n}": 1e3 * c for n, c in zip(names, read[:FEW].T, strict=True)}
    side = {"units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "none", "sigma": {"actuator": 1e-6}}}
    data = ppmcal.read_data(path, table, sidecar=side, name="tendons")
    found = ppmcal.identify(path, data, holdout=0.0)
    machine = found.identification.mechanism
    ours = forward(Model(machine), read[FEW:])
    assert ours.converged.all()
    true = cga.motor_from_rotation_vector(poses[FEW:, 3:], poses[FEW:, :3])
    assert apart(machine, ours.pose, true) < 1e-9
