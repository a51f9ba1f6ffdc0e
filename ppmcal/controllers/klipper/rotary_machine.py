"""A rotary delta between Klipper's numbers and a machine: its import, its drive, its fit."""

from __future__ import annotations

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
from ppmcal.controllers.delta.geometry import MM, TOWERS, unit_of
from ppmcal.controllers.delta.importer import NOZZLE, touch_files
from ppmcal.controllers.delta.machine import endstop
from ppmcal.controllers.export import Exported, NotExpressed, Number, effects_lacking, head, misread
from ppmcal.controllers.importing import MACHINE, Imported, machine_head
from ppmcal.controllers.klipper.config import (
    config_lines,
    moved,
    parse_config,
    read_config,
    read_touches,
)
from ppmcal.controllers.klipper.rotary import (
    KINEMATICS,
    RotaryDelta,
    endstop_angles,
    read_motor_step,
    read_rotary,
    turns_down,
)
from ppmcal.controllers.number_intervals import fitted, following
from ppmcal.controllers.pose_errors import ErrorSummary
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.limbs.spatial import RUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.wording import pluralize

FILE = "klipper.cfg"
ACROSS, HEIGHTS = 7, (0.0, 0.02, 0.04)
DISC = 0.6
"""Points are tried over a disc of this part of the shoulders' radius, or of the upper arms."""
ROUNDED = 1e-7
"""Errors below this are those of the decimals that are written, m."""
SCALES = np.array([1.0, 1.0, *[0.3] * 3, *[1.0] * 9])
FITTED = np.arange(14) != 4
"""Arm c keeps its angle."""
STEP = 1e-4
"""Step of differences by the numbers, of their scales."""


# --- import ---------------------------------------------------------------------------------------


def imported(path: Path) -> Imported:
    """Return a rotary delta of a ``printer.cfg``, with what DELTA_CALIBRATE measured.

    Raises:
        BadInput: anything wrong in the file.
    """
    config = read_config(path)
    delta = read_rotary(config)
    rows, pairs = read_touches(config)
    machine = _machine_text(path, delta)
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


def _machine_text(path: Path, delta: RotaryDelta) -> str:
    """Return the printer as it prints now, a commented mechanism file."""
    limbs = "".join(_arm(delta, i, float(end)) for i, end in enumerate(
        np.degrees(endstop_angles(delta))))
    return f"""\
# A rotary delta, with the numbers that it prints with. Only the difference of shoulder radius and
# effector radius shows, so the former is shoulder_radius and the latter 0.
{machine_head(f"rotary delta of {path.name}", NOZZLE)}limbs:
{limbs}home: {{pose: {{x: 0, y: 0, z: 0}}}}
# one standard deviation each of: shoulders, angles, endstops, arms and rods
tolerances: {{point: 1, angle: 0.5, offset: 1, length: 1}}
"""


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


# --- export ---------------------------------------------------------------------------------------


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
        q = np.empty_like(point)
        own = [limb.actuator for limb in self.mechanism.limbs]
        q[:, own] = self.zero - self.scale * turns_down(delta, point)
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
    """Return the lines, read back.

    Raises:
        NoResult: as other numbers.
    """
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
    mechanism = drive.mechanism
    shoulders, angles, upper, lower, ends = [], [], [], [], []
    for i, limb in enumerate(mechanism.limbs):
        v = limb.slots.values(mechanism.values)
        shoulders.append([v.get(f"base.point.{c}", 0.0) - v.get(f"platform.point.{c}", 0.0)
                          for c in "xyz"])
        zero, axis = (limb.constants[f"base.{c}"] for c in ("zero", "axis"))
        angles.append(float(np.degrees(np.arctan2(zero[1], zero[0]))) % 360.0)
        upper.append(v["proximal"] / MM)
        lower.append(v["distal"] / MM)
        u = v.get("ratio", 1.0) * drive.zero[i] + v.get("offset", 0.0)
        lifts = np.sign(np.cross(axis, zero)[2])
        ends.append(np.arctan2(zero[2], np.hypot(zero[0], zero[1])) + lifts * u)
    at = np.array(shoulders) / MM
    radius, height = float(np.hypot(at[:, 0], at[:, 1]).mean()), float(at[:, 2].mean())
    elbow = np.array([radius + np.array(upper) * np.cos(ends),
                      height + np.array(upper) * np.sin(ends)])
    # the height of (0, 0, z) whose rods end at that elbow
    with np.errstate(invalid="ignore"):
        z = elbow[1] - np.sqrt(np.array(lower) ** 2 - elbow[0] ** 2)
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


