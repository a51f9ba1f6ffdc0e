"""``export klipper``: lines for the printer.cfg of a linear delta."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import yaml

from ppmcal.controllers.export import Exported, Number
from ppmcal.controllers.klipper import MM
from ppmcal.controllers.klipper_config import (
    TOWERS,
    Config,
    DeltaGeometry,
    Printer,
    format_geometry,
    parse_config,
    read_config,
    read_geometry,
)
from ppmcal.controllers.klipper_fit import DISC, HEIGHTS, Export, project
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import csv_text
from ppmcal.model.limbs.spatial import PUS
from ppmcal.model.mechanism import Mechanism

CONFIG = "klipper.cfg"


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine in Klipper's numbers; see :class:`ppmcal.controllers.export.Exporter`."""
    if poses is not None:
        raise BadInput("klipper takes numbers, not poses", "--poses", "Leave it out")
    present = None if old is None else read_config(old)
    found = project(mechanism, None if present is None else read_geometry(present))
    text = format_geometry(found.new, _comment(found, mechanism.name))
    if read_geometry(parse_config(text, CONFIG)) != found.new:
        raise NoResult("the lines read back as another geometry", CONFIG,
                       "This is a fault of ppmcal; do not use them")
    before, after = keys(found.old), keys(found.new)
    held = [] if present is None else _autosaved(present, after)
    advice = [f"Change these in the #*# lines of {old}, which win over all others: "
              f"{', '.join(held)}."] if held else []
    return Exported(
        "klipper", "Klipper", {CONFIG: text},
        f"Klipper's numbers hold {'all of the geometry' if found.exact else 'most of it, fitted'}",
        tuple(Number(key, before[key], value, "deg" if key.endswith("angle") else "mm")
              for key, value in after.items()),
        f"{len(found.points)} points, {found.radius * 1e3:.0f} mm around the middle, z 0 to 100 "
        "mm, where on the bed a print lies aside",
        found.before, found.after, found.not_expressed, found.notes, tuple(advice),
        {"grid": {"points": len(found.points), "radius": found.radius / MM,
                  "part_of_radius": DISC, "z": [z / MM for z in HEIGHTS]}},
        np.pad(found.points, ((0, 0), (0, 3))))


def _comment(found: Export[DeltaGeometry], name: str) -> str:
    lines = [f"{name}: error if the model is exact {found.after.words()}, before "
             f"{found.before.words()}.",
             "Paste above the #*# lines of printer.cfg, below the sections of the same names (the",
             "later value wins). Where #*# lines name the same keys, put the numbers there: they",
             "win over all others."]
    return "\n".join([*lines, *(f"Cannot be expressed: {one.what}." for one in found.not_expressed),
                      *(f"Note: {note}." for note in found.notes)])


def keys(geometry: DeltaGeometry) -> dict[str, float]:
    """Return ``section.key`` -> value, mm and degrees."""
    out = {"printer.delta_radius": geometry.radius}
    for i, tower in enumerate(TOWERS):
        out |= {f"stepper_{tower}.angle": geometry.angles[i],
                f"stepper_{tower}.arm_length": geometry.arms[i],
                f"stepper_{tower}.position_endstop": geometry.endstops[i]}
    return out


def _autosaved(config: Config, names: Iterable[str]) -> list[str]:
    """Return which ``section.key`` stand in the lines that the printer saved itself."""
    split = ((name, *name.split(".")) for name in names)
    return [name for name, section, key in split
            if key in config.sections.get(section, {}) and config.sections[section][key].saved]


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
    kind: {PUS.name}
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
