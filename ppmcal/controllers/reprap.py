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

import numpy as np

from ppmcal.controllers import klipper_fit
from ppmcal.controllers.klipper import MM, Drive, drive_of, driven, triple
from ppmcal.controllers.klipper_fit import Export, Terms, misses_at
from ppmcal.files.klipper import ANGLES, Geometry
from ppmcal.files.reprap import Delta
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

TERMS = Terms("RepRapFirmware", ("X", "Y", "Z"), "delta radius R",
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


def reached(drive: Drive, delta: Delta, point: Array) -> Array:
    """Return where the machine goes (N, 3) when the firmware is told ``point`` (N, 3), m."""
    return driven(drive, travel(delta, point))


def geometry_of(delta: Delta) -> Geometry:
    """Return the same machine in Klipper's numbers, but for the tilt, which it has not."""
    return Geometry(delta.radius, triple(np.add(ANGLES, delta.angles)), delta.rods,
                    triple(np.add(delta.height, delta.endstops)))


def delta_of(geometry: Geometry, bed: float | None = None) -> Delta:
    """Return the same machine in RepRapFirmware's numbers; angles from -180 to 180 deg."""
    height = float(np.mean(geometry.endstops))
    turns = (np.subtract(geometry.angles, ANGLES) + 180.0) % 360.0 - 180.0
    return Delta(geometry.radius, geometry.arms, height, triple(turns),
                 triple(np.subtract(geometry.endstops, height)), (0.0, 0.0), bed)


def project(mechanism: Mechanism, old: Delta | None = None) -> Export[Delta]:
    """Return the machine in RepRapFirmware's numbers, rounded as they are written.

    ``old`` defaults to those of its drawing; its printable radius is kept.
    """
    found = klipper_fit.project(mechanism, None if old is None else geometry_of(old), TERMS)
    new = delta_of(found.new, None if old is None else old.bed).rounded()
    if old is None:
        old = delta_of(found.old).rounded()
    drive = drive_of(mechanism)
    at_old, at_new = (reached(drive, delta, found.points) for delta in (old, new))
    both = np.isfinite(at_old).all(axis=1) & np.isfinite(at_new).all(axis=1)
    points = found.points[both]
    return Export(new, old, misses_at(at_old[both], points), misses_at(at_new[both], points),
                     points, found.radius, found.lacks, found.notes)
