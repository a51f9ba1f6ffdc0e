"""Rows that were measured in another assembly mode than home's: no error of the model.

At the same joint values a parallel machine closes in several ways. A row measured in another one
lies far from the predicted pose, by about the machine's own size, and the closure has a solution
near what was measured.
"""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit import Fit, shown
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.registration import carried_back, measured_pose
from ppmcal.linalg import Array, Bools, finite_rows

FAR = 0.1
"""Parts of the platform's size; assembly modes that are less apart are about to meet."""
NEARER = 0.1
"""The other pose is off what was measured by less than this part of what home's is: a value typed
wrong is as far from any mode."""


def in_other_assembly(fit: Fit) -> Bools:
    """Return which rows (N,) of a fit's first data set close in another mode, near their values.

    Heights and distances between two positions say too little of where the platform is: none.
    """
    data, state = fit.problem.datasets[0], fit.state
    mechanism = fit.problem.mechanism.with_values(state.g)
    q, pose = fit.problem.ends(0, state)[0]
    out = np.zeros(len(data), dtype=bool)
    if data.kind not in ("pose", "position"):
        return out
    # where the platform would be by what was measured, else as predicted
    seen = shown(data)
    start = carried_back(mechanism, state.registrations[0], np.where(
        np.isfinite(seen), seen, measured_pose(state.registrations[0], pose)))
    size = mechanism.length_scale
    rows = np.flatnonzero(finite_rows(q) & finite_rows(start)
                          & (_apart(start, pose, size) > FAR * size))
    if rows.size:
        model = Model(mechanism)
        other, closed, _ = newton(model.closure(q[rows]), start[rows])
        off = _apart(start[rows], pose[rows], size)
        out[rows] = (closed & (_apart(start[rows], other, size) < NEARER * off)
                     & (_apart(other, pose[rows], size) > FAR * size))
    return out


def _apart(one: Array, two: Array, size: float) -> Array:
    """Return how far poses (N, 8) are apart (N,), m; turns count at the platform's size."""
    place = np.linalg.norm(cga.translation(one) - cga.translation(two), axis=-1)
    turn = cga.rotation_vector(cga.compose(cga.reverse(one), two))
    return np.asarray(place + size * np.linalg.norm(turn, axis=-1))
