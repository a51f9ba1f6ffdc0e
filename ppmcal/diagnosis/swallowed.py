"""Parameters that had moved to imitate what is missing."""

from __future__ import annotations

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.diagnosis.result import Swallowed


def swallowed(before: Fit, after: Fit) -> tuple[Swallowed, ...]:
    """Return the parameters that had moved by more than their tolerance to imitate effects."""
    out = []
    nominals = after.problem.mechanism.nominals
    for p in before.problem.free:
        parameter = before.problem.mechanism.parameters[p]
        tau = parameter.tolerance
        moved = float(before.state.g[p] - after.state.g[p])
        if before is not after and tau and np.isfinite(tau) and abs(moved) > tau:
            out.append(Swallowed(parameter.name, float(before.state.g[p] - nominals[p]),
                                 float(after.state.g[p] - nominals[p]), tau, parameter.quantity))
    return tuple(sorted(out, key=lambda s: -abs(s.before - s.after) / s.tolerance))
