"""Wind-up of a drive under friction that grows with the load."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.inputs import WOUND_LOAD
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    Reversal,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = s width |f|."""
    shape = setting.approach * np.abs(setting.load)
    return linear(values, {"width": setting.at_joints(shape, on)})


WINDUP = register(EffectKind(
    "windup", "du = s width |f|, f the actuator's load",
    "Coulomb friction proportional to the load, wound up in an elastic drive",
    fixed_list(EffectParameter("width", "joint/load", None, size=1e-7)),
    ("dir", "load"), _terms, uses_load=True, reversal=Reversal("wind-up", lambda v: v["width"]),
    follows=WOUND_LOAD,
    worked=Worked({"width": 1e-7}, {"approach": -1.0, "load": -50.0}, -5e-6)))
