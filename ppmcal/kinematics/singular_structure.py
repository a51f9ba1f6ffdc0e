"""Why a machine is singular at home, if due to its points: then no other home pose would help."""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

FLAT = 1e-3
"""Points lie at one point, line or plane if they are off it by less than this part of the reach."""


def singular_structure(mechanism: Mechanism) -> str:
    """Return in words which points leave the platform free, empty if none do.

    Only for machines all of whose limbs go from a point of the base to one of the platform.
    """
    values = [limb.slots.values(mechanism.values) for limb in mechanism.limbs]
    ends = ("base", "platform")
    if not all(f"{end}.point.x" in v for v in values for end in ends):
        return ""
    anchors, hooks = (np.array([[v.get(f"{end}.point.{a}", 0.0) for a in "xyz"] for v in values])
                      for end in ends)
    motion = mechanism.motion
    size = FLAT * mechanism.reach
    if motion.turns and _dimensions(hooks, size) == 0:
        return "all limbs hold the platform at one point, about which it can turn freely"
    if motion.turns_freely and _dimensions(hooks, size) == 1:
        return "all limbs hold the platform on one line, about which it can turn freely"
    if _dimensions(anchors, size) == 0:
        return "all anchors are at one point, about which the platform can swing"
    home = np.asarray(cga.move_point(mechanism.home[None], hooks))
    every = np.concatenate([anchors, home])
    axes = motion.axes
    if _dimensions(every, size) < axes:
        return (f"all anchors lie in one {'line' if axes == 2 else 'plane'} with the platform at "
                f"home, and nothing holds it across that {'line' if axes == 2 else 'plane'}")
    return ""


def _dimensions(points: Array, size: float) -> int:
    """Return the number of dimensions of a set of points (n, 3): 0 a point, 1 a line, 2 a plane."""
    away = points - points.mean(axis=0)
    return int((linalg.singular_values(away) > size * np.sqrt(len(points))).sum())
