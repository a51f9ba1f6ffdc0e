"""Sizes of blocks, and how much of a prior or posterior lies where coefficients may be."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr

from ppmcal.inference.priors import LARGEST_SIZE, SIZE_STEPS, SMALLEST_SIZE
from ppmcal.linalg import Array, Ints

SIZES = np.geomspace(float(SMALLEST_SIZE), float(LARGEST_SIZE), SIZE_STEPS)
"""Sizes s (S,), rms over the noise."""
LEAST = 1e-300


def bounded(low: Array, high: Array) -> Ints:
    """Return which of the last axis' coefficients (..., k) have an end at all, of any block."""
    ends = np.isfinite(low) | np.isfinite(high)
    return np.flatnonzero(ends.reshape(-1, ends.shape[-1]).any(axis=0))


def usual(roots: Array, low: Array, high: Array, known: float) -> Array:
    """Return the log prior probability (...) that coefficients are between their ends.

    Over all roots (..., G, k, q) and sizes; ``low``, ``high`` (..., k); ``known``: degrees of
    freedom of the noise's prior.
    """
    has = bounded(low, high)
    low, high = low[..., None, None, has], high[..., None, None, has]
    norm = np.sqrt(np.sum(roots[..., has, :] ** 2, axis=-1))            # (..., G, k)
    each = all_between(known, low, high, SIZES[:, None] * norm[..., None, :])
    return np.asarray(np.log(np.maximum(np.mean(np.exp(each), axis=(-2, -1)), LEAST)))


def all_between(freedom: float, low: Array, high: Array, deviation: Array) -> Array:
    """Return the log probability (...) that all of k coefficients are between their ends (..., k).

    Each by itself, by Student's t of a standard deviation.
    """
    safe = np.maximum(deviation, LEAST)
    if not np.isfinite(high).any():         # a sign alone: one tail
        each = stdtr(freedom, -low / safe)
    else:
        a, b = low / safe, high / safe
        turned = a > 0.0                    # differences of small tails, not of numbers near one
        a, b = np.where(turned, -b, a), np.where(turned, -a, b)
        each = stdtr(freedom, b) - stdtr(freedom, a)
    return np.asarray(np.sum(np.log(np.maximum(each, LEAST)), axis=-1))
