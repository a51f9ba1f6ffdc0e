"""Platform poses with only some coordinates wanted, or wanted in another frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import ROUNDS, SETTLED, beyond, shifted
from ppmcal.kinematics.equilibrium import platform_pose, row_known
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.inverse import Inverse, home_state, inverse
from ppmcal.kinematics.open_angles import solve_open_angles
from ppmcal.kinematics.registration import carried_back, measured_pose
from ppmcal.kinematics.rotations import euler_like, from_euler
from ppmcal.linalg import Array, finite_rows, solve_rows
from ppmcal.model.dataset import Environment, unknown_environment
from ppmcal.model.limbs.chain import cross_matrix, left_jacobian
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.model.registration import Registration

ITERATIONS = 50
NEAR = 1e-11
"""Wanted coordinates are met to within this, m (or part of a larger reach) and rad."""
LACKING = "a condition that the machine's effects depend on is not given"


def pose_vector(pose: Array) -> Array:
    """Return (N, 6) x, y, z, rotation vector of motors (N, 8)."""
    return np.concatenate([cga.translation(pose), cga.rotation_vector(pose)], axis=-1)


def pose_words(mechanism: Mechanism, pose: Array) -> str:
    """Return the freedoms of a full pose (6,) in words, file units: ``x 12 mm, rz 3 deg``."""
    return ", ".join(f"{POSE_COORDINATES[c]} " + mechanism.units.words(
        pose[c] + 0.0, "length" if c < 3 else "angle") for c in mechanism.dof)


def pose_motor(vector: Array) -> Array:
    """Return motors (N, 8) of full poses (N, 6)."""
    return cga.motor_from_rotation_vector(vector[..., 3:], vector[..., :3])


@dataclass(frozen=True)
class PoseConvention:
    """Meaning of wanted poses.

    Attributes:
        tool: the point whose position is wanted, platform axes (3,), m; axes are the platform's.
        rotation: their convention, of :mod:`rotations`; Euler angles take the place of
            the rotation vector, so that each of them can be left open.
        seen: frame and target in which they are measured, instead of base frame and tool.
    """

    tool: Array = field(default_factory=lambda: np.zeros(3))
    rotation: str = "rotvec"
    seen: Registration | None = None

    @property
    def euler(self) -> str:
        """The convention if it is one of Euler angles, else empty."""
        return self.rotation if self.rotation.startswith("euler") else ""

    @property
    def registration(self) -> Registration:
        """Registration of the poses; by default the tool's frame in base axes."""
        return self.seen or Registration(target=np.asarray(self.tool, dtype=float))


def inverse_partial(model: Model, coordinates: Array, rows: Environment | None = None,
                    convention: PoseConvention | None = None) -> Inverse:
    """Return joint values of poses with only some coordinates wanted.

    Args:
        model: the machine at its parameters.
        coordinates: (N, 6) x, y, z, rotation vector; nan where left open. Each row must
            name all coordinates of the motion or as many as there are actuators.
        rows: environment that effects depend on; the joint values compensate the effects.
        convention: of these coordinates, default those of the platform's own frame.

    Returns:
        joint values, and the platform's own poses.
    """
    coordinates = np.atleast_2d(np.asarray(coordinates, dtype=float))
    convention = convention or PoseConvention()
    if convention.euler:
        return _inverse_of_angles(model, coordinates, rows, convention)
    return _inverse_rows(model, coordinates, rows, convention)


def _inverse_of_angles(model: Model, coordinates: Array, rows: Environment | None,
                       convention: PoseConvention) -> Inverse:
    """Solve rows that name all three angles as rotations, which avoids gimbal lock."""
    whole = finite_rows(coordinates[:, 3:])
    out = Inverse(np.full((len(whole), len(model.mechanism.actuators)), np.nan),
                  np.full((len(whole), 8), np.nan), ())
    reason = np.full(len(whole), "", dtype=object)
    for mine, own in ((whole, PoseConvention(convention.tool)), (~whole, convention)):
        if mine.any():
            asked = coordinates[mine]
            if own.euler == "":
                asked[:, 3:] = from_euler(asked[:, 3:], convention.euler)
            part = _inverse_rows(model.take(mine), asked, rows and rows.take(mine), own)
            out.q[mine], out.pose[mine], reason[mine] = part.q, part.pose, part.reason
    return replace(out, reason=tuple(reason.tolist()))


def _inverse_rows(model: Model, coordinates: Array, rows: Environment | None,
                  convention: PoseConvention) -> Inverse:
    """Solve rows of one convention; the joint values compensate the effects."""
    found = _inverse_named(model, convention, coordinates)
    if not model.mechanism.effects:
        return found
    rows = rows or unknown_environment(*found.q.shape)
    asked, pose = coordinates, found.pose
    for _ in range(ROUNDS):
        now = shifted(model, rows, found.q, pose)
        usable = row_known(now.shift, len(asked))
        before = found.q
        lacking = _lacking(model, rows, found, usable)
        found = _inverse_named(now, convention, np.where(usable[:, None], asked, np.nan), lacking)
        miss = _missed(model.mechanism, convention, coordinates,
                       platform_pose(found.pose, now.shift))
        asked = asked + miss
        pose = found.pose
        change = np.abs(found.q - before)
        if (np.max(change[np.isfinite(change)], initial=0.0) < SETTLED * model.mechanism.reach
                and np.max(np.abs(miss), initial=0.0) < NEAR * max(1.0, model.mechanism.reach)):
            break
    return Inverse(found.q, platform_pose(found.pose, now.shift), found.reason)


def _lacking(model: Model, rows: Environment, found: Inverse, usable: NDArray[np.bool_]
             ) -> list[str]:
    """Return why the effects are unknown, row by row; empty where they are ``usable``."""
    if usable.all():
        return [""] * len(usable)
    why = beyond(model, rows, found.q, found.pose)
    return ["" if u else old or w or LACKING
            for u, old, w in zip(usable, found.reason, why, strict=True)]


def _missed(mechanism: Mechanism, convention: PoseConvention, wanted: Array, real: Array) -> Array:
    """Return wanted coordinates (N, 6) less those of real poses; 0 where left open or unknown."""
    vector = measured_pose(convention.registration, real)
    if convention.euler:
        return _miss_of_euler(wanted, vector, convention.euler)
    angle = np.linalg.norm(vector[:, 3:], axis=1, keepdims=True)
    # beyond half a turn the same rotation has a second vector; take the one that was wanted
    whole = np.where(angle > 0.0, 1.0 - 2.0 * np.pi / np.where(angle > 0.0, angle, 1.0), 1.0)
    far = np.nansum((wanted[:, 3:] - vector[:, 3:]) * vector[:, 3:], axis=1, keepdims=True)
    vector[:, 3:] *= np.where(far < -np.pi * angle, whole, 1.0)
    miss = np.zeros_like(wanted)
    dof = list(mechanism.dof)
    miss[:, dof] = np.nan_to_num(wanted - vector)[:, dof]
    return miss


def _miss_of_euler(wanted: Array, vector: Array, euler: str) -> Array:
    """Return wanted coordinates (N, 6) less those of poses (N, 6), angles by the shorter way."""
    angles = euler_like(vector[:, 3:], wanted[:, 3:], euler)[0]
    miss = wanted - np.concatenate([vector[:, :3], angles], axis=1)
    miss[:, 3:] -= 2.0 * np.pi * np.round(miss[:, 3:] / (2.0 * np.pi))
    return np.asarray(np.nan_to_num(miss), dtype=float)


def _inverse_named(model: Model, convention: PoseConvention, coordinates: Array,
                   lacking: Sequence[str] = ()) -> Inverse:
    """Inverse kinematics of full or partial poses, ignoring platform twists.

    ``lacking``: why effects are unknown, row by row; empty where they are known.
    """
    mechanism = model.mechanism
    full, failed = wanted_poses(model, convention.registration, coordinates, convention.euler)
    if lacking:
        failed = [lack or f for f, lack in zip(failed, lacking, strict=True)]
    ready = np.array([not f for f in failed], dtype=bool)
    pose = np.full((full.shape[0], 8), np.nan)
    q = np.full((full.shape[0], len(mechanism.actuators)), np.nan)
    pose[ready] = pose_motor(full[ready])
    done = inverse(model.take(ready), pose[ready])
    q[ready] = done.q
    for n, reason in zip(np.flatnonzero(ready), done.reason, strict=True):
        failed[n] = reason
    return Inverse(q, pose, tuple(failed))


def wanted_poses(model: Model, registration: Registration, wanted: Array, euler: str = ""
                 ) -> tuple[Array, list[str]]:
    """Return platform poses (N, 6) in the base frame for wanted measured poses (N, 6).

    Rows that name all coordinates are carried back in closed form. If a machine has
    fewer actuators than coordinates and a row leaves some open, pose and joints are solved
    together: the closure, and the named coordinates as measured. Rotations are vectors, or
    Euler angles of the convention ``euler``.
    """
    mechanism = model.mechanism
    dof = np.isin(np.arange(6), mechanism.dof)
    open_ = np.isnan(wanted) & dof
    short = mechanism.dependent
    out = np.full_like(wanted, np.nan)
    failed = [""] * wanted.shape[0]
    for n, count in enumerate(open_.sum(axis=1)):
        if count not in (0, short):
            failed[n] = (f"{count} coordinate{'s are' if count > 1 else ' is'} empty: this machine "
                         f"needs {'none' if short == 0 else f'none or {short}'} of them empty")
    wanted = _within_reason(mechanism, registration, wanted, failed)
    whole = ~open_.any(axis=1)
    if whole.any():
        given = wanted[whole]
        if euler:
            given = np.concatenate([given[:, :3], from_euler(given[:, 3:], euler)], axis=1)
        out[whole] = pose_vector(carried_back(mechanism, registration, given))
    part = np.flatnonzero((open_.sum(axis=1) == short) & (short > 0))
    if part.size:
        own, named = model.take(part), (registration, wanted[part], open_[part])
        out[part], _, solved = (solve_open_angles(own, *named, euler) if euler
                                else solve_named(own, *named))
        for n in part[~solved]:
            failed[n] = failed[n] or ("the open coordinates could not be solved for: "
                                      "no such pose near home")
    out[[bool(f) for f in failed]] = np.nan
    return out, failed


def _within_reason(mechanism: Mechanism, registration: Registration, wanted: Array,
                   failed: list[str]) -> Array:
    """Mark poses farther away than 1000 times the reach, which would only overflow."""
    reach = 1e3 * (mechanism.reach + float(np.linalg.norm(cga.translation(registration.frame)))
                   + float(np.linalg.norm(mechanism.home_pose[:3])))
    with np.errstate(invalid="ignore"):
        limit = np.array([reach] * 3 + [1e3] * 3)
        far = np.asarray((np.abs(wanted) > limit).any(axis=1), dtype=np.bool_)
    for n in np.flatnonzero(far):
        failed[n] = failed[n] or (
            "the pose is more than 1000 times the machine's reach away"
            if (np.abs(wanted[n, :3]) > reach).any() else "a rotation of more than 159 turns")
    return np.where(far[:, None], np.where(np.isnan(wanted), np.nan, 0.0), wanted)


def solve_named(model: Model, registration: Registration, wanted: Array, open_: NDArray[np.bool_]
                ) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Newton on platform pose and joints: closure and named measured coordinates.

    Args:
        model: one machine, or one for each row.
        registration: one, or one for each row.
        wanted: measured poses (N, 6).
        open_: coordinates that are not named (N, 6), equally many in every row.

    Returns:
        platform poses (N, 6), joint values (N, k), and which rows are solved (N,).
    """
    mechanism = model.mechanism
    state = home_state(mechanism)
    n = wanted.shape[0]
    pose = np.array(np.broadcast_to(mechanism.home, (n, 8)))
    q = np.tile(state.q, (n, 1))
    named = ~open_ & np.isin(np.arange(6), mechanism.dof)
    pick = np.argsort(~named, axis=1, kind="stable")[:, :int(named[0].sum())]
    frame = cga.rotation_matrix(registration.frame)
    solved = np.zeros(n, dtype=bool)
    for _ in range(ITERATIONS):
        closure = model.closure(q)
        lines = closure.lines(pose)
        measured = measured_pose(registration, pose)
        arm = (cga.rotation_matrix(pose) @ registration.target[..., None])[..., 0]
        by_pose = np.zeros((n, 6, 6))
        by_pose[:, :3, :3] = frame
        by_pose[:, :3, 3:] = -frame @ cross_matrix(arm)
        by_pose[:, 3:, 3:] = linalg.inv(left_jacobian(measured[:, 3:])) @ frame
        miss = np.take_along_axis(measured - np.nan_to_num(wanted), pick, axis=1)
        rows = np.take_along_axis(by_pose[..., mechanism.dof], pick[..., None], axis=1)
        c = closure.misclosure(pose)
        top = np.concatenate([closure.pose_matrix(pose, lines),
                              closure.joint_matrix(pose, lines)], axis=-1)
        bottom = np.concatenate([rows, np.zeros((*rows.shape[:2], q.shape[1]))], axis=-1)
        step = -solve_rows(np.concatenate([top, bottom], axis=1),
                           np.concatenate([c, miss], axis=1))
        solved = (np.max(np.abs(c), axis=1) < 1e-12 * mechanism.reach) & (
            np.max(np.abs(miss), axis=1) < 1e-11)
        if solved.all() or not finite_rows(step).any():
            break
        step = np.where(np.isfinite(step), step, 0.0)
        move = np.zeros((n, 6))
        move[:, mechanism.dof] = step[:, :len(mechanism.dof)]
        pose, q = moved(pose, move), q + step[:, len(mechanism.dof):]
    return pose_vector(pose), q, solved


def named_only(mechanism: Mechanism, asked: Array) -> Array:
    """Leave open the coordinates that a constrained machine's own closure determines.

    Full poses lie on the identified machine's surface, not on the nominal one's.
    """
    out = asked.copy()
    short = mechanism.dependent
    model = Model(mechanism)
    closure = model.closure(home_state(mechanism).q)
    a = closure.pose_matrix(mechanism.home[None])[0]
    jq = closure.joint_matrix(mechanism.home[None])[0]
    # coordinates that the joints drive least at home are the parasitic ones
    mobility = np.abs(linalg.solve(a, jq))
    scale = np.where(np.array(mechanism.dof) < 3, mechanism.length_scale, 1.0)
    strength = np.linalg.norm(mobility / scale[:, None], axis=1)
    weakest = [mechanism.dof[i] for i in np.argsort(strength, kind="stable")[:short]]
    full = finite_rows(out[:, mechanism.dof])
    out[np.ix_(full, weakest)] = np.nan
    return out
