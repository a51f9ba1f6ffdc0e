"""Half width of a 95 % interval: 1.96 sigma if the noise is known, more if it was estimated.

The one place that makes an interval from a sigma. The variance of rows is a scaled inverse
chi-squared about the stated one, which counts as :data:`LEAST` values; integrated out, an estimate
that no tolerance constrains has Student's distribution (Gelman et al., Bayesian Data
Analysis, 3.2).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri, ndtr, stdtrit

from ppmcal.linalg import Array

Z95 = 1.959963984540054
"""Half width of a 95 % interval over sigma if the noise is known."""
LEAST = 5.0
"""A data set of less redundancy keeps its stated noise; if that is only a starting value for the
estimate, it counts as this many redundant values."""
NODES = 200
"""Number of noise variances in the mixture that an interval is of."""


def variances(chi2: float, degrees: float) -> Array:
    """Return equally likely variances of the rows (n,), relative to the stated one.

    Args:
        chi2: of what no error of the machine can explain, by the stated noise.
        degrees: its degrees of freedom; without any the stated noise alone counts.
    """
    freedom = LEAST + max(degrees, 0)
    chance = (np.arange(NODES) + 0.5) / NODES
    return np.asarray((LEAST + chi2 * (degrees > 0)) / chdtri(freedom, chance))


def half_of_mixture(variance: Array, weight: Array | None = None) -> Array:
    """Return the half width (C,) containing 95 % of a mixture of normals, variances (n, C).

    ``weight``: of each normal (n,), summing to 1  [default: equal weights].
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
    """Return the half width of a 95 % interval over the sigma for unit noise.

    Args:
        variance: equally likely variances of the noise (n,), relative to unit noise.
    """
    return float(half_of_mixture(variance[:, None])[0])


def coverage_by(degrees: float) -> float:
    """Return the same for noise estimated with so many degrees of freedom (Student).

    >>> round(coverage_by(float("inf")), 2), round(coverage_by(10.0), 2)
    (1.96, 2.23)
    """
    return Z95 if np.isinf(degrees) else float(stdtrit(degrees, 0.975))


def half_interval(low: float | None, high: float | None, sigma: float | None) -> float | None:
    """Return the half width of a 95 % interval from its ends, else from sigma as known noise."""
    if low is not None and high is not None:
        return 0.5 * (high - low)
    return None if sigma is None else Z95 * sigma


def half_or(half: float | None, sigma: float | None) -> float | None:
    """Return the half width of a 95 % interval; if not given, from sigma as known noise."""
    return half if half is not None else half_interval(None, None, sigma)
