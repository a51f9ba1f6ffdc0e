"""The springs of a machine: bars, drives and joint frames that give way under load.

[LIN] section 3.2 (eq. 18) gives every elementary motion of a joint's frame a spring of its
own. A bar's acts along the limb's contact line, a drive's in the joint coordinate u.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Closure
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

EXAMPLE = "stiffness: {bar: 5e4, drive: 2e5}"


@dataclass(frozen=True)
class Spring:
    """One spring: whose it is, which part (``bar``, ``drive``, ``joint1.x``), compliance.

    ``owner`` is the limb's name, or the actuator's where several limbs share the drive;
    ``limb`` the index of the (first) limb. ``compliance``: m/N or rad/(N m).
    """

    owner: str
    limb: int
    part: str
    compliance: float


def springs_of(mechanism: Mechanism) -> tuple[Spring, ...]:
    """Return the machine's springs, limb by limb.

    A drive is one spring in the joint coordinate u of its actuator: limbs that share an
    actuator share it, as they do the effect ``compliance``.

    Raises:
        BadInput: no part has a stiffness.
    """
    out = []
    for i, (limb, parts) in enumerate(zip(mechanism.limbs, mechanism.stiffness, strict=False)):
        sharing = [j for j, x in enumerate(mechanism.limbs) if x.actuator == limb.actuator]
        for part, value in parts.items():
            owner = limb.name
            if part == "drive" and len(sharing) > 1:
                if i != sharing[0]:
                    continue
                owner = mechanism.actuators[limb.actuator]
            out.append(Spring(owner, i, part, 1.0 / value))
    if not out:
        units = mechanism.units
        raise BadInput("no part of the machine has a stiffness: everything is rigid",
                       f"{mechanism.source}: stiffness",
                       f"Add a line such as `{EXAMPLE}` (bar: {units.name('N/length')}; drive: "
                       f"{units.name('N/length')}, or {units.name('N.m/angle')} where it turns)")
    return tuple(out)


def spring_columns(closure: Closure, pose: Array, lines: Array, springs: Sequence[Spring]) -> Array:
    """Return dc/d(spring) (N, d, S) at closed poses (N, 8).

    A bar moves the limb's first closure equation by its own length change; a drive those of
    all limbs on its actuator; a joint's spring the frame component of that name.
    """
    mechanism = closure.model.mechanism
    out = np.zeros((len(pose), mechanism.equations, len(springs)))
    drives = closure.joint_matrix(pose, lines)
    first = np.cumsum([0, *(len(body.point_moves) for body in closure.bodies)])
    for i, limb in enumerate(mechanism.limbs):
        mine = {s.part: column for column, s in enumerate(springs) if s.limb == i}
        if "bar" in mine:
            out[:, first[i], mine["bar"]] = 1.0
        if "drive" in mine:
            # per unit of this limb's u: q moves all limbs on the actuator
            ratio = closure.model.limb_values[i].get("ratio", 1.0)
            out[:, :, mine["drive"]] = drives[:, :, limb.actuator] / ratio
        joints = [p for p in mine if p not in ("bar", "drive")]
        if joints:
            out[:, :, [mine[p] for p in joints]] = closure.slot_matrix(pose, i, joints, lines)
    return out
