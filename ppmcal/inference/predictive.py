"""What rows left out would be predicted to be: one function for poses, times, conditions, sessions.

With y ~ N(0, s^2 K), K = I + Z Z' and M = K^-1, rows g that are left out miss their prediction from
the others by e_g = (M_gg)^-1 (M y)_g, of covariance s^2 (M_gg)^-1: no fit is made again.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import gammaln

from ppmcal import linalg
from ppmcal.inference.given import Conditioned
from ppmcal.linalg import Array, Ints


@dataclass(frozen=True, eq=False)
class Predicted:
    """Groups of values, each predicted from all others.

    Attributes:
        error: by which each value misses its prediction, in units of the stated noise (n,).
        spread: its standard deviation by noise and by what the others leave open (n,).
        log_score: logarithm of the density at each group's values (G,), Student's.
    """

    error: Array
    spread: Array
    log_score: Array


def predicted(given: Conditioned, group: Ints) -> Predicted:
    """Return each group of values as predicted from the others.

    Args:
        given: with the blocks taken that predict.
        group: label of each value, 0 to G - 1 (n,); of a value that was not measured -1.

    Raises:
        LinearAlgebraError: if a group's values are known exactly from the others.
    """
    past = given.values - given.basis @ (given.basis.T @ given.values)
    error, spread = np.full(group.size, np.nan), np.full(group.size, np.nan)
    score = np.full(int(group.max(initial=-1)) + 1, np.nan)
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], np.arange(score.size + 1))
    for g, (begin, end) in enumerate(pairwise(starts)):
        at = order[begin:end]
        if at.size == 0:
            continue
        error[at], variance, half_log = _left_out(given.basis[at], past[at])
        square = float(past[at] @ error[at])
        freedom = given.freedom - at.size
        scale = max(given.spread - square, np.finfo(float).tiny) / freedom
        spread[at] = np.sqrt(scale * variance)
        score[g] = (gammaln(0.5 * (freedom + at.size)) - gammaln(0.5 * freedom)
                    - 0.5 * at.size * np.log(np.pi * freedom * scale) + half_log
                    - 0.5 * (freedom + at.size) * np.log1p(square / (freedom * scale)))
    return Predicted(error, spread, score)


def _left_out(own: Array, past: Array) -> tuple[Array, Array, float]:
    """Return errors (k,), the diagonal of (M_gg)^-1 (k,), and half the log determinant of M_gg.

    Of rows ``own`` (k, r) of the basis; ``past`` (k,) is M y there. The smaller of M_gg = I - W W'
    and I - W'W is factored: (M_gg)^-1 = I + W (I - W'W)^-1 W'.
    """
    k, r = own.shape
    what = "how well rows are predicted"
    if k <= r:
        factor = linalg.cholesky(np.eye(k) - own @ own.T, what)
        back = linalg.solve(factor, np.column_stack([past, np.eye(k)]))
        error, variance = back[:, 1:].T @ back[:, 0], np.sum(back[:, 1:] ** 2, axis=0)
    else:
        factor = linalg.cholesky(np.eye(r) - own.T @ own, what)
        back = linalg.solve(factor, own.T)
        error, variance = past + back.T @ (back @ past), 1.0 + np.sum(back**2, axis=0)
    return error, variance, float(np.sum(np.log(np.diagonal(factor))))
