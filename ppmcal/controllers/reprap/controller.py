"""M665 and M666 of RepRapFirmware for a linear delta, and printers as ``config.g`` has them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta.firmware import DeltaFirmware, DeltaFit, patched_lines
from ppmcal.controllers.delta.fit import export_delta
from ppmcal.controllers.delta.gcode import Lines
from ppmcal.controllers.delta.geometry import DeltaGeometry
from ppmcal.controllers.delta.importer import printer_importer
from ppmcal.controllers.reprap.reading import (
    LETTERS,
    Delta,
    delta_of,
    format_delta,
    parse,
    read_delta,
    read_lines,
    read_printer,
    travel,
)
from ppmcal.notes import NOTE, Note

FAR = 5.0
"""Endstops that move by more than this, mm, are rather a mistake in the model."""


def _of(geometry: DeltaGeometry, old: Delta | None) -> Delta:
    """Return M665 and M666, rounded as they are written; the printable radius is ``old``'s."""
    return delta_of(geometry, None if old is None else old.bed).rounded()


def _table(delta: Delta) -> Iterator[tuple[str, str, float]]:
    for tower, rod in zip("XYZ", delta.rods, strict=True):
        yield f"M665 L of {tower}", "mm", rod
    yield "M665 R", "mm", delta.radius
    yield "M665 H", "mm", delta.height
    if delta.bed is not None:
        yield "M665 B", "mm", delta.bed
    for tower, angle in zip("XYZ", delta.angles, strict=True):
        yield f"M665 {tower}", "deg", angle
    for tower, end in zip("XYZ", delta.endstops, strict=True):
        yield f"M666 {tower}", "mm", end
    for letter, tilt in zip("AB", delta.tilt, strict=True):
        yield f"M666 {letter}", "%", tilt


def _how(new: Delta) -> Iterator[str]:
    yield "Put these in place of M665 and M666 in config.g, then home. If config.g runs M501,"
    yield "M665 and M666 in config-override.g win: change them there. M500 writes them anew,"
    yield "with 3 decimals. A0 B0 is meant: X, Y, Z of M666 hold the tilt of the bed."
    if new.bed is None:
        yield "B, the printable radius, stays as it is: no --old said it."


def _notes(found: DeltaFit[Delta]) -> Iterator[Note]:
    if any(found.new.endstops) or any(found.old.endstops):
        yield Note("X, Y, Z of M666 have mean 0 and H holds the rest, as the firmware's own "
                   "calibration leaves them: only their sums with H count", NOTE)
    if len(set(found.new.rods)) > 1:
        yield Note("three rods in L of M665 need firmware 2.03 or later", NOTE)
    if any(found.old.tilt):
        yield Note(
            "the tilt of the bed, A and B of M666, becomes 0: heights of endstops tilt every "
            "level in the same way, and hold it", NOTE)


def _advice(found: DeltaFit[Delta], old: Path | None, config: Lines | None) -> Iterator[Note]:
    yield Note(
        f"Put the lines of {REPRAP.file} in place of M665 and M666 in config.g; where M501 runs "
        "there, those of config-override.g win: change them there, or take them out.", NOTE)
    if config is not None:
        higher = float(np.mean(np.subtract(found.new.endstops, found.old.endstops)))
        higher += found.new.height - found.old.height
        if abs(higher) > FAR:
            yield Note(
                f"The endstops go {higher:+.1f} mm from where {config.source} has them: before "
                "you home, check that the model's `limits` end there.", NOTE)
        for place in config.overruled():
            yield Note(
                f"{config.source}: {place} runs another file, which is not followed: if that "
                "holds M665 or M666, give it as --old.", NOTE)


REPRAP = DeltaFirmware(
    "reprap", "RepRapFirmware", "reprap.g", ("X", "Y", "Z"), "delta radius R",
    "H of M665 and X, Y, Z of M666", "divide its steps per mm (M92) by that", read_lines,
    parse, read_delta, _of, travel, _table, format_delta, _how, _advice, _notes, codes=LETTERS,
    copy="config.g")
export, patch = partial(export_delta, REPRAP), partial(patched_lines, REPRAP)
import_config = printer_importer(read_printer)
