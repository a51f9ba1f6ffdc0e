"""How well a limb's joint moves the platform, and where limbs get too close to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.limb_roots import all_roots
from ppmcal.kinematics.skeleton import FOLD, GUIDE, LimbSkeleton
from ppmcal.linalg import Array
from ppmcal.model.mechanism import PASSIVE


def transmissions_at(model: Model, pose: Array, q: Array) -> tuple[Array, Array]:
    """Return how well each limb's joint moves the platform (N, L), and both roots (N, L, 2).

    Dimensionless, 0 at a dead point (serial singularity: stretched, folded or square to its rail),
    1 at best: the sine of the joint's angle from it, or, for a prismatic joint, the part of its
    motion that goes along the strut. nan where a limb cannot reach, or has no drive.

    Args:
        model: the machine at its parameters.
        pose: platform-to-base motors (N, 8).
        q: joint values there (N, k), SI.
    """
    slope = model.closure(q).joint_matrix(pose, drive=False)
    value, roots, row, known = [], [], 0, all_roots(model, pose)
    for i, limb in enumerate(model.mechanism.limbs):
        pair = known[i][0] if limb.driven else np.full((len(pose), 2), np.nan)
        half = (pair[:, 1] - pair[:, 0]) / 2.0
        value.append(np.abs(slope[:, row, limb.actuator])
                     if limb.driven and limb.kind.actuator == "length" else np.abs(np.sin(half)))
        roots.append(pair)
        row += limb.kind.surface.equations
    return np.stack(value, axis=1), np.stack(roots, axis=1)


@dataclass(frozen=True)
class Interference:
    """Two limbs that get too close to each other.

    Attributes:
        limbs: their indices; joints: whether their joints do, else links.
        distance: of the closest two (N,), m; nan where none are close.
        place: halfway between them (N, 3), m, base axes.
        fixed: whether this is so at every pose, as for two joints on one body.
    """

    limbs: tuple[int, int]
    joints: bool
    distance: Array
    place: Array
    fixed: bool


def interferences(limbs: Sequence[LimbSkeleton], near: float,
                  actuators: Sequence[int]) -> list[Interference]:
    """Return the pairs of limbs whose joints or links are closer than ``near`` m somewhere.

    Links that end in joints which are close count as those joints. Passive slides and spans of
    hinges are not links, and limbs of one actuator belong together.

    Args:
        limbs: as :func:`ppmcal.kinematics.skeleton.skeleton` returns them, N poses.
        near: distance that is too close, m.
        actuators: of each limb.
    """
    out = []
    centres = [np.stack([limb.base_point, *(j.centre for j in limb.joints), limb.platform_point],
                        axis=1) for limb in limbs]
    links = [[(k.start, k.end) for k in limb.links if k.name not in (GUIDE, FOLD)]
             for limb in limbs]
    for i in range(len(limbs)):
        for j in range(i + 1, len(limbs)):
            if actuators[i] == actuators[j] != PASSIVE:
                continue
            a, b = centres[i][:, :, None], centres[j][:, None, :]
            found = _nearest(np.linalg.norm(a - b, axis=-1), (a + b) / 2.0, near)
            if found is not None:
                out.append(Interference((i, j), True, *found))
                continue
            if not links[i] or not links[j]:
                continue
            pairs = [_apart(p, r) for p in links[i] for r in links[j]]
            found = _nearest(np.stack([d for d, _ in pairs], axis=1)[:, :, None],
                             np.stack([m for _, m in pairs], axis=1)[:, :, None], near)
            if found is not None:
                out.append(Interference((i, j), False, *found))
    return out


def _nearest(distance: Array, place: Array, near: float) -> tuple[Array, Array, bool] | None:
    """Return distance (N,) and place (N, 3) of the closest of (N, J, K) pairs, if any is close."""
    rows = np.arange(len(distance))
    flat = distance.reshape(len(rows), -1)
    which = np.argmin(flat, axis=1)
    least = flat[rows, which]
    if not np.any(least < near):
        return None
    fixed = bool(np.ptp(least) < 1e-9 * max(near, 1e-12) + 1e-12) and len(rows) > 1
    return (np.where(least < near, least, np.nan),
            place.reshape(len(rows), -1, 3)[rows, which], fixed)


def _apart(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the distance of two straight pieces (N,) and the midpoint between them (N, 3).

    Each is (start, end), (N, 3). The ends are clamped in turn: exact for pieces in any position.
    """
    (p, p1), (r, r1) = one, other
    d, e, w = p1 - p, r1 - r, p - r
    a, b, c = _dot(d, d), _dot(d, e), _dot(e, e)
    f, g = _dot(d, w), _dot(e, w)
    safe_a, safe_c = np.where(a > 0.0, a, 1.0), np.where(c > 0.0, c, 1.0)
    det = a * c - b * b
    flat = det <= 1e-12 * a * c
    s = np.where(flat, 0.0, np.clip((b * g - c * f) / np.where(flat, 1.0, det), 0.0, 1.0))
    t = np.clip((b * s + g) / safe_c, 0.0, 1.0)
    s = np.clip((b * t - f) / safe_a, 0.0, 1.0)
    x, y = p + s[:, None] * d, r + t[:, None] * e
    return np.linalg.norm(x - y, axis=-1), (x + y) / 2.0


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))
