"""Where an instrument stands: measured = frame o pose o target."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array


@dataclass(frozen=True)
class Registration:
    """Where the instrument of one data set stands, SI; the default sees the platform in the base.

    Attributes:
        frame: the base's pose in the measuring frame, x, y, z, rotation vector (6,).
        target: the measured point in platform axes (3,).
        target_rotation: rotation vector of the measured body against the platform (3,).
        homing: shift of the joint values of this file (k,), unit of q; 0 () where there is none.
            Of one session, so that model files do not keep it.

    Several machines that are registered together have frames (M, 6) and targets (M, 3).
    """

    frame: Array = field(default_factory=lambda: np.zeros(6))
    target: Array = field(default_factory=lambda: np.zeros(3))
    target_rotation: Array = field(default_factory=lambda: np.zeros(3))
    homing: Array = field(default_factory=lambda: np.zeros(()))

    @cached_property
    def frame_motor(self) -> Array:
        """The frame as a motor (8,)."""
        return cga.motor_from_rotation_vector(self.frame[..., 3:], self.frame[..., :3])
