"""Predictions of left-out rows: one function for poses, times, conditions, sessions.

With y ~ N(0, s^2 K), K = I + Z Z' and M = K^-1, the prediction error of left-out rows g from the
others is e_g = (M_gg)^-1 (M y)_g, of covariance s^2 (M_gg)^-1: no refit is needed.
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
"""Variance of a prediction over that of the noise, beyond which it counts as no prediction."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """Groups of values, each predicted from all others.

    Attributes:
        error: prediction error of each value, in units of the stated noise (n,).
        spread: its standard deviation from noise and from the uncertainty of the others (n,).
        log_score: log predictive density (Student's t) of each group's values (G,).
        missed: the error in the directions of a group that the others predict: a frame that only
            the group determines is fitted to its own values (n,).
        directions: number of these directions (G,).
    """

    error: Array
    spread: Array
    log_score: Array
    missed: Array
    directions: Ints


def predicted(given: Conditioned, group: Ints) -> Predicted:
    """Return each group of values as predicted from the others.

    Args:
        given: the data conditioned on the predicting blocks.
        group: label of each value, 0 to G - 1 (n,); -1 for a value not measured.

    Raises:
        LinearAlgebraError: a group's values are determined exactly by the others.
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
    """Return errors (k,), those in predicted directions (k,), and variances (k,).

    Also half the log determinant of M_gg = I - W W', and the number of predicted directions, for
    rows W = ``own`` (k, r) of the basis; ``past`` (k,) is M y there. The smaller of M_gg and
    I - W'W is decomposed: (M_gg)^-1 = I + W (I - W'W)^-1 W'.
    """
    k, r = own.shape
    told, turn = linalg.eigh(np.eye(min(k, r)) - (own @ own.T if k <= r else own.T @ own))
    if told.size and told[0] <= 0.0:
        raise LinearAlgebraError("predictions of left-out rows could not be computed: the other "
                                 "rows determine them exactly", hint=linalg.TOO_FEW)
    part = turn * np.sqrt(np.maximum(1.0 - told, 0.0)) if k <= r else own @ turn
    error = past + part @ ((part.T @ past) / told)
    lost = told * UNPREDICTED <= 1.0
    open_ = part[:, lost] / np.sqrt(1.0 - told[lost])
    return (error, error - open_ @ (open_.T @ error), 1.0 + np.sum(part**2 / told, axis=1),
            0.5 * float(np.sum(np.log(told))), k - int(lost.sum()))


@dataclass(frozen=True, eq=False)
class LeftOutGroups:
    """Groups of values as predicted from all others by several models, averaged by probability.

    Attributes:
        log_score: log predictive density of each group's values (G,).
        square: sum of squared errors of each group in predicted directions, in units of the stated
            noise (G,).
        count: number of predicted directions (G,).
    """

    log_score: Array
    square: Array
    count: Ints


def averaged(models: Sequence[tuple[float, Conditioned]], group: Ints) -> LeftOutGroups:
    """Return the averaged predictions of models, weighted by their probability given other groups.

    A model's score for a group is the contribution of that group to its probability:
    p(y_g | rest) = p(y) / p(rest), with p(rest) = sum of p_h / exp(score_h).

    Args:
        models: log p of each, up to a common constant, and the data conditioned on its blocks.
        group: see :func:`predicted`.

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
