"""Inverse and forward kinematics of every kind: there and back, branches, and what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import machines
from helpers.machines import KINDS, PLANAR, Array

from ppmcal import algebra as cga
from ppmcal.design.intersection import intersection_pose, limb_ends
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.kinematics.tables import (
    forward_table,
    inverse_table,
    pose_motor,
    pose_vector,
    velocity_table,
)
from ppmcal.model.limbs import kinds
from ppmcal.model.mechanism import Mechanism

ANY_POSE = ("R(P)R", "(R)PR", "(P)PR", "P(P)R", "(P)RP", "R(P)P", "U(P)S", "R(P)S")
SHORT_REACH = tuple(k for k in KINDS if k not in ANY_POSE)
TWO_ROOTS = tuple(k for k in KINDS if kinds()[k].branch is not None and not kinds()[k].strut)
MACHINES = {
    **{f"{kind} plain": lambda kind=kind: machines.plain(kind) for kind in KINDS},
    **{f"{kind} full": lambda kind=kind: machines.full(kind) for kind in KINDS},
    "mixed planar": lambda: machines.mixed("planar"),
    "mixed spatial": lambda: machines.mixed("spatial"),
    "rods and a tripod leg": lambda: rods_and_a_tripod_leg(),
    "delta, linear": lambda: machines.delta("(P)US", 3),
    "delta, rotary": lambda: machines.delta("(R)US", 3),
    "delta, linear, six rods": lambda: machines.delta("(P)US", 6),
    "delta, rotary, six rods": lambda: machines.delta("(R)US", 6),
}
every_machine = pytest.mark.parametrize("name", MACHINES)
most_machines = pytest.mark.parametrize("name", [n for n in MACHINES if "plain" not in n])
"""A full machine has all that a plain one has, none of it at its nominal."""
each_without_ratio = pytest.mark.parametrize("name", [n for n in MACHINES if "full" not in n])


@cache
def machine(name: str) -> Mechanism:
    return MACHINES[name]()


def rods_and_a_tripod_leg() -> Mechanism:
    """A leg with two conditions and one drive beside four struts: five drives, six coordinates."""
    case = machines.CASES["U(P)S"]
    foot = {"name": "leg1", "kind": "R(P)S",
            "base": {"point": [400.0, -50.0, 0.0], "axis": [0.1, 1.0, 0.0]},
            "platform": {"point": [150.0, 20.0, 0.0]}}
    return machines.read_text(machines.mechanism_text(
        [foot, *case.limbs[1:5]], "spatial", case.home))


@cache
def either(kind: str, branch: int | None) -> Mechanism:
    return pair_of(kind, branch)


def pair_of(kind: str, branch: int | None, **more: Any) -> Mechanism:
    """Return the plain machine of a kind with all limbs on one branch, or left to the default."""
    setting = kinds()[kind].branch
    assert setting is not None

    def change(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        limb.pop("branch", None)
        limb.pop("elbow", None)
        return limb if branch is None else {**limb, setting: branch}

    return machines.read_text(machines.plain_text(kind, change, **more))


def poses_about_home(mechanism: Mechanism, count: int = 12, size: float = 1.0) -> Array:
    """Return full pose vectors (count, 6): 3 % of the reach and 0.06 rad to either side."""
    rng = np.random.default_rng(5)
    out = np.tile(mechanism.home_pose, (count, 1))
    for c in mechanism.dof:
        out[:, c] += size * rng.uniform(-1, 1, count) * (0.03 * mechanism.reach if c < 3 else 0.06)
    return out


def closes(model: Model, q: Array, pose: Array) -> None:
    gap = machines.limb_lengths(model, q, pose, machines.contract_lengths)
    assert np.abs(gap).max() < 1e-13 * max(model.mechanism.reach, 1.0)


# --- there and back -----------------------------------------------------------------------------

@pytest.mark.slow
@most_machines
def test_forward_of_inverse_is_the_pose(name: str) -> None:
    """Machines with fewer drives than coordinates are asked for as many as they have drives."""
    mechanism = machine(name)
    model = Model(mechanism)
    wanted = poses_about_home(mechanism)
    drives = len(mechanism.actuators)
    if drives < len(mechanism.dof):
        # deltas are asked for x, y, z; tripods for z, rx, ry
        left = {"rods and a tripod leg": [5], "R(P)S full": [0, 1, 5]}
        wanted[:, left.get(name, [3, 4, 5])] = np.nan
    found = inverse_partial(model, wanted)
    assert found.reached.all(), found.reason
    assert found.q.shape == (len(wanted), drives)
    closes(model, found.q, found.pose)
    named = np.isfinite(wanted)
    np.testing.assert_allclose(pose_vector(found.pose)[named], wanted[named], rtol=0, atol=1e-12)
    back = forward(model, found.q)
    assert back.converged.all()
    away = machines.difference(back.pose, found.pose)
    assert np.abs(away).max() < 2e-12 * max(mechanism.reach, 1.0)


@each_without_ratio
def test_inverse_of_forward_are_the_joints(name: str) -> None:
    model = Model(machine(name))
    q, pose = machines.spread(model, 8, size=0.7)
    closes(model, q, pose)
    found = inverse(model, pose)
    assert found.reached.all(), found.reason
    np.testing.assert_allclose(found.q, q, rtol=1e-11, atol=1e-11)


def test_a_translational_delta_keeps_its_orientation() -> None:
    for actuated in ("(P)US", "(R)US"):
        mechanism = machines.delta(actuated, 3)
        assert mechanism.coordinates == ("x", "y", "z")
        _, pose = machines.spread(Model(mechanism))
        rotation, origin = machines.matrices(pose)
        np.testing.assert_allclose(rotation, np.tile(np.eye(3), (5, 1, 1)), rtol=0, atol=1e-15)
        assert np.ptp(origin, axis=0).min() > 1e-3


@pytest.mark.parametrize("actuated", ["(P)US", "(R)US"])
def test_six_equal_rods_in_pairs_are_the_ideal_delta(actuated: str) -> None:
    """Parallelograms that are parallel keep the platform level: both models agree."""
    ideal, rods = (Model(machines.delta(actuated, n)) for n in (3, 6))
    assert rods.mechanism.actuators == ideal.mechanism.actuators == ("a", "b", "c")
    q, pose = machines.spread(ideal)
    found = forward(rods, q)
    assert found.converged.all()
    assert np.abs(machines.difference(found.pose, pose)).max() < 1e-12
    wanted = pose_vector(pose)
    wanted[:, 3:] = np.nan
    np.testing.assert_allclose(inverse_partial(rods, wanted).q, q, rtol=0, atol=1e-12)


def test_a_tripod_takes_any_three_coordinates() -> None:
    model = Model(machines.plain("R(P)S"))
    _, pose = machines.spread(model)
    vector = pose_vector(pose)
    for left in ([0, 1, 5], [3, 4, 5], [0, 4, 5]):
        wanted = vector.copy()
        wanted[:, left] = np.nan
        found = inverse_partial(model, wanted)
        # x, y, z decide rx and ry only up to second order at home: two solutions, both close
        assert found.reached.any(), found.reason
        closes(model, found.q[found.reached], found.pose[found.reached])
        keep = np.isfinite(wanted) & found.reached[:, None]
        np.testing.assert_allclose(pose_vector(found.pose[found.reached])[keep[found.reached]],
                                   vector[keep], rtol=0, atol=1e-12)


def test_a_wrong_number_of_open_coordinates_is_refused_by_row() -> None:
    model = Model(machines.plain("R(P)S"))
    wanted = np.tile(model.mechanism.home_pose, (3, 1))
    wanted[0, [0, 1]] = np.nan
    wanted[1, [0, 1, 5]] = np.nan
    found = inverse_partial(model, wanted)
    assert found.reached.tolist() == [False, True, True]
    assert "2 coordinates are empty" in found.reason[0]
    assert np.isnan(found.q[0]).all()


# --- branches -----------------------------------------------------------------------------------

@pytest.mark.parametrize("kind", TWO_ROOTS)
def test_the_two_branch_settings_are_the_two_roots(kind: str) -> None:
    q, setting = {}, kinds()[kind].branch
    for branch in (1, -1):
        mechanism = either(kind, branch)
        model = Model(mechanism)
        q[branch] = home_state(mechanism).q
        closes(model, q[branch][None], mechanism.home[None])
        wanted = pose_motor(poses_about_home(mechanism, size=0.5))
        if kind == "R(P)S":
            wanted = machines.spread(model)[1]
        found = inverse(model, wanted)
        assert found.reached.all(), found.reason
        closes(model, found.q, wanted)
    assert np.abs(q[1] - q[-1]).min() > 1e-3
    if setting == "branch":
        assert (q[1] > q[-1]).all()


def test_a_strut_has_no_other_branch() -> None:
    """Its joint value is a distance: the other root closes the square, and is no length."""
    with pytest.raises(BadInput, match=r"limbs.leg1.branch: .* and never negative"):
        either("U(P)S", -1)
    plain = either("U(P)S", None)
    assert (home_state(plain).q > 0.0).all()
    np.testing.assert_array_equal(home_state(either("U(P)S", 1)).q, home_state(plain).q)
    other = replace(plain, home_q=-home_state(plain).q)
    np.testing.assert_array_equal(home_state(other).q, home_state(plain).q)


@pytest.mark.parametrize("kind", ["(R)RR", "R(R)R"])
def test_elbow_is_the_sign_of_the_turn_from_proximal_to_distal(kind: str) -> None:
    for elbow in (1, -1):
        mechanism = either(kind, elbow)
        wanted = pose_motor(poses_about_home(mechanism))
        q = inverse(Model(mechanism), wanted).q
        if kind == "R(R)R":
            assert (elbow * np.sin(q) > 0.0).all()
            continue
        rotation, origin = machines.matrices(wanted)
        for i, limb in enumerate(mechanism.limbs):
            v = limb.slots.values(mechanism.values)
            b = origin[:, :2] + (rotation[:, :2, :2] @ [v["platform.point.x"],
                                                         v["platform.point.y"]])
            first = np.stack([np.cos(q[:, i]), np.sin(q[:, i])], axis=1)
            second = b - [v["base.point.x"], v["base.point.y"]] - v["proximal"] * first
            turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
            assert (elbow * turn > 0.0).all()


@pytest.mark.parametrize("kind", TWO_ROOTS)
def test_home_q_selects_the_branch_and_without_it_it_is_plus(kind: str) -> None:
    up, down = home_state(either(kind, 1)).q, home_state(either(kind, -1)).q
    np.testing.assert_array_equal(home_state(either(kind, None)).q, up)
    factor = 1e3 if kinds()[kind].actuator == "length" else 180.0 / np.pi
    for q, other in ((up, down), (down, up)):
        near = q + 0.02 * (other - q)
        given = pair_of(kind, None, q={f"leg{i + 1}": float(v * factor)
                                       for i, v in enumerate(near)})
        found = inverse(Model(given), given.home[None])
        np.testing.assert_allclose(found.q[0], q, rtol=1e-12, atol=1e-13)


def test_a_negative_ratio_does_not_turn_the_branch_around() -> None:
    """`branch` speaks of u; steps counted down from an endstop have u falling with q."""
    def change(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        return {**limb, "branch": 1, "ratio": -0.0125, "offset": 900.0}

    plus = machines.read_text(machines.plain_text("(P)RR", lambda i, limb: limb | {"branch": 1}))
    steps = machines.read_text(machines.plain_text("(P)RR", change))
    u = 1e3 * home_state(plus).q
    np.testing.assert_allclose(-0.0125 * home_state(steps).q + 900.0, u, rtol=1e-12)


# --- what is refused ----------------------------------------------------------------------------

@pytest.mark.parametrize("kind", SHORT_REACH)
def test_unreachable_poses_give_a_reason_and_no_number(kind: str) -> None:
    mechanism = machines.plain(kind)
    wanted = np.tile(mechanism.home_pose, (4, 1))
    far = 10.0 * mechanism.reach
    wanted[1, :2] += far
    wanted[3, :2] -= far
    found = inverse_partial(Model(mechanism), wanted)
    assert found.reached.tolist() == [True, False, True, False]
    assert np.isnan(found.q[[1, 3]]).all()
    assert np.isfinite(found.q[[0, 2]]).all()
    assert re.search(r"limb 'leg\d' cannot reach: misses by [\d.e+]+ mm", found.reason[1])
    table = inverse_table(Model(mechanism), wanted)
    assert table.status == ("ok", "unreachable", "ok", "unreachable")
    assert table.reason[1] == found.reason[1]


@pytest.mark.parametrize("kind", ["(R)RR", "R(R)R", "(P)RR", "P(R)R", "(R)RP", "R(R)P", "(P)US",
                                  "(R)US"])
def test_the_missing_length_is_how_far_the_limb_ends_short(kind: str) -> None:
    """A limb ends that much short at the joint value that brings it nearest."""
    mechanism = machines.plain(kind)
    wanted = mechanism.home_pose[None].copy()
    wanted[0, :2] += 2.0 * mechanism.reach * np.array([-0.6, -0.8])
    found = inverse_partial(Model(mechanism), wanted)
    said = re.search(r"limb 'leg(\d)' cannot reach: misses by ([\d.e+]+) mm", found.reason[0])
    assert said, found.reason
    limb = mechanism.limbs[int(said[1]) - 1]
    u = np.linspace(-8.0, 8.0, 80001) if limb.kind.actuator == "length" else np.linspace(
        -np.pi, np.pi, 80001)
    shortest = np.abs(machines.contract_lengths(
        kind, limb.slots.values(mechanism.values), limb.constants, u,
        np.broadcast_to(pose_motor(wanted), (u.size, 8)))).min()
    assert float(said[2]) == pytest.approx(1e3 * shortest, rel=2e-3)


def test_the_full_poses_of_a_tripod_are_refused_beyond_a_millionth_of_its_reach() -> None:
    model = Model(machines.plain("R(P)S"))
    _, pose = machines.spread(model, 4)
    reach = model.mechanism.reach
    for miss, reached in ((0.5e-6, True), (2e-6, False)):
        # each foot's plane is left by what the platform is pushed along y: 1, 1/2 and 1/2 of it
        off = machines.displaced(pose, np.array([0.0, miss * reach, 0.0, 0.0, 0.0, 0.0]))
        found = inverse(model, off)
        assert found.reached.tolist() == [reached] * 4
        assert np.isfinite(found.q).all() == reached
        assert np.isnan(found.q).any() != reached
        if not reached:
            said = re.search(r"off the machine's surface by ([\d.e-]+) mm", found.reason[0])
            assert said
            assert float(said[1]) == pytest.approx(2e-3 * reach, rel=1e-2)
    mixed = pose_vector(np.concatenate([pose[:1], machines.displaced(
        pose[1:2], np.array([0.0, 1e-3, 0.0, 0.0, 0.0, 0.0])), pose[2:3]]))
    table = inverse_table(model, mixed)
    assert table.status == ("ok", "unreachable", "ok")


def test_the_full_poses_of_a_delta_with_paired_rods_are_refused_off_its_surface() -> None:
    model = Model(machines.delta("(P)US", 6))
    _, pose = machines.spread(model, 2)
    off = machines.displaced(pose, np.array([0.0, 0.0, 0.0, 0.01, 0.0, 0.0]))
    found = inverse(model, np.concatenate([pose, off]))
    assert found.reached.tolist() == [True, True, False, False]
    assert np.isnan(found.q[2:]).all()


@pytest.mark.slow
@each_without_ratio
def test_forward_is_never_silently_wrong(name: str) -> None:
    """Wild joint values: each row is closed, or nan and named; none disturbs another."""
    mechanism = machine(name)
    model = Model(mechanism)
    home = home_state(mechanism).q
    q = home * np.random.default_rng(2).uniform(0.6, 1.5, (4, home.size))
    q[0], q[1, 0] = home, np.nan
    table = forward_table(model, q)
    there = np.array([status != "not converged" for status in table.status])
    assert there[0]
    assert not there[1]
    np.testing.assert_array_equal(np.isfinite(table.pose).all(axis=1), there)
    np.testing.assert_array_equal(np.isnan(table.pose).all(axis=1), ~there)
    closes(model, q[there], pose_motor(table.pose[there]))
    assert [not reason for reason in table.reason] == [s == "ok" for s in table.status]
    assert table.reason[1] == "joint values missing"
    assert np.isnan(forward(model, q[:2]).pose).all(axis=1).tolist() == [False, True]


def test_a_pose_that_does_not_exist_is_reported_by_row() -> None:
    model = Model(machines.plain("R(P)R"))
    home = home_state(model.mechanism).q
    table = forward_table(model, np.stack([home, [0.05, 0.05, 0.05], home + 0.01]))
    assert table.status == ("ok", "not converged", "ok")
    assert "the way from home ends at" in table.reason[1]
    assert np.isnan(table.pose[1]).all()
    assert np.isfinite(table.pose[[0, 2]]).all()


# --- assembly modes and singularities -------------------------------------------------------------

@pytest.mark.parametrize("kind", KINDS)
def test_the_assembly_mode_is_homes_far_away_and_back(kind: str) -> None:
    """Hand over hand along a line, out and back, ends where the first look from home did."""
    mechanism = machines.plain(kind)
    model = Model(mechanism)
    home = home_state(mechanism).q
    out, direct = machines.spread(model, 3, seed=4, size=2.0)
    pose = np.broadcast_to(mechanism.home, (3, 8))
    at = np.broadcast_to(home, out.shape)
    for part in [*np.linspace(0.0, 1.0, 6)[1:], *np.linspace(1.0, 0.0, 6)[1:]]:
        goal = home + part * (out - home)
        found = forward(model, goal, start=pose, start_q=at)
        assert found.converged.all()
        if part == 1.0:
            assert np.abs(machines.difference(found.pose, direct)).max() < 1e-11
        pose, at = found.pose, goal
    back = machines.difference(pose, np.broadcast_to(mechanism.home, (3, 8)))
    assert np.abs(back).max() < 1e-11


def test_crossing_a_singularity_is_marked() -> None:
    """3-R(P)R, similar triangles: at rz = 0 in the middle all struts meet in one point."""
    def change(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        turn = np.exp(1j * np.radians(210.0 + 120.0 * i))
        return {**limb, "base": {"point": [float(577.35 * turn.real), float(577.35 * turn.imag)]},
                "platform": {"point": [float(250.0 * turn.real), float(250.0 * turn.imag)]}}

    case = machines.CASES["R(P)R"]
    mechanism = machines.read_text(machines.mechanism_text(
        [change(i, limb) for i, limb in enumerate(case.limbs)], "planar",
        {"x": 0.0, "y": 0.0, "rz": 30.0}))
    model = Model(mechanism)
    path = np.tile(mechanism.home_pose, (7, 1))
    path[:, 5] = np.radians([30.0, 20.0, 10.0, 0.0, -10.0, -20.0, -30.0])
    table = inverse_table(model, path)
    assert table.status == ("ok", "ok", "ok", "singular", "crossed", "crossed", "crossed")
    assert table.singular_value[3] < 1e-9
    assert all(table.reason[3:])
    # rz and -rz have the same struts: forward must come back to home's side
    back = forward_table(model, table.q)
    keep = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(back.pose[keep, 5], np.abs(path[keep, 5]), rtol=0, atol=1e-9)
    assert back.status[3] in ("singular", "not converged")
    assert [back.status[n] for n in (0, 1, 2, 6)] == ["ok"] * 4


def led(base: Array, platform: Array, pose: Array, start: Array, end: Array, steps: int = 600
        ) -> tuple[Array, float]:
    """Lead three struts (R(P)R, no lateral) in small steps: plain Newton on x, y, rz.

    Returns:
        the pose (3,) at the end and the smallest |det A| on the way, times the sign at start.
    """
    def solve(q: Array, pose: Array) -> tuple[Array, float]:
        for _ in range(30):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            arm = platform @ np.array([[c, s], [-s, c]])
            strut = pose[:2] + arm - base
            length = np.hypot(*strut.T)
            e = strut / length[:, None]
            matrix = np.column_stack([e, arm[:, 0] * e[:, 1] - arm[:, 1] * e[:, 0]])
            step = -np.linalg.solve(matrix, length - q)
            pose = pose + step
            if np.abs(step).max() < 1e-13:
                break
        return pose, float(np.linalg.det(matrix))

    pose, det = solve(start, pose)
    side, least = np.sign(det), abs(det)
    for part in np.linspace(0.0, 1.0, steps + 1)[1:]:
        pose, det = solve(start + part * (end - start), pose)
        least = min(least, det * side)
    return pose, float(least)


@pytest.mark.slow
def test_a_jump_of_the_assembly_mode_is_marked() -> None:
    """A 3-R(P)R with cusps changes its assembly mode without meeting a singularity.

    The geometry is the one that Innocenti and Parenti-Castelli found this with. From home both
    joint values are reached on regular ways; the way from one to the other is regular, too,
    and ends in another pose than the one that home's way ends in.
    """
    base = np.array([[0.0, 0.0], [1.591, 0.0], [0.0, 1.0]])
    platform = np.array([[0.0, 0.0], [1.704, 0.0],
                         [2.084 * np.cos(0.882603), 2.084 * np.sin(0.882603)]])
    limbs = [{"name": f"leg{i + 1}", "kind": "R(P)R", "base": {"point": base[i].tolist()},
              "platform": {"point": platform[i].tolist()}} for i in range(3)]
    mechanism = machines.read_text(machines.mechanism_text(
        limbs, "planar", {"x": 0.097, "y": -0.045, "rz": -132.0},
        units={"length": "m", "angle": "deg"}))
    model = Model(mechanism)
    first, second = np.array([0.769, 3.015, 2.637]), np.array([0.582, 2.649, 2.462])
    home = mechanism.home_pose[[0, 1, 5]]
    home_q = home_state(mechanism).q
    at_first, clear = led(base, platform, home, home_q, first)
    assert clear > 1e-3
    at_second, clear = led(base, platform, home, home_q, second)
    assert clear > 1e-3
    onward, clear = led(base, platform, at_first, first, second)
    assert clear > 1e-3
    assert np.abs(onward - at_second).max() > 0.1

    table = forward_table(model, np.stack([home_q, first, second, home_q]))
    assert table.status[:3] == ("ok", "ok", "jump")
    assert "another assembly mode" in table.reason[2]
    for found, expected in zip(table.pose[1:3, [0, 1, 5]], (at_first, at_second), strict=True):
        away = found - expected
        away[2] = np.angle(np.exp(1j * away[2]))
        assert np.abs(away).max() < 1e-10
    alone = forward_table(model, second[None])
    assert alone.status == ("ok",)


# --- rates --------------------------------------------------------------------------------------

@pytest.mark.slow
@most_machines
def test_rates_are_differentiated_inverse_kinematics(name: str) -> None:
    mechanism = machine(name)
    model = Model(mechanism)
    q, pose = machines.spread(model, 6)
    rng = np.random.default_rng(8)
    if len(mechanism.actuators) < len(mechanism.dof):
        # a motion on the machine's surface: from the joints, by differences
        turn = rng.uniform(-1, 1, q.shape) * machines.joint_steps(model)
        h = 1e-4
        after, before = (forward(model, q + s * turn, start=pose, start_q=q).pose
                         for s in (h, -h))
        twist = machines.difference(after, before) / (2.0 * h)
        expected, tolerance = turn, 1e-8
    else:
        twist = np.zeros((6, 6))
        twist[:, mechanism.dof] = rng.uniform(-1, 1, (6, len(mechanism.dof)))
        h = 1e-5
        after, before = (inverse(model, machines.displaced(pose, s * twist)).q for s in (h, -h))
        expected, tolerance = (after - before) / (2.0 * h), 1e-7
    table = velocity_table(model, pose_vector(pose), twist)
    assert table.status == ("ok",) * 6
    scale = np.abs(expected).max(axis=0)
    assert (np.abs(table.rate - expected) / scale).max() < tolerance


def test_rates_of_a_tripod_from_as_many_velocities_as_it_has_drives() -> None:
    model = Model(machines.plain("R(P)S"))
    q, pose = machines.spread(model, 6)
    turn = np.random.default_rng(8).uniform(-1, 1, q.shape) * machines.joint_steps(model)
    after, before = (forward(model, q + s * turn, start=pose, start_q=q).pose
                     for s in (1e-4, -1e-4))
    twist = machines.difference(after, before) / 2e-4
    twist[:, [0, 1, 5]] = np.nan
    table = velocity_table(model, pose_vector(pose), twist)
    np.testing.assert_allclose(table.rate, turn, rtol=0, atol=1e-10)
    twist[0, 3] = np.nan
    table = velocity_table(model, pose_vector(pose), twist)
    assert table.status[0] == "refused"
    assert np.isnan(table.rate[0]).all()
    np.testing.assert_allclose(table.rate[1:], turn[1:], rtol=0, atol=1e-10)


# --- two ways to the platform ---------------------------------------------------------------------

@pytest.mark.parametrize("kind", [*PLANAR, "U(P)S", "R(P)S"])
def test_the_intersection_of_the_limbs_bodies_is_newtons_pose(kind: str) -> None:
    """[PPM] eq. 16-27 from the closed limbs, against Newton on the stacked closure (m, rad)."""
    for mechanism in (machines.plain(kind), machines.full(kind)):
        model = Model(mechanism)
        q, pose = machines.spread(model, 8)
        ends, local = limb_ends(model.closure(q), pose)
        three = [0, 2, 4] if kind == "U(P)S" else [0, 1, 2]
        found = intersection_pose(ends[:, three], local[:, three])
        assert np.abs(machines.difference(found, pose)).max() < 1e-12
        # where the platform carries the joint, its end is where the platform has it
        if machines.CHAINS[kind][0] != "slot":
            rotation, origin = machines.matrices(pose)
            for i, limb in enumerate(mechanism.limbs):
                v = limb.slots.values(mechanism.values)
                b = np.array([v.get(f"platform.point.{k}", 0.0) for k in "xyz"])
                np.testing.assert_allclose(ends[:, i], origin + rotation @ b, rtol=0, atol=1e-12)
                np.testing.assert_allclose(local[:, i], np.tile(b, (8, 1)), rtol=0, atol=1e-12)


# --- whole turns --------------------------------------------------------------------------------

@pytest.mark.parametrize("turns", [-2, 0, 1])
@pytest.mark.parametrize("kind", ["(R)RR", "(R)PR", "P(R)R", "(R)US"])
def test_revolute_joints_stay_on_homes_turn(kind: str, turns: int) -> None:
    plain = machines.plain(kind)
    model = Model(plain)
    home = home_state(plain).q
    q, pose = machines.spread(model)
    given = machines.read_text(machines.plain_text(
        kind, q={f"leg{i + 1}": float(np.degrees(v)) + 360.0 * turns
                 for i, v in enumerate(home)}))
    found = inverse(Model(given), pose)
    np.testing.assert_allclose(found.q, q + 2.0 * np.pi * turns, rtol=0, atol=1e-11)
    back = forward(Model(given), found.q)
    assert np.abs(machines.difference(back.pose, pose)).max() < 1e-11


def test_whole_turns_with_a_ratio_are_counted_in_the_drives_own_unit() -> None:
    """90 degrees of arm per revolution of the drive: a whole turn of the arm is 4 of them."""
    def change(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        return {**limb, "ratio": -90.0}

    free = machines.read_text(machines.plain_text("(R)RR", change))
    home = home_state(free).q
    plain = home_state(machines.plain("(R)RR")).q
    np.testing.assert_allclose(home, -np.degrees(plain) / 90.0, rtol=1e-12)
    assert np.abs(home).max() <= 2.0
    given = machines.read_text(machines.plain_text(
        "(R)RR", change, q={f"leg{i + 1}": float(v) + 8.0 for i, v in enumerate(home)}))
    np.testing.assert_allclose(inverse(Model(given), given.home[None]).q[0], home + 8.0,
                               rtol=0, atol=1e-12)


def test_a_pose_a_whole_turn_away_has_the_same_joints() -> None:
    model = Model(machines.plain("R(P)R"))
    wanted = np.tile(model.mechanism.home_pose, (2, 1))
    wanted[1, 5] += 2.0 * np.pi
    q = inverse_partial(model, wanted).q
    np.testing.assert_allclose(q[0], q[1], rtol=0, atol=1e-14)
    assert cga.rotation_vector(pose_motor(wanted))[0, 2] == pytest.approx(wanted[0, 5])
