"""Every limb kind against the contract's table and against differences, in plain NumPy.

The references are in :mod:`machines`: the table written out, and the same linkages as
products of 4x4 matrices. A kind that is registered without a case there fails the suite.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers import constrained, machines
from helpers.machines import KINDS, Array

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.limbs import kinds
from ppmcal.model.mechanism import Mechanism

each = pytest.mark.parametrize("kind", KINDS)
six_legs = pytest.mark.parametrize("kind", ["U(P)S", "(P)US", "(R)US"])
at_both = pytest.mark.parametrize("shifted", [False, True], ids=["nominal", "perturbed"])

NO_MOVE = {  # turns about a spherical joint's own centre, passive angles, passive slides
    "R(P)R": ["joint1.r?", "joint3.r?"],
    "(R)RR": ["joint2.r?", "joint3.r?"], "R(R)R": ["joint1.r?", "joint3.r?"],
    "(P)RR": ["joint2.r?", "joint3.r?"],
    "(R)PR": ["joint3.r?", "joint3.[xz]"], "P(R)R": ["joint3.r?", "joint2.[xz]"],
    "(P)PR": ["joint3.r?", "joint3.[xz]"], "P(P)R": ["joint3.r?", "joint2.y"],
    "(R)RP": ["joint2.r?", "joint1.z"], "R(R)P": ["joint1.r?", "joint1.z"],
    "R(P)P": ["joint1.r?", "joint1.z"], "(P)RP": ["joint2.r?", "joint1.y"],
    "U(P)S": ["joint1.r?", "joint3.r?"], "(P)US": ["joint2.r?", "joint3.r?"],
    "(R)US": ["joint3.r?"], "R(P)S": ["joint3.r?"],
}
NO_MOVE_AT_NOMINAL = {  # a link about its root, a slide along itself, out of the plane
    "R(P)R": ["joint2.r?", "joint1.z", "joint2.y", "joint3.z"],
    "(R)RR": ["joint?.z"], "(P)RR": ["joint1.y", "joint2.z", "joint3.z"],
    "R(R)R": ["joint?.z", "joint2.rx", "joint2.ry"],
    "(R)PR": ["joint2.z", "joint2.rz"], "P(R)R": ["joint1.z", "joint1.rz", "joint3.z"],
    "(P)PR": ["joint2.z", "joint2.rz"], "P(P)R": ["joint1.z", "joint1.rz"],
    "(R)RP": ["joint3.z", "joint3.rz"], "R(R)P": ["joint3.z", "joint3.rz"],
    "R(P)P": ["joint3.z", "joint3.rz"], "(P)RP": ["joint3.z", "joint3.rz"],
    "U(P)S": ["joint2.r?"],
    "(R)US": ["joint2.r?"],  # the universal joint's centre, as long as its axes meet
    "R(P)S": ["joint1.rz"],  # the hinge's own angle
}


def perturbed(mechanism: Mechanism) -> Array:
    """Return parameter values off nominal: 3 mm, 0.02 rad, a ratio by 2 in 1000."""
    rng = np.random.default_rng(7)
    g = mechanism.values.copy()
    for i, p in enumerate(mechanism.parameters):
        size = 2e-3 * g[i] if p.per_unit else {"length": 3e-3, "angle": 0.02}[p.quantity]
        g[i] += size * rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)
    return g


@cache
def sample(kind: str, shifted: bool) -> tuple[Model, Array, Array]:
    """Return the full machine, nominal or with finite errors in every slot, and five poses."""
    mechanism = machines.full(kind)
    model = Model(mechanism, perturbed(mechanism)) if shifted else Model(mechanism)
    return (model, *machines.spread(model))


def moved(model: Model, index: int, step: float) -> Model:
    g = model.parameters.copy()
    g[index] += step
    return Model(model.mechanism, g)


def step_of(model: Model, index: int) -> float:
    p = model.mechanism.parameters[index]
    return 1e-5 * abs(model.parameters[index]) if p.per_unit else 1e-5


def columns(model: Model, q: Array, pose: Array) -> dict[str, Array]:
    """Return Bg's columns (N, d) by parameter name."""
    everything = list(range(len(model.mechanism.parameters)))
    matrix = model.closure(q, everything).error_matrix(pose, everything)
    return {p.name: matrix[..., i] for i, p in enumerate(model.mechanism.parameters)}


def test_every_registered_kind_has_a_case() -> None:
    # ropes have no joints whose frames could err: test_least_squares_closure.py has their facts
    # limbs that hold rotations are in test_constrained_limbs.py
    elsewhere = {k.name for k in kinds().values() if k.pulls_only} | set(constrained.MACHINES)
    assert set(kinds()) - elsewhere == set(KINDS) == set(machines.CHAINS) == set(NO_MOVE)


@each
def test_the_full_machine_has_every_slot_of_its_kind(kind: str) -> None:
    names = set(machines.full(kind).names)
    slots = [*kinds()[kind].slots, *kinds()[kind].joint_slots]
    # those of a universal joint's first axis are in test_axis_offset.py
    missing = {s.name for s in slots if not s.needs} - {n.partition(".")[2] for n in names}
    assert not missing
    assert len([n for n in names if n.startswith("leg2.joint")]) == 18


@each
def test_the_gap_is_the_contracts_condition_as_a_length(kind: str) -> None:
    """At any pose and any joint value: zero at the same places, and as far from zero."""
    model = Model(machines.full(kind))
    rng = np.random.default_rng(3)
    q, pose = machines.spread(model)
    q = q + 0.02 * q * rng.uniform(-1, 1, q.shape)
    shift = np.zeros((len(q), 6))
    own = list(model.mechanism.dof)
    shift[:, own] = 0.03 * rng.uniform(-1, 1, (len(q), len(own)))
    pose = machines.displaced(pose, shift)
    expected = machines.limb_lengths(model, q, pose, machines.contract_lengths)
    closure = model.closure(q)
    assert np.min(np.abs(expected)) > 1e-6
    np.testing.assert_allclose(closure.lengths(pose), expected, rtol=0.0, atol=3e-15)
    r = closure.radius
    squared = np.divide(expected * expected, 2.0 * r, out=np.zeros_like(expected), where=r > 0.0)
    np.testing.assert_allclose(closure.misclosure(pose), expected + squared, rtol=0.0, atol=3e-15)


@each
def test_the_reference_chain_is_the_contracts_table(kind: str) -> None:
    """The 4x4 matrices, with all frame errors 0, are the contract's formulas."""
    model = Model(machines.full(kind))
    q, pose = machines.spread(model)
    q = 1.01 * q
    np.testing.assert_allclose(
        machines.limb_lengths(model, q, pose),
        machines.limb_lengths(model, q, pose, machines.contract_lengths), rtol=0.0, atol=3e-15)


@each
def test_the_gap_with_finite_frame_errors_is_the_matrix_chains(kind: str) -> None:
    model, q, pose = sample(kind, True)
    for at in (pose, machines.displaced(pose, np.array([2e-3, -1e-3, 0, 0, 0, 0.01]))):
        np.testing.assert_allclose(model.closure(q).lengths(at),
                                   machines.limb_lengths(model, q, at), rtol=0.0, atol=3e-15)


@pytest.mark.long_cases("perturbed-(R)US", "nominal-(P)US", "nominal-U(P)S")
@pytest.mark.slow
@each
@at_both
def test_slot_derivatives_are_those_of_the_matrix_chain(kind: str, shifted: bool) -> None:
    """Points, lengths, angles, offset, ratio, lateral, directions and joint frames."""
    model, q, pose = sample(kind, shifted)
    found, names = columns(model, q, pose), [limb.name for limb in model.mechanism.limbs]
    rows = machines.rows_of(model.mechanism)
    for index, p in enumerate(model.mechanism.parameters):
        h, limb = step_of(model, index), names.index(p.name.split(".")[0])
        after, before = (machines.limb_lengths(moved(model, index, step), q, pose, only=limb)
                         for step in (h, -h))
        np.testing.assert_allclose(found[p.name][:, rows[limb]], (after - before) / (2.0 * h),
                                   rtol=1e-8, atol=1e-9, err_msg=p.name)


@pytest.mark.long_cases("perturbed-(R)US")
@each
@at_both
def test_joint_and_pose_derivatives_are_those_of_the_matrix_chain(kind: str, shifted: bool
                                                                  ) -> None:
    model, q, pose = sample(kind, shifted)
    machines.assert_slopes_of_lengths(model, q, pose, by_joint_atol=2e-9)


@pytest.mark.slow
@each
def test_error_jacobian_is_that_of_refitted_forward_kinematics(kind: str) -> None:
    """J_g = -A^-1 Bg for every slot of a limb against the poses that Newton finds ([LIN])."""
    model, q, pose = sample(kind, True)
    wanted = [i for i, n in enumerate(model.mechanism.names) if n.startswith("leg2.")]
    closure = model.closure(q, wanted)
    jacobian = -np.linalg.solve(closure.pose_matrix(pose), closure.error_matrix(pose, wanted))
    for column, index in enumerate(wanted):
        h = step_of(model, index)
        (after, closed, _), (before, closed_too, _) = (
            newton(moved(model, index, step).closure(q), pose) for step in (h, -h))
        assert closed.all()
        assert closed_too.all()
        expected = machines.difference(after, before) / (2.0 * h)
        np.testing.assert_allclose(
            jacobian[..., column], expected[:, model.mechanism.dof], rtol=1e-6, atol=2e-8,
            err_msg=model.mechanism.names[index])


@six_legs
def test_error_jacobian_is_that_of_six_unit_loads(kind: str) -> None:
    """[LIN] section 2.5: the leg forces under six unit loads give J_g, here by plain statics.

    A two-force member carries f_i along its unit vector e_i. Under load w on the platform
    sum f_i (e_i, r_i x e_i) + w = 0; an elongation dl_i of the leg moves the platform by dy with
    w.dy = -f_i dl_i. Every slot is some elongation of its leg.
    """
    model, q, pose = sample(kind, False)
    mechanism = model.mechanism
    rotation, origin = machines.matrices(pose)
    u = machines.joint_coordinates(model, q)
    directions, arms, elongations = [], [], []
    for i, limb in enumerate(mechanism.limbs):
        v, c = limb.slots.values(model.parameters), limb.constants
        a = np.array([v[f"base.point.{k}"] for k in "xyz"])
        arm = rotation @ np.array([v[f"platform.point.{k}"] for k in "xyz"])
        foot = np.broadcast_to(a, arm.shape).copy()
        own: dict[str, Array] = {}
        if kind == "(P)US":
            foot += u[i][:, None] * c["base.direction"]
        elif kind == "(R)US":
            axis, zero = c["base.axis"], c["base.zero"]
            crank = (np.cos(u[i])[:, None] * zero + np.sin(u[i])[:, None] * np.cross(axis, zero))
            foot += v["proximal"] * crank
        e = origin + arm - foot
        e /= np.linalg.norm(e, axis=1, keepdims=True)
        directions.append(e)
        arms.append(arm)
        for k, letter in enumerate("xyz"):
            own[f"base.point.{letter}"] = e[:, k]
            own[f"platform.point.{letter}"] = -np.sum(e * rotation[:, :, k], axis=1)
        own[{"U(P)S": "offset", "(P)US": "length", "(R)US": "distal"}[kind]] = np.ones(len(q))
        if kind != "U(P)S":
            turning = "base.direction" if kind == "(P)US" else "base.axis"
            for k, letter in enumerate("xyz"):
                own[f"{turning}.r{letter}"] = np.sum(e * np.cross(np.eye(3)[k], foot - a), axis=1)
        if kind == "(P)US":
            own["offset"] = e @ c["base.direction"]
        if kind == "(R)US":
            own["offset"] = np.sum(e * np.cross(axis, foot - a), axis=1)
            own["proximal"] = np.sum(e * crank, axis=1)
            radial = e - np.sum(e * axis, axis=1, keepdims=True) * axis
            own["base.axis_offset"] = np.linalg.norm(radial, axis=1)
        own["ratio"] = own["offset"] * q[:, limb.actuator]
        elongations.append(own)
    legs = np.stack(directions, axis=1)
    wrenches = np.concatenate([legs, np.cross(np.stack(arms, axis=1), legs)], axis=-1)
    forces = -np.linalg.inv(np.swapaxes(wrenches, 1, 2))  # (N, leg, load)
    checked = 0
    for i, limb in enumerate(mechanism.limbs):
        for slot, elongation in elongations[i].items():
            if f"{limb.name}.{slot}" not in mechanism.names:
                continue
            index = [mechanism.names.index(f"{limb.name}.{slot}")]
            closure = model.closure(q, index)
            found = -np.linalg.solve(closure.pose_matrix(pose), closure.error_matrix(pose, index))
            np.testing.assert_allclose(found[..., 0], -forces[:, i] * elongation[:, None],
                                       rtol=1e-10, atol=1e-11, err_msg=f"{limb.name}.{slot}")
            checked += 1
    joints = [n for n in mechanism.names if ".joint" in n]
    assert checked == len(mechanism.names) - len(joints)


def names_like(mechanism: Mechanism, patterns: list[str]) -> list[str]:
    return [p.name for p in mechanism.parameters
            if any(p.matches(f"leg?.{pattern}") for pattern in patterns)]


@each
def test_errors_that_move_nothing_pair_to_zero(kind: str) -> None:
    """Nobody told the engine: the pairing of line and twist vanishes by itself."""
    for shifted in (False, True):
        model, q, pose = sample(kind, shifted)
        blind = names_like(model.mechanism, NO_MOVE[kind]
                           + ([] if shifted else NO_MOVE_AT_NOMINAL.get(kind, [])))
        assert blind
        found = columns(model, q, pose)
        assert dict.fromkeys(blind, 0.0) == {
            n: float(np.abs(found[n]).max()) if np.abs(found[n]).max() > 1e-15 else 0.0
            for n in blind}


@each
def test_errors_that_move_something_do_not_pair_to_zero(kind: str) -> None:
    """With finite errors everywhere, only the blind ones are blind."""
    model, q, pose = sample(kind, True)
    blind = set(names_like(model.mechanism, NO_MOVE[kind]))
    found = columns(model, q, pose)
    unseen = {n for n, c in found.items() if np.abs(c).max() < 1e-12} - blind
    assert not unseen


@each
def test_home_closes(kind: str) -> None:
    for mechanism in (machines.plain(kind), machines.full(kind)):
        q = home_state(mechanism).q[None]
        gap = machines.limb_lengths(Model(mechanism), q, mechanism.home[None],
                                    machines.contract_lengths)
        assert np.abs(gap).max() < 1e-15 * max(1.0, mechanism.reach) + 1e-15


@each
def test_errors_of_one_limb_leave_the_others_rows_alone(kind: str) -> None:
    model, q, pose = sample(kind, True)
    rows = dict(zip((limb.name for limb in model.mechanism.limbs),
                    machines.rows_of(model.mechanism), strict=True))
    for name, column in columns(model, q, pose).items():
        other = np.delete(column, rows[name.split(".")[0]], axis=1)
        assert not other.any()
