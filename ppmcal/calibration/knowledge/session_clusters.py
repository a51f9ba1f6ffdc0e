"""The rows of a fit in clusters that may differ: sessions, or blocks of rows.

Their normal equations, and the directions in which their machines may differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import Fit, WhiteBlock, to_prior, white_blocks
from ppmcal.linalg import Array, Bools, eigh

RIDGE = 1e-6
"""Added information, in units of tolerance, so that unseen directions stay finite."""
FEW, OTHERS = 3, "others"
"""Classes of fewer parameters share one variance: two numbers do not determine their own."""


@dataclass(frozen=True, eq=False)
class Clusters:
    """Rows of a fit in S clusters, columns in natural units (C): normal equations of each.

    ``matrix`` (S, C, C), ``right`` (S, C), ``square`` and ``count`` (S,); ``prior`` (C,) weights
    and ``away`` (C,) from the estimate to nominal, both in natural units too.
    """

    labels: tuple[str, ...]
    matrix: Array
    right: Array
    square: Array
    count: Array
    prior: Array
    away: Array

    @classmethod
    def nothing(cls, fit: Fit, labels: Sequence[str]) -> Clusters:
        """Return clusters without any rows yet."""
        count, size = len(labels), fit.scale.size
        return cls(tuple(labels), np.zeros((count, size, size)), np.zeros((count, size)),
                   np.zeros(count), np.zeros(count), fit.prior * fit.scale,
                   to_prior(fit.problem, fit.state) / fit.scale)

    def add(self, cluster: int, rows: Array, values: float, sign: float = 1.0) -> None:
        """Add rows (n, m, C + 1), residual last, to a cluster; ``sign`` -1 removes them."""
        own = rows.reshape(-1, rows.shape[-1])
        square = sign * own.T @ own
        self.matrix[cluster] += square[:-1, :-1]
        self.right[cluster] += square[:-1, -1]
        self.square[cluster] += square[-1, -1]
        self.count[cluster] += sign * values

    def weighted(self, weight: Array | float) -> Clusters:
        """Return them with squares of rows multiplied by a weight, by cluster (S,) or common."""
        each = np.broadcast_to(weight, len(self.labels))
        return replace(self, matrix=self.matrix * each[:, None, None],
                       right=self.right * each[:, None], square=self.square * each)


@dataclass(frozen=True, eq=False)
class Components:
    """Directions (C, m) in which clusters may differ, and the index (m,) of each one's variance.

    If clusters have directions of their own these are (S, C, m).
    """

    directions: Array
    member: Array
    names: tuple[str, ...]


def unit_rows(fit: Fit) -> Iterator[tuple[int, WhiteBlock]]:
    """Yield the rows of a fit by data set, white by its noise, columns in natural units."""
    # the problem's rows are white by the stated noise
    unit = np.append(fit.scale, 1.0) / fit.noise
    given = fit.problem.shared_stands(fit.state, fit.keep)
    for i, keep in enumerate(fit.keep):
        for block in white_blocks(fit.problem, fit.state, i, keep, given=given):
            yield i, replace(block, rows=block.rows * unit)


def clusters(fit: Fit, labels: Sequence[str], masks: Sequence[Sequence[Bools]]) -> Clusters:
    """Return the rows of a fit by cluster.

    Args:
        fit: a finished one.
        labels: of the S clusters.
        masks: by cluster the rows (N,) of every data set.
    """
    out = Clusters.nothing(fit, labels)
    for i, block in unit_rows(fit):
        for s, mask in enumerate(masks):
            mine = mask[i][block.index]
            if mine.any():
                out.add(s, block.rows[mine], float(block.values[mine].sum()))
    return out


def by_gaps(data: Clusters) -> Components:
    """Return directions that each cluster sees equally: one variance, in units of its own noise.

    The residuals of joint values alone are gaps of limbs, smooth over the workspace: clusters
    differ as noisier rows would make them. Tolerances do not measure that: a block that
    hardly sees a direction would need far more of them there, and none elsewhere.
    """
    size, turn = eigh(data.matrix + np.diag(data.prior**2 + RIDGE))
    size = np.maximum(size, RIDGE)    # round-off, beside rows that are almost exact
    return Components(turn / np.sqrt(size)[:, None, :], np.zeros(size.shape[1], dtype=int),
                      ("gaps",))


def components(fit: Fit) -> Components:
    """Return one variance per class of parameters, and one for the common part of a class."""
    parameters = [fit.problem.mechanism.parameters[p] for p in fit.problem.free]
    value = np.array([fit.state.g[p] for p in fit.problem.free])
    classes = [p.tolerance_class or p.name.split(".")[0] for p in parameters]
    few = {k for k in classes if classes.count(k) < FEW}
    classes = [OTHERS if k in few else k for k in classes]
    size = fit.scale.size
    columns: list[Array] = []
    member: list[int] = []
    names: list[str] = []
    for name in dict.fromkeys(classes):
        own = [c for c, k in enumerate(classes) if k == name]
        columns += [np.eye(size)[c] for c in own]
        member += [len(names)] * len(own)
        names.append(name)
        # all parts grow in proportion to their size, drives that start at 0 by the same length
        lengths = [c for c in own if parameters[c].quantity == "length"]
        if name == OTHERS or len(lengths) <= FEW:
            continue
        growth = np.zeros(size)
        growth[lengths] = value[lengths] / fit.scale[lengths]
        if np.abs(growth).max() < 10.0:
            growth[lengths] = 1.0
        columns.append(growth / np.sqrt(np.mean(growth[lengths] ** 2)))
        member.append(len(names))
        names.append(f"{name}, common")
    return Components(np.array(columns).reshape(-1, size).T, np.array(member, dtype=int),
                      tuple(names))
