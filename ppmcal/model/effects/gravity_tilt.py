"""Weight that does not act in the direction stated in the file."""

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
    names = ("turn",) if motion.planar else ("first", "second")
    return tuple(EffectParameter(n, "angle", usual=(-1.6, 1.6), size=1e-3,
                                 why="weight acts downwards") for n in names)


def _vector(setting: Setting, values: Mapping[str, float]) -> Array:
    """Return the rotation vector of the weight (3,): about z, or about two base axes.

    These are the base axes in order, without the one nearest to gravity, about which a rotation
    has no effect.
    """
    if "turn" in values:
        return np.array([0.0, 0.0, values["turn"]])
    rest = np.delete(np.eye(3), int(np.argmax(np.abs(setting.gravity))), axis=0)
    return np.asarray(values["first"] * rest[0] + values["second"] * rest[1])


def _carried(setting: Setting, values: Mapping[str, float]) -> tuple[Array, Array]:
    """Rotate the weight, which keeps its point of action."""
    vector, old = _vector(setting, values), setting.weight
    angle = float(np.linalg.norm(vector))
    half = np.sinc(0.5 * angle / np.pi)
    along = np.cross(vector, old)
    weight = old + np.sinc(angle / np.pi) * along + 0.5 * half**2 * np.cross(vector, along)
    wrench = setting.wrench.copy()
    wrench[:, :3] += weight - old
    return weight, wrench


GRAVITY_TILT = register(EffectKind(
    "gravity_tilt", "weight = payload 9.80665 m/s2 along R gravity, R a turn about two base axes",
    "the machine stands inclined, or its file states another direction of gravity",
    _parameters, ("wrench",), no_terms, per_actuator=False, uses_load=True, carried=_carried,
    body="base", remedy="put a level or a plumb line on the base",
    worked=Worked({"turn": np.pi / 2}, {"weight": 100.0}, -200.0)))
