"""``export klipper``: lines for the printer.cfg of a linear delta."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ppmcal.controllers.export import Exported, Number
from ppmcal.controllers.klipper import MM
from ppmcal.controllers.klipper_config import (
    TOWERS,
    DeltaGeometry,
    format_geometry,
    parse_config,
    read_config,
    read_geometry,
)
from ppmcal.controllers.klipper_fit import DISC, HEIGHTS, Export, project
from ppmcal.controllers.klipper_patch import patched
from ppmcal.errors import BadInput, NoResult
from ppmcal.model.mechanism import Mechanism

CONFIG = "klipper.cfg"
COPY = "printer.cfg"


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
    advice = [] if old is None else [
        f"Paste the lines of {CONFIG} into {old}, above its #*# lines and below all other "
        "sections: there they win; or --write makes such a copy."]
    return Exported(
        "klipper", "Klipper", {CONFIG: text},
        f"Klipper's numbers hold {'all of the geometry' if found.exact else 'most of it, fitted'}",
        tuple(Number(key, before[key], value, "deg" if key.endswith("angle") else "mm")
              for key, value in after.items()),
        f"{len(found.points)} points, {found.radius * 1e3:.0f} mm around the middle, z 0 to 100 "
        "mm; offset and rotation on the bed ignored",
        found.before, found.after, found.not_expressed, found.notes, tuple(advice),
        {"grid": {"points": len(found.points), "radius": found.radius / MM,
                  "part_of_radius": DISC, "z": [z / MM for z in HEIGHTS]}},
        np.pad(found.points, ((0, 0), (0, 3))))


def use(mechanism: Mechanism, model: str, old: str) -> str:
    """Return how a printer gets its numbers; whose firmware is unknown gets none."""
    return old and (f"ppmcal export klipper {model} --old {old} --write makes a {COPY} with the "
                    "new numbers: put it in the place of the old one, and restart")


def patch(exported: Exported, old: Path) -> Exported:
    """Return the export with a copy of the ``printer.cfg`` that holds the new numbers.

    Raises:
        BadInput, NoResult: there is no such copy.
    """
    numbers = {n.name: n.new for n in exported.numbers}
    text, told = patched(old, numbers, read_geometry(parse_config(exported.files[CONFIG], CONFIG)))
    advice = (f"The {COPY} written is a copy of {old} with the new numbers in its #*# lines"
              f"{f'; {told}' if told else ''}. Keep the old one, put the copy in its place, and "
              "restart.")
    return replace(exported, files={**exported.files, COPY: text}, advice=(advice,))


def _comment(found: Export[DeltaGeometry], name: str) -> str:
    lines = [f"{name}: error if the model is exact {found.after.words()}, before "
             f"{found.before.words()}.",
             "Paste above the #*# lines of printer.cfg, below all other sections: there they win",
             "over earlier values, over those of included files, and over the #*# lines."]
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
