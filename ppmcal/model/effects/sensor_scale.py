"""Scale error of the measuring instrument."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.inputs import POINT
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting, Shift


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Measured position = (1 + scale) true position, in the measuring frame."""
    return linear(values, {"scale": Shift(stretch=np.eye(3)[None])})


SENSOR_SCALE = register(EffectKind(
    "sensor_scale", "measured position = (1 + scale) true position",
    "scale of a camera or tracker (VDI/VDE 2634)",
    fixed_list(EffectParameter("scale", "1", low=-0.1, high=0.1,
                               usual=(-0.05, 0.05), why="ISO 10360-10 trackers are within 1e-5, "
                               "uncalibrated cameras within a few percent", size=1e-5)), (), _terms,
    per_actuator=False, instrument=True, follows=POINT,
    remedy="measure a known distance (a scale bar) with the same instrument",
    worked=Worked({"scale": 1e-4}, {}, 1e-4)))
