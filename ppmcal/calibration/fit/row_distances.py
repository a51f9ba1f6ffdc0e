"""Distances of rows from a fit, and the weights that follow from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ppmcal import linalg
from ppmcal.calibration.fit.linearisation import parameter_scale, prior_weights
from ppmcal.calibration.fit.normal_equations import row_squares, white_blocks
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.inference.priors import NO_WEIGHT, NOISE_FREEDOM
from ppmcal.inference.row_weights import row_weights
from ppmcal.linalg import Array, Bools, finite_rows, reciprocals

HUBER = 1.5
"""During the search rows farther than this many standard deviations (rms) get less weight."""
ALONE = 1e-3
"""A row that keeps less than this part of its own error determines something alone."""


@dataclass(frozen=True)
class Distances:
    """Distances of rows from the fit, by data set.

    ``square``: squared white distance (N,), nan without a pose; ``size``: number of
    coordinates behind it (N,); ``estimated``: whether the file asks for its noise to be estimated.
    """

    square: tuple[Array, ...]
    size: tuple[Array, ...]
    estimated: tuple[bool, ...]

    def factor(self, keep: Sequence[Bools]) -> Array:
        """Return the robust scale of the residuals over the stated noise (D,), at least 1.

        That of all rows; for a data set whose noise is not stated its own if smaller, because
        other data sets do not justify it there. A data set without rows in use has none of its own.
        """
        own = [(alone and _times([d], [m], [k])) or np.inf for d, m, k, alone in
               zip(self.square, self.size, keep, self.estimated, strict=True)]
        return np.maximum(1.0, np.minimum(own, self.times(keep)))

    def times(self, keep: Sequence[Bools]) -> float:
        """Return the median distance of the rows in use relative to noise, 0 without rows."""
        return _times(self.square, self.size, keep)

    def over_noise(self, factor: Array) -> list[Array]:
        """Return the distance of rows in units of noise, ``factor`` (D,) times the stated one.

        Rms over a row's values (N,), by data set.
        """
        return [np.sqrt(d / np.maximum(m, 1.0)) / f
                for d, m, f in zip(self.square, self.size, factor, strict=True)]

    def weights(self, keep: Sequence[Bools], factor: Array) -> list[Array]:
        """Return the weight of each row (N,) by data set, 1 if its distance is unknown.

        Args:
            keep: rows that belong so far (N,).
            factor: noise over the stated noise (D,).
        """
        known = [np.isfinite(d) & (m > 0) for d, m in zip(self.square, self.size, strict=True)]
        size = np.concatenate([m[k] for m, k in zip(self.size, known, strict=True)])
        square = np.concatenate([d[k] / f**2 for d, k, f in
                                 zip(self.square, known, factor, strict=True)])
        found = row_weights(square, size, *self._known(keep))
        out = [np.where(np.isinf(d), 0.0, 1.0) for d in self.square]
        ends = np.cumsum([int(k.sum()) for k in known])[:-1]
        for own, k, w in zip(out, known, np.split(found, ends), strict=True):
            own[k] = w
        return out

    def held_back(self, keep: Sequence[Bools], factor: Array) -> list[Array]:
        """Return the weight (N,) that brings each row no farther off than rows that may belong.

        Arguments as for :meth:`weights`. Closer rows have weight 1 and keep their residuals.
        """
        freedom, belong = self._known(keep)
        far = np.geomspace(1.0, 1e3, 400)
        limit = {m: float(np.interp(-float(NO_WEIGHT), -row_weights(
            far, np.full(far.size, m), freedom, belong), far))
            for own in self.size for m in np.unique(own[own > 0]).tolist()}
        return [np.minimum(1.0, np.array([limit.get(m, np.inf) for m in own.tolist()])
                           * reciprocals(np.nan_to_num(d), np.inf) * f**2)
                for d, own, f in zip(self.square, self.size, factor, strict=True)]

    def _known(self, keep: Sequence[Bools]) -> tuple[float, int]:
        """Return degrees of freedom of the noise estimate, and the number of rows that belong."""
        return float(NOISE_FREEDOM) + sum(float(m[k].sum()) for m, k in zip(
            self.size, keep, strict=True)), sum(int(k.sum()) for k in keep)


def _times(square: Sequence[Array], size: Sequence[Array], keep: Sequence[Bools]) -> float:
    ratios = np.concatenate([d[k & (m > 0)] / chdtri(m[k & (m > 0)], 0.5) for d, m, k in
                             zip(square, size, keep, strict=True)])
    ratios = ratios[np.isfinite(ratios)]
    return float(np.sqrt(np.median(ratios))) if ratios.size else 0.0


def distances(problem: Problem, state: State, covariance: Array | None = None,
              keep: Sequence[Bools] | None = None) -> Distances:
    """Return every row's distance; with ``covariance`` (C, C) corrected for its own leverage.

    A row in use pulled the fit towards itself: its residual has covariance I - J C J^T. A row
    that was left out is predicted: I + J C J^T. For partial weights see :func:`_freed`.
    Distances are those of whole rows, whatever their weights.
    """
    square = [np.full(len(d), np.nan) for d in problem.datasets]
    size = [np.zeros(len(d)) for d in problem.datasets]
    for i, pose in enumerate(state.poses):
        solved = finite_rows(pose)
        if covariance is not None and covariance.size:
            for block in white_blocks(problem, state, i, solved):
                weight = problem.weights[i][block.index]
                used = weight if keep is None else np.where(keep[i][block.index], weight, 0.0)
                square[i][block.index] = _freed(block.rows / np.sqrt(weight)[:, None, None],
                                                covariance, used)
                size[i][block.index] = block.values
            continue
        rows = np.flatnonzero(solved)
        square[i][rows] = row_squares(problem, state, i, solved) / problem.weights[i][rows]
        size[i][rows] = problem.counts(i, rows)
    return Distances(tuple(square), tuple(size), tuple(d.estimated for d in problem.datasets))


def _freed(rows: Array, covariance: Array, used: Array) -> Array:
    """Return squared distances (n,) of white rows (n, m, C + 1), residual last, without leverage.

    With H = J C J^T a row of weight w differs from the prediction of the others by (I - w H)^-1 r,
    of covariance I + H (I - w H)^-1: its distance is r^T (I - w H)^-1 (I + (1 - w) H)^-1 r.

    Args:
        rows: Jacobian and residual.
        covariance: of the columns (C, C).
        used: weights of rows in the fit, 0 if not used (n,).
    """
    jacobian, r = rows[..., :-1], rows[..., -1]
    spread = (jacobian.reshape(-1, len(covariance)) @ covariance).reshape(jacobian.shape)
    hat = spread @ np.swapaxes(jacobian, -1, -2)
    one, used = np.eye(r.shape[1]), used[:, None, None]
    of_residual = (one - used * hat) @ (one + (1.0 - used) * hat)
    singular = ~np.isfinite(of_residual).all(axis=(1, 2))
    of_residual[singular] = one
    # a row that alone fixes a parameter has no residual to judge; its leverage is never small
    heavy = np.flatnonzero((used[:, 0, 0] > 0.0) & ~singular
                           & (np.trace(hat, axis1=1, axis2=2) > 1.0 - ALONE))
    weak = heavy[linalg.eigvalsh(of_residual[heavy])[:, 0] < ALONE]
    of_residual[weak] = one
    squares = np.sum(r * linalg.solve(of_residual, r[..., None])[..., 0], axis=1)
    # round-off of an ill-conditioned covariance: take the residual as it is
    squares = np.where(squares < 0.0, np.sum(r * r, axis=1), squares)
    squares[singular] = np.inf
    return np.asarray(squares)


def beyond_weight(found: Distances, keep: Sequence[Bools]) -> list[Bools]:
    """Return which of the rows ``keep`` (N,) have hardly any weight, by data set."""
    return [k & (w < float(NO_WEIGHT)) for k, w in
            zip(keep, found.weights(keep, found.factor(keep)), strict=True)]


def huber_weights(problem: Problem, state: State, keep: Sequence[Bools]) -> list[Array]:
    """Return the factor on each row's residual during the search, by data set (N,).

    Huber's: with the weights of rows that may not belong, which fall with the square of their
    distance, a search that starts far off may end anywhere.
    """
    found = distances(problem, state)
    away = found.over_noise(found.factor(keep))
    return [np.sqrt(np.minimum(1.0, HUBER * reciprocals(np.nan_to_num(a), np.inf))) for a in away]


def explained_distances(problem: Problem, state: State) -> Distances:
    """Return every row's distance from the machine, less what the tolerances explain."""
    problem = toleranced(problem)
    weight = prior_weights(problem, "prior")
    # frames and targets stay; files state how far their scales may be off
    scale = reciprocals(weight)
    scale[:len(problem.free)] = parameter_scale(problem)
    nobody = [np.zeros(len(d), dtype=bool) for d in problem.datasets]
    return distances(problem, state, np.diag(scale**2), nobody)


def toleranced(problem: Problem, fixed: bool = False) -> Problem:
    """Return the problem with every parameter free that has a tolerance: all that may be off.

    ``fixed``: including those held by the file. Which parameters a fit may change is the user's
    choice, and says nothing about which are off.
    """
    own = {i for i, p in enumerate(problem.mechanism.parameters)
           if p.prior_sigma and (fixed or not p.fixed)}
    return replace(problem, free=tuple(sorted(own | set(problem.free))))
