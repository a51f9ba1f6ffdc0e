"""The small linear problem of one iteration: rows as one triangle or as sums, and its step.

Columns are judged in natural units (:func:`column_scale`), so that metres and radians,
geometry and frames can be weighed against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.normal_equations import NormalSums, white_blocks
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.errors import LinearAlgebraError
from ppmcal.linalg import Array, Bools, svd
from ppmcal.model.mechanism import Mechanism

SOLVE_TOLERANCE = 1e-13
"""Directions below this part of the strongest are round-off: neither data nor prior see them."""


def seen_directions(singular: Array) -> Bools:
    """Return which of the singular values (r,) exceed the round-off of the strongest."""
    return np.asarray(singular > SOLVE_TOLERANCE * singular.max(initial=1e-300), dtype=np.bool_)


ROWS = 1536
"""Rows of the matrix reduced at a time."""


@dataclass(frozen=True)
class SquareRootInformation:
    """All rows as one triangle: ``root`` (C, C), ``right`` (C,), and the sum of squares.

    The least-squares problem of the rows is |root s - right|^2 + (square - |right|^2).
    ``count``: number of values, weighted by row.
    """

    root: Array
    right: Array
    square: float
    count: float


def prior_weights(problem: Problem, method: str, factor: float = 1.0) -> Array:
    """Return 1/sigma of each column's prior (C,), SI, 0 where there is none.

    The tolerances of parameters, times ``factor``; and the uncertainties that files state of
    their own scales, which count like measurements under every method but the damped one, which
    has no prior at all.
    """
    weights = np.zeros(len(problem.columns))
    if method == "damped":
        return weights
    for c, p in enumerate(problem.free):
        tau = problem.mechanism.parameters[p].prior_sigma
        weights[c] = 1.0 / (factor * tau) if tau and method != "flat" else 0.0
    for data, opened in zip(problem.datasets, problem.opens, strict=True):
        if data.scale.sigma is not None:
            weights[opened.scale] = 1.0 / data.scale.sigma
    return weights


def parameter_scale(problem: Problem) -> Array:
    """Return the natural unit of each free parameter (F,), SI."""
    return natural_units(problem.mechanism, problem.free)


def natural_units(mechanism: Mechanism, places: Sequence[int]) -> Array:
    """Return the natural unit of some parameters (F,): the tolerance, SI.

    Without a finite tolerance: a thousandth of the reach, or 1e-3 rad.
    """
    out = np.empty(len(places))
    for c, p in enumerate(places):
        parameter = mechanism.parameters[p]
        natural = parameter.size or 1e-3 * (
            mechanism.reach if parameter.quantity == "length" else 1.0)
        out[c] = parameter.prior_sigma or natural
    return out


def qr_factor(problem: Problem, state: State, keep: Sequence[Bools],
                weights: Sequence[Array] | None = None) -> SquareRootInformation:
    """Accumulate all rows into one triangle by QR, chunk by chunk.

    Args:
        problem: the machine and its C columns.
        state: where rows are linearised.
        keep: rows to use (N,), for each data set.
        weights: factor on each white row (N,), for each data set  [default: 1].
    """
    size = len(problem.columns) + 1
    stack, earlier = np.zeros((0, size)), problem.earlier_rows(state, size)
    count: float = len(earlier)
    given = problem.shared_stands(state, keep)
    for i in range(len(problem.datasets)):
        for part in white_blocks(problem, state, i, keep[i],
                                 None if weights is None else weights[i], given):
            flat = part.rows.reshape(-1, size)
            # in pieces that stay in the cache, which halves the time
            for begin in range(0, len(flat), ROWS):
                piece = np.concatenate([stack, flat[begin:begin + ROWS]])
                stack = linalg.triangle(piece)
            count += problem.values(i, part.index, part.values)
    if len(earlier):
        stack = linalg.triangle(np.concatenate([stack, earlier]))
    full = np.zeros((size, size))
    full[:min(size, stack.shape[0])] = stack[:size]
    right = full[:-1, -1]
    return SquareRootInformation(full[:-1, :-1], right, float(np.sum(full[:, -1] ** 2)), count)


def column_scale(problem: Problem) -> Array:
    """Return one natural unit per column (C,): tolerances; a thousandth of the reach, 1e-3 rad.

    Frames and geometry need comparable units: otherwise, in a direction that moves both, the
    frame's larger numbers would drown the prior.
    """
    return np.concatenate([parameter_scale(problem), problem.open_scale()])


@dataclass(frozen=True)
class NormalStep:
    """One iteration's linear problem, diagonalised: minimise |s x - b|^2 along each direction.

    ``singular`` (r,), ``right`` (r,), ``directions`` (r, C) in natural units ``scale`` (C,).
    """

    singular: Array
    right: Array
    directions: Array
    scale: Array

    def seen(self) -> tuple[int, Array]:
        """Return the number of directions seen, and the variance of each column by them (C,)."""
        use = seen_directions(self.singular)
        parts = self.directions[use] / self.singular[use, None]
        return int(use.sum()), np.asarray(np.sum(parts**2, axis=0) * self.scale**2)

    def step(self, damping: float = 0.0) -> tuple[Array, float]:
        """Return the step (C,) and the predicted decrease of chi-squared.

        ``damping`` is relative to the square of the strongest direction, in natural units
        (Levenberg). Directions seen by neither data nor prior stay where they are.
        """
        s = self.singular
        use = seen_directions(s)
        power = s**2 + damping * s.max(initial=1e-300)**2
        part = np.where(use, s**2 / np.where(use, power, 1.0), 0.0)
        x = self.directions.T @ np.where(use, part * self.right / np.where(use, s, 1.0), 0.0)
        decrease = float(np.sum(self.right**2 * (1.0 - (1.0 - part) ** 2)))
        return x * self.scale, decrease


@dataclass(frozen=True, eq=False)
class SummedStep:
    """The same from normal equations of data and prior, in natural units.

    ``matrix`` (C, C) s = ``gradient`` (C,), in units ``scale`` (C,).
    """

    matrix: Array
    gradient: Array
    scale: Array

    @cached_property
    def _strongest(self) -> float:
        return float(linalg.largest_singular(self.matrix))

    def _inverse_root(self, matrix: Array) -> Array | None:
        """Return X (C, C) with X^T X = matrix^-1 by Cholesky of unit columns; None if singular."""
        size = np.sqrt(np.diagonal(matrix))
        if not np.all(size > 0.0):
            return None
        try:
            root = linalg.cholesky(matrix / (size[:, None] * size))
        except LinearAlgebraError:
            return None
        return np.asarray(linalg.inv(root) / size)

    @cached_property
    def _plain(self) -> Array | None:
        return self._inverse_root(self.matrix)

    @cached_property
    def condition(self) -> float:
        """1-norm condition number for unit columns, from the factor; inf where there is none."""
        if self._plain is None:
            return float("inf")
        if not self.matrix.size:    # NumPy 1 has no norm of an empty matrix
            return 1.0
        size = np.sqrt(np.diagonal(self.matrix))
        back = self._plain * size
        return float(np.linalg.norm(back.T @ back, 1)
                     * np.linalg.norm(self.matrix / (size[:, None] * size), 1))

    def seen(self) -> tuple[int, Array]:
        """Return the number of directions seen, and the variance of each column (C,)."""
        root = np.zeros((0, len(self.scale))) if self._plain is None else self._plain
        return len(root), np.asarray(np.sum(root**2, axis=0) * self.scale**2)

    def step(self, damping: float = 0.0) -> tuple[Array, float]:
        """Return the step (C,) and its predicted decrease; see :meth:`NormalStep.step`."""
        root = self._plain
        if damping > 0.0:
            extra = damping * self._strongest * np.eye(len(self.scale))
            root = self._inverse_root(self.matrix + extra)
        if root is None:
            return np.zeros_like(self.scale), 0.0
        x = root.T @ (root @ self.gradient)
        return x * self.scale, float(x @ (2.0 * self.gradient - self.matrix @ x))


def summed_step(problem: Problem, state: State, sums: NormalSums, prior: Array) -> SummedStep:
    """Return the linear problem of data and prior from sums; arguments as :func:`normal_step`."""
    scale = column_scale(problem)
    matrix = sums.matrix * (scale[:, None] * scale)
    matrix[np.diag_indices_from(matrix)] += (prior * scale) ** 2
    gradient = scale * (sums.gradient + prior**2 * to_prior(problem, state))
    return SummedStep(matrix, gradient, scale)


def to_prior(problem: Problem, state: State) -> Array:
    """Return the step of each column to the mean of its prior (C,), SI, 0 where it has none.

    For parameters to their nominals, for scales to the values in their files.
    """
    free = list(problem.free)
    away = np.zeros(len(problem.columns))
    away[:len(free)] = problem.mechanism.nominals[free] - state.g[free]
    for data, opened, at in zip(problem.datasets, problem.opens, state.registrations, strict=True):
        if data.scale.sigma is not None:
            away[opened.scale] = float(data.scale.value[0]) - at.scale
    return away


def normal_step(problem: Problem, state: State, information: SquareRootInformation,
                prior: Array) -> NormalStep:
    """Return the linear problem of data and prior at a state.

    Args:
        problem: the machine and its C columns.
        state: where the rows were linearised.
        information: all rows as one triangle.
        prior: weight of each column's distance from its prior mean (C,), 1/sigma, SI.
    """
    scale = column_scale(problem)
    matrix = np.concatenate([information.root * scale, np.diag(prior * scale)])
    u, s, vt = svd(matrix)
    right = u.T @ np.concatenate([information.right, prior * to_prior(problem, state)])
    return NormalStep(s, right, vt, scale)
