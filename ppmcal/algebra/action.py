"""Action of unit motors on points, vectors, lines and twists: explicit sandwiches M X M~.

Also the line of a leg and its pairing with a twist, the basic derivative of the whole program.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.algebra._types import Array, Scalars, as_array, components, cross3, pack
from ppmcal.algebra.motors import translation_parts


def _rotate(m: Array, x: Scalars) -> tuple[Scalars, Scalars, Scalars]:
    """Return R x = x + 2(s w + w × a), w = x × a, component first."""
    s, a = m[0], m[1:4]
    w = cross3(x, a)
    u = cross3(w, a)
    x1, x2, x3 = x
    return x1 + 2 * (s * w[0] + u[0]), x2 + 2 * (s * w[1] + u[1]), x3 + 2 * (s * w[2] + u[2])


def move_point(m: ArrayLike, x: ArrayLike) -> Array:
    """Return R x + t = x + 2(s w + w × a − p a), w = x × a − b: M P M~ in coordinates.

    [IK] eq. 10, 25.

    Args:
        m: unit motor, `(..., 8)`.
        x: Euclidean coordinates, `(..., 3)`.

    Returns:
        `(..., 3)`.
    """
    s, a1, a2, a3, b1, b2, b3, p = components(m, 8, "move_point")
    x1, x2, x3 = components(x, 3, "move_point")
    w1 = x2 * a3 - x3 * a2 - b1
    w2 = x3 * a1 - x1 * a3 - b2
    w3 = x1 * a2 - x2 * a1 - b3
    return pack(
        x1 + 2 * (s * w1 + w2 * a3 - w3 * a2 - p * a1),
        x2 + 2 * (s * w2 + w3 * a1 - w1 * a3 - p * a2),
        x3 + 2 * (s * w3 + w1 * a2 - w2 * a1 - p * a3),
    )


def move_vector(m: ArrayLike, v5: ArrayLike) -> Array:
    """Return M X M~ of a point, sphere or plane X = n + α e∞ + β e0.

    n′ = R n + β t, α′ = α + ½ t · (n′ + R n), β′ = β.

    Args:
        m: unit motor, `(..., 8)`.
        v5: `(..., 5)`.

    Returns:
        `(..., 5)`.
    """
    motor = components(m, 8, "move_vector")
    vector = components(v5, 5, "move_vector")
    alpha, beta = vector[3], vector[4]
    r1, r2, r3 = _rotate(motor, vector[:3])
    t1, t2, t3 = translation_parts(motor)
    n1, n2, n3 = r1 + beta * t1, r2 + beta * t2, r3 + beta * t3
    lift = 0.5 * (t1 * (n1 + r1) + t2 * (n2 + r2) + t3 * (n3 + r3))
    return pack(n1, n2, n3, alpha + lift, beta)


def _move_screw(m: ArrayLike, screw: ArrayLike, name: str) -> Array:
    """Return (R f, R g + t × R f) for six screw coordinates (free vector f, moment g)."""
    motor = components(m, 8, name)
    coordinates = components(screw, 6, name)
    free = _rotate(motor, coordinates[:3])
    g1, g2, g3 = _rotate(motor, coordinates[3:])
    c1, c2, c3 = cross3(translation_parts(motor), free)
    return pack(*free, g1 + c1, g2 + c2, g3 + c3)


def move_line(m: ArrayLike, line: ArrayLike) -> Array:
    """Return M Λ M~ of a line: (R n, R μ + t × R n).

    Args:
        m: unit motor, `(..., 8)`.
        line: Plücker coordinates (direction n, moment μ = x × n), `(..., 6)`.

    Returns:
        `(..., 6)`.
    """
    return _move_screw(m, line, "move_line")


def adjoint_twist(m: ArrayLike, twist: ArrayLike) -> Array:
    """Return the twist M B M~: (R ω, R v + t × R ω), so M exp(B) M~ = exp(M B M~).

    Args:
        m: unit motor, `(..., 8)`.
        twist: (ω, v), `(..., 6)`.

    Returns:
        `(..., 6)`.
    """
    return _move_screw(m, twist, "adjoint_twist")


def rate(twist: ArrayLike, v5: ArrayLike) -> Array:
    """Return the rate at which a twist moves a point, sphere or plane X = n + α e∞ + β e0.

    n′ = ω × n + β v, α′ = v · n, β′ = 0: the commutator product of the twist's bivector with X.

    Args:
        twist: (ω, v), `(..., 6)`.
        v5: `(..., 5)`.

    Returns:
        `(..., 5)`.
    """
    b = components(twist, 6, "rate")
    n1, n2, n3, _, beta = components(v5, 5, "rate")
    w1, w2, w3 = cross3(b[:3], (n1, n2, n3))
    v1, v2, v3 = b[3:]
    return pack(w1 + beta * v1, w2 + beta * v2, w3 + beta * v3,
                v1 * n1 + v2 * n2 + v3 * n3, 0.0 * (beta + v1))


def leg_line(P: ArrayLike, S: ArrayLike) -> Array:
    """Return the line Λ = P∧S∧e∞ through the contact P along the normal of the surface S.

    Λ = e0∧n∧e∞ + μ·(e23, e31, e12)∧e∞ with n = P0 S⃗ − S0 P⃗ and μ = P⃗ × S⃗ (arrows: the
    e1, e2, e3 parts).  For a normalised point on a sphere n = c − x, for a plane n is its normal.

    Moving P by the twist B changes P · S at the rate `pair(leg_line(P, S), B)`, for spheres and
    planes alike, on the surface and off it; moving S by B changes it by the negative of that
    ([IK] eq. 32, 49 are rows of this kind).

    Args:
        P: point, `(..., 5)`.
        S: sphere or plane, `(..., 5)`.

    Returns:
        Plücker coordinates (direction, moment), `(..., 6)`.
    """
    p1, p2, p3, _, p0 = components(P, 5, "leg_line")
    s1, s2, s3, _, s0 = components(S, 5, "leg_line")
    return pack(
        p0 * s1 - s0 * p1,
        p0 * s2 - s0 * p2,
        p0 * s3 - s0 * p3,
        *cross3((p1, p2, p3), (s1, s2, s3)),
    )


def pair(line: ArrayLike, twist: ArrayLike) -> Array:
    """Return ⟨Λ, B⟩ = n · v + μ · ω: the power of a unit force along the line on the twist.

    Args:
        line: (direction n, moment μ), `(..., 6)`.
        twist: (ω, v), `(..., 6)`.

    Returns:
        `(...)`.
    """
    line = as_array(line, 6, "pair")
    twist = as_array(twist, 6, "pair")
    swapped = np.concatenate((twist[..., 3:], twist[..., :3]), axis=-1)
    out: Array = np.einsum("...i,...i->...", line, swapped)
    return out
