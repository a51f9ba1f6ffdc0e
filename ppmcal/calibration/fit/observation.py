"""What an instrument observes of a pose: measured = frame o pose o target.

Shapes: N rows, m measured coordinates per row. Positions come first, rotations after:
(x, y, rz) in the plane, (x, y, z) or (x, y, z, rx, ry, rz) in space. Rotation residuals
are rotation vectors in the measuring frame's axes, independent of the representation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Closure
from ppmcal.kinematics.instrument_readings import levelled, sensor_turn
from ppmcal.kinematics.joint_readings import JointReading
from ppmcal.kinematics.registration import predict
from ppmcal.linalg import Array, Bools, Ints, finite_rows, row_by_row
from ppmcal.model.dataset import Dataset
from ppmcal.model.limbs.chain import cross_matrix, left_jacobian
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import Motion
from ppmcal.model.registration import Registration

GAP = "gap_"
"""Prefix of a limb's closure among residual names."""


@dataclass(frozen=True)
class ResidualJacobian:
    """Residuals of n rows and the derivatives of the prediction.

    Attributes:
        residual: measured - predicted (n, m), 0 where not measured; m and rad.
        observed: (n, m).
        by_poses: d prediction / d(platform origin displacement, rotation), (n, m, 6), for
            each pose.
        by_frame: d prediction / d(frame displacement, turn about the pivot), (n, m, 6).
        by_target: d prediction / d target (n, m, 3).
        by_target_rotation: d prediction / d target rotation vector (n, m, 3).
        by_points: d prediction / d(point before the file's scale) (n, m, 3), for each pose.
        by_scale: d prediction / d(scale of the file) (n, m).
        points: true position of the measured point, measuring frame (n, 3), for each pose.
        inside: an encoder's reading at a joint, which depends on more than the pose.
    """

    residual: Array
    observed: Bools
    by_poses: tuple[Array, ...]
    by_frame: Array
    by_target: Array
    by_target_rotation: Array
    by_points: tuple[Array, ...]
    points: tuple[Array, ...]
    by_scale: Array
    inside: JointReading | None = None

    def picked(self, parts: Sequence[int]) -> ResidualJacobian:
        """Return some of the coordinates."""
        pick = list(parts)
        return ResidualJacobian(
            self.residual[:, pick], self.observed[:, pick],
            tuple(b[:, pick] for b in self.by_poses), self.by_frame[:, pick],
            self.by_target[:, pick], self.by_target_rotation[:, pick],
            tuple(b[:, pick] for b in self.by_points), self.points, self.by_scale[:, pick])

    def beside(self, residual: Array) -> ResidualJacobian:
        """Return the rows with residuals (n, s) appended on which nothing here depends."""
        more = residual.shape[1]

        def padded(block: Array) -> Array:
            return np.pad(block, ((0, 0), (0, more), *((0, 0),) * (block.ndim - 2)))

        return replace(
            self, residual=np.concatenate([self.residual, residual], axis=1),
            observed=np.pad(self.observed, ((0, 0), (0, more)), constant_values=True),
            by_poses=tuple(map(padded, self.by_poses)), by_frame=padded(self.by_frame),
            by_target=padded(self.by_target), by_target_rotation=padded(self.by_target_rotation),
            by_points=tuple(map(padded, self.by_points)), by_scale=padded(self.by_scale))


def coordinates(data: Dataset, motion: Motion) -> tuple[int, ...]:
    """Return which of (x, y, z, rx, ry, rz) the data set's instrument measures."""
    return data.kind.coordinates(motion)


def shown(data: Dataset, rows: Ints | slice = slice(None)) -> Array:
    """Return the measurements as x, y, z, rx, ry, rz (n, 6), nan elsewhere."""
    out = np.concatenate([data.position[rows], data.rotation[rows]], axis=1)
    if data.kind.scalar:
        out[:, data.kind.place] = data.value[rows]
    return out


def labels(data: Dataset, mechanism: Mechanism) -> tuple[str, ...]:
    """Return the names of the residuals: ``x``, ..., ``height``, ``distance``.

    Without an instrument: the limbs whose lengths contradict each other, ``gap_leg1``, ...
    """
    return gap_names(mechanism) if data.kind.blind else data.kind.labels(mechanism.motion)


def gap_names(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the names of the closure equations among residuals (m,)."""
    return tuple(f"{GAP}{limb.name}" + (f"_{n + 1}" if n else "") for limb in mechanism.limbs
                 for n in range(limb.kind.surface.equations))


def values_per_row(data: Dataset, mechanism: Mechanism) -> int:
    """Return the number of values in a complete row: measured, and surplus closure."""
    ends = 1 if data.to_q is None else 2
    return len(coordinates(data, mechanism.motion)) + ends * mechanism.surplus


def pivot(data: Dataset) -> Array:
    """Return the point about which the frame is turned in fits (3,): the data's centroid."""
    seen = np.isfinite(data.position)
    count = np.maximum(seen.sum(axis=0), 1)
    return np.asarray(np.where(seen, data.position, 0.0).sum(axis=0) / count, dtype=float)


def view(data: Dataset, registration: Registration, poses: Sequence[Array], motion: Motion,
         about: Array, stretch: Array | None = None,
         closures: Sequence[Closure] = ()) -> ResidualJacobian:
    """Compare the data set's rows with poses: measured = frame o pose o target.

    Args:
        data: n rows.
        registration: where the instrument stands.
        poses: platform motors (n, 8) in the base frame; two for distances between two
            platform positions, else one.
        motion: the machine's motion.
        about: the frame's pivot (3,), m in the measuring frame.
        stretch: the instrument shows (1 + ``stretch``) (1 or n, 3, 3) times the true position.
        closures: one per pose, for instruments that need them: weight, joints.
    """
    if data.kind.of_turn is not None:
        return _tilts(data, registration, poses[0], closures[0].model.mechanism)
    if data.kind.placed is not None:
        return _joint(data, registration, poses[0], closures[0])
    if data.kind.touches:
        stretch = None    # a touch is not a reading: the height of the flat is as given
    stretch = in_scale(stretch, registration.scale)
    sights = [_six_coordinates(data, registration, pose, motion, about, stretch) for pose in poses]
    if data.kind.along_line:
        return _distance(data, sights, registration.scale)
    seen = sights[0].picked(coordinates(data, motion))
    # heights times a scale would contain the very noise that it is to explain
    return replace(seen, points=(np.zeros_like(seen.points[0]),)) if data.kind.touches else seen


def _six_coordinates(data: Dataset, registration: Registration, pose: Array, motion: Motion,
                     about: Array, stretch: Array | None) -> ResidualJacobian:
    """Return all six coordinates of one pose, before the instrument picks those it measures."""
    point, rotation = predict(registration, pose)
    seen = stretched(point, stretch)
    turned = rotation_residual(data, rotation, motion)
    residual = np.concatenate([shown(data)[:, :3] - seen, turned], axis=1)
    frame = cga.rotation_matrix(registration.frame)
    arm = cga.rotation_matrix(pose) @ registration.target
    n = len(data)
    by_pose, by_frame = np.zeros((n, 6, 6)), np.zeros((n, 6, 6))
    by_target, by_rotation = np.zeros((n, 6, 3)), np.zeros((n, 6, 3))
    half = np.eye(3) + 0.5 * cross_matrix(np.where(np.isfinite(turned), turned, 0.0))
    by_pose[:, :3, :3] = frame
    by_pose[:, :3, 3:] = -frame @ cross_matrix(arm)
    by_pose[:, 3:, 3:] = half @ frame
    by_frame[:, :3, :3] = np.eye(3)
    by_frame[:, :3, 3:] = -cross_matrix(point - about)
    by_frame[:, 3:, 3:] = half
    body = frame @ cga.rotation_matrix(pose)
    by_target[:, :3] = body
    by_rotation[:, 3:] = half @ body @ left_jacobian(registration.target_rotation)
    if stretch is not None:
        for block in (by_pose, by_frame, by_target):
            block[:, :3] += stretch @ block[:, :3]
    observed = np.isfinite(residual)
    return ResidualJacobian(np.where(observed, residual, 0.0), observed, (by_pose,), by_frame,
                            by_target, by_rotation,
                            (np.tile(registration.scale * np.eye(6, 3), (n, 1, 1)),), (point,),
                            np.pad(seen, ((0, 0), (0, 3))) / registration.scale)


def _tilts(data: Dataset, registration: Registration, pose: Array, mechanism: Mechanism
           ) -> ResidualJacobian:
    """Angles of a body's rotation: they depend on the rotations of frame, pose and body."""
    motion, of_turn = mechanism.motion, data.kind.of_turn
    assert of_turn is not None
    platform, sensor = sensor_turn(mechanism, registration, pose)
    value, by_turn = of_turn(sensor, motion)
    residual = wrapped(shown(data)[:, list(data.kind.coordinates(motion))] - value)
    n, k = residual.shape
    still, observed = np.zeros((n, k, 3)), np.isfinite(residual)
    frame = cga.rotation_matrix(registration.frame) @ levelled(mechanism)
    return ResidualJacobian(
        np.where(observed, residual, 0.0), observed,
        (np.concatenate([still, by_turn @ frame], axis=-1),),
        np.concatenate([still, by_turn], axis=-1), still,
        by_turn @ platform @ left_jacobian(registration.target_rotation), (still,),
        (np.zeros((n, 3)),), np.zeros((n, k)))


def _joint(data: Dataset, registration: Registration, pose: Array, closure: Closure
           ) -> ResidualJacobian:
    """The reading of an encoder at a joint, modulo whole turns."""
    reading = JointReading(closure, pose, data.kind.at)
    residual = (data.value - registration.offset - reading.value)[:, None]
    residual = wrapped(residual) if data.kind.quantity == "angle" else residual
    observed, still = np.isfinite(residual), np.zeros((len(data), 1, 3))
    return ResidualJacobian(
        np.where(observed, residual, 0.0), observed, (reading.by_pose[:, None],),
        np.zeros((len(data), 1, 6)), still, still, (still,), (np.zeros((len(data), 3)),),
        np.zeros((len(data), 1)), reading)


def wrapped(angle: Array) -> Array:
    """Return angles, rad, within half a turn of 0."""
    return np.asarray(angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)))


def _distance(data: Dataset, sights: Sequence[ResidualJacobian], scale: float) -> ResidualJacobian:
    """Distances from the frame's origin, or between two positions: rows along the line."""
    signed = list(zip((1.0, -1.0), sights, strict=False))
    apart = scale * np.sum([sign * s.by_scale[:, :3] for sign, s in signed], axis=0)
    length = np.linalg.norm(apart, axis=1)
    along = (apart / np.where(length > 0.0, length, 1.0)[:, None])[:, None, :]

    def rows(block: Array) -> Array:
        return np.asarray(along @ block[:, :3])

    residual = (data.value - length)[:, None]
    observed = np.isfinite(residual)
    by_frame = rows(sights[0].by_frame)
    return ResidualJacobian(
        np.where(observed, residual, 0.0), observed,
        tuple(sign * rows(s.by_poses[0]) for sign, s in signed),
        by_frame if len(sights) == 1 else np.zeros_like(by_frame),
        np.sum([sign * rows(s.by_target) for sign, s in signed], axis=0),
        np.zeros((len(data), 1, 3)), tuple(sign * rows(s.by_points[0]) for sign, s in signed),
        tuple(s.points[0] for s in sights), (length / scale)[:, None])


def in_scale(stretch: Array | None, scale: float) -> Array | None:
    """Return the stretch of an instrument whose file also has a scale of its own."""
    if scale == 1.0:
        return stretch
    own = np.zeros((1, 3, 3)) if stretch is None else stretch
    return np.asarray((scale - 1.0) * np.eye(3) + scale * own)


def stretched(point: Array, stretch: Array | None) -> Array:
    """Return points (n, 3) as an instrument with a scale error shows them."""
    return point if stretch is None else point + (stretch @ point[..., None])[..., 0]


def rotation_residual(data: Dataset, predicted: Array, motion: Motion) -> Array:
    """Return the rotation from predicted to measured (n, 3), nan where incomplete."""
    measured = data.rotation
    if motion.planar:
        angle = np.arctan2(predicted[:, 1, 0], predicted[:, 0, 0])
        out = np.full_like(measured, np.nan)
        out[:, 2] = wrapped(measured[:, 2] - angle)
        return out
    whole = finite_rows(measured)
    filled = np.where(whole[:, None], measured, 0.0)
    turn = cga.rotation_matrix(cga.motor_from_rotation_vector(filled, np.zeros(3)))
    return np.where(whole[:, None], turn_between(turn, predicted), np.nan)


def turn_between(shown: Array, predicted: Array) -> Array:
    """Return the rotation vector (n, 3) that takes predicted to shown rotations (n, 3, 3)."""
    return cga.rotation_vector(cga.motor_from_matrix(
        shown @ np.swapaxes(predicted, -1, -2), np.zeros(3)))


def noise(data: Dataset, motion: Motion) -> Array:
    """Return the stated standard deviations of the measured coordinates (n, m)."""
    if data.kind.scalar:
        return data.sigma_value[:, None]
    chosen = list(coordinates(data, motion))
    return row_by_row(lambda *both: np.concatenate(both, axis=1)[:, chosen],
                      data.sigma_position, data.sigma_rotation)


def joint_covariance(data: Dataset, motion: Motion) -> Array | None:
    """Return the covariance of the measured x, y, z, or of all coordinates (n, p, p).

    None where the coordinates are uncorrelated.
    """
    if data.covariance is None:
        return None
    axes = [c for c in coordinates(data, motion) if c < data.covariance.shape[-1]]
    return data.covariance[:, axes][:, :, axes]


def noise_quantity(data: Dataset) -> str:
    """Return the quantity of a data set's noise where it is reported as one number."""
    if data.kind.scalar:
        return data.kind.quantity
    return "length" if data.kind.of_poses else "angle"


def typical_noise(data: Dataset) -> float:
    """Return the median noise of a data set's values or positions, m; rad for angles."""
    sigma = data.sigma_value if data.kind.scalar else (
        data.sigma_position if data.kind.of_poses else data.sigma_rotation)
    return float(np.nanmedian(sigma))


def joint_noise(mechanism: Mechanism, data: Dataset) -> Array:
    """Return the standard deviations of the joint values (k,), unit of q.

    If not stated, joints are exact, except on machines with surplus equations and no gap noise,
    where only noise can make joints contradict each other: they are as good as the instrument.
    """
    gap = np.all(gap_noise(mechanism, data) > 0.0)
    if not mechanism.surplus or gap or np.any(data.sigma_actuator > 0.0):
        return data.sigma_actuator
    own = typical_noise(data) * (
        mechanism.length_scale if noise_quantity(data) == "angle" else 1.0)
    size = own / mechanism.joint_ratios
    turns = np.array([q == "angle" for q in mechanism.actuator_quantity])
    return np.asarray(np.where(turns, size / mechanism.length_scale, size))


def gap_noise(mechanism: Mechanism, data: Dataset) -> Array:
    """Return the standard uncertainty of the closure gaps in a data set (m,)."""
    return data.gap_factor * mechanism.gap_sigma


def white_measurements(data: Dataset, motion: Motion, rows: Ints | slice = slice(None)
                       ) -> tuple[Array, Array, Ints]:
    """Return what was measured in some rows: x ... rz (n, 6), 1/sigma (n, m), count (n,).

    The first two are 0 where nothing was measured; a row of lower weight has a larger sigma.
    """
    own = shown(data, rows)
    # a single number, or angles in the instrument's own sense, are not part of a rotation
    if not motion.planar and not data.kind.scalar and data.kind.of_turn is None:
        own[~finite_rows(own[:, 3:]), 3:] = np.nan
    seen = np.isfinite(own[:, list(coordinates(data, motion))])
    with np.errstate(divide="ignore", invalid="ignore"):
        white = np.where(seen, 1.0 / noise(data, motion)[rows], 0.0)
    if data.weight is not None:
        white = np.sqrt(data.weight[rows])[:, None] * white
    return np.where(np.isfinite(own), own, 0.0), white, seen.sum(axis=1)
