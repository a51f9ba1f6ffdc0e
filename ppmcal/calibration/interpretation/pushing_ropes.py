"""Ropes that would have to push in rows of a fit: slack there, whatever their drives read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.loads import rope_tensions
from ppmcal.notes import FINDING, Note
from ppmcal.wording import number, row_list


def slack_ropes(fit: Fit) -> Iterator[Note]:
    """Yield, of each file, the ropes whose tension is negative, as measured or by the load."""
    mechanism = fit.problem.mechanism
    ropes = sorted({limb.actuator for limb in mechanism.limbs if limb.kind.pulls_only})
    if not ropes:
        return
    model = Model(mechanism, fit.state.g)
    for data, rows, pose in zip(fit.problem.datasets, fit.problem.environments, fit.state.poses,
                                strict=True):
        tension = rope_tensions(model, data.q, pose, rows.wrench, rows.tension)[:, ropes]
        for a, own in zip(ropes, tension.T, strict=True):
            slack = np.flatnonzero(own < 0.0)
            if slack.size:
                least = number(float(own[slack].min()), 3)
                yield Note(
                    f"{data.name}: {mechanism.actuators[a]} would have to push in "
                    f"{row_list(data.rows[slack] - 1)} (down to {least} N): a rope is "
                    "slack there, and its reading says nothing. Leave these rows out, or "
                    "load the platform so that all ropes pull.", FINDING, "slack")
