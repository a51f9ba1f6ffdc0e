"""Grade-1 vectors: points, spheres and planes, (e1, e2, e3, e∞, e0), in the IPNS representation.

A point P lies on a sphere or plane S if and only if P · S = 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.algebra._types import Array, as_array


def point(x: ArrayLike) -> Array:
    """Return the conformal point P = x + ½x² e∞ + e0 ([IK] eq. 5).

    Args:
        x: Euclidean coordinates, `(..., 3)`.

    Returns:
        `(..., 5)` blades (e1, e2, e3, e∞, e0).
    """
    x = as_array(x, 3, "point")
    out = np.empty((*x.shape[:-1], 5))
    out[..., :3] = x
    out[..., 3] = 0.5 * np.einsum("...i,...i->...", x, x)
    out[..., 4] = 1.0
    return out


def coordinates(P: ArrayLike) -> Array:
    """Return the Euclidean coordinates x of a point λP, or the centre of a sphere.

    The vector is divided by its e0 component λ = −P · e∞.

    Args:
        P: point or sphere of any scale, `(..., 5)`.

    Returns:
        `(..., 3)`.
    """
    P = as_array(P, 5, "coordinates")
    return P[..., :3] / P[..., 4:]


def sphere(center: ArrayLike, radius: ArrayLike) -> Array:
    """Return the IPNS sphere S = C − ½ρ² e∞ ([PPM] Table 1); P · S = −½(|x − c|² − ρ²).

    Args:
        center: centre c, `(..., 3)`.
        radius: radius ρ, `(...)`.

    Returns:
        `(..., 5)`.
    """
    return sphere_squared(center, np.square(np.asarray(radius, dtype=np.float64)))


def sphere_squared(center: ArrayLike, radius_squared: ArrayLike) -> Array:
    """Return S = C − ½ρ² e∞ from the squared radius, which may be negative (imaginary sphere).

    Args:
        center: centre c, `(..., 3)`.
        radius_squared: ρ², `(...)`.

    Returns:
        `(..., 5)`.
    """
    center = as_array(center, 3, "sphere")
    half = 0.5 * np.asarray(radius_squared, dtype=np.float64)
    out = np.empty((*np.broadcast_shapes(center.shape[:-1], half.shape), 5))
    out[..., :3] = center
    out[..., 3] = 0.5 * np.einsum("...i,...i->...", center, center) - half
    out[..., 4] = 1.0
    return out


def plane(normal: ArrayLike, distance: ArrayLike) -> Array:
    """Return the IPNS plane π = n + d e∞ ([PPM] Table 1); P · π = n · x − d.

    Args:
        normal: normal n, `(..., 3)`; of unit length if P · π is to be a distance.
        distance: distance d of the plane from the origin along n, `(...)`.

    Returns:
        `(..., 5)`.
    """
    normal = as_array(normal, 3, "plane")
    distance = np.asarray(distance, dtype=np.float64)
    out = np.zeros((*np.broadcast_shapes(normal.shape[:-1], distance.shape), 5))
    out[..., :3] = normal
    out[..., 3] = distance
    return out


def inner(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the scalar product of two vectors: a · b = Σ aᵢbᵢ − a∞ b0 − a0 b∞.

    Two points give −½|p − q|² ([IK] eq. 6, 28, 42); a point and a surface give the closure of a
    limb, zero where the point lies on the surface.

    Args:
        a: `(..., 5)`.
        b: `(..., 5)`.

    Returns:
        `(...)`.
    """
    a = as_array(a, 5, "inner")
    b = as_array(b, 5, "inner")
    out: Array = np.einsum("...i,...i->...", a[..., :3], b[..., :3])
    return out - a[..., 3] * b[..., 4] - a[..., 4] * b[..., 3]
