"""Lag: at the trigger the joint is behind the controller's reading."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
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
    """Du = -tau velocity."""
    return linear(values, {"tau": setting.at_joints(-setting.velocity, on)})


LAG = register(EffectKind(
    "lag", "du = -tau velocity", "first-order delay between joint and trigger",
    fixed_list(EffectParameter("tau", "s", low=-1.0, high=1.0,
                               usual=(-0.2, 0.2), why="a later trigger is not the lag of a drive "
                               "or a camera", size=1e-5)), ("vel",), _terms,
    worked=Worked({"tau": 1e-3}, {"velocity": 0.05}, -5e-5)))
