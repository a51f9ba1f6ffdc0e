"""How far a machine is from where it should be, over many poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.errors import NoResult
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True)
class PoseErrors:
    """Errors over ``count`` poses: of position, m, and of rotation, rad, if there is one."""

    rms: float
    max: float
    rotation_rms: float | None
    rotation_max: float | None
    count: int


def pose_errors(mechanism: Mechanism, real: Array, wanted: Array) -> PoseErrors:
    """Return how far motors ``real`` are from ``wanted`` (N, 8), over the rows that are known.

    Raises:
        NoResult: no row is.
    """
    rows = np.flatnonzero(finite_rows(real) & finite_rows(wanted))
    if not rows.size:
        raise NoResult("the machine takes none of the poses", mechanism.source,
                       "Check `home` and `limits`, and the model with `ppmcal check`")
    at, ideal = real[rows], wanted[rows]
    away = np.linalg.norm(cga.translation(at) - cga.translation(ideal), axis=1)
    turn = np.linalg.norm(cga.rotation_vector(cga.compose(cga.reverse(ideal), at)), axis=1)
    turns = mechanism.motion != "translational"
    return PoseErrors(_rms(away), float(np.max(away)), _rms(turn) if turns else None,
                  float(np.max(turn)) if turns else None, int(rows.size))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
