"""Thermal growth of the platform: with the temperature above 20 degrees, or the drives' work."""

from __future__ import annotations

from ppmcal.model.effects.kind import register
from ppmcal.model.effects.late import body_thermal

PLATFORM_THERMAL = register(body_thermal(
    "platform", "record temperature_<sensor> of the platform apart"))
