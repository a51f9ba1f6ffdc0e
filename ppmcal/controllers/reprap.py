"""RepRapFirmware's delta arithmetic against a machine: what it makes of a command.

Tower i stands at (R cos w_i, R sin w_i) with w = 210 deg + X, 330 deg + Y, 90 deg + Z of M665. For
a point (x, y, z) its carriage goes to

    h_i = sqrt(L_i^2 - (x - R cos w_i)^2 - (y - R sin w_i)^2) + z + x A / 100 + y B / 100

and homing has set it to H + sqrt(L_i^2 - R^2) + e_i, with e = X, Y, Z and A, B of M666
(RepRapFirmware, ``LinearDeltaKinematics.cpp``: Recalc, Transform, OnHomingSwitchTriggered). Only
H + e_i counts. The firmware's own calibration leaves e with mean 0
(NormaliseEndstopAdjustments there), and so does :func:`delta_of`.

Without A and B these are Klipper's numbers, counted from elsewhere, and are fitted as such. A and
B stay 0: a plane through the endstops tilts every level of the machine as they do, so that the
two are nearly one. Fitting them as well took 2 to 6 % off what remained with leaning towers.

Here in double precision and without steps; the firmware has single precision, 3e-5 mm at 300 mm.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ppmcal.controllers import klipper_fit
from ppmcal.controllers.export import Exported, Number
from ppmcal.controllers.klipper import MM, KlipperDrive, drive_of, driven, triple
from ppmcal.controllers.klipper_config import ANGLES, DeltaGeometry
from ppmcal.controllers.klipper_fit import DISC, HEIGHTS, Export, KlipperTerms, error_summary
from ppmcal.controllers.reprap_config import (
    Delta,
    Lines,
    format_delta,
    parse_lines,
    read_delta,
    read_lines,
)
from ppmcal.errors import BadInput, NoResult
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

TERMS = KlipperTerms("RepRapFirmware", ("X", "Y", "Z"), "delta radius R",
              "H of M665 and X, Y, Z of M666", "divide its steps per mm (M92) by that")


def carriages(delta: Delta, point: Array) -> Array:
    """Return the carriage heights (N, 3) that the firmware wants for points (N, 3), m.

    nan where a rod does not reach.
    """
    angle = np.radians(np.add(ANGLES, delta.angles))
    tower_x, tower_y = delta.radius * MM * np.cos(angle), delta.radius * MM * np.sin(angle)
    x, y, z = point.T[:, :, None]
    with np.errstate(invalid="ignore"):
        up = np.sqrt((np.array(delta.rods) * MM) ** 2 - (x - tower_x) ** 2 - (y - tower_y) ** 2)
    out: Array = up + z + 0.01 * (delta.tilt[0] * x + delta.tilt[1] * y)
    return out


def homed(delta: Delta) -> Array:
    """Return the carriage heights (3,), m, that the firmware takes the endstops to be at."""
    rods = np.array(delta.rods)
    out: Array = (delta.height + np.sqrt(rods**2 - delta.radius**2) + delta.endstops) * MM
    return out


def travel(delta: Delta, point: Array) -> Array:
    """Return how far below its endstop each carriage goes for points (N, 3), (N, 3), m."""
    return homed(delta) - carriages(delta, point)


def reached(drive: KlipperDrive, delta: Delta, point: Array) -> Array:
    """Return where the machine goes (N, 3) when the firmware gets ``point`` (N, 3), m."""
    return driven(drive, travel(delta, point))


def geometry_of(delta: Delta) -> DeltaGeometry:
    """Return the same machine in Klipper's numbers, but for the tilt, which it has not."""
    return DeltaGeometry(delta.radius, triple(np.add(ANGLES, delta.angles)), delta.rods,
                    triple(np.add(delta.height, delta.endstops)))


def delta_of(geometry: DeltaGeometry, bed: float | None = None) -> Delta:
    """Return the same machine in RepRapFirmware's numbers; angles from -180 to 180 deg."""
    height = float(np.mean(geometry.endstops))
    turns = (np.subtract(geometry.angles, ANGLES) + 180.0) % 360.0 - 180.0
    return Delta(geometry.radius, geometry.arms, height, triple(turns),
                 triple(np.subtract(geometry.endstops, height)), (0.0, 0.0), bed)


def project(mechanism: Mechanism, old: Delta | None = None) -> Export[Delta]:
    """Return the machine in RepRapFirmware's numbers, rounded as they are written.

    ``old`` defaults to the nominal ones; its printable radius is kept.
    """
    found = klipper_fit.project(mechanism, None if old is None else geometry_of(old), TERMS)
    new = delta_of(found.new, None if old is None else old.bed).rounded()
    if old is None:
        old = delta_of(found.old).rounded()
    drive = drive_of(mechanism)
    at_old, at_new = (reached(drive, delta, found.points) for delta in (old, new))
    both = np.isfinite(at_old).all(axis=1) & np.isfinite(at_new).all(axis=1)
    points = found.points[both]
    return Export(new, old, error_summary(at_old[both], points),
                  error_summary(at_new[both], points), points, found.radius, found.not_expressed,
                  found.notes)


LINES = "reprap.g"
TOWERS = "XYZ"
FAR = 5.0
"""Endstops that move by more than this, mm, are rather a mistake in the model."""


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine as M665 and M666; see :class:`ppmcal.controllers.export.Exporter`."""
    if poses is not None:
        raise BadInput("reprap takes numbers, not poses", "--poses", "Leave it out")
    present = None if old is None else read_lines(old)
    found = project(mechanism, None if present is None else read_delta(present))
    notes = (*found.notes, *_notes(found))
    text = format_delta(found.new, _comment(found, notes, mechanism.name))
    if read_delta(parse_lines(text, LINES)) != found.new:
        raise NoResult("the lines read back as other numbers", LINES,
                       "This is a fault of ppmcal; do not use them")
    return Exported(
        "reprap", "RepRapFirmware", {LINES: text},
        "RepRapFirmware's numbers hold "
        + ("most of the geometry, fitted" if found.not_expressed else "all of the geometry"),
        tuple(_numbers(found)),
        f"{len(found.points)} points, {found.radius * 1e3:.0f} mm around the middle, z 0 to 100 "
        "mm; offset and rotation on the bed ignored",
        found.before, found.after, found.not_expressed, notes, tuple(_advice(present, found)),
        {"grid": {"points": len(found.points), "radius": found.radius / MM,
                  "part_of_radius": DISC, "z": [z / MM for z in HEIGHTS]}},
        np.pad(found.points, ((0, 0), (0, 3))))


def _numbers(found: Export[Delta]) -> Iterator[Number]:
    old, new = (dict(_named(delta)) for delta in (found.old, found.new))
    for (name, unit), value in new.items():
        yield Number(name, old.get((name, unit)), value, unit)


def _named(delta: Delta) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield (name, unit) and value of what is written."""
    for tower, rod in zip(TOWERS, delta.rods, strict=True):
        yield (f"M665 L of {tower}", "mm"), rod
    yield ("M665 R", "mm"), delta.radius
    yield ("M665 H", "mm"), delta.height
    if delta.bed is not None:
        yield ("M665 B", "mm"), delta.bed
    for tower, angle in zip(TOWERS, delta.angles, strict=True):
        yield (f"M665 {tower}", "deg"), angle
    for tower, end in zip(TOWERS, delta.endstops, strict=True):
        yield (f"M666 {tower}", "mm"), end
    for letter, tilt in zip("AB", delta.tilt, strict=True):
        yield (f"M666 {letter}", "%"), tilt


def _notes(found: Export[Delta]) -> Iterator[str]:
    """Yield what a user should know of the firmware's conventions."""
    if any(found.new.endstops) or any(found.old.endstops):
        yield ("X, Y, Z of M666 have mean 0 and H holds the rest, as the firmware's own "
               "calibration leaves them: only their sums with H count")
    if len(set(found.new.rods)) > 1:
        yield "three rods in L of M665 need firmware 2.03 or later"
    if any(found.old.tilt):
        yield ("the tilt of the bed, A and B of M666, becomes 0: heights of endstops tilt every "
               "level in the same way, and hold it")


def _advice(present: Lines | None, found: Export[Delta]) -> Iterator[str]:
    """Yield how to bring the lines in, and what to check of the old ones."""
    yield (f"Put the lines of {LINES} in place of M665 and M666 in config.g; where M501 runs "
           "there, those of config-override.g win: change them there, or take them out.")
    if present is not None:
        higher = float(np.mean(np.subtract(found.new.endstops, found.old.endstops)))
        higher += found.new.height - found.old.height
        if abs(higher) > FAR:
            yield (f"The endstops go {higher:+.1f} mm from where {present.source} has them: before "
                   "you home, check that the model's `limits` end there.")
        for place in present.overruled():
            yield (f"{present.source}: {place} runs another file, which is not followed: if that "
                   "holds M665 or M666, give it as --old.")


def _comment(found: Export[Delta], notes: tuple[str, ...], name: str) -> str:
    lines = [f"{name}: error if the model is exact {found.after.words()}, before "
             f"{found.before.words()}.",
             "Put these in place of M665 and M666 in config.g, then home. If config.g runs M501,",
             "M665 and M666 in config-override.g win: change them there. M500 writes them anew,",
             "with 3 decimals. A0 B0 is meant: X, Y, Z of M666 hold the tilt of the bed."]
    if found.new.bed is None:
        lines.append("B, the printable radius, stays as it is: no --old said it.")
    return "\n".join([*lines, *(f"Cannot be expressed: {one.what}." for one in found.not_expressed),
                      *(f"Note: {note}." for note in notes)])
