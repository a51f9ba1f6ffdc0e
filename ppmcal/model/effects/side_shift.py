"""Rope readings that differ between the two sides of the middle, such as by unequal pulling.

A controller that tightens the nearer rope first leaves different tensions on either side of the
frame, and with them different lengths in all ropes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.inputs import POSE
from ppmcal.model.effects.kind import (
    STROKE,
    EffectKind,
    EffectParameter,
    ScanRange,
    Terms,
    Worked,
    chosen_by,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import PLACE, Setting
from ppmcal.model.motions import Motion

AXES = ("x", "y", "z")
FILE = chosen_by("along", "x", lambda: KINDS, "no base axis '{}'",
                 f"Write one of {', '.join(AXES)}")


def _terms(axis: str, setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = shift where the platform is beyond the middle of the anchors along a base axis."""
    anchors = setting.points("base")[..., PLACE[axis]]
    along = setting.pose[:, PLACE[axis]] - 0.5 * (anchors.min(axis=1) + anchors.max(axis=1))
    beyond = np.where(np.isnan(along), np.nan, along > values["at"])
    return linear(values, {"shift": setting.at_joints(
        np.broadcast_to(beyond[:, None], setting.travel.shape), on)})


def _scan(data: ScanRange) -> list[float]:
    """Return the middle, and where a controller with inexact frame data may assume it."""
    return [part * data.size for part in (-0.01, 0.0, 0.01)]


def _kind(axis: str) -> EffectKind:
    return EffectKind(
        "side_shift", f"du = shift where the platform is beyond the middle of the anchors along "
        f"{axis} by more than `at`", "the rope that is pulled first, and so the force that the "
        "others hold, differs from side to side",
        fixed_list(EffectParameter("shift", "joint", usual=(-0.2, 0.2), of_stroke=True, why=STROKE),
                   EffectParameter("at", "length", 0.0, constant=True, scan=_scan, why="controllers"
                                   " switch in the middle of the frame as they know it")),
        (), partial(_terms, axis), joints="ropes", uses_load=True, follows=POSE,
        exists_in=lambda motion: axis in motion.coordinates, from_file=FILE,
        written=lambda units: {"along": axis}, variants=_variants,
        title=f"reading that differs between both sides along {axis}",
        remedy="pull the ropes tight in the same order everywhere",
        worked=Worked({"shift": 1e-3, "at": 0.1}, {"travel": 0.2, axis: 0.2}, 1e-3))


def _variants(motion: Motion) -> tuple[EffectKind, ...]:
    return tuple(k for a, k in KINDS.items() if a in motion.coordinates)


KINDS: dict[str, EffectKind] = {axis: _kind(axis) for axis in AXES}
SIDE_SHIFT = register(KINDS["x"])
