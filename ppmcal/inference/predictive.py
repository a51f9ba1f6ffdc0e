"""What rows left out would be predicted to be: one function for poses, times, conditions, sessions.

With y ~ N(0, s^2 K), K = I + Z Z' and M = K^-1, rows g that are left out miss their prediction from
the others by e_g = (M_gg)^-1 (M y)_g, of covariance s^2 (M_gg)^-1: no fit is made again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import gammaln

from ppmcal import linalg
from ppmcal.errors import LinearAlgebraError
from ppmcal.inference.given import Conditioned
from ppmcal.linalg import Array, Ints

UNPREDICTED = 100.0
"""Variance of a prediction over that of the noise, beyond which it is none."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """Groups of values, each predicted from all others.

    Attributes:
        error: by which each value misses its prediction, in units of the stated noise (n,).
        spread: its standard deviation by noise and by what the others leave open (n,).
        log_score: logarithm of the density at each group's values (G,), Student's.
        missed: the error in those directions of a group in which the others predict it at all: a
            frame that nothing else tells of is fitted to the group's own values (n,).
        directions: how many these are (G,).
    """

    error: Array
    spread: Array
    log_score: Array
    missed: Array
    directions: Ints


def predicted(given: Conditioned, group: Ints) -> Predicted:
    """Return each group of values as predicted from the others.

    Args:
        given: with the blocks taken that predict.
        group: label of each value, 0 to G - 1 (n,); of a value that was not measured -1.

    Raises:
        LinearAlgebraError: if a group's values are known exactly from the others.
    """
    past = given.values - given.basis @ (given.basis.T @ given.values)
    error, spread, missed = (np.full(group.size, np.nan) for _ in range(3))
    score = np.full(int(group.max(initial=-1)) + 1, np.nan)
    directions = np.zeros(score.size, dtype=np.int64)
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], np.arange(score.size + 1))
    for g, (begin, end) in enumerate(pairwise(starts)):
        at = order[begin:end]
        if at.size == 0:
            continue
        error[at], missed[at], variance, half_log, directions[g] = _left_out(given.basis[at],
                                                                            past[at])
        square = float(past[at] @ error[at])
        freedom = given.freedom - at.size
        scale = max(given.spread - square, np.finfo(float).tiny) / freedom
        spread[at] = np.sqrt(scale * variance)
        score[g] = (gammaln(0.5 * (freedom + at.size)) - gammaln(0.5 * freedom)
                    - 0.5 * at.size * np.log(np.pi * freedom * scale) + half_log
                    - 0.5 * (freedom + at.size) * np.log1p(square / (freedom * scale)))
    return Predicted(error, spread, score, missed, directions)


def _left_out(own: Array, past: Array) -> tuple[Array, Array, Array, float, int]:
    """Return errors (k,), those in directions that are predicted at all (k,), variances (k,).

    And half the log determinant of M_gg = I - W W', and how many such directions there are, of rows
    W = ``own`` (k, r) of the basis; ``past`` (k,) is M y there. The smaller of M_gg and I - W'W is
    decomposed: (M_gg)^-1 = I + W (I - W'W)^-1 W'.
    """
    k, r = own.shape
    told, turn = linalg.eigh(np.eye(min(k, r)) - (own @ own.T if k <= r else own.T @ own))
    if told.size and told[0] <= 0.0:
        raise LinearAlgebraError("how well rows are predicted could not be had: the others say "
                                 "exactly what they are", hint=linalg.TOO_FEW)
    part = turn * np.sqrt(np.maximum(1.0 - told, 0.0)) if k <= r else own @ turn
    error = past + part @ ((part.T @ past) / told)
    lost = told * UNPREDICTED <= 1.0
    open_ = part[:, lost] / np.sqrt(1.0 - told[lost])
    return (error, error - open_ @ (open_.T @ error), 1.0 + np.sum(part**2 / told, axis=1),
            0.5 * float(np.sum(np.log(told))), k - int(lost.sum()))


@dataclass(frozen=True, eq=False)
class LeftOutGroups:
    """Groups of values as several models, each by its probability, predict them from all others.

    Attributes:
        log_score: logarithm of the density at each group's values (G,).
        square: sum of squared errors of each group, in units of the stated noise, as far as it is
            predicted at all (G,).
        count: in how many directions that is (G,).
    """

    log_score: Array
    square: Array
    count: Ints


def averaged(models: Sequence[tuple[float, Conditioned]], group: Ints) -> LeftOutGroups:
    """Return what models predict together, each as probable as the other groups make it.

    What the values of a group add to a model's probability is its score there: p(y_g | rest) =
    p(y) / p(rest), with p(rest) = sum of p_h / exp(score_h).

    Args:
        models: log p of each, up to what they have in common, and the data past what it has.
        group: as of :func:`predicted`.

    Raises:
        LinearAlgebraError: as :func:`predicted`.
    """
    log_p = np.array([p for p, _ in models])
    each = [predicted(given, group) for _, given in models]
    without = log_p[:, None] - np.stack([e.log_score for e in each])
    rest = linalg.logsumexp(without, axis=0)
    known = group >= 0
    weight = np.exp(without - rest)[:, group[known]]
    error = np.sum(weight * np.stack([e.missed[known] for e in each]), axis=0)
    return LeftOutGroups(linalg.logsumexp(log_p) - rest,
                         np.bincount(group[known], error**2, rest.size).astype(float),
                         each[int(np.argmax(log_p))].directions)
