"""Limbs that keep the platform from turning, passive ones among them, against plain NumPy."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import yaml
from helpers import machines
from helpers.constrained import CONDITIONS, MACHINES, serial_pose, with_joint_frames
from helpers.machines import Array, displaced, read_text
from helpers.paths import ROOT

from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.mechanism_writer import write_mechanism
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.loads import limb_forces, loads
from ppmcal.kinematics.partial_pose import inverse_partial, pose_vector
from ppmcal.kinematics.skeleton import skeleton
from ppmcal.model.limbs import kinds
from ppmcal.model.mechanism import PASSIVE

CONFIGS = ROOT / "configs"
FILES = sorted(set(MACHINES.values()))
each = pytest.mark.parametrize("kind", MACHINES)
at_both = pytest.mark.parametrize("shifted", [False, True], ids=["nominal", "perturbed"])


@cache
def sample(kind: str, shifted: bool) -> tuple[Model, Array, Array]:
    """Return a machine, nominal or with finite errors in every slot, and five closed poses."""
    mechanism = with_joint_frames(kind)
    g = mechanism.values.copy()
    if shifted:
        size = np.where([p.quantity == "length" for p in mechanism.parameters], 3e-3, 0.02)
        g += size * np.random.default_rng(5).uniform(-1.0, 1.0, g.size)
    model = Model(mechanism, g)
    return (model, *machines.spread(model, size=0.5))


def own_rows(model: Model, kind: str) -> list[tuple[int, slice]]:
    """Return the limbs of a kind with their equations."""
    out, row = [], 0
    for i, limb in enumerate(model.mechanism.limbs):
        rows = slice(row, row + limb.kind.surface.equations)
        row = rows.stop
        if limb.kind.name == kind:
            out.append((i, rows))
    return out


def test_there_is_a_machine_of_every_kind() -> None:
    assert {k.name for k in kinds().values() if k.surface.angles or not k.driven} == set(MACHINES)


@each
@at_both
def test_a_serial_chain_through_the_passive_joints_closes(kind: str, shifted: bool) -> None:
    """Wherever such a chain can stand its conditions hold, and nowhere else: their rank."""
    model, q, _ = sample(kind, shifted)
    mechanism = model.mechanism
    rng = np.random.default_rng(8)
    for i, rows in own_rows(model, kind):
        limb = mechanism.limbs[i]
        u = np.zeros(len(q)) if not limb.driven else model.joint_coordinate(i, q)
        pose = serial_pose(kind, model.limb_values[i], limb.constants, u, rng)
        closure = model.closure(q)
        np.testing.assert_allclose(closure.misclosure(pose)[:, rows], 0.0, rtol=0.0, atol=2e-15)
        singular = np.linalg.svd(closure.pose_matrix(pose)[:, rows], compute_uv=False)
        assert singular.shape[1] == CONDITIONS[kind]
        assert np.all(singular[:, -1] > 1e-2)


@pytest.mark.long_cases(
    "perturbed-UPR", "perturbed-UPU", "nominal-UPR", "nominal-UPU", "nominal-U(P)U",
    "nominal-(R)RPaU", "nominal-U(P)R", "perturbed-UP", "perturbed-(P)RRR")
@each
@at_both
@pytest.mark.slow
def test_derivatives_are_differences(kind: str, shifted: bool) -> None:
    """By pose, joint and every slot, at poses that close and at poses that do not."""
    model, q, closed = sample(kind, shifted)
    every = list(range(len(model.mechanism.parameters)))
    off = displaced(closed, np.array([4e-3, -3e-3, 2e-3, 0.02, -0.03, 0.01]))
    h = 1e-5

    def c(pose: Array, q: Array = q, g: Array = model.parameters) -> Array:
        return Model(model.mechanism, g).closure(q).misclosure(pose)

    for pose in (closed, off):
        closure = model.closure(q, every)
        a = closure.pose_matrix(pose)
        for k in range(6):
            step = h * np.eye(6)[k]
            np.testing.assert_allclose(
                a[..., k], (c(displaced(pose, step)) - c(displaced(pose, -step))) / (2 * h),
                rtol=1e-8, atol=2e-9)
    for k, step in enumerate(h * np.eye(q.shape[1])):
        np.testing.assert_allclose(closure.joint_matrix(closed)[..., k],
                                   (c(closed, q + step) - c(closed, q - step)) / (2 * h),
                                   rtol=1e-8, atol=2e-9)
    by = closure.error_matrix(closed, every)
    for k, step in enumerate(h * np.eye(len(every))):
        g = model.parameters
        np.testing.assert_allclose(
            by[..., k], (c(closed, g=g + step) - c(closed, g=g - step)) / (2 * h), rtol=1e-8,
            atol=2e-9, err_msg=model.mechanism.names[k])


def test_an_angle_is_a_pure_moment_across_both_axes() -> None:
    """(a x b).omega at the lever of one metre, whatever point the platform turns about."""
    model, q, pose = sample("UP", True)
    closure = model.closure(q)
    i, rows = own_rows(model, "UP")[0]
    line = closure.lines(pose)[:, rows.stop - 1]
    rotation, _ = machines.matrices(pose)
    v, c = model.limb_values[i], model.mechanism.limbs[i].constants
    a = machines.chain("D:base.axis J1", v, c, np.zeros(1))[:, :3, 2]
    b = machines.chain("D:platform.axis:platform.direction J2x", v, c, np.zeros(1))[:, :3, 2]
    carried = (rotation @ b[..., None])[..., 0]
    np.testing.assert_array_equal(line[:, :3], 0.0)
    np.testing.assert_allclose(line[:, 3:], np.cross(carried, a), rtol=0.0, atol=1e-15)
    tilted = displaced(pose, np.full(6, 0.02))
    cosine = np.sum(a * (machines.matrices(tilted)[0] @ b[..., None])[..., 0], axis=-1)
    np.testing.assert_allclose(closure.misclosure(tilted)[:, rows.stop - 1], cosine, rtol=0.0,
                               atol=1e-15)


@each
@at_both
def test_forward_undoes_inverse_which_undoes_forward(kind: str, shifted: bool) -> None:
    model, q, pose = sample(kind, shifted)
    found = inverse(model, pose)
    assert found.reached.all()
    np.testing.assert_allclose(found.q, q, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(forward(model, found.q).pose, pose, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("name", "named"), [("tricept", "xyz"), ("3-UPU", "xyz"),
                                             ("mixed-spatial", "xz")])
def test_poses_name_as_many_coordinates_as_there_are_drives(name: str, named: str) -> None:
    mechanism = read_mechanism(CONFIGS / f"{name}.yaml")
    assert mechanism.freedoms == len(named) == len(mechanism.actuators)
    wanted = np.tile(mechanism.home_pose, (3, 1))
    wanted[:, ["xyz".index(c) for c in named]] += 0.03 * np.array([[1.0], [0.0], [-1.0]])
    full = wanted.copy()
    wanted[:, [i for i in range(6) if "xyzabc"[i] not in named]] = np.nan
    found = inverse_partial(Model(mechanism), wanted)
    assert found.reached.all()
    np.testing.assert_allclose(pose_vector(found.pose)[:, [0, 2]], wanted[:, [0, 2]], atol=1e-11)
    full[:, 3] += 0.1
    off = inverse_partial(Model(mechanism), full)
    assert all("off the machine's surface" in r for r in off.reason)


def test_a_passive_limb_has_no_joint_column_and_no_offset() -> None:
    mechanism = read_mechanism(CONFIGS / "tricept.yaml")
    assert mechanism.actuators == ("leg1", "leg2", "leg3")
    assert (mechanism.driven, mechanism.limbs[3].actuator) == ((0, 1, 2), PASSIVE)
    assert (mechanism.equations, mechanism.dependent, mechanism.freedoms) == (6, 3, 3)
    assert not [n for n in mechanism.names if n.startswith("centre.") and "point" not in n
                and "axis" not in n]
    assert home_state(mechanism).roots[3] == 1
    closure = Model(mechanism).closure(home_state(mechanism).q)
    assert closure.joint_matrix(mechanism.home[None]).shape == (1, 6, 3)
    assert not closure.joint_matrix(mechanism.home[None])[:, 3:].any()


def test_a_passive_limb_carries_what_the_drives_do_not() -> None:
    """A side force at the platform is work on no drive where the centre leg holds it upright."""
    mechanism = read_mechanism(CONFIGS / "tricept.yaml")
    model, pose = Model(mechanism), mechanism.home[None]
    q = home_state(mechanism).q[None]
    turn = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 5.0]])     # about the leg: the leg alone holds it
    np.testing.assert_allclose(loads(model, q, pose, turn), 0.0, atol=1e-13)
    wrench = np.array([[30.0, 20.0, -100.0, 1.0, -2.0, 5.0]])
    np.testing.assert_allclose(limb_forces(model, q, pose, wrench).sum(axis=1), wrench[:, :3],
                               rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", FILES)
def test_a_file_reads_back_as_written(name: str) -> None:
    mechanism = read_mechanism(CONFIGS / f"{name}.yaml")
    moved = mechanism.with_values(mechanism.values + 1e-3 * np.arange(mechanism.values.size))
    assert read_text(write_mechanism(mechanism)).nominals.tolist() == mechanism.nominals.tolist()
    for own in (mechanism, moved):
        again = read_text(write_mechanism(own))
        assert again.names == own.names
        q = home_state(mechanism).q
        shift = displaced(mechanism.home[None], np.full(6, 0.01))
        gaps = [Model(m).closure(q).misclosure(shift)[0] for m in (again, own)]
        if name == "mixed-spatial":    # which two directions square to an axis are asked is open
            gaps = [np.append(np.delete(c, [1, 2]), np.hypot(*c[1:3])) for c in gaps]
        np.testing.assert_allclose(*gaps, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("name", FILES)
def test_limbs_are_drawn_closed(name: str) -> None:
    mechanism = read_mechanism(CONFIGS / f"{name}.yaml")
    model = Model(mechanism)
    q, pose = machines.spread(model)
    for limb, drawn in zip(mechanism.limbs, skeleton(model, pose, q), strict=True):
        assert np.max(drawn.gap) < 1e-9
        assert (drawn.drive is not None) == limb.driven
        for joint in drawn.joints:
            assert joint.kind and joint.driven == (f"({joint.kind})" in limb.kind.name
                                                   and joint.number == _driven(limb.kind.name))


def _driven(name: str) -> int:
    return sum(c.isupper() for c in name[:name.index("(") + 2])


@pytest.mark.parametrize(("name", "limb", "actuator"), [("delta-parallelograms", 1, 1),
                                                        ("mixed-spatial", 1, 1)])
def test_the_two_branch_settings_are_the_two_roots(name: str, limb: int, actuator: int) -> None:
    tree = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    q = {}
    for branch in (1, -1):
        tree["limbs"][limb]["branch"] = branch
        mechanism = read_text(yaml.safe_dump(tree))
        q[branch] = home_state(mechanism).q[actuator]
        closed = Model(mechanism).closure(home_state(mechanism).q).lengths(mechanism.home[None])
        assert np.max(np.abs(closed)) < 1e-12
    assert q[1] > q[-1] + 1e-3


def tricept(change: dict[str, object]) -> str:
    tree = yaml.safe_load((CONFIGS / "tricept.yaml").read_text(encoding="utf-8"))
    tree["limbs"][3] |= change
    return yaml.safe_dump(tree)


def refused(text: str) -> tuple[str, str]:
    with pytest.raises(BadInput) as error:
        read_text(text)
    return error.value.what, error.value.hint


def test_what_is_refused_of_drives() -> None:
    what, hint = refused(tricept({"actuator": "leg1"}))
    assert what == "a UP has no drive, but an actuator 'leg1' is given"
    assert hint == "Write `actuator: none`, or leave it out"
    tree = yaml.safe_load((CONFIGS / "tricept.yaml").read_text(encoding="utf-8"))
    tree["limbs"][0]["actuator"] = "none"
    what, hint = refused(yaml.safe_dump(tree))
    assert what == "a U(P)S without its drive leaves open what the drive holds"
    assert "Choose a kind without a drive: UP or UPU or UPR" in hint
    what, _ = refused(tricept({"offset": 3}))
    assert what.startswith("unknown key 'offset'")
    what, _ = refused(tricept({"stiffness": {"drive": 1e5}}))
    assert what.startswith("unknown key 'drive'")


def test_what_is_refused_of_directions() -> None:
    centre = yaml.safe_load(tricept({}))["limbs"][3]
    platform = centre["platform"]
    what, hint = refused(tricept({"platform": platform | {"direction": [0, 0.1, 1]}}))
    assert what.startswith("platform.direction is not perpendicular to platform.axis")
    assert hint == "Give it, at right angles to the axis"
    what, hint = refused(tricept({"platform": platform | {"direction": {
        "value": [0, 0, 1], "tolerance": 0.1}}}))
    assert what == "platform.direction turns with platform.axis and has no 'tolerance' of its own"
    assert hint == "Move it to platform.axis"
    what, _ = refused(tricept({"platform": {"point": [0, 0, 0], "axis": [0, 1, 0]}}))
    assert what == "the direction 'platform.direction' is missing"


def test_what_is_refused_of_machines() -> None:
    tree = yaml.safe_load((CONFIGS / "3-UPU.yaml").read_text(encoding="utf-8"))
    what, hint = refused(yaml.safe_dump(tree | {"motion": "translational", "home": {
        "pose": {"x": 0, "y": 0, "z": 600}}}))
    assert what == ("a U(P)U keeps the platform from turning, but in translational motion it does "
                    "not turn freely anyhow")
    assert hint == "Write `motion: spatial`, or choose another kind"
    what, _ = refused(yaml.safe_dump(tree | {"limbs": tree["limbs"][:2]}))
    assert what == ("the limbs put 4 conditions on the platform, but a pose in spatial motion has "
                    "6 coordinates")
    mixed = yaml.safe_load((CONFIGS / "mixed-spatial.yaml").read_text(encoding="utf-8"))
    carriage = mixed["limbs"][0]
    mixed["limbs"] = [carriage | {"name": name} for name in "abc"]
    del mixed["limits"]
    what, _ = refused(yaml.safe_dump(mixed))
    assert what == (
        "the limbs put 9 conditions on the platform and have 3 drives: the 6 that no drive changes "
        "hold all 6 coordinates of a pose in spatial motion, or some of them twice")
    centre = yaml.safe_load(tricept({}))["limbs"][3]
    only = yaml.safe_load(tricept({}))
    only["limbs"] = [centre | {"name": name} for name in ("one", "two")]
    del only["limits"]
    assert refused(yaml.safe_dump(only))[0] == "no limb has a drive"


def test_limbs_that_hold_the_same_twice_are_refused() -> None:
    """As in an Exechon: two U(P)R on one line keep their hinges square to it three times over."""
    def limb(name: str, x: float) -> dict[str, object]:
        return {"name": name, "kind": "U(P)R", "base": {"point": [x, 0, 0], "axis": [1, 0, 0]},
                "platform": {"point": [x / 3, 0, 0], "axis": [0, 1, 0]}}

    tree = yaml.safe_load((CONFIGS / "mixed-spatial.yaml").read_text(encoding="utf-8"))
    del tree["limits"]
    tree["limbs"] = [limb("one", 300.0), limb("two", -300.0), {
        "name": "three", "kind": "R(P)S", "base": {"point": [0, 250, 0], "axis": [1, 0, 0]},
        "platform": {"point": [0, 80, 0]}}]
    what, hint = refused(yaml.safe_dump(tree))
    assert what == ("the limbs hold the platform twice: 2 of the 5 conditions that no drive "
                    "changes say the same as others at home")
    assert hint.startswith("Leave out limbs, or choose kinds that hold less")


def test_a_redundant_tricept_is_least_squares_that_its_centre_leg_holds() -> None:
    """Four drives for three freedoms: joints that disagree move the platform along its surface."""
    tree = yaml.safe_load((CONFIGS / "tricept.yaml").read_text(encoding="utf-8"))
    fourth = {"name": "leg4", "kind": "U(P)S", "base": {"point": [300, 300, 0]},
              "platform": {"point": [120, 120, 0]}}
    tree["limbs"].insert(3, fourth)
    mechanism = read_text(yaml.safe_dump(tree))
    assert (mechanism.equations, mechanism.surplus, mechanism.freedoms) == (7, 1, 3)
    model = Model(mechanism)
    q = home_state(mechanism).q + 1e-3 * np.array([[1.0, -1.0, 0.5, 0.8]])
    found = forward(model, q)
    closure: Closure = model.closure(q)
    gaps = closure.misclosure(found.pose)[0]
    assert np.max(np.abs(gaps[4:])) < 1e-12 < 1e-4 < np.max(np.abs(gaps[:4]))
    a = closure.pose_matrix(found.pose)[0]
    free = np.linalg.svd(a[4:])[2][3:].T              # what the centre leg lets the platform do
    np.testing.assert_allclose(free.T @ a[:4].T @ gaps[:4], 0.0, atol=1e-11)


def test_home_may_be_told_by_driven_joints_alone() -> None:
    mechanism = read_mechanism(CONFIGS / "tricept.yaml")
    text = (CONFIGS / "tricept.yaml").read_text(encoding="utf-8").replace(
        "rx: 0, ry: 0, rz: 0}}", "rx: 0, ry: 0, rz: 0}, q: {leg1: 939.6276}}")
    assert read_text(text).home_q[0] == pytest.approx(home_state(mechanism).q[0], abs=1e-6)
    assert replace(mechanism, name="other").driven == mechanism.driven
