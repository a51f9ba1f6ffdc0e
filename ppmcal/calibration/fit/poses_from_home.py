"""Poses led from home, kept for whoever asks for the same ones again.

A campaign's poses at the machine's present values start its fit, and are asked for again where the
nominal machine is registered and judged. Leading them there is what few rows cost most, above all
those of surplus limbs, and neither what is free nor how rows weigh changes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.led_rows import alike
from ppmcal.linalg import Array

MOST = 16384
"""So many rows are kept: more are made by compiled loops, in less time than memory is worth."""


@dataclass(eq=False)
class PosesFromHome:
    """Poses (N, 8) of some machines at joint values (N, k), the latest last."""

    known: list[tuple[Model, Array, Array]] = field(default_factory=list)

    def of(self, model: Model, q: Array, solve: Callable[[], Array]) -> Array:
        """Return poses (N, 8) at joint values ``q`` (N, k), by ``solve`` where they are not known.

        With effects they depend on more than joint values, and are not kept.
        """
        if model.mechanism.effects or len(q) > MOST:
            return solve()
        for other, joints, poses in self.known:
            if alike(model, other) and np.array_equal(joints, q, equal_nan=True):
                return poses.copy()
        poses = solve()
        self.known.append((model, q.copy(), poses.copy()))
        while sum(len(joints) for _, joints, _ in self.known) > MOST:
            del self.known[0]
        return poses
