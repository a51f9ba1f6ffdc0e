"""Motors: rigid displacements as even elements M = T R, object ↦ M X M~ ([IK] eq. 9, 10).

Storage: 8 blades (1, e23, e31, e12, e1∞, e2∞, e3∞, e123∞), written (s, a, p = b, c) below as
M = s + a·(e23, e31, e12) + b·(e1, e2, e3) e∞ + p e123∞.  A unit motor has s² + |a|² = 1 and
s p = a · b; M and −M are the same displacement.

Twist: (ω, v), the velocity field x ↦ v + ω × x, is the bivector
B = −½ ω·(e23, e31, e12) − ½ v·(e1, e2, e3) e∞.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.algebra._types import Array, Scalars, as_array, components, cross3, dot3, pack

_REVERSE: Array = np.array([1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0, 1.0])
_TAYLOR_BELOW = 1e-2


def identity_motor(shape: tuple[int, ...] = ()) -> Array:
    """Return the motor 1, for every element of a batch: `(*shape, 8)`."""
    out = np.zeros((*shape, 8))
    out[..., 0] = 1.0
    return out


def translator(t: ArrayLike) -> Array:
    """Return T = 1 − ½ t e∞, which moves x to x + t ([IK] eq. 7, [PPM] eq. 11).

    Args:
        t: `(..., 3)`.

    Returns:
        `(..., 8)`.
    """
    t = as_array(t, 3, "translator")
    out = identity_motor(t.shape[:-1])
    out[..., 4:7] = -0.5 * t
    return out


def rotor(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Return R = cos(θ/2) − L sin(θ/2) about an axis through the origin ([IK] eq. 8, [PPM] eq. 9).

    L = axis·(e23, e31, e12); the turn is right-handed about the axis.

    Args:
        axis: unit vector, `(..., 3)`.
        angle: θ in rad, `(...)`.

    Returns:
        `(..., 8)`.
    """
    axis = as_array(axis, 3, "rotor")
    half = 0.5 * np.asarray(angle, dtype=np.float64)
    out = np.zeros((*np.broadcast_shapes(axis.shape[:-1], half.shape), 8))
    out[..., 0] = np.cos(half)
    out[..., 1:4] = -np.sin(half)[..., None] * axis
    return out


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the geometric product a b: the displacement b, then a ([IK] eq. 9).

    Args:
        a: `(..., 8)`.
        b: `(..., 8)`.

    Returns:
        `(..., 8)`.
    """
    s, a1, a2, a3, b1, b2, b3, p = components(a, 8, "compose")
    t, c1, c2, c3, d1, d2, d3, q = components(b, 8, "compose")
    return pack(
        s * t - a1 * c1 - a2 * c2 - a3 * c3,
        s * c1 + a1 * t - a2 * c3 + a3 * c2,
        s * c2 + a2 * t - a3 * c1 + a1 * c3,
        s * c3 + a3 * t - a1 * c2 + a2 * c1,
        s * d1 + b1 * t - a1 * q - p * c1 - a2 * d3 + a3 * d2 - b2 * c3 + b3 * c2,
        s * d2 + b2 * t - a2 * q - p * c2 - a3 * d1 + a1 * d3 - b3 * c1 + b1 * c3,
        s * d3 + b3 * t - a3 * q - p * c3 - a1 * d2 + a2 * d1 - b1 * c2 + b2 * c1,
        s * q + p * t + a1 * d1 + a2 * d2 + a3 * d3 + b1 * c1 + b2 * c2 + b3 * c3,
    )


def reverse(m: ArrayLike) -> Array:
    """Return M~, for a unit motor the inverse displacement: `(..., 8)` to `(..., 8)`."""
    return as_array(m, 8, "reverse") * _REVERSE


def normalise(m: ArrayLike) -> Array:
    """Return the corresponding unit motor: M M~ = 1, in both its scalar and its e123∞ part.

    With q = (s, a) and its partner d: q / |q|, then the part of d along q is removed, so that
    `translation` gives the same result as before.

    Args:
        m: motor with round-off or of any scale, `(..., 8)`; (s, a) must not vanish.

    Returns:
        `(..., 8)`.
    """
    m = as_array(m, 8, "normalise")
    norm_squared: Array = np.einsum("...i,...i->...", m[..., :4], m[..., :4])
    # M M~ = |q|² + 2 e123∞ (s p − a · b)
    slip: Array = m[..., 0] * m[..., 7] - np.einsum("...i,...i->...", m[..., 1:4], m[..., 4:7])
    slip = (slip / norm_squared)[..., None]
    out: Array = m.copy()
    out[..., 4:7] += slip * m[..., 1:4]
    out[..., 7:] -= slip * m[..., :1]
    out /= np.sqrt(norm_squared)[..., None]
    return out


def _sinc(phi: Scalars) -> Scalars:
    """Return S = sin φ / φ, by its series near zero."""
    square = phi * phi
    small = square < _TAYLOR_BELOW
    safe, x = np.where(small, 1.0, phi), np.where(small, square, 0.0)
    series = 1 - x / 6 * (1 - x / 20 * (1 - x / 42 * (1 - x / 72)))
    return np.where(small, series, np.sin(safe) / safe)


def _sinc_and_slope(phi: Scalars) -> tuple[Scalars, Scalars]:
    """Return S and C = (cos φ − S) / φ² = S′/φ, by their series near zero."""
    square, sinc = phi * phi, _sinc(phi)
    small = square < _TAYLOR_BELOW
    safe, x = np.where(small, 1.0, phi), np.where(small, square, 0.0)
    slope = (np.cos(safe) - sinc) / (safe * safe)
    series = -(1 - x / 10 * (1 - x / 28 * (1 - x / 54 * (1 - x / 88)))) / 3
    return sinc, np.where(small, series, slope)


def motor_exp(twist: ArrayLike) -> Array:
    """Return M = exp(B), the finite screw motion of the twist.

    With φ = |ω|/2, S = sin φ/φ, C = S′/φ:
    s = cos φ, a = −½Sω, b = −½S v − ⅛C(ω·v) ω, p = ¼S(ω·v).

    Args:
        twist: (ω, v), `(..., 6)`.

    Returns:
        `(..., 8)`; the rotation is by |ω| rad.
    """
    w1, w2, w3, v1, v2, v3 = components(twist, 6, "motor_exp")
    phi = 0.5 * np.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    sinc, slope = _sinc_and_slope(phi)
    pitch = w1 * v1 + w2 * v2 + w3 * v3
    half = -0.5 * sinc
    along = -0.125 * slope * pitch
    return pack(
        np.cos(phi),
        half * w1,
        half * w2,
        half * w3,
        half * v1 + along * w1,
        half * v2 + along * w2,
        half * v3 + along * w3,
        -0.5 * half * pitch,
    )


def rotor_of(rotation: ArrayLike) -> tuple[Scalars, Scalars, Scalars, Scalars]:
    """Return (s, a) of `motor_exp(rotation, 0)`, component first.

    Args:
        rotation: ω, `(..., 3)`.

    Returns:
        four arrays `(...)`.
    """
    w1, w2, w3 = components(rotation, 3, "rotor_of")
    phi = 0.5 * np.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    half = -0.5 * _sinc(phi)
    return np.cos(phi), half * w1, half * w2, half * w3


def rotated(m: ArrayLike, rotation: ArrayLike) -> Array:
    """Return the rotor of `m` followed by a rotation: that of `motor_exp(rotation, 0) m`.

    Args:
        m: motor, `(..., 8)`; its translation is ignored.
        rotation: ω, `(..., 3)`.

    Returns:
        `(..., 8)`, without translation.
    """
    s, a1, a2, a3 = rotor_of(rotation)
    t, c1, c2, c3 = components(m, 8, "rotated")[:4]
    out = np.zeros((*np.broadcast(s, t).shape, 8))
    out[..., 0] = s * t - a1 * c1 - a2 * c2 - a3 * c3
    out[..., 1] = s * c1 + a1 * t - a2 * c3 + a3 * c2
    out[..., 2] = s * c2 + a2 * t - a3 * c1 + a1 * c3
    out[..., 3] = s * c3 + a3 * t - a1 * c2 + a2 * c1
    return out


def half_angle(s: Scalars, a: Scalars) -> tuple[Scalars, Scalars]:
    """Return φ = θ/2 in [0, π/2] and φ / sin φ of the unit rotor s + a, s ≥ 0."""
    sine = np.sqrt(dot3(a, a))
    phi = np.arctan2(sine, s)
    small = sine < 1e-8
    ratio = phi / np.where(small, 1.0, sine)
    return phi, np.where(small, 1.0 + phi * phi / 6, ratio)


def motor_log(motor: ArrayLike) -> Array:
    """Return the twist of a unit motor, rotation angle in [0, π]; inverse of `motor_exp`.

    M and −M give the same twist.  With K = φ/sin φ and C as in `motor_exp`:
    ω = −2K a, v = 2K(K²C p a − b).

    Args:
        motor: unit motor, `(..., 8)`.

    Returns:
        (ω, v), `(..., 6)`.
    """
    s, a1, a2, a3, b1, b2, b3, p = components(motor, 8, "motor_log")
    phi, ratio = half_angle(np.abs(s), (a1, a2, a3))
    slope = _sinc_and_slope(phi)[1]
    twice = np.where(s < 0, -2.0, 2.0) * ratio
    along = 2 * ratio**3 * slope * p  # p a has the same sign for M and −M
    return pack(
        -twice * a1,
        -twice * a2,
        -twice * a3,
        along * a1 - twice * b1,
        along * a2 - twice * b2,
        along * a3 - twice * b3,
    )


def translation(m: ArrayLike) -> Array:
    """Return t of the unit motor M = T R: t = −2(s b + p a + b × a), the image of the origin.

    Args:
        m: `(..., 8)`.

    Returns:
        `(..., 3)`.
    """
    m = components(m, 8, "translation")
    return pack(*translation_parts(m))


def translation_parts(m: Array) -> tuple[Scalars, Scalars, Scalars]:
    """Return the three components of the translation of a component-first motor `(8, ...)`."""
    s, a1, a2, a3, b1, b2, b3, p = m
    c1, c2, c3 = cross3((b1, b2, b3), (a1, a2, a3))
    return (
        -2 * (s * b1 + p * a1 + c1),
        -2 * (s * b2 + p * a2 + c2),
        -2 * (s * b3 + p * a3 + c3),
    )
