"""A delta printer that a firmware's configuration describes, and what it has measured."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta.geometry import DeltaGeometry, Triple, triple
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.notes import Note

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
        findings: what the user must look at.
    """

    geometry: DeltaGeometry
    origin: dict[str, str]
    radius: float = LEAST_RADIUS
    offset: float = LEAST_OFFSET
    rods: float = WIDE_RODS
    rods_known: bool = True
    findings: tuple[Note, ...] = ()


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
    findings: tuple[Note, ...] = ()


@dataclass(frozen=True)
class Printer:
    """A delta printer.

    Attributes:
        source: the file; geometry: what it prints with now.
        nominal: what it was meant to be.
        saved: whether ``geometry`` holds numbers of a calibration that it saved itself.
        heights: true z and carriages a, b, c below their endstops at each touch, mm, (N, 4).
        distances: measured, and carriages at both ends, mm, (M, 7).
        meshes: beds that were probed with ``geometry``.
        findings: what the user must look at.
        result: what a calibration saved, where that is not what it prints with.
        included: other files that were read.
        off: saved number -> by how much it is not what the printer's own fit gives, mm and degrees.
        size: both readings of its size, by distances and by rods, in a sentence.
        probe: how far its probe stands beside the nozzle in x and y, mm.
        by_hand: how many of the heights, the last ones, the nozzle itself touched.
        probed: whether the configuration says where its probe is.
    """

    source: str
    geometry: DeltaGeometry
    nominal: Nominal
    saved: bool = False
    heights: tuple[tuple[float, ...], ...] = ()
    distances: tuple[tuple[float, ...], ...] = ()
    meshes: tuple[Mesh, ...] = ()
    findings: tuple[Note, ...] = ()
    result: DeltaGeometry | None = None
    included: tuple[str, ...] = ()
    off: Mapping[str, float] = field(default_factory=dict)
    size: str = ""
    probe: tuple[float, float] = (0.0, 0.0)
    by_hand: int = 0
    probed: bool = True

    def __post_init__(self) -> None:
        """Refuse a probe that stands farther beside the nozzle than the towers do.

        Raises:
            BadInput: so.
        """
        away = math.hypot(*self.probe)
        if away > self.geometry.radius:
            raise BadInput(f"the probe stands {away:g} mm beside the nozzle, and the towers' "
                           f"joints {self.geometry.radius:g} mm", self.source,
                           "Look at the probe's offsets in x and y, in mm")

    @property
    def calibration(self) -> DeltaGeometry:
        """What its last calibration saved, mm and degrees."""
        return self.geometry if self.result is None else self.result

    @property
    def calibrated(self) -> bool:
        """Whether it saved numbers that are not those it was meant to have."""
        return self.saved and self.calibration != self.nominal.geometry


PrinterReader = Callable[[Path, float | None, Sequence[str], float | None], Printer]
"""What reads a printer in one format: the configuration's path, the length of the rods as the user
knows it, mm, names or files of probed beds, and the delta's radius likewise. Raises BadInput."""


def offsets(geometry: DeltaGeometry) -> Triple:
    """Return the carriages' heights at the endstops, mm: endstop + sqrt(rod^2 - radius^2)."""
    return triple([e + math.sqrt(rod**2 - geometry.radius**2)
                   for e, rod in zip(geometry.endstops, geometry.arms, strict=True)])


def far_radius(given: float, active: float) -> list[Note]:
    """Return what to say of a radius, mm, that is not the one the printer prints with."""
    return _far("--radius", given, active, "give the distance from the rods' joints at a tower to "
                "those at the effector, the effector in the middle, seen from above")


def far_rods(given: float | None, active: Triple) -> list[Note]:
    """Return what to say of rods, mm, that are not those the printer prints with."""
    return [] if given is None else _far("--rods", given, sum(active) / len(active),
                                         "give the length from bearing to bearing")


def _far(option: str, given: float, active: float, what: str) -> list[Note]:
    return [] if abs(given - active) <= FAR else [Note(
        f"{option} {given:g} is {abs(given - active):.3g} mm from the {active:.6g} mm that it "
        f"prints with: {what}")]


def tolerance(least: float, apart: float) -> float:
    """Return a tolerance in which a printer's own answer is not a surprise, mm, in 0.1 mm."""
    return max(least, math.ceil(20.0 * apart) / 10.0)


def nominal_of(source: str, meant: DeltaGeometry, active: DeltaGeometry, origin: dict[str, str],
               rods: float | None, unknown: Collection[str] = (), rods_known: bool = True,
               findings: Sequence[Note] = ()) -> Nominal:
    """Return what a printer was meant to be that prints with ``active`` numbers.

    Args:
        source: the file, for messages.
        meant: what it was meant to have.
        active: what it has.
        origin: where each of radius, rods and endstops is from, in words.
        rods: the rods' length as the user knows it, mm.
        unknown: those of ``delta_radius`` and ``endstops`` that nothing but a calibration says.
        rods_known: as of :class:`Nominal`.
        findings: likewise.

    Raises:
        BadInput: the rods do not reach the middle.
    """
    if min(meant.arms) <= meant.radius:
        raise BadInput(f"rods of {min(meant.arms):g} mm do not reach the middle: the radius is "
                       f"{meant.radius:g} mm", source, "Check both lengths")
    apart = float(np.max(np.abs(np.subtract(offsets(meant), offsets(active)))))
    return Nominal(
        meant, origin, math.inf if "delta_radius" in unknown else
        tolerance(LEAST_RADIUS, abs(meant.radius - active.radius)),
        math.inf if "endstops" in unknown else tolerance(LEAST_OFFSET, apart),
        WIDE_RODS if rods is None else LEAST_RODS, rods_known, tuple(findings))


def stated_nominal(source: str, meant: DeltaGeometry, active: DeltaGeometry, where: str,
                   rods: float | None, radius: float | None) -> tuple[Nominal, list[Note]]:
    """Return what a printer was meant to be whose file holds nothing else, and what to say of it.

    Args:
        source: the file, for messages.
        meant: what the file says, mm and degrees.
        active: what it prints with.
        where: what sentences call the file.
        rods: the rods' length as the user knows it, mm.
        radius: the delta's radius as the user knows it, mm.

    Raises:
        BadInput: the rods do not reach the middle.
    """
    if rods is not None:
        meant = replace(meant, arms=(rods, rods, rods))
    if radius is not None:
        meant = replace(meant, radius=radius)
    nominal = nominal_of(source, meant, active, {
        "delta_radius": "--radius" if radius else where, "rods": "--rods" if rods else where,
        "endstops": where}, rods)
    return nominal, [*far_rods(rods, active.arms), *(
        [] if radius is None else far_radius(radius, active.radius))]


def in_rows(point: Array, touched: Array) -> tuple[Array, Array]:
    """Return touched points of a grid (Y, X, 3) to and fro, row by row, and the ways (N,).

    The way along x, +1 or -1, is the row's, at its first point as well.
    """
    backward = np.arange(len(point)) % 2 == 1
    order = np.where(backward[:, None, None], point[:, ::-1], point).reshape(-1, 3)
    keep = np.where(backward[:, None], touched[:, ::-1], touched).reshape(-1)
    return order[keep], np.repeat(np.where(backward, -1.0, 1.0), point.shape[1])[keep]


def mesh_of(name: str, what: str, height: float, down: Array, way: Array) -> Mesh:
    """Return a probed bed, less the points that the rods do not reach.

    Args:
        name: of the mesh.
        what: messages call it.
        height: of the nozzle at the trigger, mm.
        down: carriages below their endstops at each touch (N, 3), mm, nan out of reach.
        way: of travel along x (N,).
    """
    good = np.isfinite(down).all(axis=1)
    told = () if good.all() else (Note(
        f"{what}: {int((~good).sum())} points are out of the rods' reach, and left out"),)
    rows = np.column_stack([np.full(len(down), height), down, way])[good]
    return Mesh(re.sub(r"[^A-Za-z0-9_-]", "_", name), tuple(map(tuple, rows.tolist())), told)
