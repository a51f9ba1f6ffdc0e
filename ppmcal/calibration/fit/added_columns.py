"""The rows of a fit with further columns beside its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.linearisation import column_scale, to_prior
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.inference.priors import WIDE
from ppmcal.linalg import Array, Bools, reciprocals, subsample

MOST = 20000
"""At most this many rows are used, evenly spread."""

Group = Mapping[int, tuple[slice, Bools]]
"""Columns that act together: by data set, their slice in the wider problem and rows (N,)."""


@dataclass(frozen=True, eq=False)
class AddedColumns:
    """White rows, reduced: those of a fit with further columns.

    Attributes:
        rows: the fit's columns (k, C) in natural units.
        added: the further columns (k, T), SI, group after group.
        right: residuals (k,).
        count: number of values behind them.
        held: weight of each of the C columns' distance from nominal, natural units.
        away: from the linearisation point to the nominal, natural units (C,).
    """

    rows: Array
    added: Array
    right: Array
    count: int
    held: Array
    away: Array

    @property
    def values(self) -> Array:
        """Residuals (k,), taken back to the nominal machine."""
        return np.asarray(self.right - self.rows @ self.away)

    @property
    def geometry(self) -> Array:
        """The fit's columns times the roots of their priors (k, C)."""
        return self.rows * reciprocals(self.held, float(WIDE))


def added_columns(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
                  wide: Problem, groups: Sequence[Group]) -> AddedColumns:
    """Return the rows of a problem with additional columns of a wider one.

    Args:
        problem: of the fit.
        state: where rows are linearised.
        keep: rows that count (N,), by data set.
        prior: weight of each of its columns (C,), SI.
        wide: the problem with the same data and more open.
        groups: its columns to add.
    """
    width = [next(at.stop - at.start for at, _ in g.values()) for g in groups]
    scale, size = column_scale(problem), len(problem.columns)
    begin = (size + np.cumsum([0, *width])).tolist()
    stack = problem.earlier_rows(state, begin[-1] + 1)
    count = float(len(stack))
    some = subsample(keep, MOST)
    for part, more in zip(problem.rows(state, True, some), wide.rows(state, True, some),
                          strict=True):
        block = np.zeros((*part.residual.shape, stack.shape[1]))
        block[..., :size], block[..., -1] = part.jacobian, part.residual
        for own, first, last in zip(groups, begin, begin[1:], strict=False):
            block[..., first:last] = more.some_columns(own)
        stack = linalg.triangle(np.concatenate([stack, block.reshape(-1, stack.shape[1])]))
        count += part.count
    return AddedColumns(stack[:, :size] * scale, stack[:, size:-1], stack[:, -1], round(count),
                        prior * scale, to_prior(problem, state) / scale)
