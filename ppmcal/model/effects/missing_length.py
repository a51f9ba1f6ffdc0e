"""A constant missing from all rope readings: an arm, hook or belt end that was never counted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

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
from ppmcal.model.effects.setting import Setting, Shift


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = length."""
    return linear(values, {"length": Shift({
        (i, "offset"): np.ones_like(setting.time) for i, limb in enumerate(setting.limbs)
        if limb.pulls_only})})


MISSING_LENGTH = register(EffectKind(
    "missing_length", "du = length, the same on all ropes",
    "a rope's length is counted from its exit from the winch to its cut end",
    fixed_list(EffectParameter("length", "length", usual=(-0.5, 0.5), size=1e-4,
                               why="hooks, arms and rings are a few centimetres long, a rope's "
                               "zero may refer to another place")),
    (), _terms, per_actuator=False, joints="ropes", title="constant missing from all lengths",
    remedy="measure one rope from its anchor to its attachment point",
    worked=Worked({"length": 0.15}, {"travel": 2.0}, 0.15)))
