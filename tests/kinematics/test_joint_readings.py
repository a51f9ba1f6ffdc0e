"""What encoders at the joints of limbs read: in plain NumPy, and derivatives by differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.machines import (
    CASES,
    KINDS,
    OFFSET_JOINTS,
    full,
    joint_coordinates,
    matrices,
    offset_joints,
    plain,
    spread,
)
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.joint_readings import JointReading
from ppmcal.model.instruments import find_instrument
from ppmcal.model.limbs.passive_joints import joints_of
from ppmcal.model.mechanism import Mechanism

Array = NDArray[np.float64]
STEP = 1e-6

MACHINES = {kind: full(kind) for kind in KINDS} | {
    f"{kind} {body}": offset_joints(kind, body, full=True) for kind, body in OFFSET_JOINTS}


def readable(mechanism: Mechanism, limb: int) -> list[str]:
    """Return the joints of a limb that have what they need."""
    own = mechanism.limbs[limb]
    return [f"{own.name}.{name}" for name, joint in joints_of(own.kind).items()
            if (not joint.needs or joint.needs in own.constants)
            and joint.unless not in own.constants]


def displaced(pose: Array, step: Array) -> Array:
    """Return motors (N, 8) after an origin displacement and a turn (6,) in base axes."""
    turn = cga.motor_from_rotation_vector(step[3:], np.zeros(3))
    at = cga.translation(pose)
    about = cga.translator(at + step[:3] - cga.move_point(turn, at))
    return cga.compose(cga.compose(about, np.broadcast_to(turn, pose.shape)), pose)


def value(model: Model, q: Array, pose: Array, at: str) -> Array:
    return JointReading(model.closure(q), pose, at).value


@pytest.mark.slow_cases(
    "(P)RR", "P(R)R", "(R)RP", "(P)RP", "(P)PR", "(R)US", "U(P)S base", "(P)US platform",
    "(R)US base", "(R)US platform", "(P)US base", "(R)PR", "(R)RR", "R(P)R", "R(P)S", "R(R)R")
@pytest.mark.parametrize("name", MACHINES)
def test_derivatives_are_those_of_differences(name: str) -> None:
    mechanism = MACHINES[name]
    model = Model(mechanism)
    q, pose = spread(model, 4)
    # off the closure too: each derivative is at a platform that is held
    pose = displaced(pose, np.array([1e-3, -2e-3, 0.0, 0.0, 0.0, 1e-3]))
    closure = model.closure(q, range(len(mechanism.parameters)))
    shifted = [[Model(mechanism, mechanism.values + step).closure(q) for step in (ahead, -ahead)]
               for ahead in STEP * np.eye(len(mechanism.values))]
    for at in [*readable(mechanism, 0), *readable(mechanism, 1)]:
        found = JointReading(closure, pose, at)
        for c in mechanism.dof:
            step = STEP * np.eye(6)[c]
            by = (value(model, q, displaced(pose, step), at)
                  - value(model, q, displaced(pose, -step), at)) / (2.0 * STEP)
            np.testing.assert_allclose(found.by_pose[:, c], by, atol=2e-8, rtol=2e-7)
        columns = closure.columns[found.limb]
        by_parameters = found.by_parameters(columns, closure.slots[found.limb])
        for place, p in enumerate(columns):
            ends = [JointReading(other, pose, at).value for other in shifted[p]]
            np.testing.assert_allclose(by_parameters[:, place], (ends[0] - ends[1]) / (2.0 * STEP),
                                       atol=2e-8, rtol=1e-6, err_msg=mechanism.names[p])
        for a in range(q.shape[1]):
            step = STEP * np.eye(q.shape[1])[a]
            by = (value(model, q + step, pose, at) - value(model, q - step, pose, at)) / (
                2.0 * STEP)
            np.testing.assert_allclose(found.by_joint[:, a], by, atol=2e-8, rtol=1e-6)


def heading(v: Array) -> Array:
    return np.arctan2(v[..., 1], v[..., 0])


def of_the_table(kind: str, v: dict[str, float], u: Array, pose: Array) -> dict[str, Array]:
    """Return the passive joints' readings of a planar limb, with the contract's letters."""
    rotation, origin = matrices(pose)
    a = np.array([v["base.point.x"], v["base.point.y"], 0.0])
    b = origin + rotation @ np.array([v["platform.point.x"], v["platform.point.y"], 0.0])
    rz = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    psi, alpha = rz + v.get("platform.angle", 0.0), v.get("base.angle", 0.0)
    sigma, lateral = v.get("slide_angle", 0.0), v.get("lateral", 0.0)
    p, distal, length = v.get("proximal", 0.0), v.get("distal", 0.0), v.get("length", 0.0)

    def d(angle: Any) -> Array:
        return np.stack(np.broadcast_arrays(np.cos(angle), np.sin(angle), 0.0), axis=-1)

    def along(x: Array, angle: Any) -> Array:
        return np.sum(x * d(angle), axis=-1)

    ab, ur = b - a, u[:, None]
    one = {"R(P)R": lambda: heading(ab) - np.arctan2(lateral, u),
           "(R)RR": lambda: heading(ab - p * d(u)) - u,
           "R(R)R": lambda: heading(ab) - np.arctan2(distal * np.sin(u), p + distal * np.cos(u)),
           "(P)RR": lambda: heading(ab - ur * d(alpha)) - alpha,
           "(R)PR": lambda: along(ab, u), "P(R)R": lambda: along(ab - length * d(alpha + u), alpha),
           "(P)PR": lambda: along(ab - ur * d(alpha), alpha + sigma),
           "P(P)R": lambda: along(ab - ur * d(alpha + sigma), alpha),
           "(R)RP": lambda: psi - u, "R(R)P": lambda: psi - u, "R(P)P": lambda: psi - sigma,
           "(P)RP": lambda: psi - alpha}[kind]()
    # how the link that ends at the platform lies in the base: what is left is the last joint's
    link = {"R(P)R": lambda: one, "(R)RR": lambda: u + one, "R(R)R": lambda: one + u,
            "(P)RR": lambda: alpha + one, "(R)PR": lambda: u, "P(R)R": lambda: alpha + u,
            "(P)PR": lambda: alpha + sigma, "P(P)R": lambda: alpha + sigma}
    if kind in link:
        return {"first": one, "last": psi - link[kind]()}
    foot = {"(R)RP": lambda: p * d(u), "R(R)P": lambda: p * d(one),
            "R(P)P": lambda: ur * d(one), "(P)RP": lambda: ur * d(alpha)}[kind]()
    return {"first": one, "last": along(ab - foot, psi)}


@pytest.mark.parametrize("kind", [k for k in KINDS if CASES[k].motion == "planar"])
def test_planar_joints_in_plain_numpy(kind: str) -> None:
    mechanism = plain(kind)
    model = Model(mechanism)
    q, pose = spread(model, 6)
    for i, limb in enumerate(mechanism.limbs):
        u = joint_coordinates(model, q)[i]
        wanted = of_the_table(kind, limb.slots.values(model.parameters), u, pose)
        joints = joints_of(limb.kind)
        passive = [n for n, j in joints.items() if j.read is not None]
        driven = next(n for n, j in joints.items() if j.read is None)
        assert len(joints) == 3
        np.testing.assert_array_equal(value(model, q, pose, f"{limb.name}.{driven}"), u)
        for name, own in zip(passive, ("first", "last"), strict=True):
            away = value(model, q, pose, f"{limb.name}.{name}") - wanted[own]
            if joints[name].quantity == "angle":
                away = np.angle(np.exp(1j * away))
            np.testing.assert_allclose(away, 0.0, atol=1e-12)


@pytest.mark.parametrize("kind", ["U(P)S", "(P)US", "(R)US"])
def test_first_axes_of_universal_joints_in_plain_numpy(kind: str) -> None:
    """Steps of the reading are those of the rod's direction about the axis."""
    mechanism = offset_joints(kind, "base")
    model = Model(mechanism)
    q, pose = spread(model, 6)
    rotation, origin = matrices(pose)
    for i, limb in enumerate(mechanism.limbs):
        v, c = limb.slots.values(model.parameters), limb.constants
        u = joint_coordinates(model, q)[i][:, None]
        a, b = (np.array([v[f"{end}.point.{x}"] for x in "xyz"]) for end in ("base", "platform"))
        axis, foot, turned = c["base.axis"], a, 0.0
        if kind == "(P)US":
            foot = a + u * c["base.direction"]
        if kind == "(R)US":
            zero = c["base.zero"]
            foot = a + v["proximal"] * (np.cos(u) * zero + np.sin(u) * np.cross(axis, zero))
            turned = u[:, 0]
        away = origin + rotation @ b - foot
        x = np.eye(3)[np.argmin(np.abs(axis))]
        x = x - (x @ axis) * axis
        x /= np.linalg.norm(x)
        angle = np.arctan2(away @ np.cross(axis, x), away @ x) - turned
        name = "joint1" if kind == "U(P)S" else "joint2"
        read = value(model, q, pose, f"{limb.name}.{name}")
        step = np.angle(np.exp(1j * ((read - read[0]) - (angle - angle[0]))))
        np.testing.assert_allclose(step, 0.0, atol=1e-11)


def test_the_hinge_of_a_tripod_in_plain_numpy() -> None:
    mechanism = plain("R(P)S")
    model = Model(mechanism)
    q, pose = spread(model, 6)
    rotation, origin = matrices(pose)
    limb = mechanism.limbs[1]
    v, axis = limb.slots.values(model.parameters), limb.constants["base.axis"]
    away = origin + rotation @ np.array([v[f"platform.point.{x}"] for x in "xyz"]) - np.array(
        [v[f"base.point.{x}"] for x in "xyz"])
    x = np.cross(axis, away[0])
    angle = np.arctan2(away @ np.cross(axis, x), away @ x)
    read = value(model, q, pose, "leg2.joint1")
    np.testing.assert_allclose(read - read[0], angle - angle[0], atol=1e-12)


def test_joints_that_there_are() -> None:
    joint = find_instrument("joint")
    planar, hexapod = plain("R(P)R"), plain("U(P)S")
    at = joint.located("leg1.joint3", planar, "a.yaml")
    assert (at.at, at.quantity, at.labels(planar.motion)) == (
        "leg1.joint3", "angle", ("turn_leg1.joint3",))
    drive = joint.located("leg2.joint2", hexapod, "a.yaml")
    assert (drive.quantity, drive.labels(hexapod.motion)) == ("length", ("slide_leg2.joint2",))
    assert joint.located("leg2.joint2", hexapod, "b.yaml") is drive
    for at_, machine, said, hint in (
            ("leg1.joint4", planar, r"leg1, of kind R\(P\)R, has no joint 'joint4'",
             r"leg1.joint1 \(R\), leg1.joint2 \(P, driven\), leg1.joint3 \(R\)"),
            ("leg9.joint1", planar, "unknown joint 'leg9.joint1'", "leg1.joint1"),
            (None, planar, "the joint that the encoder is at is missing", "at: leg1.joint1"),
            ("leg1.joint3", hexapod, "no joint 'joint3'", "leg1.joint1"),
            ("leg1.joint2", offset_joints("(R)US", "platform"), "is a ball", "another joint"),
            ("leg1.joint1", hexapod, "does not give the direction of its first axis", "base.axis")):
        with pytest.raises(BadInput, match=said) as told:
            joint.located(at_, machine, "a.yaml")
        assert told.match(hint)
        assert told.match(r"a.yaml: instrument.at")
    with pytest.raises(BadInput, match="the instrument 'pose' is not at a joint"):
        find_instrument("pose").located("leg1.joint1", planar, "a.yaml")
