"""Distances from a fixed point, or between two platform positions: a ballbar, a wire, a caliper."""

from __future__ import annotations

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Array
from ppmcal.model.instruments.kind import InstrumentKind, Parts, register
from ppmcal.model.motions import Motion


def _value(point: Array, far: Array) -> Array:
    return np.asarray(np.linalg.norm(np.nan_to_num(point - far), axis=1))


def _start(point: Array, distance: Array, motion: Motion) -> Array:
    """Return the shift (6,) that brings the reference point of the distances to the origin.

    |p - c|^2 = d^2 becomes linear in c once its mean is subtracted. Of two mirrored solutions, for
    points in a plane, the fit starts at the one nearer to that plane.
    """
    free = motion.axes
    middle = point.mean(axis=0)
    p = (point - middle)[:, :free]
    square = np.sum(p**2, axis=1) - distance**2
    columns = np.concatenate([2.0 * p, np.ones((len(p), 1))], axis=1)
    solution = linalg.lstsq(columns, square, rcond=1e-9)[0]
    out = np.zeros(6)
    out[:free] = -(solution[:free] + middle[:free])
    return out


def _frame(motion: Motion, between: bool) -> Parts:
    """Return the reference point's components; distances between platform positions have none."""
    return () if between else tuple(range(motion.axes))


def _target(motion: Motion, relative: bool) -> Parts:
    """Return identifiable components; without rotation the target is a constant like the frame."""
    return () if relative and not motion.turns else tuple(range(motion.axes))


DISTANCE = register(InstrumentKind(
    "distance", lambda motion: (0,), "distance", _value, _start, _frame, _target, opened=(),
    sigma="distance", along_line=True))
