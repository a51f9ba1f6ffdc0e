"""Thermal growth of the platform: lengths grow with the temperature above 20 degrees Celsius."""

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
    """Platform points x (1 + expansion (T - 20 C))."""
    return linear(values, {"expansion": setting.at_slots("platform", setting.temperature, on)})


PLATFORM_THERMAL = register(EffectKind(
    "platform_thermal", "platform points x (1 + expansion (T - 20 C))",
    "ISO 1: lengths refer to 20 degrees Celsius; ISO 230-3, thermal effects",
    fixed_list(EffectParameter("expansion", "1/K", low=-30e-6, high=30e-6, size=1e-6)),
    ("temperature",), _terms, per_actuator=False,
    remedy="record temperature_<sensor> of the platform apart",
    worked=Worked({"expansion": 11e-6}, {"temperature": 5.0, "platform": 2.0}, 1.1e-4)))
