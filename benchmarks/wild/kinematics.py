"""Loop closure of limbs with one rod: struts, sliders and cranks; forward and inverse.

Arrays: N rows, L limbs, d coordinates of motion. Lengths mm, angles rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

COLUMNS = {"planar": [0, 1, 5], "translational": [0, 1, 2], "spatial": [0, 1, 2, 3, 4, 5]}

CLOSED = 1e-12 * 1e3
"""Closure error (mm) at which a pose is found."""


@dataclass(frozen=True)
class Geometry:
    """Limbs; every array leads with 1 or N rows: points (., L, 3), numbers (., L).

    ``closure`` is strut (the rod is the actuator), slider (the rod hangs from a carriage) or
    crank (the rod hangs from an arm). ``u_axis`` and ``u_gap`` are the first axis of the
    universal joint at the rod's base end and the distance between its two axes (mm).
    """

    closure: str
    base: np.ndarray
    platform: np.ndarray
    axis: np.ndarray
    zero: np.ndarray
    proximal: np.ndarray
    length: np.ndarray
    offset: np.ndarray
    branch: np.ndarray
    u_axis: np.ndarray
    u_gap: np.ndarray

    def turned(self, turn: np.ndarray) -> Geometry:
        """Axes and zero directions turned by rotation vectors (L, 3), rad."""
        rot = Rotation.from_rotvec(turn)
        return replace(self, axis=rot.apply(self.axis[0])[None], zero=rot.apply(self.zero[0])[None])


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar product over the last axis."""
    return np.sum(a * b, axis=-1)


def rod_foot(geo: Geometry, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Base end of every rod (N, L, 3) at joint values u (N, L), and its derivative by u."""
    if geo.closure == "strut":
        foot = np.broadcast_to(geo.base, u.shape + (3,))
        return foot, np.zeros_like(foot)
    if geo.closure == "slider":
        way = np.broadcast_to(geo.axis, u.shape + (3,))
        return geo.base + u[..., None] * way, way
    across = np.cross(geo.axis, geo.zero)
    cos, sin, arm = np.cos(u)[..., None], np.sin(u)[..., None], geo.proximal[..., None]
    return geo.base + arm * (cos * geo.zero + sin * across), arm * (cos * across - sin * geo.zero)


def platform_arms(geo: Geometry, rot: np.ndarray) -> np.ndarray:
    """Platform joints from the platform's origin, in base axes (N, L, 3)."""
    points = np.broadcast_to(geo.platform, (len(rot),) + geo.platform.shape[1:])
    return np.einsum("nij,nlj->nli", rot, points)


def closure(geo: Geometry, u: np.ndarray, pos: np.ndarray, rot: np.ndarray) -> tuple:
    """Closure error (N, L) mm, its gradient by the platform joint (N, L, 3), and by u (N, L)."""
    foot, speed = rod_foot(geo, u)
    v = pos[:, None, :] + platform_arms(geo, rot) - foot
    along = dot(v, geo.u_axis)
    radial = v - along[..., None] * geo.u_axis
    r = np.linalg.norm(radial, axis=-1)
    r = np.where(r > 0, r, 1.0)
    keep = 1.0 - geo.u_gap / r
    squared = along**2 + (r - geo.u_gap) ** 2 * (r > 0)
    rod = u if geo.closure == "strut" else np.broadcast_to(geo.length, u.shape)
    grad = (along[..., None] * geo.u_axis + keep[..., None] * radial) / rod[..., None]
    by_u = -np.ones_like(u) if geo.closure == "strut" else -dot(grad, speed)
    return (squared - rod**2) / (2 * rod), grad, by_u


def by_pose(geo: Geometry, grad: np.ndarray, rot: np.ndarray, motion: str) -> np.ndarray:
    """Closure's derivative by the platform's twist at its origin, base axes (N, L, d)."""
    both = np.concatenate([grad, np.cross(platform_arms(geo, rot), grad)], axis=-1)
    return both[..., COLUMNS[motion]]


def moved(pos: np.ndarray, rot: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose after a twist (N, 6) at the platform's origin in base axes (mm, rad)."""
    return pos + twist[:, :3], Rotation.from_rotvec(twist[:, 3:]).as_matrix() @ rot


def forward(
    geo: Geometry, q: np.ndarray, pos: np.ndarray, rot: np.ndarray, motion: str, steps: int = 30
) -> tuple[np.ndarray, np.ndarray]:
    """Pose (N, 3) mm and (N, 3, 3) at joints q (N, L), by Newton from the pose given."""
    return forward_of_each([geo], q, pos, rot, motion, steps)[0]


def _newton(geo: Geometry, u: np.ndarray, pos: np.ndarray, rot: np.ndarray, motion: str) -> tuple:
    """Poses after a step of Newton, and the closure error (N, L) before it."""
    gap, grad, _ = closure(geo, u, pos, rot)
    step = -np.linalg.solve(by_pose(geo, grad, rot, motion), gap[..., None])[..., 0]
    twist = np.zeros((len(u), 6))
    twist[:, COLUMNS[motion]] = step
    return *moved(pos, rot, twist), gap


def forward_of_each(
    machines: Sequence[Geometry], q: np.ndarray, pos: np.ndarray, rot: np.ndarray, motion: str,
    steps: int = 30
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poses of several machines at the same joints, each as :func:`forward` has them.

    Rows of all of them are solved together; those of a machine rest once they are closed.
    """
    count, rows = len(machines), len(q)
    first, arrays = machines[0], [f.name for f in fields(Geometry) if f.name != "closure"]
    stacked = {name: np.concatenate([np.broadcast_to(
        getattr(m, name), (rows, *getattr(m, name).shape[1:])) for m in machines])
        for name in arrays}
    pos, rot, q = (np.concatenate([x] * count) for x in (pos, rot, q))
    left = np.arange(count)
    for _ in range(steps):
        at = (left[:, None] * rows + np.arange(rows)).ravel()
        geo = replace(first, **{name: values[at] for name, values in stacked.items()})
        pos[at], rot[at], gap = _newton(geo, q[at] + geo.offset, pos[at], rot[at], motion)
        left = left[~(np.abs(gap).reshape(len(left), -1).max(axis=1) < CLOSED)]
        if not len(left):
            return [(pos[n:n + rows], rot[n:n + rows]) for n in range(0, count * rows, rows)]
    raise ArithmeticError(f"forward kinematics left {np.max(np.abs(gap)):.3g} mm open")


def _first_joints(geo: Geometry, pos: np.ndarray, rot: np.ndarray) -> np.ndarray:
    w = pos[:, None, :] + platform_arms(geo, rot) - geo.base
    squared = dot(w, w)
    if geo.closure == "strut":
        return np.sqrt(squared)
    if geo.closure == "slider":
        along = dot(w, geo.axis)
        return along + geo.branch * np.sqrt(along**2 - squared + geo.length**2)
    a, b = dot(w, geo.zero), dot(w, np.cross(geo.axis, geo.zero))
    c = (squared + geo.proximal**2 - geo.length**2) / (2 * geo.proximal * np.hypot(a, b))
    start = np.where(geo.axis[..., 2] == 1.0, np.arctan2(-geo.base[..., 1], -geo.base[..., 0]), 0.0)
    turn = (
        np.mod(np.arctan2(b, a) - start + np.pi, 2 * np.pi) - np.pi
    )  # planar: cut behind the base
    return start + turn + geo.branch * np.arccos(c)


def inverse(geo: Geometry, pos: np.ndarray, rot: np.ndarray) -> np.ndarray:
    """Joints q (N, L) at poses (N, 3), (N, 3, 3): closed form, then Newton for joint gaps."""
    u = _first_joints(geo, pos, rot)
    for _ in range(8):
        gap, _, by_u = closure(geo, u, pos, rot)
        u = u - gap / by_u
    return u - geo.offset


def pose_by_joint(geo: Geometry, q: np.ndarray, pos: np.ndarray, rot: np.ndarray, motion: str):
    """Derivative of the pose's twist by the joints (N, d, L)."""
    _, grad, by_u = closure(geo, q + geo.offset, pos, rot)
    rows = by_pose(geo, grad, rot, motion)
    return -np.linalg.solve(rows, by_u[:, :, None] * np.eye(by_u.shape[1]))


def rod_forces(geo: Geometry, q, pos, rot, motion: str, wrench: np.ndarray) -> np.ndarray:
    """Force vector that each rod puts on the platform (N, L, 3), N, under a wrench (N, 6)."""
    _, grad, _ = closure(geo, q + geo.offset, pos, rot)
    rows = by_pose(geo, grad, rot, motion)
    push = np.linalg.solve(np.swapaxes(rows, 1, 2), -wrench[:, COLUMNS[motion], None])[..., 0]
    return push[..., None] * grad
