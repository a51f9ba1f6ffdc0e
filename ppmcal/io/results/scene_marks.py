"""What needs a look in a drawing: limbs that are open, stretched, in each other's way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.io.results.scene_parts import SceneMark
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import smallest_singular_value
from ppmcal.kinematics.skeleton import LimbSkeleton
from ppmcal.kinematics.transmission import interferences, transmissions_at
from ppmcal.linalg import Array
from ppmcal.wording import number

THICKNESS = 0.01
"""A link is drawn so thick, in parts of the reach."""
STRETCHED = 0.05
"""A limb is marked where its transmission is below this: 3 degrees from straight."""
SINGULAR = 0.02
"""A machine is marked where its smallest singular value is below this, as at home by `check`."""


def pose_marks(model: Model, pose: Array, q: Array, limbs: Sequence[LimbSkeleton], gap: Array
               ) -> list[tuple[SceneMark, ...]]:
    """Return what needs a look at each of N poses.

    Args:
        model: the machine at its parameters.
        pose: platform-to-base motors (N, 8).
        q: joint values (N, k), SI.
        limbs: where they stand.
        gap: a limb with more than this between its ends does not close (N,), m.
    """
    out: list[list[SceneMark]] = [[] for _ in range(len(q))]
    units = model.mechanism.units
    for i, limb in enumerate(limbs):
        for n in np.flatnonzero(limb.gap > gap):
            out[n].append(SceneMark.filled(
                None, units, kind="gap", limbs=(i,),
                points=[(limb.ends[0][n] + limb.ends[1][n]) / 2],
                text=f"{limb.name} does not close: {units.words(limb.gap[n], 'length')} are "
                     "missing"))
    _singular(model, pose, q, out)
    _beyond_travel(model, q, limbs, out)
    _too_near(model, limbs, out)
    return [tuple(marks) for marks in out]


def _singular(model: Model, pose: Array, q: Array, out: list[list[SceneMark]]) -> None:
    """Add the limbs that are stretched, folded or square to their rail, then the machine."""
    mechanism = model.mechanism
    with np.errstate(invalid="ignore", divide="ignore"):
        value = transmissions_at(model, pose, q)[0]
        whole = smallest_singular_value(model.closure(q), pose)[0]
    for n, i in np.argwhere(value < STRETCHED).tolist():
        limb = mechanism.limbs[i]
        how = ("stands square to its rail" if limb.kind.actuator == "length"
               else "is stretched out or folded")
        out[n].append(SceneMark(kind="stretched", limbs=(i,), text=(
            f"{limb.name} {how}: near a dead point, where its joint no longer moves the platform "
            f"(transmission {number(value[n, i], 2)}, 1 at best)")))
    for n in np.flatnonzero(whole < SINGULAR).tolist():
        if not any(m.kind in ("stretched", "gap") for m in out[n]):
            out[n].append(SceneMark(kind="singular", text=(
                "near a singularity: the drives do not hold the platform (smallest singular value "
                f"{number(float(whole[n]), 2)}, a sound machine has 0.1 to 1)")))


def _beyond_travel(model: Model, q: Array, limbs: Sequence[LimbSkeleton],
                   out: list[list[SceneMark]]) -> None:
    mechanism = model.mechanism
    low, high = mechanism.limits.T
    for n, a in np.argwhere((q < low) | (q > high)).tolist():
        factor, unit = mechanism.joint_units[a]
        ends = " to ".join(number(v / factor) for v in mechanism.limits[a])
        own = tuple(i for i, limb in enumerate(mechanism.limbs) if limb.actuator == a)
        out[n].append(SceneMark(
            kind="travel", limbs=own,
            text=f"{mechanism.actuators[a]} is outside of its travel: {number(q[n, a] / factor)} "
                 f"of {ends} {unit}".rstrip()))


def _too_near(model: Model, limbs: Sequence[LimbSkeleton], out: list[list[SceneMark]]) -> None:
    """Add joints and links of two limbs that are nearer than a link is drawn thick."""
    mechanism = model.mechanism
    for found in interferences(limbs, THICKNESS * mechanism.reach,
                               [limb.actuator for limb in mechanism.limbs]):
        names = " and ".join(limbs[i].name for i in found.limbs)
        for n in np.flatnonzero(np.isfinite(found.distance)).tolist():
            if found.fixed and n:
                continue
            kind, text = ("joints" if found.joints else "links"), (
                f"{'joints' if found.joints else 'links'} of {names} are "
                f"{mechanism.units.words(found.distance[n], 'length', 2)} apart")
            if found.fixed and found.joints and found.distance[n] < 1e-9 * mechanism.reach:
                kind, text = "shared", names
            elif not found.joints and mechanism.motion.planar:
                text = f"links of {names} cross, unless they lie in layers"
            out[n].append(SceneMark.filled(None, mechanism.units, kind=kind, limbs=found.limbs,
                                           text=text, points=[found.place[n]]))
