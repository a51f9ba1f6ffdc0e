"""Ropes whose ends are at different heights, on a machine that is modelled in the plane.

A belt from an anchor above or below its attachment point is the hypotenuse: it reads more than its
length in the plane, the more so the shorter it is. Arms and hooks in the plane are not part of it:
they are added to the length in the plane, as the joint's offset. Without an instrument, the belt's
expected reading follows from the pose, and with it the shift.
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
    """Du = sqrt(r^2 - height^2) - r with r = ratio q, nan unless r exceeds the height."""
    read, height = setting.travel, values["height"]
    square = read**2 - height**2
    with np.errstate(invalid="ignore", divide="ignore"):
        flat = np.where(square > 0.0, np.sqrt(square), np.nan)
    return Terms(setting.at_joints(flat - read, on),
                 {"height": setting.at_joints(-height / flat, on)})


def _scan(data: ScanRange) -> list[float]:
    """Return evenly spaced heights up to the size of the base."""
    low = data.near / 2.0
    return [low + (data.size - low) * i / 4.0 for i in range(1, 5)]


ROPE_HEIGHT = register(EffectKind(
    "rope_height", "du = sqrt(q^2 - height^2) - q", "Pythagoras; measurementToXYPlane of a "
    "belt router's firmware",
    fixed_list(EffectParameter("height", "length", default=None, low=0.0, usual=(0.0, 0.5),
                               size=1e-3, scan=_scan,
                               why="stacked arms on a router are a few centimetres apart")),
    (), _terms, joints="ropes", exists_in=lambda motion: motion.planar,
    height="height", title="height of a rope's anchor above the plane",
    remedy="measure the height of each anchor above the rope's attachment point",
    # a height is on the drawing; at 0, where a search begins, it has no first-order effect
    variants=lambda motion: (),
    worked=Worked({"height": 0.3}, {"travel": 0.5}, -0.1)))
