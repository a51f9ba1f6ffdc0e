"""Parameters that end farther from nominal than a machine within its tolerances would.

What data see weakly is pulled to nominal, so an estimate is judged by how far such data find the
errors of machines that are within their tolerances: with the tolerances as prior the variance is
that of the tolerance less that of the posterior, without a prior it is the sum of both.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from ppmcal.calibration.fit import CONVERGED, FAILED_NOISE, Fit, prediction_covariance
from ppmcal.linalg import Array


def farthest(count: int) -> float:
    """Return how many standard deviations the farthest of so many estimates may be from nominal.

    Two-sided, at the level of a failed check divided by their number (Bonferroni).

    >>> round(farthest(1), 2), round(farthest(20), 2)
    (3.29, 4.06)
    """
    return float(-ndtri(0.5 * FAILED_NOISE / max(count, 1)))


def expected_errors(fit: Fit) -> Array:
    """Return how large errors of each free parameter such data find (F,), SI, one sigma.

    Of machines that are within their tolerances; of a parameter without one, by noise alone. With
    the information J'J of the rows and the fit's covariance P the estimates are P J'J times the
    errors, and P J'J P is what noise adds.
    """
    problem = fit.problem
    tolerances = np.zeros(len(problem.columns))
    for c, p in enumerate(problem.free):
        tolerances[c] = problem.mechanism.parameters[p].prior_sigma or 0.0
    known = prediction_covariance(fit) / np.outer(fit.scale, fit.scale)
    rows = fit.reduced.triangle * fit.scale
    found = known @ (rows.T @ rows)
    # a fit ends within that of the minimum of its chi-squared
    variance = (found**2 @ (tolerances / fit.scale) ** 2 + np.sum((known @ rows.T) ** 2, axis=1)
                + CONVERGED * np.diagonal(known))
    return np.asarray((np.sqrt(variance) * fit.scale)[:len(problem.free)])
