"""A delta printer as a mechanism file and measurement files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ppmcal.calibration.fit import Z95
from ppmcal.controllers.delta.geometry import TOWERS, DeltaGeometry
from ppmcal.controllers.delta.printer import Nominal, Printer, offsets
from ppmcal.controllers.importing import machine_head, sidecar
from ppmcal.io import csv_text
from ppmcal.model.limbs.spatial import PUS

NOZZLE = "translational             # a pose is x, y, z of the nozzle, the bed is z = 0"
HEIGHT_SIGMA = 0.02
DISTANCE_SIGMA = 0.05
LEAN = 0.2
"""Tolerance of a tower's direction, degrees."""
SHRUNK = (0.992, 0.998)
"""Lengths of a printed part over those between the nozzle's places: ends of a 95 % interval."""
SCALES = ("printed", "known", "unknown")
"""What measured distances are: those of a printed part, true, or off by any factor."""
RODS = ("fixed", "shared", "single")
SAVED = "saved.yaml"


def rods_of(printer: Printer, wanted: str | None) -> str:
    """Return how rods are fitted: ``wanted``, or as many lengths as the file has.

    Touches hardly tell their length; then it stays where it is, and what its tolerance leaves open
    is in every promise.
    """
    if wanted is not None:
        return wanted
    return "shared" if len(set(printer.nominal.geometry.arms)) == 1 else "single"


def shrinkage() -> tuple[float, float]:
    """Return what is known of a printed part's scale: value and standard deviation."""
    low, high = SHRUNK
    return round((low + high) / 2.0, 4), round((high - low) / (2.0 * Z95), 4)


def _scale_line(scale: str) -> str:
    """Return the sidecar's line on the scale of measured distances, of :data:`SCALES`.

    Rods and scale are one direction. Neither a length on a drawing nor a part outweighs the
    other: each counts by how well it is known.
    """
    if scale != "printed":
        return f"scale: {scale}    # of all these distances\n"
    value, sigma = shrinkage()
    least, most = (100.0 * (1.0 - part) for part in reversed(SHRUNK))
    return (f"# Plastic shrinks: in 95 of 100 printed parts all lengths are {least:.1f} to "
            f"{most:.1f} % too small.\nscale: {{value: {value:g}, sigma: {sigma:g}}}"
            "    # where you know better, write it here\n")


def files(printer: Printer, rods: str, scale: str = "known", choose: bool = False
          ) -> dict[str, str]:
    """Return file name -> text of everything that the import writes.

    ``choose``: whether freedoms are left to what predicts best.
    """
    more = _OPTIONAL if choose and printer.distances and printer.nominal.rods_known else ""
    out = {"machine.yaml": machine_yaml(printer, rods) + more}
    if printer.calibrated:
        out[SAVED] = saved_yaml(printer, rods)
    q = [f"q_{t}" for t in TOWERS]
    out |= touch_files(printer.heights, printer.distances, "where the carriages were")
    if printer.distances:
        out["distances.yaml"] += _scale_line(scale)
    for mesh in printer.meshes:
        name = f"mesh_{mesh.name}"
        out[f"{name}.csv"] = touch_table(["height", *q, "dir_x"], mesh.rows)
        out[f"{name}.yaml"] = touch_sidecar(name, "plane", "height", HEIGHT_SIGMA, (
            "# Touches of a bed in their order; how high it lies and how it is tilted is not known."
            "\n# Carriages are where the numbers in the configuration put them: it has to hold "
            "those\n# that the bed was probed with."), "unknown")
    return out


def touch_files(heights: Sequence[Sequence[float]], distances: Sequence[Sequence[float]],
                joints: str) -> dict[str, str]:
    """Return tables and sidecars of heights and distances; ``joints``: what else rows say."""
    out, q = dict[str, str](), [f"q_{t}" for t in TOWERS]
    if heights:
        out["heights.csv"] = touch_table(["height", *q], heights)
        out["heights.yaml"] = touch_sidecar(
            "heights", "plane", "height", HEIGHT_SIGMA,
            f"# Touches: the nozzle's true height above the bed, and {joints}.")
    if distances:
        out["distances.csv"] = touch_table(["distance", *q, *(f"to_{c}" for c in q)], distances)
        out["distances.yaml"] = touch_sidecar(
            "distances", "distance", "distance", DISTANCE_SIGMA,
            "# Distances on a printed part between two nozzle positions.")
    return out


def touch_table(header: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    """Return a table of touches, or of distances."""
    return csv_text(header, list(np.array(rows, dtype=float).T))


def touch_sidecar(name: str, kind: str, column: str, sigma: float, comment: str,
                  frame: str = "known") -> str:
    """Return the sidecar of such a table, below a comment."""
    return sidecar(comment, name, kind, {column: sigma}, sigma, f"frame: {frame}\ntarget: known\n")


def machine_yaml(printer: Printer, rods: str) -> str:
    """Return the printer as it was meant to be, a commented mechanism file.

    A carriage is at u = offset - travel, offset = position_endstop +
    sqrt(arm_length^2 - delta_radius^2), and the machine closes where the arm from there ends.
    """
    nominal = printer.nominal
    origin = ", ".join(f"{what}: {where}" for what, where in nominal.origin.items())
    angles = ", ".join(f"{t} {a:g}" for t, a in zip(TOWERS, nominal.geometry.angles, strict=True))
    head = f"""\
# A linear delta printer, as it was meant to be before any calibration. Where its numbers are
# from: {origin}; angles {angles}.
# Only the difference of tower radius and effector radius shows, so the former is delta_radius
# and the latter 0. Rods: {_RODS[rods]}
{machine_head(f"delta printer of {Path(printer.source).name}", NOZZLE)}limbs:
"""
    offset = _size(_offset_tolerance(nominal))
    tail = f"""\
home: {{pose: {{x: 0, y: 0, z: 0}}}}
# one standard deviation each of: delta_radius, angles, offset (endstops and rods), rods
tolerances: {{point: {_size(nominal.radius)}, angle: 0.5, offset: {offset}, \
length: {_size(nominal.rods)}}}
"""
    return head + "".join(_tower(printer, i, rods) for i in range(3)) + tail


def _offset_tolerance(nominal: Nominal) -> float:
    """Return the tolerance of offset, mm: the endstop's, and what a longer rod adds to it."""
    arm, radius = max(nominal.geometry.arms), nominal.geometry.radius
    longer = nominal.rods * arm / math.sqrt(arm**2 - radius**2)
    return math.ceil(10.0 * math.hypot(nominal.offset, longer)) / 10.0 if math.isfinite(
        nominal.offset) else nominal.offset


def _size(tolerance: float) -> str:
    return f"{tolerance:g}" if math.isfinite(tolerance) else ".inf"


def saved_yaml(printer: Printer, rods: str) -> str:
    """Return the printer with the numbers that it saved itself, to compare with."""
    own = replace(printer, nominal=replace(printer.nominal, geometry=printer.calibration))
    each = "single" if rods == "shared" and len(set(printer.calibration.arms)) > 1 else rods
    text = machine_yaml(own, each)
    return ("# With the numbers that the printer saved itself: a result, to be compared with\n"
            "# (`ppmcal validate identified DATA --against saved.yaml`), never a nominal.\n"
            + text[text.index("format:"):])


_OPTIONAL = """\
# identify takes these, or leaves them, by what predicts touches and distances left out
# (`--free` chooses by hand): the rods' lengths, then towers that lean
optional: [["*.length"], ["*.base.direction.*"]]
"""
_RODS = {"fixed": "fixed,\n# as if they were known exactly.",
         "shared": "one length for\n# all, fitted; it takes distances to know it.",
         "single": "one length for\n# each tower, fitted; it takes distances to know them."}


def _tower(printer: Printer, i: int, rods: str) -> str:
    g: DeltaGeometry = printer.nominal.geometry
    arm, angle = g.arms[i], g.angles[i]
    end = {"fixed": ", fixed: true", "shared": ", share: rod", "single": ""}[rods]
    held = ", fixed: true" if i == 2 else ""
    why = "    # holds the x and y axes" if i == 2 else ""
    return f"""\
  - name: {TOWERS[i]}
    kind: {PUS.name}
    base:
      point:
        radius: {{share: delta_radius, value: {g.radius!r}}}
        angle: {{value: {angle!r}{held}}}{why}
        z: {{value: 0, fixed: true}}    # an error here is one of offset
      direction: {{value: [0, 0, 1], fixed: true, tolerance: {LEAN}}}    # free: it leans
    platform:
      point: {{value: [0, 0, 0], fixed: true}}
    length: {{value: {arm!r}{end}}}
    ratio: -1    # q is travel down from the endstop in mm, whatever the microsteps
    offset: {offsets(g)[i]!r}    # position_endstop + sqrt(arm_length^2 - delta_radius^2)
    branch: 1
"""
