"""RepRapFirmware's delta arithmetic, and a delta's geometry in its numbers.

Tower i stands at (R cos w_i, R sin w_i) with w = 210 deg + X, 330 deg + Y, 90 deg + Z of M665. For
a point (x, y, z) its carriage goes to

    h_i = sqrt(L_i^2 - (x - R cos w_i)^2 - (y - R sin w_i)^2) + z + x A / 100 + y B / 100

and homing has set it to H + sqrt(L_i^2 - R^2) + e_i, with e = X, Y, Z and A, B of M666
(RepRapFirmware, ``LinearDeltaKinematics.cpp``: Recalc, Transform, OnHomingSwitchTriggered). Only
H + e_i counts. The firmware's own calibration leaves e with mean 0
(NormaliseEndstopAdjustments there), and so does :func:`delta_of`.

Without A and B these are the numbers of :class:`DeltaGeometry`, counted from elsewhere, and are
fitted as such. A and B stay 0: a plane through the endstops tilts every level of the machine as
they do, so that the two are nearly one. Fitting them as well took 2 to 6 % off what remained with
leaning towers.

Here in double precision and without steps; the firmware has single precision, 3e-5 mm at 300 mm.
"""

from __future__ import annotations

import numpy as np

from ppmcal.controllers.delta.geometry import ANGLES, MM, DeltaGeometry, triple
from ppmcal.controllers.reprap.config import Delta
from ppmcal.linalg import Array


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


def geometry_of(delta: Delta) -> DeltaGeometry:
    """Return the same machine as a delta's geometry, but for the tilt, which that has not."""
    return DeltaGeometry(delta.radius, triple(np.add(ANGLES, delta.angles)), delta.rods,
                    triple(np.add(delta.height, delta.endstops)))


def delta_of(geometry: DeltaGeometry, bed: float | None = None) -> Delta:
    """Return the same machine in RepRapFirmware's numbers; angles from -180 to 180 deg."""
    height = float(np.mean(geometry.endstops))
    turns = (np.subtract(geometry.angles, ANGLES) + 180.0) % 360.0 - 180.0
    return Delta(geometry.radius, geometry.arms, height, triple(turns),
                 triple(np.subtract(geometry.endstops, height)), (0.0, 0.0), bed)
