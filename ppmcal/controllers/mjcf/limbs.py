"""Limbs as MJCF has them: fixed offsets and joints, one after another, from a body to a body.

The chains of a limb are walked step by step, their drive is a joint, everything else is where the
next body stands. Which passive joints lie between them is not in the chains: it follows from the
surface that they make (:data:`PASSIVE`), so a kind of a known surface needs nothing here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import ChainStep, Values
from ppmcal.model.limbs.kind import LimbKind
from ppmcal.model.limbs.surfaces import SPHERE

AXES = dict(zip("xyz", np.eye(3), strict=True))
FLAT = 1e-12
"""Parts keep to the plane where they leave it by less, m."""
QUARTER = cga.motor_from_rotation_vector(np.array([-0.5 * np.pi, 0.0, 0.0]), np.zeros(3))
"""The turn that makes what was y the new z, and leaves x."""


@dataclass(frozen=True)
class PassiveJoints:
    """The joints of a limb that no step of its chains is, as words, in their order.

    ``Rz`` is a hinge about, ``Px`` a slide along a local axis, ``B`` a ball, ``T`` the fixed
    :data:`QUARTER` turn, ``-Ry`` a hinge that turns back what the first ``Ry`` turned.

    Attributes:
        start: between the base's chain and the middle one; end: between that and the platform.
        held: axes of the last body that keep to the platform's; without any the last two bodies
            share a point.
        said: how this differs from the joints of the limb, empty where it does not.
    """

    start: str
    end: str = ""
    held: str = ""
    said: str = ""


PASSIVE = {
    "sphere": PassiveJoints("B"),
    "circle": PassiveJoints("Rz"),
    "base plane": PassiveJoints("Px"),
    "platform plane": PassiveJoints("Rz", "Px", "x"),
    "sphere and angle": PassiveJoints(
        "Rz Ry", "-Ry Rz T", "z", "a parallelogram is a rod on two hinges, of which the second "
        "turns back what the first turned"),
    "base plane and direction": PassiveJoints(
        "Px Py", "", "z", "three parallel hinges are two slides: no file says how long their bars "
        "are"),
    "sphere, platform plane and angle": PassiveJoints("Rz T Rz", "", "z"),
    "platform plane and angle": PassiveJoints("Rz T Rz Px", "", "z"),
    "line of the platform and angle": PassiveJoints("Rz T Rz", "Px", "zx"),
    "sphere between axes": PassiveJoints("Rz Ry", "Ry", "z"),
    "between axes": PassiveJoints("Rz Ry Pz", "Ry", "z"),
}
"""By closure family (:mod:`ppmcal.model.limbs.surfaces`)."""
IN_PLANE = {"sphere": PassiveJoints("Rz")}
UNIVERSAL = PassiveJoints("")
"""Of a limb whose U, axes apart, is on the base: its hinges stand on both sides of their arm."""
HANGING = PassiveJoints("B", "", "z")
"""Of one whose U, axes apart, is on the platform: the rod keeps square to its second axis."""


@dataclass(frozen=True)
class BodyJoint:
    """One joint: ``kind`` is hinge, slide or ball, ``axis`` (3,) in the axes of its body.

    ``driven``: by the limb's drive; ``back``: it turns back what the first other hinge about its
    axis turned.
    """

    kind: str
    axis: Array
    driven: bool = False
    back: bool = False


Part = Array | BodyJoint
"""A fixed motor (8,), or a joint."""


@dataclass(frozen=True)
class LimbParts:
    """A limb between base and platform.

    Attributes:
        base: parts from the base on; the loop is closed behind the last.
        platform: parts from the platform on, to what is on the other side of that.
        held: as in :class:`PassiveJoints`; said: likewise.
        rope: whether nothing but a rope is in between.
    """

    base: tuple[Part, ...]
    platform: tuple[Part, ...]
    held: str
    said: str
    rope: bool


def parts_of(kind: LimbKind, values: Values) -> LimbParts:
    """Return a limb of slots and directions ``values``, SI, at u = 0.

    Raises:
        BadInput: nothing is known of the joints of its surface, a planar limb leaves its plane, or
            a rope goes over something on its way.
    """
    passive = (IN_PLANE if kind.planar else {}).get(kind.surface.name) or PASSIVE.get(
        kind.surface.name)
    if kind.pulls_only and kind.surface is not SPHERE:
        raise BadInput(f"a {kind.name} is no tendon from a point to a point", "",
                       "Export `grid`: what lies on the pulley would have to wrap about a body")
    if passive is None:
        raise BadInput(f"the passive joints of limb kind '{kind.name}' are not known: its closure "
                       f"family is '{kind.surface.name}'", "", "Export `grid`")
    base = _apart(kind.base.steps, values)
    platform = _apart(kind.platform.steps, values)
    if kind.pulls_only:
        return LimbParts((*base,), (*platform,), "", "", True)
    if _offset(kind.base.steps, values):
        passive = UNIVERSAL
    elif _offset(kind.platform.steps, values):
        passive = HANGING
    out = LimbParts((*base, *_joints(passive.start), *_walk(kind.middle.steps, values),
                     *_joints(passive.end)), (*platform,), passive.held, passive.said, False)
    if kind.planar and not all(_in_plane(part) for part in (*out.base, *out.platform)):
        raise BadInput("a joint of a planar limb is tilted or lifted out of the plane, where the "
                       "hinges of bodies do not close", "", "Export `grid`, or hold the "
                       "joints' z, rx and ry")
    return out


def _in_plane(part: Part) -> bool:
    """Return whether a fixed part keeps z, and does not tilt it."""
    return isinstance(part, BodyJoint) or bool(
        abs(cga.translation(part)[2]) < FLAT and abs(cga.rotation_matrix(part)[2, 2] - 1.0) < FLAT)


def _joints(words: str) -> Iterator[Part]:
    for word in words.split():
        if word == "T":
            yield QUARTER
        elif word == "B":
            yield BodyJoint("ball", AXES["z"])
        else:
            yield BodyJoint("hinge" if "R" in word else "slide", AXES[word[-1]],
                            back=word[0] == "-")


def _offset(steps: Sequence[ChainStep], values: Values) -> bool:
    """Return whether a chain ends in a universal joint whose axes do not meet."""
    last = steps[-1] if steps else None
    return last is not None and bool(last.needs) and bool(
        np.any(values.get(last.slots[0].name, 0.0)))


def _apart(steps: Sequence[ChainStep], values: Values) -> Iterator[Part]:
    """Yield a chain; one that ends in such a joint with its hinges on both sides of the arm."""
    if not _offset(steps, values):
        yield from _walk(steps, values)
        return
    straight = {**values, steps[-1].needs: 0.0}
    yield from _walk(steps[:-1], straight)
    yield from _joints("Rz")
    yield from _walk(steps[-1:], straight)
    yield from _joints("Ry")


def _walk(steps: Sequence[ChainStep], values: Values) -> Iterator[Part]:
    """Yield the steps that this limb has."""
    for step in steps:
        if step.needs and step.needs not in values:
            continue
        if step.drive:
            twist = np.asarray(step.twists(values)[0][1], dtype=float).reshape(6)
            turns = bool(np.any(twist[:3]))
            yield BodyJoint("hinge" if turns else "slide", twist[:3] if turns else twist[3:], True)
        else:
            yield np.asarray(step.motor(values), dtype=float).reshape(8)


def moved(joint: BodyJoint, by: Any) -> Array:
    """Return the motor (8,) of a joint: ``by`` rad, m, or for a ball a rotation matrix (3, 3)."""
    if joint.kind == "ball":
        return cga.motor_from_matrix(np.asarray(by, dtype=float), np.zeros(3))
    if joint.kind == "hinge":
        return cga.motor_from_rotation_vector(float(by) * joint.axis, np.zeros(3))
    return cga.translator(float(by) * joint.axis)
