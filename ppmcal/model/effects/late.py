"""What heat that comes late shares: a time constant, and growth that follows the thermometer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import EffectParameter, ScanRange, Terms
from ppmcal.model.effects.setting import Setting


def taus(data: ScanRange) -> list[float]:
    """Return time constants between a few rows and the whole campaign, s."""
    return [part * data.duration for part in (0.03, 0.1, 0.3)]


EXPANSION = EffectParameter("expansion", "1/K", low=-30e-6, high=30e-6, size=1e-6)
TAU = EffectParameter("tau", "s", 0.0, low=0.0, usual=(0.0, 1e6), size=1.0, scan=taus,
                      optional=True, needs=("past",),
                      why="what takes longer than a week does not heat within a campaign")


def grown(which: str, setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Return the terms of slots ``which`` x (1 + expansion x), x' = (T - 20 C - x)/tau."""
    warm, slope = setting.late(values["tau"])
    shape = setting.at_slots(which, warm, on)
    return Terms(shape.times(values["expansion"]), {
        "expansion": shape,
        "tau": setting.at_slots(which, values["expansion"] * slope, on)})


def rate_grown(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Return the terms of struts x (1 + growth x), x' = (|dq|/dt - x)/tau by joint."""
    work, slope = setting.worked(values["tau"])
    shape = setting.at_struts(work, on)
    return Terms(shape.times(values["growth"]), {
        "growth": shape, "tau": setting.at_struts(np.asarray(values["growth"] * slope), on)})
