"""Error once per revolution of a screw or gear, or per period of a scale."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.inputs import PHASE
from ppmcal.model.effects.kind import (
    STROKE,
    EffectKind,
    EffectParameter,
    ScanRange,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.setting import Setting, total
from ppmcal.model.effects.wave import wave


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = cos cos(w) + sin sin(w), w = 2 pi ratio q/period."""
    period = values["period"]
    w = 2.0 * np.pi * setting.travel / period
    c, s = setting.at_joints(np.cos(w), on), setting.at_joints(np.sin(w), on)
    slope = (values["cos"] * np.sin(w) - values["sin"] * np.cos(w)) * w / period
    return Terms(total([c.times(values["cos"]), s.times(values["sin"])]),
                 {"cos": c, "sin": s, "period": setting.at_joints(slope, on)})


FEWEST_PERIODS, MOST_PERIODS = 1.5, 80.0
"""Periods per stroke that a search tries; longer waves are smooth errors."""
STEP = 0.4
PITCHES = {
    "length": tuple(1e-3 * mm for mm in (1, 2, 2.5, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32, 40)),
    "angle": tuple(2.0 * np.pi / n for n in (50, 60, 72, 80, 90, 100, 120, 144, 160, 180, 200, 240,
                                             320, 360))}
"""Periods of drives: nominal leads of screws (ISO 3408-2), also pitches of belts and scales, m;
tooth pitches of worm wheels, and twice those of strain wave gears, rad."""


def _periods(data: ScanRange) -> list[float]:
    """Return the stroke over 1.5, 1.9, ... periods, at most two for each pose; then finer pitches.

    Unevenly spaced positions show finer waves as well. There are too many for a scan, but machines
    have only a few standard ones, and these are exact: a lead is within 1e-4.
    """
    counts = np.arange(FEWEST_PERIODS, min(MOST_PERIODS, 2.0 * data.poses), STEP)
    finest = data.stroke / (counts[-1] + STEP / 2.0)
    fine = {p for joint in data.joints for p in PITCHES[joint] if p < finest}
    return [*(float(data.stroke / n) for n in counts), *sorted(fine, reverse=True)]


PERIODIC = register(EffectKind(
    "periodic", "du = cos cos(2 pi q/period) + sin sin(2 pi q/period)",
    "ISO 230-2, periodic positioning deviation (screw pitch, encoder)",
    fixed_list(*(EffectParameter(n, "joint", usual=(-0.05, 0.05), of_stroke=True, why=STROKE)
                 for n in ("cos", "sin")),
               EffectParameter("period", "joint", None, low=1e-9, usual=(0.0, 1.0),
                               of_stroke=True, why="without a whole period in the stroke an error "
                               "cannot be seen to repeat", scan=_periods)), (), _terms,
    period="period", follows=PHASE,
    worked=Worked({"cos": 2e-5, "sin": 1e-5, "period": 0.4}, {"travel": 0.1}, 1e-5),
    derived=wave("cos", "sin", lambda v, at: 2.0 * np.pi * at / v["period"])))
