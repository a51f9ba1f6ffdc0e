"""Reading ``--tool``, ``0,0,-120``, a point in platform axes, and the length ``--metric``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ppmcal.errors import BadInput
from ppmcal.model.mechanism import Mechanism

LARGEST = 1e12


def read_point(text: str | None, mechanism: Mechanism, place: str = "--tool"
               ) -> NDArray[np.float64]:
    """Return the point (3,), m; the platform origin where none is given.

    Raises:
        BadInput: not two (planar) or three finite numbers.
    """
    if text is None:
        return np.zeros(3)
    sizes = (2, 3) if mechanism.motion == "planar" else (3,)
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in sizes or not all(
            math.isfinite(n) and abs(n) <= LARGEST for n in numbers):
        wanted = " or ".join(str(s) for s in sizes)
        raise BadInput(f"'{text}' is not a point", place,
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
