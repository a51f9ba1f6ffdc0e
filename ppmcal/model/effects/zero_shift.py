"""A shift of a joint's zero in mid-run: rehomed, or a slipped encoder or belt."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.event import ONSET
from ppmcal.model.effects.kind import (
    STROKE,
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
    """Du = shift from the row on."""
    return linear(values, {"shift": setting.at_joints(setting.since(values["from_row"]), on)})


ZERO_SHIFT = register(EffectKind(
    "zero_shift", "du = shift from row from_row on, until the next",
    "ISO 230-2, zero point; homing repeatability",
    fixed_list(EffectParameter("shift", "joint", None, usual=(-0.2, 0.2), of_stroke=True,
                               why=STROKE), ONSET), ("row",), _terms, onset="from_row",
    remedy="home each joint again and return to one reference pose",
    worked=Worked({"shift": 3e-5, "from_row": 5.0}, {"row": 6.0}, 3e-5)))
