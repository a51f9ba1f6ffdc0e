"""The linearised problem in which effects are searched for: rows as plain arrays, whitened.

N rows of m coordinates; a row that lacks a coordinate has zeros there. All arrays are whitened by
the stated noise; :class:`Whitening` adds the correlation from row to row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import (
    Companion,
    Problem,
    Response,
    State,
    column_scale,
    whitened,
)
from ppmcal.inference.correlation import RowNoise
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.effects import Setting, Shift
from ppmcal.model.sessions import pose_labels

MOST_ROWS = 1500
"""Effects are searched for in at most this many rows, evenly spread; fits use all rows."""
BLOCK, TOGETHER = 64, 2**20
"""Columns, and entries, processed at a time, to keep intermediate arrays small."""
RANK = 1e-9
"""Directions below this part of the strongest are round-off."""
INVISIBLE = 0.3
"""A direction in which one tolerance changes all residuals together by less than this many sigmas
cannot cause a noticeable error, nor may it mimic an effect."""


@dataclass(frozen=True, eq=False)
class SystemPart:
    """Rows ``at`` (slice of the system) of one data set: how they respond to shifts.

    ``companions``: other targets at the same stops, given which the rows are white. ``stood``: one
    label per pose (n,) if joint readings are measurements too, whatever measures the pose: an
    effect computed from each reading would follow their noise, which is in the residual.

    Distances between two platform positions have two parts, one per end.
    """

    at: slice
    dataset: int
    response: Response
    whitener: Array
    companions: tuple[Companion, ...] = ()
    stood: Ints | None = None

    @cached_property
    def setting(self) -> Setting:
        """The inputs of effects in these rows."""
        return self.response.setting(self.stood)

    @cached_property
    def of_joints(self) -> list[Shift]:
        """The shifts of one unit of each joint coordinate."""
        count = len(self.response.pose)
        return [Shift({(i, "offset"): np.ones(count) for i, limb in enumerate(self.setting.limbs)
                       if limb.actuator == a}) for a in range(self.setting.turning.size)]

    def column(self, shift: Shift) -> Array:
        """Return the whitened column (n, m) of a shift."""
        return self.whitened(lambda response: response.column(shift))

    def whitened(self, raw: Callable[[Response], Array]) -> Array:
        """Return the whitened values (n, m) that ``raw`` computes for the rows, m and rad.

        Conditional on those of other targets at the same stops, which move alike.
        """
        return whitened(self.whitener, self.response.seen.observed, raw(self.response),
                        ((c, raw(c.response)) for c in self.companions))


@dataclass(frozen=True, eq=False)
class System:
    """Rows of a fit: ``residual`` (N, m), ``jacobian`` (N, m, C) scaled, ``observed``.

    ``dataset``, ``row`` (N,): origin of each row; ``group`` (N,): its commanded pose.
    """

    problem: Problem
    state: State
    parts: tuple[SystemPart, ...]
    residual: Array
    jacobian: Array
    observed: Bools
    dataset: Ints
    row: Ints
    group: Ints

    @cached_property
    def apart(self) -> Ints:
        """Number of file rows from each row to the next (N-1,), 0 between files.

        Also 0 between rows of joint values alone that are read several times at each stop: their
        common error comes from the limbs' pull there, and is modelled as that.
        """
        number = np.array([self.problem.datasets[i].rows[n] for i, n in
                           zip(self.dataset, self.row, strict=True)], dtype=np.int64)
        same = self.dataset[1:] == self.dataset[:-1]
        if self.blind.any() and np.unique(self.group).size < self.group.size:
            same &= ~self.blind[1:]
        return np.where(same, np.maximum(np.diff(number), 1), 0)

    @cached_property
    def blind(self) -> Bools:
        """Which rows have joint values alone (N,)."""
        return np.array([d.kind.blind for d in self.problem.datasets])[self.dataset]

    @property
    def firsts(self) -> tuple[SystemPart, ...]:
        """One part per row: the first for distances between two platform positions."""
        return tuple(p for p in self.parts if p.response.end == 0)

    @property
    def count(self) -> int:
        """Number of measured values n."""
        return int(self.observed.sum())

    @cached_property
    def jacobian_scale(self) -> Array:
        """Scale factors of the columns of the Jacobian (C,)."""
        return column_scale(self.problem)

    @cached_property
    def stroke(self) -> float:
        """The longest travel of a joint in these rows, m or rad."""
        travel = np.concatenate([p.setting.travel for p in self.parts])
        return float(np.ptp(travel, axis=0).max())

    def column(self, shifts: Sequence[Shift]) -> Array:
        """Return the whitened column (N, m) of one shift per part."""
        out = np.zeros(self.residual.shape)
        for part, shift in zip(self.parts, shifts, strict=True):
            column = part.column(shift)
            out[part.at, :column.shape[1]] += column
        return out


def build(problem: Problem, state: State, keep: Sequence[Bools]) -> System:
    """Return the system of the rows ``keep`` (N,) of each data set at a state.

    Every row has full weight: rows misfitted without the causes are the evidence for them.
    """
    chunks = list(problem.weighted(None).rows(state, True, keep))
    width = max(c.residual.shape[1] for c in chunks)
    total = sum(c.residual.shape[0] for c in chunks)
    columns = len(problem.columns)
    residual, observed = np.zeros((total, width)), np.zeros((total, width), dtype=bool)
    jacobian = np.zeros((total, width, columns))
    dataset, row = np.zeros(total, dtype=np.int64), np.zeros(total, dtype=np.int64)
    parts, begin = [], 0
    for c in chunks:
        n, m = c.residual.shape
        at = slice(begin, begin + n)
        residual[at, :m], observed[at, :m] = c.residual, c.observed
        jacobian[at, :m] = c.jacobian
        dataset[at], row[at] = c.dataset, c.index
        parts += [SystemPart(at, c.dataset, end, c.whitener, c.companions)
                  for end in (c.response, c.second) if end]
        begin += n
    group = _groups(problem, dataset, row)
    if problem.mechanism.surplus:
        parts = [replace(part, stood=group[part.at]) for part in parts]
    return System(problem, state, tuple(parts), residual, jacobian * column_scale(problem),
                  observed, dataset, row, group)


def _groups(problem: Problem, dataset: Ints, row: Ints) -> Ints:
    """Return one label per commanded pose (N,), shared by files of one campaign."""
    label = np.zeros(dataset.size, dtype=np.int64)
    for i, own in enumerate(pose_labels(problem.datasets)):
        mine = dataset == i
        label[mine] = own[row[mine]]
    return np.asarray(np.unique(label, return_inverse=True)[1]).reshape(-1).astype(np.int64)


@dataclass(frozen=True)
class Whitening:
    """Whitening of residuals from row to row, by the correlation ``rho`` of AR(1).

    ``rho_error``: standard deviation of ``rho``.
    """

    rho: float = 0.0
    rho_error: float = 0.0

    def apply(self, values: Array, system: System) -> Array:
        """Return values (N, m, c) whitened, as a matrix (N m, c)."""
        flat = (values * system.observed[..., None]).reshape(system.observed.size, -1)
        return RowNoise(self.rho, system.apart, system.observed).apply(flat)


def range_basis(matrix: Array, least: float = 0.0) -> Array:
    """Return an orthonormal basis (n, rank) of a matrix's columns.

    Directions with a singular value below ``least`` are left out.
    """
    return linalg.range_basis(matrix, RANK, least)
