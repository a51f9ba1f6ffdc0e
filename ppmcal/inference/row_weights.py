"""Row weights: the probability of not being an outlier, noise and error sizes integrated.

An inlier is off by noise; an outlier, one row in so many, by noise and an error of unknown size.
With d its squared distance, whitened by the noise common to all rows, and m its number of values,
both follow Student's t with the degrees of freedom of that noise:

    p(d | belongs)        ~ (1 + d / freedom)^-(freedom + m)/2
    p(d | does not, size) ~ (1 + size^2)^-m/2 (1 + d / freedom / (1 + size^2))^-(freedom + m)/2
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit, logit

from ppmcal import linalg
from ppmcal.inference.priors import GROSS_ROW, NOISE_FREEDOM
from ppmcal.inference.ranges import SIZES
from ppmcal.linalg import Array

BEYOND_NOISE = SIZES[SIZES > 1.0]
"""Sizes of an error beyond the noise."""
AT_ONCE = 2**16


def log_ratio(square: Array, size: Array, freedom: float) -> Array:
    """Return the log likelihood ratio of each row being an outlier (n,).

    Args:
        square: squared whitened distances (n,).
        size: number of values of each, above 0 (n,).
        freedom: degrees of freedom of the noise scale.
    """
    own = 1.0 + BEYOND_NOISE**2
    out = np.empty(square.size)
    for begin in range(0, square.size, AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        d, m = square[some, None], size[some, None]
        each = 0.5 * (freedom + m) * (np.log1p(d / freedom) - np.log1p(d / (freedom * own)))
        out[some] = linalg.logsumexp(each - 0.5 * m * np.log(own), axis=1) - np.log(own.size)
    return out


def improbability(square: Array, size: Array) -> Array:
    """Return minus twice the log probability of rows (n,), up to a constant.

    Arguments as for :func:`log_ratio`, with the degrees of freedom of stated noise.
    """
    freedom = float(NOISE_FREEDOM)
    return np.asarray((freedom + size) * np.log1p(square / freedom) - 2.0 * np.logaddexp(
        0.0, logit(float(GROSS_ROW)) + log_ratio(square, size, freedom)))


def row_weights(square: Array, size: Array, freedom: float, belong: int) -> Array:
    """Return the weight of each row (n,): its inlier probability over that of a row without error.

    Arguments as for :func:`log_ratio`; ``belong``: number of inliers. The more there are, the more
    probable is another; outliers do not influence the other rows.
    """
    odds = 1.0 / float(GROSS_ROW) + belong - 1.0
    nowhere = log_ratio(np.zeros(size.size), size, freedom)
    return np.asarray(expit(np.log(odds) - log_ratio(square, size, freedom))
                      / expit(np.log(odds) - nowhere))
