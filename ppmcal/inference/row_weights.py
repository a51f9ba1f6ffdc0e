"""How much a row counts: how likely it belongs, sizes of noise and of gross errors integrated.

A row that belongs is off by noise; of the others, one in so many, by noise and an error of its own,
whose size nobody knows. With d its squared distance, white by the noise that all rows show, and m
the values behind it, both are Student's, of what is known of that noise:

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
"""Sizes of an error that is none of the noise's."""
AT_ONCE = 2**16


def log_ratio(square: Array, size: Array, freedom: float) -> Array:
    """Return how much likelier rows are if they do not belong, its logarithm (n,).

    Args:
        square: squared white distances (n,).
        size: values behind each, above 0 (n,).
        freedom: degrees of freedom of the noise's size.
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
    """Return twice the negative logarithm of how likely rows are (n,), to a constant.

    Arguments as :func:`log_ratio`, with the stated noise as it is known.
    """
    freedom = float(NOISE_FREEDOM)
    return np.asarray((freedom + size) * np.log1p(square / freedom) - 2.0 * np.logaddexp(
        0.0, logit(float(GROSS_ROW)) + log_ratio(square, size, freedom)))


def row_weights(square: Array, size: Array, freedom: float, belong: int) -> Array:
    """Return the weight of each row (n,): how likely it belongs, over a row that is not off at all.

    Arguments as :func:`log_ratio`; ``belong``: rows that do. With them one more belongs the surer;
    those that do not have no say in the others.
    """
    odds = 1.0 / float(GROSS_ROW) + belong - 1.0
    nowhere = log_ratio(np.zeros(size.size), size, freedom)
    return np.asarray(expit(np.log(odds) - log_ratio(square, size, freedom))
                      / expit(np.log(odds) - nowhere))
