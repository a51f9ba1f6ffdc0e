"""Clearance in a limb's joints, taken up to the side to which the load pushes."""

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


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = sign(f) width/2."""
    return linear(values, {"width": setting.at_joints(0.5 * np.sign(setting.load), on)})


CLEARANCE = register(EffectKind(
    "clearance", "du = sign(f) width/2, f the actuator's load",
    "joint clearance under load, as in stiffness analyses of parallel machines",
    fixed_list(EffectParameter("width", "joint", None, low=0.0, usual=(0.0, 0.05),
                               of_stroke=True, why=STROKE)), ("load",), _terms,
    uses_load=True, by_sign=True,
    worked=Worked({"width": 2e-5}, {"load": -30.0}, -1e-5)))
