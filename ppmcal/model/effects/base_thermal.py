"""Thermal growth of the base: lengths grow with the temperature above 20 degrees Celsius."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.late import EXPANSION, TAU, grown
from ppmcal.model.effects.setting import Setting


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Base points x (1 + expansion x), x' = (T - 20 C - x)/tau; tau 0: x = T - 20 C."""
    return grown("base", setting, on, values)


BASE_THERMAL = register(EffectKind(
    "base_thermal", "base points x (1 + expansion x), x' = (T - 20 C - x)/tau",
    "ISO 1: lengths refer to 20 degrees Celsius; ISO 230-3, thermal effects",
    fixed_list(EXPANSION, TAU),
    ("temperature",), _terms, per_actuator=False,
    remedy="record temperature_<sensor> of legs and of the base apart",
    worked=Worked({"expansion": 11e-6, "tau": 0.0}, {"temperature": 5.0, "base": 2.0}, 1.1e-4)))
