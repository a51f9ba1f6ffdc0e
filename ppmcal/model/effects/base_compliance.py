"""Compliance of the frame: the platform gives way in proportion to the wrench."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import EffectKind, EffectParameter, Terms, Worked, linear, register
from ppmcal.model.effects.setting import COORDINATES, PLACE, Setting, Shift

WRENCH = {"planar": ("fx", "fy", "mz"), "translational": ("fx", "fy", "fz"),
          "spatial": ("fx", "fy", "fz", "mx", "my", "mz")}
COLUMN = {"fx": 0, "fy": 1, "fz": 2, "mx": 3, "my": 4, "mz": 5}


def _parameters(motion: str) -> tuple[EffectParameter, ...]:
    """Return one compliance ``x_fx`` per coordinate and component of the wrench."""
    return tuple(EffectParameter(
        f"{c}_{w}", f"{'angle' if c[0] == 'r' else 'length'}/{'N.m' if w[0] == 'm' else 'N'}",
        size=1e-8, component=w) for c in COORDINATES[motion] for w in WRENCH[motion])


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """dpose_c = sum over w of c_w wrench_w, base axes, about the platform's origin."""
    by = {}
    for name in values:
        c, w = name.rsplit("_", 1)
        pose = np.zeros((setting.wrench.shape[0], 6))
        pose[:, PLACE[c]] = setting.wrench[:, COLUMN[w]]
        by[name] = Shift(pose=pose)
    return linear(values, by)


BASE_COMPLIANCE = register(EffectKind(
    "base_compliance", "platform twist = C wrench, base axes",
    "[LIN] section 4.3: compliance outside of the limbs", _parameters, ("wrench",), _terms,
    per_actuator=False,
    worked=Worked({"x_fx": 1e-8}, {"wrench": 200.0}, 2e-6)))
