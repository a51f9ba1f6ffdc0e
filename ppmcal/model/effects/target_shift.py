"""The target that moved against the platform in mid-run: bumped, or taken off and put back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import EffectKind, EffectParameter, Terms, Worked, linear, register
from ppmcal.model.effects.setting import COORDINATES, PLACE, Setting, Shift
from ppmcal.model.effects.zero_shift import ONSET


def _parameters(motion: str) -> tuple[EffectParameter, ...]:
    """Return one step per pose coordinate, and the row."""
    return (*(EffectParameter(c, "angle" if c[0] == "r" else "length", size=1e-5)
              for c in COORDINATES[motion]), ONSET)


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Target displaced by the steps from the row on."""
    since = setting.since(values["from_row"])[:, 0]
    by = {}
    for name in values:
        if name in PLACE:
            step = np.zeros((since.size, 6))
            step[:, PLACE[name]] = since
            by[name] = Shift(target=step)
    return linear(values, by)


TARGET_SHIFT = register(EffectKind(
    "target_shift", "target displaced by a twist, platform axes, from row from_row on",
    "ISO 230-1, set-up of the instrument", _parameters, ("row",), _terms, per_actuator=False,
    instrument=True, onset="from_row",
    remedy="put the target back on its seat and repeat the first poses",
    worked=Worked({"x": 3e-5, "from_row": 5.0}, {"row": 6.0}, 3e-5)))
