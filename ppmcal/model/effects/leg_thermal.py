"""Thermal growth of struts: with the deviation from 20 degrees Celsius, or the drives' work."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import EffectKind, Terms, Worked, fixed_list, register
from ppmcal.model.effects.late import (
    EXPANSION,
    OWN_WORK,
    TAU,
    grown,
    rate_grown,
    source_of_heat,
)
from ppmcal.model.effects.setting import Setting


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Strut lengths x (1 + expansion x), x' = (T - 20 C - x)/tau; tau 0: x = T - 20 C."""
    return grown("struts", setting, on, values)


FILE = source_of_heat("legs are", lambda: {"thermometer": LEG_THERMAL, "motion": FROM_MOTION})

FROM_MOTION: EffectKind = EffectKind(
    "leg_thermal", "strut lengths x (1 + growth x), x' = (|dq|/dt - x)/tau, by joint",
    "ISO 230-3, distortion by moving axes: the drive's work heats the leg, which cools with tau",
    OWN_WORK, ("past",), rate_grown, from_file=FILE, written=lambda units: {"from": "motion"},
    title="leg_thermal from motion",
    remedy="move each joint back and forth for a while between two measurements of one pose")

LEG_THERMAL: EffectKind = register(EffectKind(
    "leg_thermal", "strut lengths x (1 + expansion x), x' = (T - 20 C - x)/tau",
    "ISO 1: lengths refer to 20 degrees Celsius; ISO 230-3, thermal effects",
    fixed_list(EXPANSION, TAU), ("temperature",), _terms, per_actuator=True, from_file=FILE,
    variants=lambda motion: (LEG_THERMAL, FROM_MOTION),
    remedy="record temperature_<sensor> of legs and of the base separately",
    worked=Worked({"expansion": 11e-6, "tau": 0.0}, {"temperature": 5.0, "struts": 2.0}, 1.1e-4)))
