"""Hysteresis of a drive: plays of several widths at once (Prandtl-Ishlinskii)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    Reversal,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting

WIDTHS = {"w1": 0.004, "w2": 0.03, "w3": 0.2}
"""Full widths of the plays, as fractions of the stroke: each about seven times the previous."""


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = sum w_i (p_i - u), p_i play of a fixed fraction of the stroke ``low`` to ``high``."""
    stroke = _stroke(setting, values)
    return linear(values, {n: setting.at_joints(setting.slack(part * stroke)[0], on)
                           for n, part in WIDTHS.items()})


def _stroke(setting: Setting, values: Mapping[str, float]) -> Array:
    """Return the length of each joint's stroke (k,)."""
    low = np.where(np.isnan(values["low"]), setting.stroke[:, 0], values["low"])
    high = np.where(np.isnan(values["high"]), setting.stroke[:, 1], values["high"])
    return high - low


def _unsettled(setting: Setting, on: Bools, values: Mapping[str, float], start: float = 1.0
               ) -> Array:
    stroke = _stroke(setting, values)
    each = [abs(values[n]) * setting.unsettled(part * stroke, start) for n, part in WIDTHS.items()]
    return np.where(on, np.sum(each, axis=0), 0.0)


HYSTERESIS = register(EffectKind(
    "hysteresis", "du = sum w_i (p_i - u), p_i play of 0.004, 0.03 and 0.2 of the stroke",
    "Kuhnen, Modeling, identification and compensation of complex hysteretic nonlinearities, "
    "Eur. J. Control 9 (2003) 407: Prandtl-Ishlinskii operator",
    fixed_list(*(EffectParameter(n, "1", low=-1.0, high=1.0, usual=(-0.5, 0.5), size=1e-4,
                                 why="a drive whose output lags by more hardly drives")
                 for n in WIDTHS),
               *(EffectParameter(n, "joint", np.nan, constant=True, stroke_end=n)
                 for n in ("low", "high"))),
    ("order",), _terms, unsettled=_unsettled,
    reversal=Reversal("wind-up", lambda v: -sum(v[n] * part for n, part in WIDTHS.items())),
    remedy="move through strokes of several lengths, back and forth",
    worked=Worked({"w1": 0.0, "w2": 1e-3, "w3": 0.0, "low": 0.0, "high": 1.0},
                  {"travel_before": 0.1, "travel": 0.2}, -1.5e-5)))
