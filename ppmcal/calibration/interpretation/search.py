"""Search for the way a file was meant: the candidates that are worth a score.

A way is another reading of its columns, a registration given by the sidecar that is opened, or a
mechanism file with diameters for radii. Readings are ranked against the nominal machine: each
reading of the joint columns gives predicted poses (one batch of Newton steps), each reading of the
measured columns measured ones; both are aligned by the best rigid registration, robustly, and
judged by the median error. All pairs are compared at once, so two mistakes in one file are found
as easily as one. Readings that tolerances hide there are ranked by their residuals, to first order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.fit import Problem, toleranced
from ppmcal.calibration.interpretation.candidates import (
    joint_readings,
    pose_readings,
    position_readings,
    rotation_readings,
    whole_pose_readings,
)
from ppmcal.calibration.interpretation.encoders import search_encoder
from ppmcal.calibration.interpretation.interpretation_error import FileFault
from ppmcal.calibration.interpretation.limits import ALLOWED, FAR, LANDS
from ppmcal.calibration.interpretation.readings import (
    ColumnInterpretation,
    ReadColumns,
    of_a_joint,
)
from ppmcal.calibration.interpretation.score import Score, first_order_scores, score
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.pose_readings import shifted_rows
from ppmcal.linalg import Array, Ints, finite_rows, nearest_rotation, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.scaled_points import other_radii

ROWS = 40
"""Number of rows by which readings are compared."""
SHIFTS = (1, -1, 2, -2, 3, -3)
"""Rows by which measured columns may be late or early."""
ROUNDS = 4
TRIMMED = 3.0
"""Rows off by more than this many medians do not affect the registration."""
BEST_PAIRS = 60
"""Pairs of joint and position readings for which all readings of the rotations are tried."""
LONGLIST = 300
"""Pairs that are registered carefully, after a quick comparison of all."""
CHUNK = 2000
NEWTON_STEPS = 12
TRIED = 8
"""Number of readings scored near the nominal machine; half as many near a fit."""
NEAR_BEST = 2.5
"""Their median error is within this factor of the smallest."""
REGISTERED = {
    "frame": "the measuring frame is not where the sidecar puts it",
    "target": "the measured point is not where the sidecar puts it",
    "target_rotation": "the measured body is not rotated as in the sidecar",
    "offset": "the encoder's zero is not where the sidecar puts it"}
"""What may be wrong in a sidecar, in words, by its key."""


@dataclass(frozen=True, eq=False)
class Way:
    """One way in which a file may have been meant, with the resulting problem.

    ``parts``: number of differences from how it is read; ``reading``: of the columns.
    """

    what: tuple[FileFault, ...]
    parts: float
    problem: Problem
    reading: ColumnInterpretation | None = None


def ways(alone: Problem, as_read: Score) -> list[Way]:
    """Return the ways that are worth a score, those with the fewest changes first."""
    data, mechanism = alone.datasets[0], alone.mechanism
    readings = dict.fromkeys([*_near_nominal(alone), *(
        _near_fit(alone) if as_read.nominal <= LANDS else ())])
    out = [Way(r.mistakes(data), r.parts, replace(alone, datasets=(r.of(data),)), r)
           for r in readings]
    if _beyond_tolerances(alone, as_read):
        out += _registrations(alone)
    for machine, ends, words in other_radii(mechanism):
        text = f"{mechanism.source}: {words.format(reason='the measurements say')}"
        out.append(Way((FileFault("radius", tuple(f"{e}.point" for e in ends), text),), 1.2,
                       replace(alone, mechanism=machine, free=machine.free)))
    return sorted(out, key=lambda w: w.parts)


def _near_nominal(alone: Problem) -> list[ColumnInterpretation]:
    """Return the readings that come closest to the nominal machine."""
    data = alone.datasets[0]
    search = search_encoder if of_a_joint(data) else search_readings
    ordered = iter(search(alone.mechanism, data))
    best = next((f for f in ordered if f[1].parts), None)
    if best is None:
        return []
    near = [best, *(f for f in takewhile(lambda f: f[0] <= NEAR_BEST * best[0], ordered)
                    if f[1].parts)]
    near = sorted(near, key=lambda f: (f[1].parts, f[0]))[:TRIED]
    return [reading for _, reading in (*near, best)]


def _near_fit(alone: Problem) -> list[ColumnInterpretation]:
    """Return readings of measured columns that tolerances hide in a comparison with nominal.

    Euler angles of small rotations; a row of shift on a dense path. None for joints alone.
    """
    data = alone.datasets[0]
    if of_a_joint(data) or data.kind.blind:
        return []
    plain = ColumnInterpretation.as_declared(alone.mechanism, data)
    readings = [*pose_readings(plain, data), *(replace(plain, shift=s) for s in SHIFTS)]
    try:
        scores = first_order_scores(alone, readings)
    except PpmcalError:
        return []
    order = sorted(range(1, len(readings)), key=lambda i: (scores[i], readings[i].parts))
    return [readings[i] for i in order[:TRIED // 2] if np.isfinite(scores[i])]


def _beyond_tolerances(alone: Problem, as_read: Score) -> bool:
    """Whether no tolerance explains a file, including those of parameters that the file holds."""
    return as_read.geometry > FAR or (as_read.nominal > LANDS and score(
        toleranced(alone, fixed=True), 0.0).total > ALLOWED)


def _registrations(alone: Problem) -> Iterator[Way]:
    """Yield the problem with parts of the registration open that the sidecar gives."""
    data = alone.datasets[0]
    turns = alone.mechanism.motion.turns    # otherwise its platform never does
    seen = {"frame": data.kind.of_poses, "target": data.kind.of_poses and turns,
            "target_rotation": data.kind.sees_rotation and turns, "offset": of_a_joint(data)}
    given = [key for key in REGISTERED if seen[key] and not getattr(data, key).fitted]
    for keys in dict.fromkeys([*((key,) for key in given), tuple(given)]) if given else ():
        opened = replace(data, **{k: replace(getattr(data, k), fitted=True) for k in keys})
        yield Way(tuple(FileFault(k.replace("_", "-"), (), REGISTERED[k]) for k in keys),
                  len(keys) + 0.1, replace(alone, datasets=(opened,)))


# --- all readings against the nominal machine -----------------------------------------------------

def search_readings(mechanism: Mechanism,
                    data: Dataset) -> list[tuple[float, ColumnInterpretation]]:
    """Return readings of one data set of poses or positions with their errors, best first.

    The error is the median one over the platform's motion; rotations count times the machine's
    length scale. The reading as declared is among them.
    """
    shifts = (0, *SHIFTS) if len(data) >= 4 * max(SHIFTS) else (0,)
    return sorted((found for shift in shifts for found in _at_shift(mechanism, data, shift)),
                  key=lambda found: found[0])


def _at_shift(mechanism: Mechanism, data: Dataset,
              shift: int) -> list[tuple[float, ColumnInterpretation]]:
    data = shifted_rows(data, shift)
    plain = replace(ColumnInterpretation.as_declared(mechanism, data), shift=shift)
    joints = joint_readings(mechanism, data, single=not shift)
    usable = finite_rows(data.position[:, plain.places.own]) & finite_rows(data.q)
    few = data.take(subsample([usable], ROWS)[0])
    if len(few) < 6:
        return []
    origins, turns = _predicted(mechanism, np.stack([j.of(few.q) for j in joints]))
    # a row that most readings cannot reach does not distinguish them
    able = _distinct(joints, origins)
    if not able:
        return []
    scene = _Scene(mechanism, few, origins[able], turns[able], [joints[i] for i in able])
    if shift:
        return scene.scored(position_readings(plain)[:4], [plain])
    return scene.scored([*position_readings(plain), *whole_pose_readings(plain, few)],
                        rotation_readings(plain, few))


def _distinct(joints: Sequence[ReadColumns], origins: Array) -> list[int]:
    """Return which readings reach most rows; of those with equal predictions, the simplest."""
    out: dict[bytes, int] = {}
    for i in sorted(range(len(joints)), key=lambda i: joints[i].parts):
        if finite_rows(origins[i]).mean() > 0.5:
            # to a millionth of the machine: the square of a strut's length hides its sign
            out.setdefault((np.round(origins[i], 9) + 0.0).tobytes(), i)
    return list(out.values())


def _predicted(mechanism: Mechanism, q: Array) -> tuple[Array, Array]:
    """Return platform origins (C, n, 3) and rotations (C, n, 3, 3) of joints (C, n, k)."""
    model = Model(replace(mechanism, effects=()))
    flat = q.reshape(-1, q.shape[-1])
    start = np.tile(mechanism.home, (len(flat), 1))
    pose, good, _ = newton(model.closure(flat), start, NEWTON_STEPS)
    origin, rotation = np.full((len(flat), 3), np.nan), np.full((len(flat), 3, 3), np.nan)
    origin[good], rotation[good] = cga.translation(pose[good]), cga.rotation_matrix(pose[good])
    return origin.reshape(*q.shape[:2], 3), rotation.reshape(*q.shape[:2], 3, 3)


@dataclass(frozen=True, eq=False)
class _Scene:
    """Predictions (C, n), one per joint reading, to compare with the rows of a data set."""

    mechanism: Mechanism
    data: Dataset
    origins: Array
    turns: Array
    joints: Sequence[ReadColumns]

    @property
    def planar(self) -> bool:
        return self.mechanism.motion.planar

    def scored(self, poses: Sequence[ColumnInterpretation],
               rotations: Sequence[ColumnInterpretation]
               ) -> list[tuple[float, ColumnInterpretation]]:
        """Return the best pairs of readings with their errors."""
        place = np.stack([np.where([False, False, self.planar], 0.0, p.measured(self.data)[0])
                          for p in poses])
        c, p = (x.ravel() for x in np.indices((len(self.joints), len(poses))))
        first = np.concatenate([self._registered(c[i:i + CHUNK], place[p[i:i + CHUNK]], 2)[0]
                                for i in range(0, len(c), CHUNK)])
        # a reading that makes everything small has small residuals but explains no more
        sizes = self._sizes()
        some = np.argsort(first / sizes[c], kind="stable")[:LONGLIST]
        c, p = c[some], p[some]
        median, frames = self._registered(c, place[p], ROUNDS)
        turned: dict[tuple[str, int], Array] = {}
        out: list[tuple[float, ColumnInterpretation]] = []
        for f in np.argsort(median / sizes[c], kind="stable")[:BEST_PAIRS]:
            pose = replace(poses[p[f]], joints=self.joints[c[f]])
            own = [pose] if pose.inverse else [
                replace(pose, turns=r.turns, rotation=r.rotation) for r in rotations]
            alike = pose.mirror, pose.inverse and int(p[f])
            if alike not in turned:
                turned[alike] = self._rotations(np.stack(
                    [r.measured(self.data)[1] for r in own]))
            angles = self._rotation_misses(frames[f] @ self.turns[c[f]], turned[alike])
            score = np.hypot(median[f], self.mechanism.length_scale * np.nan_to_num(angles))
            out += zip((score / sizes[c[f]]).tolist(), own, strict=True)
        return out

    def _sizes(self) -> Array:
        """Return the median distance of predicted origins from their median, m (C,)."""
        middle = np.nanmedian(self.origins, axis=1, keepdims=True)
        away = np.nanmedian(np.linalg.norm(self.origins - middle, axis=-1), axis=1)
        return np.asarray(np.maximum(away, 1e-12))

    def _registered(self, c: Ints, b: Array, rounds: int) -> tuple[Array, Array]:
        """Return the best registrations of F pairs of a prediction and a reading.

        Args:
            c: index of the prediction (F,).
            b: measured positions (F, n, 3).
            rounds: of leaving out rows that are far off.

        Returns:
            median errors (F,), m, and frame rotations (F, 3, 3).
        """
        known = self.data.frame
        motor = cga.motor_from_rotation_vector(known.value[3:], known.value[:3])
        frame = np.broadcast_to(cga.rotation_matrix(motor), (len(c), 3, 3))
        a, turn, b = self.origins[c], np.nan_to_num(self.turns[c]), b - cga.translation(motor)
        whole = np.asarray(np.isfinite(a).all(axis=-1) & np.isfinite(b).all(axis=-1))
        a, b = np.where(whole[..., None], a, 0.0), np.where(whole[..., None], b, 0.0)
        target = np.tile(self.data.target.value, (len(c), 1))
        weight = whole.astype(float)
        for _ in range(rounds):
            w = weight / np.maximum(weight.sum(axis=-1, keepdims=True), 1e-300)

            def free(rows: Array, w: Array = w) -> Array:
                """Return rows (F, n, ...) less what the frame's origin absorbs, if it is open."""
                middle = np.einsum("fn,fn...->f...", w, rows)[:, None]
                return rows - middle if known.fitted else rows

            if known.fitted:
                point = free(a + (turn @ target[:, None, :, None])[..., 0])
                frame = nearest_rotation(np.swapaxes(w[..., None] * b, -1, -2) @ point, self.planar)
            own, rest = free(turn), free(b @ frame - a)
            if self.data.target.fitted and self.mechanism.motion.turns:
                # where the rows do not separate it from the frame's origin, it stays short
                back = np.swapaxes(w[..., None, None] * own, -1, -2)
                normal = (back @ own).sum(axis=1) + (1e-6 + 1e-9) * np.eye(3)
                target = linalg.solve(normal, (back @ rest[..., None]).sum(axis=1))[..., 0]
                target = target * [1.0, 1.0, not self.planar]
            miss = np.linalg.norm(rest - (own @ target[:, None, :, None])[..., 0], axis=-1)
            median = np.median(np.where(whole, miss, np.inf), axis=-1)
            weight = np.where(whole & (miss <= TRIMMED * median[:, None]), 1.0, 1e-9 * whole)
        return median, frame

    def _rotations(self, seen: Array) -> Array:
        """Return measured rotations (R, n, 3) as matrices (R, n, 3, 3), nan without one."""
        turn = np.where([True, True, False], 0.0, seen) if self.planar else seen
        finite = np.asarray(np.isfinite(turn).all(axis=-1))[..., None]
        matrices = cga.rotation_matrix(cga.motor_from_rotation_vector(
            np.where(finite, turn, 0.0), np.zeros(3)))
        return np.where(finite[..., None], matrices, np.nan)

    def _rotation_misses(self, predicted: Array, measured: Array) -> Array:
        """Return the median angle (R,) between predicted (n, 3, 3) and measured (R, n, 3, 3)."""
        whole = np.asarray(np.isfinite(measured[..., 0, 0])
                           & np.isfinite(predicted).all(axis=(-1, -2)))
        if not whole.any():
            return np.full(len(measured), np.nan)
        body = np.swapaxes(np.nan_to_num(predicted), -1, -2) @ np.nan_to_num(measured)
        body = np.where(whole[..., None, None], body, 0.0)
        if self.data.target_rotation.fitted:
            own = nearest_rotation(body.sum(axis=1), self.planar)[:, None]
        else:
            own = cga.rotation_matrix(cga.motor_from_rotation_vector(
                self.data.target_rotation.value, np.zeros(3)))
        trace = np.sum(body * own, axis=(-2, -1))
        angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        return np.asarray(np.nanmedian(np.where(whole, angle, np.nan), axis=-1))
