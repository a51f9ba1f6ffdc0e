"""Thermal growth of the base: with the deviation from 20 degrees Celsius, or the drives' work."""

from __future__ import annotations

from ppmcal.model.effects.kind import register
from ppmcal.model.effects.late import body_thermal

BASE_THERMAL = register(body_thermal(
    "base", "record temperature_<sensor> of legs and of the base separately"))
