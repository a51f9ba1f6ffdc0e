"""Noise that was estimated from residuals: is it noise, or has what does not fit become it?

An estimate takes whatever is left for noise, measurements of another machine too. Where it exceeds
what the machine's tolerances do to the readings, the rows have told nothing of the machine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.calibration.fit import Fit, typical_noise
from ppmcal.linalg import Array, reciprocals


def noise_beyond_tolerances(fit: Fit, which: Sequence[bool]) -> list[str]:
    """Return a sentence for each data set whose estimated noise hides all that tolerances do.

    Args:
        fit: with the noise as it was estimated; without tolerances there is nothing to compare.
        which: data sets whose noise is estimated (D,).
    """
    out = []
    for i, data in enumerate(fit.problem.datasets):
        if not which[i] or not fit.keep[i].any():
            continue
        moved = _moved(fit, i)
        noise = typical_noise(data)
        if not 0.0 < moved < 1.0 or not np.isfinite(noise):
            continue
        unit, factor = data.units.length, data.units.factor("length")
        out.append(
            f"{data.name}: what is left, {noise / factor:.3g} {unit}, is taken for noise, and is "
            f"more than this machine's tolerances move the readings ({moved * noise / factor:.3g} "
            f"{unit}): these rows tell nothing of the machine; check that they are of it, how "
            "their columns are read, and the tolerances")
    return out


def _moved(fit: Fit, i: int) -> float:
    """Return how far tolerances move the readings of a data set over their noise, the median."""
    held = fit.prior[:len(fit.problem.free)] > 0.0
    if not held.any():
        return 0.0
    tau = reciprocals(fit.prior[:held.size])
    each: list[Array] = []
    for rows in fit.problem.rows_of(i, fit.state, True, fit.keep[i]):
        spread = np.linalg.norm(rows.jacobian[..., :held.size] * tau, axis=-1)
        each.append(spread[rows.observed])
    values = np.concatenate(each) if each else np.zeros(0)
    return float(np.median(values)) if values.size else 0.0
