"""Ropes over pulleys against the contract's formula and against differences, in plain NumPy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import yaml
from helpers.machines import Array, displaced, read_text
from helpers.paths import ROOT
from helpers.pulleys import rope_lengths

from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.json_schema import file_schema
from ppmcal.io.mechanism_writer import write_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.loads import limb_forces
from ppmcal.kinematics.skeleton import skeleton

FILES = ("cable-4-pulleys", "cable-8-pulleys")
each = pytest.mark.parametrize("name", FILES)


def tree(name: str) -> dict:
    return yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))


def refused(text: str) -> tuple[str, str]:
    with pytest.raises(BadInput) as error:
        read_text(text)
    return error.value.what, error.value.hint


@cache
def sample(name: str, axes: float = 0.02) -> tuple[Model, Array, Array]:
    """Return a machine with finite errors, of axes too, and five of its poses with joints."""
    mechanism = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    rng = np.random.default_rng(5)
    size = np.where([p.quantity == "length" for p in mechanism.parameters], 3e-3, axes)
    model = Model(mechanism, mechanism.values + size * rng.uniform(-1.0, 1.0, size.size))
    step = np.zeros((5, 6))
    reach = np.where(np.array(mechanism.dof) < 3, 0.4, 0.15)
    step[:, list(mechanism.dof)] = reach * rng.uniform(-1.0, 1.0, (5, reach.size))
    pose = displaced(np.repeat(mechanism.home[None], 5, axis=0), step)
    return model, inverse(model, pose).q, pose


@each
def test_a_rope_is_as_long_as_tangent_and_arc(name: str) -> None:
    model, q, pose = sample(name, 0.0)
    np.testing.assert_allclose(q, rope_lengths(model.mechanism, model.parameters, pose), rtol=0.0,
                               atol=1e-12)
    np.testing.assert_allclose(model.closure(q).lengths(pose), 0.0, rtol=0.0, atol=1e-14)


@each
@pytest.mark.slow_cases("cable-8-pulleys")
def test_forward_undoes_inverse(name: str) -> None:
    model, q, pose = sample(name)
    found = forward(model, q)
    assert found.converged.all()
    np.testing.assert_allclose(found.pose, pose, rtol=0.0, atol=1e-12)


@each
@pytest.mark.slow_cases("cable-8-pulleys")
def test_derivatives_are_differences(name: str) -> None:
    """By pose, joint and every slot, radii and axes too: of a rope that leaves askew as well.

    Exact at poses that do not close, too, as those of ropes that contradict each other.
    """
    model, q, pose = sample(name)
    q = q + 0.01 * np.arange(q.shape[1])
    every, h = list(range(len(model.mechanism.parameters))), 1e-5

    def c(pose: Array, q: Array = q, g: Array = model.parameters) -> Array:
        return Model(model.mechanism, g).closure(q).misclosure(pose)

    closure = model.closure(q, every)
    for column, k in enumerate(model.mechanism.dof):
        step = h * np.eye(6)[k]
        np.testing.assert_allclose(
            closure.pose_matrix(pose)[..., column],
            (c(displaced(pose, step)) - c(displaced(pose, -step))) / (2 * h), rtol=0.0, atol=2e-9)
    for k, step in enumerate(h * np.eye(q.shape[1])):
        np.testing.assert_allclose(closure.joint_matrix(pose)[..., k],
                                   (c(pose, q + step) - c(pose, q - step)) / (2 * h), rtol=0.0,
                                   atol=2e-9)
    by = closure.error_matrix(pose, every)
    for k, step in enumerate(h * np.eye(len(every))):
        g = model.parameters
        np.testing.assert_allclose(
            by[..., k], (c(pose, g=g + step) - c(pose, g=g - step)) / (2 * h), rtol=0.0, atol=2e-9,
            err_msg=model.mechanism.names[k])


@each
def test_a_rope_pulls_along_what_is_off_the_pulley(name: str) -> None:
    """The line is that of the tangent; it is drawn from where it leaves the pulley."""
    model, q, pose = sample(name)
    drawn = skeleton(model, pose, q)
    lines = model.closure(q).lines(pose)[..., :3]
    for i, limb in enumerate(drawn):
        start, end = limb.links[-1].start, limb.links[-1].end
        assert limb.links[-1].name == "u"
        away = end - start
        length = np.linalg.norm(away, axis=1)
        size = np.linalg.norm(lines[:, i], axis=1)     # 1 but where it leaves askew
        assert np.all((size >= 1.0 - 1e-12) & (size < 1.0 + 1e-6))
        np.testing.assert_allclose(lines[:, i] / size[:, None], away / length[:, None], rtol=0.0,
                                   atol=1e-12)
        assert np.max(limb.gap) < 1e-12
        r = next(v for k, v in model.limb_values[i].items() if k.endswith("radius"))
        assert np.all(q[:, i] - length > 0.0)
        assert np.all(q[:, i] - length < 1.01 * np.pi * r + abs(model.limb_values[i]["offset"]))


@each
@pytest.mark.slow_cases("cable-8-pulleys")
def test_a_file_reads_back_as_written(name: str) -> None:
    mechanism = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    moved = mechanism.with_values(mechanism.values + 1e-3 * np.arange(mechanism.values.size) / 50)
    for own in (mechanism, moved):
        again = read_text(write_mechanism(own))
        assert again.names == own.names
        np.testing.assert_allclose(home_state(again).q, home_state(own).q, rtol=0.0, atol=1e-13)


def test_slots_are_called_as_the_file_has_them() -> None:
    names = read_mechanism(ROOT / "configs" / "cable-8-pulleys.yaml").names
    assert names[:9] == (
        "c1.base.pulley.center.x", "c1.base.pulley.center.y", "c1.base.pulley.center.z",
        "c1.base.pulley.axis.rx", "c1.base.pulley.axis.ry", "c1.base.pulley.axis.rz",
        "c1.base.pulley.radius", "c1.platform.point.x", "c1.platform.point.y")
    assert {n.partition(".")[2] for n in names if n.startswith("c5.base")} == {
        *(f"base.swivel_pulley.point.{a}" for a in "xyz"),
        *(f"base.swivel_pulley.axis.r{a}" for a in "xyz"), "base.swivel_pulley.radius"}
    flat = read_mechanism(ROOT / "configs" / "cable-4-pulleys.yaml").names
    assert not [n for n in flat if "axis" in n or "zero" in n]


def test_the_force_on_a_pulley_is_that_of_the_rope() -> None:
    model, q, pose = sample("cable-8-pulleys")
    wrench = np.tile([30.0, 20.0, -100.0, 1.0, -2.0, 5.0], (5, 1))
    np.testing.assert_allclose(limb_forces(model, q, pose, wrench).sum(axis=1), wrench[:, :3],
                               rtol=0.0, atol=1e-10)


def test_a_point_inside_the_pulley_cannot_be_reached() -> None:
    machine = tree("cable-4-pulleys")
    machine["limbs"][0]["base"]["pulley"]["radius"] = 3000
    mechanism = read_text(yaml.safe_dump(machine))
    with pytest.raises(BadInput) as error:
        home_state(mechanism)
    assert "it ends inside its pulley" in error.value.what


def test_what_is_refused_of_pulleys() -> None:
    machine = tree("cable-4-pulleys")
    own = machine["limbs"][0]["base"]["pulley"]

    def with_pulley(**change: object) -> tuple[str, str]:
        machine["limbs"][0]["base"] = {"pulley": {
            k: v for k, v in {**own, **change}.items() if v is not None}}
        return refused(yaml.safe_dump(machine))

    assert with_pulley(radius=-2)[0] == "a pulley of radius -2 is not possible"
    assert with_pulley(radius=None)[0] == "the slot 'base.pulley.radius' is missing"
    what, hint = with_pulley(zero=None)
    assert what == "the direction 'base.pulley.zero' is missing"
    assert hint == "Add `zero: [0, 0, 1]` under `base.pulley`"
    assert with_pulley(axis=[0, 1, 0], zero=[1, 0, 0])[0] == (
        "base.pulley.axis is not square to the plane of motion")
    assert with_pulley(center=None)[0] == "the point is missing"
    assert with_pulley(size=3)[0].startswith("unknown key 'size'")
    assert with_pulley(axis={"value": [0, 0, 1], "tolerance": 1})[0] == (
        "base.pulley.axis has no 'tolerance' in the plane")
    machine["limbs"][0]["base"] = {"swivel_pulley": {"point": [0, 0], "radius": 3}}
    what, hint = refused(yaml.safe_dump(machine))
    assert what == "a swivel_pulley turns out of the plane, in which planar motion stays"
    assert hint == "Give base.pulley"
    machine["limbs"][0]["base"] |= {"pulley": own}
    assert refused(yaml.safe_dump(machine))[0].startswith("pulley and swivel_pulley are given")


@pytest.mark.long
def test_the_schema_knows_pulleys() -> None:
    definitions = file_schema("mechanism")["$defs"]
    own = definitions["limb rope over a pulley"]["properties"]["base"]["properties"]["pulley"]
    assert set(own["properties"]) == {"center", "axis", "zero", "radius"}
    jsonschema = pytest.importorskip("jsonschema")
    for name in FILES:
        jsonschema.validate(tree(name), file_schema("mechanism"))
    wrong = tree("cable-4-pulleys")
    wrong["limbs"][0]["base"]["pulley"]["size"] = 3
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(wrong, file_schema("mechanism"))
