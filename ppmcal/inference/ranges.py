"""Sizes of blocks, and the prior or posterior probability of coefficients within bounds."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from ppmcal.inference.priors import LARGEST_SIZE, SIZE_STEPS, SMALLEST_SIZE
from ppmcal.linalg import Array, Ints

SIZES = np.geomspace(float(SMALLEST_SIZE), float(LARGEST_SIZE), SIZE_STEPS)
"""Sizes s (S,), rms over the noise."""
LEAST = 1e-300
TINY = 1e-200
"""Probabilities too small for an accurate quotient."""
FAR = 1e12
"""Standard deviations beyond which the probability is less than LEAST."""


def bounded(low: Array, high: Array) -> Ints:
    """Return which coefficients of the last axis (..., k) are bounded in any block."""
    ends = np.isfinite(low) | np.isfinite(high)
    return np.flatnonzero(ends.reshape(-1, ends.shape[-1]).any(axis=0))


def usual(roots: Array, low: Array, high: Array, known: float) -> Array:
    """Return the log prior probability (...) that coefficients are within their bounds.

    Averaged over all roots (..., G, k, q) and sizes; ``low``, ``high`` (..., k); ``known``: degrees
    of freedom of the noise prior.
    """
    has = bounded(low, high)
    low, high = low[..., None, None, has], high[..., None, None, has]
    norm = np.sqrt(np.sum(roots[..., has, :] ** 2, axis=-1))            # (..., G, k)
    each = all_between(known, low, high, SIZES[:, None] * norm[..., None, :])
    return np.asarray(np.log(np.maximum(np.mean(np.exp(each), axis=(-2, -1)), LEAST)))


def all_between(freedom: float, low: Array, high: Array, deviation: Array) -> Array:
    """Return the log probability (...) that all of k coefficients are within bounds (..., k).

    As independent, by Student's t with a given standard deviation.
    """
    safe = np.maximum(deviation, LEAST)
    if not np.isfinite(high).any():         # a sign alone: one tail
        each = student(freedom, -low / safe)
    else:
        a, b = low / safe, high / safe
        turned = a > 0.0                    # subtract small tails, not numbers near one
        a, b = np.where(turned, -b, a), np.where(turned, -a, b)
        each = student(freedom, b) - student(freedom, a)
    return np.asarray(np.sum(np.log(np.maximum(each, LEAST)), axis=-1))


def together_between(freedom: float, low: Array, high: Array, covariance: Array) -> Array:
    """Return the joint log probability (...) that k coefficients are within bounds (..., k).

    One after the other, given that the previous ones are, which are approximated as normal with
    their truncated moments (Mendell & Elston 1974). ``covariance`` (..., k, k).
    """
    count = covariance.shape[-1]
    total: Array = np.zeros(np.broadcast_shapes(low.shape, covariance.shape[:-1])[:-1])
    mean: Array = np.zeros((*total.shape, count))
    left: Array = np.broadcast_to(covariance, (*total.shape, count, count)).copy()
    for j in range(count):
        deviation = np.sqrt(np.maximum(left[..., j, j], LEAST))
        a, b = (np.clip((end[..., j] - mean[..., j]) / deviation, -FAR, FAR)
                for end in (low, high))
        own = all_between(freedom, a[..., None], b[..., None], np.ones(1))
        total += own
        if j + 1 < count:
            shift, narrowed = _moments(a, b, np.exp(own))
            slope = left[..., j + 1:, j] / deviation[..., None]
            mean[..., j + 1:] += slope * shift[..., None]
            left[..., j + 1:, j + 1:] -= (slope[..., :, None] * slope[..., None, :]
                                          * (1.0 - narrowed)[..., None, None])
    return total


def _moments(a: Array, b: Array, chance: Array) -> tuple[Array, Array]:
    """Return mean and variance of a standard normal truncated to a, b; ``chance``: its mass."""
    at_a, at_b = (np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi) for x in (a, b))
    mean = np.clip((at_a - at_b) / chance, a, b)
    variance = 1.0 + (a * at_a - b * at_b) / chance - mean**2
    # too far out for any digits: all mass is at the nearer end
    far = chance < TINY
    near = np.where(np.abs(a) < np.abs(b), a, b)
    return np.where(far, near, mean), np.where(far, 0.0, np.clip(variance, 0.0, 1.0))


def student(freedom: float, x: Array) -> Array:
    """Return the probability that Student's t is below x, by a normal of the transformed x.

    Practically exact for the degrees of freedom of the noise or more, in a quarter of the time.
    Hill 1970, Algorithm 395.
    """
    a, x = freedom - 0.5, np.clip(x, -FAR, FAR)
    b, y = 48.0 * a**2, a * np.log1p(x**2 / freedom)
    series = (((-0.4 * y - 3.3) * y - 24.0) * y - 85.5) / (0.8 * y**2 + 100.0 + b) + y + 3.0
    return np.asarray(ndtr(np.copysign(np.sqrt(y) * (1.0 + series / b), x)))
