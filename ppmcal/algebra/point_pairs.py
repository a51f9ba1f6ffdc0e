"""Point pairs: the intersection of three spheres or planes, as a bivector of 10 blades.

Storage: (e23, e31, e12, e1∞, e2∞, e3∞, e10, e20, e30, e∞0), written F = (f, g, h, z).  Real pairs
are F = λ P₊∧P₋ with λ > 0: h is along P₊ − P₋, F² = z² + 2 g·h − f².
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.algebra._types import Array, Scalars, as_array, components, cross3, dot3, pack


def _pivoted(surfaces: list[Array]) -> list[Array]:
    """Permute the three surfaces cyclically so that the first has the largest e0 component.

    Cyclic order keeps the sign of the outer product.  Spheres of equal scale stay in place.
    """
    weights = np.abs([surface[4] for surface in surfaces])
    if np.all(weights[0] >= weights[1]) and np.all(weights[0] >= weights[2]):
        return surfaces
    order = np.argmax(weights, axis=0) + np.arange(3).reshape((3,) + (1,) * (weights.ndim - 1))
    turned = np.take_along_axis(np.stack(surfaces), order[:, None] % 3, axis=0)
    return list(turned)


def _difference(surface: Array, first: Array) -> tuple[Array, Scalars]:
    """Return (n, d) of the plane in which a surface meets the first: surface − (β/β₁) first."""
    scale = surface[4] / np.where(first[4] == 0, 1.0, first[4])
    plane = surface - scale * first
    return plane[:3], plane[3]


def meet(s1: ArrayLike, s2: ArrayLike, s3: ArrayLike) -> Array:
    """Return the point pair (S1∧S2∧S3) I⁻¹, with I = e123∞0 ([PPM] eq. 17).

    One sphere is subtracted from the other two first, which changes nothing in the product:
    S1∧S2∧S3 = S1∧π2∧π3 with planes π = n + d e∞.  With N = n2 × n3, D = d3 n2 − d2 n3 and
    S1 = c + α e∞ + β e0: f = −βD, g = −(c × D + αN), h = βN, z = c · N.

    Args:
        s1: sphere or plane, `(..., 5)`.
        s2: sphere or plane, `(..., 5)`.
        s3: sphere or plane, `(..., 5)`.

    Returns:
        `(..., 10)`.  Spheres with e0 component +1: P₊ lies on the side of
        (c2 − c1) × (c3 − c1).
    """
    surfaces = np.broadcast_arrays(*(as_array(s, 5, "meet") for s in (s1, s2, s3)))
    first, second, third = _pivoted([components(s, 5, "meet") for s in surfaces])
    n2, d2 = _difference(second, first)
    n3, d3 = _difference(third, first)
    center, alpha, beta = first[:3], first[3], first[4]
    N = cross3(n2, n3)
    D = (d3 * n2[0] - d2 * n3[0], d3 * n2[1] - d2 * n3[1], d3 * n2[2] - d2 * n3[2])
    turn = cross3(center, D)
    return pack(
        *(-beta * part for part in D),
        *(-part - alpha * normal for part, normal in zip(turn, N, strict=True)),
        *(beta * normal for normal in N),
        dot3(center, N),
    )


def _square(rows: Array) -> Scalars:
    """Return the scalar F² = z² + 2 g·h − f²."""
    f, g, h, z = rows[:3], rows[3:6], rows[6:9], rows[9]
    return z * z + 2 * dot3(g, h) - dot3(f, f)


def _length_squared(rows: Array) -> Scalars:
    """Return h², the squared length of e∞⌋F; nan where it is zero and there is no pair."""
    square = dot3(rows[6:9], rows[6:9])
    return np.where(square == 0, np.nan, square)


def _middle(rows: Array, length_squared: Scalars) -> list[Scalars]:
    """Return the midpoint (f × h + z h) / h²."""
    h, z = rows[6:9], rows[9]
    turned = cross3(rows[:3], h)
    return [(part + z * along) / length_squared for part, along in zip(turned, h, strict=True)]


def split(pair: ArrayLike) -> tuple[Array, Array, Array]:
    """Return the two points of a pair, P± = (−F·u ± √F² u) / u² with u = e∞⌋F ([PPM] eq. 5).

    In coordinates: the midpoint ± h √F² / h²; nothing cancels.

    Args:
        pair: bivector, `(..., 10)`.

    Returns:
        P_plus `(..., 5)` and P_minus `(..., 5)`, normalised (e0 component 1), nan where the pair
        is imaginary or has no two finite points; the discriminant F² `(...)`, positive where
        the pair is real, zero at tangency (up to round-off of either sign).
    """
    rows = components(pair, 10, "split")
    discriminant = np.asarray(_square(rows))
    length_squared = _length_squared(rows)
    center = _middle(rows, length_squared)
    step = np.sqrt(np.where(discriminant < 0, np.nan, discriminant)) / length_squared
    half = [step * along for along in rows[6:9]]
    plus = [c + offset for c, offset in zip(center, half, strict=True)]
    minus = [c - offset for c, offset in zip(center, half, strict=True)]
    one = np.where(np.isnan(step), np.nan, 1.0)
    return (
        pack(*plus, 0.5 * dot3(plus, plus), one),
        pack(*minus, 0.5 * dot3(minus, minus), one),
        discriminant,
    )


def middle(pair: ArrayLike) -> Array:
    """Return the midpoint of a pair, real or imaginary: the platform centre of [PPM] eq. 17-19.

    Args:
        pair: bivector, `(..., 10)`.

    Returns:
        `(..., 3)`; nan where the surfaces do not meet in a pair (two of them parallel or
        concentric, or three planes).
    """
    rows = components(pair, 10, "middle")
    return pack(*_middle(rows, _length_squared(rows)))


def pair_radius_squared(pair: ArrayLike) -> Array:
    """Return the squared half distance of the two points, F² / h²; negative if imaginary.

    Args:
        pair: bivector, `(..., 10)`.

    Returns:
        `(...)`; nan where the surfaces do not meet in a pair.
    """
    rows = components(pair, 10, "pair_radius_squared")
    return np.asarray(_square(rows) / _length_squared(rows))
