"""How far the platform of a machine within its tolerances can be from where the nominal one is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.response import Response
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism


def as_pose(response: Response) -> Response:
    """Return the response of the same n rows, were the platform's whole pose measured (n, 6)."""
    count = len(response.pose)
    return replace(response, end=0, seen=replace(
        response.seen, residual=np.zeros((count, 6)), observed=np.ones((count, 6), dtype=np.bool_),
        by_poses=(np.tile(np.eye(6), (count, 1, 1)),)))


def by_tolerances(pose: Response, mechanism: Mechanism) -> Array:
    """Return how the pose moves with one tolerance of each parameter (n, 6, F), m and rad.

    ``pose``: as :func:`as_pose` returns it. Infinite where a tolerance is.
    """
    free, tolerance = uncertain(mechanism)
    out = np.zeros((len(pose.pose), 6, len(free)))
    pose.geometry_columns(out, free, slice(len(free), len(free)))
    return scaled(out, tolerance)


def uncertain(mechanism: Mechanism) -> tuple[tuple[int, ...], Array]:
    """Return the parameters that may be off, and their tolerances (F,), SI.

    Infinite where a free parameter has none.
    """
    known = mechanism.parameters
    free = tuple(i for i, p in enumerate(known)
                 if i in mechanism.free or (p.tolerance and not p.fixed))
    return free, np.array([np.inf if known[i].tolerance is None else known[i].tolerance
                           for i in free], dtype=float)


def scaled(columns: Array, tolerance: Array) -> Array:
    """Return columns (..., F) times tolerances (F,); what does not move stays at 0."""
    with np.errstate(invalid="ignore"):
        return np.where(columns == 0.0, 0.0, columns * tolerance)
