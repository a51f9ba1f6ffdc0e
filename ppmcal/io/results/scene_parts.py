"""Parts of a scene: one class for each of its objects, in file units."""

from __future__ import annotations

from ppmcal.io.results.record import Finite, Flag, Part, Text, Whole
from ppmcal.kinematics.skeleton import Link, PlacedJoint
from ppmcal.linalg import Array
from ppmcal.units import Length, OfUnit

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
