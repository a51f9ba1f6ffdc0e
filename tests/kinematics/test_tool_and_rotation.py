"""Kinematics of a tool point, and rotations as Euler angles and quaternions."""

import csv
import json

import numpy as np
import pytest
from helpers import machines
from helpers.commands import ppmcal
from helpers.paths import ROOT
from scipy.spatial.transform import Rotation

from ppmcal.errors import BadInput
from ppmcal.io.pose_fields import check_convention
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import PoseConvention, pose_motor, pose_vector
from ppmcal.kinematics.rotations import (
    ORDERS,
    euler_like,
    euler_rates,
    from_euler,
    to_euler,
    to_quaternion,
)
from ppmcal.kinematics.tables import forward_table, inverse_table, tool_poses, velocity_table
from ppmcal.model.dataset import environment

TOOL = {"planar": np.array([0.031, -0.047, 0.0])}
SPATIAL_TOOL = np.array([0.021, -0.034, -0.09])
FREE = {"R(P)R": lambda: machines.plain("R(P)R"), "(R)RR": lambda: machines.plain("(R)RR"),
        "U(P)S": lambda: machines.plain("U(P)S"), "(R)US": lambda: machines.plain("(R)US"),
        "delta": lambda: machines.delta("(P)US", 3)}
SHORT = {"3-RPS": (lambda: machines.plain("R(P)S"), (0, 1, 5)),
         "delta of six rods": (lambda: machines.delta("(R)US", 6), (3, 4, 5))}


def tool_of(mechanism):
    """Return a tool point off the platform's origin, m."""
    return TOOL.get(mechanism.motion.name, SPATIAL_TOOL)


def carried(pose, tool):
    """Return where the tool's frame is (N, 6), by SciPy alone."""
    rotation, origin = machines.matrices(pose)
    return np.concatenate([origin + rotation @ tool, Rotation.from_matrix(rotation).as_rotvec()],
                          axis=1)


@pytest.mark.parametrize("name", FREE)
def test_poses_of_the_tool_there_and_back(name):
    mechanism = FREE[name]()
    model, tool = Model(mechanism), tool_of(FREE[name]())
    q, pose = machines.spread(model, 6)
    seen = tool_poses(model, forward_table(model, q).pose, tool)
    np.testing.assert_allclose(seen, carried(pose, tool), rtol=0, atol=1e-12)
    assert np.abs(seen - pose_vector(pose)).max() > 0.01
    table = inverse_table(model, seen, convention=PoseConvention(tool))
    assert table.status == ("ok",) * 6
    np.testing.assert_allclose(table.q, q, rtol=0, atol=1e-10)
    np.testing.assert_allclose(table.pose, pose_vector(pose), rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", SHORT)
def test_open_coordinates_are_those_of_the_tool(name):
    """A machine that names only some coordinates meets them with its tool, not its origin."""
    mechanism, open_ = SHORT[name][0](), list(SHORT[name][1])
    model, tool = Model(mechanism), SPATIAL_TOOL
    q, pose = machines.spread(model, 6)
    wanted = carried(pose, tool)
    wanted[:, open_] = np.nan
    table = inverse_table(model, wanted, convention=PoseConvention(tool))
    assert table.status == ("ok",) * 6
    np.testing.assert_allclose(table.q, q, rtol=0, atol=1e-9)
    full = inverse_table(model, carried(pose, tool), convention=PoseConvention(tool))
    np.testing.assert_allclose(full.q, q, rtol=0, atol=1e-9)
    bare = inverse_table(model, wanted)
    assert not np.allclose(bare.q, q, atol=1e-6)


@pytest.mark.parametrize("name", [*FREE, *SHORT])
def test_velocities_of_the_tool_are_derivatives(name):
    mechanism = (FREE[name] if name in FREE else SHORT[name][0])()
    model, tool, h = Model(mechanism), tool_of(mechanism), 1e-4
    q, pose = machines.spread(model, 5)
    rate = np.random.default_rng(8).uniform(-1, 1, q.shape) * machines.joint_steps(model)
    after, before = (pose_motor(forward_table(model, q + s * rate).pose) for s in (h, -h))
    twist = machines.difference(after, before) / (2.0 * h)
    twist[:, :3] = (carried(after, tool) - carried(before, tool))[:, :3] / (2.0 * h)
    if name in SHORT:
        twist[:, list(SHORT[name][1])] = np.nan
    at = carried(pose, tool)
    table = velocity_table(model, at, twist, convention=PoseConvention(tool))
    assert table.status == ("ok",) * 5
    np.testing.assert_allclose(table.rate, rate, rtol=0, atol=1e-7 * np.abs(rate).max())
    if not name.startswith("delta"):  # a delta does not turn: all its points move alike
        origin = velocity_table(model, pose_vector(pose), twist)
        assert np.abs(origin.rate - rate).max() > 1e-3 * np.abs(rate).max()


def test_the_tool_of_a_machine_with_effects():
    text = machines.plain_text("U(P)S", effects=[
        {"kind": "compliance", "parameters": {"stiffness": 2000.0}},
        {"kind": "base_compliance", "parameters": {"z_fz": 1e-3, "rx_fz": 1e-4}}])
    mechanism = machines.read_text(text)
    model = Model(mechanism)
    load = environment({"payload": np.array([20.0, 20.0])}, mechanism.actuators, mechanism.gravity,
                       np.zeros((2, 6)))
    wanted = np.tile(carried(mechanism.home[None], SPATIAL_TOOL), (2, 1))
    wanted[1] += [0.01, -0.02, 0.0, 0.05, 0.0, 0.02]
    table = inverse_table(model, wanted, load, PoseConvention(SPATIAL_TOOL))
    assert table.status == ("ok", "ok")
    back = forward_table(model, table.q, load)
    np.testing.assert_allclose(tool_poses(model, back.pose, SPATIAL_TOOL), wanted, rtol=0,
                               atol=1e-9)
    rigid = inverse_table(Model(machines.plain("U(P)S")), wanted,
                          convention=PoseConvention(SPATIAL_TOOL))
    assert np.abs(rigid.q - table.q).max() > 1e-5


# --- rotations --------------------------------------------------------------------------------

def elementary(letter, angle):
    """Return the rotation matrix about one axis."""
    c, s = np.cos(angle), np.sin(angle)
    turned = {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
              "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}
    return np.array(turned[letter.lower()])


@pytest.mark.parametrize("order", ORDERS)
def test_an_order_is_a_product_of_three_turns(order):
    assert len(ORDERS) == 24
    angles = np.array([[0.3, 1.1, -0.7], [-2.0, 0.4, 2.5], [np.nan] * 3])
    for row, vector in zip(angles[:2], from_euler(angles, f"euler-{order}"), strict=False):
        first, second, third = (elementary(o, a) for o, a in zip(order, row, strict=True))
        turned = third @ second @ first if order.islower() else first @ second @ third
        np.testing.assert_allclose(Rotation.from_rotvec(vector).as_matrix(), turned, atol=1e-14)
    back, locked = to_euler(from_euler(angles, f"euler-{order}"), f"euler-{order}")
    np.testing.assert_allclose(back, angles, rtol=0, atol=1e-12)
    assert not locked.any()


@pytest.mark.parametrize("order", ORDERS)
def test_gimbal_lock_is_told_and_loses_nothing(order):
    middle = 0.0 if order[0] == order[2] else np.pi / 2.0
    vector = from_euler(np.array([[0.4, middle, 0.3], [0.4, middle - 0.2, 0.3]]), f"euler-{order}")
    angles, locked = to_euler(vector, f"euler-{order}")
    assert locked.tolist() == [True, False]
    assert angles[0, 2] == 0.0
    turns = Rotation.from_rotvec(from_euler(angles, f"euler-{order}")).inv() * Rotation.from_rotvec(
        vector)
    assert turns.magnitude().max() < 1e-7


@pytest.mark.parametrize("order", ORDERS)
def test_rates_of_euler_angles_are_derivatives(order):
    angles, h = np.array([[0.3, 1.1, -0.7], [-2.0, 0.4, 2.5]]), 1e-5
    for i in range(3):
        after, before = (Rotation.from_rotvec(from_euler(
            angles + s * h * np.eye(3)[i], f"euler-{order}")) for s in (1.0, -1.0))
        np.testing.assert_allclose(euler_rates(angles, f"euler-{order}")[:, :, i],
                                   (after * before.inv()).as_rotvec() / (2.0 * h), atol=1e-9)


@pytest.mark.parametrize("order", [o for o in ORDERS if o[0] != o[2]])
def test_single_euler_angles_can_be_left_open(order):
    """Of a tripod that names z and two angles, with a tool; the third follows."""
    mechanism = machines.plain("R(P)S")
    model, convention = Model(mechanism), PoseConvention(SPATIAL_TOOL, f"euler-{order}")
    q, pose = machines.spread(model, 5)
    seen = carried(pose, SPATIAL_TOOL)
    wanted = np.concatenate([seen[:, :3], to_euler(seen[:, 3:], convention.rotation)[0]], axis=1)
    full = inverse_table(model, wanted, convention=convention)
    np.testing.assert_allclose(full.q, q, rtol=0, atol=1e-9)
    wanted[:, [0, 1, 3 + order.lower().index("z")]] = np.nan
    table = inverse_table(model, wanted, convention=convention)
    assert table.status == ("ok",) * 5
    np.testing.assert_allclose(table.q, q, rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", [o for o in ORDERS if o[0] == o[2] and o[0] in "zZ"])
@pytest.mark.parametrize("tilt", [0.2, -0.2, 1e-7, 0.0])
def test_tilt_and_azimuth_of_a_tripod_that_is_level_at_home(order, tilt):
    """Home is in gimbal lock: the azimuth has no rate there, and the open turn follows all the
    same, so that the three angles are the pose."""
    mechanism, convention = level_tripod(), PoseConvention(rotation=f"euler-{order}")
    model = Model(mechanism)
    for azimuth, open_ in ((0.6, 5), (-2.4, 5), (0.6, 3)):
        wanted = np.full((1, 6), np.nan)
        wanted[0, 2], wanted[0, 4], wanted[0, 8 - open_] = 0.1, tilt, azimuth
        table = inverse_table(model, wanted, convention=convention)
        assert table.status == ("ok",)
        angles, locked = euler_like(table.pose[:, 3:], wanted[:, 3:], convention.rotation)
        named = np.isfinite(wanted[0, 3:])
        np.testing.assert_allclose(angles[0, named], wanted[0, 3:][named], atol=1e-6)
        off = Rotation.from_rotvec(from_euler(angles, convention.rotation)).inv() * (
            Rotation.from_rotvec(table.pose[:, 3:]))
        assert off.magnitude().max() < 1e-6 and not locked.any()
        np.testing.assert_allclose(forward_table(model, table.q).pose, table.pose, atol=1e-9)
        height = Rotation.from_rotvec(table.pose[0, 3:]).as_matrix()[2, 2]
        assert np.arccos(min(height, 1.0)) == pytest.approx(abs(tilt), abs=1e-7)


def level_tripod():
    """Return a 3-RPS machine, level at home."""
    return machines.read_text(machines.plain_text("R(P)S", lambda i, limb: limb | {
        "base": limb["base"] | {"point": machines._turned([85.0, 0.0, 0.0], 120.0 * i),
                                "axis": machines._turned([0.0, 1.0, 0.0], 120.0 * i)},
        "platform": {"point": machines._turned([51.0, 0.0, 0.0], 120.0 * i)}}))


@pytest.mark.parametrize("order", ORDERS)
def test_angles_in_gimbal_lock_are_taken_as_they_are(order):
    """Inverse and velocity of poses at which two of three named angles turn about one axis."""
    middle = 0.0 if order[0] == order[2] else np.pi / 2.0
    angles = np.array([[0.7, middle, -0.5], [0.2, -middle, 0.0], [0.3, middle + 1e-9, 0.1]])
    own, locked = euler_like(from_euler(angles, f"euler-{order}"), angles, f"euler-{order}")
    np.testing.assert_allclose(own, angles, atol=1e-6)
    assert not locked.any()
    mechanism = machines.plain("U(P)S")
    model, tool = Model(mechanism), SPATIAL_TOOL
    if order[0] != order[2]:
        return  # a quarter turn is beyond this machine
    at = np.concatenate([np.tile(carried(mechanism.home[None], tool)[:, :3], (3, 1)),
                         0.02 * angles], axis=1)
    at[:, 4] = [0.0, 0.0, 1e-9]
    twist = np.random.default_rng(2).uniform(-0.1, 0.1, (3, 6))
    vector = np.concatenate([at[:, :3], from_euler(at[:, 3:], f"euler-{order}")], axis=1)
    for one, other in ((inverse_table(model, at, convention=PoseConvention(tool, f"euler-{order}")),
                        inverse_table(model, vector, convention=PoseConvention(tool))),
                       (velocity_table(model, at, twist,
                                       convention=PoseConvention(tool, f"euler-{order}")),
                        velocity_table(model, vector, twist, convention=PoseConvention(tool)))):
        assert one.status == ("ok",) * 3
        np.testing.assert_allclose(one.q, other.q, atol=1e-12)
        np.testing.assert_allclose(one.rate, other.rate, atol=1e-12)


def test_effects_are_made_up_for_in_gimbal_lock():
    """The base gives way and tilts: joints that level the platform again, whatever the azimuth."""
    mechanism = machines.read_text(machines.plain_text("U(P)S", effects=[
        {"kind": "base_compliance", "parameters": {"z_fz": 1e-3, "rx_fz": 1e-4}}]))
    model = Model(mechanism)
    load = environment({"payload": np.array([20.0])}, mechanism.actuators, mechanism.gravity,
                       np.zeros((1, 6)))
    wanted = np.concatenate([mechanism.home_pose[:3], [0.5, 0.0, -0.4]])[None]
    table = inverse_table(model, wanted, load, PoseConvention(rotation="euler-ZYZ"))
    assert table.status == ("ok",)
    reached = forward_table(model, table.q, load).pose
    np.testing.assert_allclose(reached, [[*wanted[0, :3], 0.0, 0.0, 0.1]], atol=1e-9)


@pytest.mark.long
def test_open_angles_of_files_go_with_the_named_ones(tmp_path):
    (tmp_path / "m.yaml").write_text((ROOT / "configs" / "3-RPS.yaml").read_text())
    names = ["x", "y", "z", "euler_1", "euler_2", "euler_3"]
    wanted = [[np.nan, np.nan, 100.0, 30.0, tilt, np.nan] for tilt in (0.0, 8.0, -8.0)]
    write(tmp_path / "p.csv", names, wanted)
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--rotation", "euler-ZYZ", cwd=tmp_path,
           expect=0)
    found = read(tmp_path / "kinematics" / "kinematics.csv", names)
    np.testing.assert_allclose(found[:, 3:], [[30.0, t, -30.0] for t in (0.0, 8.0, -8.0)],
                               atol=1e-6)


def test_the_parasitic_turn_of_a_tripod():
    """[IK]: tan gamma = sin a sin b / (cos a + cos b) with R = Rz(gamma) Ry(b) Rx(a)."""
    tripod = machines.read_text(machines.plain_text("R(P)S", lambda i, limb: limb | {
        "base": limb["base"] | {"point": machines._turned([85.0, 0.0, 0.0], 120.0 * i)},
        "platform": {"point": machines._turned([51.0, 0.0, 0.0], 120.0 * i)}}))
    a, b = np.array([0.1, -0.25]), np.array([0.2, 0.15])
    wanted = np.full((2, 6), np.nan)
    wanted[:, 2], wanted[:, 3], wanted[:, 4] = 0.1, a, b
    table = inverse_table(Model(tripod), wanted, convention=PoseConvention(rotation="euler-xyz"))
    assert table.status == ("ok", "ok")
    gamma = to_euler(table.pose[:, 3:], "euler-xyz")[0][:, 2]
    np.testing.assert_allclose(np.tan(gamma), np.sin(a) * np.sin(b) / (np.cos(a) + np.cos(b)),
                               rtol=1e-9)


def test_quaternions_have_their_scalar_last_and_not_negative():
    vector = np.array([[0.0, 0.0, np.pi / 2.0], [0.0, 3.0, -2.0], [np.nan] * 3])
    quaternion = to_quaternion(vector)
    np.testing.assert_allclose(quaternion[0], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
    assert (quaternion[:2, 3] >= 0.0).all() and np.isnan(quaternion[2]).all()


# --- the command ------------------------------------------------------------------------------

def write(path, names, values):
    """Write a table of numbers."""
    path.write_text(",".join(names) + "\n" + "".join(
        ",".join("" if np.isnan(v) else repr(float(v)) for v in row) + "\n" for row in values))


def read(path, names=None):
    """Return the named columns of a CSV as numbers (N, len(names)), or all as text."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    if names is None:
        return rows
    return np.array([[float(row[n]) for n in names] for row in rows])


@pytest.fixture
def hexapod(tmp_path):
    """A 6-UPS machine file, and joint values of poses that turn about all axes."""
    (tmp_path / "m.yaml").write_text(machines.plain_text("U(P)S"))
    mechanism = machines.plain("U(P)S")
    q, pose = machines.spread(Model(mechanism), 4, size=2.0)
    write(tmp_path / "q.csv", [f"q_{a}" for a in mechanism.actuators], 1e3 * q)
    return tmp_path, mechanism, q, pose


@pytest.mark.slow
@pytest.mark.parametrize("rotation", ["quat", *(f"euler-{o}" for o in ORDERS)])
def test_forward_and_inverse_through_files(hexapod, rotation):
    folder, mechanism, q, pose = hexapod
    asked = ("--tool", "21,-34,-90", "--rotation", rotation)
    ppmcal("kinematics", "forward", "m.yaml", "q.csv", *asked, "--out", "f", cwd=folder, expect=0)
    turned = (["quat_x", "quat_y", "quat_z", "quat_w"] if rotation == "quat" else
              ["euler_1", "euler_2", "euler_3"])
    names = ["x", "y", "z", *turned]
    found = read(folder / "f" / "kinematics.csv", names)
    head = list(read(folder / "f" / "kinematics.csv")[0])
    assert "rx" not in head and head[6:13] == [*names, "condition"][:7]
    np.testing.assert_allclose(found[:, :3], 1e3 * carried(pose, SPATIAL_TOOL)[:, :3], atol=1e-8)
    matrices = machines.matrices(pose)[0]
    own = (Rotation.from_quat(found[:, 3:]) if rotation == "quat" else
           Rotation.from_euler(rotation.removeprefix("euler-"), found[:, 3:], degrees=True))
    np.testing.assert_allclose(own.as_matrix(), matrices, atol=1e-10)
    write(folder / "p.csv", names, found)
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", *asked, "--out", "g", cwd=folder, expect=0)
    joints = [f"q_{a}" for a in mechanism.actuators]
    np.testing.assert_allclose(read(folder / "g" / "kinematics.csv", joints), 1e3 * q, atol=1e-7)
    said = json.loads((folder / "g" / "kinematics.json").read_text())
    assert said["rotation"] == rotation
    assert said["tool"]["unit"] == "mm" and said["tool"]["point"] == pytest.approx([21, -34, -90])
    assert {n: said["units"].get(n) for n in names[:3]} == dict.fromkeys("xyz", "mm")
    assert all(said["units"].get(n) == ("" if rotation == "quat" else "deg") for n in turned)


def test_gimbal_lock_is_a_note_not_a_warning(hexapod):
    folder, mechanism, _, _ = hexapod
    level = machines.read_text(machines.plain_text("U(P)S")
                               .replace("rx: 2.0", "rx: 0.0").replace("ry: -3.0", "ry: 0.0")
                               .replace("rz: 1.0", "rz: 10.0"))
    q = home_state(level).q
    write(folder / "q.csv", [f"q_{a}" for a in mechanism.actuators], 1e3 * q[None])
    run = ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--rotation", "euler-zxz", cwd=folder,
                 expect=0)
    (row,) = read(folder / "kinematics" / "kinematics.csv")
    assert row["status"] == "ok" and "gimbal lock" in row["reason"]
    assert "gimbal lock" in run.out and not run.err
    assert float(row["euler_3"]) == 0.0 and float(row["euler_1"]) == pytest.approx(10.0, abs=1e-6)


@pytest.mark.parametrize("rotation", ["rotvec", "euler-xyz"])
@pytest.mark.long
def test_open_coordinates_of_the_tool_are_filled_in(tmp_path, rotation):
    (tmp_path / "m.yaml").write_text(machines.plain_text("R(P)S"))
    names = ["x", "y", "z", *(["rx", "ry", "rz"] if rotation == "rotvec" else
                              ["euler_1", "euler_2", "euler_3"])]
    wanted = np.array([[np.nan, np.nan, 20.0, 4.0, -3.0, np.nan]])
    write(tmp_path / "p.csv", names, wanted)
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--tool", "10,5,-80", "--rotation",
           rotation, cwd=tmp_path, expect=0)
    found = read(tmp_path / "kinematics" / "kinematics.csv", names)
    np.testing.assert_allclose(found[0, [2, 3, 4]], wanted[0, [2, 3, 4]], rtol=1e-15)
    joints = ["q_leg1", "q_leg2", "q_leg3"]
    write(tmp_path / "q.csv", joints, read(tmp_path / "kinematics" / "kinematics.csv", joints))
    ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--tool", "10,5,-80", "--out", "f",
           "--rotation", rotation, cwd=tmp_path, expect=0)
    np.testing.assert_allclose(read(tmp_path / "f" / "kinematics.csv", names), found, atol=1e-7)


@pytest.mark.slow
def test_velocity_of_a_planar_tool_through_files(tmp_path):
    (tmp_path / "m.yaml").write_text(machines.plain_text("R(P)R"))
    step = 1e-4
    pose, speed = np.array([15.0, -8.0, 25.0]), np.array([3.0, -2.0, 4.0])
    write(tmp_path / "p.csv", ["x", "y", "rz"], [pose - step * speed, pose + step * speed])
    write(tmp_path / "v.csv", ["x", "y", "rz", "vx", "vy", "wz"], [[*pose, *speed]])
    tool = ("--tool", "40,-25")
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", *tool, "--out", "g", cwd=tmp_path, expect=0)
    ppmcal("kinematics", "velocity", "m.yaml", "v.csv", *tool, "--out", "v", cwd=tmp_path, expect=0)
    before, after = read(tmp_path / "g" / "kinematics.csv", ["q_leg1", "q_leg2", "q_leg3"])
    rate = read(tmp_path / "v" / "kinematics.csv", ["rate_leg1", "rate_leg2", "rate_leg3"])
    np.testing.assert_allclose(rate[0], (after - before) / (2.0 * step), rtol=0, atol=1e-5)


@pytest.mark.parametrize(("arguments", "says"), [
    (["inverse", "m.yaml", "p.csv", "--tool", "1,2"], "--tool"),
    (["inverse", "m.yaml", "p.csv", "--rotation", "euler-xyy"], "Allowed: rotvec, quat, euler-"),
    (["inverse", "m.yaml", "p.csv", "--rotation", "euler-xyz"], "the column rx is not of"),
    (["inverse", "m.yaml", "two.csv", "--rotation", "euler-xyz"], "no column euler_3"),
    (["inverse", "m.yaml", "part.csv"], "the column euler_1 is not of"),
    (["inverse", "m.yaml", "p.csv", "--dataset", "a"], "--dataset goes with forward"),
    (["forward", "m.yaml", "q.csv", "--dataset", "a", "--tool", "1,2,3"], "do not go together"),
    (["inverse", "planar.yaml", "p.csv", "--rotation", "quat"], "its rotation is rz"),
    (["inverse", "planar.yaml", "p.csv", "--tool", "1,2,3"], "X,Y in mm")])
def test_what_does_not_go_is_refused(hexapod, arguments, says):
    folder = hexapod[0]
    (folder / "planar.yaml").write_text(machines.plain_text("R(P)R"))
    write(folder / "p.csv", ["x", "y", "z", "rx", "ry", "rz"], [[0, 0, 450, 0, 0, 0]])
    write(folder / "part.csv", ["x", "y", "z", "euler_1", "euler_2", "euler_3"],
          [[0, 0, 450, 1, np.nan, 3]])
    write(folder / "two.csv", ["x", "y", "z", "euler_1", "euler_2"], [[0, 0, 450, 1, 2]])
    run = ppmcal("kinematics", *arguments, cwd=folder, expect=2)
    assert says in " ".join(run.err.split())
    assert not (folder / "kinematics").exists()


def test_a_convention_that_nobody_knows_names_the_nearest():
    with pytest.raises(BadInput, match="Did you mean 'euler-xyz'"):
        check_convention("eulerxyz", machines.plain("U(P)S"))
