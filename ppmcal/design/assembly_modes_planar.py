"""Assembly modes of planar machines: a resultant found by interpolation.

Any mix of limbs. With joints locked and the platform turned to phi, every
closure equation is one of

    |x|^2 + a x + b y + d = 0     (a point on a circle)
    a x + b y + d = 0             (a point on a line),

a, b, d trigonometric polynomials of phi of degree at most 1. Put the origin of (x, y) where the
first circle's joint is at that circle's centre: then its a = b = 0 and its d is constant. Circles
less the first one are lines; two lines meet in (X, Y)/D, which on the circle gives

    F(phi) = X^2 + Y^2 + a X D + b Y D + d D^2 = 0.

Without a circle F is the determinant of the three lines. Degree of F, hence half of the most modes
that there can be:

    3 circles                                       3   (3-R(P)R: six modes)
    2 circles, 1 line                               3
    1 circle, 2 lines on one body; on both          2; 3
    3 lines on one body; on both                    1; 2

for k = [a b d] of a circle less the first is (2 w, |w|^2 + const) with w and |w|^2 of degree 1, and
products of normals on one body do not depend on phi. So F is known from 2*3 + 1 samples; its roots
are eigenvalues of a companion matrix in z = exp(i phi). That is the classical result of six modes
(Gosselin, Sefrioui, Richard, "Solutions polynomiales au probleme de la cinematique directe des
manipulateurs paralleles plans a trois degres de liberte", Mech. Mach. Theory 27(2), 1992), found
here by interpolation, without a formula for any limb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.design.assembly_modes_spatial import PLACE, FoundModes, closing
from ppmcal.errors import NoResult
from ppmcal.kinematics.closure import Closure
from ppmcal.linalg import Array, Bools, finite_rows

DEGREE = 3
SAMPLES = 16
"""More than 2 DEGREE + 1: round-off is averaged, and what exceeds DEGREE is seen to be nothing."""
NOTHING = 1e-11
"""F below this part of the terms that it is the sum of is identically zero."""
ON_CIRCLE = 1e-2
"""Roots z with | |z| - 1 | below this are tried: a root of multiplicity 4 is off by about 1e-4."""
SAME = 1e-6
"""A mode is double where A is nearer to singular; poses nearer than 100 of it are one."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """The closure equations at M rotations, lengths in units of the reach.

    ``circle`` (M, 3): a, b, d of the first circle, None where there is none; ``lines``
    (M, 2 or 3, 3): a, b, d; ``origin`` (M, 2): where (x, y) = 0 is, m.
    """

    circle: Array | None
    lines: Array
    origin: Array

    @property
    def crossings(self) -> Array:
        """Where two lines meet, times the third coordinate: (M, pairs, 3) X, Y, D."""
        first, second = np.triu_indices(self.lines.shape[1], 1)
        return np.cross(self.lines[:, first], self.lines[:, second])

    @property
    def resultant(self) -> tuple[Array, float]:
        """F (M,), and the size of the largest of its terms."""
        x, y, w = np.moveaxis(self.crossings[:, 0], -1, 0)
        if self.circle is None:
            return np.linalg.det(self.lines), float(np.max(np.prod(
                np.linalg.norm(self.lines, axis=-1), axis=-1)))
        a, b, d = self.circle.T
        return (x * x + y * y + (a * x + b * y + d * w) * w,
                float(np.max(x * x + y * y + np.abs(d) * w * w)))


def weights(closure: Closure) -> Array:
    """Return the factor of |x|^2 in each gap (d,), 1/m; 0 for planes."""
    squares = closure.fixed[0, :, 4] * closure.moving[0, :, 4]
    return np.asarray(-0.5 * closure.scale[0] * squares, dtype=float)


def _poses(xy: Array, phi: Array) -> Array:
    """Return motors (M, 8) of planar poses."""
    nil = np.zeros_like(phi)
    return cga.motor_from_rotation_vector(np.stack([nil, nil, phi], axis=-1),
                                          np.concatenate([xy, nil[:, None]], axis=-1))


def _rows(closure: Closure, phi: Array) -> _Rows:
    """Return the closure equations at rotations ``phi`` (M,), from gaps at five places each."""
    reach = closure.model.mechanism.reach
    weight = weights(closure) * reach * reach
    circles, planes = np.flatnonzero(weight), np.flatnonzero(weight == 0.0)
    origin = np.zeros((len(phi), 2))
    if circles.size:
        k = circles[0]
        turned = cga.move_point(_poses(origin, phi), cga.coordinates(closure.moving[0, k]))
        origin = (cga.coordinates(closure.fixed[0, k]) - turned)[:, :2]
    offsets = reach * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    at = (origin[None] + offsets[:, None]).reshape(-1, 2)
    c, e, w, n, s = closure.misclosure(_poses(at, np.tile(phi, 5))).reshape(5, len(phi), -1)
    table = np.stack([0.5 * (e - w), 0.5 * (n - s), c], axis=-1)
    table /= np.where(weight == 0.0, reach, weight)[:, None]
    if not circles.size:
        return _Rows(None, table, origin)
    first = table[:, circles[0]]
    others = table[:, circles[1:]] - first[:, None]
    return _Rows(first, np.concatenate([others, table[:, planes]], axis=1), origin)


def _even_angles() -> Array:
    return np.asarray(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES, dtype=float)


def by_resultant(closure: Closure, spheres: Bools) -> FoundModes:
    """Return the modes of a planar machine by the resultant.

    Raises:
        NoResult: infinitely many.
    """
    return closing(closure, _candidates(closure, rotations(closure, spheres)))


def rotations(closure: Closure, spheres: Bools) -> Array:
    """Return the platform rotations (n,), rad, at which F vanishes, to round-off.

    Some of them may be near a real root only, and close nothing.

    Raises:
        NoResult: infinitely many poses close.
    """
    value, size = _rows(closure, _even_angles()).resultant
    if np.max(np.abs(value)) <= NOTHING * size:
        raise NoResult("infinitely many poses close at these joint values, or those of none: the "
                       "closure does not depend on the platform's rotation", PLACE,
                       "Choose other joint values, or check the limbs' points and angles")
    angles = _roots(np.fft.fft(value) / SAMPLES)
    _finite_number(closure, angles, int(spheres.sum()))
    return angles


def _roots(spectrum: NDArray[np.complex128]) -> Array:
    """Return the real angles at which a trigonometric polynomial vanishes, nearly."""
    upper = spectrum[:DEGREE + 1]
    degree = int(np.flatnonzero(np.abs(upper) > NOTHING * np.abs(upper).max()).max())
    if not degree:
        return np.zeros(0)
    # sum c_k z^k, k = -degree ... degree, highest power first
    z = np.roots(np.concatenate([upper[degree:0:-1], np.conj(upper[:degree + 1])]))
    angles: Array = np.angle(z[np.abs(np.abs(z) - 1.0) < ON_CIRCLE])
    return angles


def _finite_number(closure: Closure, angles: Array, circles: int) -> None:
    """Refuse joint values at which the platform translates freely at one rotation.

    Three circles that coincide (equal triangles on equal legs): the two lines vanish. F has
    a fourfold root there, so the rotation is improved by Gauss-Newton first. Three lines
    that coincide: rank 1.
    """
    if not angles.size or circles not in (0, 3):
        return
    where = angles
    if circles == 0:
        lines = _rows(closure, where).lines
        left = linalg.singular_values(lines)[:, 1]
        free = left < SAME * np.linalg.norm(lines, axis=(1, 2))
    else:
        step = 1e-4
        usual = float(np.abs(_rows(closure, _even_angles()).lines).max())
        for _ in range(4):
            w, after, before = (_rows(closure, where + s).lines.reshape(len(where), -1)
                                for s in (0.0, step, -step))
            slope = (after - before) / (2.0 * step)
            where = where - np.sum(w * slope, axis=1) / np.maximum(np.sum(slope**2, axis=1), 1e-30)
        free = np.abs(_rows(closure, where).lines).max(axis=(1, 2)) < 1e-9 * usual
    if free.any():
        unit = closure.model.mechanism.units
        turn = float(where[np.argmax(free)]) / unit.factor("angle")
        turn = (turn + 180.0) % 360.0 - 180.0 if unit.angle == "deg" else turn
        raise NoResult("infinitely many poses close at these joint values: at rz = "
                       f"{turn:.4g} {unit.angle} the platform translates freely", PLACE,
                       "Choose other joint values")


def _candidates(closure: Closure, angles: Array) -> Array:
    """Return motors to start Newton from (M, 8), for every root of F.

    Where two lines are parallel at a root they say nothing, and the circle's meets with each
    line do. All are tried at every root: what does not close is dropped.
    """
    if not angles.size:
        return np.zeros((0, 8))
    rows = _rows(closure, angles)
    x = rows.crossings
    with np.errstate(divide="ignore", invalid="ignore"):
        places = [x[..., :2] / x[..., 2:]]
        if rows.circle is not None:
            normal, d = rows.lines[..., :2], rows.lines[..., 2:]
            square = np.sum(normal**2, axis=-1, keepdims=True)
            centre = -0.5 * rows.circle[:, None, :2]
            foot = centre - normal * (np.sum(normal * centre, axis=-1, keepdims=True) + d) / square
            room = (np.sum(centre**2, axis=-1) - rows.circle[:, None, 2]
                    - np.sum((foot - centre)**2, axis=-1))[..., None]
            way = np.sqrt(np.maximum(room, 0.0) / square) * normal[..., ::-1] * [-1.0, 1.0]
            places += [foot + way, foot - way]
    there = np.concatenate(places, axis=1)
    count = there.shape[1]
    xy = (rows.origin[:, None] + closure.model.mechanism.reach * there).reshape(-1, 2)
    phi = np.repeat(angles, count)
    good = finite_rows(xy) & (np.abs(xy).max(axis=1) < 1e6 * closure.model.mechanism.reach)
    return _poses(xy[good], phi[good])
