"""Forward kinematics of spatial machines whose limbs' bodies meet in closed form.

Translational machines (deltas of three ideal parallelograms): the platform does not turn, so each
limb's sphere, carried by -R B_i, is one on which the platform's origin lies. Three meet in a point
pair ([PPM] eq. 5, 17).

Tripods (3-R(P)S): with the joints locked each end point B_i is on a circle, the meet of a sphere
and a plane. Let B_1 stand at an angle t of its circle. Spheres about it, of radii |B_1 B_2| and
|B_1 B_3|, meet the other circles in a point pair each, P_j +- s_j Q_j over W_j, and

    F(t) = W_2^2 W_3^2 prod over both signs (|B_2 - B_3|^2 - b_23^2)

is a trigonometric polynomial of degree 8: sixteen assembly modes at most, eight of them the others
mirrored where the hinges' axes lie in one plane (Zhang et al., CGA-based approach to direct
kinematics of parallel mechanisms with the 3-RS structure, Mech. Mach. Theory 124, 2018). F is
interpolated; its roots are eigenvalues of a companion matrix. At each root the end points are
meets, and the pose is that of three end points ([PPM] eq. 16-27).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Closure
from ppmcal.linalg import Array, Ints, finite_rows
from ppmcal.model.mechanism import Mechanism

DEGREE = 8
SAMPLES = 64
ON_CIRCLE = 3e-2
"""Roots z with | |z| - 1 | below this are tried; double ones are off by the root of round-off."""
POLISHED = 12
"""Secant steps on the distance B_2 B_3 over the angle of B_1."""
CLOSE = 1e-7
"""Roots count where the distance B_2 B_3 is met to this part of the reach."""


def is_tripod(mechanism: Mechanism) -> bool:
    """Whether three limbs tie a point of the platform each to a circle."""
    return mechanism.motion.turns_freely and len(mechanism.limbs) == 3 and all(
        limb.kind.surface.point_moves == (True, True) and not limb.kind.surface.angles
        for limb in mechanism.limbs)


def origin_surfaces(closure: Closure) -> list[tuple[Array, ...]]:
    """Return threes of surfaces that the origin of a platform that never turns lies on; one row.

    A platform point b on a sphere about c is the origin on the sphere about c - R b; likewise for
    planes. In the plane, that one is the third. Surplus limbs make more threes than one.
    """
    mechanism = closure.model.mechanism
    turned = cga.motor_from_rotation_vector(mechanism.home_pose[3:], np.zeros(3))
    arm = cga.move_point(turned, cga.coordinates(closure.moving[0]))
    plane = [cga.plane(np.array([0.0, 0.0, 1.0]), 0.0)] if mechanism.motion.planar else []
    of_limbs = cga.move_vector(cga.translator(-arm), closure.fixed[0])
    return [(*few, *plane) for few in combinations(of_limbs, 3 - len(plane))]


def translational_poses(closure: Closure) -> Array:
    """Return motors (n, 8) of a machine that never turns, n at most two; one row of joints."""
    turn, surfaces = closure.model.mechanism.home_pose[3:], origin_surfaces(closure)[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        places = cga.coordinates(np.stack(cga.split(cga.meet(*surfaces))[:2]))
    places = places[finite_rows(places)]
    return cga.motor_from_rotation_vector(np.broadcast_to(turn, places.shape), places)


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles of the three end points and the triangle between them, lengths in reaches.

    ``centre``, ``x``, ``y`` (3, 3): of each circle and the axes of its plane times its radius;
    ``surfaces``: sphere and plane of each (3, 2, 5); ``edges``: |B_1 B_2|, |B_1 B_3|, |B_2 B_3|.
    """

    centre: Array
    x: Array
    y: Array
    surfaces: Array
    edges: Array

    def first(self, t: Array) -> Array:
        """Return B_1 (M, 3) at angles ``t`` (M,)."""
        around = np.cos(t)[:, None] * self.x[0] + np.sin(t)[:, None] * self.y[0]
        return np.asarray(self.centre[0] + around, dtype=float)

    def seconds(self, t: Array) -> Array:
        """Return both B_2 and both B_3 (M, 2, 2, 3) at angles of B_1, nan where imaginary."""
        first, out = self.first(t), []
        for j in (1, 2):
            about = cga.sphere(first, np.full(len(t), self.edges[j - 1]))
            with np.errstate(divide="ignore", invalid="ignore"):
                pair = cga.split(cga.meet(about, *self.surfaces[j]))[:2]
            out.append(np.stack([cga.coordinates(p) for p in pair], axis=1))
        return np.stack(out, axis=1)

    def resultant(self, t: Array) -> Array:
        """Return F (M,) at angles of B_1."""
        first, pairs = self.first(t), []
        for j in (1, 2):
            to = first - self.centre[j]
            a, b = -2.0 * to @ self.x[j], -2.0 * to @ self.y[j]
            square = np.sum(to * to, axis=-1) + self.x[j] @ self.x[j]
            c = self.edges[j - 1] ** 2 - square
            w = a * a + b * b
            middle = (self.centre[j] * w[:, None] + (a * c)[:, None] * self.x[j]
                      + (b * c)[:, None] * self.y[j])
            half = a[:, None] * self.y[j] - b[:, None] * self.x[j]
            pairs.append((middle, half, w, w - c * c))
        (p2, q2, w2, s2), (p3, q3, w3, s3) = pairs
        # on the spheres about B_1: |B_j|^2 = b_1j^2 - |B_1|^2 + 2 B_1.B_j, so that the squared
        # distance is linear in each: k + 2 B_1.B_2 + 2 B_1.B_3 - 2 B_2.B_3
        k = self.edges[0]**2 + self.edges[1]**2 - self.edges[2]**2 - 2.0 * _dot(first, first)
        e = -2.0 * _dot(q2, q3)
        b2 = 2.0 * _dot(q2, first * w3[:, None] - p3)
        b3 = 2.0 * _dot(q3, first * w2[:, None] - p2)
        a = (k * w2 * w3 + 2.0 * _dot(first, p2 * w3[:, None] + p3 * w2[:, None])
             - 2.0 * _dot(p2, p3))
        even = a * a + b3 * b3 * s3 - s2 * (b2 * b2 + e * e * s3)
        odd = 2.0 * (a * b3 - s2 * b2 * e)
        return np.asarray((even * even - s3 * odd * odd) / (w2 * w3)**2, dtype=float)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1), dtype=float)


def tripod_ends(closure: Closure) -> tuple[Array, Array]:
    """Return where the end points of a tripod are, base axes and platform axes (n, 3, 3), m.

    ``closure`` has one row of joint values; n is at most sixteen.
    """
    reach = closure.model.mechanism.reach
    local = cga.coordinates(closure.moving[0])[::2]
    circles = tripod_circles(closure, local)
    if circles is None:
        return np.zeros((0, 3, 3)), np.zeros((0, 3, 3))
    t, i, j = (np.ravel(a) for a in np.meshgrid(_roots(circles), (0, 1), (0, 1), indexing="ij"))
    ends = reach * _polished(circles, t, i.astype(int), j.astype(int))
    return ends, np.broadcast_to(local, ends.shape)


def tripod_circles(closure: Closure, local: Array) -> Circles | None:
    """Return the circles of the end points, None where a sphere does not reach its plane."""
    reach = closure.model.mechanism.reach
    fixed = closure.fixed[0].reshape(3, 2, 5)
    centre, radius = cga.coordinates(fixed[:, 0]) / reach, closure.radius[0, ::2] / reach
    normal, offset = fixed[:, 1, :3], fixed[:, 1, 3] / reach
    height = offset - _dot(normal, centre)
    square = radius**2 - height**2
    if not np.all(square > 0.0):
        return None
    middle = centre + height[:, None] * normal
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    size = np.sqrt(square)[:, None]
    surfaces = np.stack([cga.sphere(middle, size[:, 0]),
                         cga.plane(normal, offset)], axis=1)
    edges = np.linalg.norm(local[[0, 0, 1]] - local[[1, 2, 2]], axis=-1) / reach
    return Circles(middle, size * across, size * np.cross(normal, across), surfaces, edges)


def _roots(circles: Circles) -> Array:
    """Return angles of B_1 near which F is 0."""
    even = 2.0 * np.pi * (np.arange(SAMPLES) + 0.5) / SAMPLES
    spectrum = np.fft.fft(circles.resultant(even)) / SAMPLES
    order = np.arange(-DEGREE, DEGREE + 1)
    coefficients = spectrum[order] * np.exp(-1j * order * np.pi / SAMPLES)
    z = np.roots(coefficients[::-1])
    z = z[np.abs(np.abs(z) - 1.0) < ON_CIRCLE]
    return np.asarray(np.angle(z), dtype=float)


def _polished(circles: Circles, t: Array, i: Ints, j: Ints) -> Array:
    """Return the end points (n, 3, 3) where |B_2 B_3| is right, near angles of B_1 (M,).

    ``i``, ``j``: which B_2 and which B_3 go with each (M,). By secants; one that leads nowhere
    is left out.
    """
    def gaps(at: Array, which: Ints) -> tuple[Array, Array]:
        pair, row = circles.seconds(at), np.arange(len(at))
        two, three = pair[row, 0, i[which]], pair[row, 1, j[which]]
        return (_dot(two - three, two - three) - circles.edges[2]**2,
                np.stack([circles.first(at), two, three], axis=1))

    before, at = t.copy(), t + 1e-7
    c0, _ = gaps(before, np.arange(len(t)))
    c, ends = gaps(at, np.arange(len(t)))
    sound = np.isfinite(c0) & np.isfinite(c) & (np.abs(c0) <= 1e-2)
    for _ in range(POLISHED):
        go = np.flatnonzero(sound & (c != c0))
        if not go.size:
            break
        ahead = at[go] - c[go] * (at[go] - before[go]) / (c[go] - c0[go])
        before[go], at[go], c0[go] = at[go], ahead, c[go]
        c[go], ends[go] = gaps(ahead, go)
        sound &= np.isfinite(c)
    return ends[sound & (np.abs(c) < CLOSE) & (np.abs(at - t) < ON_CIRCLE)]
