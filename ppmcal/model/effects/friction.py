"""Friction that falls with speed: the drive winds up less the faster the joint moves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
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
from ppmcal.model.effects.setting import Setting, total


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = s (dynamic + (static - dynamic) exp(-|v|/speed))."""
    static, dynamic, speed = values["static"], values["dynamic"], values["speed"]
    ratio = np.abs(setting.velocity / speed)
    falling = np.exp(-ratio)
    by_static = setting.at_joints(setting.approach * falling, on)
    by_dynamic = setting.at_joints(setting.approach * (1.0 - falling), on)
    slope = setting.approach * (static - dynamic) * falling * ratio / speed
    return Terms(total([by_static.times(static), by_dynamic.times(dynamic)]),
                 {"static": by_static, "dynamic": by_dynamic,
                  "speed": setting.at_joints(slope, on)})


def _speeds(data: ScanRange) -> list[float]:
    """Return speeds around the median recorded speed."""
    return [data.speed * part for part in (0.15, 0.4, 1.0, 2.5)]


FRICTION = register(EffectKind(
    "friction", "du = s (dynamic + (static - dynamic) exp(-|v|/speed)), s the direction",
    "Stribeck curve; Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083",
    fixed_list(*(EffectParameter(n, "joint", usual=(-0.05, 0.05), of_stroke=True, why=STROKE)
                 for n in ("static", "dynamic")),
               EffectParameter("speed", "joint/s", None, low=1e-12, usual=(1e-12, np.inf),
                               scan=_speeds)),
    ("dir", "vel"), _terms,
    reversal=Reversal("wind-up", lambda v: v["static"] + v["dynamic"]),
    remedy="approach the same poses at several speeds, from both sides",
    worked=Worked({"static": 3e-5, "dynamic": 1e-5, "speed": 0.02},
                  {"approach": -1.0, "velocity": -0.02},
                  -1e-5 * (1.0 + 2.0 * float(np.exp(-1.0))))))
