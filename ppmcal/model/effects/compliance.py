"""Compliance of the drive or strut: it deflects in the direction of its load.

It may stiffen under load, and vary along the stroke.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    ScanRange,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.setting import Setting


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = f/stiffness (1 + by_stroke (u - middle))/(1 + hardening |f|).

    f is the load at the pose reached; the middle is that of the stroke, ``low`` to ``high`` if the
    file gives them, otherwise the joint's limits or the range of the data.
    """
    k, load = values["stiffness"], setting.load
    hardening, by_stroke = values.get("hardening", 0.0), values.get("by_stroke", 0.0)
    given = np.array([values.get("low", np.nan), values.get("high", np.nan)])
    ends = np.where(np.isnan(given), setting.stroke, given)
    with np.errstate(invalid="ignore"):     # a joint without limits has no middle
        away = setting.travel - 0.5 * ends.sum(axis=1)
    soft = 1.0 + by_stroke * away if by_stroke else np.ones_like(load)
    hard = 1.0 + hardening * np.abs(load)
    give = load * soft / hard
    shape = setting.at_joints(give, on)
    return Terms(shape.times(1.0 / k), {
        "stiffness": shape.times(-1.0 / k**2),
        "hardening": setting.at_joints(-np.abs(load) * give / hard / k, on),
        "by_stroke": setting.at_joints(load * away / hard / k, on)})


def _hardenings(data: ScanRange) -> list[float]:
    """Return values that make a compliance 1/1.3 ... 1/13 as soft under the largest load.

    Spaced closely, like the slopes, so that a second effect cannot gain by values in between.
    """
    return [0.3 * 1.4**i / data.load for i in range(12)] if data.load > 0.0 else []


def _slopes(data: ScanRange) -> list[float]:
    """Return slopes that change a compliance by 12, 24 ... 84 % at the ends of the stroke."""
    return [2.0 * 0.12 * i / data.stroke for i in range(-7, 8) if i]


COMPLIANCE = register(EffectKind(
    "compliance", "du = f/stiffness (1 + by_stroke (u - middle))/(1 + hardening |f|), f the "
    "actuator's load",
    "[LIN] section 4.3: stiffness of drives and bars in the limb; ISO 3408-4: a screw held at one "
    "end deflects in proportion to its free length, ball contacts stiffen under load",
    fixed_list(EffectParameter("stiffness", "load/joint", None, low=1e-300,
                               usual=(10.0, 2e9), why="a solid steel strut 50 mm thick and 200 mm "
                               "long has 2e9 N/m; [LIN] section 4.3: 6e7 to 8.1e8 N/m",
                               reciprocal=True),
               EffectParameter("hardening", "1/load", low=0.0, usual=(0.0, np.inf),
                               why="contacts grow under load: ISO 3408-4", size=1e-4,
                               scan=_hardenings, optional=True),
               EffectParameter("by_stroke", "1/joint", usual=(-2.0, 2.0), per_stroke=True,
                               why="beyond it a drive would move against its load at one end",
                               size=1e-1, scan=_slopes, optional=True),
               *(EffectParameter(n, "joint", np.nan, constant=True, stroke_end=n)
                 for n in ("low", "high"))),
    ("load",), _terms, uses_load=True, under_weight=True,
    gives=lambda values: 1.0 / values["stiffness"],
    worked=Worked({"stiffness": 2e7, "hardening": 1e-2, "by_stroke": 4.0, "low": 0.0, "high": 1.0},
                  {"load": 100.0, "travel": 0.75}, 5e-6)))
