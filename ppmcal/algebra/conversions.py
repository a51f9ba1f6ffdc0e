"""Motors from and to rotation matrices, quaternions and rotation vectors."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.algebra._types import Array, Scalars, as_array, components, pack
from ppmcal.algebra.motors import half_angle, rotor_of


def rotation_matrix(m: ArrayLike) -> Array:
    """Return R with M x M~ = R x for the rotor part of a unit motor.

    Args:
        m: `(..., 8)`.

    Returns:
        `(..., 3, 3)`, columns are the images of e1, e2, e3.
    """
    s, x, y, z = components(m, 8, "rotation_matrix")[:4]
    # the quaternion of s + a is (s, −a)
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    sx, sy, sz = s * x, s * y, s * z
    flat = pack(
        1 - 2 * (yy + zz),
        2 * (xy + sz),
        2 * (xz - sy),
        2 * (xy - sz),
        1 - 2 * (xx + zz),
        2 * (yz + sx),
        2 * (xz + sy),
        2 * (yz - sx),
        1 - 2 * (xx + yy),
    )
    return flat.reshape((*flat.shape[:-1], 3, 3))


def _place(rotor: Iterable[Scalars], t: ArrayLike) -> Array:
    """Return the motor T R of a rotor (s, a), component first, and a translation `(..., 3)`.

    With b = −½ t it is (s, a, s b − b × a, a · b): `compose` without the terms that are zero.
    """
    s, a1, a2, a3 = rotor
    b1, b2, b3 = -0.5 * components(t, 3, "translation")
    return pack(
        s,
        a1,
        a2,
        a3,
        b1 * s - b2 * a3 + b3 * a2,
        b2 * s - b3 * a1 + b1 * a3,
        b3 * s - b1 * a2 + b2 * a1,
        b1 * a1 + b2 * a2 + b3 * a3,
    )


def motor_from_quaternion(quat_xyzw: ArrayLike, t: ArrayLike) -> Array:
    """Return M = T R from a quaternion (x, y, z, w) of any non-zero length.

    Args:
        quat_xyzw: `(..., 4)`, scalar last.
        t: `(..., 3)`.

    Returns:
        Unit motor `(..., 8)`, s = w / |quaternion|.

    Raises:
        ValueError: if a quaternion is zero.
    """
    quaternion = as_array(quat_xyzw, 4, "motor_from_quaternion")
    norm = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    if np.any(norm == 0):
        raise ValueError("motor_from_quaternion got a quaternion of length zero")
    x, y, z, w = components(quaternion / norm, 4, "motor_from_quaternion")
    return _place((w, -x, -y, -z), t)


def motor_from_matrix(R: ArrayLike, t: ArrayLike) -> Array:
    """Return M = T R from a rotation matrix, with s ≥ 0.

    All ten products 4 qᵢqⱼ of the quaternion's components are linear in R; the row of the
    largest component gives the quaternion without a small divisor, even at half a turn.

    Args:
        R: rotation matrix, `(..., 3, 3)`.
        t: `(..., 3)`.

    Returns:
        Unit motor `(..., 8)`.

    Raises:
        ValueError: if R is not `(..., 3, 3)`.
    """
    R = np.asarray(R, dtype=np.float64)
    if R.shape[-2:] != (3, 3):
        raise ValueError(f"motor_from_matrix needs R of shape (..., 3, 3), got {R.shape}")
    products = np.empty((*R.shape[:-2], 4, 4))
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    for index, signs in enumerate(((1, -1, -1), (-1, 1, -1), (-1, -1, 1), (1, 1, 1))):
        products[..., index, index] = 1 + signs[0] * xx + signs[1] * yy + signs[2] * zz
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[..., i, j] = products[..., j, i] = R[..., i, j] + R[..., j, i]
        products[..., k, 3] = products[..., 3, k] = R[..., j, i] - R[..., i, j]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return motor_from_quaternion(np.where(row[..., 3:] < 0, -row, row), t)


def rotation_vector(m: ArrayLike) -> Array:
    """Return the rotation vector (unit axis times angle in [0, π]) of a unit motor.

    Args:
        m: `(..., 8)`; M and −M give the same vector.

    Returns:
        `(..., 3)`.
    """
    s, a1, a2, a3 = components(m, 8, "rotation_vector")[:4]
    factor = np.where(s < 0, 2.0, -2.0) * half_angle(np.abs(s), (a1, a2, a3))[1]
    return pack(factor * a1, factor * a2, factor * a3)


def motor_from_rotation_vector(rvec: ArrayLike, t: ArrayLike) -> Array:
    """Return M = T R from a rotation vector and a translation.

    Args:
        rvec: axis times angle, `(..., 3)`.
        t: `(..., 3)`.

    Returns:
        Unit motor `(..., 8)`.
    """
    return _place(rotor_of(as_array(rvec, 3, "motor_from_rotation_vector")), t)
