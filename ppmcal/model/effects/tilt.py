"""An inclined measuring plane: one direction appears shorter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.inputs import POINT
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    ScanRange,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.setting import Setting, Shift


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Measured = (1 - shrink d d^T) true, d = (cos direction, sin direction)."""
    shrink, a = values["shrink"], values["direction"]
    d, n = np.array([np.cos(a), np.sin(a), 0.0]), np.array([-np.sin(a), np.cos(a), 0.0])
    one = -np.outer(d, d)[None]
    turn = -(np.outer(d, n) + np.outer(n, d))[None]
    return Terms(Shift(stretch=shrink * one),
                 {"shrink": Shift(stretch=one), "direction": Shift(stretch=shrink * turn)})


DIRECTIONS = 12
"""Directions that a search tries, over half a turn."""


def _directions(data: ScanRange) -> list[float]:
    return [np.pi * i / DIRECTIONS for i in range(DIRECTIONS)]


TILT = register(EffectKind(
    "tilt", "measured = (1 - shrink d d^T) true, d at angle direction",
    "a camera or plate inclined by a: shrink = 1 - cos a",
    fixed_list(EffectParameter("shrink", "1", None, low=0.0, high=0.1, size=1e-5),
               EffectParameter("direction", "angle", None, size=1e-2, scan=_directions)),
    (), _terms, per_actuator=False, exists_in=lambda motion: motion.planar, instrument=True,
    follows=POINT,
    worked=Worked({"shrink": 1e-4, "direction": 0.0}, {}, -1e-4)))
