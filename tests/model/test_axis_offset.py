"""Universal joints whose axes do not meet, against the two-axis joint turned explicitly.

:func:`machines.chain_lengths` turns the joint about its first axis until the second is square to
the rod; :func:`machines.contract_lengths` has h^2 + (r - e)^2. Neither uses the program's algebra.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import machines
from helpers.machines import OFFSET_JOINTS, Array

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, newton
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.model.mechanism import Mechanism

each = pytest.mark.parametrize(("kind", "body"), OFFSET_JOINTS)


def perturbed(mechanism: Mechanism) -> Array:
    """Return parameter values off nominal: 3 mm, 0.02 rad, a ratio by 2 in 1000."""
    rng, g = np.random.default_rng(7), mechanism.values.copy()
    for i, p in enumerate(mechanism.parameters):
        size = 2e-3 * g[i] if p.per_unit else {"length": 3e-3, "angle": 0.02}[p.quantity]
        g[i] += size * rng.uniform(0.3, 1.0) * rng.choice([-1.0, 1.0])
    return g


@cache
def sample(kind: str, body: str, shifted: bool) -> tuple[Model, Array, Array]:
    """Return the machine with every slot, at nominal or with errors in all, and five poses."""
    mechanism = machines.offset_joints(kind, body, full=True)
    model = Model(mechanism, perturbed(mechanism)) if shifted else Model(mechanism)
    return (model, *machines.spread(model))


def moved(model: Model, index: int, step: float) -> Model:
    g = model.parameters.copy()
    g[index] += step
    return Model(model.mechanism, g)


@pytest.mark.long_cases("(P)US-base", "(R)US-base", "U(P)S-platform")
@each
@pytest.mark.slow
def test_the_closure_is_that_of_the_joint_turned_explicitly(kind: str, body: str) -> None:
    """Open or closed, at any pose: with the contract's formula, and with errors in every slot."""
    for shifted, tables in ((False, (machines.contract_lengths, machines.chain_lengths)),
                            (True, (machines.chain_lengths,))):
        model, q, pose = sample(kind, body, shifted)
        away = machines.displaced(pose, np.array([0.03, -0.02, 0.01, 0.05, -0.03, 0.04]))
        for at in (pose, away):
            found = model.closure(q).lengths(at)
            for table in tables:
                np.testing.assert_allclose(found, machines.limb_lengths(model, q, at, table),
                                           rtol=0.0, atol=4e-15)
        assert np.abs(found).min() > 1e-4


@each
def test_the_offset_matters_as_much_as_it_should(kind: str, body: str) -> None:
    """The same joints with axes that meet leave a gap of about e r/length."""
    mechanism = machines.offset_joints(kind, body)
    model = Model(mechanism)
    q, pose = machines.spread(model)
    g = model.parameters.copy()
    for i, name in enumerate(mechanism.names):
        g[i] = 0.0 if name.endswith("axis_offset") else g[i]
    gap = Model(mechanism, g).closure(q).lengths(pose)
    assert np.abs(gap).min() > 1e-3


@pytest.mark.long_cases(
    "nominal-(P)US-base", "nominal-(R)US-base", "nominal-(R)US-platform", "nominal-U(P)S-base",
    "perturbed-(P)US-base", "perturbed-(P)US-platform", "perturbed-(R)US-base",
    "perturbed-(R)US-platform", "perturbed-U(P)S-platform", "nominal-(P)US-platform",
    "perturbed-U(P)S-base")
@pytest.mark.slow
@each
@pytest.mark.parametrize("shifted", [False, True], ids=["nominal", "perturbed"])
def test_slot_derivatives_are_those_of_the_explicit_joint(kind: str, body: str, shifted: bool
                                                          ) -> None:
    """Closure's derivative by every slot, among them the offset, the axis and joint frames.

    By differences those of two legs: the six are of one kind.
    """
    model, q, pose = sample(kind, body, shifted)
    wanted = list(range(len(model.mechanism.parameters)))
    found = model.closure(q, wanted).error_matrix(pose, wanted)
    seen = np.abs(found).max(axis=(0, 1))
    for index, p in enumerate(model.mechanism.parameters):
        h = 1e-5 * abs(model.parameters[index]) if p.per_unit else 1e-5
        limb = next(i for i, limb in enumerate(model.mechanism.limbs)
                    if p.name.startswith(f"{limb.name}."))
        if limb not in (1, 4):
            continue
        after, before = (machines.limb_lengths(moved(model, index, step), q, pose, only=limb)
                         for step in (h, -h))
        np.testing.assert_allclose(found[:, limb, index], ((after - before) / (2.0 * h))[:, 0],
                                   rtol=1e-8, atol=2e-9, err_msg=p.name)
    names = [n for n in model.mechanism.names if f".{body}.axis" in n]
    assert len(names) == 24
    # at its own turn the joint does no work; that about the rod's plane does
    for limb in model.mechanism.limbs:
        own = [seen[i] for i, n in enumerate(model.mechanism.names)
               if n.startswith(f"{limb.name}.{body}.axis")]
        assert max(own[:3]) > 1e-4
        assert own[3] > 0.2


@pytest.mark.long
@each
def test_pose_and_joint_derivatives_are_those_of_the_explicit_joint(kind: str, body: str) -> None:
    model, q, pose = sample(kind, body, True)
    machines.assert_slopes_of_lengths(model, q, pose, by_joint_atol=3e-9)


@pytest.mark.long_cases("(P)US-base", "(R)US-platform", "U(P)S-platform")
@pytest.mark.slow
@each
def test_error_jacobian_is_that_of_refitted_forward_kinematics(kind: str, body: str) -> None:
    model, q, pose = sample(kind, body, True)
    wanted = [i for i, n in enumerate(model.mechanism.names) if n.startswith("leg2.")]
    closure = model.closure(q, wanted)
    jacobian = -np.linalg.solve(closure.pose_matrix(pose), closure.error_matrix(pose, wanted))
    for column, index in enumerate(wanted):
        h = 1e-5 * (abs(model.parameters[index]) if model.mechanism.parameters[index].per_unit
                    else 1.0)
        (after, good, _), (before, too, _) = (
            newton(moved(model, index, step).closure(q), pose) for step in (h, -h))
        assert good.all()
        assert too.all()
        np.testing.assert_allclose(jacobian[..., column],
                                   machines.difference(after, before) / (2.0 * h), rtol=1e-6,
                                   atol=3e-8, err_msg=model.mechanism.names[index])


@pytest.mark.slow
@each
def test_forward_and_inverse_undo_each_other(kind: str, body: str) -> None:
    """In all rows at once, with errors in all slots."""
    model, _, _ = sample(kind, body, True)
    q, pose = machines.spread(model, 40, seed=3)
    again = inverse(model, pose)
    assert again.reached.all()
    step = machines.joint_steps(model)
    np.testing.assert_allclose(again.q / step, q / step, rtol=0.0, atol=1e-11)
    there = forward(model, again.q)
    assert there.converged.all()
    assert np.abs(machines.difference(there.pose, pose)).max() < 1e-12


@pytest.mark.long_cases("(P)US-base", "(R)US-platform", "U(P)S-platform")
@pytest.mark.slow
@each
def test_the_branch_stays(kind: str, body: str) -> None:
    """As the offset grows from nothing, joint values follow it; the other root is another one."""
    meeting = machines.offset_joints(kind, body, size=0.0)
    model = Model(meeting)
    _, pose = machines.spread(model, 12)
    before = inverse(model, pose).q
    last = 0.0
    for size in (0.01, 1.0, 4.0, 12.0):
        own = Model(machines.offset_joints(kind, body, size=size))
        now = inverse(own, pose)
        assert now.reached.all()
        assert home_state(own.mechanism).roots == home_state(meeting).roots
        gap = machines.limb_lengths(own, now.q, pose, machines.contract_lengths)
        assert np.abs(gap).max() < 1e-14
        by_joint = own.closure(now.q).joint_matrix(pose)
        stiff = np.abs(np.diagonal(by_joint, axis1=1, axis2=2)).min(axis=0)
        # no offset changed by more than that, and a length by no more than the offset
        change = 1e-3 * (size - last + 10.0 * (last == 0.0))
        assert (np.abs(now.q - before).max(axis=0) < 2.0 * change / stiff).all()
        before, last = now.q, size


@each
def test_axes_that_meet_change_nothing_to_the_last_digit(kind: str, body: str) -> None:
    """With the first axis given and no offset: joints, poses, closure and derivatives are equal."""
    plain, given = Model(machines.plain(kind)), Model(machines.offset_joints(kind, body, size=0.0))
    q, pose = machines.spread(plain, 8)
    np.testing.assert_array_equal(inverse(plain, pose).q, inverse(given, pose).q)
    np.testing.assert_array_equal(forward(plain, q).pose, forward(given, q).pose)
    one, two = plain.closure(q), given.closure(q)
    np.testing.assert_array_equal(one.misclosure(pose), two.misclosure(pose))
    np.testing.assert_array_equal(one.pose_matrix(pose), two.pose_matrix(pose))
    np.testing.assert_array_equal(one.joint_matrix(pose), two.joint_matrix(pose))


@each
def test_the_slope_by_an_offset_of_nothing(kind: str, body: str) -> None:
    """At e = 0 the closure's slope by e is -r/length, by differences too."""
    model = Model(machines.offset_joints(kind, body, size=0.0))
    mechanism = model.mechanism
    wanted = [mechanism.names.index(f"leg{i + 1}.{body}.axis_offset") for i in range(6)]
    q, pose = machines.spread(model)
    found = model.closure(q, wanted).error_matrix(pose, wanted)
    for limb, index in enumerate(wanted):
        h = 1e-6
        after, before = (moved(model, index, step).closure(q).lengths(pose)[:, limb]
                         for step in (h, -h))
        np.testing.assert_allclose(found[:, limb, limb], (after - before) / (2.0 * h), rtol=1e-7,
                                   atol=1e-9)
    assert (np.diagonal(found, axis1=1, axis2=2) < -0.1).all()


def test_no_slope_where_the_rod_lies_along_the_first_axis() -> None:
    """r = 0: the turn has no meaning, and an offset that is not there has no slope."""
    def change(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        if i:
            return limb
        return {**limb, "base": {"point": [10.0, 20.0, 0.0], "axis": [0.0, 0.0, 1.0]},
                "platform": {"point": [10.0, 20.0, 0.0]}}

    text = machines.plain_text("U(P)S", change)
    mechanism = machines.read_text(text)
    wanted = [mechanism.names.index("leg1.base.axis_offset")]
    up = machines.motors(np.eye(3)[None], np.array([[0.0, 0.0, 0.5]]))
    q = inverse(Model(mechanism), up).q
    column = Model(mechanism).closure(q, wanted).error_matrix(up, wanted)
    assert np.isfinite(column).all()
    assert not column.any()


@pytest.mark.slow
@each
def test_a_rod_within_the_offset_of_the_first_axis_is_refused(kind: str, body: str) -> None:
    """The row is refused with the reason, and forward kinematics gives no pose there."""
    model = Model(machines.offset_joints(kind, body))
    _, pose = machines.spread(model, 3)
    g = model.parameters.copy()
    g[model.mechanism.names.index(f"leg2.{body}.axis_offset")] = 3.0 * model.mechanism.reach
    wide = Model(model.mechanism, g)
    found = inverse(wide, pose)
    assert not found.reached.any()
    assert all("leg2" in reason and "axis_offset" in reason for reason in found.reason)
    q = inverse(model, pose).q
    gone = forward(wide, q)
    assert not gone.converged.any()
    assert np.isnan(gone.pose).all()


@pytest.mark.long_cases("(P)US-base", "(R)US-platform")
@pytest.mark.slow
@pytest.mark.parametrize("body", ["base", "platform"])
@pytest.mark.parametrize("kind", ["(P)US", "(R)US"])
def test_at_the_end_of_the_reach(kind: str, body: str) -> None:
    """Poses are reached where the contract's equation has a root on a fine grid, and only there."""
    model = Model(machines.offset_joints(kind, body))
    mechanism = model.mechanism
    _, pose = machines.spread(model, 1)
    along = {"(P)US": [0.9, 0.2, 0.0], "(R)US": [0.06, 0.02, 0.4]}[kind]
    way = np.linspace(0.0, 1.0, 25)[:, None] * mechanism.reach * np.array(along)
    pose = machines.displaced(np.repeat(pose, len(way), axis=0), np.hstack([way, 0.0 * way]))
    found = inverse(model, pose)
    can = np.ones(len(pose), dtype=bool)
    for limb in mechanism.limbs:
        u = (np.linspace(-3.0, 3.0, 60001) * mechanism.reach if kind == "(P)US"
             else np.linspace(-np.pi, np.pi, 20001))
        for n in range(len(pose)):
            length = machines.contract_lengths(kind, limb.slots.values(model.parameters),
                                               limb.constants, u, pose[n])[:, 0]
            can[n] &= bool((length[1:] * length[:-1] <= 0.0).any())
    np.testing.assert_array_equal(found.reached, can)
    assert 3 < can.sum() < len(can) - 3
    gap = machines.limb_lengths(model, found.q[can], pose[can], machines.contract_lengths)
    assert np.abs(gap).max() < 1e-13
