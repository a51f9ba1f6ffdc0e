"""Compliance of the drive or strut: it gives way in the direction of its load."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.setting import Setting


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = f/stiffness, with f the load at the pose that is reached."""
    shape = setting.at_joints(setting.load, on)
    k = values["stiffness"]
    return Terms(shape.times(1.0 / k), {"stiffness": shape.times(-1.0 / k**2)})


COMPLIANCE = register(EffectKind(
    "compliance", "du = f/stiffness, f the actuator's load",
    "[LIN] section 4.3: stiffness of drives and bars in the limb",
    fixed_list(EffectParameter("stiffness", "load/joint", None, low=1e-300,
                               usual=(10.0, 2e9), why="a solid steel strut 50 mm thick and 200 mm "
                               "long has 2e9 N/m; [LIN] section 4.3: 6e7 to 8.1e8 N/m",
                               reciprocal=True)),
    ("load",), _terms, uses_load=True, under_weight=True,
    worked=Worked({"stiffness": 2e7}, {"load": 100.0}, 5e-6)))
