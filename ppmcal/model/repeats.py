"""Which rows are repeats: of one commanded pose, and of one environment as well.

A label says which rows are meant to be of one pose; the joints show which are. Rows of one pose
also differ by direction of approach, load and temperature, which is not noise: only rows of one
pose *and* one environment show the noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Dataset

RESOLVED, TOUCHED = 1e-3, 1e-2
"""Joints of one pose agree within this part of their range over the file; the second value is for
touches of a flat, whose noise is in the joints."""
DIGITS = 1e-5
"""Joints that hardly move in the whole file agree within this part of their largest value."""
NOISES = 6.0
"""Joints of one pose agree within this multiple of the stated noise of the drives."""
SAME, SAME_TEMPERATURE = 0.02, 0.05
"""Repeats may differ in speed and load by this part of the largest, in temperature by this (K)."""
NO_INFLUENCE = ("time",)
"""Columns in which repeats and copies may differ."""


def commanded_poses(labels: Ints, q: Array, others: Sequence[Array | None], noise: Array,
                    touched: bool) -> Ints:
    """Return a label per commanded pose (N,), numbered in order of appearance.

    Rows of one label whose joints differ by more than the controller's resolution are of different
    poses. Rows whose joints agree in every digit are of one pose, whatever their labels.

    Args:
        labels: from the file, numbered in order of appearance (N,).
        q: joint values (N, k).
        others: further commands, second joints or a commanded pose (N, m), or None.
        noise: standard deviation of the joints (k,), unit of q.
        touched: the rows are touches of a flat: joints were measured, so equal ones do not make
            one pose.
    """
    told = np.concatenate([q, *(o for o in others if o is not None)], axis=1)
    out = labels
    if np.unique(labels).size < labels.size:
        for column, step in zip(told.T, _steps(told, noise, touched), strict=True):
            out = _split(out, column, step)
    if not touched:
        out = _merged(out, identical_rows(told))
    return out if np.array_equal(out, labels) else _in_order(out)


def places(q: Array, noise: Array, surplus: int) -> Ints:
    """Return a label per stop (N,) of rows that have only joint values (N, k).

    Consecutive rows whose joints agree within their repeatability were read at one stop. With two
    or more ``surplus`` equations, so were rows in which a single joint differs: the others hold
    the platform and remain redundant. That joint was misread.
    """
    if len(q) < 2:
        return np.arange(len(q))
    moved = np.sum(np.abs(np.diff(q, axis=0)) > _steps(q, noise, False), axis=1)
    return np.concatenate([[0], np.cumsum(moved > (1 if surplus > 1 else 0))])


def with_misread(groups: Ints, labels: Ints, q: Array, noise: Array) -> Ints:
    """Return labels of stops (N,) in which rows that differ in one joint rejoin their stop.

    If only joint values are measured, a typing error in one of them does not make another stop.

    Args:
        groups: labels from :func:`commanded_poses` (N,).
        labels: which rows are of one stop, joints aside (N,).
        q: joint values (N, k).
        noise: standard deviation of the joints (k,), unit of q.
    """
    out, steps = groups.copy(), np.array(_steps(q, noise, False))
    known, first, of = np.unique(groups, return_index=True, return_inverse=True)
    several = np.unique(labels[first], return_counts=True)
    for label in several[0][several[1] > 1].tolist():
        rows = np.flatnonzero(labels == label)
        own, count = np.unique(of[rows], return_counts=True)
        main = known[own[np.argmax(count)]]
        middle = np.median(q[rows[groups[rows] == main]], axis=0)
        out[rows[np.sum(np.abs(q[rows] - middle) > steps, axis=1) <= 1]] = main
    return groups if np.array_equal(out, groups) else _in_order(out)


def _steps(told: Array, noise: Array, touched: bool) -> list[float]:
    """Return how much each of the columns (N, c) may differ within a pose; arguments as above."""
    sigma = [*noise, *np.zeros(told.shape[1] - noise.size)]
    return [max(_resolved(c, touched), NOISES * float(s))
            for c, s in zip(told.T, sigma, strict=True)]


def _resolved(column: Array, touched: bool) -> float:
    """Return how much joint values (N,) of one pose may differ."""
    known = column[np.isfinite(column)]
    if not known.size:
        return np.inf
    return max((TOUCHED if touched else RESOLVED) * float(np.ptp(known)),
               DIGITS * float(np.abs(known).max()))


def repeats(data: Dataset) -> Ints:
    """Return a label per commanded pose and environment (N,): rows of one differ by noise alone.

    The environment is the session, the direction of approach, velocities, loads and temperatures:
    every recorded column but the time.
    """
    out = data.groups
    if np.unique(out).size == out.size:
        return out
    keys = [c for n, c in sorted(data.columns.items()) if n not in NO_INFLUENCE]
    warm = [n.startswith("temperature") for n in sorted(data.columns) if n not in NO_INFLUENCE]
    ways = data.directions()
    if ways is not None:
        keys += list(ways.T)
        warm += [False] * ways.shape[1]
    if data.sessions is not None:
        keys.append(np.unique(np.array(data.sessions), return_inverse=True)[1].astype(float))
        warm.append(False)
    for values, temperature in zip(keys, warm, strict=True):
        largest = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
        out = _split(out, values, SAME_TEMPERATURE if temperature else SAME * largest)
    return out


def _split(label: Ints, values: Array, step: float) -> Ints:
    """Return labels (N,) split wherever values (N,) are in different steps."""
    known = np.isfinite(values)
    low = np.full(int(label.max(initial=0)) + 1, np.inf)
    np.minimum.at(low, label[known], values[known])
    part = np.zeros(label.size, dtype=np.int64)
    if 0.0 < step < np.inf:
        part[known] = 1 + np.floor((values[known] - low[label[known]]) / step).astype(np.int64)
    else:
        part[known] = 1
    mixed = label * (int(part.max(initial=0)) + 1) + part
    return np.asarray(np.unique(mixed, return_inverse=True)[1], dtype=np.int64).reshape(-1)


def _merged(label: Ints, same: Ints) -> Ints:
    """Return labels (N,) merged wherever ``same`` (N,) is equal, transitively."""
    if np.unique(same).size == same.size:
        return label
    out = label
    while True:
        by_same = np.full(same.size, out.size)
        np.minimum.at(by_same, same, out)
        by_label = np.full(int(out.max()) + 1, out.size)
        np.minimum.at(by_label, out, by_same[same])
        new = by_label[out]
        if np.array_equal(new, out):
            return out
        out = new


def _in_order(label: Ints) -> Ints:
    """Return labels (N,) numbered in order of appearance."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[inverse.reshape(-1)], dtype=np.int64)


def identical_rows(rows: Array) -> Ints:
    """Return the index of the first row that equals each row (N, c) bit by bit (N,).

    nan equals nan.
    """
    bits = np.ascontiguousarray(np.where(np.isnan(rows), np.nan, rows) + 0.0).view(np.uint64)
    odd = np.random.default_rng(1).integers(1, 2**63, bits.shape[1], dtype=np.uint64) | np.uint64(1)
    mixed = (bits ^ (bits >> np.uint64(29))) * odd
    _, first, label = np.unique((mixed ^ (mixed >> np.uint64(32))).sum(axis=1),
                                return_index=True, return_inverse=True)
    found = first[label.reshape(-1)]
    # a row that shares only the hash with another is its own first
    return np.where(np.all(bits[found] == bits, axis=1), found, np.arange(len(rows)))
