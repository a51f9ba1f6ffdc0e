"""``export twincat``: a rotary delta as the parameters of 3D-Delta Type 1 (P_3C).

Beckhoff documents four lengths, mm, alike for all three arms: inner and outer arm, displacement of
the motors' axes from the middle of the base and of the rods' ends from the middle of the gripper
plate (TF5110 to TF5113, Kinematic Transformation). Arms are 120 deg apart. Where a motor's 0 is and
which way it counts stands in a drawing, so that both are taken as the machine file has them: what
drives are off is given as a change of their zero. There is no file of these parameters; they are
entered in the engineering, so the text written here is a list to type from.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.export import (
    Exported,
    NotExpressed,
    Number,
    effects_lacking,
    head,
    misread,
    other_machine,
    refuse,
)
from ppmcal.controllers.klipper.rotary import RotaryDelta, arm_angles, is_rotary_delta
from ppmcal.controllers.number_intervals import fitted, following
from ppmcal.controllers.pose_errors import ErrorSummary, pose_errors
from ppmcal.controllers.pose_grid import default_grid, instrument_notes
from ppmcal.controllers.text import commented
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.limbs.spatial import RUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

FILE, DIGITS, MM = "twincat.txt", 6, 1e-3
NAMES = ("Inner arm length", "Outer arm length", "Displacement", "TCP displacement")
MOST, ENOUGH, EXACT = 100, 20, 1e-7
FITTED, SCALES, STEP = np.arange(7) != 3, np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3]), 1e-4
"""Numbers that are fitted, their scales, mm and deg, and the step of differences by them, in these.
"""
EVEN = 0.5
"""Arms are 120 degrees apart, and level at u = 0, to this, degrees."""
NOTES = (
    Note("the zero of each motor and its sense are those of the machine file: Beckhoff's drawing "
         "of them could not be checked, so the nominal parameters must drive the machine well "
         "before these are entered", NOTE),
    Note("only the difference of Displacement and TCP displacement counts: the latter stays "
         "nominal", NOTE))
_LINE = re.compile(r"^([A-Za-z][^=#\n]*?) = (\S+) (mm|deg)$", re.MULTILINE)


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return a rotary delta as parameters; see :class:`ppmcal.controllers.export.Exporter`."""
    for given, option in ((old, "--old"), (poses, "--poses")):
        refuse(given, option, "TwinCAT's parameters are compared with the nominal ones, over the "
               "workspace")
    turns = _arms(mechanism)
    bare = replace(mechanism, effects=())
    wanted = default_grid(bare).poses(bare)
    wanted = wanted[:: 1 + len(wanted) // MOST]
    pose = inverse_partial(Model(bare), wanted).pose
    pose = pose[finite_rows(pose)]
    if len(pose) < ENOUGH:
        raise NoResult("the machine takes next to no pose within its limits", mechanism.source,
                       "Check `home` and `limits`")
    nominal = _read_off(bare.nominal(), bare)
    exact = _best(bare, turns, pose)
    new = np.round(exact, DIGITS) + 0.0
    before, after = (_errors(bare, turns, n, pose) for n in (nominal, new))
    lacks = tuple(_lacks(mechanism, after))
    numbers = tuple(Number(name, round(float(nominal[i]), DIGITS), float(new[i]),
                           "mm" if i < 4 else "deg") for i, name in enumerate(_names(mechanism)))
    lines = head(mechanism.name, before, after, lacks, how=["3D-Delta Type 1 (P_3C) of TF5112."])
    text = "\n".join([*commented(lines), *(
        f"{n.name} = {n.new:.{DIGITS}f} {n.unit}" for n in numbers)]) + "\n"
    if [v for _, v in parse(text)] != [n.new for n in numbers]:
        raise misread(FILE, "the list reads back as other numbers", "it")
    return Exported(
        "twincat", "TwinCAT", {FILE: text},
        f"TwinCAT's parameters hold {'most of it, fitted' if lacks else 'all of the geometry'}",
        numbers, f"{len(pose)} poses within the limits", before, after, lacks,
        (*NOTES, *instrument_notes(mechanism)),
        (Note(f"Type the numbers of {FILE} into the parameters of the kinematics' object, and add "
              "each change to the joint value at which its axis is homed.", NOTE),),
        poses=np.pad(cga.translation(pose), ((0, 0), (0, 3))),
        again=following(
            lambda m: _misses(replace(m, effects=()), turns, exact, pose), mechanism,
            exact[FITTED], STEP * SCALES,
            lambda p: dict(zip(_names(mechanism), _filled(exact, p).tolist(), strict=True))))


def parse(text: str) -> list[tuple[str, float]]:
    """Return name and number of each line of a list."""
    return [(name, float(value)) for name, value, _ in _LINE.findall(text)]


def _arms(mechanism: Mechanism) -> Array:
    """Return the nominal directions of the arms (3,), degrees.

    Raises:
        BadInput: no rotary delta whose arms are 120 degrees apart and level at u = 0.
    """
    if not is_rotary_delta(mechanism):
        raise other_machine(mechanism, f"3D-Delta Type 1 has three limbs {RUS.name} with "
                            "`motion: translational`")
    zero = np.array([limb.constants["base.zero"] for limb in mechanism.limbs])
    turns = np.degrees(np.arctan2(zero[:, 1], zero[:, 0]))
    apart = np.sort((turns - turns[0]) % 360.0) - [0.0, 120.0, 240.0]
    level = np.degrees(np.arcsin(np.clip(zero[:, 2], -1.0, 1.0)))
    if np.abs([*apart, *level]).max() > EVEN:
        raise BadInput("the arms are not 120 degrees apart, or not level at u = 0",
                       mechanism.source, "Export `joints`, or `grid`")
    return np.asarray(turns)


def _read_off(mechanism: Mechanism, real: Mechanism) -> Array:
    """Return the four lengths, mm, means of the arms, and the changes of the zeros (3,), rad."""
    values = Model(mechanism).limb_values
    radius = [[np.hypot(v.get(f"{part}.point.x", 0.0), v.get(f"{part}.point.y", 0.0))
               for part in ("base", "platform")] for v in values]
    lengths = np.array([[v["proximal"], v["distal"], *r]
                        for v, r in zip(values, radius, strict=True)]).mean(axis=0)
    was = Model(real.nominal()).limb_values
    shift = [(w.get("offset", 0.0) - v.get("offset", 0.0)) / w.get("ratio", 1.0)
             for v, w in zip(values, was, strict=True)]
    return np.array([*(lengths / MM), *np.degrees(shift)])


def _reached(mechanism: Mechanism, turns: Array, numbers: Array, pose: Array) -> Array:
    """Return where the machine goes when told to go to motors (N, 8)."""
    inner, outer, out, tcp = numbers[:4]
    nominal = Model(mechanism.nominal()).limb_values
    height = np.mean([v.get("base.point.z", 0.0) - v.get("platform.point.z", 0.0)
                      for v in nominal]) / MM
    a, b, c = turns.tolist()
    delta = RotaryDelta(out - tcp, float(height), (a, b, c), (inner,) * 3, (outer,) * 3, (0.0,) * 3)
    angle = arm_angles(delta, cga.translation(pose))
    q = np.empty_like(angle)
    for i, (limb, v) in enumerate(zip(mechanism.limbs, nominal, strict=True)):
        lifts = np.sign(np.cross(limb.constants["base.axis"], limb.constants["base.zero"])[2])
        q[:, limb.actuator] = ((lifts * angle[:, i] - v.get("offset", 0.0)) / v.get("ratio", 1.0)
                               + np.radians(numbers[4 + i]))
    return forward(Model(mechanism), q).pose


def _errors(mechanism: Mechanism, turns: Array, numbers: Array, pose: Array) -> ErrorSummary:
    return pose_errors(mechanism, _reached(mechanism, turns, numbers, pose), pose)


def _best(mechanism: Mechanism, turns: Array, pose: Array) -> Array:
    """Return the numbers (7,) with the smallest errors; only a difference of displacements counts.

    So that of the gripper plate stays nominal.
    """
    numbers = _read_off(mechanism, mechanism)
    numbers[2] += _read_off(mechanism.nominal(), mechanism)[3] - numbers[3]
    numbers[3] = _read_off(mechanism.nominal(), mechanism)[3]
    if _errors(mechanism, turns, numbers, pose).max < EXACT:
        return numbers
    return _filled(numbers, fitted(_misses(mechanism, turns, numbers, pose), numbers[FITTED],
                                   "the parameters for TwinCAT", 40, scale=SCALES))


def _filled(numbers: Array, own: Array) -> Array:
    """Return the numbers (7,) with those in their place that are fitted, (6,)."""
    out = numbers.copy()
    out[FITTED] = own
    return out


def _misses(mechanism: Mechanism, turns: Array, numbers: Array, pose: Array
            ) -> Callable[[Array], Array]:
    """Return what makes errors at motors (N, 8), mm (3N,), of the numbers (6,) that are fitted."""
    def errors(own: Array) -> Array:
        at = _reached(mechanism, turns, _filled(numbers, own), pose)
        away = cga.translation(at) - cga.translation(pose)
        return np.nan_to_num(away / MM, nan=1e3).ravel()

    return errors


def _names(mechanism: Mechanism) -> tuple[str, ...]:
    return (*NAMES, *(f"Change of zero of {mechanism.actuators[limb.actuator]}"
                      for limb in mechanism.limbs))


def _lacks(mechanism: Mechanism, after: ErrorSummary) -> Iterator[NotExpressed]:
    """Yield what four lengths alike for all arms cannot hold."""
    effects = {p for e in mechanism.effects for p in e.parameters.values()}
    if after.max >= EXACT:
        names = tuple(p.name for i, p in enumerate(mechanism.parameters)
                      if i not in effects and p.value != p.nominal)
        yield NotExpressed("arms that differ from each other, and shoulders out of their places",
                           names, after)
    yield from effects_lacking(mechanism)
