"""Kinematics of tables of poses: status row by row, paths checked for singularities.

Platform poses of joint values come from Newton on the closure (:mod:`kinematics.forward`) unless
the caller passes others (:mod:`ppmcal.design.intersection`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.errors import NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import beyond
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import (
    Forward,
    forward,
    least_of_minima,
    smallest_singular_value,
)
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import (
    LACKING,
    PoseConvention,
    inverse_partial,
    pose_motor,
    pose_vector,
)
from ppmcal.kinematics.registration import measured_pose
from ppmcal.linalg import Array, finite_rows, solve_rows
from ppmcal.model.dataset import Dataset, Environment, unknown_environment
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import stage

SINGULAR = 0.02
"""A pose counts as singular below this part of the singular value at home."""
SINGULAR_HOME = 0.02
"""A home below this singular value is a finding; sound ones have 0.1 to 1."""
LOST_HOME = SINGULAR * SINGULAR_HOME
"""A home below this is no reference for other poses: it would count as singular itself."""


@dataclass(frozen=True)
class KinematicsTable:
    """Kinematics of N rows.

    Attributes:
        q: joint values (N, k); pose: full poses (N, 6) x, y, z, rotation vector.
        rate: joint rates (N, k), nan if not requested.
        singular_value: the smallest of A (see :func:`forward.smallest_singular_value`).
        status: ``ok``, ``unreachable``, ``limits``, ``singular``, ``crossed``, ``jump`` or
            ``not converged``; reason in words, empty for ``ok``.
    """

    q: Array
    pose: Array
    rate: Array
    singular_value: Array
    status: tuple[str, ...]
    reason: tuple[str, ...]


@stage("inverse kinematics")
def inverse_table(model: Model, coordinates: Array, rows: Environment | None = None,
                  convention: PoseConvention | None = None) -> KinematicsTable:
    """Return joint values of poses, as a path in row order.

    Args:
        model: the machine at its parameters.
        coordinates: poses (N, 6) in the base frame, m and rad; nan is an open coordinate.
        rows: the environment that the machine's effects depend on.
        convention: the point of the poses and the form of their rotations  [default: the
            platform origin, rotation vectors].

    Returns:
        Joint values and the platform's own poses, as rotation vectors.
    """
    found = inverse_partial(model, coordinates, rows, convention)
    status = ["ok" if r else "unreachable" for r in found.reached]
    return _judged(model, found.q, found.pose, status, list(found.reason))


def tool_poses(model: Model, pose: Array, tool: Array) -> Array:
    """Return the poses (N, 6) of the tool point (3,), m in platform axes, from platform ones."""
    out = np.full_like(pose, np.nan)
    good = finite_rows(pose)
    out[good] = measured_pose(PoseConvention(tool).registration,
                              pose_motor(pose[good]))
    return out


@stage("forward kinematics")
def forward_table(model: Model, q: Array, rows: Environment | None = None,
                  found: Forward | None = None) -> KinematicsTable:
    """Return the poses of joint values, in home's assembly mode, as a path.

    Args:
        model: the machine at its parameters.
        q: joint values (N, k), m or rad (bare numbers with a drive ratio).
        rows: the environment that the machine's effects depend on.
        found: the geometry's poses, if already known.
    """
    found = found or forward(model, q)
    status = ["ok" if c else "not converged" for c in found.converged]
    reason = ["" if c else ("joint values missing" if not np.isfinite(row).all() else r or
              f"no pose: the way from home ends at {p:.0%} of it (singular or out of reach)")
              for c, p, row, r in zip(found.converged, found.progress, q,
                                      found.reason or [""] * len(q), strict=True)]
    _mark_jumps(model, q, found.pose, status, reason)
    pose = found.pose
    if model.mechanism.effects:
        pose = reached_poses(model, q, rows, found.pose, q).pose
        unknown = beyond(model, rows or unknown_environment(*q.shape), q, found.pose)
        for n in np.flatnonzero(finite_rows(found.pose) & ~finite_rows(pose)):
            status[n], reason[n] = "not converged", unknown[n] or LACKING
    return _judged(model, q, pose, status, reason)


def velocity_table(
    model: Model,
    coordinates: Array,
    twist: Array,
    environment: Environment | None = None,
    convention: PoseConvention | None = None,
) -> KinematicsTable:
    """Return joint rates of poses moving with ``twist`` (N, 6) vx, vy, vz, wx, wy, wz.

    A twist + Jq rate = 0 ([IK] eq. 32 and 49). A machine with fewer actuators than pose
    coordinates takes as many velocity components as it has actuators, the others nan; they
    follow from the closure. Effects (``environment``) change the joints, not the rates. Poses and
    velocities are those of the point in ``convention``, as in :func:`inverse_table`; the
    second half of the twist is the angular velocity in base axes, however rotations are written.
    """
    table = inverse_table(model, coordinates, environment, convention)
    rows = np.flatnonzero([s == "ok" for s in table.status])
    rate = np.full_like(table.q, np.nan)
    status, reason = list(table.status), list(table.reason)
    if rows.size:
        pose = pose_motor(table.pose[rows])
        closure = model.closure(table.q[rows])
        lines = closure.lines(pose)
        a, jq = closure.pose_matrix(pose, lines), closure.joint_matrix(pose, lines)
        if convention is not None:
            dof = model.mechanism.dof
            a = a @ _origin_twist(pose, convention.tool)[:, dof][..., dof]
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
                rate[rows[mine]] = (linalg.pinv(jq[mine]) @ right[..., None])[..., 0]
    return KinematicsTable(table.q, table.pose, rate, table.singular_value, tuple(status),
                           tuple(reason))


def _origin_twist(pose: Array, tool: Array) -> Array:
    """Return (N, 6, 6), which maps the twist of the tool point to that of the platform origin."""
    out = np.tile(np.eye(6), (len(pose), 1, 1))
    # v = v_tool - w x r = v_tool + r x w
    out[:, :3, 3:] = cross_matrix((cga.rotation_matrix(pose) @ tool[:, None])[..., 0])
    return out


def with_joints(mechanism: Mechanism, data: Dataset) -> Dataset:
    """Return the data set with commanded poses converted to joints by the nominal machine.

    Rows that the nominal machine cannot reach keep nan joints, and are reported later.
    """
    if data.commanded is None:
        return data
    missing = ~finite_rows(data.q)
    q = data.q.copy()
    found = inverse_partial(Model(mechanism.nominal()), data.commanded[missing])
    q[missing] = found.q
    whole = None if data.whole is None else with_joints(mechanism, data.whole)
    return replace(data, q=q, whole=whole)


@stage("checking limits and singularities")
def _judged(
    model: Model, q: Array, pose: Array, status: list[str], reason: list[str]
) -> KinematicsTable:
    """Add singular values, limits and singularities to rows that have a solution."""
    mechanism = model.mechanism
    smallest = np.full(q.shape[0], np.nan)
    rows = np.flatnonzero([s != "unreachable" and s != "not converged" for s in status])
    if rows.size:
        closure = model.closure(q[rows])
        value, sign = smallest_singular_value(closure, pose[rows])
        smallest[rows] = value
        home_value, home_sign = home_singular_value(mechanism)
        for n, v, s in zip(rows, value, sign, strict=True):
            if status[n] != "ok":
                continue
            if not home_value > LOST_HOME:
                status[n], reason[n] = "singular", f"{_lost(home_value)}: choose another home pose"
            elif v < SINGULAR * home_value:
                status[n] = "singular"
                reason[n] = f"near a singularity: condition {v:.2g}, {home_value:.2g} at home"
            elif s != home_sign:
                status[n] = "crossed"
                reason[n] = "on the other side of a singularity than home"
            else:
                over = limit_reason(mechanism, q[n])
                if over:
                    status[n], reason[n] = "limits", over
    vector = np.full((q.shape[0], 6), np.nan)
    good = finite_rows(pose)
    vector[good] = pose_vector(pose[good])
    return KinematicsTable(
        q, vector, np.full_like(q, np.nan), smallest, tuple(status), tuple(reason)
    )


def limit_reason(mechanism: Mechanism, q: Array) -> str:
    """Return which joint of one row (k,) is outside its limits, empty if none is."""
    for name, value, (low, high), (factor, unit) in zip(
            mechanism.actuators, q, mechanism.limits, mechanism.joint_units, strict=True):
        if value < low or value > high:
            return (f"{name} = {value / factor:.6g} {unit} is outside "
                    f"[{low / factor:.6g}, {high / factor:.6g}] {unit}").replace("  ", " ").strip()
    return ""


def refuse_singular_home(mechanism: Mechanism) -> None:
    """Refuse a machine whose home is no reference for the distance from singularities.

    Raises:
        NoResult: home is singular.
    """
    value, _ = home_singular_value(mechanism)
    if not value > LOST_HOME:
        raise NoResult(_lost(value), f"{mechanism.source}: home", "Choose another home pose")


def _lost(value: float) -> str:
    return (f"the machine is singular at home (condition {value:.2g}), against which the distance "
            "from singularities is measured")


def home_singular_value(mechanism: Mechanism) -> tuple[float, float]:
    """Return the smallest singular value of A at home and the sign of its determinant."""
    model = Model(mechanism)
    closure = model.closure(home_state(mechanism).q)
    value, sign = smallest_singular_value(closure, mechanism.home[None])
    return float(value[0]), float(sign[0])


@stage("following the path")
def _mark_jumps(model: Model, q: Array, pose: Array, status: list[str], reason: list[str]) -> None:
    """Mark rows at which a path from the previous row ends in another pose than one from home."""
    good = np.array([s == "ok" for s in status])
    rows = np.flatnonzero(good[1:] & good[:-1]) + 1
    if not rows.size:
        return
    onward = forward(model, q[rows], start=pose[rows - 1], start_q=q[rows - 1])
    led, known = onward.pose, onward.converged
    if model.mechanism.surplus and not known.all():
        # joints that move in proportion make surplus limbs contradict each other on the way
        lost = rows[~known]
        led[~known] = least_of_minima(model, q[lost], led[~known], start=pose[lost - 1],
                                      start_q=q[lost - 1])
        known = finite_rows(led)
    for n in rows[~known]:
        status[n], reason[n] = "crossed", "the way from the previous row meets a singularity"
    there = rows[known]
    if there.size:
        away = cga.motor_log(cga.compose(cga.reverse(pose[there]), led[known]))
        turn, way = (np.linalg.norm(part, axis=-1) for part in (away[:, :3], away[:, 3:]))
        for n in there[np.hypot(turn, way / model.mechanism.length_scale) > 1e-6]:
            status[n] = "jump"
            reason[n] = "the way from the previous row leads to another assembly mode"


__all__ = [
    "SINGULAR",
    "KinematicsTable",
    "forward_table",
    "inverse_table",
    "tool_poses",
    "velocity_table",
]
