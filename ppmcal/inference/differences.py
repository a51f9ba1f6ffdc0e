"""Whether things differ by more than their noise: how much they differ by is integrated."""

from __future__ import annotations

import numpy as np

from ppmcal import linalg
from ppmcal.inference.ranges import SIZES


def differing(chi2: float, freedom: int) -> float:
    """Return the odds that differences of unit noise are there, not noise alone.

    What is there has a normal distribution, its size in units of the noise as that of any cause
    (:data:`ppmcal.inference.ranges.SIZES`).

    Args:
        chi2: sum of squares of the differences over their noise.
        freedom: how many they are.
    """
    wider = 1.0 + SIZES**2
    each = 0.5 * (chi2 * (1.0 - 1.0 / wider) - freedom * np.log(wider))
    return float(np.exp(np.minimum(linalg.logsumexp(each) - np.log(SIZES.size), 700.0)))
