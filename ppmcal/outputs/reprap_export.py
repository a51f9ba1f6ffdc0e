"""``export reprap``: M665 and M666 for the config.g of a linear delta with RepRapFirmware."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ppmcal.controllers.klipper import MM
from ppmcal.controllers.klipper_fit import DISC, HEIGHTS, Export
from ppmcal.controllers.reprap import project
from ppmcal.errors import BadInput, NoResult
from ppmcal.files.reprap import (
    Delta,
    Lines,
    format_delta,
    parse_lines,
    read_delta,
    read_lines,
)
from ppmcal.model.mechanism import Mechanism
from ppmcal.outputs.exported import Exported, Lacking, Number, words
from ppmcal.outputs.klipper_export import figure

LINES = "reprap.g"
TOWERS = "XYZ"
FAR = 5.0
"""Endstops that move by more than this, mm, are rather a mistake in the model."""


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine as M665 and M666; see :class:`ppmcal.outputs.exported.Exporter`."""
    if poses is not None:
        raise BadInput("reprap takes numbers, not poses", "--poses", "Leave it out")
    present = None if old is None else read_lines(old)
    found = project(mechanism, None if present is None else read_delta(present))
    notes = (*found.notes, *_notes(found))
    text = format_delta(found.new, _comment(found, notes, mechanism.name))
    if read_delta(parse_lines(text, LINES)) != found.new:
        raise NoResult("the lines read back as other numbers", LINES,
                       "This is a fault of ppmcal; do not use them")
    return Exported(
        "reprap", "RepRapFirmware", {LINES: text},
        "RepRapFirmware's numbers hold "
        + ("most of the geometry, fitted" if found.lacks else "all of the geometry"),
        tuple(_numbers(found)),
        f"{len(found.points)} points, {found.radius * 1e3:.0f} mm around the middle, z 0 to 100 "
        "mm, where on the bed a print lies aside",
        figure(found.before), figure(found.after),
        tuple(Lacking(lack.what, lack.parameters,
                      None if lack.cost is None else figure(lack.cost)) for lack in found.lacks),
        notes, tuple(_advice(present, found)),
        {"grid": {"points": len(found.points), "radius": found.radius / MM,
                  "part_of_radius": DISC, "z": [z / MM for z in HEIGHTS]}},
        np.pad(found.points, ((0, 0), (0, 3))))


def _numbers(found: Export[Delta]) -> Iterator[Number]:
    old, new = (dict(_named(delta)) for delta in (found.old, found.new))
    for (name, unit), value in new.items():
        yield Number(name, old.get((name, unit)), value, unit)


def _named(delta: Delta) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield (name, unit) and value of what is written."""
    for tower, rod in zip(TOWERS, delta.rods, strict=True):
        yield (f"M665 L of {tower}", "mm"), rod
    yield ("M665 R", "mm"), delta.radius
    yield ("M665 H", "mm"), delta.height
    if delta.bed is not None:
        yield ("M665 B", "mm"), delta.bed
    for tower, angle in zip(TOWERS, delta.angles, strict=True):
        yield (f"M665 {tower}", "deg"), angle
    for tower, end in zip(TOWERS, delta.endstops, strict=True):
        yield (f"M666 {tower}", "mm"), end
    for letter, tilt in zip("AB", delta.tilt, strict=True):
        yield (f"M666 {letter}", "%"), tilt


def _notes(found: Export[Delta]) -> Iterator[str]:
    """Yield what a user should know of the firmware's conventions."""
    if any(found.new.endstops) or any(found.old.endstops):
        yield ("X, Y, Z of M666 have mean 0 and H holds the rest, as the firmware's own "
               "calibration leaves them: only their sums with H count")
    if len(set(found.new.rods)) > 1:
        yield "three rods in L of M665 need firmware 2.03 or later"
    if any(found.old.tilt):
        yield ("the tilt of the bed, A and B of M666, becomes 0: heights of endstops tilt every "
               "level in the same way, and hold it")


def _advice(present: Lines | None, found: Export[Delta]) -> Iterator[str]:
    """Yield how to bring the lines in, and what to check of the old ones."""
    yield (f"Put the lines of {LINES} in place of M665 and M666 in config.g; where M501 runs "
           "there, those of config-override.g win: change them there, or take them out.")
    if present is not None:
        higher = float(np.mean(np.subtract(found.new.endstops, found.old.endstops)))
        higher += found.new.height - found.old.height
        if abs(higher) > FAR:
            yield (f"The endstops go {higher:+.1f} mm from where {present.source} has them: before "
                   "you home, check that the model's `limits` end there.")
        for place in present.overruled():
            yield (f"{present.source}: {place} runs another file, which is not followed: if that "
                   "holds M665 or M666, give it as --old.")


def _comment(found: Export[Delta], notes: tuple[str, ...], name: str) -> str:
    lines = [f"{name}: error if the model is exact {words(figure(found.after))}, before "
             f"{words(figure(found.before))}.",
             "Put these in place of M665 and M666 in config.g, then home. If config.g runs M501,",
             "M665 and M666 in config-override.g win: change them there. M500 writes them anew,",
             "with 3 decimals. A0 B0 is meant: X, Y, Z of M666 hold the tilt of the bed."]
    if found.new.bed is None:
        lines.append("B, the printable radius, stays as it is: no --old said it.")
    return "\n".join([*lines, *(f"Cannot be expressed: {lack.what}." for lack in found.lacks),
                      *(f"Note: {note}." for note in notes)])
