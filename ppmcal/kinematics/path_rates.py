"""Rates and accelerations along a path given row by row, by differences."""

from __future__ import annotations

import numpy as np

from ppmcal.linalg import Array


def follows(time: Array) -> bool:
    """Whether times (N,) increase from row to row, so that differences are meaningful."""
    return bool(time.size > 1 and np.isfinite(time).all() and np.all(np.diff(time) > 0.0))


def rates(time: Array, values: Array) -> Array:
    """Return d(values)/dt (N,) by the parabola through each row and its neighbours.

    Exact for a parabola at any spacing; nan next to a gap, and with fewer than three rows.
    """
    if len(values) < 3:
        return np.full(len(values), np.nan)
    return np.asarray(np.gradient(values, time, edge_order=2), dtype=float)


def accelerations(time: Array, values: Array) -> Array:
    """Return the second derivative (N,) of the same parabolas; nan at both ends."""
    out = np.full(len(values), np.nan)
    if len(values) < 3:
        return out
    before, after = np.diff(time)[:-1], np.diff(time)[1:]
    slope = np.diff(values) / np.diff(time)
    out[1:-1] = 2.0 * np.diff(slope) / (before + after)
    return out


def without_turns(values: Array, turn: float) -> Array:
    """Return angles (N,) without steps of whole turns from row to row; ``turn`` 0: no angle."""
    if turn <= 0.0:
        return values
    good = np.isfinite(values)
    out = values.copy()
    out[good] = np.unwrap(values[good], period=turn)
    return out
