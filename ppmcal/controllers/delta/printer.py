"""A delta printer that a firmware's configuration describes, and what it has measured."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta.geometry import SMALLEST, TOWERS, DeltaGeometry, Triple, triple
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.model.limbs.spatial import PUS
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


# ---- a printer of which each rod is a limb
#
# Firmwares take the two rods of a pair for one, and the effector for level. Where a pair's lengths
# or joints differ it tilts, and a probe that stands beside the nozzle shows another height than the
# nozzle's.


JOINT = 0.1
"""Tolerance of a joint of a rod against the other five, mm: holes, balls, and the rod's length
against that of the others."""
MEET = 2.0 * 3.0**0.5
"""Spacing over radius at which the joints of neighbouring pairs meet."""
SMALL = 10.0
"""No printer is known whose effector is smaller, mm."""
LARGEST = 1e4
"""No effector is larger, mm."""
TILTING = "spatial             # a pose is x, y, z of the nozzle and the effector's rotation vector"


@dataclass(frozen=True)
class Effector:
    """Where the rods are held, mm.

    ``radius``: from the nozzle to the line between the joints of a pair; ``spacing``: between them.
    """

    radius: float
    spacing: float


def effector_of(given: str | Sequence[float] | None) -> Effector | None:
    """Return an effector as a user gives it, ``40,60``.

    Raises:
        BadInput: it is not two lengths.
    """
    if given is None:
        return None
    each = given.split(",") if isinstance(given, str) else list(given)
    try:
        radius, spacing = (float(one) for one in each)
    except ValueError:
        radius = spacing = float("nan")
    if not (SMALLEST <= radius < LARGEST and SMALLEST <= spacing < LARGEST):
        raise BadInput(f"'{given}' is not a radius and a spacing in mm", "--effector",
                       "Give from the nozzle to the line between the two joints of a pair, seen "
                       "from above, and between these joints, such as --effector 40,60")
    return Effector(radius, spacing)


def refuse_effector(effector: Effector, radius: float) -> list[Note]:
    """Refuse an effector that no printer has, and return what is odd about it.

    ``radius``: of the delta, mm.

    Raises:
        BadInput: it is as large as the printer, or joints of neighbouring pairs would meet.
    """
    if effector.radius >= radius:
        raise BadInput(f"an effector of {effector.radius:g} mm is as large as the delta, whose "
                       f"radius is {radius:g} mm", "--effector",
                       "Give from the nozzle to the line between the two joints of a pair")
    if effector.spacing >= MEET * effector.radius:
        raise BadInput(f"joints {effector.spacing:g} mm apart, {effector.radius:g} mm from the "
                       "nozzle, are beyond those of the next pair", "--effector",
                       "Give the radius first, then the distance of the two joints of a pair")
    return [] if min(effector.radius, effector.spacing) >= SMALL else [Note(
        f"--effector {effector.radius:g},{effector.spacing:g} is small for a printer: both are mm")]


def six_limbs(printer: Printer, rods: str, effector: Effector, radius: str, lean: float) -> str:
    """Return the lines of the limbs, two to a tower.

    What a tower's two rods have in common are shared parameters, as firmwares have them; what can
    tilt the effector are the places of its joints, each by itself. Both joints of a carriage are
    counted from the tower, turned to it.

    Args:
        printer: as it was meant to be.
        rods: ``fixed``, ``shared`` or ``single``, one length for each tower.
        effector: where the rods are held.
        radius: tolerance of tower_radius, mm, as a file has it.
        lean: tolerance of a tower's direction, degrees.
    """
    g = printer.nominal.geometry
    lines: list[str] = []
    for tower, name in enumerate(TOWERS):
        held = ", fixed: true" if tower == 2 else ""
        length = f"value: {g.arms[tower]!r}"
        for side in (-1, 1):
            first = side < 0
            lines.append(_rod(name, side, g.angles[tower], effector, {
                "radius": "share: tower_radius" + ("" if lines else (
                    f", value: {g.radius + effector.radius!r}, tolerance: {radius}")),
                "angle": f"share: angle_{name}" + f", value: {g.angles[tower]!r}{held}" * first,
                "direction": f"share: tower_{name}" + (
                    f", value: [0, 0, 1], fixed: true, tolerance: {lean}") * first,
                "length": {"fixed": f"{length}, fixed: true",
                           "shared": "share: rod" + ("" if lines else f", {length}"),
                           "single": f"share: rod_{name}" + f", {length}" * first}[rods],
                "offset": f"share: endstop_{name}" + f", value: {offsets(g)[tower]!r}" * first}))
    return "".join(lines)


def _rod(tower: str, side: int, angle: float, effector: Effector, said: Mapping[str, str]) -> str:
    """Return one of the two rods of a tower as a limb.

    ``side``: -1 or 1; ``angle``: of the tower, degrees; ``said``: what stands in slots that it
    shares.
    """
    across = 0.5 * side * effector.spacing
    way = np.radians(angle)
    x, y = (round(float(v), 6) for v in (
        effector.radius * np.cos(way) - across * np.sin(way),
        effector.radius * np.sin(way) + across * np.cos(way)))
    turn = angle % 360.0 - 360.0 * (angle % 360.0 > 180.0)    # a rotation vector's
    return f"""\
  - name: {tower}{1 if side < 0 else 2}
    kind: {PUS.name}
    actuator: {tower}
    base:
      point:    # of the tower
        radius: {{{said["radius"]}}}
        angle: {{{said["angle"]}}}
        z: {{value: 0, fixed: true}}    # an error here is one of offset
      direction: {{{said["direction"]}}}{"    # free: it leans" * (side < 0)}
    # the carriage's joint, this far across from the middle of the two
    joint1: {{rz: {{value: {turn!r}, nominal: {turn!r}, fixed: true}}}}
    joint2: {{y: {{value: {across!r}, nominal: {across!r}, fixed: true}}}}
    platform:
      point: [{x!r}, {y!r}, 0]    # of all that tells this rod from the other five
    length: {{{said["length"]}}}
    ratio: -1    # q is travel down from the endstop in mm, whatever the microsteps
    offset: {{{said["offset"]}}}
    branch: 1
"""


def by_probe_and_nozzle(printer: Printer
                        ) -> tuple[tuple[tuple[float, ...], ...], tuple[tuple[float, ...], ...]]:
    """Return the heights that a printer's probe touched, and those of the nozzle itself."""
    count = len(printer.heights) - printer.by_hand
    return printer.heights[:count], printer.heights[count:]


def beside(probe: tuple[float, float]) -> str:
    """Return a sidecar's target of a probe that stands so far beside the nozzle, mm."""
    return "known" if not any(probe) else f"[{probe[0]:g}, {probe[1]:g}, 0]"
