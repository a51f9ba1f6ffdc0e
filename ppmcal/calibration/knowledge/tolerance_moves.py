"""How far the platform of a machine within its tolerances can be from where the nominal one is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Response
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism


def as_pose(response: Response) -> Response:
    """Return the response of the same n rows, were the platform's whole pose measured (n, 6)."""
    count = len(response.pose)
    return replace(response, end=0, seen=replace(
        response.seen, residual=np.zeros((count, 6)), observed=np.ones((count, 6), dtype=np.bool_),
        by_poses=(np.tile(np.eye(6), (count, 1, 1)),)))


def by_tolerances(response: Response, mechanism: Mechanism) -> Array:
    """Return how n predictions move with one tolerance of each parameter (n, m, F), m and rad.

    Of all that may be off, whatever a fit had free. Infinite where a tolerance is; what a
    parameter does not move stays at 0.
    """
    free, tolerance = uncertain(mechanism)
    here = response.closure
    whole = replace(response, closure=here.model.closure(here.q, free))
    out = np.zeros((*response.seen.residual.shape, len(free)))
    whole.geometry_columns(out, free, slice(len(free), len(free)))
    with np.errstate(invalid="ignore"):
        return np.where(out == 0.0, 0.0, out * tolerance)


def uncertain(mechanism: Mechanism) -> tuple[tuple[int, ...], Array]:
    """Return the parameters that may be off, and their tolerances (F,), SI.

    Infinite where a free parameter has none.
    """
    known = mechanism.parameters
    free = tuple(i for i, p in enumerate(known)
                 if i in mechanism.free or (p.tolerance and not p.fixed))
    return free, np.array([np.inf if known[i].tolerance is None else known[i].tolerance
                           for i in free], dtype=float)
