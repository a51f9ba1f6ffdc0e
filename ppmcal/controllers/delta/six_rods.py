"""A delta printer of which each rod is a limb, so that its effector tilts where rods differ.

Firmwares take the two rods of a pair for one, and the effector for level. Where a pair's lengths
or joints differ it tilts, and a probe that stands beside the nozzle shows another height than the
nozzle's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.controllers.delta.geometry import SMALLEST, TOWERS
from ppmcal.controllers.delta.printer import Printer, offsets
from ppmcal.errors import BadInput
from ppmcal.model.limbs.spatial import PUS
from ppmcal.notes import Note

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
