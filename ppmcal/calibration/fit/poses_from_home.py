"""Poses reached from home, cached.

A campaign's poses at the machine's present values start its fit, and are needed again where the
nominal machine is registered and judged. Reaching them is most of the cost for few rows, above all
with surplus limbs, and depends neither on what is free nor on row weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

MOST = 16384
"""At most this many rows are kept: for more, compiled loops take less than the memory is worth."""


@dataclass(eq=False)
class PosesFromHome:
    """Poses (N, 8) of some machines at joint values (N, k), the latest last."""

    known: list[tuple[Model, Array, Array]] = field(default_factory=list)

    def of(self, model: Model, q: Array, solve: Callable[[], Array]) -> Array:
        """Return poses (N, 8) at joint values ``q`` (N, k), from the cache or else by ``solve``.

        With effects they depend on more than joint values, and are not kept.
        """
        if model.mechanism.effects or len(q) > MOST:
            return solve()
        for other, joints, poses in self.known:
            if _alike(model, other) and np.array_equal(joints, q, equal_nan=True):
                return poses.copy()
        poses = solve()
        self.known.append((model, q.copy(), poses.copy()))
        while sum(len(joints) for _, joints, _ in self.known) > MOST:
            del self.known[0]
        return poses


def _alike(one: Model, other: Model) -> bool:
    """Whether two models have their limbs, and their home, in the same places."""
    a, b = one.mechanism, other.mechanism
    return _defined_alike(a, b) and np.array_equal(one.parameters, other.parameters)


def _defined_alike(a: Mechanism, b: Mechanism) -> bool:
    """Whether two machines differ in nothing but prior information about the parameters."""
    return a is b or (a.limbs is b.limbs and a.motion is b.motion and a.gaps == b.gaps
                      and np.array_equal(a.home_pose, b.home_pose)
                      and np.array_equal(a.home_q, b.home_q, equal_nan=True)
                      and np.array_equal(a.values, b.values))
