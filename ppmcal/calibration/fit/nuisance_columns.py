"""Column layout of a problem: geometry first, then the nuisance parameters of each data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit.observation import ResidualJacobian, pivot
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES, Motion
from ppmcal.model.registration import Registration


@dataclass(frozen=True)
class NuisanceColumns:
    """Columns of one data set's nuisance parameters, and the components that they belong to.

    ``about`` (3,): the point about which the frame is turned.
    """

    frame: slice
    target: slice
    target_rotation: slice
    homing: slice
    scale: slice
    offset: slice
    frame_parts: tuple[int, ...]
    target_parts: tuple[int, ...]
    turn_parts: tuple[int, ...]
    about: Array

    def moved(self, registration: Registration, step: Array) -> Registration:
        """Return the registration moved by a step (..., C) of all columns."""
        frame, target, turn = (np.zeros((*step.shape[:-1], size)) for size in (6, 3, 3))
        for whole, columns, parts in ((frame, self.frame, self.frame_parts),
                                      (target, self.target, self.target_parts),
                                      (turn, self.target_rotation, self.turn_parts)):
            if columns.stop > columns.start:
                whole[..., list(parts)] = step[..., columns]
        moved = replace(registration, target=registration.target + target,
                        target_rotation=registration.target_rotation + turn)
        if self.frame.stop > self.frame.start:
            moved = replace(moved, frame=turned_about(moved.frame, frame, self.about))
        if self.homing.stop > self.homing.start:
            moved = replace(moved, homing=moved.homing + step[..., self.homing])
        if self.scale.stop > self.scale.start:
            moved = replace(moved, scale=moved.scale + float(step[self.scale.start]))
        if self.offset.stop > self.offset.start:
            moved = replace(moved, offset=moved.offset + float(step[self.offset.start]))
        return moved

    def fill(self, out: Array, seen: ResidualJacobian) -> None:
        """Fill the columns of frame, target, its rotation, scale and offset (n, m, C)."""
        for columns, parts, source in (
                (self.frame, self.frame_parts, seen.by_frame),
                (self.target, self.target_parts, seen.by_target),
                (self.target_rotation, self.turn_parts, seen.by_target_rotation)):
            if columns.stop > columns.start:
                out[..., columns] = source[..., list(parts)]
        if self.scale.stop > self.scale.start:
            out[..., self.scale] = seen.by_scale[..., None]
        if self.offset.stop > self.offset.start:
            out[:, 0, self.offset] = 1.0


def frame_parts(data: Dataset, motion: Motion) -> tuple[int, ...]:
    """Return the components of an unknown frame that the instrument can determine."""
    return data.kind.frame_parts(motion, data.to_q is not None)


def target_parts(data: Dataset, motion: Motion) -> tuple[int, ...]:
    """Return the components of an unknown target point that the instrument can determine."""
    return data.kind.target_parts(motion, data.frame.fitted or data.to_q is not None)


def lay_out(mechanism: Mechanism, datasets: Sequence[Dataset], free: Sequence[int],
            pivots: Sequence[Array] | None) -> tuple[tuple[NuisanceColumns, ...], tuple[str, ...]]:
    """Return each data set's nuisance columns, and the names of all columns (C,).

    Args:
        mechanism: names the parameters.
        datasets: their nuisance columns follow the parameters, in this order.
        free: indices of the parameters to fit.
        pivots: points about which frames are turned (3,), one for each data set, m in the
            measuring frame  [default: each one's centroid].
    """
    names = [mechanism.names[p] for p in free]
    motion = mechanism.motion
    opens: dict[int, NuisanceColumns] = {}
    by_name: dict[str, NuisanceColumns] = {}
    by_body: dict[str, NuisanceColumns] = {}
    turn_parts = tuple(p - 3 for p in motion.measured_turns)
    # a frame that another data set owns must have its columns before it is referenced
    for i, data in sorted(enumerate(datasets), key=lambda d: bool(d[1].frame.same_as)):
        def take(wanted: bool, labels: Sequence[str], data: Dataset = data) -> slice:
            begin = len(names)
            if wanted:
                names.extend(f"{label} of {data.name}" for label in labels)
            return slice(begin, len(names))

        parts, points = frame_parts(data, motion), target_parts(data, motion)
        frame = take(data.frame.fitted and not data.frame.same_as,
                     [f"frame.{POSE_COORDINATES[p]}" for p in parts])
        about = pivots[i] if pivots else pivot(data)
        owner = by_name.get(data.frame.same_as or "")
        if owner is not None:
            frame, about, parts = owner.frame, owner.about, owner.frame_parts
        target = take(data.target.fitted, [f"target.{POSE_COORDINATES[p]}" for p in points])
        turns = data.target_rotation.fitted and motion.turns and (
            data.kind.sees_rotation or data.kind.of_turn is not None)
        turn = take(turns, [f"target_rotation.{POSE_COORDINATES[3 + p]}" for p in turn_parts])
        # the targets of one file share one instrument and one homing
        file = by_body.get(data.body) if data.body else None
        homing = file.homing if file and data.homing == "per-file" else take(
            (i > 0 and data.homing == "per-file") or data.homing == "alone",
            [f"homing.{a}" for a in mechanism.actuators])
        scale = file.scale if file else take(data.scale.fitted, ["scale"])
        offset = take(data.offset.fitted, [f"offset.{POSE_COORDINATES[data.kind.place]}"]
                      if data.offset.fitted else ())
        opens[i] = NuisanceColumns(frame, target, turn, homing, scale, offset, parts, points,
                                   turn_parts, np.where(np.isfinite(about), about, 0.0))
        by_name[data.name] = opens[i]
        by_body.setdefault(data.body, opens[i])
    return tuple(opens[i] for i in range(len(opens))), tuple(names)


def turned_about(frame: Array, step: Array, about: Array) -> Array:
    """Return frame motors (..., 8) displaced by step[..., :3], turned by the rest about a point."""
    turn = cga.motor_from_rotation_vector(step[..., 3:], np.zeros(3))
    shift = about + step[..., :3] - cga.move_point(turn, about)
    return cga.compose(cga.motor_from_rotation_vector(step[..., 3:], shift), frame)


TARGET, TURN, SCALE = 6, 9, 12
"""First numbers of the parts of a registration; those of the frame start at 0."""


class InstrumentTables(NamedTuple):
    """An instrument at its station.

    ``frame`` (12,): rotation row by row and translation; ``frame_rotor``, ``body`` (4,): rotors of
    the frame and of the measured body; ``target`` (3,); ``slope`` (9,): left Jacobian of the body's
    rotation vector; ``about`` (3,): the frame's pivot; ``scale`` of lengths; ``planar``: rotations
    are angles about z; ``coordinates`` (m,): which of x, y, z, rx, ry, rz are measured; ``parts``
    (f,): open parts, 0-5 of the frame, then target, turn and scale.
    """

    frame: Array
    frame_rotor: Array
    body: Array
    target: Array
    slope: Array
    about: Array
    scale: float
    planar: bool
    coordinates: Ints
    parts: Ints
