"""Sparse regression over all columns at once, its threshold chosen on poses held out.

Sequentially thresholded ridge regression (Brunton, Proctor, Kutz, PNAS 113 (2016)): columns of unit
length are fitted together, those with small coefficients struck out, and so on. A quarter of the
poses chooses the threshold, none of the columns among the choices. Readings that do not belong are
put aside before: no other pose tells of one.
"""

from __future__ import annotations

import numpy as np

from labelled.linear import Candidate, LinearProblem, gross_readings, span, without
from labelled.score import Name
from ppmcal.linalg import Array

SHARE = 0.25
RIDGE = 1e-3
THRESHOLDS = np.geomspace(0.02, 1.0, 18)
"""Parts of the largest coefficient of the first fit."""
ROUNDS = 10
BETTER = 0.95
"""A model's error on held-out poses has to fall below this part of none's."""


def names(problem: LinearProblem, seed: int) -> tuple[tuple[Name, ...], float]:
    """Return the candidates whose columns are left. It has no word for the unknown."""
    problem, gone = gross_readings(problem)
    columns = _single(problem)
    out = _held_out(problem, seed)
    if not columns or not out.any() or out.all():
        return gone, 0.0
    train, test = problem.take(~out), problem.take(out)
    if train.residual.size <= problem.basis.shape[1] + 2:
        return gone, 0.0
    best, kept = BETTER * _error(train, test, [], columns), list[int]()
    for part in THRESHOLDS[::-1]:
        some = sparse(train, [c.columns[0] for c in columns], part)
        error = _error(train, test, some, columns)
        if error < best:
            best, kept = error, some
    named = {(c.kind, c.on, c.slot): c.name() for c in (columns[k] for k in kept)}
    return (*gone, *named.values()), 0.0


def _single(problem: LinearProblem) -> list[Candidate]:
    """Return one candidate for each column, the first that has it."""
    out: dict[int, Candidate] = {}
    for c in problem.candidates:
        for at in c.columns:
            out.setdefault(at, Candidate(c.kind, (at,), c.on, c.slot, c.rows))
    return list(out.values())


def _held_out(problem: LinearProblem, seed: int) -> Array:
    """Return which values belong to poses that are held out (n,)."""
    groups = np.unique(problem.group)
    order = np.random.default_rng(seed).permutation(groups)
    return np.isin(problem.group, order[:max(1, round(SHARE * groups.size))])


def sparse(problem: LinearProblem, at: list[int], part: float) -> list[int]:
    """Return which of some columns survive, as places in ``at``."""
    basis = span(problem.geometry)
    matrix = without(problem.matrix[:, at], basis)
    residual = without(problem.residual, basis)
    length = np.linalg.norm(matrix, axis=0)
    kept = np.flatnonzero(length > 1e-6)
    first = _ridge(matrix[:, kept] / length[kept], residual)
    limit = part * float(np.abs(first).max()) if first.size else 0.0
    for _ in range(ROUNDS):
        size = _ridge(matrix[:, kept] / length[kept], residual)
        stay = np.abs(size) >= limit
        if stay.all() or not stay.any():
            kept = kept[stay]
            break
        kept = kept[stay]
    return [int(k) for k in kept]


def _ridge(matrix: Array, values: Array) -> Array:
    """Return ridge coefficients (k,), from the smaller of the two normal equations."""
    n, k = matrix.shape
    if k == 0:
        return np.zeros(0)
    if k <= n:
        return np.asarray(np.linalg.solve(matrix.T @ matrix + RIDGE * np.eye(k), matrix.T @ values))
    return np.asarray(matrix.T @ np.linalg.solve(matrix @ matrix.T + RIDGE * np.eye(n), values))


def _error(train: LinearProblem, test: LinearProblem, some: list[int],
           columns: list[Candidate]) -> float:
    """Return the sum of squares on held-out poses of a fit to the others, geometry with it."""
    at = [columns[k].columns[0] for k in some]
    left = np.concatenate([train.geometry, train.matrix[:, at]], axis=1)
    right = np.concatenate([test.geometry, test.matrix[:, at]], axis=1)
    scale = np.linalg.norm(left, axis=0)
    scale[scale == 0.0] = 1.0
    size = np.linalg.lstsq(left / scale, train.residual, rcond=1e-9)[0]
    miss = test.residual - right / scale @ size
    return float(miss @ miss)
