"""The numbers of a linear delta and their arithmetic, which all its firmwares share.

A firmware has one radius r, three angles w_i, three rods L_i, three endstops e_i. For a point
(x, y, z) the carriage of tower i goes to

    h_i = sqrt(L_i^2 - (r cos w_i - x)^2 - (r sin w_i - y)^2) + z,

which is e_i + sqrt(L_i^2 - r^2) - h_i below its endstop. Klipper takes these numbers as they are,
RepRapFirmware counts some from elsewhere. Steps are not rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from ppmcal.controllers.text import Rounded
from ppmcal.errors import BadInput
from ppmcal.linalg import Array

MM = 1e-3
TOWERS = ("a", "b", "c")
ANGLES = (210.0, 330.0, 90.0)
"""Of the towers where nobody says, degrees."""
DIGITS = 6
"""Decimals of numbers that are kept."""
SMALLEST = 1e-6
"""No number of a printer that has to be above 0 is as small, mm."""
KEYS = ("printer.delta_radius", *(f"stepper_{tower}.{key}" for tower in TOWERS
        for key in ("angle", "arm_length", "position_endstop")))
"""``section.key`` of a printer.cfg for every number of a delta's geometry."""
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class DeltaGeometry(Rounded, digits=DIGITS):
    """The numbers of a linear delta: mm and degrees; triples are towers a, b, c."""

    radius: float
    angles: Triple
    arms: Triple
    endstops: Triple

    def named(self) -> dict[str, float]:
        """Return the value of each of :data:`KEYS`, mm and degrees."""
        towers = zip(self.angles, self.arms, self.endstops, strict=True)
        return dict(zip(KEYS, (self.radius, *chain(*towers)), strict=True))

    @property
    def turns(self) -> Triple:
        """How far towers stand from :data:`ANGLES`, -180 to 180 degrees."""
        return triple((np.subtract(self.angles, ANGLES) + 180.0) % 360.0 - 180.0)


def tower_angles(turns: Triple) -> Triple:
    """Return the angles of towers that stand so far from :data:`ANGLES`, degrees."""
    return triple(np.add(ANGLES, turns))


def unit_of(key: str) -> str:
    """Return the unit of a number by its key in a printer.cfg."""
    return "deg" if key.endswith("angle") else "mm"


def triple(values: Array | Sequence[float]) -> Triple:
    """Return three numbers as they go into a :class:`DeltaGeometry`."""
    return float(values[0]), float(values[1]), float(values[2])


def travel(geometry: DeltaGeometry, point: Array) -> Array:
    """Return how far below its endstop each carriage goes for points (N, 3), (N, 3), m.

    nan where a rod does not reach.
    """
    arms = np.array(geometry.arms)
    top = np.array(geometry.endstops) + np.sqrt(arms**2 - geometry.radius**2)
    angle = np.radians(geometry.angles)
    foot = geometry.radius * MM * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    away = np.sum((foot - point[:, None, :2]) ** 2, axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray(top * MM - (np.sqrt((arms * MM) ** 2 - away) + point[:, 2:]))


def above_zero(value: float, place: str) -> float:
    """Return a number of a configuration that has to be above 0.

    Raises:
        BadInput: it is not, or too small for a printer.
    """
    if value < SMALLEST:
        raise BadInput(f"{value:g} is not above 0" if value <= 0.0 else
                       f"{value:g} is out of range", place,
                       "Write the value that the printer has")
    return value
