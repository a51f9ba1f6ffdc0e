"""Euler angles and quaternions of rotations, in SciPy's conventions.

``euler-xyz`` (small letters) rotates about the fixed axes of the base, first x, then y, then z;
``euler-XYZ`` (capitals) about the axes that rotate along. All twelve orders of each are known,
including those that name one axis twice (``euler-ZYZ``).
"""

from __future__ import annotations

import warnings
from itertools import product
from typing import Any

import numpy as np

from ppmcal.linalg import Array, Bools, finite_rows

ORDERS = tuple("".join(o) for letters in ("xyz", "XYZ") for o in product(letters, repeat=3)
               if o[0] != o[1] != o[2])
CONVENTIONS = ("rotvec", "quat", *(f"euler-{o}" for o in ORDERS))
GIMBAL = 1e-6
"""Gimbal lock: the second angle is within this, rad, of where the others share one axis."""


def from_euler(angles: Array, convention: str) -> Array:
    """Return rotation vectors (N, 3), rad, of Euler angles (N, 3), rad; nan rows stay nan."""
    from scipy.spatial.transform import Rotation

    out = np.full_like(angles, np.nan)
    good = finite_rows(angles)
    if good.any():
        order = convention.removeprefix("euler-")
        out[good] = Rotation.from_euler(order, angles[good]).as_rotvec()
    return out


def to_euler(vector: Array, convention: str) -> tuple[Array, Bools]:
    """Return Euler angles (N, 3), rad, of rotation vectors (N, 3), and rows in gimbal lock (N,).

    In gimbal lock only the sum or difference of the first and the third angle is known: then the
    third one is 0.
    """
    from scipy.spatial.transform import Rotation

    out = np.full_like(vector, np.nan)
    good = finite_rows(vector)
    if not good.any():
        return out, good
    order: Any = convention.removeprefix("euler-")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        out[good] = Rotation.from_rotvec(vector[good]).as_euler(order)
    proper = order[0] == order[2]
    sine = np.abs(np.sin(out[:, 1]) if proper else np.cos(out[:, 1]))
    with np.errstate(invalid="ignore"):
        locked = good & (sine < GIMBAL) & (out[:, 2] == 0.0)
    return out, locked


def euler_like(vector: Array, named: Array, convention: str) -> tuple[Array, Bools]:
    """Return Euler angles (N, 3), rad, of rotation vectors (N, 3), close to angles named before.

    Every rotation has two sets of angles, in gimbal lock any number: the set closest to
    ``named`` (N, 3) is taken, nan where an angle is not named. Without any, as :func:`to_euler`.

    Returns:
        the angles, and rows in gimbal lock without first and third angle named (N,).
    """
    own, locked = to_euler(vector, convention)
    order = convention.removeprefix("euler-")
    twin = own + np.pi
    twin[:, 1] = -own[:, 1] if order[0] == order[2] else np.pi - own[:, 1]
    sets = [own, twin]
    total, first, third = own[:, 0], named[:, 0], named[:, 2]
    for pair in ((first, total - first), (first, first - total), (total - third, third),
                 (total + third, third)):
        here = locked & np.isfinite(pair[0]) & np.isfinite(pair[1])
        sets.append(np.where(here[:, None], np.stack([pair[0], own[:, 1], pair[1]], axis=1),
                             np.nan))
    best, least = own.copy(), np.full(len(own), np.inf)
    for angles in sets:
        away = np.nansum(np.abs(_within_half_a_turn(angles - named)), axis=1)
        away = np.where(_turned_by(vector, from_euler(angles, convention)) < 10.0 * GIMBAL, away,
                        np.inf)
        nearer = away < least - GIMBAL
        best[nearer], least[nearer] = _within_half_a_turn(angles[nearer]), away[nearer]
    return best, locked & np.isnan(first) & np.isnan(third)


def vector_like(vector: Array, near: Array) -> Array:
    """Return the rotation vectors (N, 3) of the same rotations closest to another one (3,), rad.

    Near half a turn they flip between opposite ends; beyond it each has a second one.

    >>> vector_like(np.array([[-3.0, 0.0, 0.0]]), np.array([3.1, 0.0, 0.0]))[:, 0].round(3).tolist()
    [3.283]
    """
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        other = vector * np.where(angle > 0.0, 1.0 - 2.0 * np.pi / angle, 1.0)
        nearer = np.sum((other - near) ** 2 - (vector - near) ** 2, axis=1, keepdims=True) < 0.0
    return np.where(nearer, other, vector)


def _within_half_a_turn(angles: Array) -> Array:
    return np.asarray(angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi)), dtype=float)


def _turned_by(one: Array, other: Array) -> Array:
    """Return the angle between rotation vectors (N, 3), rad; inf where one is nan."""
    from scipy.spatial.transform import Rotation

    out = np.full(len(one), np.inf)
    good = finite_rows(one) & finite_rows(other)
    if good.any():
        turns = Rotation.from_rotvec(one[good]).inv() * Rotation.from_rotvec(other[good])
        out[good] = turns.magnitude()
    return out


def euler_rates(angles: Array, convention: str) -> Array:
    """Return E (N, 3, 3) of Euler angles (N, 3), rad: angular velocity = E times their rates."""
    from scipy.spatial.transform import Rotation

    order = convention.removeprefix("euler-")
    # the axis of each rotation is carried by those outside it
    outside = (2, 1, 0) if order.islower() else (0, 1, 2)
    out, carried = np.zeros((len(angles), 3, 3)), Rotation.identity(len(angles))
    for i in outside:
        axis = np.eye(3)["xyz".index(order[i].lower())]
        out[:, :, i] = carried.apply(axis)
        carried = carried * Rotation.from_rotvec(angles[:, i, None] * axis)
    return out


def to_quaternion(vector: Array) -> Array:
    """Return quaternions x, y, z, w (N, 4), w >= 0, of rotation vectors (N, 3); nan stays nan."""
    from scipy.spatial.transform import Rotation

    out = np.full((len(vector), 4), np.nan)
    good = finite_rows(vector)
    if good.any():
        out[good] = Rotation.from_rotvec(vector[good]).as_quat(canonical=True)
    return out
