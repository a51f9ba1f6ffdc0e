"""A machine to scale, in the units of its file: what a drawing of it is made from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.io.results.record import Finite, Flag, Part, Text
from ppmcal.io.results.scene_machine import (
    MachineStand,
    MeasuredPose,
    Point,
    SceneEffect,
    SceneFrame,
    SceneMachine,
    machine_frames,
)
from ppmcal.kinematics.closed_at_home import home_gaps
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_attempt
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.pose_sweep import PoseSweep, pose_sweep
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import NOTE, Note
from ppmcal.units import Units, coordinate_quantity

FORMAT = "ppmcal/scene/1"
SHOWN_PART = 0.05
"""Magnified, the largest difference is about this part of the reach."""
SHOWN_ROOM = 0.15
"""Magnified, the largest error is at most this part of the room that the rows take."""


@dataclass(frozen=True)
class ScenePoses:
    """Poses to draw the machine at beside home and those about it, by their joint values.

    ``labels`` and ``keys`` of the rows; ``q`` (R, k), SI.
    """

    labels: Sequence[str]
    keys: Sequence[str]
    q: Array


class Scene(Part):
    """A machine, if need be with a second one over it, and measured rows.

    Attributes:
        coordinates, coordinate_units: of every pose; actuators, joint_units: of every q, in words
            where a drive counts in its own, such as revolutions.
        flat: whether all of it lies in the x-y plane.
        still: coordinates that are not moved among the poses.
        machines: the one that is drawn, then the one that is laid over it.
        about_home: so many of the poses are home and those about it, the first ones.
        magnification: of the second machine's differences.
        error_magnification, error_magnification_before: of the error vectors after and before.
        value, value_unit, turn_unit: what measured rows are coloured by; of their rotations.
        effects: what the model has beside its geometry, and where.
    """

    format: Text = FORMAT
    name: Text
    motion: Text
    flat: Flag
    units: Units
    reach: Finite
    coordinates: tuple[Text, ...]
    coordinate_units: tuple[Text, ...]
    actuators: tuple[Text, ...]
    joint_units: tuple[Text, ...]
    still: tuple[Text, ...] = ()
    machines: tuple[SceneMachine, ...]
    about_home: int = 1
    magnification: Finite = 1.0
    error_magnification: Finite = 1.0
    error_magnification_before: Finite = 1.0
    measured: tuple[MeasuredPose, ...] = ()
    value: Text = ""
    value_unit: Text = ""
    turn_unit: Text = ""
    effects: tuple[SceneEffect, ...] = ()
    notes: tuple[Text, ...] = ()

    @classmethod
    def of(cls, mechanism: Mechanism, measured: Sequence[MeasuredPose] = (), value: str = "",
           value_unit: str = "", poses: ScenePoses | None = None,
           effects: Sequence[SceneEffect] = (), present: str = "present values",
           notes: Sequence[str] = ()) -> Scene:
        """Return the scene of a machine at home, at poses about it and at given ones.

        Without effects. A machine whose values are not its nominal ones is laid over the nominal
        one, at the same joint values. One that does not reach home is drawn as far as it goes.

        Args:
            mechanism: the machine.
            measured: rows with errors, in units of the file; their ``frame`` is one of ``poses``.
            value: what they are coloured by.
            value_unit: its unit.
            poses: further poses to draw it at.
            effects: what to light.
            present: what the second machine is called.
            notes: to be said beside the drawing.
        """
        units = mechanism.units
        plain = replace(mechanism, effects=())
        nominal = plain.nominal()
        moved = not np.array_equal(plain.values, plain.nominals)
        first = nominal if moved else plain
        sweep = pose_sweep(Model(first))
        stand, kept = _stand(first, sweep, None if sweep.lost else poses)
        drawn = [machine_frames(first, "nominal" if moved else plain.name, stand, True)]
        if moved:
            drawn.append(machine_frames(plain, present, _other_stand(plain, stand), False))
        reach = mechanism.reach / units.factor("length")
        about = len(sweep.pose)
        rows = tuple(_with_frame(m, kept, about) for m in measured)
        return cls(
            name=mechanism.name, motion=mechanism.motion.name, flat=mechanism.motion.planar,
            units=units, reach=reach, coordinates=mechanism.coordinates,
            coordinate_units=tuple(units.name(coordinate_quantity(c))
                                   for c in mechanism.coordinates),
            actuators=mechanism.actuators, joint_units=joint_words(mechanism),
            still=() if sweep.lost else tuple(POSE_COORDINATES[c] for c in sweep.still),
            machines=tuple(drawn), about_home=about, magnification=_of_machines(reach, drawn),
            error_magnification=_of_errors(reach, measured, [m.error for m in measured]),
            error_magnification_before=_of_errors(reach, measured,
                                                  [m.error_before for m in measured]),
            measured=rows, value=value, value_unit=value_unit, turn_unit=units.name("angle"),
            effects=tuple(effects), notes=(*notes, *_own_notes(mechanism, effects)))


def joint_words(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the unit of each joint value; of one with a drive ratio how far a unit goes."""
    def own(ratio: float, quantity: str) -> str:
        return mechanism.units.words(ratio, quantity, 4).replace(" ", "\N{NO-BREAK SPACE}")

    return tuple(name or f"units of {own(ratio, quantity)}"
                 for (_, name), ratio, quantity in zip(
                     mechanism.joint_units, mechanism.joint_ratios.tolist(),
                     mechanism.actuator_quantity, strict=True))


def _own_notes(mechanism: Mechanism, effects: Sequence[SceneEffect]) -> tuple[Note, ...]:
    if not mechanism.effects or effects:
        return ()
    return (Note("Effects of the file are left out: this is its geometry.", NOTE),)


def _with_frame(m: MeasuredPose, kept: Array, about: int) -> MeasuredPose:
    """Return a row with its pose counted among those of the scene."""
    if m.frame is None:
        return m
    frame = int(kept[m.frame]) if m.frame < len(kept) else -1
    return m.changed(**{"frame": about + frame, "own": m.own} if frame >= 0
                        else {"frame": None, "own": False})


def _stand(first: Mechanism, sweep: PoseSweep, poses: ScenePoses | None
           ) -> tuple[MachineStand, Array]:
    """Return where the drawn machine stands, and the place of each of ``poses`` there, or -1."""
    labels = ["home", *(_label(first, sweep, n) for n in range(1, len(sweep.pose)))]
    pose, keys, q = pose_motor(sweep.pose), [""] * len(labels), _with_given_home(first, sweep.q)
    if poses is None or not len(poses.q):
        return MachineStand(tuple(labels), tuple(keys), pose, q), np.full(
            0 if poses is None else len(poses.q), -1)
    found = forward(Model(first), poses.q).pose
    good = finite_rows(found)
    place = np.where(good, np.cumsum(good) - 1, -1)
    rows = np.flatnonzero(good).tolist()
    return MachineStand(
        (*labels, *(poses.labels[n] for n in rows)), (*keys, *(poses.keys[n] for n in rows)),
        np.concatenate([pose, found[good]]), np.concatenate([q, poses.q[good]])), place


def _with_given_home(first: Mechanism, q: Array) -> Array:
    """Return the joint values with the file's own at home for limbs that do not close there."""
    out = np.array(q)
    for limb, gap in zip(first.limbs, home_gaps(first), strict=False):
        if gap.open:
            out[0, limb.actuator] = first.home_q[limb.actuator]
    return out


def _other_stand(plain: Mechanism, stand: MachineStand) -> MachineStand:
    """Return where the machine at its present values stands with the same joint values.

    At the same pose where it has none there.
    """
    pose = np.array(stand.pose)
    good: Bools = np.zeros(len(pose), dtype=bool)
    if not home_attempt(plain).lost:
        found = forward(Model(plain), stand.q, stand.pose, stand.q).pose
        good = finite_rows(found)
        pose[good] = found[good]
    return replace(stand, pose=pose, own_joints=good)


def _label(mechanism: Mechanism, sweep: PoseSweep, n: int) -> str:
    """Return what a pose about home is called: by how much which coordinate is moved."""
    name, by = POSE_COORDINATES[sweep.coordinate[n]], sweep.step[n]
    size = mechanism.units.words(abs(by), coordinate_quantity(name), 3)
    return f"{name} {'+' if by > 0 else '−'} {size}"


def _of_machines(reach: float, drawn: Sequence[SceneMachine]) -> float:
    """Return by how much the differences of two machines are magnified."""
    if len(drawn) < 2:
        return 1.0
    a, b = (_points(machine.frames[0]) for machine in drawn)
    return _magnification(reach, (a - b).tolist()) if a.shape == b.shape else 1.0


def _of_errors(reach: float, measured: Sequence[MeasuredPose],
               errors: Sequence[Point | None]) -> float:
    """Return by how much errors are magnified, judged by the rows that were used.

    The longest is as long as a part of the reach, or, where the rows lie close together, of the
    room that they take.
    """
    own = [e for e, m in zip(errors, measured, strict=True) if m.used and e]
    room = float(np.ptp([m.point for m in measured], axis=0).max(initial=0.0)) if measured else 0.0
    size = min(SHOWN_PART * reach, SHOWN_ROOM * room) if room > 0.0 else SHOWN_PART * reach
    return _magnification(reach, own or [e for e in errors if e], size)


def _magnification(reach: float, differences: Sequence[Sequence[float]],
                   size: float | None = None) -> float:
    """Return 1, 2 or 5 times a power of ten, by which the largest difference can be seen."""
    largest = max([math.hypot(*d) for d in differences], default=0.0)
    if not largest > 1e-300:
        return 1.0
    wanted = (SHOWN_PART * reach if size is None else size) / largest
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, float(power * max(s for s in (1.0, 2.0, 5.0) if s * power <= wanted)))


def _points(frame: SceneFrame) -> Array:
    return np.array([p for limb in frame.limbs for p in
                     (limb.base, limb.platform, *limb.joints)], dtype=float).reshape(-1, 3)
