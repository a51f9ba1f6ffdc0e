"""A machine to scale, in the units of its file: what a drawing of it is made from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.io.results.record import Finite, Flag, Part, Text, UnitNames, Whole
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.pose_sweep import PoseSweep, pose_sweep
from ppmcal.kinematics.skeleton import GUIDE, LimbSkeleton, skeleton
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import U
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism
from ppmcal.units import Units
from ppmcal.wording import number

FORMAT = "ppmcal/scene/1"
SHOWN_PART = 0.05
"""Magnified, the largest difference is about this part of the reach."""

Point = tuple[Finite, Finite, Finite]


class SceneJoint(Part):
    """A joint: its type R, P, U or S, and whether it is driven."""

    number: Whole
    kind: Text
    driven: Flag


class SceneLink(Part):
    """A piece of a limb: ``bar``, ``drive`` (a driven slide) or ``guide`` (a passive one)."""

    name: Text
    role: Text


class SceneLimb(Part):
    """One limb; ``travel``: the ends of a driven slide by its limits, where it has both."""

    name: Text
    kind: Text
    actuator: Text
    unit: Text
    joints: tuple[SceneJoint, ...]
    links: tuple[SceneLink, ...]
    slides: Flag
    travel: tuple[Finite, Finite] | None = None


class PlacedLimb(Part):
    """One limb at one pose, base axes: what is named in :class:`SceneLimb`, in its order.

    ``axes`` are unit vectors; ``links`` hold start and end; ``drive`` is the centre of the driven
    joint, ``drive_axis`` the direction in which or about which it grows, ``zero`` where the next
    piece ends at u = 0; ``u`` is the joint coordinate, in units of length or angle; ``gap`` by how
    much the limb does not close.
    """

    base: Point
    platform: Point
    joints: tuple[Point, ...]
    axes: tuple[Point, ...]
    links: tuple[tuple[Point, Point], ...]
    drive: Point | None = None
    drive_axis: Point | None = None
    zero: Point | None = None
    u: Finite | None = None
    gap: Finite = 0.0


class SceneFrame(Part):
    """The machine at one pose: label, coordinates and joint values as the file has them.

    ``origin`` and ``axes`` are those of the platform, x, y and z, in base axes.
    """

    label: Text
    pose: tuple[Finite, ...]
    q: tuple[Finite, ...]
    origin: Point
    axes: tuple[Point, Point, Point]
    limbs: tuple[PlacedLimb, ...]


class SceneMachine(Part):
    """One machine at every pose of the scene; ``outline``: the order of its platform's points."""

    name: Text
    limbs: tuple[SceneLimb, ...]
    base_outline: tuple[Whole, ...]
    platform_outline: tuple[Whole, ...]
    frames: tuple[SceneFrame, ...]


class MeasuredPose(Part):
    """A measured pose: where it is, a value to colour by, and its error, not magnified."""

    label: Text
    point: Point
    value: Finite | None = None
    error: Point | None = None


class Scene(Part):
    """A machine, if need be with a second one over it, and measured poses.

    Attributes:
        coordinates, coordinate_units: of every pose; actuators, joint_units: of every q.
        flat: whether all of it lies in the x-y plane.
        still: coordinates that are not moved among the poses.
        machines: the one that is drawn, then the one that is laid over it.
        magnification: of the second machine's differences and of error vectors.
        value, value_unit: what measured poses are coloured by.
    """

    format: Text = FORMAT
    name: Text
    motion: Text
    flat: Flag
    units: UnitNames
    reach: Finite
    coordinates: tuple[Text, ...]
    coordinate_units: tuple[Text, ...]
    actuators: tuple[Text, ...]
    joint_units: tuple[Text, ...]
    still: tuple[Text, ...] = ()
    machines: tuple[SceneMachine, ...]
    magnification: Finite = 1.0
    measured: tuple[MeasuredPose, ...] = ()
    value: Text = ""
    value_unit: Text = ""
    notes: tuple[Text, ...] = ()

    @classmethod
    def of(cls, mechanism: Mechanism, measured: Sequence[MeasuredPose] = (), value: str = "",
           value_unit: str = "") -> Scene:
        """Return the scene of a machine at home and at poses about it, without effects.

        A machine whose values are not its nominal ones is laid over the nominal one.

        Args:
            mechanism: the machine.
            measured: poses with errors, in units of the file.
            value: what they are coloured by.
            value_unit: its unit.

        Raises:
            BadInput: the home pose cannot be reached.
        """
        units = mechanism.units
        plain = replace(mechanism, effects=())
        nominal = plain.nominal()
        moved = not np.array_equal(plain.values, plain.nominals)
        sweep = pose_sweep(Model(nominal if moved else plain))
        drawn = [_machine(nominal if moved else plain, "nominal" if moved else plain.name, sweep)]
        if moved:
            drawn.append(_machine(plain, "present values", sweep))
        reach = mechanism.reach / units.factor("length")
        return cls(
            name=mechanism.name, motion=mechanism.motion, flat=mechanism.motion == "planar",
            units=UnitNames.of(units), reach=reach, coordinates=mechanism.coordinates,
            coordinate_units=tuple(_unit(mechanism, c)[1] for c in mechanism.dof),
            actuators=mechanism.actuators, joint_units=tuple(u for _, u in mechanism.joint_units),
            still=tuple(POSE_COORDINATES[c] for c in sweep.still), machines=tuple(drawn),
            magnification=_magnification(reach, drawn, measured), measured=tuple(measured),
            value=value, value_unit=value_unit,
            notes=("Effects of the file are left out: this is its geometry.",)
            if mechanism.effects else ())


def _machine(mechanism: Mechanism, name: str, sweep: PoseSweep) -> SceneMachine:
    """Return a machine at the poses of a sweep, with the joint values that are its own there."""
    model, pose, q = Model(mechanism), pose_motor(sweep.pose), sweep.q
    own = inverse(model, pose)
    # off its surface or out of reach: as it stands with the drawn machine's joint values
    q = np.where(own.reached[:, None], own.q, q)
    limbs = skeleton(model, pose, q)
    at_home = [np.stack([getattr(limb, side)[0] for limb in limbs])
               for side in ("base_point", "platform_point")]
    return SceneMachine(
        name=name, limbs=tuple(_limb(mechanism, i, limb) for i, limb in enumerate(limbs)),
        base_outline=around(at_home[0]), platform_outline=around(at_home[1]),
        frames=tuple(_frame(mechanism, limbs, sweep, pose, q, n) for n in range(len(pose))))


def _limb(mechanism: Mechanism, index: int, placed: LimbSkeleton) -> SceneLimb:
    limb = mechanism.limbs[index]
    drive, role = placed.drive, {U: "drive", GUIDE: "guide"}
    travel: tuple[float, float] | None = None
    if drive is not None and drive.prismatic and np.all(np.isfinite(
            mechanism.limits[limb.actuator])):
        ends = [Model(mechanism).joint_coordinate(index, np.tile(v, (1, len(mechanism.actuators))))
                for v in mechanism.limits[limb.actuator]]
        low, high = sorted(float(e[0]) / mechanism.units.factor("length") for e in ends)
        travel = low, high
    return SceneLimb(
        name=limb.name, kind=limb.kind.name, actuator=mechanism.actuators[limb.actuator],
        unit=mechanism.joint_units[limb.actuator][1],
        joints=tuple(SceneJoint(number=j.number, kind=j.kind, driven=j.driven)
                     for j in placed.joints),
        links=tuple(SceneLink(name=k.name, role=role.get(k.name, "bar")) for k in placed.links),
        slides=drive is not None and drive.prismatic, travel=travel)


def _frame(mechanism: Mechanism, limbs: Sequence[LimbSkeleton], sweep: PoseSweep, pose: Array,
           q: Array, n: int) -> SceneFrame:
    f = mechanism.units.factor("length")
    factors = [_unit(mechanism, c)[0] for c in mechanism.dof]
    vector = pose_vector(pose[n:n + 1])[0]
    label = "home"
    if sweep.coordinate[n] >= 0:
        c = sweep.coordinate[n]
        factor, unit = _unit(mechanism, c)
        by = sweep.step[n] / factor
        label = f"{POSE_COORDINATES[c]} {'+' if by > 0 else '−'} {number(abs(by), 3)} {unit}"
    turn = cga.rotation_matrix(pose[n])
    return SceneFrame(
        label=label, pose=tuple(vector[c] / u for c, u in zip(mechanism.dof, factors, strict=True)),
        q=tuple((q[n] / mechanism.joint_factors()).tolist()), origin=_point(vector / f),
        axes=(_point(turn[:, 0]), _point(turn[:, 1]), _point(turn[:, 2])),
        limbs=tuple(_placed(limb, n, mechanism.units) for limb in limbs))


def _placed(limb: LimbSkeleton, n: int, units: Units) -> PlacedLimb:
    drive, f = limb.drive, units.factor("length")
    own = units.factor("length" if drive is not None and drive.prismatic else "angle")
    return PlacedLimb(
        base=_point(limb.base_point[n] / f), platform=_point(limb.platform_point[n] / f),
        joints=tuple(_point(j.centre[n] / f) for j in limb.joints),
        axes=tuple(_point(j.axis[n]) for j in limb.joints),
        links=tuple((_point(k.start[n] / f), _point(k.end[n] / f)) for k in limb.links),
        drive=None if drive is None else _point(drive.centre[n] / f),
        drive_axis=None if drive is None else _point(drive.axis[n]),
        zero=None if drive is None else _point(drive.zero[n] / f),
        u=None if drive is None else float(drive.u[n]) / own, gap=float(limb.gap[n] / f))


def _point(vector: Array) -> Point:
    x, y, z = vector[:3].tolist()
    return x, y, z


def _unit(mechanism: Mechanism, coordinate: int) -> tuple[float, str]:
    quantity = "length" if coordinate < 3 else "angle"
    return mechanism.units.factor(quantity), mechanism.units.name(quantity)


def around(points: Array) -> tuple[int, ...]:
    """Return the order in which points (L, 3) go round their middle, in the plane nearest to them.

    >>> around(np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]]))
    (3, 0, 2, 1)
    """
    away = points - points.mean(axis=0)
    normal = np.linalg.svd(away.T @ away)[0][:, 2]
    normal = normal if normal[np.argmax(np.abs(normal))] > 0.0 else -normal
    x = np.eye(3)[np.argmin(np.abs(normal))] if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = x - (x @ normal) * normal
    angle = np.arctan2(away @ np.cross(normal, x), away @ x)
    return tuple(np.argsort(angle, kind="stable").tolist())


def _magnification(reach: float, drawn: Sequence[SceneMachine], measured: Sequence[MeasuredPose]
                   ) -> float:
    """Return 1, 2 or 5 times a power of ten, by which the largest difference can be seen."""
    largest = max([math.dist(m.error, (0.0, 0.0, 0.0)) for m in measured if m.error], default=0.0)
    if len(drawn) > 1:
        a, b = (_points(machine.frames[0]) for machine in drawn)
        if a.shape == b.shape:
            largest = max(largest, float(np.max(np.linalg.norm(a - b, axis=-1), initial=0.0)))
    if not largest > 0.0:
        return 1.0
    wanted = SHOWN_PART * reach / largest
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, float(power * max(s for s in (1.0, 2.0, 5.0) if s * power <= wanted)))


def _points(frame: SceneFrame) -> Array:
    return np.array([p for limb in frame.limbs for p in
                     (limb.base, limb.platform, *limb.joints)], dtype=float).reshape(-1, 3)
