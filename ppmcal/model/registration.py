"""Where an instrument stands: measured = frame o pose o target."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.plain import Rows
from ppmcal.units import Quantity

FIRST_POSE = "the first pose"
"""Defines a frame by the nominal machine at the first pose."""


@dataclass(frozen=True)
class DefinedFrame:
    """What defines a base frame that is given, and how well.

    Attributes:
        by: what defines it: ``three points``, or :data:`FIRST_POSE`.
        covariance: of the base's motion in the measuring frame (6, 6), displacement and rotation
            about the base's origin, base axes, m and rad.
    """

    by: str
    covariance: Annotated[Rows, Quantity(of="motion", square=True)]
    motion: ClassVar = ("length",) * 3 + ("angle",) * 3

    @property
    def size(self) -> float:
        """Rough variance of a point 1 m away: of two frames the larger one is less certain."""
        return float(np.trace(self.covariance))


@dataclass(frozen=True)
class Registration:
    """Where the instrument of one data set stands, SI; by default it measures in the base frame.

    Attributes:
        frame: motor of the base in the measuring frame (8,).
        target: the measured point in platform axes (3,).
        target_rotation: rotation vector of the measured body against the platform (3,).
        homing: shift of the joint values of this file (k,), unit of q; 0 () if there is none.
            Specific to one session, so model files do not keep it.
        scale: lengths that the instrument shows over true ones.
        offset: reading of an encoder at a joint minus the true value, rad or m; per session too.

    Several machines that are registered together have frames (M, 8) and targets (M, 3).
    """

    frame: Array = field(default_factory=cga.identity_motor)
    target: Array = field(default_factory=lambda: np.zeros(3))
    target_rotation: Array = field(default_factory=lambda: np.zeros(3))
    homing: Array = field(default_factory=lambda: np.zeros(()))
    scale: float = 1.0
    offset: float = 0.0

    @classmethod
    def of_pose(cls, frame: Array, target: Array | None = None,
                target_rotation: Array | None = None, scale: float = 1.0) -> Registration:
        """Return the registration of a frame in file form: x, y, z, rotation vector (6,)."""
        made = cls(cga.motor_from_rotation_vector(frame[3:], frame[:3]),
                   np.zeros(3) if target is None else target,
                   np.zeros(3) if target_rotation is None else target_rotation, scale=scale)
        # kept, so that reading and writing a file again is exact to the last bit
        made.__dict__["frame_pose"] = frame
        return made

    @cached_property
    def frame_pose(self) -> Array:
        """The base's pose in the measuring frame, x, y, z, rotation vector (6,), m and rad."""
        return np.concatenate([cga.translation(self.frame), cga.rotation_vector(self.frame)],
                              axis=-1)
