"""Whether quantities differ by more than their noise, with the size of differences integrated."""

from __future__ import annotations

import numpy as np

from ppmcal import linalg
from ppmcal.inference.ranges import SIZES


def differing(chi2: float, freedom: int) -> float:
    """Return the odds that there are real differences rather than noise alone.

    Real differences are normally distributed, with a size in units of the noise like that of any
    cause (:data:`ppmcal.inference.ranges.SIZES`).

    Args:
        chi2: sum of squares of the differences over their noise.
        freedom: number of differences.
    """
    wider = 1.0 + SIZES**2
    each = 0.5 * (chi2 * (1.0 - 1.0 / wider) - freedom * np.log(wider))
    return float(np.exp(np.minimum(linalg.logsumexp(each) - np.log(SIZES.size), 700.0)))
