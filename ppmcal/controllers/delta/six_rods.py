"""A delta printer of which each rod is a limb, so that its effector tilts where rods differ.

Firmwares take the two rods of a pair for one, and the effector for level. Where a pair's lengths
or joints differ it tilts, and a probe that stands beside the nozzle shows another height than the
nozzle's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.controllers.delta.geometry import SMALLEST, TOWERS
from ppmcal.controllers.delta.printer import Printer, offsets
from ppmcal.errors import BadInput
from ppmcal.model.limbs.spatial import PUS

JOINT = 0.1
"""Tolerance of a joint of a rod against the other five, mm: holes, balls, and the rod's length
against that of the others."""
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


def six_limbs(printer: Printer, rods: str, effector: Effector, radius: str, lean: float) -> str:
    """Return the lines of the limbs, two to a tower.

    What a tower's two rods have in common are shared parameters, as firmwares have them; what can
    tilt the effector are the places of its joints, each by itself. A joint at a carriage is
    reached from the middle of the bed: turned to its tower, up it, and out to the joint.

    Args:
        printer: as it was meant to be.
        rods: ``fixed``, ``shared`` or ``single``, one length for each tower.
        effector: where the rods are held.
        radius: tolerance of tower_radius, mm, as a file has it.
        lean: tolerance of a tower's direction, degrees.
    """
    g = printer.nominal.geometry
    out = g.radius + effector.radius
    whole = f", value: {out!r}, nominal: {out!r}, tolerance: {radius}"
    lines: list[str] = []
    for tower, name in enumerate(TOWERS):
        angle = g.angles[tower] % 360.0
        angle -= 360.0 * (angle > 180.0)    # a rotation vector's
        held = ", fixed: true" if tower == 2 else ""
        length = f"value: {g.arms[tower]!r}"
        for side in (-1, 1):
            lines.append(_Rod(name, side, angle, effector).lines(
                f"share: tower_{name}", f"value: [0, 0, 1], fixed: true, tolerance: {lean}",
                f"share: angle_{name}", f"value: {angle!r}, nominal: {angle!r}{held}",
                "share: tower_radius" + ("" if lines else whole),
                {"fixed": f"{length}, fixed: true",
                 "shared": "share: rod" + ("" if lines else f", {length}"),
                 "single": f"share: rod_{name}" + (f", {length}" if side < 0 else "")}[rods],
                f"share: endstop_{name}", f"value: {offsets(g)[tower]!r}"))
    return "".join(lines)


@dataclass(frozen=True)
class _Rod:
    """One of the two rods of a tower, at its angle, degrees; ``side``: -1 or 1."""

    tower: str
    side: int
    angle: float
    effector: Effector

    def lines(self, direction: str, upright: str, turn: str, angle: str, radius: str, length: str,
              offset: str, value: str) -> str:
        """Return the rod as a limb; what is shared is said in full at the first of the two."""
        across = 0.5 * self.side * self.effector.spacing
        way = np.radians(self.angle)
        x, y = (round(float(v), 6) for v in (
            self.effector.radius * np.cos(way) - across * np.sin(way),
            self.effector.radius * np.sin(way) + across * np.cos(way)))
        first = self.side < 0

        def said(shared: str, whole: str) -> str:
            return f"{{{shared}, {whole}}}" if first else f"{{{shared}}}"

        return f"""\
  - name: {self.tower}{1 if first else 2}
    kind: {PUS.name}
    actuator: {self.tower}
    base:
      point: {{value: [0, 0, 0], fixed: true}}    # the middle of the bed
      direction: {said(direction, upright)}{"    # free: it leans" * first}
    joint1:
      rz: {said(turn, angle)}
    joint2:
      x: {{{radius}}}
      y: {{value: {across!r}, nominal: {across!r}, fixed: true}}
    platform:
      point: [{x!r}, {y!r}, 0]    # of all that tells this rod from the other five
    length: {{{length}}}
    ratio: -1    # q is travel down from the endstop in mm, whatever the microsteps
    offset: {said(offset, value)}
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
