"""Creep: a drive or strut that yields slowly after its load has changed."""

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
    """Du = give x, x' = (f - x)/tau, f the load at nominal geometry, including earlier rows."""
    x, slope = setting.late_load(values["tau"])
    shape = setting.at_joints(x, on)
    return Terms(shape.times(values["give"]), {
        "give": shape, "tau": setting.at_joints(values["give"] * slope, on)})


def _taus(data: ScanRange) -> list[float]:
    """Return time constants of several rows: shorter is compliance, longer is not observable."""
    return [float(t) for t in np.geomspace(2.0 * data.step, 20.0 * data.step, 3)]


CREEP = register(EffectKind(
    "creep", "du = give x, x' = (f - x)/tau, f the actuator's load",
    "Kelvin-Voigt solid: Findley, Lai, Onaran, Creep and relaxation (1976)",
    fixed_list(EffectParameter("give", "joint/load", None, low=0.0, usual=(5e-10, 0.1), size=1e-9,
                               why="the inverse of 10 to 2e9 N/m, as for a compliance"),
               EffectParameter("tau", "s", None, low=1e-6, usual=(1e-6, np.inf), size=1.0,
                               scan=_taus)),
    ("load", "past"), _terms,
    remedy="leave each load on for many rows, and measure repeatedly",
    worked=Worked({"give": 1e-7, "tau": 30.0},
                  {"load_before": 100.0, "load": 0.0, "time": 30.0 * float(np.log(2.0))}, 5e-6)))
