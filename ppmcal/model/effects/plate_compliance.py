"""A base or platform that bends where the legs push on it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    ScanRange,
    Terms,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.setting import Setting, Shift, total

PARTS = ("base", "platform")
BEYOND = 40.0
"""Distance in reaches beyond which nothing bends: exp(-800) is 0; a reach may be very small."""


def _pushed(setting: Setting, part: str, points: Array) -> Array:
    """Return the force on each joint centre of a body, in its axes (N, limbs, 3).

    A plate in space bends only along its normal, that of the plane nearest to its joint centres;
    in its plane it is stiffer by the square of its slenderness.
    """
    force = setting.forces
    if part == "platform":
        force = -np.einsum("nij,nli->nlj", setting.turn, force)
    if not setting.motion.turns_freely:
        return force
    at = points[0] - points[0].mean(axis=0)
    normal = linalg.svd(at, full=True)[2][-1]
    return np.asarray((force @ normal)[..., None] * normal)


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Displacement of centre i = give sum over j of exp(-(d_ij/reach)^2/2) f_j."""
    reach = values["reach"]
    by: dict[str, Shift] = {}
    wider: list[Shift] = []
    for part in PARTS:
        points = setting.points(part)
        push = _pushed(setting, part, points)
        distance = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
        apart = np.minimum(distance, BEYOND * abs(reach)) / abs(reach)
        field = np.exp(-0.5 * apart**2)
        by[part] = _shift(setting, part, field @ push)
        wider.append(_shift(setting, part, (field * apart**2 / reach) @ push).times(values[part]))
    return Terms(total([by[part].times(values[part]) for part in PARTS if values[part] != 0.0]),
                 {**by, "reach": total(wider)})


def _shift(setting: Setting, part: str, moved: Array) -> Shift:
    """Return displacements of a body's joint centres (N, limbs, 3) as a shift of slots."""
    return Shift({(i, name): moved[:, i, "xyz".index(name[-1])]
                  for i, limb in enumerate(setting.limbs) for name in getattr(limb, part)})


COUPLED = 0.6
"""Below this part of the distance to the nearest joint, where a force still moves that one by 25 %,
each joint deflects by itself: a compliance of the limb with its seat."""


def _reaches(data: ScanRange) -> list[float]:
    """Return parts of the largest distance between two joint centres."""
    return [part * data.size for part in (0.3, 0.6, 0.9)
            if part * data.size >= COUPLED * data.near > 0.0] if data.size > 0.0 else []


PLATE_COMPLIANCE = register(EffectKind(
    "plate_compliance", "joint centre i moves by give sum_j exp(-(d_ij/reach)^2/2) f_j",
    "influence function of a plate or half space (Boussinesq): the displacement falls smoothly "
    "with the distance d from the force",
    fixed_list(*(EffectParameter(part, "length/N", low=0.0, usual=(0.0, 0.1),
                                 why="stiffer than 10 N/m, as drives are", size=1e-9)
                 for part in PARTS),
               EffectParameter("reach", "length", None, low=1e-6, reciprocal=True, scan=_reaches)),
    ("wrench",), _terms, per_actuator=False, uses_load=True, one_by_one=True, seldom=True,
    remedy="measure base and platform near a joint with an indicator while applying the payload",
    worked=Worked({"base": 1e-8, "platform": 0.0, "reach": 0.1}, {"forces": 200.0, "base": 0.3},
                  2e-6)))
