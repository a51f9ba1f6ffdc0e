"""Kinematics of tables of poses: status row by row, paths checked for singularities.

Two ways to the same platform pose are kept apart on purpose: Newton on the closure
(:mod:`ppmcal.forward`), and [PPM]'s intersection of the limbs' kinematic geometric bodies
(:func:`intersection_pose`), which starts from the closed limbs' end points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.arrays import known
from ppmcal.closure import Model
from ppmcal.conditions import Conditions
from ppmcal.dataset import Dataset
from ppmcal.equilibrium import reach
from ppmcal.forward import conditioning, forward
from ppmcal.inverse import home_state, solve_rows
from ppmcal.mechanism import Mechanism
from ppmcal.targets import LACKING, inverse_partial, pose_motor, pose_vector

Array = NDArray[np.float64]

SINGULAR = 0.02
"""A pose counts as singular below this part of the singular value at home."""


@dataclass(frozen=True)
class Table:
    """Kinematics of N rows.

    Attributes:
        q: joint values (N, k); pose: full poses (N, 6) x, y, z, rotation vector.
        rate: joint rates (N, k), nan where not asked for.
        condition: smallest singular value of A (see :func:`ppmcal.forward.conditioning`).
        status: ``ok``, ``unreachable``, ``limits``, ``singular``, ``crossed``, ``jump`` or
            ``not converged``; reason in words, empty for ``ok``.
    """

    q: Array
    pose: Array
    rate: Array
    condition: Array
    status: tuple[str, ...]
    reason: tuple[str, ...]


def inverse_table(model: Model, coordinates: Array, rows: Conditions | None = None) -> Table:
    """Return joint values of poses (N, 6), nan = open coordinate, as a path in row order.

    ``rows``: the conditions that the machine's effects depend on.
    """
    found = inverse_partial(model, coordinates, rows)
    status = ["ok" if r else "unreachable" for r in found.reached]
    return _judged(model, found.q, found.pose, status, list(found.reason))


def forward_table(model: Model, q: Array, rows: Conditions | None = None) -> Table:
    """Return the poses of joint values (N, k), in home's assembly mode, as a path.

    ``rows``: the conditions that the machine's effects depend on.
    """
    found = forward(model, q)
    status = ["ok" if c else "not converged" for c in found.converged]
    reason = ["" if c else ("joint values missing" if not np.isfinite(row).all() else
              f"no pose: the way from home ends at {p:.0%} of it (singular or out of reach)")
              for c, p, row in zip(found.converged, found.progress, q, strict=True)]
    _mark_jumps(model, q, found.pose, status, reason)
    pose = found.pose
    if model.mechanism.effects:
        pose = reach(model, q, rows, found.pose, q).pose
        for n in np.flatnonzero(known(found.pose) & ~known(pose)):
            status[n], reason[n] = "not converged", LACKING
    return _judged(model, q, pose, status, reason)


def velocity_table(model: Model, coordinates: Array, twist: Array,
                   conditions: Conditions | None = None) -> Table:
    """Return joint rates of poses moving with ``twist`` (N, 6) vx, vy, vz, wx, wy, wz.

    A twist + Jq rate = 0 ([IK] eq. 32 and 49). A machine with fewer actuators than pose
    coordinates takes as many velocity components as it has actuators, the others nan; they
    follow from the closure. Effects (``conditions``) change the joints, not the rates.
    """
    table = inverse_table(model, coordinates, conditions)
    rows = np.flatnonzero([s == "ok" for s in table.status])
    rate = np.full_like(table.q, np.nan)
    status, reason = list(table.status), list(table.reason)
    if rows.size:
        pose = pose_motor(table.pose[rows])
        closure = model.closure(table.q[rows])
        lines = closure.lines(pose)
        a, jq = closure.pose_matrix(pose, lines), closure.joint_matrix(pose, lines)
        given = twist[rows][:, model.mechanism.dof]
        for pattern in np.unique(np.isnan(given), axis=0):
            mine = np.flatnonzero((np.isnan(given) == pattern).all(axis=1))
            if int(pattern.sum()) != a.shape[1] - jq.shape[2] and pattern.any():
                for n in rows[mine]:
                    status[n], reason[n] = "refused", "velocity components are missing"
                continue
            wanted = np.where(np.isnan(given[mine]), 0.0, given[mine])
            right = -(a[mine] @ wanted[..., None])[..., 0]
            if pattern.any():
                unknown = np.concatenate([jq[mine], a[mine][..., pattern]], axis=-1)
                rate[rows[mine]] = solve_rows(unknown, right)[:, :jq.shape[2]]
            else:
                rate[rows[mine]] = (np.linalg.pinv(jq[mine]) @ right[..., None])[..., 0]
    return Table(table.q, table.pose, rate, table.condition, tuple(status), tuple(reason))


def with_joints(mechanism: Mechanism, data: Dataset) -> Dataset:
    """Return the data set with commanded poses turned into joints by the nominal machine.

    Rows that the nominal machine cannot reach keep nan joints, and so are reported later.
    """
    if data.commanded is None:
        return data
    missing = ~known(data.q)
    q = data.q.copy()
    found = inverse_partial(Model(mechanism.nominal()), data.commanded[missing])
    q[missing] = found.q
    return replace(data, q=q)


def _judged(model: Model, q: Array, pose: Array, status: list[str], reason: list[str]) -> Table:
    """Add condition, limits and singularities to rows that have a solution."""
    mechanism = model.mechanism
    condition = np.full(q.shape[0], np.nan)
    rows = np.flatnonzero([s != "unreachable" and s != "not converged" for s in status])
    if rows.size:
        closure = model.closure(q[rows])
        value, sign = conditioning(closure, pose[rows])
        condition[rows] = value
        home_value, home_sign = home_conditioning(mechanism)
        for n, v, s in zip(rows, value, sign, strict=True):
            if status[n] != "ok":
                continue
            if v < SINGULAR * home_value:
                status[n], reason[n] = "singular", f"condition {v:.2g}, {home_value:.2g} at home"
            elif s != home_sign:
                status[n] = "crossed"
                reason[n] = "on the other side of a singularity than home"
            else:
                over = limit_reason(mechanism, q[n])
                if over:
                    status[n], reason[n] = "limits", over
    vector = np.full((q.shape[0], 6), np.nan)
    good = known(pose)
    vector[good] = pose_vector(pose[good])
    return Table(q, vector, np.full_like(q, np.nan), condition, tuple(status), tuple(reason))


def limit_reason(mechanism: Mechanism, q: Array) -> str:
    """Return which joint of one row (k,) is outside its limits, empty if none."""
    for name, value, (low, high), (factor, unit) in zip(
            mechanism.actuators, q, mechanism.limits, mechanism.joint_units, strict=True):
        if value < low or value > high:
            return (f"{name} = {value / factor:.6g} {unit} is outside "
                    f"[{low / factor:.6g}, {high / factor:.6g}]").replace("  ", " ")
    return ""


def home_conditioning(mechanism: Mechanism) -> tuple[float, float]:
    """Return the smallest singular value of A at home and the sign of its determinant."""
    model = Model(mechanism)
    value, sign = conditioning(model.closure(home_state(mechanism).q), mechanism.home[None])
    return float(value[0]), float(sign[0])


def _mark_jumps(model: Model, q: Array, pose: Array, status: list[str], reason: list[str]) -> None:
    """Mark rows at which a path from the row before ends in another pose than from home."""
    good = np.array([s == "ok" for s in status])
    rows = np.flatnonzero(good[1:] & good[:-1]) + 1
    if not rows.size:
        return
    onward = forward(model, q[rows], start=pose[rows - 1], start_q=q[rows - 1])
    scale = model.mechanism.length_scale
    for i, n in enumerate(rows):
        if not onward.converged[i]:
            status[n], reason[n] = "crossed", "the way from the row before meets a singularity"
            continue
        away = cga.motor_log(cga.compose(cga.reverse(pose[n]), onward.pose[i]))
        if np.hypot(np.linalg.norm(away[:3]), np.linalg.norm(away[3:]) / scale) > 1e-6:
            status[n] = "jump"
            reason[n] = "the way from the row before leads to another assembly mode"


def limb_ends(model: Model, q: Array, pose: Array) -> tuple[Array, Array]:
    """Return where the closed limbs hold the platform: base axes and platform axes.

    Each limb's passive joints are set to close it ([PPM] eq. 15). The first result is built
    from the base side (centre, strut direction, strut length) wherever the limb ends in a
    revolute or spherical joint; the second from the platform's own slots, or, where the
    limb slides along the platform, from how far it has slid.

    Returns:
        two arrays (N, L, 3), m.
    """
    closure = model.closure(q)
    contact = closure.contacts(pose)
    own = cga.move_point(cga.reverse(np.atleast_2d(pose))[:, None, :], contact)
    ends, local, row = [], [], 0
    for body in closure.bodies:
        point = contact[:, row]
        if body.radius[:, 0].max() > 0.0:
            centre = cga.coordinates(body.fixed[:, 0])
            along = point - centre
            along = along / np.linalg.norm(along, axis=-1, keepdims=True)
            point = centre + body.radius[:, 0, None] * along
        ends.append(point)
        local.append(own[:, row])
        row += len(body.point_moves)
    return np.stack(ends, axis=1), np.stack(local, axis=1)


def intersection_pose(ends: Array, local: Array) -> Array:
    """Return platform motors (N, 8) from three limb end points, by [PPM]'s construction.

    Spheres about the end points B_i with the platform's own radii b_i = |local_i| meet in a
    point pair; its middle is the foot of the platform centre on the plane of the B_i
    ([PPM] eq. 16-19), which is the centre itself in a planar machine. The orientation comes
    from that plane and the edge B1 B2 (eq. 20-27).

    Args:
        ends: end points in base axes (N, 3, 3), not on one line.
        local: the same points in platform axes (N, 3, 3).
    """
    radius = np.linalg.norm(local, axis=-1)
    pair = cga.meet(*(cga.sphere(ends[:, i], radius[:, i]) for i in range(3)))
    seen, own = _triad(ends), _triad(local)
    rotation = seen @ np.swapaxes(own, -1, -2)
    height = -np.sum(own[..., :, 2] * local[:, 0], axis=-1)
    centre = cga.middle(pair) + height[:, None] * seen[..., :, 2]
    return cga.motor_from_matrix(rotation, centre)


def _triad(points: Array) -> Array:
    """Orthonormal axes (N, 3, 3) from three points: edge 1-2, in-plane normal, plane normal."""
    x = points[:, 1] - points[:, 0]
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    z = np.cross(x, points[:, 2] - points[:, 0])
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


__all__ = [
    "SINGULAR",
    "Table",
    "forward_table",
    "intersection_pose",
    "inverse_table",
    "limb_ends",
    "velocity_table",
]
