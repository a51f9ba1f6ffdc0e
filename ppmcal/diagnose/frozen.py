"""Geometry that the fit may not change, as hypotheses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.diagnose.forms import GEOMETRY, Collector, Form
from ppmcal.diagnose.system import System
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift
from ppmcal.model.parameters import is_joint_component


def frozen_slots(to: Collector, tried: Sequence[int]) -> None:
    """Add every frozen slot, and those that were freed to be tried."""
    problem = to.system.problem
    effects = {p for e in problem.mechanism.effects for p in e.parameters.values()}
    taken = (set(problem.free) - set(tried)) | effects
    for p, parameter in enumerate(problem.mechanism.parameters):
        if p in taken or parameter.per_unit or is_joint_component(parameter.name):
            continue
        shifts = [slot_shift(to.system, p) for _ in to.system.parts]
        limbs = [limb for limb in problem.mechanism.limbs
                 if any(i == p for _, i in limb.slots.direct)
                 or any(p in (r, a) for _, _, r, a in limb.slots.polar)]
        on = tuple(dict.fromkeys(to.actuators[limb.actuator] for limb in limbs))
        column = to.shifted(shifts)
        to.forms.append(Form(GEOMETRY, on, True, (parameter.name,), (-np.inf,), (np.inf,),
                               (column,), slot=parameter.name))


def slot_shift(system: System, parameter: int) -> Shift:
    """Return the shift of all slots that a parameter feeds, per unit of it."""
    slots: dict[tuple[int, str], Array] = {}
    for i, limb in enumerate(system.problem.mechanism.limbs):
        fed, used = limb.slots.feeds({parameter})
        if not used:
            continue
        chain = limb.slots.jacobian(system.state.g, fed, [parameter])[:, 0]
        for slot, d in zip(fed, chain, strict=True):
            slots[i, slot] = np.array([d])
    return Shift(slots)
