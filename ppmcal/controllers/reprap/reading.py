"""A ``config.g`` and height maps as a printer with touches."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta.gcode import Lines
from ppmcal.controllers.delta.geometry import MM
from ppmcal.controllers.delta.printer import Mesh, Printer, in_rows, mesh_of, stated_nominal
from ppmcal.controllers.reprap.config import Delta, geometry_of, read_delta, read_lines, travel
from ppmcal.controllers.text import read_text
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.notes import Note

OVERRIDE = "config-override.g"
"""What M500 writes and M501 runs."""
LARGEST = 1000
"""No grid has more points along an axis."""
FARTHEST = 1e6
"""No number of a height map is larger."""
_PROBE = re.compile(r"^[^\S\n]*G31\b([^;\n]*)", re.ASCII | re.IGNORECASE | re.MULTILINE)
_LETTER = re.compile(r"([XYZ])\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+))", re.ASCII | re.IGNORECASE)


def read_printer(path: str | os.PathLike[str], rods: float | None = None,
                 meshes: Sequence[str] = (), radius: float | None = None) -> Printer:
    """Return the printer of a ``config.g`` with the beds of its height maps.

    Numbers of a ``config-override.g`` beside it, where M501 runs that, are what it prints with:
    a calibration's result, and no nominal.

    Args:
        path: ``config.g``.
        rods: length of the rods as the user knows it, mm.
        meshes: paths of ``heightmap.csv``.
        radius: R of M665 as the user knows it, mm.

    Raises:
        BadInput: anything wrong in a file.
    """
    lines = read_lines(path)
    delta = read_delta(lines)
    active, findings = _active(Path(path), lines, delta)
    now = geometry_of(active)
    nominal, told = stated_nominal(str(path), geometry_of(delta), now, "config.g", rods, radius)
    findings += told
    if any(active.tilt):
        findings.append(Note(f"A{active.tilt[0]:g} B{active.tilt[1]:g} of M666 tilt the bed: the "
                             "touches are taken with it, the machine has it in its endstops"))
    beds = tuple(_mesh(Path(path), active, Path(name)) for name in meshes)
    if not beds:
        findings.append(Note("the file holds no touches: give the map that G29 wrote with --mesh "
                             "heightmap.csv"))
    findings += [f for bed in beds for f in bed.findings]
    return Printer(str(path), now, (np.nan, np.nan, np.nan), nominal, active != delta, meshes=beds,
                   findings=tuple(findings))


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


def _mesh(config: Path, active: Delta, path: Path) -> Mesh:
    """Return a height map's touches as carriages, mm below the endstops."""
    offset = _probe_offset(config)
    grid, touched = read_map(path)
    point, way = in_rows(grid, touched)
    point = point - np.array([offset[0], offset[1], -offset[2]])
    down = travel(active, MM * point) / MM
    return mesh_of(path.stem, str(path), offset[2], down, way)


def _probe_offset(config: Path) -> tuple[float, float, float]:
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
                           "Take the file as the firmware wrote it")
        axes.append(low + space * np.arange(int(count)))
    wanted = (len(axes[1]), len(axes[0]))
    for n, row in enumerate(cells, 4):
        if len(row) != wanted[1] or not all(_number(c) for c in row):
            raise BadInput(f"{len(row)} heights are not {wanted[1]} numbers", f"{path}: line {n}",
                           "Take the file as the firmware wrote it")
    if len(cells) != wanted[0]:
        raise BadInput(f"{len(cells)} rows of heights are not {wanted[0]}", str(path),
                       "Take the file as the firmware wrote it")
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
                   "Take the file as the firmware wrote it")
