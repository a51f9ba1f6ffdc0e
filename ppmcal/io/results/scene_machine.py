"""The parts of a scene, in file units, and one machine at every pose of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.codec import in_units
from ppmcal.io.pose_fields import factors
from ppmcal.io.results.record import Finite, Flag, Part, Text, Whole
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import smallest_singular_value
from ppmcal.kinematics.inverse import home_attempt, to_joint
from ppmcal.kinematics.limb_roots import limb_roots, nearest_joint
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.skeleton import LimbSkeleton, Link, PlacedJoint, skeleton
from ppmcal.kinematics.transmission import interferences, transmissions_at
from ppmcal.linalg import Array, Bools
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Length, OfUnit
from ppmcal.wording import number

Point = tuple[Finite, Finite, Finite]


def point_of(vector: Array) -> Point:
    """Return an array (3,) as a point."""
    x, y, z = vector.tolist()
    return x, y, z


class SceneLimb(Part):
    """One limb; ``travel``: the ends of a driven slide by its limits, where it has both."""

    name: Text
    kind: Text
    actuator: Text
    unit: Text
    joints: tuple[PlacedJoint, ...]
    links: tuple[Link, ...]
    slides: Flag
    travel: tuple[Finite, Finite] | None = None


class PlacedLimb(Part):
    """One limb at one pose, base axes: what is named in :class:`SceneLimb`, in its order.

    ``links`` hold start and end; ``drive`` is the centre of the driven
    joint, ``drive_axis`` the direction in which or about which it grows, ``zero`` where the next
    piece ends at u = 0; ``u`` is the joint coordinate, in units of length or angle; ``gap`` by how
    much the limb does not close, between ``gap_ends``, null where it does.
    """

    base: Length[Point]
    platform: Length[Point]
    joints: Length[tuple[Point, ...]]
    links: Length[tuple[tuple[Point, Point], ...]]
    drive: Length[Point | None] = None
    drive_axis: Point | None = None
    zero: Length[Point | None] = None
    u: OfUnit[Finite | None] = None
    gap: Length[Finite] = 0.0
    gap_ends: Length[tuple[Point, Point] | None] = None


QUIET = ("shared", "touching")
"""Marks of two joints in one place, or two links that touch, by design or by a mistake: their text
is the limbs."""


class SceneMark(Part):
    """What needs a look at one pose: limbs, words, and the places where it is.

    ``kind``: ``gap``, ``stretched``, ``singular``, ``travel``, ``joints``, ``links``; and those of
    :data:`QUIET`.
    """

    kind: Text
    limbs: tuple[Whole, ...] = ()
    text: Text
    points: Length[tuple[Point, ...]] = ()


class SceneFrame(Part):
    """The machine at one pose: label, coordinates and joint values as the file has them.

    ``origin`` and ``axes`` are those of the platform, x, y and z, in base axes; ``key``: the
    measured row, where it is one's; ``marks``: what needs a look there.
    """

    label: Text
    pose: tuple[Finite, ...]
    q: tuple[Finite, ...]
    origin: Length[Point]
    axes: tuple[Point, Point, Point]
    limbs: tuple[PlacedLimb, ...]
    key: Text = ""
    marks: tuple[SceneMark, ...] = ()


class SceneMachine(Part):
    """One machine at every pose of the scene; ``outline``: the order of its platform's points.

    ``other``: at home each limb as a line on its other branch, empty where it has none.
    """

    name: Text
    limbs: tuple[SceneLimb, ...]
    base_outline: tuple[Whole, ...]
    platform_outline: tuple[Whole, ...]
    frames: tuple[SceneFrame, ...]
    other: tuple[tuple[Point, ...], ...] = ()


class MeasuredPose(Part):
    """A measured row: where it is, a value to colour by, and its error, not magnified.

    ``value`` and ``error`` are those after the fit, ``value_before`` and ``error_before`` those
    before it; ``turn``, ``turn_before``: errors of rotation. ``key``: of the row on the page;
    ``used``: not left out, or else for which ``reason``. ``frame``: the pose among the drawn ones
    that is nearest, ``own`` whether it is the row's.
    """

    label: Text
    point: Point
    key: Text = ""
    value: Finite | None = None
    error: Point | None = None
    value_before: Finite | None = None
    error_before: Point | None = None
    turn: Finite | None = None
    turn_before: Finite | None = None
    used: Flag = True
    reason: Text = ""
    frame: Whole | None = None
    own: Flag = False


class SceneEffect(Part):
    """An effect and where it sits: ``limbs``, or ``body``: base, platform, instrument."""

    name: Text
    text: Text
    limbs: tuple[Whole, ...] = ()
    body: Text = ""


# ---- one machine at every pose


THICKNESS = 0.01
"""A link is drawn so thick, in parts of the reach."""
STRETCHED = 0.05
"""A limb is marked where its transmission is below this: 3 degrees from straight."""
TOUCHING = 1e-9
"""Limbs nearer than this part of the reach have a point in common, to round-off."""
SINGULAR = 0.02
"""A machine is marked where its smallest singular value is below this, as at home by `check`."""


def pose_marks(model: Model, pose: Array, q: Array, limbs: Sequence[LimbSkeleton], gap: Array
               ) -> list[tuple[SceneMark, ...]]:
    """Return what needs a look at each of N poses.

    Args:
        model: the machine at its parameters.
        pose: platform-to-base motors (N, 8).
        q: joint values (N, k), SI.
        limbs: where they stand.
        gap: a limb with more than this between its ends does not close (N,), m.
    """
    out: list[list[SceneMark]] = [[] for _ in range(len(q))]
    units = model.mechanism.units
    for i, limb in enumerate(limbs):
        for n in np.flatnonzero(limb.gap > gap):
            out[n].append(SceneMark.filled(
                None, units, kind="gap", limbs=(i,),
                points=[(limb.ends[0][n] + limb.ends[1][n]) / 2],
                text=f"{limb.name} does not close: {units.words(limb.gap[n], 'length')} are "
                     "missing"))
    _singular(model, pose, q, out)
    _beyond_travel(model, q, limbs, out)
    _too_near(model, limbs, out)
    return [tuple(marks) for marks in out]


def _singular(model: Model, pose: Array, q: Array, out: list[list[SceneMark]]) -> None:
    """Add the limbs that are stretched, folded or square to their rail, then the machine."""
    mechanism = model.mechanism
    with np.errstate(invalid="ignore", divide="ignore"):
        value = transmissions_at(model, pose, q)[0]
        whole = smallest_singular_value(model.closure(q), pose)[0]
    for n, i in np.argwhere(value < STRETCHED).tolist():
        limb = mechanism.limbs[i]
        how = ("stands square to its rail" if limb.kind.actuator == "length"
               else "is stretched out or folded")
        out[n].append(SceneMark(kind="stretched", limbs=(i,), text=(
            f"{limb.name} {how}: near a dead point, where its joint no longer moves the platform "
            f"(transmission {number(value[n, i], 2)}, 1 at best)")))
    for n in np.flatnonzero(whole < SINGULAR).tolist():
        if not any(m.kind in ("stretched", "gap") for m in out[n]):
            out[n].append(SceneMark(kind="singular", text=(
                "near a singularity: the drives do not hold the platform (smallest singular value "
                f"{number(float(whole[n]), 2)}, a sound machine has 0.1 to 1)")))


def _beyond_travel(model: Model, q: Array, limbs: Sequence[LimbSkeleton],
                   out: list[list[SceneMark]]) -> None:
    mechanism = model.mechanism
    low, high = mechanism.limits.T
    for n, a in np.argwhere((q < low) | (q > high)).tolist():
        factor, unit = mechanism.joint_units[a]
        ends = " to ".join(number(v / factor) for v in mechanism.limits[a])
        own = tuple(i for i, limb in enumerate(mechanism.limbs) if limb.actuator == a)
        out[n].append(SceneMark(
            kind="travel", limbs=own,
            text=f"{mechanism.actuators[a]} is outside of its travel: {number(q[n, a] / factor)} "
                 f"of {ends} {unit}".rstrip()))


def _too_near(model: Model, limbs: Sequence[LimbSkeleton], out: list[list[SceneMark]]) -> None:
    """Add joints and links of two limbs that are nearer than a link is drawn thick.

    Joints that are in one place everywhere, and links of space that touch at home, are so by
    design, or by a mistake in a point: once, and no alarm.
    """
    mechanism = model.mechanism
    for found in interferences(limbs, THICKNESS * mechanism.reach,
                               [limb.actuator for limb in mechanism.limbs]):
        names = " and ".join(limbs[i].name for i in found.limbs)
        what = "joints" if found.joints else "links"
        crossing = not found.joints and mechanism.motion.planar
        drawn = found.distance[0] < TOUCHING * mechanism.reach and not crossing and (
            found.fixed or not found.joints)
        for n in np.flatnonzero(np.isfinite(found.distance)).tolist():
            if (found.fixed or drawn) and n:
                continue
            kind, text = what, (f"{what} of {names} are "
                                f"{mechanism.units.words(found.distance[n], 'length', 2)} apart")
            if drawn:
                kind, text = ("shared" if found.joints else "touching"), names
            elif crossing:
                text = f"links of {names} cross, unless they lie in layers"
            out[n].append(SceneMark.filled(None, mechanism.units, kind=kind, limbs=found.limbs,
                                           text=text, points=[found.place[n]]))


GAP = 1e-6
"""A limb does not close where its ends are further apart than this part of the reach."""


@dataclass(frozen=True)
class MachineStand:
    """Where a machine stands in N poses.

    ``labels`` and ``keys`` of the poses; ``pose``: platform-to-base motors (N, 8); ``q``: joint
    values (N, k), SI. ``own_joints`` (N,): whether the machine has these joint values there, else
    those that the pose asks for; None: it has them everywhere.
    """

    labels: tuple[str, ...]
    keys: tuple[str, ...]
    pose: Array
    q: Array
    own_joints: Bools | None = None


def machine_frames(mechanism: Mechanism, name: str, stand: MachineStand, marked: bool
                   ) -> SceneMachine:
    """Return a machine at every pose.

    Args:
        mechanism: the machine, without effects.
        name: what it is called.
        stand: where it stands.
        marked: whether to look for what needs a look.
    """
    model, q = Model(mechanism), np.array(stand.q)
    if stand.own_joints is not None and not stand.own_joints.all():
        rows = np.flatnonzero(~stand.own_joints)
        q[rows] = joints_at(model, stand.pose[rows])
    limbs = skeleton(model, stand.pose, q)
    sides = [np.stack([getattr(limb, side)[0] for limb in limbs])
             for side in ("base_point", "platform_point")]
    marks: Sequence[tuple[SceneMark, ...]] = [()] * len(q)
    if marked:
        gap = np.full(len(q), GAP * mechanism.reach)
        if mechanism.surplus:
            gap[1:] = np.inf    # what surplus limbs read contradicts itself, but for home
        marks = pose_marks(model, stand.pose, q, limbs, gap)
    return SceneMachine(
        name=name, limbs=tuple(_limb(mechanism, i, limb) for i, limb in enumerate(limbs)),
        base_outline=around(sides[0]), platform_outline=around(sides[1]),
        frames=tuple(_frame(mechanism, limbs, stand, q, n, marks[n]) for n in range(len(q))),
        other=_other_branches(model) if marked else ())


def joints_at(model: Model, pose: Array) -> Array:
    """Return joint values (N, k) at poses (N, 8), the nearest where a limb does not reach."""
    mechanism = model.mechanism
    home = home_attempt(mechanism)
    q = np.full((len(pose), len(mechanism.actuators)), np.nan)
    for i in mechanism.driven:
        limb = mechanism.limbs[i]
        u = limb_roots(model, i, pose)[0][:, 1 if home.roots[i] > 0 else 0]
        own = to_joint(model, i, np.where(np.isfinite(u), u, nearest_joint(model, i, pose)))
        empty = np.isnan(q[:, limb.actuator])
        q[empty, limb.actuator] = own[empty]
    return q


def _other_branches(model: Model) -> tuple[tuple[Point, ...], ...]:
    """Return each limb at home on its other branch, as a line; empty where it has none."""
    mechanism, pose = model.mechanism, model.mechanism.home[None]
    home, f = home_attempt(mechanism), mechanism.units.factor("length")
    q = np.tile(home.q, (1 + len(mechanism.limbs), 1))
    for i in mechanism.driven:
        limb = mechanism.limbs[i]
        u = limb_roots(model, i, pose)[0][0, 0 if home.roots[i] > 0 else 1]
        if limb.kind.branch is not None and i not in home.lost and np.isfinite(u):
            q[i + 1, limb.actuator] = to_joint(model, i, np.array([u]))[0]
    limbs = skeleton(model, np.repeat(pose, len(q), axis=0), q)
    out = []
    for i, placed in enumerate(limbs):
        own, other = placed.polyline[0], placed.polyline[i + 1]
        # of a strut the other root is the same line, counted backwards
        same = np.allclose(own, other, rtol=0.0, atol=GAP * mechanism.reach)
        out.append(() if same else tuple(point_of(p / f) for p in other))
    return tuple(out)


def _limb(mechanism: Mechanism, index: int, placed: LimbSkeleton) -> SceneLimb:
    limb = mechanism.limbs[index]
    drive, units = placed.drive, mechanism.units
    travel: tuple[float, float] | None = None
    if drive is not None and drive.prismatic and np.all(np.isfinite(
            mechanism.limits[limb.actuator])):
        ends = [Model(mechanism).joint_coordinate(index, np.tile(v, (1, len(mechanism.actuators))))
                for v in mechanism.limits[limb.actuator]]
        low, high = sorted(float(e[0]) / units.factor("length") for e in ends)
        travel = low, high
    return SceneLimb(
        name=limb.name, kind=limb.kind.name,
        actuator=mechanism.actuators[limb.actuator] if limb.driven else "",
        unit=mechanism.joint_units[limb.actuator][1] if limb.driven else "",
        joints=in_units(placed.joints, units), links=in_units(placed.links, units),
        slides=drive is not None and drive.prismatic, travel=travel)


def _frame(mechanism: Mechanism, limbs: Sequence[LimbSkeleton], stand: MachineStand, q: Array,
           n: int, marks: tuple[SceneMark, ...]) -> SceneFrame:
    vector, dof = pose_vector(stand.pose[n:n + 1])[0], list(mechanism.dof)
    return SceneFrame.filled(
        None, mechanism.units, label=stand.labels[n], key=stand.keys[n], marks=marks,
        pose=(vector / factors(mechanism.units))[dof],
        q=q[n] / mechanism.joint_factors(), origin=vector[:3],
        axes=cga.rotation_matrix(stand.pose[n]).T,
        limbs=tuple(_placed(mechanism, limb, n) for limb in limbs))


def _placed(mechanism: Mechanism, limb: LimbSkeleton, n: int) -> PlacedLimb:
    drive = limb.drive
    return PlacedLimb.filled(
        None, mechanism.units, base=limb.base_point[n], platform=limb.platform_point[n],
        joints=[j.centre[n] for j in limb.joints],
        links=[(k.start[n], k.end[n]) for k in limb.links],
        drive=None if drive is None else drive.centre[n],
        drive_axis=None if drive is None else drive.axis[n],
        zero=None if drive is None else drive.zero[n], u=None if drive is None else drive.u[n],
        unit="length" if drive is not None and drive.prismatic else "angle", gap=limb.gap[n],
        gap_ends=[e[n] for e in limb.ends] if limb.gap[n] > GAP * mechanism.reach else None)


def around(points: Array) -> tuple[int, ...]:
    """Return the order in which points (L, 3) go round their middle, in the plane nearest to them.

    >>> around(np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]]))
    (3, 0, 2, 1)
    """
    away = points - points.mean(axis=0)
    normal = linalg.svd(away.T @ away, full=True)[0][:, 2]
    normal = normal if normal[np.argmax(np.abs(normal))] > 0.0 else -normal
    x = np.eye(3)[np.argmin(np.abs(normal))] if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = x - (x @ normal) * normal
    angle = np.arctan2(away @ np.cross(normal, x), away @ x)
    return tuple(np.argsort(angle, kind="stable").tolist())
