"""Stiffness: the file's springs, the tool's compliance by independent ways, and the command."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers import machines
from helpers.commands import columns, number, ppmcal, rows, write_csv
from helpers.paths import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ppmcal.design.spring_model import springs_of
from ppmcal.design.stiffness import Compliance, compliance, stiffness_at_home, stiffness_table
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import csv_text, read_mechanism, write_mechanism
from ppmcal.io.mechanism_blocks import joint_names
from ppmcal.io.results.tables import pose_columns
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.region import Grid, slice_axes
from ppmcal.kinematics.tables import inverse_table
from ppmcal.model.dataset import environment
from ppmcal.model.effects import Shift
from ppmcal.model.mechanism import Limb, Mechanism

Array = np.ndarray
CONFIGS = ROOT / "configs"
NAMES = sorted(p.stem for p in CONFIGS.glob("*.yaml"))
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
PLAIN = {"bar": 5e4, "drive": 2e5}
"""Works in every file: N/mm or N m/deg."""
HEXAPOD = {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0}
PLANAR = {"x": 500, "y": 260, "rz": 30}
"""Poses that 6-UPS and 3-RPR reach."""
BARS = {"(P)US": "length", "(R)US": "distal", "(P)RR": "length", "(R)RR": "distal"}
"""Kinds whose bar is a slot of its own."""


def edited(folder: Path, name: str, limbs: Callable[[int, dict[str, Any]], dict[str, Any]]
           | None = None, **change: Any) -> Path:
    """A shipped machine with other top-level keys, None to take one out, and other limbs."""
    whole = {**yaml.safe_load((CONFIGS / f"{name}.yaml").read_text()), **change}
    if limbs:
        whole["limbs"] = [limbs(i, dict(limb)) for i, limb in enumerate(whole["limbs"])]
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in whole.items() if v is not None},
                                   sort_keys=False))
    return path


def machine(folder: Path, name: str, **change: Any) -> Mechanism:
    return read_mechanism(edited(folder, name, **change))


def with_springs(mechanism: Mechanism, value: Callable[[Limb, str], float | None]) -> Mechanism:
    """A machine with a spring in every part for which there is a value, SI."""
    parts = [["bar", "drive", *(s.name for s in limb.kind.joint_slots)]
             for limb in mechanism.limbs]
    return replace(mechanism, stiffness=tuple(
        {p: v for p in own if (v := value(limb, p)) is not None}
        for limb, own in zip(mechanism.limbs, parts, strict=True)))


@cache
def sprung(kind: str) -> Mechanism:
    """A machine of one kind, offsets and drive ratios included, every part a spring."""
    rng = np.random.default_rng(len(kind))
    turning = machines.full(kind).limbs[0].kind.actuator == "angle"

    def value(limb: Limb, part: str) -> float:
        turns = turning if part == "drive" else part.rpartition(".")[2].startswith("r")
        return float(rng.uniform(1.0, 5.0) * (1e5 if turns else 1e7))

    return with_springs(machines.full(kind), value)


def listed(folder: Path, *poses: dict[str, float]) -> tuple[str, Path]:
    """Options for a list of poses, file units: no map is drawn, which takes most of the time."""
    write_csv(folder / "p.csv", list(poses))
    return "--poses", folder / "p.csv"


def at_home(mechanism: Mechanism, tool: Array | None = None) -> Compliance:
    return stiffness_at_home(mechanism, tool).compliance


def stiffness_json(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "stiffness.json").read_text())
    assert isinstance(found, dict)
    return found


# --- the file ---------------------------------------------------------------------------------

def test_the_section_is_read_in_the_files_units_and_limbs_go_before_it(tmp_path: Path) -> None:
    own = [{"bar": 4e4}, {"drive": math.inf, "joint2": {"rx": 7.0}}, None]
    mechanism = machine(
        tmp_path, "3-RPR", stiffness={**PLAIN, "joint1": 3e5, "joint2": {"x": 1e5, "rz": 2.0}},
        limbs=lambda i, limb: limb | ({"stiffness": own[i]} if own[i] else {}))
    joint = {f"joint1.{c}": 3e8 for c in "xyz"}
    second = {"joint2.x": 1e8, "joint2.rz": pytest.approx(2.0 * 180.0 / np.pi)}
    assert mechanism.stiffness[0] == {"bar": 4e7, "drive": 2e8} | joint | second
    assert mechanism.stiffness[1] == {"bar": 5e7} | joint | {
        "joint2.rx": pytest.approx(7.0 * 180.0 / np.pi)}
    assert mechanism.stiffness[2] == {"bar": 5e7, "drive": 2e8} | joint | second


def test_a_drive_that_turns_is_per_angle_one_that_slides_per_length(tmp_path: Path) -> None:
    for name, si in (("3-RRR-1", 2e5 * 180.0 / np.pi), ("3-PRR-1", 2e8), ("linapod", 2e5)):
        mechanism = machine(tmp_path, name, stiffness={"drive": 2e5})
        assert mechanism.stiffness[0]["drive"] == pytest.approx(si, rel=1e-14)


def test_nothing_said_or_all_rigid_is_no_stiffness(tmp_path: Path) -> None:
    for section in (None, {}, {"bar": math.inf, "joint2": math.inf}):
        mechanism = machine(tmp_path, "3-RPR", stiffness=section)
        assert mechanism.stiffness == ()
        assert "stiffness" not in yaml.safe_load(write_mechanism(mechanism))


values = st.one_of(st.floats(1e-6, 1e9), st.just(math.inf))
components = st.dictionaries(st.sampled_from(["x", "y", "z", "rx", "ry", "rz"]), values)
sections = st.fixed_dictionaries({}, optional={
    "bar": values, "drive": values, **{f"joint{n}": st.one_of(values, components)
                                       for n in (1, 2, 3)}})


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(st.sampled_from(["3-RPR", "linapod", "6-RUS", "mixed-planar"]), sections,
       st.lists(sections, min_size=3, max_size=3))
def test_what_is_written_reads_back_equal(name: str, section: dict[str, Any],
                                          own: list[dict[str, Any]]) -> None:
    whole = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text()) | {"stiffness": section}
    for i, limb in enumerate(whole["limbs"]):
        limb["stiffness"] = own[i % 3]
    first = machines.read_text(yaml.safe_dump(whole))
    text = write_mechanism(first)
    again = machines.read_text(text)
    assert again.stiffness == first.stiffness
    assert write_mechanism(again) == text


def test_a_file_laid_over_another_adds_components(tmp_path: Path) -> None:
    edited(tmp_path, "3-RPR", stiffness={"bar": 5e4, "joint2": 1e5})
    top = tmp_path / "top.yaml"
    top.write_text("extends: m.yaml\nstiffness: {joint2: {rz: 3}}\n")
    found = read_mechanism(top).stiffness[0]
    assert list(found) == ["bar", "joint2.x", "joint2.y", "joint2.z", "joint2.rz"]
    assert found["joint2.x"] == 1e8


@pytest.mark.parametrize(("section", "place", "says"), [
    (5e4, "stiffness", "is not a mapping"),
    ([5e4], "stiffness", "bar, drive, joint1, joint2, joint3"),
    ({"bars": 5e4}, "stiffness", "Did you mean 'bar'?"),
    ({"joint4": 5e4}, "stiffness", "Allowed: bar, drive, joint1, joint2, joint3"),
    ({"joint1": {"q": 1.0}}, "stiffness.joint1", "Allowed: x, y, z, rx, ry, rz"),
    ({"bar": 0}, "stiffness.bar", "0 is not a stiffness"),
    ({"bar": -5.0}, "stiffness.bar", "Write a positive number, or .inf for rigid"),
    ({"drive": math.nan}, "stiffness.drive", "nan is not a stiffness"),
    ({"drive": True}, "stiffness.drive", "True is not a stiffness"),
    ({"drive": None}, "stiffness.drive", "nothing is not a stiffness"),
    ({"bar": "stiff"}, "stiffness.bar", "'stiff' is not a stiffness"),
    ({"bar": 1e300}, "stiffness.bar", "out of range"),
    ({"joint2": {"rz": 1e-300}}, "stiffness.joint2.rz", "out of range"),
    ({"joint2": [1, 2, 3]}, "stiffness.joint2", "is not a stiffness"),
])
def test_refused(tmp_path: Path, section: Any, place: str, says: str) -> None:
    path = edited(tmp_path, "3-RPR", stiffness=section)
    run = ppmcal("stiffness", path, cwd=tmp_path, expect=2)
    assert f"{path}: {place}:" in run.err and says in run.err and len(run.err.splitlines()) == 1
    path = edited(tmp_path, "3-RPR", limbs=lambda i, limb: limb | (
        {"stiffness": section} if i == 1 else {}))
    run = ppmcal("stiffness", path, cwd=tmp_path, expect=2)
    assert f"limbs.leg2.{place}:" in run.err and says in run.err
    assert [p.name for p in tmp_path.iterdir()] == ["m.yaml"]


def test_one_drive_cannot_have_two_stiffnesses(tmp_path: Path) -> None:
    path = edited(tmp_path, "delta-linear-6rods", stiffness=PLAIN,
                  limbs=lambda i, limb: limb | ({"stiffness": {"drive": 1e5}} if i == 3 else {}))
    run = ppmcal("stiffness", path, cwd=tmp_path, expect=2)
    assert "limbs.b2.stiffness.drive" in run.err and "b1" in run.err


def test_a_file_without_stiffness_is_refused_with_a_line_to_add(tmp_path: Path) -> None:
    run = ppmcal("stiffness", CONFIGS / "3-RPR.yaml", cwd=tmp_path, expect=2)
    assert f"{CONFIGS / '3-RPR.yaml'}: stiffness:" in run.err
    assert "`stiffness: {bar: 5e4, drive: 2e5}`" in run.err and "N/mm" in run.err
    assert not list(tmp_path.iterdir())


# --- two ways to the same compliance ----------------------------------------------------------

def numeric(mechanism: Mechanism, q: Array, pose: Array) -> tuple[Array, Array]:
    """Return A (d, d) and dc/d(spring) (d, S) by differences of plain 4x4 matrices."""
    model, h = Model(mechanism), 1e-6
    steps = h * np.eye(6)[list(mechanism.dof)]
    a = np.stack([(machines.limb_lengths(model, q, machines.displaced(pose, s))
                   - machines.limb_lengths(model, q, machines.displaced(pose, -s)))[0] / (2 * h)
                  for s in steps], axis=-1)
    springs = springs_of(mechanism)
    b = np.zeros((mechanism.equations, len(springs)))
    where = machines.rows_of(mechanism)
    for k, spring in enumerate(springs):
        if spring.part == "bar":
            b[where[spring.limb].start, k] = 1.0
            continue
        shared = mechanism.limbs[spring.limb].actuator
        for i, limb in enumerate(mechanism.limbs):
            if i != spring.limb and (spring.part != "drive" or limb.actuator != shared):
                continue
            values = limb.slots.values(mechanism.values)
            u = values.get("ratio", 1.0) * q[:, limb.actuator] + values.get("offset", 0.0)
            sides = []
            for sign in (1.0, -1.0):
                moved, v = u, dict(values)
                if spring.part == "drive":
                    moved = u + sign * h
                else:
                    v[spring.part] = v.get(spring.part, 0.0) + sign * h
                sides.append(machines.chain_lengths(limb.kind.name, v, limb.constants, moved,
                                                    pose)[0])
            b[where[i], k] = (sides[0] - sides[1]) / (2 * h)
    return a, b


def pushed(mechanism: Mechanism, a: Array, b: Array, wrench: Array) -> tuple[Array, Array]:
    """Leg forces that bear the wrench, carried to each spring: (spring's motion, pose change)."""
    legs = np.linalg.solve(a.T, wrench[list(mechanism.dof)])
    give = -(b.T @ legs) * np.array([s.compliance for s in springs_of(mechanism)])
    return give, np.linalg.solve(a, -b @ give)


@pytest.mark.slow
@pytest.mark.parametrize("kind", machines.KINDS)
def test_the_internal_loads_put_through_the_springs_move_the_tool_as_c_does(kind: str) -> None:
    mechanism = sprung(kind)
    q, pose = machines.spread(Model(mechanism), 2)
    found = compliance(mechanism, q, pose)
    rng = np.random.default_rng(3)
    for n in range(2):
        wrench = rng.normal(size=6)
        _, moved = pushed(mechanism, *numeric(mechanism, q[n:n + 1], pose[n:n + 1]), wrench)
        ours = found.deflection(wrench)[n, list(mechanism.dof)]
        np.testing.assert_allclose(ours, moved, rtol=2e-6, atol=1e-8 * np.abs(moved).max())
        np.testing.assert_allclose(found.matrix[n] @ wrench[list(mechanism.dof)], ours, rtol=1e-9)


@pytest.mark.slow_cases("(R)US")
@pytest.mark.parametrize("kind", machines.KINDS)
def test_springs_as_shifts_of_slots_move_the_nonlinear_machine_alike(kind: str) -> None:
    whole = sprung(kind)
    kept = tuple({p: v for p, v in own.items() if p != "bar" or kind in BARS}
                 for own in whole.stiffness)
    mechanism = replace(whole, stiffness=kept)
    q, pose = machines.spread(Model(mechanism), 1)
    a, b = numeric(mechanism, q, pose)
    wrench = np.array([1.0, -0.7, -1.3, 0.1, 0.07, -0.13])
    give, _ = pushed(mechanism, a, b, wrench)
    slots: dict[tuple[int, str], Array] = {}
    for spring, much in zip(springs_of(mechanism), give, strict=True):
        slot = {"drive": "offset", "bar": BARS.get(kind, "")}.get(spring.part, spring.part)
        # a longer bar lets its end go, which is what c = 1 takes back
        slots[spring.limb, slot] = np.array([-much if spring.part == "bar" else much])
    there = forward(Model(mechanism, shift=Shift(slots)), q, pose, q)
    assert there.converged.all()
    real = machines.difference(there.pose, pose)[0]
    linear = compliance(mechanism, q, pose).deflection(wrench)[0]
    np.testing.assert_allclose(real, linear, rtol=1e-4, atol=1e-5 * np.abs(linear).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6-UPS", "3-RPR", "3-RPS", "delta-rotary-6rods",
                                  "delta-linear"])
def test_drives_agree_with_the_effect_compliance(tmp_path: Path, name: str) -> None:
    """In equilibrium, to first order; also where two limbs hang on one drive."""
    k = 2e8 if name == "linapod" else 2e5
    soft = machine(tmp_path, name, effects=[
        {"kind": "compliance", "parameters": {"stiffness": k}}])
    still = machine(tmp_path, name, stiffness={"drive": k},
                    limbs=lambda i, limb: {n: v for n, v in limb.items() if n != "stiffness"})
    home = stiffness_at_home(still)
    q = inverse_table(Model(still), home.pose[None]).q
    wrench = np.array([3.0, -2.0, -5.0, 0.3, 0.2, -0.4])
    pushing = environment({n: np.array([v]) for n, v in zip(WRENCH, wrench, strict=True)},
                          soft.actuators, soft.gravity, q)
    pushed = reached_poses(Model(soft), q, pushing).pose
    real = machines.difference(pushed, pose_motor(home.pose[None]))[0]
    linear = home.compliance.deflection(wrench)[0]
    assert np.abs(linear).max() > 1e-9
    np.testing.assert_allclose(real, linear, rtol=2e-4, atol=2e-4 * np.abs(linear).max())


@pytest.mark.parametrize("name", ["6-UPS", "3-RPR", "linapod"])
def test_a_tool_point_is_a_machine_whose_platform_is_named_from_there(tmp_path: Path, name: str
                                                                      ) -> None:
    part = 1e-3 if name == "linapod" else 1.0
    tool = np.array([40.0, -70.0, 0.0 if name == "3-RPR" else -120.0]) * part
    stiff = {"bar": 5e4 / part, "drive": 1e5 / part}
    turned = {"rz": 12.0} if name == "3-RPR" else {"rx": 7.0, "ry": -4.0, "rz": 12.0}
    whole = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())
    pose = whole["home"]["pose"] | turned
    first = machine(tmp_path, name, stiffness=stiff, home={"pose": pose}, limits=None)
    turn = Rotation.from_rotvec([pose.get(c, 0.0) for c in ("rx", "ry", "rz")],
                                degrees=True).as_matrix()
    moved = dict(pose)
    for axis, step in zip("xyz", turn @ tool, strict=True):
        if axis in moved:
            moved[axis] = float(moved[axis] + step)
    size = 2 if name == "3-RPR" else 3

    def shifted(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        own = first.limbs[i].slots.values(first.values)
        spot = [float(own[f"platform.point.{c}"] / first.units.factor("length") - t)
                for c, t in zip("xyz"[:size], tool, strict=False)]
        return limb | {"platform": {**limb["platform"], "point": spot}}

    second = machine(tmp_path, name, stiffness=stiff, home={"pose": moved}, limits=None,
                     limbs=shifted)
    np.testing.assert_allclose(at_home(first, tool * first.units.factor("length")).matrix,
                               at_home(second).matrix, rtol=1e-7, atol=1e-16)
    assert not np.allclose(at_home(first).matrix, at_home(second).matrix, rtol=1e-2, atol=0.0)


def legs_of_table(pose: Array) -> tuple[Array, Array]:
    """Linapod in plain numbers: A (6, 6), and the rails' share n_z (6,), at (x, y, z)."""
    whole = yaml.safe_load((CONFIGS / "linapod.yaml").read_text())
    a, along = [], []
    for limb in whole["limbs"]:
        arm = np.array(limb["platform"]["point"])
        flat = pose[:2] + arm[:2] - np.array(limb["base"]["point"][:2])
        n = np.array([*flat, -math.sqrt(limb["length"]**2 - flat @ flat)]) / limb["length"]
        a.append([*n, *np.cross(arm, n)])
        along.append(n[2])
    return np.array(a), np.array(along)


def table_stiffness(pose: Array) -> Array:
    """K (6, 6) of [LIN] section 4.3, bars and drives in series along each leg's line."""
    a, along = legs_of_table(pose)
    each = 1.0 / np.repeat([8.8e7, 6.0e7], 3) + along**2 / 8.13e8
    return np.asarray(a.T @ np.diag(1.0 / each) @ a)


@pytest.mark.slow
def test_linapod_is_stiffest_at_home_and_softer_outward(tmp_path: Path) -> None:
    """[LIN] section 4.3 and Fig. 11; the figure from the table, by hand, in N/um."""
    run = ppmcal("stiffness", CONFIGS / "linapod.yaml", "--grid", "x=-0.3:0.3:13,y=-0.3:0.3:13",
                 cwd=tmp_path, expect=0)
    home = stiffness_json(tmp_path / "stiffness")["home"]
    by_hand = table_stiffness(np.zeros(3))
    np.testing.assert_allclose(home["stiffness"]["matrix"],
                               by_hand * np.repeat([1.0, np.pi / 180.0], 3), rtol=1e-9,
                               atol=1e-9 * by_hand.max())
    np.testing.assert_allclose(np.array(home["stiffness"]["matrix"])
                               @ np.array(home["compliance"]["matrix"]), np.eye(6), atol=1e-9)
    expected = 1.0 / np.linalg.eigvalsh(np.linalg.inv(by_hand)[:3, :3]).max()
    assert home["translational"]["values"][0] == pytest.approx(expected, rel=1e-10)
    assert f"({expected / 1e6:.4g} N/um)" in run.out and 40e6 < expected < 60e6
    table = rows(tmp_path / "stiffness" / "map.csv")
    good = [r for r in table if r["status"] == "ok"]
    assert len(table) == 169 and len(good) > 160
    best = max(good, key=lambda r: number(r, "stiffness_min"))
    assert abs(number(best, "x")) < 1e-12 and abs(number(best, "y")) < 1e-12
    assert number(best, "stiffness_min") == pytest.approx(expected, rel=1e-9)
    mechanism = read_mechanism(CONFIGS / "linapod.yaml")
    way, far = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False), np.linspace(0.0, 0.3, 7)
    poses = np.zeros((24, 7, 6))
    poses[..., 0], poses[..., 1] = np.outer(np.cos(way), far), np.outer(np.sin(way), far)
    soft = stiffness_table(mechanism, poses.reshape(-1, 6)).translational[:, 0].reshape(24, 7)
    assert np.all(np.diff(soft, axis=1) < 0.0)


def test_bars_and_drives_alone_are_springs_along_the_legs(tmp_path: Path) -> None:
    """K = sum over legs of (leg line)(leg line)^T/(1/bar + slope^2/drive), 6 struts."""
    mechanism = machine(tmp_path, "6-UPS", stiffness={"bar": 5e4, "drive": 2e5})
    found = at_home(mechanism)
    a, _ = numeric(mechanism, home_state(mechanism).q[None], mechanism.home[None])
    k = a.T @ a / (1.0 / 5e7 + 1.0 / 2e8)
    np.testing.assert_allclose(found.stiffness[0], k, rtol=1e-6, atol=1e-8 * k.max())
    np.testing.assert_allclose(found.stiffness[0] @ found.matrix[0], np.eye(6), atol=1e-10)


# --- rigid directions, shares -----------------------------------------------------------------

@pytest.mark.slow
def test_one_soft_bar_leaves_all_but_one_motion_rigid(tmp_path: Path) -> None:
    path = edited(tmp_path, "6-UPS", limbs=lambda i, limb: limb | (
        {"stiffness": {"bar": 5e4}} if i == 2 else {}))
    ppmcal("stiffness", path, "--grid", "x=900:1000:3", "--load", "fz=-1000", cwd=tmp_path,
           expect=0)
    found = at_home(read_mechanism(path))
    assert np.isinf(found.translational().values[0]).tolist() == [False, True, True]
    assert np.isinf(found.rotational().values[0]).tolist() == [False, True, True]
    assert np.isnan(found.stiffness).all()
    record = stiffness_json(tmp_path / "stiffness")
    assert record["home"]["translational"]["rigid"] == [False, True, True]
    assert record["home"]["translational"]["values"][1:] == [None, None]
    assert record["home"]["stiffness"]["matrix"] is None
    table = rows(tmp_path / "stiffness" / "map.csv")
    ok = [r for r in table if r["status"] == "ok"]
    assert ok and all(math.isinf(number(r, "stiffness_max")) for r in ok)
    assert all(math.isfinite(number(r, "stiffness_min")) for r in ok)
    # a force across the one motion that is left moves nothing, and the tool says so
    way = found.translational().directions[0, :, 0]
    turn = np.zeros(6)
    turn[:3] = np.cross(way, [0.3, 0.5, 0.7])
    direction = found.translational().directions[0, :, 1]
    assert np.abs(found.deflection(np.array([*direction, 0.0, 0.0, 0.0]))).max() < 1e-20
    assert np.isnan(found.shares(np.array([*direction, 0.0, 0.0, 0.0]))).all()


def test_a_stiff_part_beside_a_soft_one_is_not_yet_rigid(tmp_path: Path) -> None:
    mechanism = machine(tmp_path, "6-UPS", stiffness={"bar": 1e9}, limbs=lambda i, limb: limb | (
        {"stiffness": {"bar": 1e-3}} if i == 2 else {}))
    found = at_home(mechanism)
    a, _ = numeric(mechanism, home_state(mechanism).q[None], mechanism.home[None])
    move = np.linalg.inv(a)[:, 2]
    values = found.translational().values[0]
    assert values[0] == pytest.approx(1.0 / (move[:3] @ move[:3]), rel=1e-6)
    assert np.isfinite(values).all() and values[1] > 1e10
    assert np.isfinite(found.stiffness).all()


@pytest.mark.slow
def test_a_joint_that_the_pose_does_not_feel_is_no_spring(tmp_path: Path) -> None:
    """Out of the plane a planar limb gives way without moving the platform in it."""
    path = edited(tmp_path, "3-RPR", stiffness={"joint1": {"z": 10.0, "rx": 1.0}})
    run = ppmcal("stiffness", path, "--grid", "x=400:600:3,y=200:300:3", "--load", "fy=-10",
                 cwd=tmp_path, expect=0)
    assert "infinite: nothing gives way" in run.out and "nothing gives way there" in run.out
    assert stiffness_json(tmp_path / "stiffness")["home"]["translational"]["rigid"] == [True, True]
    ok = [r for r in rows(tmp_path / "stiffness" / "map.csv") if r["status"] == "ok"]
    assert all(math.isinf(number(r, "stiffness_min")) for r in ok)
    assert all(number(r, "deflection_position") < 1e-15 for r in ok)


@pytest.mark.slow
def test_shares_are_what_is_saved_by_making_a_part_rigid(tmp_path: Path) -> None:
    whole = {"bar": 5e4, "drive": 2e5, "joint2": {"x": 3e5, "y": 1e5, "z": 2e5, "rx": 20.0}}
    mechanism = machine(tmp_path, "6-UPS", stiffness=whole)
    wrench = np.array([100.0, 20.0, -500.0, 5.0, -3.0, 8.0])
    found = at_home(mechanism)
    share = found.shares(wrench)[0]
    work = wrench @ found.deflection(wrench)[0]
    for part in whole:
        less = at_home(machine(tmp_path, "6-UPS", stiffness=whole | {part: math.inf}))
        mine = sum(v for v, s in zip(share, found.springs, strict=True)
                   if s.part.partition(".")[0] == part)
        assert 1.0 - wrench @ less.deflection(wrench)[0] / work == pytest.approx(mine, abs=1e-12)
        assert mine > 0.0
    run = ppmcal("stiffness", edited(tmp_path, "6-UPS", stiffness=whole), "--payload", 50,
                 *listed(tmp_path, HEXAPOD), cwd=tmp_path, expect=0)
    table = stiffness_json(tmp_path / "stiffness")["tables"][0]
    assert table["columns"] == ["limb", "bar", "drive", "joint2", "all"]
    assert [r[0] for r in table["rows"]] == [f"leg{n}" for n in range(1, 7)] + ["all"]
    down = found.shares(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))[0]
    for row in table["rows"][:-1]:
        mine = {s.part.partition(".")[0]: 0.0 for s in found.springs}
        for value, s in zip(down, found.springs, strict=True):
            if s.owner == row[0]:
                mine[s.part.partition(".")[0]] += 100.0 * value
        for shown, part in zip(row[1:-1], ("bar", "drive", "joint2"), strict=True):
            assert float(shown) == pytest.approx(mine[part], abs=0.051)
    assert table["rows"][-1][-1] == "100.0" and "the weight of 50 kg" in run.out


def test_two_limbs_on_one_drive_share_its_spring(tmp_path: Path) -> None:
    path = edited(tmp_path, "delta-linear-6rods", stiffness=PLAIN)
    mechanism = read_mechanism(path)
    drives = [s for s in springs_of(mechanism) if s.part == "drive"]
    assert [s.owner for s in drives] == ["a", "b", "c"] and len(springs_of(mechanism)) == 9
    run = ppmcal("stiffness", path, *listed(tmp_path, {"x": 0, "y": 0, "z": 100}), cwd=tmp_path,
                 expect=0)
    assert "a1, a2 hang on one drive, a" in " ".join(run.out.split())


def test_effects_are_left_out_and_said(tmp_path: Path) -> None:
    effect = [{"kind": "compliance", "parameters": {"stiffness": 100.0}}]
    paths = []
    for name, effects in (("with", effect), ("without", None)):
        (tmp_path / name).mkdir()
        path = edited(tmp_path / name, "3-RPR", stiffness=PLAIN, effects=effects)
        paths.append(ppmcal("stiffness", path, *listed(tmp_path, PLANAR), "--load", "fy=-100",
                            cwd=tmp_path / name, expect=0))
    tables = [(tmp_path / n / "stiffness" / "map.csv").read_text() for n in ("with", "without")]
    assert tables[0] == tables[1]
    said = [" ".join(run.out.split()) for run in paths]
    assert "the file's effects (compliance)" in said[0] and "effects" not in said[1]


# --- the command ------------------------------------------------------------------------------

@pytest.mark.slow
@pytest.mark.parametrize("name", ["3-RPR", "3-RPS", "delta-linear", "6-UPS", "linapod",
                                  "mixed-planar"])
def test_every_shipped_machine(tmp_path: Path, name: str) -> None:
    path = CONFIGS / "linapod.yaml" if name == "linapod" else edited(
        tmp_path, name, stiffness={**PLAIN, "joint2": {"x": 3e5, "y": 2e5, "z": 1e5}})
    mechanism = read_mechanism(path)
    axes = slice_axes(mechanism)
    steps = [np.array([-0.04, 0.0, 0.04, 5.0]) * (mechanism.reach if c < 3 else 1.0) for c in axes]
    grid = Grid(axes, tuple(mechanism.home_pose[c] + s for c, s in zip(axes, steps, strict=True)))
    drawn = name in ("3-RPR", "3-RPS", "delta-linear")
    if drawn:
        units = [mechanism.units.factor("angle" if n[0] == "r" else "length") for n in grid.names]
        where = ("--grid", ",".join(f"{n}={v[0] / u}:{v[-1] / u}:{len(v)}" for n, v, u in zip(
            grid.names, grid.levels, units, strict=True)))
    else:
        wanted = pose_columns(mechanism, grid.poses(mechanism))
        (tmp_path / "p.csv").write_text(csv_text(list(wanted), list(wanted.values())))
        where = ("--poses", str(tmp_path / "p.csv"))
    run = ppmcal("stiffness", path, *where, "--load", "fx=10,fy=-50", cwd=tmp_path)
    assert run.code == int(not drawn)
    assert all(len(line) <= 80 for line in run.out.splitlines()) and not run.err
    out = tmp_path / "stiffness"
    names = ["stiffness_min", "stiffness_max", "rotational_min", "rotational_max",
             "deflection_position", "deflection_rotation"]
    if not mechanism.motion.turns:
        names = [n for n in names if "rotation" not in n]
    assert columns(out / "map.csv") == [*mechanism.coordinates, *names, "status", "reason"]
    record = stiffness_json(out)
    assert record["format"] == "ppmcal/stiffness/1" and record["name"] == mechanism.name
    assert record["findings"] == [] and len(record["said"]) >= 4
    assert record["units"]["stiffness_min"] == mechanism.units.name("N/length")
    assert set(record["pictures"]) == {p.name for p in out.glob("*.png")}
    assert len(record["pictures"]) == drawn * (len(names) - (mechanism.motion.planar))
    for picture in record["pictures"]:
        assert (out / picture).read_bytes().startswith(b"\x89PNG\r\n")
    table = rows(out / "map.csv")
    ok = [r for r in table if r["status"] == "ok"]
    assert ok and sum(record["status"].values()) == record["poses"] == len(table)
    for row in table:
        finite = [math.isfinite(number(row, n)) for n in names]
        assert all(finite) if row["status"] == "ok" else not any(finite)
        assert bool(row["reason"]) == (row["status"] != "ok")
    assert all(0.0 < number(r, "stiffness_min") <= number(r, "stiffness_max") for r in ok)
    share = [float(r[-1]) for r in record["tables"][0]["rows"]]
    assert share[-1] == 100.0 and sum(share[:-1]) == pytest.approx(100.0, abs=0.5)


def test_a_pose_of_the_map_is_the_pose_alone(tmp_path: Path) -> None:
    path = edited(tmp_path, "6-UPS", stiffness=PLAIN)
    mechanism = read_mechanism(path)
    where = listed(tmp_path, *({**HEXAPOD, "x": x, "rz": rz} for x in (-100, 0, 100)
                               for rz in (-5, 0, 5)))
    ppmcal("stiffness", path, *where, "--load", "fx=30,mz=4", "--tool", "10,-20,-100",
           cwd=tmp_path, expect=0)
    units = mechanism.units
    for row in rows(tmp_path / "stiffness" / "map.csv"):
        assert row["status"] == "ok"
        pose = np.array([[number(row, c) * units.factor("length" if i < 3 else "angle")
                          for i, c in enumerate(mechanism.coordinates)]])
        q = inverse_table(Model(mechanism), pose).q
        found = compliance(mechanism, q, pose_motor(pose), np.array([0.01, -0.02, -0.1]))
        c = found.matrix[0]
        for block, name, quantity in ((slice(0, 3), "stiffness", "N/length"),
                                      (slice(3, 6), "rotational", "N.m/angle")):
            soft = 1.0 / np.linalg.eigvalsh(c[block, block]) / units.factor(quantity)
            assert number(row, f"{name}_max") == pytest.approx(soft[0], rel=1e-8)
            assert number(row, f"{name}_min") == pytest.approx(soft[-1], rel=1e-10)
        moved = c @ np.array([30.0, 0.0, 0.0, 0.0, 0.0, 4.0])
        assert number(row, "deflection_position") == pytest.approx(
            np.linalg.norm(moved[:3]) / units.factor("length"), rel=1e-9)
        assert number(row, "deflection_rotation") == pytest.approx(
            np.linalg.norm(moved[3:]) / units.factor("angle"), rel=1e-9)


def test_the_units_of_the_file_do_not_matter(tmp_path: Path) -> None:
    """The same planar machine in mm and degrees, m and radians, inches."""
    found = []
    for length, angle in (("mm", "deg"), ("m", "rad"), ("in", "deg"), ("um", "rad")):
        si = {"mm": 1e-3, "m": 1.0, "in": 0.0254, "um": 1e-6}[length]
        turn = 1.0 if angle == "rad" else math.degrees(1.0)
        limbs = [{"name": f"leg{i + 1}", "kind": "R(P)R", "base": {"point": [a / si, b / si]},
                  "platform": {"point": [c / si, d / si]}}
                 for i, (a, b, c, d) in enumerate((
                     (0.0, 0.0, -0.12, -0.07), (1.0, 0.0, 0.12, -0.07), (0.5, 0.9, 0.0, 0.14)))]
        home = {"x": 0.5 / si, "y": 0.26 / si, "rz": 0.4 * turn}
        stiff = {"bar": 5e7 * si, "joint1": {"x": 1e8 * si, "ry": 5e4 / turn}}
        path = tmp_path / f"{length}.yaml"
        path.write_text(machines.mechanism_text(limbs, "planar", home,
                                                {"length": length, "angle": angle},
                                                stiffness=stiff))
        where = listed(tmp_path, *({**home, "x": x / si} for x in (0.4, 0.5, 0.6)))
        ppmcal("stiffness", path, "--out", length, *where, "--load", "fx=100,mz=-3", "--tool",
               f"{0.05 / si},{-0.02 / si}", cwd=tmp_path, expect=0)
        table = rows(tmp_path / length / "map.csv")
        assert {r["status"] for r in table} == {"ok"}
        scale = {"x": si, "y": si, "rz": 1 / turn, "stiffness_min": 1 / si, "stiffness_max": 1 / si,
                 "rotational_min": turn, "rotational_max": turn, "deflection_position": si,
                 "deflection_rotation": 1 / turn}
        found.append([[number(r, n) * f for n, f in scale.items()] for r in table])
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=1e-9)


def test_poses_from_a_table(tmp_path: Path) -> None:
    path = edited(tmp_path, "3-RPS", stiffness=PLAIN)
    write_csv(tmp_path / "p.csv", [{"z": z, "rx": rx, "ry": 0, "payload": 3}
                                   for z, rx in ((100, 0), (105, 5), (400, 0))])
    run = ppmcal("stiffness", path, "--poses", "p.csv", "--payload", 2, cwd=tmp_path, expect=1)
    assert "! row 3: limits" in run.out and "Columns payload of p.csv are not used" in run.out
    table = rows(tmp_path / "stiffness" / "map.csv")
    assert [r["status"] for r in table] == ["ok", "ok", "limits"]
    assert number(table[1], "rx") == pytest.approx(5.0) and math.isfinite(number(table[1], "x"))
    assert [p.name for p in (tmp_path / "stiffness").iterdir()
            if p.suffix == ".png"] == []
    assert str(tmp_path / "p.csv") in " ".join(
        str(tmp_path / k) for k in stiffness_json(tmp_path / "stiffness")["provenance"]["inputs"])
    home = at_home(read_mechanism(path))
    moved = home.deflection(np.array([0.0, 0.0, -2.0 * 9.80665, 0.0, 0.0, 0.0]))[0]
    assert number(table[0], "deflection_position") == pytest.approx(
        np.linalg.norm(moved[:3]) / 1e-3, rel=1e-9)


def test_weight_goes_along_the_files_gravity(tmp_path: Path) -> None:
    path = edited(tmp_path, "6-UPS", stiffness=PLAIN, gravity=[0, 1, 0])
    where = listed(tmp_path, HEXAPOD)
    ppmcal("stiffness", path, "--payload", 10, *where, cwd=tmp_path, expect=0)
    first = stiffness_json(tmp_path / "stiffness")["home"]
    ppmcal("stiffness", path, "--load", "fy=98.0665", *where, cwd=tmp_path, expect=0)
    second = stiffness_json(tmp_path / "stiffness")["home"]
    assert first["deflection"] == pytest.approx(second["deflection"], rel=1e-12)
    assert first["deflection"]["y"] > 0.0


def test_json_is_one_object_and_quiet_is_quiet(tmp_path: Path) -> None:
    path = edited(tmp_path, "3-RPR", stiffness=PLAIN)
    where = listed(tmp_path, PLANAR)
    found = ppmcal("stiffness", path, *where, "--json", cwd=tmp_path, expect=0).json
    assert found["format"] == "ppmcal/stiffness/1" and found["said"]
    assert found["home"]["translational"]["unit"] == "N/mm"
    assert ppmcal("stiffness", path, *where, "--quiet", cwd=tmp_path, expect=0).out == ""


@pytest.mark.slow
def test_the_default_map_has_41_by_41_poses_about_home(tmp_path: Path) -> None:
    path = edited(tmp_path, "delta-linear", stiffness=PLAIN)
    ppmcal("stiffness", path, cwd=tmp_path, expect=0)
    with (tmp_path / "stiffness" / "map.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 41 * 41 and {r["z"] for r in table} == {table[0]["z"]}
    assert {r["status"] for r in table} > {"ok"}


@pytest.mark.parametrize(("arguments", "says"), [
    (("--load", "fz=-100"), "fz cannot be answered: in planar motion"),
    (("--load", "fx"), "'fx' is not a component with a value"),
    (("--load", "fx=ten"), "'ten' is not a number"),
    (("--load", "f=10"), "Allowed: fx, fy, mz"),
    (("--load", "fx=1,fx=2"), "names fx twice"),
    (("--load", "fx=nan"), "nan is out of range"),
    (("--load", "fx=1e300"), "out of range"),
    (("--load", ""), "the load is zero"),
    (("--load", "fx=0,fz=0"), "the load is zero"),
    (("--payload", "0"), "0 is not a mass"),
    (("--payload", "-3"), "-3 is not a mass"),
    (("--payload", "nan"), "nan is not a mass"),
    (("--payload", "1", "--load", "fx=1"), "not both"),
    (("--grid", "x", "--poses", "m.yaml"), "not both"),
    (("--tool", "1,2,3,4"), "is not a point"),
    (("--tool", "1,b"), "is not a point"),
    (("--tool", ""), "is not a point"),
    (("--grid", "z"), "Allowed: x, y, rz"),
    (("--poses", "none.csv"), "none.csv"),
])
def test_wrong_options(tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    edited(tmp_path, "3-RPR", stiffness=PLAIN)
    run = ppmcal("stiffness", "m.yaml", *arguments, cwd=tmp_path, expect=2)
    assert says in run.err and "Traceback" not in run.err
    assert [p.name for p in tmp_path.iterdir()] == ["m.yaml"]


def test_a_weight_across_the_plane_is_refused(tmp_path: Path) -> None:
    edited(tmp_path, "3-RPR", stiffness=PLAIN, gravity=[0, 0, -1])
    run = ppmcal("stiffness", "m.yaml", "--payload", 5, cwd=tmp_path, expect=2)
    assert "the weight acts along z, across the plane" in run.err


def test_a_moment_on_a_delta_is_refused(tmp_path: Path) -> None:
    edited(tmp_path, "delta-rotary", stiffness=PLAIN)
    run = ppmcal("stiffness", "m.yaml", "--load", "mx=1", cwd=tmp_path, expect=2)
    assert "mx cannot be answered: in translational motion" in run.err


@pytest.mark.slow
def test_a_map_that_nothing_reaches_is_a_finding(tmp_path: Path) -> None:
    edited(tmp_path, "3-RPR", stiffness=PLAIN)
    run = ppmcal("stiffness", "m.yaml", "--grid", "x=90000:91000:3,y", cwd=tmp_path, expect=1)
    assert "! no pose has a stiffness" in run.out
    assert "nan" in (tmp_path / "stiffness" / "map.csv").read_text()


def test_home_outside_its_limits_is_a_finding(tmp_path: Path) -> None:
    names = [limb["name"] for limb in yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text())["limbs"]]
    edited(tmp_path, "3-RPR", stiffness=PLAIN, limits={n: [10.0, 20.0] for n in names})
    run = ppmcal("stiffness", "m.yaml", *listed(tmp_path, PLANAR), cwd=tmp_path, expect=1)
    assert "! home is not a pose to work at: limits" in run.out
    assert stiffness_json(tmp_path / "stiffness")["home"]["translational"]["values"][0] > 0.0


def test_a_singular_home_has_no_stiffness(tmp_path: Path) -> None:
    """Legs at their own angles from one centre: nothing holds rz."""
    limbs = [{"name": f"leg{i + 1}", "kind": "R(P)R",
              "base": {"point": [300 * math.cos(t), 300 * math.sin(t)]},
              "platform": {"point": [100 * math.cos(t), 100 * math.sin(t)]}}
             for i, t in enumerate((0.0, 2.1, 4.2))]
    (tmp_path / "m.yaml").write_text(machines.mechanism_text(
        limbs, "planar", {"x": 0.0, "y": 0.0, "rz": 0.0}, stiffness=PLAIN))
    run = ppmcal("stiffness", "m.yaml", cwd=tmp_path, expect=3)
    assert "singular at home" in run.err and not (tmp_path / "stiffness").exists()
    with pytest.raises(NoResult):
        stiffness_at_home(read_mechanism(tmp_path / "m.yaml"))


def test_a_load_too_large_for_a_linear_model_is_a_finding(tmp_path: Path) -> None:
    edited(tmp_path, "3-RPR", stiffness={"bar": 10.0})
    run = ppmcal("stiffness", "m.yaml", *listed(tmp_path, PLANAR), "--load", "fx=500",
                 cwd=tmp_path, expect=1)
    assert "too far for a linear model" in " ".join(run.out.split())


def test_the_library_refuses_what_has_no_spring() -> None:
    with pytest.raises(BadInput, match="everything is rigid"):
        springs_of(machines.plain("R(P)R"))


def test_every_kind_has_the_joints_that_its_section_may_name() -> None:
    for kind in machines.KINDS:
        assert joint_names(machines.plain(kind).limbs[0].kind) == ("joint1", "joint2", "joint3")


def test_a_singular_pose_gives_nan_and_spares_the_others(tmp_path: Path) -> None:
    mechanism = machine(tmp_path, "3-RPR", stiffness=PLAIN, limits=None)
    pose = np.tile(mechanism.home_pose, (3, 1))
    q = np.tile(home_state(mechanism).q, (3, 1))
    motor = pose_motor(pose)
    motor[1] = np.nan
    with np.errstate(invalid="ignore"):
        found = compliance(mechanism, q, motor)
    assert np.isnan(found.translational().values[1]).all()
    assert np.isnan(found.stiffness[1]).all() and np.isfinite(found.stiffness[[0, 2]]).all()
    np.testing.assert_allclose(found.stiffness[0], at_home(mechanism).stiffness[0], rtol=1e-12)
    assert compliance(mechanism, q[:0], motor[:0]).translational().values.shape == (0, 2)
    assert pose_vector(motor).shape == (3, 6)
