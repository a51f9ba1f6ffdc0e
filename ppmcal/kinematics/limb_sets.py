"""A machine with some of its limbs: sets that close it exactly, if it has surplus ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np

from ppmcal import linalg
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.mechanism import Mechanism

MOST_COMBINATIONS, MOST_PARTS = 1000, 8
"""Sets of limbs that close a machine: maximum numbers listed, and tried."""
SOUND = 1e-3
"""Smallest singular value at home of sets that are tried."""


@lru_cache(maxsize=64)
def exact_sets(mechanism: Mechanism) -> tuple[tuple[int, ...], ...]:
    """Return minimal sets of limbs that close a machine, best conditioned at home first."""
    sizes = [limb.kind.surface.equations for limb in mechanism.limbs]
    wanted = len(mechanism.dof)
    chosen = []
    every = range(len(sizes))
    a = Model(mechanism).closure(home_state(mechanism).q).pose_matrix(mechanism.home)[0]
    a[:, [c >= 3 for c in mechanism.dof]] /= mechanism.length_scale
    first = np.cumsum([0, *sizes])
    for some in (s for count in every for s in combinations(every, count + 1)
                 if sum(sizes[i] for i in s) == wanted):
        own = a[[r for i in some for r in range(first[i], first[i + 1])]]
        chosen.append((float(linalg.singular_values(own)[-1]), some))
        if len(chosen) > MOST_COMBINATIONS:
            break
    return tuple(some for value, some in sorted(chosen, reverse=True)[:MOST_PARTS] if value > SOUND)


def with_limbs(model: Model, some: Sequence[int]) -> tuple[Model, list[int]]:
    """Return the machine with some of its limbs, and the indices of their actuators."""
    shift = model.shift and replace(model.shift, slots={
        (some.index(i), slot): v for (i, slot), v in model.shift.slots.items() if i in some})
    part, driven = _part_of(model.mechanism, tuple(some))
    return replace(model, shift=shift, mechanism=part), driven


@lru_cache(maxsize=64)
def _part_of(mechanism: Mechanism, some: tuple[int, ...]) -> tuple[Mechanism, list[int]]:
    """Return the machine with some of its limbs; cached, so that its home state is too."""
    chosen = [mechanism.limbs[i] for i in some]
    driven = sorted({limb.actuator for limb in chosen if limb.driven})
    limbs = tuple(replace(limb, actuator=driven.index(limb.actuator)) if limb.driven else limb
                  for limb in chosen)
    part = replace(mechanism, limbs=limbs, actuators=tuple(mechanism.actuators[a] for a in driven),
                   limits=mechanism.limits[driven], home_q=mechanism.home_q[driven], effects=())
    return part, driven
