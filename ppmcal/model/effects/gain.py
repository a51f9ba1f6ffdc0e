"""Gain error of an encoder or a screw: the joint moves (1 + gain) times its reading."""

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
    """Du = gain ratio q."""
    return linear(values, {"gain": setting.at_joints(setting.travel, on)})


GAIN = register(EffectKind(
    "gain", "du = gain q", "ISO 230-2, linear part of the positioning deviation",
    fixed_list(EffectParameter("gain", "1", low=-0.1, high=0.1,
                               usual=(-0.03, 0.03), why="screws of ISO 3408-3 class 10 are within "
                               "7e-4, belts and spools within a few percent", size=1e-5)), (),
    _terms, same_as=("ratio",),
    remedy="measure one joint's travel directly, or a known distance",
    worked=Worked({"gain": 1e-4}, {"travel": 0.5}, 5e-5)))
