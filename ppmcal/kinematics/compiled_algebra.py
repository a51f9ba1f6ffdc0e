"""Motors and small linear systems, one at a time, for compiled loops.

The motors are those of :mod:`ppmcal.algebra`, the systems those of `linalg.solve_blocks`.
"""

from __future__ import annotations

import math

from ppmcal.kinematics.compilation import part
from ppmcal.linalg import Array, Ints

INVERTED = 1e-300
"""A is singular if a pivot is below this."""


@part
def factorise(A: Array, order: Ints) -> float:
    """Replace A (d, d) by its L and U with partial pivoting; return the sign of its determinant.

    0 if it is singular, nan if it is not a number: then ``order`` (d,) is incomplete, and
    nothing can be solved with it.
    """
    d, sign = A.shape[0], 1.0
    for k in range(d):
        best, at = abs(A[k, k]), k
        for i in range(k + 1, d):
            if abs(A[i, k]) > best:
                best, at = abs(A[i, k]), i
        order[k] = at
        if not best > INVERTED:
            return 0.0 if best == best else math.nan
        if at != k:
            sign = -sign
            for j in range(d):
                A[k, j], A[at, j] = A[at, j], A[k, j]
        if A[k, k] < 0.0:
            sign = -sign
        inverse = 1.0 / A[k, k]
        for i in range(k + 1, d):
            f = A[i, k] * inverse
            A[i, k] = f
            for j in range(k + 1, d):
                A[i, j] -= f * A[k, j]
    return sign


@part
def solve_factorised(A: Array, order: Ints, x: Array) -> None:
    """Replace x (d,) by the solution of A x = x."""
    d = A.shape[0]
    for k in range(d):
        at = order[k]
        x[k], x[at] = x[at], x[k]
    for k in range(d):
        for i in range(k + 1, d):
            x[i] -= A[i, k] * x[k]
    for k in range(d - 1, -1, -1):
        for j in range(k + 1, d):
            x[k] -= A[k, j] * x[j]
        x[k] /= A[k, k]


@part
def solve_transposed(A: Array, order: Ints, X: Array) -> None:
    """Replace the columns of X (d, m) by the solutions of A^T x = x."""
    d, m = X.shape
    for k in range(d):
        for j in range(k):
            f = A[j, k]
            for i in range(m):
                X[k, i] -= f * X[j, i]
        f = 1.0 / A[k, k]
        for i in range(m):
            X[k, i] *= f
    for k in range(d - 1, -1, -1):
        for j in range(k + 1, d):
            f = A[j, k]
            for i in range(m):
                X[k, i] -= f * X[j, i]
    for k in range(d - 1, -1, -1):
        at = order[k]
        if at != k:
            for i in range(m):
                X[k, i], X[at, i] = X[at, i], X[k, i]


@part
def unpack(motor: Array, quaternion: Array, R: Array, t: Array) -> None:
    """Fill rotor (4,), rotation (9,) and translation (3,) of a motor (8,)."""
    s, x, y, z, b1, b2, b3, p = (motor[0], motor[1], motor[2], motor[3], motor[4], motor[5],
                                 motor[6], motor[7])
    quaternion[0], quaternion[1], quaternion[2], quaternion[3] = s, x, y, z
    t[0] = -2.0 * (s * b1 + p * x + b2 * z - b3 * y)
    t[1] = -2.0 * (s * b2 + p * y + b3 * x - b1 * z)
    t[2] = -2.0 * (s * b3 + p * z + b1 * y - b2 * x)
    rotation(quaternion, R)


@part
def rotation(quaternion: Array, R: Array) -> None:
    """Fill the rotation (9,), row by row, of a rotor s + a (4,)."""
    s, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    R[0], R[1], R[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + s * z), 2.0 * (x * z - s * y)
    R[3], R[4], R[5] = 2.0 * (x * y - s * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + s * x)
    R[6], R[7], R[8] = 2.0 * (x * z + s * y), 2.0 * (y * z - s * x), 1.0 - 2.0 * (x * x + y * y)


@part
def turn(quaternion: Array, w1: float, w2: float, w3: float) -> None:
    """Turn a rotor (4,) by a rotation vector, base axes."""
    angle = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    half = 0.5 * angle
    sinc = math.sin(half) / half if half > 1e-4 else 1.0 - half * half / 6.0
    s, a1, a2, a3 = math.cos(half), -0.5 * sinc * w1, -0.5 * sinc * w2, -0.5 * sinc * w3
    q, c1, c2, c3 = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    quaternion[0] = s * q - a1 * c1 - a2 * c2 - a3 * c3
    quaternion[1] = s * c1 + a1 * q - a2 * c3 + a3 * c2
    quaternion[2] = s * c2 + a2 * q - a3 * c1 + a1 * c3
    quaternion[3] = s * c3 + a3 * q - a1 * c2 + a2 * c1


@part
def displace(step: Array, turns: bool, quaternion: Array, R: Array, t: Array) -> None:
    """Move rotor (4,), rotation (9,) and translation (3,) by a step (6,), base axes.

    ``turns``: whether the platform can rotate.
    """
    for i in range(3):
        t[i] += step[i]
    if turns:
        turn(quaternion, step[3], step[4], step[5])
        rotation(quaternion, R)


@part
def pack(quaternion: Array, t: Array, motor: Array) -> None:
    """Fill the motor T R (8,) of a rotor (4,) and a translation (3,)."""
    s, a1, a2, a3 = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    b1, b2, b3 = -0.5 * t[0], -0.5 * t[1], -0.5 * t[2]
    motor[0], motor[1], motor[2], motor[3] = s, a1, a2, a3
    motor[4] = b1 * s - b2 * a3 + b3 * a2
    motor[5] = b2 * s - b3 * a1 + b1 * a3
    motor[6] = b3 * s - b1 * a2 + b2 * a1
    motor[7] = b1 * a1 + b2 * a2 + b3 * a3
