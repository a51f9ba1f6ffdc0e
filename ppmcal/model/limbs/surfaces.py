"""The closure families: the constraints that chain motors impose.

Each builder yields, per closure equation, ``fixed, moving, scale, radius, middle line``; see
:class:`kind.ClosureSurface`. The middle line is the leg's line in the axes of the middle chain's
root: it converts errors of the middle chain to changes of radius or offset.

A limb of fewer freedoms also constrains the angle between directions of both bodies. Directions are
planes through the origin, their inner product is the cosine, and its derivative by a twist
(a x b).omega, a pure moment: a deviation from a right angle counts as its arc at :data:`LEVER`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.limbs.kind import EquationForm, Surface

_Equation = tuple[Array, Array, Array, Array, Array]
LEVER = 1.0
"""The lever arm that converts angle conditions to lengths, m."""
X, Y, Z = 0, 1, 2


def _line(direction: Array, through: Array) -> Array:
    out = np.empty((*np.broadcast_shapes(direction.shape, through.shape)[:-1], 6))
    out[..., :3] = direction
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[..., 3 + k] = through[..., i] * direction[..., j] - through[..., j] * direction[..., i]
    return out


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1), dtype=float)


def _axis(motor: Array, axis: int) -> Array:
    """Return a local axis of a chain's end (..., 3), in its root's axes."""
    return np.asarray(cga.rotation_matrix(motor)[..., :, axis], dtype=float)


def _sphere(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """R-R and U-S: the platform's point on a sphere ([PPM] eq. 16, [IK] eq. 28)."""
    reach = cga.translation(middle)
    radius = np.sqrt(_dot(reach, reach))
    size = np.where(radius > 0.0, radius, 1.0)
    yield (cga.sphere(cga.translation(base), radius), cga.point(cga.translation(platform)),
           -1.0 / size, radius, _line(reach / size[..., None], np.zeros(3)))


def _base_plane(base: Array, middle: Array, platform: Array, axis: int = Y
                ) -> Iterator[_Equation]:
    """P-R: the platform's point on a plane along the passive slide (local x of base)."""
    reach, normal = cga.translation(middle), _axis(base, axis)
    plane = cga.plane(normal, _dot(normal, cga.translation(base)) + reach[..., axis])
    yield (plane, cga.point(cga.translation(platform)), np.ones(plane.shape[:-1]),
           np.zeros(plane.shape[:-1]), _line(np.eye(3)[axis], reach))


def _platform_plane(base: Array, middle: Array, platform: Array, axis: int = Y
                    ) -> Iterator[_Equation]:
    """R-P: the limb's last revolute centre on a plane of the platform."""
    normal = _axis(platform, axis)
    offset = cga.translation(cga.reverse(middle))[..., axis]
    plane = cga.plane(normal, _dot(normal, cga.translation(platform)) + offset)
    centre = cga.point(cga.translation(base))
    yield (centre, plane, -np.ones(np.broadcast_shapes(plane.shape[:-1], centre.shape[:-1])),
           np.zeros(plane.shape[:-1]), _line(_axis(middle, axis), np.zeros(3)))


def _circle(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """R-S: sphere and plane, which intersect in the circle about the joint's axis."""
    yield from _sphere(base, middle, platform)
    yield from _base_plane(base, middle, platform, Z)


def _angle(base: Array, platform: Array, axis: int, other: int = Z) -> Iterator[_Equation]:
    """An axis on the base's side perpendicular to one on the platform's."""
    fixed, moving = _axis(base, axis), _axis(platform, other)
    shape = np.broadcast_shapes(fixed.shape, moving.shape)[:-1]
    yield (cga.plane(fixed, 0.0), cga.plane(moving, 0.0), np.full(shape, LEVER), np.zeros(shape),
           np.zeros((*shape, 6)))


def _rod_and_angle(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """R-Pa-U: a parallelogram keeps the crank's axis; the platform's is perpendicular to it."""
    yield from _sphere(base, middle, platform)
    yield from _angle(base, platform, Z)


def _plane_and_direction(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """R-R-R: the platform in a plane of the base, one of its axes along the normal."""
    yield from _base_plane(base, middle, platform, Z)
    yield from _angle(base, platform, X)
    yield from _angle(base, platform, Y)


def _hinge_on_platform(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """U-R: sphere and platform plane; the hinge is perpendicular to the U's first axis."""
    yield from _sphere(base, middle, platform)
    yield from _free_hinge(base, middle, platform)


def _free_hinge(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """The same at any distance."""
    yield from _platform_plane(base, middle, platform, Z)
    yield from _angle(base, platform, Z)


def _held_slide(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """U-P: a line of the platform through the base's point, without rotation about itself."""
    yield from _platform_plane(base, middle, platform, Z)
    yield from _platform_plane(base, middle, platform, Y)
    yield from _angle(base, platform, Z)


def _sphere_between_axes(base: Array, middle: Array, platform: Array, pose: Array | None
                         ) -> Iterator[_Equation]:
    """U-U: a sphere, and the first axes of both universal joints in one plane."""
    yield from _sphere(base, middle, platform)
    yield from _between_axes(base, middle, platform, pose)


def _between_axes(base: Array, middle: Array, platform: Array, pose: Array | None
                  ) -> Iterator[_Equation]:
    """The first axes of two universal joints in one plane with the rod between them.

    The joints' second axes are parallel, along n, which is perpendicular to both first axes a and b
    and to the rod d. So b - k d is perpendicular to n for any k. With the k that keeps it so to
    first order as n rotates about a, this is the limb's only constraint on the platform: a force if
    a and b intersect, a moment if they are parallel.
    """
    start, end, a = cga.translation(base), cga.translation(platform), _axis(base, Z)
    own = _axis(platform, Z)
    at = cga.identity_motor() if pose is None else pose
    rod = cga.move_point(at, end) - start
    b = _axis(cga.compose(at, platform), Z)
    normal = np.cross(a, rod)
    with np.errstate(invalid="ignore", divide="ignore"):   # nan where the rod is along the axis
        normal = normal / np.sqrt(_dot(normal, normal))[..., None]
        across = np.cross(a, normal)
        k = _dot(across, b) / _dot(across, rod)
    moving = -k[..., None] * cga.point(end)
    moving[..., :3] += own
    fixed = cga.plane(normal, _dot(normal, start))
    shape = np.broadcast_shapes(fixed.shape, moving.shape)[:-1]
    yield fixed, moving, np.full(shape, LEVER), np.zeros(shape), np.zeros((*shape, 6))


def _over_pulley(base: Array, middle: Array, platform: Array, pose: Array | None, axis: int
                 ) -> Iterator[_Equation]:
    """A rope over a pulley: its length minus the joint's, exact, by a sphere of equal curvature.

    The local ``axis`` of the middle chain is the rope; k of :mod:`pulley` is perpendicular to it.
    At a pose the equation is directly a length, like that of a plane.
    """
    centre, reach = cga.translation(base), cga.translation(middle)
    rope = reach[..., axis]
    lean = _dot(reach, reach) - rope * rope        # k squared
    if pose is None:
        free, radius = np.where(rope > 0.0, rope, 1.0), rope
        squared = rope * rope + lean
    else:
        away = cga.move_point(pose, cga.translation(platform)) - centre
        free = np.sqrt(_dot(away, away) - lean)
        squared, radius = lean + (2.0 * rope - free) * free, np.zeros_like(free)
    yield (cga.sphere_squared(centre, squared), cga.point(cga.translation(platform)), -1.0 / free,
           radius, _line(np.eye(3)[axis], np.zeros_like(reach)))


_ROD, _SQUARE = EquationForm("sphere"), EquationForm("angle", Z, Z)
_BETWEEN, _HINGED = EquationForm("between axes", Z, Z), EquationForm("platform plane", Z)

SPHERE = Surface("sphere", (True,), _sphere, (_ROD,))
BASE_PLANE = Surface("base plane", (True,), _base_plane, (EquationForm("base plane", Y),))
PLATFORM_PLANE = Surface("platform plane", (False,), _platform_plane,
                         (EquationForm("platform plane", Y),))
CIRCLE = Surface("circle", (True, True), _circle, (_ROD, EquationForm("base plane", Z)))
ROD_AND_ANGLE = Surface("sphere and angle", (True, True), _rod_and_angle, (_ROD, _SQUARE))
PLANE_AND_DIRECTION = Surface(
    "base plane and direction", (True, True, True), _plane_and_direction,
    (EquationForm("base plane", Z), EquationForm("angle", X, Z), EquationForm("angle", Y, Z)))
HINGE_ON_PLATFORM = Surface("sphere, platform plane and angle", (True, False, True),
                            _hinge_on_platform, (_ROD, _HINGED, _SQUARE))
FREE_HINGE = Surface("platform plane and angle", (False, True), _free_hinge, (_HINGED, _SQUARE))
HELD_SLIDE = Surface(
    "line of the platform and angle", (False, False, True), _held_slide,
    (_HINGED, EquationForm("platform plane", Y), _SQUARE))
SPHERE_BETWEEN_AXES = Surface("sphere between axes", (True, True), _sphere_between_axes,
                              (_ROD, _BETWEEN), turns=True)
BETWEEN_AXES = Surface("between axes", (True,), _between_axes, (_BETWEEN,), turns=True)
OVER_SHEAVE, OVER_SHEAVE_IN_PLANE, OVER_SWIVEL = (
    Surface("rope over a pulley", (True,), partial(_over_pulley, axis=axis),
            (EquationForm(form, axis),), turns=True)
    for form, axis in (("over sheave", Z), ("over sheave", X), ("over swivel", Z)))
