"""Backlash: the joint's position differs by the play between its two directions of approach."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    STROKE,
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
    """Du = s width/2; a negative width means that the joint lags its encoder reading."""
    return linear(values, {"width": setting.at_joints(0.5 * setting.approach, on)})


BACKLASH = register(EffectKind(
    "backlash", "du = s width/2, s the direction of approach", "ISO 230-2, reversal value",
    fixed_list(EffectParameter("width", "joint", None, usual=(-0.05, 0.05), of_stroke=True,
                               why=STROKE)), ("dir",), _terms,
    reversal=Reversal("play", lambda v: v["width"]),
    worked=Worked({"width": 2e-5}, {"approach": -1.0}, -1e-5)))
