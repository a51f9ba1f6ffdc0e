"""What a fit saw, to be kept in the machine's file: noise check, how it ended, ranges of rows."""

from __future__ import annotations

import numpy as np

from ppmcal.calibration.fit import Fit, Noise
from ppmcal.calibration.knowledge.extrapolation import from_home
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array
from ppmcal.model.dataset import WRENCH
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import POSE_COORDINATES

CONDITIONS = ("temperature", "payload", "time", *WRENCH)


def measured_by(fit: Fit, noise: Noise) -> MeasurementBasis:
    """Return the noise check of a fit, the ranges of the rows that it used, SI, and how it ended.

    Carried on from an earlier calibration, with what that one had measured, as its machine says.
    """
    found: dict[str, list[Array]] = {}
    mechanism = fit.problem.mechanism
    if fit.problem.earlier is not None and mechanism.measured is not None:
        found = {name: [np.array(ends)] for name, ends in mechanism.measured.ranges.items()}
    for data, state, kept in zip(fit.problem.datasets, fit.state.poses, fit.keep, strict=True):
        # a distance has two platform positions
        full = from_home(mechanism, pose_vector(state[kept].reshape(-1, 8)))
        for c in mechanism.dof:
            found.setdefault(POSE_COORDINATES[c], []).append(full[:, c])
        joints = [data.q[kept], *([] if data.to_q is None else [data.to_q[kept]])]
        for a, name in enumerate(mechanism.actuators):
            found.setdefault(f"q_{name}", []).extend(q[:, a] for q in joints)
        for name in CONDITIONS:
            if name in data.columns:
                found.setdefault(name, []).append(data.columns[name][kept])
    ranges = {}
    for name, parts in found.items():
        values = np.concatenate(parts)
        values = values[np.isfinite(values)]
        if values.size:
            ranges[name] = (float(values.min()), float(values.max()))
    return MeasurementBasis(noise.sigma_ratio, noise.chi2_p, ranges, fit.ended)
