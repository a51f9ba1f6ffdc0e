"""Rows that do not belong: down-weighted on the way, named and left out at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from ppmcal.arrays import Array, Bools
from ppmcal.problem import Problem, State

HUBER = 1.5
"""Rows farther than this many standard deviations (root mean square) are down-weighted."""
REJECT = 0.05
"""A row is left out when its p-value times the number of rows is below this."""


@dataclass(frozen=True)
class Distances:
    """How far rows are from the fit, by data set.

    ``square``: squared white distance (N,), nan where there is no pose; ``size``: number of
    coordinates behind it (N,).
    """

    square: tuple[Array, ...]
    size: tuple[Array, ...]

    def factor(self, keep: Sequence[Bools]) -> float:
        """Return the robust scale of the residuals over the stated noise, at least 1."""
        return max(1.0, self.times(keep))

    def times(self, keep: Sequence[Bools]) -> float:
        """Return the median distance of the rows in use over that of noise, 0 without rows."""
        ratios = np.concatenate([
            (d[k & (m > 0)] / chdtri(m[k & (m > 0)], 0.5)) for d, m, k in
            zip(self.square, self.size, keep, strict=True)])
        ratios = ratios[np.isfinite(ratios)]
        return float(np.sqrt(np.median(ratios))) if ratios.size else 0.0

    def p_values(self, factor: float) -> list[Array]:
        """Return the chance of a larger distance, by data set (N,); 1 where unknown."""
        return [np.where(~np.isnan(d) & (m > 0), chdtrc(np.maximum(m, 1), np.nan_to_num(
            d, nan=0.0, posinf=np.inf) / factor**2), 1.0)
            for d, m in zip(self.square, self.size, strict=True)]


def distances(problem: Problem, state: State, covariance: Array | None = None,
              keep: Sequence[Bools] | None = None) -> Distances:
    """Return every row's distance; with ``covariance`` (C, C) freed of its own leverage.

    A used row pulled the fit towards itself: its residual has covariance I - J C J^T. A row
    that was left out is predicted: I + J C J^T.
    """
    square = [np.full(len(d), np.nan) for d in problem.datasets]
    size = [np.zeros(len(d)) for d in problem.datasets]
    for rows in problem.rows(state, covariance is not None):
        r = rows.residual
        if covariance is None:
            d2 = np.sum(r * r, axis=1)
        else:
            hat = rows.jacobian @ covariance @ np.swapaxes(rows.jacobian, -1, -2)
            used = np.ones(r.shape[0]) if keep is None else np.where(
                keep[rows.dataset][rows.index], 1.0, -1.0)
            spread = np.eye(r.shape[1]) - used[:, None, None] * hat
            singular = ~np.isfinite(spread).all(axis=(1, 2))
            spread[singular] = np.eye(r.shape[1])
            # a row that alone fixes a parameter has no residual to judge
            weak = np.linalg.eigvalsh(spread)[:, 0] < 1e-3
            spread[weak] = np.eye(r.shape[1])
            d2 = np.sum(r * np.linalg.solve(spread, r[..., None])[..., 0], axis=1)
            d2[singular] = np.inf
        square[rows.dataset][rows.index] = d2
        size[rows.dataset][rows.index] = rows.observed.sum(axis=1)
    return Distances(tuple(square), tuple(size))


def huber_weights(problem: Problem, state: State, keep: Sequence[Bools]) -> list[Array]:
    """Return the factor on each row's residual, by data set (N,)."""
    found = distances(problem, state)
    factor = found.factor(keep)
    out = []
    for d, m in zip(found.square, found.size, strict=True):
        with np.errstate(invalid="ignore", divide="ignore"):
            away = np.sqrt(d / (factor**2 * np.maximum(m, 1.0)))
            weight = np.minimum(1.0, HUBER / away)
        out.append(np.sqrt(np.where(np.isfinite(weight), weight, 1.0)))
    return out


def worst(found: Distances, keep: Sequence[Bools], factor: float) -> list[tuple[int, int, float]]:
    """Return the used rows that do not belong, worst first: (data set, row, p)."""
    total = sum(int(k.sum()) for k in keep)
    bad = [(i, int(n), float(p[n])) for i, (p, k) in
           enumerate(zip(found.p_values(factor), keep, strict=True))
           for n in np.flatnonzero(k & (p * total < REJECT))]
    return sorted(bad, key=lambda b: (b[2], -found.square[b[0]][b[1]]))
