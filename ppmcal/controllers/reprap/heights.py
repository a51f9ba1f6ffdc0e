"""Height maps of RepRapFirmware: touches of a bed, as G29 writes them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta.geometry import MM
from ppmcal.controllers.delta.printer import Mesh, in_rows, mesh_of
from ppmcal.controllers.text import read_text
from ppmcal.errors import BadInput
from ppmcal.linalg import Array

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
