"""Machines as MuJoCo's bodies: where joints are told to be, MuJoCo brings the platform where we do.

MuJoCo closes the loops by its own constraints (``helpers/in_mujoco.py``); of ours it has the file.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.machines import (
    KINDS,
    OFFSET_JOINTS,
    full,
    matrices,
    mechanism_text,
    mixed,
    offset_joints,
    plain,
    read_text,
    spread,
)
from helpers.paths import ROOT

from ppmcal import export
from ppmcal.controllers.mjcf import controller
from ppmcal.controllers.mjcf.arithmetic import read
from ppmcal.controllers.mjcf.controller import bodies_at_home
from ppmcal.controllers.mjcf.limbs import PASSIVE, parts_of
from ppmcal.controllers.mjcf.writer import text
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import inverse
from ppmcal.model.limbs import kinds

pytest.importorskip("mujoco")
from helpers.in_mujoco import Bodies

CONFIGS = sorted(p.stem for p in (ROOT / "configs").glob("*.yaml") if "pulley" not in p.stem)
MACHINES = {
    **{f"plain {k}": lambda k=k: plain(k) for k in KINDS},
    **{f"full {k}": lambda k=k: full(k) for k in KINDS},
    **{f"offset {k} {b}": lambda k=k, b=b: offset_joints(k, b, full=True)
       for k, b in OFFSET_JOINTS},
    **{f"mixed {n}": lambda n=n: mixed(n) for n in ("planar", "spatial")},
    **{c: lambda c=c: config(c) for c in CONFIGS}}
NAMED = ("3-RPR", "3-RRR-1", "3-RPS", "6-UPS", "delta-rotary", "delta-parallelograms", "3-UPU")


def config(name):
    return read_mechanism(ROOT / "configs" / f"{name}.yaml")


def bodies(machine, count):
    """Return a machine in MuJoCo, joint values (N, k) and its poses' rotations and positions."""
    machine = replace(machine, effects=())
    model = Model(machine)
    q, pose = spread(model, count)
    if machine.surplus:     # joint values of their own contradict each other there
        q = inverse(model, pose).q
    world = Bodies(text(machine, *bodies_at_home(machine)))
    assert world.names() == list(machine.actuators)
    return world, q, *matrices(pose)


@pytest.mark.long_cases("offset (P)US platform", "offset U(P)S platform", "offset (R)US base")
@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.slow_cases(
    "offset U(P)S base", "3-UPU", "offset (P)US base", "offset (R)US platform", "plain (R)RP",
    "plain R(R)P", "plain R(P)P", "plain (P)RP", "plain (R)US", "plain (P)US", "3-RPP-2", "3-RRP-1",
    "3-RRP-2", "6-RUS", "delta-parallelograms", "delta-rotary-6rods", "passive-legs", "stewart-7",
    "tricept")
def test_at_joint_values_mujoco_has_the_platform_where_we_have_it(name):
    world, q, turns, places = bodies(MACHINES[name](), 2)
    for joints, turn, place in zip(q, turns, places, strict=True):
        assert world.go(joints) < 1e-11
        position, rotation = world.pose()
        assert np.abs(position - place).max() < 1e-9
        assert np.abs(rotation - turn).max() < 1e-9


@pytest.mark.slow_cases("3-UPU", "delta-parallelograms")
@pytest.mark.parametrize("name", NAMED)
def test_its_actuators_bring_it_there(name):
    """Through servos and constraints that give way, from home, until it rests."""
    world, q, turns, places = bodies(config(name), 1)
    position, rotation = world.settled(q[0])
    assert np.abs(position - places[0]).max() < 1e-6
    assert np.abs(rotation - turns[0]).max() < 1e-6


@pytest.mark.slow
def test_ctrl_and_the_actuators_length_are_the_joint_value():
    """With a ratio and an offset; and ropes, whose offset stands in biasprm."""
    machine = full("U(P)S")
    world, q, _, _ = bodies(machine, 1)
    world.go(q[0])
    assert world.data.actuator_length == pytest.approx(q[0], abs=1e-11)
    assert machine.joint_ratios == pytest.approx(1.0 / np.abs(world.model.actuator_gear[:, 0]))
    cage = config("cable-8")
    longer = cage.with_values(cage.values + 0.02 * np.array(
        [n.endswith(".offset") for n in cage.names]))
    assert longer.values.sum() > cage.values.sum()
    world, q, _, places = bodies(longer, 1)
    assert world.go(q[0]) < 1e-11
    assert world.pose()[0] == pytest.approx(places[0], abs=1e-9)


def test_limbs_on_one_drive_follow_the_first():
    world, q, _, _ = bodies(config("delta-linear-6rods"), 1)
    assert world.model.nu == 3 and len(world.joint) == 3
    joints = np.array([world.model.joint(f"{n}").qposadr[0] for n in
                       (limb.name for limb in config("delta-linear-6rods").limbs)])
    world.go(q[0])
    pairs = world.data.qpos[joints].reshape(3, 2)
    assert pairs[:, 0] == pytest.approx(pairs[:, 1], abs=1e-9)


def test_every_closure_family_says_its_passive_joints():
    assert {k.surface.name for k in kinds().values() if not k.pulls_only} <= set(PASSIVE)


def test_a_rope_over_a_pulley_is_refused():
    """A tendon from site to site would be as long as another rope."""
    rope = kinds()["rope"]
    over = replace(rope, name="rope over a pulley",
                   surface=replace(rope.surface, name="rope over a pulley"))
    with pytest.raises(BadInput, match="is no tendon from a point to a point"):
        parts_of(over, Model(config("cable-8")).limb_values[0])


def test_no_kind_is_named():
    folder = ROOT / "ppmcal" / "controllers" / "mjcf"
    code = "".join(p.read_text() for p in folder.glob("*.py"))
    assert not [k for k in kinds() if f'"{k}"' in code]


@pytest.mark.slow
def test_effects_are_named_with_what_each_costs(tmp_path):
    tree = yaml.safe_load((ROOT / "configs" / "3-RPR.yaml").read_text())
    tree["effects"] = [{"kind": "backlash", "parameters": {"width": 0.2}},
                       {"kind": "periodic", "parameters": {"cos": 0.05, "sin": 0.02, "period": 10}}]
    path = tmp_path / "m.yaml"
    path.write_text(yaml.safe_dump(tree))
    made = export("mjcf", path)
    by_start = {lack.what.split(",")[0]: lack for lack in made.exported.not_expressed}
    assert set(by_start) == {"effect backlash", "effect periodic"}
    assert by_start["effect backlash"].cost is None
    assert "depends on dir" in by_start["effect backlash"].what
    assert by_start["effect periodic"].cost.rms == pytest.approx(made.exported.after.rms)
    assert 1e-5 < made.exported.after.rms < 1e-4
    assert "Cannot be expressed: effect backlash" in made.exported.files["machine.xml"]


@pytest.mark.slow
def test_the_command_writes_what_mujoco_reads(tmp_path):
    """Of an identified machine: its numbers, and errors of the nominal one at its joint values."""
    tree = yaml.safe_load((ROOT / "configs" / "3-RPR.yaml").read_text())
    x = tree["limbs"][0]["base"]["point"][0]
    tree["limbs"][0]["base"]["point"][0] = {"value": x + 1.0, "nominal": x}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree))
    ran = ppmcal("export", "mjcf", "m.yaml", cwd=tmp_path)
    assert ran.code == 0, ran.err
    record = json.loads((tmp_path / "exported" / "export.json").read_text())
    assert record["exact"] and record["read_back"] and record["number_units"] == {
        "leg1.base.point.x": "m"}
    assert record["gain"]["before"]["rms"] > 0.1 > 1e-9 > record["gain"]["after"]["rms"]
    content = (tmp_path / "exported" / "machine.xml").read_text()
    assert "masses, inertias and gains are placeholders" in content
    world = Bodies(content)
    world.gaps()
    assert world.data.ctrl == pytest.approx(world.data.actuator_length, abs=1e-12)


@pytest.mark.slow
def test_poses_of_a_table_are_driven_and_others_left_out(tmp_path):
    (tmp_path / "poses.csv").write_text("x,y,rz\n500,288,30\n510,295,28\n9000,0,0\n")
    made = export("mjcf", ROOT / "configs" / "3-RPR.yaml", poses=tmp_path / "poses.csv")
    assert made.exported.over == "2 poses, at the same joint values"
    (tmp_path / "poses.csv").write_text("x,y,rz\n9000,0,0\n")
    with pytest.raises(NoResult, match="takes none of the poses"):
        export("mjcf", ROOT / "configs" / "3-RPR.yaml", poses=tmp_path / "poses.csv")


@pytest.mark.slow
def test_what_is_refused(tmp_path, monkeypatch):
    path = ROOT / "configs" / "3-RPR.yaml"
    with pytest.raises(BadInput, match="compared with the nominal geometry"):
        export("mjcf", path, old=path)
    machine = plain("R(P)R")
    tilted = machine.with_values(machine.values + 1e-3 * np.array(
        [n == "leg1.joint1.rx" for n in machine.names]))
    if "leg1.joint1.rx" in machine.names:
        with pytest.raises(BadInput, match="out of the plane"):
            bodies_at_home(tilted)
    values = {**Model(machine).limb_values[0], "joint1.rx": 1e-3}
    with pytest.raises(BadInput, match="out of the plane"):
        parts_of(machine.limbs[0].kind, values)
    kind = machine.limbs[0].kind
    strange = replace(kind, surface=replace(kind.surface, name="saddle"))
    with pytest.raises(BadInput, match="its closure family is 'saddle'"):
        parts_of(strange, Model(machine).limb_values[0])
    with pytest.raises(BadInput, match="no XML"):
        read("<mujoco>")
    own = controller.text
    monkeypatch.setattr(controller, "text", lambda m, pose, home, *more, **only: own(
        m if only else m.with_values(m.values + 1e-6), pose, home, *more, **only))
    with pytest.raises(NoResult, match="reads back as another machine"):
        export("mjcf", path)


def test_a_home_off_the_limbs_surfaces_is_refused(monkeypatch):
    case = mechanism_text(yaml.safe_load(
        (ROOT / "configs" / "3-RPR.yaml").read_text())["limbs"], "planar",
        {"x": 500.0, "y": 288.0, "rz": 30.0})
    machine = read_text(case)
    monkeypatch.setattr(controller, "ALIKE", 0.0)
    with pytest.raises(NoResult, match="the joints of limb 'leg1' do not close at home"):
        bodies_at_home(machine)
