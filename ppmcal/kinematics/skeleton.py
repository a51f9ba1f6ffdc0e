"""Positions of every joint and bar of a machine, for drawings to scale.

The chains of a limb are followed step by step. The passive joints between the chains
follow from the limb's surface: a point on a sphere turns the middle chain towards the
platform, a point on a plane of the base slides it along, a plane of the platform turns
it with the platform. So a new kind of limb is drawn from its declaration.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array
from ppmcal.model.limbs import LimbKind
from ppmcal.model.limbs.chain import Chain, ChainStep, U, Values

GUIDE = "slide"
"""Name of a passive slide among the links of a limb."""
FOLD = "hinged bars"
"""Name of what passive hinges with parallel axes span, whose bars are in no slot."""


@dataclass(frozen=True)
class PlacedJoint:
    """One joint of a limb in N poses.

    Attributes:
        number: from the base, starting at 1; kind: R, P, U, S or Pa, empty if its name has none.
        driven: whether the actuator moves it.
        centre: (N, 3), m, base axes.
        axis: unit direction of its own z axis (N, 3): hinge or slide; meaningless for U and S.
    """

    KEYS: ClassVar = ("number", "kind", "driven")

    number: int
    kind: str
    driven: bool
    centre: Array
    axis: Array


@dataclass(frozen=True)
class Link:
    """A straight piece of a limb in N poses, from ``start`` to ``end`` (N, 3), m, base axes.

    ``name`` is the slot of its length, ``u`` for a driven slide, :data:`GUIDE` for a passive
    one, :data:`FOLD` between hinges, ``joint2`` for the frame error of a joint.
    """

    KEYS: ClassVar = ("name", "role")

    name: str
    start: Array
    end: Array

    @cached_property
    def role(self) -> str:
        """``bar``, ``drive`` (a driven slide) or ``guide`` (a passive one)."""
        return {U: "drive", GUIDE: "guide"}.get(self.name, "bar")


@dataclass(frozen=True)
class Drive:
    """The driven joint in N poses, in base axes.

    Attributes:
        prismatic: whether it slides.
        u: joint coordinate (N,), m or rad.
        centre: of the joint at u = 0 for a slide, of the crank for a hinge (N, 3), m.
        axis: unit direction along which, or about which, u grows (N, 3).
        zero: end of the next piece at u = 0 (N, 3), m; the centre for a slide.
    """

    prismatic: bool
    u: Array
    centre: Array
    axis: Array
    zero: Array


@dataclass(frozen=True)
class LimbSkeleton:
    """One limb in N poses.

    Attributes:
        name, kind: of the limb.
        base_point, platform_point: its attachment points (N, 3), m, base axes.
        joints: from the base on; links: each begins at the end of the previous one, from the base's
            joint to the platform's point.
        drive: its driven joint, None if no step is marked as driven.
        gap: distance between the ends of both sides (N,), m; round-off at a closed pose.
        ends: of the base's side and of the platform's, between which the gap is (N, 3) each, m.
    """

    name: str
    kind: str
    base_point: Array
    platform_point: Array
    joints: tuple[PlacedJoint, ...]
    links: tuple[Link, ...]
    drive: Drive | None
    gap: Array
    ends: tuple[Array, Array]

    @property
    def polyline(self) -> Array:
        """The limb as one line (N, K + 1, 3) of its K links, m."""
        first = self.links[0].start if self.links else self.base_point
        return np.stack([first, *(link.end for link in self.links)], axis=1)


@dataclass(frozen=True)
class _Placed:
    """One step of a chain, with the motors (N, 8) to base axes before and after it."""

    step: ChainStep
    before: Array
    after: Array


def skeleton(model: Model, pose: Array, q: Array) -> tuple[LimbSkeleton, ...]:
    """Return every limb's joints and links.

    Args:
        model: the machine at its parameters, without effects.
        pose: platform-to-base motors (N, 8).
        q: joint values (N, k), SI.
    """
    pose, q = np.atleast_2d(pose), np.atleast_2d(np.asarray(q, dtype=float))
    return tuple(_limb(model, i, pose, q) for i in range(len(model.mechanism.limbs)))


def _limb(model: Model, index: int, pose: Array, q: Array) -> LimbSkeleton:
    limb = model.mechanism.limbs[index]
    kind, values = limb.kind, dict(model.limb_values[index])
    if limb.driven:
        values[U] = model.joint_coordinate(index, q)
    values |= kind.turn(values, pose)
    base = _walk(kind.base, values, np.broadcast_to(cga.identity_motor(), pose.shape))
    platform = _walk(kind.platform, values, pose)
    reach = _motors(kind.middle.evaluate(values, ())[0], len(pose))
    start = base[-1].after
    root, spanned = _middle_root(kind, values, start, platform[-1].after, reach)
    guide = [Link(spanned, cga.translation(start), cga.translation(root))] if spanned else []
    middle = _walk(kind.middle, values, root)
    steps = [*base[1:], *middle]
    links = _links(base[1:], values) + guide + _links(middle, values)
    end = _end(middle, root)
    held = cga.translation(platform[-1].after)
    if not kind.surface.point_moves[0]:
        axes, foot = cga.rotation_matrix(platform[-1].after), end
        for along in (axes[..., :, k] for k in _free_axes(kind, "platform plane")):
            foot = foot + np.sum((held - end) * along, axis=-1, keepdims=True) * along
        links, end = [*links, Link(GUIDE, end, foot)], foot
    back = [Link(p.name, p.end, p.start) for p in reversed(_links(platform[1:], values))]
    return LimbSkeleton(limb.name, kind.name, cga.translation(base[0].after),
                        cga.translation(platform[0].after),
                        _joints(kind, values, [*steps, *platform[1:]]),
                        tuple(links + back), _drive(kind, values, steps),
                        np.linalg.norm(held - end, axis=-1), (end, held))


def _walk(chain: Chain, values: Values, root: Array) -> list[_Placed]:
    """Return the steps of a chain that this limb has, placed from ``root`` (N, 8) on."""
    out, total = [], np.asarray(root)
    for step in chain.steps:
        if step.needs and step.needs not in values:
            continue
        after = cga.compose(total, _motors(step.motor(values), len(total)))
        out.append(_Placed(step, total, after))
        total = after
    return out


def _motors(motor: Array, count: int) -> Array:
    return np.array(np.broadcast_to(motor, (count, 8)))


def _end(placed: list[_Placed], root: Array) -> Array:
    return cga.translation(placed[-1].after if placed else root)


def _middle_root(kind: LimbKind, values: Values, start: Array, held: Array, middle: Array
                 ) -> tuple[Array, str]:
    """Return the start of the middle chain (N, 8), and the name of what passive joints span to it.

    Args:
        kind: of the limb.
        values: its slots.
        start: end of the base chain (N, 8), base axes.
        held: end of the platform chain (N, 8), base axes.
        middle: the middle chain (N, 8).
    """
    if not kind.surface.point_moves[0]:
        turn = cga.rotation_matrix(held) @ np.swapaxes(cga.rotation_matrix(middle), -1, -2)
        return cga.motor_from_matrix(turn, cga.translation(start)), ""
    reach = cga.translation(middle)
    wanted = cga.move_point(cga.reverse(start), cga.translation(held))
    sphere = bool(np.any(kind.evaluate(values).radius[..., 0] > 0.0))
    if not sphere:
        along = _free_axes(kind, "base plane")
        away = (wanted - reach) * np.isin(np.arange(3), along)
        return cga.compose(start, cga.translator(away)), FOLD if len(along) == 2 else GUIDE
    turn = np.zeros_like(wanted)
    hinged = kind.surface.equations > 1 and not kind.surface.angles
    if kind.planar or hinged:
        # a hinge about local z: the plane, or a second equation, leaves no other turn
        turn[:, 2] = (np.arctan2(wanted[:, 1], wanted[:, 0]) - np.arctan2(reach[:, 1], reach[:, 0]))
    hinge = cga.motor_from_rotation_vector(turn, np.zeros(3))
    if hinged:
        return cga.compose(start, hinge), ""
    rest = _shortest_turn(cga.move_point(hinge, reach), wanted)
    return cga.compose(cga.compose(start, rest), hinge), ""


def _free_axes(kind: LimbKind, plane: str) -> list[int]:
    """Return the local axes along which passive joints move, in planes of that form or in space."""
    if kind.planar or not kind.surface.forms:
        return [0]
    return [k for k in range(3) if k not in {f.axis for f in kind.surface.forms
                                             if f.name == plane}]


def _shortest_turn(a: Array, b: Array) -> Array:
    """Return rotors (N, 8) that carry the direction of ``a`` (N, 3) onto that of ``b``."""
    normal = np.cross(a, b)
    sine, cosine = np.linalg.norm(normal, axis=-1, keepdims=True), np.sum(a * b, -1, keepdims=True)
    # straight back: about any axis perpendicular to a
    other = np.cross(a, np.eye(3)[np.argmin(np.abs(a), axis=-1)])
    axis = np.where(sine > 0.0, normal, np.where(cosine < 0.0, other, 0.0))
    size = np.linalg.norm(axis, axis=-1, keepdims=True)
    vector = np.arctan2(sine, cosine) * axis / np.where(size > 0.0, size, 1.0)
    return cga.motor_from_rotation_vector(vector, np.zeros(3))


def _links(placed: list[_Placed], values: Values) -> list[Link]:
    """Return the pieces spanned by steps, including a driven slide at u = 0."""
    out: list[Link] = []
    for p in placed:
        if _slides(p.step, values) or np.any(cga.translation(p.step.motor(values)) != 0.0):
            slot = p.step.slots[0].name if p.step.slots else U
            out.append(Link(slot.split(".")[0] if p.step.joint else slot,
                            cga.translation(p.before), cga.translation(p.after)))
    return out


def _slides(step: ChainStep, values: Values) -> bool:
    """Return whether a step is a driven slide."""
    return step.drive and not np.any(np.asarray(step.twists(values)[0][1])[..., :3])


def _joints(kind: LimbKind, values: Values, steps: list[_Placed]) -> tuple[PlacedJoint, ...]:
    """Return the joints, with their letters in the kind's name."""
    letters = re.findall(r"\(?[A-Z]a?\)?", kind.name)
    out = []
    for p in (p for p in steps if p.step.joint):
        number = int(p.step.slots[0].name.partition(".")[0].removeprefix("joint"))
        letter = letters[number - 1] if number <= len(letters) else ""
        # the last of its slots is the rotation about its own z axis
        own = np.asarray(dict(p.step.twists(values))[p.step.slots[-1].name], dtype=float)[..., :3]
        out.append(PlacedJoint(number, letter.strip("()"), "(" in letter,
                               cga.translation(p.after), _turned(p.before, own)))
    return tuple(out)


def _turned(motor: Array, direction: Array) -> Array:
    return np.asarray((cga.rotation_matrix(motor) @ direction[..., None])[..., 0], dtype=float)


def _drive(kind: LimbKind, values: Values, steps: list[_Placed]) -> Drive | None:
    """Return the driven step, with where the limb would continue at u = 0."""
    for place, p in enumerate(steps):
        if not p.step.drive:
            continue
        twist = np.asarray(p.step.twists(values)[0][1], dtype=float)
        slides = _slides(p.step, values)
        own = twist[..., 3:] if slides else twist[..., :3]
        axis, centre = _turned(p.before, own), cga.translation(p.before)
        size = np.linalg.norm(axis, axis=-1, keepdims=True)
        if kind.pulley:     # as if the rope on the pulley continued straight
            centre = cga.translation(p.after) - np.asarray(values[U])[:, None] * axis
        zero = centre
        for following in steps[place + 1:]:
            # without the drive's own motion
            ahead = cga.compose(cga.reverse(p.after), following.after)
            zero = cga.translation(cga.compose(p.before, ahead))
            if np.any(np.linalg.norm(zero - centre, axis=-1) > 1e-9):
                break
        return Drive(slides, values[U], centre, axis / np.where(size > 0.0, size, 1.0),
                     centre if slides else zero)
    return None
