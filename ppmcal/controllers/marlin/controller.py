"""M665 and M666 of Marlin for a linear delta, and printers as M503 reports them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from ppmcal.controllers.delta.export import export_delta
from ppmcal.controllers.delta.firmware import DeltaFirmware, DeltaFit
from ppmcal.controllers.delta.gcode import Lines
from ppmcal.controllers.delta.importer import printer_importer
from ppmcal.controllers.delta.printer import Printer, stated_nominal
from ppmcal.controllers.marlin.config import (
    MarlinDelta,
    delta_of,
    format_delta,
    geometry_of,
    parse,
    read_delta,
    read_lines,
    travel,
)
from ppmcal.notes import NOTE, Note

NAN = float("nan")


def _table(delta: MarlinDelta) -> Iterator[tuple[str, str, float]]:
    yield "M665 L", "mm", delta.rod
    yield "M665 R", "mm", delta.radius
    yield "M665 H", "mm", delta.height
    for letter, angle in zip("XYZ", delta.angles, strict=True):
        yield f"M665 {letter}", "deg", angle
    for letter, trim in zip("ABC", delta.trims or (), strict=delta.trims is not None):
        yield f"M665 {letter}", "mm", trim
    for letter, back in zip("XYZ", delta.backs, strict=True):
        yield f"M666 {letter}", "mm", back


def _how(new: MarlinDelta) -> Iterator[str]:
    yield "Send both lines to the printer, then M500 to keep them, and home."
    if new.segments is None:
        yield "S, the segments per second, stays as it is: no --old said it."


def _notes(found: DeltaFit[MarlinDelta]) -> Iterator[Note]:
    yield Note("H of M665 is that of the lowest endstop: Marlin takes no M666 above 0, and leaves "
               "out one that is shorter than its shortest move", NOTE)
    if any(found.new.trims or ()):
        yield Note("rods that differ are A, B and C of M665, which older firmware does not have: "
                   "there B is another number, so send the line without them", NOTE)


def _advice(found: DeltaFit[MarlinDelta], old: Path | None, config: Lines | None
            ) -> Iterator[Note]:
    yield Note(f"Send the lines of {MARLIN.file}, then M500. DELTA_RADIUS_TRIM_TOWER of "
               "Configuration.h must be 0 for all towers: no line says what it is.", NOTE)


MARLIN = DeltaFirmware(
    "marlin", "Marlin", "marlin.g", ("X", "Y", "Z"), "delta radius R",
    "H of M665 and X, Y, Z of M666", "divide its steps per mm (M92) by that", read_lines, parse,
    read_delta, delta_of, travel, _table, format_delta, _how, _advice, _notes)


def read_printer(path: Path, rods: float | None = None, meshes: Sequence[str] = (),
                 radius: float | None = None) -> Printer:
    """Return the printer of a report; a report holds no touches.

    Raises:
        BadInput: anything wrong in the file.
    """
    now = geometry_of(read_delta(read_lines(path)))
    nominal, findings = stated_nominal(str(path), now, now, "the report", rods, radius)
    findings.append(Note("the report holds no touches: write heights and carriages below their "
                         "endstops into a table with columns height, q_a, q_b, q_c"))
    return Printer(str(path), now, (NAN, NAN, NAN), nominal, findings=tuple(findings))


export, import_config = partial(export_delta, MARLIN), printer_importer(read_printer)
