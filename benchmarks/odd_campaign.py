"""One campaign of a machine of :mod:`odd_physics`, which odd physics changes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
SIGMA, ANGLE = 0.015, 0.004
"""Of the instrument, mm and degrees."""


@dataclass
class Campaign:
    """What a machine did, mm and rad.

    ``place`` (N, 3), ``turn`` (N): where the platform was; ``seen`` (N, 3): where it is measured to
    be; ``joints`` (N, k): what the drives say; ``warmth`` (N,), K, and ``payload`` (N,), kg: what
    else is recorded; ``rng``: chance.
    """

    place: Array
    turn: Rotation
    joints: Array
    warmth: Array
    payload: Array
    rng: np.random.Generator
    seen: Array = field(init=False)

    def __post_init__(self) -> None:
        self.seen = self.place.copy()

    def along(self, joint: int) -> Array:
        """Return a joint's travel in standard deviations (N,)."""
        own = self.joints[:, joint]
        return np.asarray((own - own.mean()) / own.std())

    def away(self, axis: int) -> Array:
        """Return how far the platform was along an axis, from -1 to 1 (N,)."""
        own = self.place[:, axis] - self.place[:, axis].mean()
        return np.asarray(own / np.abs(own).max())

    def way(self, joint: int) -> Array:
        """Return how far a joint came from the row before (N,), 0 in the first."""
        own = self.joints[:, joint]
        return np.asarray(np.diff(own, prepend=own[0]))
