"""M665 and M666 of RepRapFirmware for a linear delta, and printers as ``config.g`` has them.

``M665 L R H B X Y Z``: rods, delta radius, height of the nozzle at the endstops, printable radius,
mm, and how far towers X, Y, Z stand from 210, 330 and 90 deg, counted against the clock from
above. ``M666 X Y Z A B``: how much higher than H each endstop is, mm, and how far the bed rises
along x and y, percent.

Tower i stands at (R cos w_i, R sin w_i) with w = 210 deg + X, 330 deg + Y, 90 deg + Z of M665. For
a point (x, y, z) its carriage goes to

    h_i = sqrt(L_i^2 - (x - R cos w_i)^2 - (y - R sin w_i)^2) + z + x A / 100 + y B / 100

and homing has set it to H + sqrt(L_i^2 - R^2) + e_i, with e = X, Y, Z and A, B of M666. Only
H + e_i counts. The firmware's own calibration leaves e with mean 0
(NormaliseEndstopAdjustments there), and so does :func:`delta_of`.

Without A and B these are the numbers of :class:`DeltaGeometry`, counted from elsewhere, and are
fitted as such. A and B stay 0: a plane through the endstops tilts every level of the machine as
they do, so that the two are nearly one. Fitting them as well took 2 to 6 % off what remained with
leaning towers.

Here in double precision and without steps; the firmware has single precision, 3e-5 mm at 300 mm.

Sources: RepRapFirmware, ``LinearDeltaKinematics.cpp`` (Configure, WriteCalibrationParameters,
Recalc, Transform, OnHomingSwitchTriggered); the firmware's G-code dictionary, M665 and M666.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta import geometry as delta_geometry
from ppmcal.controllers.delta.firmware import DeltaFirmware, DeltaFit, patched_lines
from ppmcal.controllers.delta.fit import export_delta
from ppmcal.controllers.delta.gcode import DIGITS, Lines, line_readers, two_lines, words
from ppmcal.controllers.delta.geometry import MM, DeltaGeometry, Triple, triple
from ppmcal.controllers.delta.importer import printer_importer
from ppmcal.controllers.delta.printer import Mesh, Printer, in_rows, mesh_of, stated_nominal
from ppmcal.controllers.text import Rounded, read_text
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.notes import NOTE, Note

LETTERS = {665: "LRHBXYZ", 666: "XYZAB"}
STEEP = 50.0
"""No bed is tilted by more, percent."""
FAR = 5.0
"""Endstops that move by more than this, mm, are rather a mistake in the model."""
OVERRIDE = "config-override.g"
"""What M500 writes and M501 runs."""


@dataclass(frozen=True)
class Delta(Rounded, digits=DIGITS):
    """The numbers of RepRapFirmware's linear delta; triples are towers X, Y, Z.

    Attributes:
        radius: M665 R, mm; rods: M665 L, mm; height: M665 H, mm.
        angles: M665 X, Y, Z, degrees from 210, 330 and 90.
        endstops: M666 X, Y, Z, mm above H.
        tilt: M666 A and B, percent.
        bed: M665 B, mm, None where nothing says.
    """

    radius: float
    rods: Triple
    height: float
    angles: Triple = (0.0, 0.0, 0.0)
    endstops: Triple = (0.0, 0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    bed: float | None = None


read_lines, parse = line_readers(LETTERS, "Give the config.g of a printer")


def read_delta(lines: Lines) -> Delta:
    """Return the delta's numbers; what is 0 in the firmware when nobody says is 0 here.

    Raises:
        BadInput: L, R or H is missing, or they make no delta of three towers.
    """
    if not any(name.startswith("M665") for name in lines.values):
        more = ", ".join(f"line {n} runs {command}" for n, command in lines.elsewhere)
        raise BadInput("there is no M665 with numbers", lines.source, "Give the config.g or "
                       "config-override.g of a linear delta"
                       + (f"; {more}, which is not followed" if more else ""))
    radius = lines.number("M665 R", positive=True)
    rods = _rods(lines)
    for tower, rod in zip("XYZ", rods, strict=True):
        lines.refuse_short(tower, rod, radius)
    tilt = lines.number("M666 A", 0.0), lines.number("M666 B", 0.0)
    for letter, percent in zip("AB", tilt, strict=True):
        if abs(percent) > STEEP:
            raise BadInput(f"the bed rises by {percent:g} %", lines.at(f"M666 {letter}"),
                           f"Write at most {STEEP:g}: 1 is 1 mm on 100 mm")
    bed = lines.optional("M665 B")
    return Delta(radius, rods, lines.number("M665 H"), lines.triple("M665"), lines.triple("M666"),
                 tilt, bed)


def _rods(lines: Lines) -> Triple:
    value = lines.values.get("M665 L")
    if value is None or len(value.numbers) == 1:
        rod = lines.number("M665 L", positive=True)
        return rod, rod, rod
    if len(value.numbers) != 3:
        raise BadInput(f"{len(value.numbers)} rods stand here", lines.at("M665 L"),
                       "Write one for all, or three: deltas of three towers are read")
    return value.numbers[0], value.numbers[1], value.numbers[2]


def format_delta(delta: Delta, comment: str = "") -> str:
    """Return M665 and M666 as M500 writes them, with every letter that another line could set.

    Rods that are equal are one number, as firmware before 2.03 wants it.
    """
    delta = delta.rounded()
    rods = delta.rods[:1] if len(set(delta.rods)) == 1 else delta.rods
    first = (f"M665 L{':'.join(f'{rod:.{DIGITS}f}' for rod in rods)}"
             + words("RH", (delta.radius, delta.height))
             + ("" if delta.bed is None else words("B", (delta.bed,)))
             + words("XYZ", delta.angles))
    return two_lines(first, "M666" + words("XYZAB", (*delta.endstops, *delta.tilt)), comment)


def travel(delta: Delta, point: Array) -> Array:
    """Return how far below its endstop each carriage goes for points (N, 3), (N, 3), m."""
    level = delta_geometry.travel(geometry_of(delta), point)
    return np.asarray(level - 0.01 * (point[:, :2] @ delta.tilt)[:, None])


def geometry_of(delta: Delta) -> DeltaGeometry:
    """Return the same machine as a delta's geometry, but for the tilt, which that has not."""
    return DeltaGeometry(delta.radius, delta_geometry.tower_angles(delta.angles), delta.rods,
                         triple(np.add(delta.height, delta.endstops)))


def delta_of(geometry: DeltaGeometry, old: Delta | None = None) -> Delta:
    """Return the same machine in RepRapFirmware's numbers; angles from -180 to 180 deg.

    The printable radius is that of the old numbers.
    """
    height = float(np.mean(geometry.endstops))
    return Delta(geometry.radius, geometry.arms, height, geometry.turns,
                 triple(np.subtract(geometry.endstops, height)), (0.0, 0.0),
                 None if old is None else old.bed)


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
    parse, read_delta, lambda geometry, old: delta_of(geometry, old).rounded(), travel, _table,
    format_delta, _how, _advice, _notes, codes=LETTERS, copy="config.g")


def read_printer(path: Path, rods: float | None = None, meshes: Sequence[str] = (),
                 radius: float | None = None) -> Printer:
    """Return the printer of a ``config.g`` with the beds of its height maps.

    Numbers of a ``config-override.g`` beside it, where M501 runs that, are what it prints with:
    a calibration's result, and no nominal. ``meshes``: paths of ``heightmap.csv``.
    """
    lines = read_lines(path)
    delta = read_delta(lines)
    active, findings = _active(path, lines, delta)
    now = geometry_of(active)
    nominal, told = stated_nominal(str(path), geometry_of(delta), now, "config.g", rods, radius)
    findings += told
    if any(active.tilt):
        findings.append(Note(f"A{active.tilt[0]:g} B{active.tilt[1]:g} of M666 tilt the bed: the "
                             "touches are taken with it, the machine has it in its endstops"))
    probe = probe_offset(path)
    beds = tuple(read_mesh(probe, partial(travel, active), Path(name)) for name in meshes)
    if not beds:
        findings.append(Note("the file holds no touches: give the map that G29 wrote with --mesh "
                             "heightmap.csv"))
    findings += [f for bed in beds for f in bed.findings]
    return Printer(str(path), now, nominal, active != delta, meshes=beds, findings=tuple(findings),
                   probe=probe[:2])


def _active(path: Path, lines: Lines, delta: Delta) -> tuple[Delta, list[Note]]:
    """Return what the firmware prints with, and what may hold more."""
    beside = path.with_name(OVERRIDE)
    runs = [command for _, command in lines.elsewhere]
    if "M501" in runs and beside.is_file() and beside != path:
        saved = read_lines(beside)
        both = replace(lines, values={**lines.values, **saved.values})
        return read_delta(both), []
    return delta, [Note(f"{place} runs another file, which is not followed: numbers of M665 and "
                        "M666 there would win") for place in lines.overruled()]


export, patch = partial(export_delta, REPRAP), partial(patched_lines, REPRAP)
import_config = printer_importer(read_printer)


# ---- height maps: touches of a bed, as G29 writes them


AS_WRITTEN = "Take the file as the firmware wrote it"
LARGEST = 1000
"""No grid has more points along an axis."""
FARTHEST = 1e6
"""No number of a height map is larger."""
_PROBE = re.compile(r"^[^\S\n]*G31\b([^;\n]*)", re.ASCII | re.IGNORECASE | re.MULTILINE)
_LETTER = re.compile(r"([XYZ])\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+))", re.ASCII | re.IGNORECASE)


def read_mesh(offset: Sequence[float], travel: Callable[[Array], Array], path: Path) -> Mesh:
    """Return a height map's touches as carriages, mm below the endstops.

    Args:
        offset: of the probe, as :func:`probe_offset` has it.
        travel: how far below its endstop each carriage goes for points (N, 3), (N, 3), m.
        path: of the map.

    Raises:
        BadInput: it is no such map.
    """
    grid, touched = read_map(path)
    point, way = in_rows(grid, touched)
    point = point - np.array([offset[0], offset[1], -offset[2]])
    down = travel(MM * point) / MM
    return mesh_of(path.stem, str(path), offset[2], down, way)


def probe_offset(config: Path) -> tuple[float, float, float]:
    """Return X, Y, Z of the last G31: the probe from the nozzle, and its trigger height, mm."""
    found = {"X": 0.0, "Y": 0.0, "Z": 0.0}
    for line in _PROBE.findall(read_text(config)):
        found |= {letter.upper(): float(value) for letter, value in _LETTER.findall(line)}
    return found["X"], found["Y"], found["Z"]


def read_map(path: Path) -> tuple[Array, Array]:
    """Return the grid (Y, X, 3) of a ``heightmap.csv``, mm, and which points were touched (Y, X).

    A header, names of columns, their numbers, and a line per row from the lowest y on; a point
    that was not touched is a 0 without a decimal point (RepRapFirmware, ``Grid.cpp``:
    ``WriteHeadingAndParameters``, ``SaveToFile``).

    Raises:
        BadInput: it is not such a file.
    """
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    if len(lines) < 4 or "height map" not in lines[0]:
        raise BadInput("is not a height map of RepRapFirmware", f"{path}: line 1",
                       "Give the heightmap.csv that G29 wrote")
    header, values, *cells = ([c.strip() for c in line.split(",")] for line in lines[1:])
    named = dict(zip(header, values, strict=False))
    axes = []
    for axis, number in (("x", "0"), ("y", "1")):
        low, high = (_first(named, path, f"{axis}{end}", f"{end}{number}")
                     for end in ("min", "max"))
        count = _first(named, path, f"{axis}num", f"num{number}", f"num_{axis}")
        space = _first(named, path, f"{axis}spacing", f"spacing{number}", "spacing")
        if count != int(count) or not 2 <= count <= LARGEST or not high > low or not space > 0.0:
            raise BadInput(f"{count:g} points from {low:g} to {high:g} mm along {axis} do not "
                           "form a grid", f"{path}: line 3",
                           AS_WRITTEN)
        axes.append(low + space * np.arange(int(count)))
    wanted = (len(axes[1]), len(axes[0]))
    for n, row in enumerate(cells, 4):
        if len(row) != wanted[1] or not all(_number(c) for c in row):
            raise BadInput(f"{len(row)} heights are not {wanted[1]} numbers", f"{path}: line {n}",
                           AS_WRITTEN)
    if len(cells) != wanted[0]:
        raise BadInput(f"{len(cells)} rows of heights are not {wanted[0]}", str(path),
                       AS_WRITTEN)
    height = np.array([[float(c) for c in row] for row in cells])
    touched = np.array([["." in c for c in row] for row in cells])
    if int(touched.sum()) < 3:
        raise BadInput(f"{int(touched.sum())} points were touched", str(path), "Probe the bed")
    return np.stack([*np.meshgrid(*axes), height], axis=-1), touched


def _number(cell: str) -> bool:
    try:
        return abs(float(cell)) <= FARTHEST
    except ValueError:
        return False


def _first(named: dict[str, str], path: Path, *names: str) -> float:
    for name in names:
        if name in named and _number(named[name]):
            return float(named[name])
    raise BadInput(f"{names[0]} is missing, or not a number up to {FARTHEST:g}", f"{path}: line 3",
                   AS_WRITTEN)
