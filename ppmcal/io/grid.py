"""Reading ``--grid``: ``x=-300:300:41,y``, in the machine's units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.io.schema import LARGEST
from ppmcal.kinematics.region import Grid, slice_axes, slice_grid
from ppmcal.limits import GRID_POSES
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES

LEVELS = {1: 201, 2: 41, 3: 15}
"""Levels of each coordinate where none are given, by how many coordinates the grid has."""
PLACE = "--grid"


def read_grid(text: str | None, mechanism: Mechanism, levels: int = LEVELS[2]) -> Grid:
    """Return the grid of ``NAME[=LOW:HIGH[:COUNT]],...``.

    Coordinates that are not named stay as at home; without a range they go a little beyond
    what home can reach. Without a text: a map of ``levels`` by ``levels`` over the first two
    coordinates.

    Raises:
        BadInput: an unknown coordinate, a range that is none, too many poses.
    """
    if text is None:
        axes_of_map = slice_axes(mechanism)
        return slice_grid(mechanism, axes_of_map, [levels] * len(axes_of_map))
    parts = [p.strip() for p in text.split(",") if p.strip()]
    if not parts:
        raise BadInput("names no coordinate", PLACE, "Write for example x=-100:100:41,y=-100:100")
    axes: list[int] = []
    counts: list[int] = []
    ranges: dict[int, tuple[float, float]] = {}
    for part in parts:
        name, _, span = (p.strip() for p in part.partition("="))
        if name not in mechanism.coordinates:
            raise unknown("pose coordinate", name, mechanism.coordinates, PLACE)
        axis = POSE_COORDINATES.index(name)
        if axis in axes:
            raise BadInput(f"names {name} twice", PLACE, "Name each coordinate once")
        axes.append(axis)
        ends, count = _span(span, name, part)
        counts.append(count or LEVELS.get(len(parts), 7))
        if ends is not None:
            unit = mechanism.units.factor("length" if axis < 3 else "angle")
            ranges[axis] = (ends[0] * unit, ends[1] * unit)
    GRID_POSES.refuse(math.prod(counts), PLACE)
    if len(axes) > mechanism.freedoms:
        raise BadInput(f"names {len(axes)} coordinates, but the machine has "
                       f"{mechanism.freedoms} freedoms", PLACE, "Name fewer")
    return slice_grid(mechanism, axes, counts, ranges)


def _span(span: str, name: str, part: str) -> tuple[tuple[float, float] | None, int | None]:
    """Return the ends and the count of one coordinate, None where not given."""
    hint = f"Write {name}=LOW:HIGH or {name}=LOW:HIGH:COUNT, for example {name}=-100:100:41"
    if not span:
        return None, None
    pieces = span.split(":")
    if len(pieces) not in (2, 3):
        raise BadInput(f"'{part}' is not a range", PLACE, hint)
    try:
        low, high = float(pieces[0]), float(pieces[1])
        count = int(pieces[2]) if len(pieces) == 3 else None
    except ValueError:
        raise BadInput(f"'{part}' holds what is not a number", PLACE, hint) from None
    for end in (low, high):
        if not -1e12 < end < 1e12:
            raise BadInput(f"{end:g} in '{part}' is not between -1e12 and 1e12", PLACE, hint)
    if low >= high:
        raise BadInput(f"'{part}' does not go from a lower to a higher value", PLACE, hint)
    if count is not None and count < 2:
        raise BadInput(f"'{part}' has fewer than 2 levels", PLACE, hint)
    return (low, high), count


def read_point(given: str | Sequence[float] | None, mechanism: Mechanism) -> Array:
    """Return the point (3,), m, of ``--tool``; the platform origin where none is given.

    ``given``: ``X,Y,Z`` or numbers, in the mechanism file's unit of length.

    Raises:
        BadInput: not two (planar) or three finite numbers.
    """
    if given is None:
        return np.zeros(3)
    text = given if isinstance(given, str) else ",".join(map(str, given))
    sizes = tuple(range(mechanism.motion.axes, 4))
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in sizes or not all(
            math.isfinite(n) and abs(n) <= LARGEST for n in numbers):
        wanted = " or ".join(str(s) for s in sizes)
        raise BadInput(f"'{text}' is not a point", "--tool",
                       f"Write {wanted} numbers in {mechanism.units.length}, such as "
                       f"{','.join(['0'] * (sizes[0] - 1))},-120")
    return np.array([*numbers, 0.0][:3]) * mechanism.units.factor("length")


def metric_length(value: float | None, mechanism: Mechanism) -> float:
    """Return the length by which angles count, m; the machine's length scale where none is given.

    Raises:
        BadInput: not a length above 0.
    """
    if value is None:
        return mechanism.length_scale
    if not 0.0 < value < LARGEST:
        raise BadInput(f"{value:g} is not a length", "--metric", "Write a length above 0")
    return value * mechanism.units.factor("length")
