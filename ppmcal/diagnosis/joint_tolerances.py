"""How large errors of the joints' coordinates are in a machine that is within its tolerances."""

from __future__ import annotations

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Response
from ppmcal.calibration.knowledge import as_pose, by_tolerances
from ppmcal.diagnosis.linear_system import System, SystemPart
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift


def tolerated(part: SystemPart, system: System) -> tuple[Array, Array, Array]:
    """Return what joints and tolerances do to the platform in the n rows of a part.

    Its displacement with each joint, lengths and arcs at the platform's joints (n, 6, k); the
    squares of how far tolerances displace it, m and rad (n, 6), and of what that asks of each
    joint (n, k).
    """
    mechanism = system.problem.mechanism
    metric = np.array([1.0] * 3 + [mechanism.length_scale] * 3)[:, None]
    pose: Response = as_pose(part.response)
    across = metric * np.stack([pose.column(s) for s in joint_shifts(part)], axis=-1)
    sigma = by_tolerances(pose, mechanism)
    sigma = sigma[..., np.isfinite(sigma).all(axis=(0, 1))]    # one of inf says nothing
    asked = np.sum((linalg.pinv(across) @ (metric * sigma)) ** 2, axis=2)
    return across, np.sum(sigma**2, axis=2), asked


def joint_shifts(part: SystemPart) -> list[Shift]:
    """Return the shifts of one unit of each joint coordinate, in the rows of a part."""
    count = len(part.response.pose)
    return [Shift({(i, "offset"): np.ones(count) for i, limb in enumerate(part.setting.limbs)
                   if limb.actuator == a}) for a in range(part.setting.turning.size)]
