"""A delta printer that a firmware's configuration describes, and what it has measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ppmcal.controllers.klipper_config import DeltaGeometry, Triple

LEAST_RADIUS, LEAST_OFFSET, LEAST_RODS = 1.0, 1.0, 0.3
"""Tolerances, mm: how far a radius, an endstop and a measured rod are from what is said."""
WIDE_RODS = 2.0
"""Tolerance of rods that nobody measured, mm: a drawing's, or what a calibration saved."""
FAR = 5.0
"""A radius or endstop that the printer is farther from than this, mm, was never its own."""


@dataclass(frozen=True)
class Nominal:
    """What a printer was meant to be, before it was calibrated: the prior.

    Attributes:
        geometry: mm and degrees.
        origin: where radius, angles, rods and endstops are from, in words.
        radius, offset, rods: tolerances, mm; inf where nothing is known.
        rods_known: whether the rods are from another source than a saved calibration.
        rods_stated: whether the user gave them.
        findings: what the user must look at.
    """

    geometry: DeltaGeometry
    origin: dict[str, str]
    radius: float = LEAST_RADIUS
    offset: float = LEAST_OFFSET
    rods: float = WIDE_RODS
    rods_known: bool = True
    rods_stated: bool = False
    findings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Mesh:
    """A probed bed as touches in the order in which they were made.

    Attributes:
        name: of the mesh, which its files are called by.
        rows: true height of the nozzle at the trigger and carriages a, b, c below their endstops,
            mm, and the direction of travel along x before the descent, +1 or -1; (N, 5).
        findings: what the user must look at.
    """

    name: str
    rows: tuple[tuple[float, ...], ...]
    findings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Printer:
    """A delta printer.

    Attributes:
        source: the file; geometry: what it prints with now.
        step: travel per microstep, mm; nan where carriages are not counted in them.
        nominal: what it was meant to be.
        saved: whether ``geometry`` holds numbers of a calibration that it saved itself.
        heights: true z and carriages a, b, c below their endstops at each touch, mm, (N, 4).
        distances: measured, and carriages at both ends, mm, (M, 7).
        meshes: beds that were probed with ``geometry``.
        findings: what the user must look at.
        result: what a calibration saved, where that is not what it prints with.
        included: other files that were read.
    """

    source: str
    geometry: DeltaGeometry
    step: Triple
    nominal: Nominal
    saved: bool = False
    heights: tuple[tuple[float, ...], ...] = ()
    distances: tuple[tuple[float, ...], ...] = ()
    meshes: tuple[Mesh, ...] = ()
    findings: tuple[str, ...] = field(default=())
    result: DeltaGeometry | None = None
    included: tuple[str, ...] = ()

    @property
    def calibration(self) -> DeltaGeometry:
        """What its last calibration saved, mm and degrees."""
        return self.geometry if self.result is None else self.result

    @property
    def calibrated(self) -> bool:
        """Whether it saved numbers that are not those it was meant to have."""
        return self.saved and self.calibration != self.nominal.geometry


def offsets(geometry: DeltaGeometry) -> Triple:
    """Return the carriages' heights at the endstops, mm: endstop + sqrt(rod^2 - radius^2)."""
    a, b, c = (e + math.sqrt(rod**2 - geometry.radius**2)
               for e, rod in zip(geometry.endstops, geometry.arms, strict=True))
    return a, b, c


def far_radius(given: float, active: float) -> list[str]:
    """Return what to say of a radius, mm, that is not the one the printer prints with."""
    return [] if abs(given - active) <= FAR else [
        f"--radius {given:g} is {abs(given - active):.3g} mm from the {active:g} mm that it prints "
        "with: give the distance from the rods' joints at a tower to those at the effector, the "
        "effector in the middle, seen from above"]


def tolerance(least: float, apart: float) -> float:
    """Return a tolerance in which a printer's own answer is not a surprise, mm, in 0.1 mm."""
    return max(least, math.ceil(20.0 * apart) / 10.0)
