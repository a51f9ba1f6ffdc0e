"""Play: a gap that the drive has to cross before the load follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.kind import (
    STROKE,
    EffectKind,
    EffectParameter,
    Reversal,
    ScanRange,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.setting import Setting

WIDEST, NARROWEST = 0.05, 1e-4
"""Limits of the widths that a search tries, as fractions of the stroke."""
SHARES = (0.0, 0.2, 0.4)
"""Fractions of the moves that are shorter than the widths tried: if all moves are longer, any width
gives the same columns."""
APART = 1.5


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = p - u, p_k = max(u_k - width/2, min(u_k + width/2, p_(k-1)))."""
    behind, slope = setting.slack(values["width"])
    return Terms(setting.at_joints(behind, on), {"width": setting.at_joints(slope, on)})


def _unsettled(setting: Setting, on: Bools, values: Mapping[str, float], start: float = 1.0
               ) -> Array:
    return np.where(on, setting.unsettled(values["width"], start), 0.0)


def _widths(data: ScanRange) -> list[float]:
    """Return widths that some of the moves do not take up."""
    low, high = NARROWEST * data.stroke, WIDEST * data.stroke
    if not data.moves:
        return [low, float(np.sqrt(low * high)), high]
    return _spread(np.clip(np.quantile(data.moves, SHARES), low, high).tolist())


def _spread(widths: Sequence[float]) -> list[float]:
    """Return rising widths, none of them close to the previous one."""
    out: list[float] = []
    for width in widths:
        if not out or width > APART * out[-1]:
            out.append(float(width))
    return out


PLAY = register(EffectKind(
    "play", "du = p - u, p_k = max(u_k - width/2, min(u_k + width/2, p_(k-1)))",
    "Krasnosel'skii and Pokrovskii, Systems with hysteresis (1989); ISO 230-2, reversal value",
    fixed_list(EffectParameter("width", "joint", None, usual=(-0.05, 0.05), of_stroke=True,
                               why=STROKE, scan=_widths, scaling=True)), ("order",), _terms,
    unsettled=_unsettled, reversal=Reversal("play", lambda v: -v["width"]),
    remedy="approach some poses by moves that are shorter than the play, after a reversal",
    worked=Worked({"width": 4e-5}, {"travel_before": -0.01, "travel": 0.0}, -2e-5)))
