"""How platforms move: each motion is one declaration, from which all that depends on it follows.

Other packages add motions through the entry-point group ``ppmcal.motions``: an entry loads a
:class:`Motion`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ppmcal.linalg import Array
from ppmcal.model.registry import Registry

POSE_COORDINATES = ("x", "y", "z", "rx", "ry", "rz")
IN_PLANE = ("x", "y", "rz")
ONE_AXIS, ALL_AXES = np.radians(45.0), np.radians(15.0)
"""The largest turn from home that is looked at: about one axis, and about all three."""


@dataclass(frozen=True)
class Motion:
    """The coordinates that a platform has; it keeps the others.

    Attributes:
        name: as in files.
        coordinates: names among :data:`POSE_COORDINATES`, in their order; turns about no axis,
            about z, or about all.
        planar: whether base, limbs and instruments are in the x-y plane: then the base has the
            coordinates x, y, rz in the measuring frame, else all six.
    """

    name: str
    coordinates: tuple[str, ...]
    planar: bool = False

    def __post_init__(self) -> None:
        """Refuse coordinates that nothing here could compute with (ValueError)."""
        own = tuple(c for c in POSE_COORDINATES if c in self.coordinates)
        turns = own[sum(c[0] != "r" for c in own):]
        if own != self.coordinates or turns not in ((), ("rz",), POSE_COORDINATES[3:]) or (
                self.planar and not set(own) <= set(IN_PLANE)):
            raise ValueError(f"motion '{self.name}' has the coordinates "
                             f"{', '.join(self.coordinates)}")

    def __str__(self) -> str:
        """Return the name."""
        return self.name

    @cached_property
    def dof(self) -> tuple[int, ...]:
        """Indices of the coordinates in the full pose x, y, z, rx, ry, rz."""
        return tuple(POSE_COORDINATES.index(c) for c in self.coordinates)

    @property
    def turns(self) -> bool:
        """Whether the platform turns at all."""
        return self.dof[-1] > 2

    @property
    def turns_freely(self) -> bool:
        """Whether it turns about all axes, so that poses have a rotation vector."""
        return "rx" in self.coordinates

    @property
    def axes(self) -> int:
        """Coordinates of a point: 2 in the plane, else 3."""
        return 2 if self.planar else 3

    @property
    def frame_parts(self) -> tuple[int, ...]:
        """Indices of the coordinates that base and target have towards the instrument."""
        return (0, 1, 5) if self.planar else (0, 1, 2, 3, 4, 5)

    @property
    def frame_coordinates(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(POSE_COORDINATES[i] for i in self.frame_parts)

    @property
    def measured_turns(self) -> tuple[int, ...]:
        """Indices of what an instrument for whole poses measures of a rotation.

        In space all of it, also where the platform turns about one axis of the base: the
        instrument's frame and the measured body may be tilted. Nothing where nothing turns.
        """
        return tuple(i for i in self.frame_parts if i > 2) if self.turns else ()

    @property
    def measured_parts(self) -> tuple[int, ...]:
        """Indices of what an instrument for whole poses measures, positions first."""
        return (*range(self.axes), *self.measured_turns)

    @property
    def measures_rotation_vectors(self) -> bool:
        """Whether a measured rotation has all three components."""
        return len(self.measured_turns) == 3

    @property
    def largest_turn(self) -> float:
        """By how much a box of poses turns the platform from home at most, rad."""
        return ALL_AXES if self.turns_freely else ONE_AXIS if self.turns else 0.0

    @property
    def gravity(self) -> Array:
        """The usual direction of weight in base axes (3,)."""
        return np.array([0.0, -1.0, 0.0] if self.planar else [0.0, 0.0, -1.0])


_REGISTRY: Registry[Motion] = Registry("motion", "ppmcal.motions")
register, motions, find_motion = _REGISTRY.register, _REGISTRY.kinds, _REGISTRY.find

PLANAR_POINT = register(Motion("planar-point", ("x", "y"), planar=True))
PLANAR = register(Motion("planar", IN_PLANE, planar=True))
TRANSLATIONAL = register(Motion("translational", ("x", "y", "z")))
SCHOENFLIES = register(Motion("schoenflies", ("x", "y", "z", "rz")))
SPATIAL = register(Motion("spatial", POSE_COORDINATES))
OWN = tuple(_REGISTRY.own().values())
"""Those of this package."""


def motion_names(planar: bool | None = None) -> list[str]:
    """Return the names of all motions, or of those in the plane or in space."""
    return [m.name for m in motions().values() if planar is None or m.planar == planar]
