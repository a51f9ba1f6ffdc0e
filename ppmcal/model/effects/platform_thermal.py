"""Thermal growth of the platform: with the deviation from 20 deg C, or the drives' work."""

from __future__ import annotations

from ppmcal.model.effects.kind import register
from ppmcal.model.effects.late import body_thermal

PLATFORM_THERMAL = register(body_thermal(
    "platform", "record temperature_<sensor> of the platform separately"))
