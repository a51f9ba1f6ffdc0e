"""The target that moved against the platform in mid-run: bumped, or taken off and put back."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.event import step_parameters, stepped
from ppmcal.model.effects.kind import EffectKind, Terms, Worked, register
from ppmcal.model.effects.setting import Setting, Shift


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Target displaced by the steps from the row on."""
    return stepped(setting, values, lambda step: Shift(target=step))


TARGET_SHIFT = register(EffectKind(
    "target_shift", "target displaced by a twist, platform axes, from row from_row on",
    "ISO 230-1, set-up of the instrument",
    lambda motion: step_parameters(motion.coordinates), ("row",), _terms, per_actuator=False,
    instrument=True, onset="from_row", body="platform",
    remedy="put the target back on its seat and repeat the first poses",
    worked=Worked({"x": 3e-5, "from_row": 5.0}, {"row": 6.0}, 3e-5)))
