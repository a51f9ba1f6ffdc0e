"""The base that moved against the instrument in mid-run: either of them was bumped."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import EffectKind, EffectParameter, Terms, Worked, linear, register
from ppmcal.model.effects.setting import COORDINATES, PLACE, Setting, Shift
from ppmcal.model.effects.zero_shift import ONSET


def _parameters(motion: str) -> tuple[EffectParameter, ...]:
    """Return one step per pose coordinate, and the row."""
    seen = "spatial" if motion == "translational" else motion
    return (*(EffectParameter(c, "angle" if c[0] == "r" else "length", size=1e-5)
              for c in COORDINATES[seen]), ONSET)


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Base displaced by the steps from the row on."""
    since = setting.since(values["from_row"])[:, 0]
    by = {}
    for name in values:
        if name in PLACE:
            step = np.zeros((since.size, 6))
            step[:, PLACE[name]] = since
            by[name] = Shift(frame=step)
    return linear(values, by)


BASE_SHIFT = register(EffectKind(
    "base_shift", "base displaced by a twist, base axes, from row from_row on",
    "ISO 230-1, set-up of the instrument", _parameters, ("row",), _terms, per_actuator=False,
    instrument=True, onset="from_row",
    remedy="measure fixed points of the base now and then",
    worked=Worked({"x": 3e-5, "from_row": 5.0}, {"row": 6.0}, 3e-5)))
