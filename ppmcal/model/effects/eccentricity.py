"""Eccentric code disc or gear of a rotary joint: errors once and twice per revolution."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    STROKE,
    EffectKind,
    EffectParameter,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting
from ppmcal.model.effects.wave import wave


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = cos cos q + sin sin q + cos2 cos 2q + sin2 sin 2q."""
    q = setting.travel
    shapes = {"cos": np.cos(q), "sin": np.sin(q), "cos2": np.cos(2.0 * q), "sin2": np.sin(2.0 * q)}
    return linear(values, {n: setting.at_joints(s, on) for n, s in shapes.items()})


ECCENTRICITY = register(EffectKind(
    "eccentricity", "du = cos cos q + sin sin q + cos2 cos 2q + sin2 sin 2q",
    "encoder eccentricity and tilt of the disc (first and second harmonic)",
    fixed_list(*(EffectParameter(n, "joint", usual=(-0.05, 0.05), of_stroke=True, why=STROKE)
                 for n in ("cos", "sin", "cos2", "sin2"))),
    (), _terms, joints="turning",
    worked=Worked({"cos": 1e-4, "sin": 2e-4, "cos2": 3e-4, "sin2": 0.0},
                  {"travel": np.pi / 2.0}, -1e-4),
    derived=(*wave("cos", "sin", lambda v, at: at),
             *wave("cos2", "sin2", lambda v, at: 2.0 * at, "2"))))
