"""LinuxCNC's pentakins: a pentapod as its 25 numbers, by arithmetic after the firmware's source."""

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT
from scipy.spatial.transform import Rotation

from ppmcal import export
from ppmcal.controllers.linuxcnc import controller, pentakins
from ppmcal.controllers.linuxcnc.hal import parse_joints
from ppmcal.controllers.linuxcnc.pentakins import (
    export_pentapod,
    is_pentapod,
    parse_pins,
    strut_lengths,
)
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import read_mechanism
from ppmcal.kinematics.partial_pose import pose_motor

FEET = ((500, 0, 900), (-250, 433, 900), (-250, -433, 900), (300, 520, 300), (300, -520, 300))
RINGS = ((45, 240), (45, 200), (45, 160), (40, 0), (40, 40))


def tree():
    """Five struts, and a passive limb that keeps the platform from turning about its axis."""
    struts = [{"name": f"s{n}", "kind": "U(P)S", "base": {"point": list(foot)},
               "platform": {"point": [0, 0, z], "axis": [0, 0, 1], "axis_offset": r}}
              for n, (foot, (r, z)) in enumerate(zip(FEET, RINGS, strict=True))]
    guide = {"name": "guide", "kind": "UPU", "base": {"point": [0, 0, 1200], "axis": [1, 0, 0]},
             "platform": {"point": [0, 0, 300], "axis": [1, 0, 0]}}
    return {"format": "ppmcal/mechanism/1", "name": "pentapod",
            "units": {"length": "mm", "angle": "deg"}, "motion": "spatial",
            "limbs": [*struts, guide],
            "home": {"pose": {"x": 0, "y": 0, "z": 100, "rx": 0, "ry": 0, "rz": 0}},
            "limits": {f"s{n}": [300, 1100] for n in range(5)}}


def written(folder, own):
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump(own))
    return path


def changed(value, by):
    return {"value": value + by, "nominal": value}


def asked(numbers, pose):
    """What the firmware asks of a strut for x, y, z, A, B: mm and degrees."""
    x, y, z, a, b = pose
    turn = Rotation.from_euler("xy", [a, b], degrees=True).as_matrix()   # about fixed axes: x first
    w = turn.T @ (np.array(numbers[:3]) - [x, y, z])
    return np.sqrt((w[2] - numbers[4]) ** 2 + (np.sqrt(w[0] ** 2 + w[1] ** 2) - numbers[3]) ** 2)


def test_lengths_are_those_of_the_firmwares_source():
    rng = np.random.default_rng(4)
    numbers = np.array([[*f, *r] for f, r in zip(FEET, RINGS, strict=True)], dtype=float)
    for _ in range(20):
        pose = rng.uniform([-50, -50, 50, -20, -20], [50, 50, 150, 20, 20])
        turn = Rotation.from_euler("xy", pose[3:], degrees=True)
        # how the effector is turned about its own axis counts for nothing
        spun = turn * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-1.0, 1.0)])
        motor = pose_motor(np.array([[*1e-3 * pose[:3], *spun.as_rotvec()]]))
        found = strut_lengths(1e-3 * numbers, motor)[0]
        assert 1e3 * found == pytest.approx([asked(n, pose) for n in numbers], abs=1e-9)


@pytest.mark.slow
def test_a_nominal_pentapod_goes_out_as_it_is_drawn(tmp_path):
    """The ring is our universal joint whose axes miss each other: both arithmetics are one."""
    ran = ppmcal("export", "linuxcnc", written(tmp_path, tree()), cwd=tmp_path, expect=0)
    assert "pentakins' numbers hold all of the geometry" in " ".join(ran.out.split())
    text = (tmp_path / "exported" / "pentakins.hal").read_text()
    assert parse_pins(text, "x") == pytest.approx(
        np.array([[*f, *r] for f, r in zip(FEET, RINGS, strict=True)]), abs=1e-6)
    assert "setp pentakins.effector.0.r 45.0000000" in text


@pytest.mark.slow
def test_errors_of_feet_rings_and_drives_are_held_exactly(tmp_path):
    own = tree()
    own["limbs"][0]["base"]["point"] = [changed(500, 1.2), changed(0, -0.4), changed(900, 0.7)]
    own["limbs"][1]["platform"]["axis_offset"] = changed(45, 0.3)
    own["limbs"][2]["platform"]["point"][2] = changed(160, -0.5)
    own["limbs"][3]["offset"] = changed(0, 0.8)
    made = export("linuxcnc", written(tmp_path, own))
    assert not made.exported.not_expressed
    assert made.exported.after.max < 1e-8 < 1e-4 < made.exported.before.rms
    joints = parse_joints(made.exported.files["joints.ini"], "joints.ini")
    assert [j.shift for j in joints] == pytest.approx([0, 0, 0, 0.8, 0], abs=1e-6)
    new = {n.name: n.new for n in made.exported.numbers}
    assert new["pentakins.base.0.x"] == pytest.approx(501.2)
    assert new["pentakins.effector.1.r"] == pytest.approx(45.3)
    assert new["pentakins.effector.2.z"] == pytest.approx(159.5)


@pytest.mark.slow
def test_a_joint_beside_the_axis_is_fitted_and_told(tmp_path):
    own = tree()
    own["limbs"][0]["platform"]["point"] = [changed(0, 0.5), 0, 240]
    made = export("linuxcnc", written(tmp_path, own))
    (lack,) = made.exported.not_expressed
    assert "beside its z axis" in lack.what
    assert lack.parameters == ("s0.platform.point.x",)
    assert 1e-6 < made.exported.after.rms < 0.7 * made.exported.before.rms


@pytest.mark.slow
def test_effects_are_named(tmp_path):
    own = tree() | {"effects": [{"kind": "gain", "parameters": {"gain": 1e-4}}]}
    made = export("linuxcnc", written(tmp_path, own))
    assert [k.what.split(",")[0] for k in made.exported.not_expressed] == ["effect gain"]


@pytest.mark.slow
def test_what_is_refused(tmp_path, monkeypatch):
    path = written(tmp_path, tree())
    for option in ("old", "poses"):
        with pytest.raises(BadInput, match="compared with the nominal ones"):
            export("linuxcnc", path, **{option: path})
    with pytest.raises(BadInput, match=r"effector\.4\.z is not set"):
        parse_pins("\n".join(f"setp pentakins.{f.format(n)} 1" for n in range(5)
                             for f in pentakins.FIELDS)[:-len("\nsetp pentakins.effector.4.z 1")],
                   "x.hal")
    beside = tree()
    beside["limbs"][0]["platform"]["point"] = [60, 0, 240]
    assert not is_pentapod(read_mechanism(written(tmp_path, beside)))
    shut = tree() | {"limits": {f"s{n}": [1, 2] for n in range(5)}}
    with pytest.raises(NoResult, match="next to no pose"):
        export_pentapod(read_mechanism(written(tmp_path, shut)), None, None)
    monkeypatch.setattr(pentakins, "parse_pins", lambda *_: np.zeros((5, 5)))
    with pytest.raises(NoResult, match="read back as other numbers"):
        export_pentapod(read_mechanism(written(tmp_path, tree())), None, None)


def test_no_machine_here_is_a_serial_arm():
    """The refusal says which modules there are, and why genserkins is none of them."""
    with pytest.raises(BadInput, match="genhexkins takes six limbs") as refused:
        controller.export(read_mechanism(ROOT / "configs" / "3-RPR.yaml"), None, None)
    assert "genserkins is for serial arms" in str(refused.value)
