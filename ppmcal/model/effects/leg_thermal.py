"""Thermal growth of the struts: lengths grow with the temperature above 20 degrees Celsius."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ppmcal.errors import BadInput
from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    FromFile,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.late import EXPANSION, TAU, grown, rate_grown
from ppmcal.model.effects.setting import Setting
from ppmcal.units import Units


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Strut lengths x (1 + expansion x), x' = (T - 20 C - x)/tau; tau 0: x = T - 20 C."""
    return grown("struts", setting, on, values)


def _made(entries: Mapping[str, object], units: Units, joint: str) -> EffectKind:
    """Return the kind that a file means by ``from``.

    Raises:
        BadInput: neither thermometer nor motion.
    """
    source = entries.get("from", "thermometer")
    if source not in ("thermometer", "motion"):
        raise BadInput(f"legs are not heated from '{source}'", "from",
                       "Write `from: motion` (the drives' own work), or leave it out")
    return FROM_MOTION if source == "motion" else LEG_THERMAL


FILE = FromFile(("from",), _made)

FROM_MOTION = EffectKind(
    "leg_thermal", "strut lengths x (1 + growth x), x' = (|dq|/dt - x)/tau, by joint",
    "ISO 230-3, distortion by moving axes: the drive's work heats the leg, which cools with tau",
    fixed_list(EffectParameter("growth", "s/joint", low=-1.0, high=1.0, size=1e-4,
                               usual=(0.0, 1.0), why="work heats"),
               replace(TAU, default=None, optional=False, low=1e-6, usual=(1e-6, 1e6), needs=())),
    ("past",), rate_grown, from_file=FILE, written=lambda units: {"from": "motion"},
    title="leg_thermal from motion",
    remedy="move each joint back and forth for a while between two measurements of one pose")

LEG_THERMAL: EffectKind = register(EffectKind(
    "leg_thermal", "strut lengths x (1 + expansion x), x' = (T - 20 C - x)/tau",
    "ISO 1: lengths refer to 20 degrees Celsius; ISO 230-3, thermal effects",
    fixed_list(EXPANSION, TAU), ("temperature",), _terms, per_actuator=True, from_file=FILE,
    variants=lambda motion: (LEG_THERMAL, FROM_MOTION),
    remedy="record temperature_<sensor> of legs and of the base apart",
    worked=Worked({"expansion": 11e-6, "tau": 0.0}, {"temperature": 5.0, "struts": 2.0}, 1.1e-4)))
