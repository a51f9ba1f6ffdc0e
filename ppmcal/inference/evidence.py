"""Evidence of values with a block relative to that without, its size integrated.

A block's coefficients are s R z: z standard normal, s log-uniform over sizes, in units of the
noise. With M = (I + Z Z')^-1 of the conditioning, G = R'C'MC R and b = R'C'My, and the noise scale
integrated,

    log Z(s) / Z(0) = -1/2 log|I + s^2 G| - (nu0 + n)/2 log(1 - b'(G + I/s^2)^-1 b / (nu0 + y'My))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ppmcal import linalg
from ppmcal.inference.blocks import Batch
from ppmcal.inference.given import Conditioned
from ppmcal.inference.ranges import LEAST, SIZES, all_between, bounded, together_between
from ppmcal.linalg import Array, Bools, Ints


class NoiseScale(Protocol):
    """Knowledge of the noise scale; for several correlations ``spread`` is (V, 1, 1)."""

    @property
    def freedom(self) -> float:
        """Degrees of freedom of its posterior."""

    @property
    def spread(self) -> Array | float:
        """Sum of squares behind it."""


def odds_by_size(given: NoiseScale, own: Array, part: Array, gone: Array | float = 0.0) -> Array:
    """Return log Z at each size over log Z without the block (..., S).

    Args:
        given: the noise scale given the conditioning.
        own: eigenvalues of G (..., q).
        part: squares of b along them (..., q).
        gone: part of y'My explained by blocks outside the conditioning; an array is (..., 1).
    """
    own, part = np.maximum(own, 0.0)[..., None, :], part[..., None, :]
    grown = SIZES[:, None] ** 2
    spread = 1.0 + grown * own
    rest = np.maximum(given.spread - gone - np.sum(grown * part / spread, axis=-1), LEAST)
    return np.asarray(-0.5 * np.sum(np.log(spread), axis=-1)
                      - 0.5 * given.freedom * np.log(rest / given.spread))


WIDE = 8
"""Above this number of columns eigenvectors cost more than a tridiagonal form."""


def odds_of_narrow(given: Conditioned, square: Array, right: Array) -> Array:
    """Return :func:`odds_by_size` (..., S) directly from G (..., q, q) and b (..., q)."""
    own, turn = small_eigh(square)
    return odds_by_size(given, own, (right[..., None, :] @ turn)[..., 0, :] ** 2)


def odds_of_wide(given: NoiseScale, square: Array, right: Array, gone: Array | float = 0.0
                 ) -> Array:
    """Return the same without eigenvectors; ``gone``: see :func:`odds_by_size`.

    In a basis that begins with b and in which G is tridiagonal, pivots computed from the end give
    the determinant; the last pivot alone gives b'(G + 1/s^2)^-1 b.
    """
    diagonal, beside, length = linalg.tridiagonal(square, right)
    grown = SIZES**2
    pivot = 1.0 + grown * diagonal[..., -1:]
    log_det = np.log(pivot)
    for i in reversed(range(beside.shape[-1])):
        pivot = np.maximum(1.0 + grown * (diagonal[..., i, None] - grown
                                          * beside[..., i, None] ** 2 / pivot), 1.0)
        log_det += np.log(pivot)
    rest = np.maximum(given.spread - gone - grown * length[..., None] ** 2 / pivot, LEAST)
    return np.asarray(-0.5 * log_det - 0.5 * given.freedom * np.log(rest / given.spread))


def small_eigh(square: Array) -> tuple[Array, Array]:
    """Return eigenvalues (..., q) and eigenvectors (..., q, q) of many small matrices at once."""
    if square.shape[-1] == 1:
        return square[..., 0], np.ones_like(square)
    return linalg.eigh(square)


@dataclass(frozen=True, eq=False)
class BatchOdds:
    """Odds for each block of a batch, without bounds on its coefficients.

    ``square``: G (B, G, q, q); ``right``: b (B, G, q); ``free``: log odds (B, G, S).
    """

    given: Conditioned
    batch: Batch
    square: Array
    right: Array
    free: Array

    @classmethod
    def of(cls, given: Conditioned, batch: Batch) -> BatchOdds:
        """Return the odds for the blocks of a batch, without bounds."""
        seen = given.seen[batch.columns][:, None]                          # (B, 1, k, r)
        inner = batch.gram[:, None] - seen @ np.swapaxes(seen, 2, 3)
        square = np.swapaxes(batch.roots, 2, 3) @ inner @ batch.roots
        right = (given.right[batch.columns][:, None, None] @ batch.roots)[..., 0, :]
        free = odds_of_wide if square.shape[-1] > WIDE else odds_of_narrow
        there = np.trace(square, axis1=2, axis2=3)[..., None] > 0.0
        return cls(given, batch, square, right, np.where(there, free(given, square, right), 0.0))

    @cached_property
    def most(self) -> Array:
        """Upper limit of the log odds (B,): reached if the posterior is within the bounds."""
        return total(self.free) - self.batch.usual

    def between(self, which: Ints) -> Array:
        """Return the log odds (b, G, S) of some blocks, with coefficients within their bounds."""
        batch, out = self.batch, self.free[which] - self.batch.usual[which, None, None]
        ends = batch.bounded[which]
        # blocks that are improbable even without bounds are evaluated approximately
        close = self.most[which] > 0.0
        for mine, closely in ((ends & close, True), (ends & ~close, False)):
            some = which[mine]
            if some.size:
                own, turn = small_eigh(self.square[some])
                part = (self.right[some][..., None, :] @ turn)[..., 0, :]
                out[mine] += within(self.given, batch.roots[some] @ turn, own, part,
                                    batch.low[some, None], batch.high[some, None], closely=closely)
        return np.asarray(out)


def total(log_odds: Array) -> Array:
    """Return the log odds of each block (B,), averaged over all roots and sizes (B, G, S)."""
    few = log_odds[0].size if len(log_odds) else 1
    return np.asarray(linalg.logsumexp(log_odds, axis=(1, 2)) - np.log(few))


def within(given: NoiseScale, lift: Array, own: Array, part: Array, low: Array, high: Array,
           gone: Array | float = 0.0, closely: bool = True) -> Array:
    """Return the log probability that coefficients are within their bounds.

    They follow Student's t, since the noise scale is integrated.

    Args:
        given: the noise scale given the conditioning.
        lift: R times the eigenvectors of G (..., G, k, q).
        own: eigenvalues of G (..., G, q).
        part: b along the eigenvectors (..., G, q).
        low: lower bound of each coefficient (..., 1, k).
        high: upper bound (..., 1, k).
        gone: part of y'My explained by blocks outside the conditioning.
        closely: compute the joint probability; otherwise the product of the marginals.

    Returns:
        (..., G, S).
    """
    has = bounded(low, high)
    lift, low, high = lift[..., has, :], low[..., None, has], high[..., None, has]
    own, part = np.maximum(own, 0.0)[..., None, :], part[..., None, :]
    grown = SIZES[:, None] ** 2
    known = grown / (1.0 + grown * own)                                 # (..., G, S, q)
    rest = np.maximum(given.spread - gone - np.sum(known * part**2, axis=-1), LEAST)
    mean = (known * part) @ np.swapaxes(lift, -1, -2)                   # (..., G, S, k)
    scale = (rest / given.freedom)[..., None]
    if has.size == 1 or not closely:
        square = known @ np.swapaxes(lift**2, -1, -2)
        return all_between(given.freedom, low - mean, high - mean, np.sqrt(scale * square))
    covariance = np.swapaxes(lift, -1, -2)[..., None, :, :]             # (..., G, 1, q, k)
    covariance = (lift[..., None, :, :] * known[..., None, :]) @ covariance * scale[..., None]
    return together_between(given.freedom, low - mean, high - mean, covariance)


def most_of_all(every: Sequence[BatchOdds], count: int) -> Array:
    """Return upper limits of the log odds (count,) of each block of several batches."""
    out = np.full(count, -np.inf)
    for one in every:
        out[one.batch.which] = one.most
    return out


def odds_of_some(every: Sequence[BatchOdds], asked: Bools) -> Array:
    """Return the log odds (B,) of the blocks of several batches ``asked`` for (B,), others -inf."""
    out = np.full(asked.size, -np.inf)
    for one in every:
        which = np.flatnonzero(asked[one.batch.which])
        if which.size:
            out[one.batch.which[which]] = total(one.between(which))
    return out
