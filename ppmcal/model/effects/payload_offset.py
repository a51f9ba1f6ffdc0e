"""A payload whose centre of mass is not at the platform's origin."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Array
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    Worked,
    no_terms,
    register,
)
from ppmcal.model.effects.setting import Setting
from ppmcal.model.motions import Motion


def _parameters(motion: Motion) -> tuple[EffectParameter, ...]:
    return tuple(EffectParameter(c, "length", usual=(-1.0, 1.0), size=1e-4,
                                 why="a payload is held within reach of its platform")
                 for c in "xyz"[:motion.axes])


def _carried(setting: Setting, values: Mapping[str, float]) -> tuple[Array, Array]:
    """Apply the weight at (x, y, z) in platform axes: moment = R (x, y, z) x weight."""
    arm = setting.turn @ np.array([values.get(c, 0.0) for c in "xyz"])
    wrench = setting.wrench.copy()
    wrench[:, 3:] += np.cross(arm, setting.weight)
    return setting.weight, wrench


PAYLOAD_OFFSET = register(EffectKind(
    "payload_offset", "moment of the payload's weight about the platform's origin = R c x weight, "
    "c its centre of mass", "statics: the wrench of a force that does not act at the origin",
    _parameters, ("wrench",), no_terms, per_actuator=False, exists_in=lambda motion: motion.turns,
    uses_load=True, carried=_carried, body="platform",
    remedy="determine the payload's centre of mass, or mount it in another place",
    worked=Worked({"x": 0.0, "y": -0.05}, {"weight": 100.0}, -5.0)))
