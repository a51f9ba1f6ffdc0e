"""How much more likely values are with a block than without, its size integrated.

A block's coefficients are s R z: z standard normal, s log-uniform over sizes, in units of the
noise. With M = (I + Z Z')^-1 of what is taken, G = R'C'MC R and b = R'C'My, and the noise's scale
integrated,

    log Z(s) / Z(0) = -1/2 log|I + s^2 G| - (nu0 + n)/2 log(1 - b'(G + I/s^2)^-1 b / (nu0 + y'My))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, ndtr, stdtr

from ppmcal import linalg
from ppmcal.inference.blocks import Batch
from ppmcal.inference.given import Conditioned
from ppmcal.inference.priors import LARGEST_SIZE, SIZE_STEPS, SMALLEST_SIZE
from ppmcal.linalg import Array

SIZES = np.geomspace(float(SMALLEST_SIZE), float(LARGEST_SIZE), SIZE_STEPS)
"""Sizes s (S,), rms over the noise."""
LEAST = 1e-300


@dataclass(frozen=True, eq=False)
class BatchOdds:
    """What a batch of B blocks looks like given what is taken.

    Attributes:
        log_odds: for each block, size and root (B, S, G): log Z with it over Z without.
        mean, deviation: of the coefficient of single columns (B, S), else empty.
    """

    log_odds: Array
    mean: Array
    deviation: Array

    @property
    def total(self) -> Array:
        """Log odds of each block (B,), all sizes and roots together."""
        few = self.log_odds[0].size if len(self.log_odds) else 1
        return np.asarray(logsumexp(self.log_odds, axis=(1, 2)) - np.log(few))

    def mode(self, block: int) -> tuple[int, int]:
        """Return the numbers of the size and root at which a block's odds are largest."""
        at = np.unravel_index(int(np.argmax(self.log_odds[block])), self.log_odds[block].shape)
        return int(at[0]), int(at[1])


def look(given: Conditioned, batch: Batch) -> BatchOdds:
    """Return the odds of each block of a batch, given what is taken."""
    seen = given.seen[batch.columns]                                   # (B, k, r)
    inner = batch.gram - seen @ seen.transpose(0, 2, 1)
    right = given.right[batch.columns]                                 # (B, k)
    square = np.einsum("bgkq,bkl,bglp->bgqp", batch.roots, inner, batch.roots, optimize=True)
    along = np.einsum("bgkq,bk->bgq", batch.roots, right)
    if square.shape[-1] == 1:
        own, part = square[..., 0], along
    else:
        own, turn = linalg.eigh(square)
        part = np.einsum("bgqp,bgq->bgp", turn, along)
    own = np.maximum(own, 0.0)[:, None]                                # (B, 1, G, q)
    part = (part**2)[:, None]
    grown = SIZES[None, :, None, None] ** 2
    spread = 1.0 + grown * own
    gone = np.sum(grown * part / spread, axis=-1)                      # (B, S, G)
    rest = np.maximum(given.spread - gone, LEAST)
    odds = (-0.5 * np.sum(np.log(spread), axis=-1)
            - 0.5 * given.freedom * np.log(rest / given.spread))
    odds = np.where(np.sum(own, axis=-1) > 0.0, odds, 0.0)
    if batch.columns.shape[1] > 1 or batch.roots.shape[1] > 1:
        return BatchOdds(odds, np.empty((0, 0)), np.empty((0, 0)))
    root = np.abs(batch.roots[:, 0, 0, 0])[:, None] * SIZES            # (B, S) of the coefficient
    spread, sign = spread[..., 0, 0], np.sign(batch.roots[:, 0, 0, 0])[:, None]
    mean = root * SIZES * sign * along[:, 0] / spread
    deviation = root * np.sqrt(rest[..., 0] / given.freedom / spread)
    if batch.bounded:
        odds = odds + _within(batch, mean, deviation, root, given.freedom)[..., None]
    return BatchOdds(odds, mean, deviation)


def _within(batch: Batch, mean: Array, deviation: Array, root: Array, freedom: float) -> Array:
    """Return by how much odds change where the coefficient has to be between two ends (B, S).

    The posterior is Student's, the prior normal; what the prior has between the ends, over all
    sizes, is one.
    """
    low, high = batch.low[:, None], batch.high[:, None]
    safe, wide = np.maximum(deviation, LEAST), np.maximum(root, LEAST)
    a, b = (low - mean) / safe, (high - mean) / safe
    turned = a > 0.0                    # differences of small tails, not of numbers near one
    a, b = np.where(turned, -b, a), np.where(turned, -a, b)
    after = stdtr(freedom, b) - stdtr(freedom, a)
    before = np.mean(ndtr(high / wide) - ndtr(low / wide), axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.maximum(after, LEAST)) - np.log(np.maximum(before, LEAST)))


def odds_of_all(given: Conditioned, some: Sequence[Batch], count: int) -> Array:
    """Return the log odds (count,) of each block of several batches."""
    out = np.full(count, -np.inf)
    for batch in some:
        out[batch.which] = look(given, batch).total
    return out
