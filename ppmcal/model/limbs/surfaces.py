"""The four closure families: what the chain motors tie to what.

Each builder yields, per closure equation, ``fixed, moving, scale, radius, middle line``; see
:class:`kind.ClosureSurface`. The middle line is the leg's line seen from the middle
chain's root: it turns errors of the middle chain into changes of radius or offset.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.limbs.kind import EquationForm, Surface

_Equation = tuple[Array, Array, Array, Array, Array]
_Y = np.array([0.0, 1.0, 0.0])
_Z = np.array([0.0, 0.0, 1.0])


def _line(direction: Array, through: Array) -> Array:
    out = np.empty((*np.broadcast_shapes(direction.shape, through.shape)[:-1], 6))
    out[..., :3] = direction
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[..., 3 + k] = through[..., i] * direction[..., j] - through[..., j] * direction[..., i]
    return out


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1), dtype=float)


def _sphere(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """R-R and U-S: the platform's point on a sphere ([PPM] eq. 16, [IK] eq. 28)."""
    reach = cga.translation(middle)
    radius = np.sqrt(_dot(reach, reach))
    size = np.where(radius > 0.0, radius, 1.0)
    yield (cga.sphere(cga.translation(base), radius), cga.point(cga.translation(platform)),
           -1.0 / size, radius, _line(reach / size[..., None], np.zeros(3)))


def _base_plane(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """P-R: the platform's point on a plane along the passive slide (local x of base)."""
    reach, normal = cga.translation(middle), cga.rotation_matrix(base)[..., :, 1]
    plane = cga.plane(normal, _dot(normal, cga.translation(base)) + reach[..., 1])
    yield (plane, cga.point(cga.translation(platform)), np.ones(plane.shape[:-1]),
           np.zeros(plane.shape[:-1]), _line(_Y, reach))


def _platform_plane(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """R-P: the limb's last revolute centre on a plane that the platform carries."""
    normal = cga.rotation_matrix(platform)[..., :, 1]
    offset = cga.translation(cga.reverse(middle))[..., 1]
    plane = cga.plane(normal, _dot(normal, cga.translation(platform)) + offset)
    centre = cga.point(cga.translation(base))
    yield (centre, plane, -np.ones(np.broadcast_shapes(plane.shape[:-1], centre.shape[:-1])),
           np.zeros(plane.shape[:-1]),
           _line(cga.rotation_matrix(middle)[..., :, 1], np.zeros(3)))


def _circle(base: Array, middle: Array, platform: Array) -> Iterator[_Equation]:
    """R-S: sphere and plane, whose meet is the circle about the joint's axis."""
    yield from _sphere(base, middle, platform)
    reach, axis = cga.translation(middle), cga.rotation_matrix(base)[..., :, 2]
    plane = cga.plane(axis, _dot(axis, cga.translation(base)) + reach[..., 2])
    yield (plane, cga.point(cga.translation(platform)), np.ones(plane.shape[:-1]),
           np.zeros(plane.shape[:-1]), _line(_Z, reach))


SPHERE = Surface("sphere", (True,), _sphere, (EquationForm("sphere"),))
BASE_PLANE = Surface("base plane", (True,), _base_plane, (EquationForm("base plane", 1),))
PLATFORM_PLANE = Surface("platform plane", (False,), _platform_plane,
                         (EquationForm("platform plane", 1),))
CIRCLE = Surface("circle", (True, True), _circle,
                 (EquationForm("sphere"), EquationForm("base plane", 2)))
