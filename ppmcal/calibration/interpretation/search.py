"""The search for the way in which a file was meant: all readings against the nominal machine.

Every reading of the joint columns gives predicted poses (one batch of Newton steps), every
reading of the measured columns gives measured ones; both are brought together by the best rigid
registration, robustly, and judged by the median miss. All pairs are compared at once, so two
mistakes in one file are found like one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.interpretation.candidates import (
    joint_readings,
    position_readings,
    rotation_readings,
    whole_pose_readings,
)
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.pose_readings import (
    FileReading,
    JointReading,
    PoseReading,
    shifted_rows,
)
from ppmcal.linalg import Array, finite_rows, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

Index = NDArray[np.int64]
ROWS = 40
"""Rows that decide between readings."""
SHIFTS = (1, -1, 2, -2, 3, -3)
"""Rows by which measured columns may be late or early."""
ROUNDS = 4
TRIMMED = 3.0
"""Rows that miss by more than so many medians have no say in the registration."""
BEST_PAIRS = 60
"""Pairs of joint and position readings for which the rotations are read in every way."""
LONGLIST = 300
"""Pairs that are registered with care, after a look at all of them."""
CHUNK = 2000
NEWTON_STEPS = 12


@dataclass(frozen=True)
class Scored:
    """One reading, and the median miss that it leaves over how far the platform moves."""

    reading: FileReading
    score: float


def search_readings(mechanism: Mechanism, data: Dataset) -> list[Scored]:
    """Return readings of one data set of poses or positions, best first.

    A rotation counts on the machine's length scale. The reading as declared is among them.
    """
    out: list[Scored] = []
    for shift in (0, *SHIFTS):
        if shift and len(data) < 4 * max(abs(s) for s in SHIFTS):
            continue
        moved = shifted_rows(data, shift)
        out += _at_shift(mechanism, moved, shift)
    return sorted(out, key=lambda s: s.score)


def _at_shift(mechanism: Mechanism, data: Dataset, shift: int) -> list[Scored]:
    planar = mechanism.motion == "planar"
    joints = joint_readings(mechanism, data, single=not shift)
    usable = np.isfinite(data.position[:, :2 if planar else 3]).all(axis=1) & finite_rows(data.q)
    few = data.take(subsample([usable], ROWS)[0])
    if len(few) < 6:
        return []
    declared = mechanism.joint_factors(data.units)
    origins, turns = _predicted(mechanism, np.stack([j.of(few.q, declared) for j in joints]))
    # a row that most readings cannot reach says nothing about which of them is right
    able = _distinct(joints, origins)
    if not able:
        return []
    poses = position_readings(few, planar)[:4 if shift else None]
    scene = _Scene(mechanism, few, planar, origins[able], turns[able], [joints[i] for i in able],
                   shift)
    rotations = [PoseReading()] if shift else rotation_readings(few, planar)
    return scene.scored([*poses, *([] if shift else whole_pose_readings(few, planar))], rotations)


def _distinct(joints: Sequence[JointReading], origins: Array) -> list[int]:
    """Return which readings reach most rows; of those that predict the same, the simplest."""
    out: dict[bytes, int] = {}
    for i in sorted(range(len(joints)), key=lambda i: joints[i].parts):
        if np.isfinite(origins[i]).all(axis=-1).mean() > 0.5:
            # to a millionth of the machine: a strut's length squared knows no sign
            out.setdefault((np.round(origins[i], 9) + 0.0).tobytes(), i)
    return list(out.values())


def _predicted(mechanism: Mechanism, q: Array) -> tuple[Array, Array]:
    """Return platform origins (C, n, 3) and rotations (C, n, 3, 3) of joints (C, n, k)."""
    model = Model(replace(mechanism, effects=()))
    flat = q.reshape(-1, q.shape[-1])
    start = np.tile(mechanism.home, (len(flat), 1))
    pose, good, _ = newton(model.closure(flat), start, NEWTON_STEPS)
    pose[~good] = np.nan
    rotation = np.full((len(flat), 3, 3), np.nan)
    rotation[good] = cga.rotation_matrix(pose[good])
    origin = np.full((len(flat), 3), np.nan)
    origin[good] = cga.translation(pose[good])
    return origin.reshape(*q.shape[:2], 3), rotation.reshape(*q.shape[:2], 3, 3)


@dataclass(frozen=True, eq=False)
class _Scene:
    """What is compared: C predictions of n rows, and how measured columns may be read."""

    mechanism: Mechanism
    data: Dataset
    planar: bool
    origins: Array
    turns: Array
    joints: Sequence[JointReading]
    shift: int

    def scored(self, poses: Sequence[PoseReading], rotations: Sequence[PoseReading]
               ) -> list[Scored]:
        """Return the best pairs of readings with their misses."""
        place = np.stack([np.where([False, False, self.planar], 0.0, self._read(p)[0])
                          for p in poses])
        c, p = (x.ravel() for x in np.indices((len(self.joints), len(poses))))
        with_target = self.data.target.fitted and self.mechanism.motion != "translational"
        first = np.concatenate([
            self._registered(c[i:i + CHUNK], place[p[i:i + CHUNK]], 2, with_target)[0]
            for i in range(0, len(c), CHUNK)])
        # a reading that makes everything small leaves little, and explains no more
        sizes = self._sizes()
        some = np.argsort(first / sizes[c], kind="stable")[:LONGLIST]
        c, p = c[some], p[some]
        median, frames = self._registered(c, place[p], ROUNDS, with_target)
        turned: dict[str, Array] = {}
        out = []
        for f in np.argsort(median / sizes[c], kind="stable")[:BEST_PAIRS]:
            pose = poses[p[f]]
            own = [pose] if pose.inverse else [pose.with_rotation(r) for r in rotations]
            if pose.inverse:
                seen = self._read(pose)[1][None]
            else:
                if pose.mirror not in turned:
                    turned[pose.mirror] = np.stack([self._read(r)[1] for r in own])
                seen = turned[pose.mirror]
            angles = self._rotation_misses(frames[f] @ self.turns[c[f]], seen)
            score = np.hypot(median[f], self.mechanism.length_scale * np.nan_to_num(angles))
            out += [Scored(FileReading(self.joints[c[f]], t, self.shift), s) for t, s in
                    zip(own, (score / sizes[c[f]]).tolist(), strict=True)]
        return out

    def _read(self, pose: PoseReading) -> tuple[Array, Array]:
        data = self.data
        return pose.of(data.position, data.rotation, data.units, data.convention, self.planar)

    def _sizes(self) -> Array:
        """Return how far half of the predicted origins are from their middle, m (C,)."""
        middle = np.nanmedian(self.origins, axis=1, keepdims=True)
        away = np.nanmedian(np.linalg.norm(self.origins - middle, axis=-1), axis=1)
        return np.asarray(np.maximum(away, 1e-12))

    def _registered(self, c: Index, b: Array, rounds: int, with_target: bool
                    ) -> tuple[Array, Array]:
        """Return the best registrations of F pairs of a prediction and a reading.

        Args:
            c: which prediction (F,).
            b: measured positions (F, n, 3).
            rounds: of leaving out the rows that are far off.
            with_target: whether the target is open.

        Returns:
            median misses (F,), m, and frame rotations (F, 3, 3).
        """
        a, turn = self.origins[c], np.where(np.isfinite(self.turns), self.turns, 0.0)[c]
        whole = np.asarray(np.isfinite(a).all(axis=-1) & np.isfinite(b).all(axis=-1))
        a, b = np.where(whole[..., None], a, 0.0), np.where(whole[..., None], b, 0.0)
        weight = whole.astype(float)
        target = np.zeros((len(c), 3)) + self.data.target.value
        median = np.full(len(c), np.inf)
        for _ in range(rounds):
            point = a + (turn @ target[:, None, :, None])[..., 0]
            frame, offset = self._frame(point, b, weight)
            if with_target:
                target, offset = self._target(frame, a, turn, b, weight, offset)
                point = a + (turn @ target[:, None, :, None])[..., 0]
            miss = np.linalg.norm(b - point @ np.swapaxes(frame, -1, -2) - offset[:, None], axis=-1)
            median = np.median(np.where(whole, miss, np.inf), axis=-1)
            weight = np.where(whole & (miss <= TRIMMED * median[:, None]), 1.0, 1e-9 * whole)
        return median, frame

    def _frame(self, point: Array, b: Array, weight: Array) -> tuple[Array, Array]:
        """Return frames' rotations (F, 3, 3) and origins (F, 3)."""
        known = self.data.frame
        if not known.fitted:
            motor = cga.motor_from_rotation_vector(known.value[3:], known.value[:3])
            return (np.broadcast_to(cga.rotation_matrix(motor), (len(weight), 3, 3)),
                    np.broadcast_to(cga.translation(motor), (len(weight), 3)))
        w = (weight / np.maximum(weight.sum(axis=-1, keepdims=True), 1e-300))[..., None]
        p0, b0 = (w * point).sum(axis=-2), (w * b).sum(axis=-2)
        cross = np.swapaxes(w * (b - b0[:, None]), -1, -2) @ (point - p0[:, None])
        turn = _rotations(cross, self.planar)
        return turn, b0 - (turn @ p0[..., None])[..., 0]

    def _target(self, frame: Array, a: Array, turn: Array, b: Array, weight: Array, offset: Array
                ) -> tuple[Array, Array]:
        """Return targets and frame origins (F, 3), linear once the frame's rotation is known.

        Where the rows do not tell them apart, the target stays short.
        """
        seen = frame[:, None] @ turn
        rest = b - a @ np.swapaxes(frame, -1, -2)
        w = weight[..., None, None]
        total = weight.sum(axis=-1)[:, None, None]
        normal = np.zeros((len(a), 6, 6))
        normal[..., :3, :3] = np.eye(3) * total
        normal[..., :3, 3:] = (w * seen).sum(axis=1)
        normal[..., 3:, :3] = np.swapaxes(normal[..., :3, 3:], -1, -2)
        normal[..., 3:, 3:] = np.eye(3) * (total * (1.0 + 1e-6))
        right = np.concatenate([(weight[..., None] * rest).sum(axis=1), (
            w * np.swapaxes(seen, -1, -2) @ rest[..., None])[..., 0].sum(axis=1)], axis=-1)
        if not self.data.frame.fitted:
            # the frame stays where it is known to be
            normal[..., :3, 3:], normal[..., 3:, :3] = 0.0, 0.0
            back = (w * np.swapaxes(seen, -1, -2)).sum(axis=1)
            right[:, 3:] -= (back @ offset[..., None])[..., 0]
        solution = linalg.solve(normal + 1e-9 * np.eye(6), right[..., None])[..., 0]
        target = solution[..., 3:] * np.array([1.0, 1.0, 0.0 if self.planar else 1.0])
        return target, solution[..., :3] if self.data.frame.fitted else offset

    def _rotation_misses(self, predicted: Array, seen: Array) -> Array:
        """Return the median angle (R,) between predicted (n, 3, 3) and measured turns (R, n, 3)."""
        turn = np.where([True, True, False], 0.0, seen) if self.planar else seen
        whole = np.asarray(np.isfinite(turn).all(axis=-1)
                           & np.isfinite(predicted).all(axis=(-1, -2)))
        if not whole.any():
            return np.full(len(seen), np.nan)
        measured = cga.rotation_matrix(cga.motor_from_rotation_vector(
            np.where(whole[..., None], turn, 0.0), np.zeros(3)))
        body = np.swapaxes(np.where(np.isfinite(predicted), predicted, 0.0), -1, -2) @ measured
        body = np.where(whole[..., None, None], body, 0.0)
        if self.data.target_rotation.fitted:
            own = _rotations(body.sum(axis=1), self.planar)[:, None]
        else:
            own = cga.rotation_matrix(cga.motor_from_rotation_vector(
                self.data.target_rotation.value, np.zeros(3)))
        trace = np.trace(np.swapaxes(body, -1, -2) @ own, axis1=-2, axis2=-1)
        angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        return np.asarray(np.nanmedian(np.where(whole, angle, np.nan), axis=-1))


def _rotations(matrix: Array, planar: bool) -> Array:
    """Return the rotations (..., 3, 3) nearest to matrices; about z only in the plane."""
    if planar:
        angle = np.arctan2(matrix[..., 1, 0] - matrix[..., 0, 1],
                           matrix[..., 0, 0] + matrix[..., 1, 1])
        motor = cga.motor_from_rotation_vector(
            angle[..., None] * np.array([0.0, 0.0, 1.0]), np.zeros(3))
        return np.asarray(cga.rotation_matrix(motor))
    u, _, v = linalg.svd(np.where(np.isfinite(matrix), matrix, 0.0), full=True)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ v))[..., None]
    return np.asarray(u @ v)

