"""TwinCAT's 3D-Delta Type 1: four lengths and changes of zeros, by geometry written out here."""

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT

from ppmcal import algebra as cga
from ppmcal import export
from ppmcal.controllers.twincat import controller
from ppmcal.controllers.twincat.controller import parse
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import read_mechanism
from ppmcal.kinematics.partial_pose import pose_motor

DELTA = ROOT / "configs" / "delta-rotary.yaml"


def tree():
    return yaml.safe_load(DELTA.read_text())


def written(folder, own):
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump(own))
    return path


def changed(value, by):
    return {"value": value + by, "nominal": value}


@pytest.mark.slow
def test_a_drawing_goes_out_as_its_four_lengths(tmp_path):
    ran = ppmcal("export", "twincat", DELTA, cwd=tmp_path, expect=0)
    assert "TwinCAT's parameters hold all of the geometry" in " ".join(ran.out.split())
    found = parse((tmp_path / "exported" / "twincat.txt").read_text())
    assert [v for _, v in found] == [150.0, 350.0, 120.0, 45.0, 0.0, 0.0, 0.0]
    assert [n for n, _ in found][:4] == list(controller.NAMES)


def test_told_to_go_somewhere_arms_and_rods_are_as_long_as_the_numbers_say():
    """The nominal machine is reached where elbows of these numbers have rods of that length."""
    machine = read_mechanism(DELTA)
    numbers = np.array([150.0, 350.0, 120.0, 45.0, 0.0, 0.0, 0.0])
    points = np.random.default_rng(3).uniform([-0.08, -0.08, -0.42], [0.08, 0.08, -0.36], (20, 3))
    pose = pose_motor(np.pad(points, ((0, 0), (0, 3))))
    at = controller._reached(machine, np.array([0.0, 120.0, 240.0]), numbers, pose)
    assert cga.translation(at) == pytest.approx(points, abs=1e-10)


@pytest.mark.slow
def test_what_all_arms_share_and_zeros_are_held_exactly(tmp_path):
    own = tree()
    for limb, by in zip(own["limbs"], (0.3, -0.2, 0.1), strict=True):
        limb["proximal"], limb["distal"] = changed(150, 0.4), changed(350, -0.6)
        limb["offset"] = changed(0, by)
    made = export("twincat", written(tmp_path, own))
    assert not made.exported.not_expressed
    assert made.exported.after.max < 1e-7 < 1e-4 < made.exported.before.rms
    new = [n.new for n in made.exported.numbers]
    assert new == pytest.approx([150.4, 349.4, 120.0, 45.0, -0.3, 0.2, -0.1], abs=1e-5)


@pytest.mark.slow
def test_arms_that_differ_are_fitted_and_told(tmp_path):
    own = tree()
    own["limbs"][0]["proximal"] = changed(150, 0.8)
    own["effects"] = [{"kind": "gain", "parameters": {"gain": 1e-4}}]
    made = export("twincat", written(tmp_path, own))
    first, second = made.exported.not_expressed
    assert "arms that differ" in first.what and first.parameters == ("a.proximal",)
    assert "effect gain" in second.what
    assert 1e-6 < made.exported.after.rms < made.exported.before.rms
    told = " ".join(str(n) for n in made.exported.notes)
    assert "could not be checked" in told and "stays nominal" in told


@pytest.mark.slow
def test_what_is_refused(tmp_path, monkeypatch):
    for option in ("old", "poses"):
        with pytest.raises(BadInput, match="compared with the nominal ones"):
            export("twincat", DELTA, **{option: DELTA})
    with pytest.raises(BadInput, match="3D-Delta Type 1 has three limbs"):
        export("twincat", ROOT / "configs" / "6-UPS.yaml")
    askew = tree()
    askew["limbs"][0]["base"]["zero"] = [1.0, 0.0, 0.2]
    askew["limbs"][0]["base"]["axis"] = [0.0, 1.0, 0.0]
    with pytest.raises(BadInput, match="not level"):
        export("twincat", written(tmp_path, askew))
    monkeypatch.setattr(controller, "parse", lambda _: [])
    with pytest.raises(NoResult, match="reads back as other numbers"):
        export("twincat", DELTA)
