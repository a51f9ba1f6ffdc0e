"""Drift: the machine moves steadily relative to the instrument."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import EffectKind, EffectParameter, Terms, Worked, linear, register
from ppmcal.model.effects.setting import PLACE, Setting, Shift
from ppmcal.model.motions import Motion


def _parameters(motion: Motion) -> tuple[EffectParameter, ...]:
    """Return one rate per pose coordinate."""
    return tuple(EffectParameter(c, "angle/s" if c[0] == "r" else "length/s", size=1e-9)
                 for c in motion.coordinates)


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """dpose_c = rate_c time, base axes, about the platform's origin."""
    by = {}
    for name in values:
        pose = np.zeros((setting.time.size, 6))
        pose[:, PLACE[name]] = setting.time
        by[name] = Shift(pose=pose)
    return linear(values, by)


DRIFT = register(EffectKind(
    "drift", "platform twist = rate time, base axes", "ISO 230-3, drift of the set-up",
    _parameters, ("time",), _terms, per_actuator=False,
    remedy="return to one reference pose at intervals, at changing temperature",
    worked=Worked({"x": 1e-9}, {"time": 3600.0}, 3.6e-6)))
