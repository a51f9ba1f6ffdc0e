"""A delta printer's configuration as a mechanism file and tables of measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from ppmcal.files.klipper import TOWERS, Printer
from ppmcal.io import csv_text

HEIGHT_SIGMA = 0.02
DISTANCE_SIGMA = 0.05
RODS = ("fixed", "shared", "single")


def rods_of(printer: Printer, wanted: str | None) -> str:
    """Return how rods are fitted: ``wanted``, or what the measurements allow."""
    if wanted is not None:
        return wanted
    if not printer.distances:
        return "fixed"
    return "shared" if len(set(printer.geometry.arms)) == 1 else "single"


def files(printer: Printer, rods: str) -> dict[str, str]:
    """Return file name -> text of everything that the import writes."""
    out = {"machine.yaml": machine_yaml(printer, rods)}
    q = [f"q_{t}" for t in TOWERS]
    if printer.heights:
        out["heights.csv"] = _table(["height", *q], printer.heights)
        out["heights.yaml"] = _sidecar("heights", "plane", "height", HEIGHT_SIGMA, (
            "# Touches: the nozzle's true height above the bed, and where the carriages were.\n"
            "# sigma: how far one touch scatters; 0.02 mm is a usual probe. Put in yours."))
    if printer.distances:
        out["distances.csv"] = _table(["distance", *q, *(f"to_{c}" for c in q)], printer.distances)
        out["distances.yaml"] = _sidecar("distances", "distance", "distance", DISTANCE_SIGMA, (
            "# Distances on a printed part between two nozzle positions.\n"
            "# sigma: how far one reading scatters; 0.05 mm is a usual caliper. Put in yours."))
    return out


def _table(header: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    return csv_text(header, list(np.array(rows, dtype=float).T))


def _sidecar(name: str, kind: str, column: str, sigma: float, comment: str) -> str:
    return f"""{comment}
format: ppmcal/dataset/1
name: {name}
units: {{length: mm, angle: deg}}
instrument: {{kind: {kind}, sigma: {{{column}: {sigma}}}}}
frame: known
target: known
"""


def machine_yaml(printer: Printer, rods: str) -> str:
    """Return the printer as a commented mechanism file.

    A carriage is at u = offset - steps x step distance, offset = position_endstop +
    sqrt(arm_length^2 - delta_radius^2), and the machine closes where the arm from there ends.
    """
    name = yaml.safe_dump(f"delta printer of {Path(printer.source).name}", width=1000).strip()
    head = f"""\
# A linear delta printer, read from its configuration. Only the difference of tower radius and
# effector radius shows, so the former is delta_radius and the latter 0. Rods: {_RODS[rods]}
format: ppmcal/mechanism/1
name: {name.removesuffix("...").strip()}
units: {{length: mm, angle: deg}}   # of every number in this file
motion: translational             # a pose is x, y, z of the nozzle, the bed is z = 0
limbs:
"""
    tail = """\
home: {pose: {x: 0, y: 0, z: 0}}
# one standard deviation each of: delta_radius, angles, endstops (offset), rods
tolerances: {point: 1.0, angle: 0.5, offset: 1.0, length: 0.3}
"""
    return head + "".join(_tower(printer, i, rods) for i in range(3)) + tail


_RODS = {"fixed": "fixed, as\n# heights alone hardly tell their length; measured distances do.",
         "shared": "one length for\n# all, fitted; it takes distances to know it.",
         "single": "one length for\n# each tower, fitted; it takes distances to know them."}


def _tower(printer: Printer, i: int, rods: str) -> str:
    g = printer.geometry
    arm, angle = g.arms[i], g.angles[i]
    end = {"fixed": ", fixed: true", "shared": ", share: rod", "single": ""}[rods]
    held = ", fixed: true" if i == 2 else ""
    why = "    # holds the x and y axes" if i == 2 else ""
    offset = g.endstops[i] + math.sqrt(arm**2 - g.radius**2)
    return f"""\
  - name: {TOWERS[i]}
    kind: (P)US
    base:
      point:
        radius: {{share: delta_radius, value: {g.radius!r}}}
        angle: {{value: {angle!r}{held}}}{why}
        z: {{value: 0, fixed: true}}    # an error here is one of offset
      direction: {{value: [0, 0, 1], fixed: true}}    # free it for a leaning tower
    platform:
      point: {{value: [0, 0, 0], fixed: true}}
    length: {{value: {arm!r}{end}}}
    ratio: {-printer.step[i]!r}    # mm per microstep, counted down from the endstop
    offset: {offset!r}    # position_endstop + sqrt(arm_length^2 - delta_radius^2)
    branch: 1
"""
