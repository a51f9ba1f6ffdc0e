"""Touches of a flat: a printer's probe, a dial gauge over a surface plate."""

from __future__ import annotations

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Array
from ppmcal.model.instruments.kind import FRAME, InstrumentKind, Parts, register
from ppmcal.model.motions import Motion


def _value(point: Array, far: Array) -> Array:
    return point[:, 2]


def _start(point: Array, height: Array, motion: Motion) -> Array:
    """Return height and tilt (6,) that best map the points' z to the heights."""
    x, y, z = point.T
    columns = np.stack([np.ones_like(z), y, -x], axis=1)
    up, rx, ry = linalg.lstsq(columns, height - z, rcond=None)[0]
    return np.array([0.0, 0.0, up, rx, ry, 0.0])


def _target(motion: Motion, relative: bool) -> Parts:
    """Return identifiable components; without rotation the target is a constant like the frame."""
    if motion.turns:
        return tuple(range(motion.axes))
    return () if relative else (2,)


PLANE = register(InstrumentKind(
    "plane", lambda motion: (2,), "height", _value, _start,
    # its height and tilt
    lambda motion, between: (2, 3, 4), _target, opened=(FRAME,), sigma="height",
    touches=True))
