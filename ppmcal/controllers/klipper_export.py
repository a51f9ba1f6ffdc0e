"""``export klipper``: lines for the printer.cfg of a linear delta."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ppmcal.controllers.export import Exported, Number
from ppmcal.controllers.klipper import MM
from ppmcal.controllers.klipper_config import (
    TOWERS,
    Config,
    DeltaGeometry,
    format_geometry,
    parse_config,
    read_config,
    read_geometry,
)
from ppmcal.controllers.klipper_fit import DISC, HEIGHTS, Export, project
from ppmcal.errors import BadInput, NoResult
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import some

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
    refuse_endstops(found.new.endstops, mechanism.source)
    before, after = keys(found.old), keys(found.new)
    held = [] if present is None else _autosaved(present, after)
    advice = [f"Change these in the #*# lines of {old}, which win over all others: "
              f"{some(held, CONFIG)}."] if held else []
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


def refuse_endstops(endstops: tuple[float, float, float], source: str) -> None:
    """Refuse endstops that the firmware would not take: it counts them up from the bed, mm.

    Raises:
        NoResult: one of them is at the bed or below it.
    """
    for tower, end in zip(TOWERS, endstops, strict=True):
        if end <= 0.0:
            raise NoResult(f"position_endstop of stepper_{tower} would be {end:.6g} mm, which is "
                           "not above the bed: Klipper refuses it", source,
                           "Check `home`, `limits` and the height of the towers' points: the bed "
                           "is z = 0")


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
