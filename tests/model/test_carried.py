"""What limbs carry of a wrench, and kinds that say what the platform carries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from helpers.machines import spread
from helpers.paths import ROOT

from ppmcal import algebra as cga
from ppmcal.io import read_mechanism
from ppmcal.io.effects import with_effects
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import effect_terms, setting
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.loads import limb_forces, loads
from ppmcal.linalg import Array
from ppmcal.model.dataset import Environment, environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import SI

N = 5


def machine(name: str) -> Mechanism:
    return read_mechanism(ROOT / "configs" / f"{name}.yaml")


def campaign(mechanism: Mechanism) -> tuple[Array, Environment]:
    """Return joints about home and conditions with a payload and other forces."""
    rng = np.random.default_rng(8)
    q, _ = spread(Model(mechanism), N, size=0.5)
    columns = {"payload": rng.uniform(5.0, 20.0, N), **{
        c: rng.uniform(-30.0, 30.0, N) for c in ("fx", "fy", "fz", "mx", "my", "mz")}}
    return q, environment(columns, mechanism.actuators, mechanism.gravity, q)


def acting(mechanism: Mechanism, **effects: Mapping[str, float]) -> Mechanism:
    return with_effects(mechanism, [{"kind": k, "parameters": v} for k, v in effects.items()],
                        SI, "effects.yaml")


def centres(model: Model, body: str) -> Array:
    """Return the joint centres of a body in its own axes (limbs, 3)."""
    return np.array([[float(v.get(f"{body}.point.{c}", 0.0)) for c in "xyz"]
                     for v in model.limb_values])


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS"])
def test_limbs_bear_the_wrench_together(name: str) -> None:
    """Their forces have its sum and its moment, and act along the limbs with the drives' loads."""
    mechanism = machine(name)
    model = Model(mechanism)
    q, rows = campaign(mechanism)
    pose = forward(model, q).pose
    force = limb_forces(model, q, pose, rows.wrench)
    turn = cga.rotation_matrix(pose)
    arms = np.einsum("nij,lj->nli", turn, centres(model, "platform"))
    whole = np.concatenate([force.sum(axis=1), np.cross(arms, force).sum(axis=1)], axis=1)
    scale = np.abs(rows.wrench).max()
    np.testing.assert_allclose(whole[:, mechanism.dof], rows.wrench[:, mechanism.dof], rtol=0.0,
                               atol=1e-10 * scale * max(1.0, mechanism.reach))
    along = arms + cga.translation(pose)[:, None] - centres(model, "base")
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.sum(force * along, axis=-1),
                               loads(model, q, pose, rows.wrench), rtol=1e-9, atol=1e-9 * scale)
    np.testing.assert_allclose(np.cross(force, along), 0.0, atol=1e-9 * scale)


def test_a_plate_of_no_reach_is_a_compliance_of_the_limbs() -> None:
    """In the plane a joint that moves along its own limb's force is a limb that is softer."""
    mechanism = machine("3-RPR")
    q, rows = campaign(mechanism)
    give = 2e-7
    one = acting(mechanism, plate_compliance={"base": give, "reach": 1e-3})
    other = acting(mechanism, compliance={"stiffness": 1.0 / give})
    plain = reached_poses(Model(mechanism), q, rows).pose
    found = reached_poses(Model(one), q, rows).pose
    expected = reached_poses(Model(other), q, rows).pose
    moved = np.abs(expected - plain).max()
    assert moved > 1e-6
    # the base joint also swings sideways by nothing: the force is along the limb
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-4 * moved)


def test_a_plate_of_endless_reach_moves_as_one() -> None:
    """All joints of the base move alike: the platform with them, by the wrench's force."""
    mechanism = machine("3-RPR")
    q, rows = campaign(mechanism)
    give = 2e-7
    plate = acting(mechanism, plate_compliance={"base": give, "reach": 1e5})
    plain = reached_poses(Model(mechanism), q, rows).pose
    found = reached_poses(Model(plate), q, rows).pose
    np.testing.assert_allclose(
        cga.translation(found)[:, :2] - cga.translation(plain)[:, :2],
        give * rows.wrench[:, :2], rtol=1e-6)


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS"])
def test_a_payload_beside_the_origin_is_its_moment(name: str) -> None:
    """As if the moment had been recorded, at the pose where it acts."""
    mechanism = machine(name)
    q, rows = campaign(mechanism)
    arm = {"x": 0.05, "y": -0.08} | ({} if name == "3-RPR" else {"z": 0.03})
    compliance = {"stiffness": 1e6}
    found = reached_poses(Model(acting(mechanism, compliance=compliance, payload_offset=arm)),
                          q, rows).pose
    lever = np.einsum("nij,j->ni", cga.rotation_matrix(found), [*arm.values(), 0.0][:3])
    wrench = rows.wrench.copy()
    wrench[:, 3:] += np.cross(lever, rows.weight)
    expected = reached_poses(Model(acting(mechanism, compliance=compliance)), q,
                             replace(rows, wrench=wrench)).pose
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10)
    plain = reached_poses(Model(acting(mechanism, compliance=compliance)), q, rows).pose
    assert np.abs(found - plain).max() > 1e-6


@pytest.mark.parametrize(("name", "turns", "gravity"), [
    ("3-RPR", {"turn": np.pi / 2}, [1.0, 0.0, 0.0]),
    ("6-UPS", {"first": np.pi / 2}, [0.0, 1.0, 0.0]),
    ("6-UPS", {"second": np.pi / 2}, [-1.0, 0.0, 0.0])])
def test_a_tilt_is_another_gravity(name: str, turns: dict[str, float], gravity: list[float]
                                   ) -> None:
    """By a right angle: -y turned about z is x, -z about x is y, -z about y is -x."""
    mechanism = machine(name)
    down = np.array([0.0, -1.0, 0.0] if name == "3-RPR" else [0.0, 0.0, -1.0])
    mechanism = replace(mechanism, gravity=down)
    q, rows = campaign(mechanism)
    pose = forward(Model(mechanism), q).pose
    tilted = acting(mechanism, gravity_tilt=turns)
    seen = setting(Model(tilted), rows, q, pose)
    weight = np.linalg.norm(rows.weight, axis=1)
    np.testing.assert_allclose(seen.weight, weight[:, None] * np.array(gravity), rtol=0.0,
                               atol=1e-12 * weight.max())
    np.testing.assert_allclose(seen.wrench[:, :3] - rows.wrench[:, :3], seen.weight - rows.weight,
                               rtol=0.0, atol=1e-12 * weight.max())


CARRIED = {"payload_offset": {"x": 0.05, "y": -0.08}, "gravity_tilt": {"turn": 0.3}}


def visited(moments: Array | float = 0.0, turn: float = 0.0) -> tuple[Array, Environment]:
    """Return joints in their order with a payload put on and off, its weight turned as told."""
    mechanism, rng = machine("3-RPR"), np.random.default_rng(9)
    q, _ = spread(Model(mechanism), 12, size=0.5)
    columns = {"payload": rng.choice([5.0, 20.0], 12), "time": np.arange(12) * 60.0,
               "mz": rng.uniform(-3.0, 3.0, 12) + moments}
    down = mechanism.gravity
    turned = np.array([np.cos(turn) * down[0] - np.sin(turn) * down[1],
                       np.sin(turn) * down[0] + np.cos(turn) * down[1], 0.0])
    return q, environment(columns, mechanism.actuators, turned, q, sequence=True)


@pytest.mark.parametrize("kind", CARRIED)
def test_what_creeps_remembers_what_was_carried(kind: str) -> None:
    """The loads of rows before are those of the payload as it is carried, recorded or not."""
    plain = machine("3-RPR")
    mechanism = acting(plain, creep={"give": 1e-6, "tau": 90.0}, **{kind: CARRIED[kind]})
    q, rows = visited()
    pose = forward(Model(plain), q).pose
    lever = np.einsum("nij,j->ni", cga.rotation_matrix(pose), [0.05, -0.08, 0.0])
    told = visited(moments=np.cross(lever, rows.weight)[:, 2]) if kind == "payload_offset" else (
        visited(turn=0.3))
    found = setting(Model(mechanism), rows, q, pose).late_load(90.0)[0]
    expected = setting(Model(plain), told[1], q, pose).late_load(90.0)[0]
    unaware = setting(Model(plain), rows, q, pose).late_load(90.0)[0]
    scale = np.abs(expected).max()
    assert np.abs(unaware - expected).max() > 1e-2 * scale
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10 * scale)


@pytest.mark.parametrize("kind", CARRIED)
def test_creep_changes_with_what_is_carried(kind: str) -> None:
    """Derivatives of the whole shift by what is carried, against differences of the whole."""
    mechanism = acting(machine("3-RPR"), creep={"give": 1e-6, "tau": 90.0}, **{kind: CARRIED[kind]})
    q, rows = visited()
    model = Model(mechanism)
    pose = forward(Model(machine("3-RPR")), q).pose

    def whole(values: Array) -> Array:
        moved = mechanism.with_values(values)
        at = setting(Model(moved), rows, q, pose)
        ((_, creep), *_rest) = effect_terms(moved, moved.values, at)
        return np.stack([creep.shift.slots[i, "offset"] for i in range(3)])

    terms = effect_terms(mechanism, mechanism.values, setting(model, rows, q, pose))
    effect, own = terms[1]
    for name in CARRIED[kind]:
        step = np.zeros(len(mechanism.values))
        step[effect.parameters[name]] = 1e-5
        wanted = (whole(mechanism.values + step) - whole(mechanism.values - step)) / 2e-5
        found = np.stack([own.by[name].slots[i, "offset"] for i in range(3)])
        assert np.abs(wanted).max() > 0.0
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-6 * np.abs(wanted).max())


def test_a_plain_compliance_is_what_it_was() -> None:
    """Without hardening and slope it is f/stiffness to the last digit; with them it is not."""
    mechanism = machine("3-RPR")
    q, rows = campaign(mechanism)
    model = Model(acting(mechanism, compliance={"stiffness": 3e6}))
    pose = forward(Model(mechanism), q).pose
    at = setting(model, rows, q, pose)
    (effect,) = model.mechanism.effects
    on = np.ones(3, dtype=bool)
    values = {n: model.mechanism.values[p] for n, p in effect.parameters.items()}
    plain = effect.kind.evaluate(at, on, values).shift.slots
    for i in range(3):
        np.testing.assert_array_equal(plain[i, "offset"], at.load[:, i] * (1.0 / 3e6))
    for more in ({"hardening": 1e-3}, {"by_stroke": 0.5}):
        bent = effect.kind.evaluate(at, on, values | more).shift.slots
        assert np.abs(bent[0, "offset"] / plain[0, "offset"] - 1.0).max() > 1e-3
