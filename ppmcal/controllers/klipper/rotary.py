"""Klipper's rotary delta: what ``printer.cfg`` says of one, and the firmware's arithmetic.

Arm i turns in the upright plane through the middle at angle w_i, about a shoulder at radius R and
height H over the bed. For a point (x, y, z), with

    c = y cos w - x sin w,    d = x cos w + y sin w - R,    e = z - H,

its elbow is where the arm's circle and that of the rods in the plane, of radius
sqrt(lower^2 - c^2) about (d, e), meet, farther out; the motor's angle is that of the arm over the
horizontal. Homing sets it to the angle for (0, 0, ``position_endstop``), and motors count down
from there (Klipper: ``rotary_delta.py``, ``kin_rotary_delta.c``). Steps are not rounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.delta.fit import (
    ENOUGH,
    EXACT,
    disc,
    error_summary,
    laid_on,
    reached_with_both,
)
from ppmcal.controllers.delta.geometry import DIGITS, MM, TOWERS, Triple, endstop, triple, unit_of
from ppmcal.controllers.delta.importer import NOZZLE, touch_files
from ppmcal.controllers.export import Exported, NotExpressed, Number, effects_lacking, head, misread
from ppmcal.controllers.importing import MACHINE, Imported, machine_head
from ppmcal.controllers.klipper.config import (
    Config,
    config_lines,
    geared,
    moved,
    parse_config,
    read_config,
    read_touches,
)
from ppmcal.controllers.number_intervals import fitted, following
from ppmcal.controllers.pose_errors import ErrorSummary
from ppmcal.controllers.text import Rounded
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.limbs.spatial import RUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.wording import pluralize

KINEMATICS = "rotary_delta"
SHOULDERS = (30.0, 150.0, 270.0)
"""Angles of the arms where nobody says, degrees."""
FILE = "klipper.cfg"
ACROSS, HEIGHTS, DISC = 7, (0.0, 0.02, 0.04), 0.6
"""Points are tried over a disc of this part of the shoulders' radius, or of the upper arms."""
ROUNDED = 1e-7
"""Errors below this are those of the decimals that are written, m."""
SCALES = np.array([1.0, 1.0, *[0.3] * 3, *[1.0] * 9])
FITTED = np.arange(14) != 4
"""Arm c keeps its angle."""
STEP = 1e-4
"""Step of differences by the numbers, of their scales."""


@dataclass(frozen=True)
class RotaryDelta(Rounded, digits=DIGITS):
    """The numbers of a rotary delta: mm and degrees; triples are arms a, b, c."""

    radius: float
    height: float
    angles: Triple
    upper: Triple
    lower: Triple
    endstops: Triple

    def named(self) -> dict[str, float]:
        """Return ``section.key`` and value of each number, mm and degrees."""
        out = {"printer.shoulder_radius": self.radius, "printer.shoulder_height": self.height}
        for i, arm in enumerate(TOWERS):
            out |= {f"stepper_{arm}.angle": self.angles[i],
                    f"stepper_{arm}.upper_arm_length": self.upper[i],
                    f"stepper_{arm}.lower_arm_length": self.lower[i],
                    f"stepper_{arm}.position_endstop": self.endstops[i]}
        return out

    def array(self) -> Array:
        """Return the numbers (14,) in their order."""
        return np.hstack([*vars(self).values()])

    @classmethod
    def of(cls, numbers: Array) -> RotaryDelta:
        """Return the geometry of numbers (14,)."""
        return cls(float(numbers[0]), float(numbers[1]),
                   *(triple(numbers[i:i + 3]) for i in (2, 5, 8, 11)))


def is_rotary(config: Config) -> bool:
    """Return whether a ``printer.cfg`` is that of a rotary delta."""
    kind = config.sections.get("printer", {}).get("kinematics")
    return kind is not None and kind.text == KINEMATICS


def read_rotary(config: Config) -> RotaryDelta:
    """Return the numbers of a ``printer.cfg``; b and c default to a's, as in the firmware.

    Raises:
        BadInput: a number is missing, or the arms do not get to the middle.
    """
    if not is_rotary(config):
        raise BadInput(f"kinematics is not {KINEMATICS}", config.at("printer", "kinematics"),
                       "Give the printer.cfg of a rotary delta")
    delta = RotaryDelta(
        config.number("printer", "shoulder_radius", positive=True),
        config.number("printer", "shoulder_height", positive=True),
        config.each("angle", SHOULDERS), *(config.each(key, positive=True) for key in (
            "upper_arm_length", "lower_arm_length", "position_endstop")))
    for arm, angle in zip(TOWERS, endstop_angles(delta), strict=True):
        if not math.isfinite(angle):
            raise BadInput(f"arm {arm} does not get to the middle at its endstop",
                           config.at(f"stepper_{arm}", "lower_arm_length"),
                           "Check shoulder_radius, shoulder_height and both lengths")
    return delta


def read_motor_step(config: Config, arm: str) -> float:
    """Return the motor's turn per microstep, degrees: a turn of the arm unless the file says.

    Raises:
        BadInput: the numbers give none.
    """
    name = f"stepper_{arm}"
    steps = config.number(name, "full_steps_per_rotation", 200.0, positive=True)
    steps *= config.number(name, "microsteps", positive=True)
    gear = config.section(name).get("gear_ratio")
    if gear is None or not gear.text:
        raise BadInput("is missing", config.at(name, "gear_ratio"),
                       "Klipper wants the teeth from motor to arm, such as `107:16, 60:16`")
    return 360.0 / geared(config, name, steps, "107:16, 60:16")


def arm_angles(delta: RotaryDelta, point: Array) -> Array:
    """Return the motors' angles (N, 3) for points (N, 3), m; rad over the horizontal.

    nan where an arm does not get there.
    """
    turn = np.radians(delta.angles)
    x, y, z = (point[:, None, i] / MM for i in range(3))
    across = y * np.cos(turn) - x * np.sin(turn)
    out = x * np.cos(turn) + y * np.sin(turn) - delta.radius
    up = z - delta.height
    upper, lower = np.array(delta.upper), np.array(delta.lower)
    far = np.hypot(out, up)
    with np.errstate(invalid="ignore", divide="ignore"):
        # the triangle of shoulder, elbow and the rods' end in the arm's plane
        inner = np.arccos((far**2 + upper**2 - lower**2 + across**2) / (2.0 * upper * far))
        inner = np.where(lower**2 >= across**2, inner, np.nan)
    toward = np.arctan2(up, out)
    both = np.stack([toward + inner, toward - inner])
    # the elbow that is farther out
    chosen = np.where(np.cos(both[0]) >= np.cos(both[1]), both[0], both[1])
    return np.asarray((chosen + np.pi) % (2.0 * np.pi) - np.pi)


def endstop_angles(delta: RotaryDelta) -> Array:
    """Return the motors' angles (3,) at the endstops, rad."""
    points = np.pad(MM * np.array(delta.endstops)[:, None], ((0, 0), (2, 0)))
    return np.asarray(np.diagonal(arm_angles(delta, points)))


def imported(path: Path) -> Imported:
    """Return a rotary delta of a ``printer.cfg``, with what DELTA_CALIBRATE measured.

    Raises:
        BadInput: anything wrong in the file.
    """
    config = read_config(path)
    delta = read_rotary(config)
    rows, pairs, _ = read_touches(config)
    limbs = "".join(_arm(delta, i, float(end)) for i, end in enumerate(
        np.degrees(endstop_angles(delta))))
    machine = f"""\
# A rotary delta, with the numbers that it prints with. Only the difference of shoulder radius and
# effector radius shows, so the former is shoulder_radius and the latter 0.
{machine_head(f"rotary delta of {path.name}", NOZZLE)}limbs:
{limbs}home: {{pose: {{x: 0, y: 0, z: 0}}}}
# one standard deviation each of: shoulders, angles, endstops, arms and rods
tolerances: {{point: 1, angle: 0.5, offset: 1, length: 1}}
"""
    steps = [read_motor_step(config, t) for t in TOWERS] if rows or pairs else []
    texts = {MACHINE: machine, **touch_files(moved(rows, steps), moved(pairs, steps),
                                             "how far arms were below their endstops")}
    findings = [] if rows else [Note(
        "the file holds no measured heights: run DELTA_CALIBRATE and SAVE_CONFIG on the printer, "
        "then import again", topic="heights")]
    return Imported(
        texts, f"{path}: a rotary delta with {pluralize(len(rows), 'height')} and "
        f"{pluralize(len(pairs), 'distance')}.",
        {"heights": len(rows), "distances": len(pairs), "nominal": delta.named()},
        tuple(findings), config.files)


def _arm(delta: RotaryDelta, i: int, end: float) -> str:
    turn = np.radians(delta.angles[i])
    c, s = float(np.cos(turn)) + 0.0, float(np.sin(turn)) + 0.0
    held = ", fixed: true" if i == 2 else ""
    return f"""\
  - name: {TOWERS[i]}
    kind: {RUS.name}
    base:
      point:
        radius: {{share: shoulder_radius, value: {delta.radius!r}}}
        angle: {{value: {delta.angles[i]!r}{held}}}
        z: {{share: shoulder_height, value: {delta.height!r}}}
      axis: [{s!r}, {-c!r}, 0]      # of the motor: u lifts the arm
      zero: [{c!r}, {s!r}, 0]       # outwards
    platform:
      point: {{value: [0, 0, 0], fixed: true}}
    proximal: {delta.upper[i]!r}    # upper_arm_length
    distal: {delta.lower[i]!r}      # lower_arm_length
    ratio: -1    # q is the turn down from the endstop in degrees, whatever the microsteps
    offset: {end!r}    # the arm at position_endstop, degrees over the horizontal
    branch: -1    # the elbow outside, where q is smaller
"""


def is_rotary_delta(mechanism: Mechanism) -> bool:
    """Return whether a machine is three driven cranks that move a platform without turning it."""
    return (not mechanism.motion.turns and len(mechanism.limbs) == 3 == len(mechanism.actuators)
            and all(limb.kind is RUS for limb in mechanism.limbs))


@dataclass(frozen=True, eq=False)
class RotaryDrive:
    """How turns from the endstops become joint values: ``zero`` (3,) less ``scale`` (3,) a rad."""

    mechanism: Mechanism
    zero: Array
    scale: Array

    def reached(self, delta: RotaryDelta, point: Array) -> Array:
        """Return where the machine goes (N, 3), m, when the firmware is told ``point`` (N, 3)."""
        q, down = np.empty_like(point), endstop_angles(delta) - arm_angles(delta, point)
        q[:, [limb.actuator for limb in self.mechanism.limbs]] = self.zero - self.scale * down
        return np.asarray(cga.translation(forward(Model(self.mechanism), q).pose))


def drive_of(mechanism: Mechanism) -> RotaryDrive:
    """Return how the firmware would drive the machine.

    Raises:
        BadInput: no endstop is known.
    """
    zero, scale = np.zeros(3), np.zeros(3)
    for i, limb in enumerate(mechanism.limbs):
        lifts = np.cross(limb.constants["base.axis"], limb.constants["base.zero"])[2]
        ratio = limb.slots.values(mechanism.nominals).get("ratio", 1.0) * np.sign(lifts)
        zero[i] = endstop(mechanism, limb.actuator, ratio, f"{mechanism.source}: limbs.{limb.name}",
                          "Give `limits` whose end with the arm up is the endstop")
        scale[i] = 1.0 / ratio
    return RotaryDrive(mechanism, zero, scale)


def export_rotary(mechanism: Mechanism, old: Path | None) -> Exported:
    """Return a rotary delta in Klipper's numbers; see :class:`ppmcal.controllers.export.Exporter`.

    Raises:
        BadInput: no endstop is known, or the old file is another machine's.
        NoResult: it does not reach the bed, or the lines read back as others.
    """
    drive, first = drive_of(mechanism), drive_of(mechanism.nominal())
    points = _points(mechanism)
    exact = _best(drive, points)
    new = exact.rounded()
    was = (_best(first, points).rounded() if old is None
           else read_rotary(read_config(old)))
    at_old, at_new = drive.reached(was, points), drive.reached(new, points)
    both = reached_with_both(at_old, at_new, mechanism.source, "position_endstop")
    before, after = (error_summary(at[both], points[both]) for at in (at_old, at_new))
    lacks = tuple(_lacks(mechanism, after))
    olds = was.named()
    return Exported(
        "klipper", "Klipper", {FILE: _text(mechanism, new, before, after, lacks)},
        f"Klipper's numbers hold {'most of it, fitted' if lacks else 'all of the geometry'}",
        tuple(Number(n, olds[n], v, unit_of(n)) for n, v in new.named().items()),
        f"{int(both.sum())} points over the bed, z 0 to {1e3 * HEIGHTS[-1]:.0f} mm; offset and "
        "rotation on the bed ignored", before, after, lacks, (), (Note(
            f"Paste the lines of {FILE} into {old or 'printer.cfg'}, above its #*# lines and "
            "below all other sections: there they win. Keep `gear_ratio` as it is.", NOTE),),
        poses=np.pad(points[both], ((0, 0), (0, 3))),
        again=following(lambda m: _errors(drive_of(m), points, exact.array()), mechanism,
                        exact.array()[FITTED], STEP * SCALES[FITTED],
                        lambda p: _filled(exact.array(), p).named()))


def _text(mechanism: Mechanism, new: RotaryDelta, before: ErrorSummary, after: ErrorSummary,
          lacks: Sequence[NotExpressed]) -> str:
    """Return the lines, read back as the same numbers."""
    text = config_lines(new.named(), head(mechanism.name, before, after, lacks, how=[
        "Paste above the #*# lines of printer.cfg, below all other sections: there they win."]))
    if read_rotary(parse_config(f"[printer]\nkinematics: {KINEMATICS}\n{text}", FILE)) != new:
        raise misread(FILE)
    return text


def _points(mechanism: Mechanism) -> Array:
    """Return points (N, 3), m, over the bed that the nominal machine reaches within its limits."""
    nominal = mechanism.nominal()
    firmware = _read_off(drive_of(nominal))
    radius = DISC * max(firmware.radius, *firmware.upper) * MM
    points = disc(radius, ACROSS, HEIGHTS)
    at = drive_of(nominal).reached(firmware, points)
    points = points[finite_rows(at) & finite_rows(drive_of(mechanism).reached(firmware, points))]
    if len(points) < ENOUGH:
        raise NoResult(f"the machine reaches next to nothing between z = 0 and "
                       f"{1e3 * HEIGHTS[-1]:.0f} mm", mechanism.source,
                       "The bed is z = 0: put the origin there, below the arms, and check "
                       "`limits`")
    return np.asarray(points)


def _read_off(drive: RotaryDrive) -> RotaryDelta:
    """Return the numbers as they are about: each arm's own, the shoulders' mean."""
    mechanism, rows = drive.mechanism, []
    for zero_at, limb in zip(drive.zero, mechanism.limbs, strict=True):
        v = limb.slots.values(mechanism.values)
        zero, axis = (limb.constants[f"base.{c}"] for c in ("zero", "axis"))
        u = v.get("ratio", 1.0) * zero_at + v.get("offset", 0.0)
        rows.append([*((v.get(f"base.point.{c}", 0.0) - v.get(f"platform.point.{c}", 0.0)) / MM
                       for c in "xyz"),
                     float(np.degrees(np.arctan2(zero[1], zero[0]))) % 360.0,
                     v["proximal"] / MM, v["distal"] / MM,
                     np.arctan2(zero[2], np.hypot(zero[0], zero[1]))
                     + np.sign(np.cross(axis, zero)[2]) * u])
    x, y, up, angles, upper, lower, ends = np.array(rows).T
    radius, height = float(np.hypot(x, y).mean()), float(up.mean())
    elbow = np.array([radius + upper * np.cos(ends), height + upper * np.sin(ends)])
    # the height of (0, 0, z) whose rods end at that elbow
    with np.errstate(invalid="ignore"):
        z = elbow[1] - np.sqrt(lower**2 - elbow[0] ** 2)
    if not (height > 0.0 and np.isfinite(z).all() and (z > 0.0).all()):
        raise BadInput("the arms are not above the bed, or their rods do not reach the middle at "
                       "the endstops", mechanism.source,
                       "The bed is z = 0: put the origin there, below the arms, and check "
                       "`limits`")
    return RotaryDelta.of(np.array([radius, height, *angles, *upper, *lower, *z]))


def _best(drive: RotaryDrive, points: Array) -> RotaryDelta:
    """Return the numbers with the smallest squared errors at ``points``; arm c keeps its angle."""
    start = _read_off(drive)
    if error_summary(drive.reached(start, points), points).max < EXACT:
        return start
    whole = start.array()
    return _filled(whole, fitted(_errors(drive, points, whole), whole[FITTED],
                                 "the numbers for the firmware", 40, scale=SCALES[FITTED]))


def _filled(whole: Array, own: Array) -> RotaryDelta:
    """Return the numbers (14,) with those in their place that are fitted, (13,)."""
    numbers = whole.copy()
    numbers[FITTED] = own
    return RotaryDelta.of(numbers)


def _errors(drive: RotaryDrive, points: Array, whole: Array) -> Callable[[Array], Array]:
    """Return what makes errors at points (N, 3), mm (3N,), of the numbers that are fitted."""
    def errors(own: Array) -> Array:
        at = drive.reached(_filled(whole, own), points)
        good = finite_rows(at)
        out = np.full(points.shape, 1e3)
        out[good] = laid_on(at[good], points[good])[0] / MM
        return np.asarray(out.ravel())

    return errors


def _lacks(mechanism: Mechanism, after: ErrorSummary) -> Iterator[NotExpressed]:
    """Yield what one radius, one height and upright planes of the arms cannot hold."""
    if after.max >= ROUNDED:
        changed = tuple(p.name for p in mechanism.parameters if p.value != p.nominal
                        and any(part in p.name for part in ("base.", "platform.", "joint",
                                                            "ratio")))
        yield NotExpressed("shoulders at radii and heights of their own, axes that are not "
                           "square to the arms' planes, or gears that differ", changed, after)
    yield from effects_lacking(mechanism)
