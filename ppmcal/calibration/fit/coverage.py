"""Half of a 95 % interval: 1.96 sigma of a noise that is known, more of one that was estimated.

The one place that makes an interval of a sigma. The variance of rows is a scaled inverse
chi-squared about the stated one, which counts as :data:`LEAST` values; integrated out, an estimate
that no tolerance holds in part has Student's distribution (Gelman et al., Bayesian Data
Analysis, 3.2).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri, ndtr, stdtrit

from ppmcal.linalg import Array

Z95 = 1.959963984540054
"""Half of a 95 % interval over sigma where the size of the noise is known."""
LEAST = 5.0
"""A data set of less redundancy keeps its stated noise; where that is only where an estimate
starts, it counts as so many redundant values more."""
NODES = 200
"""Sizes of the noise that an interval is a mixture of."""


def variances(chi2: float, degrees: float) -> Array:
    """Return equally likely variances of the rows (n,), over the stated one.

    Args:
        chi2: of what no error of the machine can explain, in stated noise.
        degrees: of freedom of that; none where not positive.
    """
    freedom = LEAST + max(degrees, 0)
    chance = (np.arange(NODES) + 0.5) / NODES
    return np.asarray((LEAST + chi2 * (degrees > 0)) / chdtri(freedom, chance))


def half_of_mixture(variance: Array, weight: Array | None = None) -> Array:
    """Return the half width (C,) that holds 95 % of a mixture of normals, variances (n, C).

    ``weight``: of each normal (n,), of sum 1  [default: of all the same].
    """
    sigma = np.sqrt(np.maximum(variance, 1e-300))
    low, high = sigma.min(axis=0), 10.0 * sigma.max(axis=0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        each = ndtr(middle / sigma)
        inside = 2.0 * (each.mean(axis=0) if weight is None else weight @ each) - 1.0
        low, high = np.where(inside < 0.95, middle, low), np.where(inside < 0.95, high, middle)
    return np.asarray(0.5 * (low + high))


def coverage_of(variance: Array) -> float:
    """Return half of a 95 % interval over the sigma that unit noise makes.

    Args:
        variance: equally likely variances of the noise (n,), over unit noise.
    """
    return float(half_of_mixture(variance[:, None])[0])


def coverage_by(degrees: float) -> float:
    """Return the same of a noise that was estimated from so many degrees of freedom (Student).

    >>> round(coverage_by(float("inf")), 2), round(coverage_by(10.0), 2)
    (1.96, 2.23)
    """
    return Z95 if np.isinf(degrees) else float(stdtrit(degrees, 0.975))


def half_interval(low: float | None, high: float | None, sigma: float | None) -> float | None:
    """Return half of a 95 % interval from its ends, else from sigma as if the noise were known."""
    if low is not None and high is not None:
        return 0.5 * (high - low)
    return None if sigma is None else Z95 * sigma


def half_or(half: float | None, sigma: float | None) -> float | None:
    """Return half of a 95 % interval; where a file does not say, as if the noise were known."""
    return half if half is not None else half_interval(None, None, sigma)
