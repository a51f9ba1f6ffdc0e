"""Smooth error over the stroke: spool build-up, a bent scale, string stretch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.polynomial import legendre

from ppmcal.linalg import Bools
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
    """Du = p2 P2(s) + p3 P3(s) + p4 P4(s), s = -1 to 1 over the stroke.

    The stroke is ``low`` to ``high`` if the file gives them, otherwise the joint's limits or,
    without limits, the range of the data.
    """
    low = np.where(np.isnan(values["low"]), setting.stroke[:, 0], values["low"])
    high = np.where(np.isnan(values["high"]), setting.stroke[:, 1], values["high"])
    s = (2.0 * setting.travel - low - high) / (high - low)
    return linear(values, {f"p{n}": setting.at_joints(legendre.legval(s, np.eye(5)[n]), on)
                           for n in (2, 3, 4)})


CURVATURE = register(EffectKind(
    "curvature", "du = p2 P2(s) + p3 P3(s) + p4 P4(s), s over the stroke",
    "ISO 230-2, smooth part of the positioning deviation; Legendre polynomials",
    fixed_list(*(EffectParameter(f"p{n}", "joint", usual=(-0.05, 0.05), of_stroke=True, why=STROKE)
                 for n in (2, 3, 4)),
               *(EffectParameter(n, "joint", np.nan, constant=True, stroke_end=n)
                 for n in ("low", "high"))),
    (), _terms,
    worked=Worked({"p2": 1e-4, "p3": 0.0, "p4": 0.0, "low": 0.0, "high": 1.0},
                  {"travel": 0.5}, -0.5e-4)))
