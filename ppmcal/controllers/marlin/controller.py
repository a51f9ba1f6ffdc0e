"""M665 and M666 of Marlin for a linear delta, and printers as M503 reports them.

``M665 L R H S X Y Z A B C``: rod, delta radius, height, mm; segments per second; how far towers
stand from 210, 330 and 90 deg; how much longer than L each tower's rods are, mm. ``M666 X Y Z``:
how far each carriage backs off from its endstop, mm, 0 or below. Older versions have no A and C,
and B is a radius for their own calibration.

Tower i stands at (R cos w_i, R sin w_i); for a point (x, y, z) its carriage goes to

    h_i = sqrt((L + t_i)^2 - (x - R cos w_i)^2 - (y - R sin w_i)^2) + z,

and when it has backed off by e_i from its endstop it is taken to be at H + sqrt((L + t_i)^2 - R^2):
the endstop is -e_i above that (Marlin: ``delta.cpp``, ``motion.cpp``: homeaxis; ``M665.cpp``,
``M666.cpp``). A back-off below the shortest move, of some steps, is left out by the firmware.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta import geometry as delta_geometry
from ppmcal.controllers.delta.firmware import DeltaFirmware, DeltaFit, patched_lines
from ppmcal.controllers.delta.fit import export_delta
from ppmcal.controllers.delta.gcode import DIGITS, Lines, line_readers, two_lines, words
from ppmcal.controllers.delta.geometry import DeltaGeometry, Triple, triple
from ppmcal.controllers.delta.importer import printer_importer
from ppmcal.controllers.delta.printer import Printer, stated_nominal
from ppmcal.controllers.text import Rounded
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.notes import NOTE, Note

LETTERS = {665: "LRHSXYZABC", 666: "XYZ"}
_LEAD = re.compile(r"^(?:[^;\n]*?\becho:|\s*>+|\s*Recv:|\s*<<<)\s*(?=[;MGNmgn])", re.MULTILINE)
"""What stands before a line in what a host shows of a report."""


@dataclass(frozen=True)
class MarlinDelta(Rounded, digits=DIGITS):
    """The numbers of Marlin's delta; triples are towers A, B, C.

    Attributes:
        radius: M665 R, mm; rod: M665 L, mm; height: M665 H, mm.
        angles: M665 X, Y, Z, degrees from 210, 330 and 90.
        trims: M665 A, B, C, mm over L, None of a version that has them not.
        backs: M666 X, Y, Z, mm, 0 or below.
        segments: M665 S, None where nothing says.
    """

    radius: float
    rod: float
    height: float
    angles: Triple = (0.0, 0.0, 0.0)
    trims: Triple | None = (0.0, 0.0, 0.0)
    backs: Triple = (0.0, 0.0, 0.0)
    segments: float | None = None

    @property
    def rods(self) -> Array:
        """Length of each tower's rods (3,), mm."""
        return self.rod + np.array(self.trims or (0.0, 0.0, 0.0))


bare = partial(_LEAD.sub, "")
read_lines, parse = line_readers(LETTERS, "Give what M503 sent", bare)


def read_delta(lines: Lines) -> MarlinDelta:
    """Return the delta's numbers; angles, trims and back-offs are 0 where nobody says.

    Raises:
        BadInput: L, R or H is missing, or they make no delta that Marlin would take.
    """
    if not any(name.startswith("M665") for name in lines.values):
        raise BadInput("there is no M665 with numbers", lines.source,
                       "Give what M503 sends of a delta printer")
    radius = lines.number("M665 R", positive=True)
    rod = lines.number("M665 L", positive=True)
    new = "M665 A" in lines.values or "M665 C" in lines.values
    trims = lines.triple("M665", "ABC") if new else None
    backs = lines.triple("M666")
    for tower, (trim, back) in zip("XYZ", zip(trims or (0.0,) * 3, backs, strict=True),
                                   strict=True):
        lines.refuse_short(tower, rod + trim, radius)
        if back > 0.0:
            raise BadInput(f"{back:g} is above 0, and Marlin refuses it",
                           lines.at(f"M666 {tower}"), "Write 0 or less, and the rest into H")
    segments = lines.optional("M665 S")
    return MarlinDelta(radius, rod, lines.number("M665 H"), lines.triple("M665"), trims, backs,
                       segments)


def format_delta(delta: MarlinDelta, comment: str = "") -> str:
    """Return M665 and M666 as M503 reports them, with every letter that another line could set."""
    delta = delta.rounded()
    first = ("M665" + words("LRH", (delta.rod, delta.radius, delta.height))
             + ("" if delta.segments is None else words("S", (delta.segments,)))
             + words("XYZ", delta.angles)
             + ("" if delta.trims is None else words("ABC", delta.trims)))
    return two_lines(first, "M666" + words("XYZ", delta.backs), comment)


# --- arithmetic -----------------------------------------------------------------------------------


def travel(delta: MarlinDelta, point: Array) -> Array:
    """Return how far below its endstop each carriage goes for points (N, 3), (N, 3), m."""
    return delta_geometry.travel(geometry_of(delta), point)


def geometry_of(delta: MarlinDelta) -> DeltaGeometry:
    """Return the same machine as a delta's geometry."""
    return DeltaGeometry(delta.radius, delta_geometry.tower_angles(delta.angles),
                         triple(delta.rods), triple(delta.height - np.array(delta.backs)))


def delta_of(geometry: DeltaGeometry, old: MarlinDelta | None = None) -> MarlinDelta:
    """Return the same machine in Marlin's numbers, rounded as they are written.

    H is that of the lowest endstop, so that none backs off upwards; L the mean of the rods, and
    A, B, C how far each is off that. Segments are those of the old numbers.
    """
    rod = round(float(np.mean(geometry.arms)), DIGITS)
    height = round(min(geometry.endstops), DIGITS)
    own = MarlinDelta(geometry.radius, rod, height, geometry.turns,
                      triple(np.subtract(geometry.arms, rod)),
                      triple(np.minimum(0.0, height - np.array(geometry.endstops))),
                      None if old is None else old.segments).rounded()
    equal = not any(own.trims or ())
    return replace(own, trims=None) if equal and old is not None and old.trims is None else own


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


MARLIN = DeltaFirmware(
    "marlin", "Marlin", "marlin.g", ("X", "Y", "Z"), "delta radius R",
    "H of M665 and X, Y, Z of M666", "divide its steps per mm (M92) by that", read_lines, parse,
    read_delta, delta_of, travel, _table, format_delta, _how,
    advice=lambda *_: [Note(
        "Send the lines of marlin.g, then M500. DELTA_RADIUS_TRIM_TOWER of Configuration.h must be "
        "0 for all towers: no line says what it is.", NOTE)], notes=_notes, codes=LETTERS,
    bare=bare, copy="m503.txt")


def read_printer(path: Path, rods: float | None = None, meshes: Sequence[str] = (),
                 radius: float | None = None) -> Printer:
    """Return the printer of a report; a report holds no touches."""
    now = geometry_of(read_delta(read_lines(path)))
    nominal, findings = stated_nominal(str(path), now, now, "the report", rods, radius)
    findings.append(Note("the report holds no touches: write heights and carriages below their "
                         "endstops into a table with columns height, q_a, q_b, q_c"))
    return Printer(str(path), now, nominal, findings=tuple(findings))


export, patch = partial(export_delta, MARLIN), partial(patched_lines, MARLIN)
import_config = printer_importer(read_printer)
