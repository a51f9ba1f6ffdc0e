"""Directions of a limb: unit vectors, and the small rotation that is their error.

A limb holds its directions as constants d (``base.axis``, and maybe ``base.zero``) and its
error as three parameters r = (rx, ry, rz), a rotation vector in base axes: the machine's
direction is Rot(r) d. A file writes the machine's direction as ``value`` and the nominal one
as ``nominal``. Read back, the constants are ``value``, r is 0, and the parameters' *nominal*
is the rotation vector n with Rot(n) value = nominal; so a mechanism with every parameter at
its nominal is still the nominal machine. A limb whose joint frames are parameters too keeps r apart
in the file (``rotation``), because those frames turn with the constants' own axes; so does one with
an offset universal joint, and that joint's axis.
"""

from __future__ import annotations

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.linalg import Array

SQUARE_TOLERANCE = 2e-3


def unit(vector: list[float], where: str) -> Array:
    """Return a direction (3,) with length 1; already normalised ones stay as they are."""
    v = np.asarray(vector, dtype=float)
    largest = float(np.max(np.abs(v)))
    if largest < 1e-150:
        raise BadInput("a direction of length zero points nowhere", where,
                       "Write a vector such as [0, 0, 1]")
    v = v if 1e-3 < largest < 1e3 else v / largest
    norm = float(np.sqrt(v @ v))
    return v if abs(norm - 1.0) <= 4e-16 else _settle(v / norm)


def _settle(v: Array) -> Array:
    """Normalise until it changes nothing, so that what is written reads back equal."""
    for _ in range(4):
        norm = float(np.sqrt(v @ v))
        if abs(norm - 1.0) <= 4e-16:
            break
        v = v / norm
    return v


def square(zero: Array, axis: Array, where: str, name: str = "base.zero",
           other: str = "base.axis") -> Array:
    """Return ``zero`` (3,) made exactly perpendicular to ``axis`` (3,), by their names.

    Raises:
        BadInput: they are further than 2e-3 rad from perpendicular.
    """
    along = float(zero @ axis)
    if abs(along) > SQUARE_TOLERANCE:
        angle = float(np.degrees(np.arccos(np.clip(along, -1.0, 1.0))))
        what = "the arm's direction at u = 0" if name == "base.zero" else "it"
        raise BadInput(f"{name} is not perpendicular to {other} (they are {angle:.3f} deg "
                       "apart)", where, f"Give {what}, at right angles to the axis")
    for _ in range(4):
        if abs(float(zero @ axis)) <= 4e-16:
            break
        zero = zero - float(zero @ axis) * axis
        zero = _settle(zero / np.sqrt(zero @ zero))
    return zero


def rotation(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,), rad."""
    t = float(np.sqrt(vector @ vector))
    k = np.array([[0.0, -vector[2], vector[1]], [vector[2], 0.0, -vector[0]],
                  [-vector[1], vector[0], 0.0]])
    if t < 1e-4:
        a, b = 1.0 - t * t / 6.0, 0.5 - t * t / 24.0
    else:
        a, b = np.sin(t) / t, (1.0 - np.cos(t)) / (t * t)
    return np.asarray(np.eye(3) + a * k + b * (k @ k), dtype=float)


def log_rotation(matrix: Array) -> Array:
    """Return the rotation vector (3,) of a rotation matrix, for angles below pi."""
    w = 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0],
                        matrix[1, 0] - matrix[0, 1]])
    sine = float(np.sqrt(w @ w))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(matrix) - 1.0)))
    return w if sine < 1e-12 else w * (angle / sine)


def between(start: Array, end: Array) -> Array:
    """Return the smallest rotation vector (3,) that carries ``start`` onto ``end``."""
    cross = np.cross(start, end)
    sine = float(np.sqrt(cross @ cross))
    angle = float(np.arctan2(sine, start @ end))
    if sine < 1e-12:
        if start @ end > 0.0:
            return np.asarray(cross, dtype=float)
        across = np.cross(start, np.eye(3)[int(np.argmin(np.abs(start)))])
        return np.asarray(np.pi * across / np.sqrt(across @ across), dtype=float)
    return np.asarray(cross * (angle / sine), dtype=float)


def frame(axis: Array, zero: Array) -> Array:
    """Return the matrix with columns zero, axis x zero, axis."""
    return np.stack([zero, np.cross(axis, zero), axis], axis=1)


def to_nominal(now: tuple[Array, Array | None], nominal: tuple[Array, Array | None]) -> Array:
    """Return the rotation vector n with Rot(n) now = nominal, for a direction or a pair.

    Each argument is (axis, zero or None); a pair fixes all three components, a single
    direction leaves the turn about itself out.
    """
    if all(np.array_equal(a, b) for a, b in zip(now, nominal, strict=True)
           if a is not None and b is not None):
        return np.zeros(3)
    if now[1] is None or nominal[1] is None:
        return between(now[0], nominal[0])
    return log_rotation(frame(nominal[0], nominal[1]) @ frame(now[0], now[1]).T)
