"""How platforms move: each motion is one declaration, and everything else follows from it.

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
"""The largest rotation from home considered: about one axis, and about all three."""


@dataclass(frozen=True)
class Motion:
    """The coordinates in which a platform moves; the others stay fixed.

    Attributes:
        name: as in files.
        coordinates: names among :data:`POSE_COORDINATES`, in their order; rotations about no
            axis, about z, or about all.
        planar: whether base, limbs and instruments are in the x-y plane: then the base has the
            coordinates x, y, rz in the measuring frame, otherwise all six.
    """

    name: str
    coordinates: tuple[str, ...]
    planar: bool = False

    def __post_init__(self) -> None:
        """Reject unsupported sets of coordinates (ValueError)."""
        own = tuple(c for c in POSE_COORDINATES if c in self.coordinates)
        turns = own[sum(c[0] != "r" for c in own):]
        if own != self.coordinates or turns not in ((), ("rz",), POSE_COORDINATES[3:]) or (
                self.planar and not set(own) <= set(IN_PLANE)):
            raise ValueError(f"motion '{self.name}' has unsupported coordinates "
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
        """Whether the platform rotates at all."""
        return self.dof[-1] > 2

    @property
    def turns_freely(self) -> bool:
        """Whether it rotates about all axes, so that poses have a rotation vector."""
        return "rx" in self.coordinates

    @property
    def axes(self) -> int:
        """Number of coordinates of a point: 2 in the plane, otherwise 3."""
        return 2 if self.planar else 3

    @property
    def frame_parts(self) -> tuple[int, ...]:
        """Indices of the coordinates of base and target relative to the instrument."""
        return (0, 1, 5) if self.planar else (0, 1, 2, 3, 4, 5)

    @property
    def frame_coordinates(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(POSE_COORDINATES[i] for i in self.frame_parts)

    @property
    def measured_turns(self) -> tuple[int, ...]:
        """Indices of the rotation components that a full-pose instrument measures.

        In space all three, even if the platform rotates about one axis of the base: the
        instrument's frame and the measured body may be tilted. None if the platform cannot rotate.
        """
        return tuple(i for i in self.frame_parts if i > 2) if self.turns else ()

    @property
    def measured_parts(self) -> tuple[int, ...]:
        """Indices of the coordinates that a full-pose instrument measures, positions first."""
        return (*range(self.axes), *self.measured_turns)

    @property
    def measures_rotation_vectors(self) -> bool:
        """Whether a measured rotation has all three components."""
        return len(self.measured_turns) == 3

    @property
    def largest_turn(self) -> float:
        """The largest rotation from home in a box of poses, rad."""
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
"""The motions of this package."""


def motion_names(planar: bool | None = None) -> list[str]:
    """Return the names of all motions, or of those in the plane or in space."""
    return [m.name for m in motions().values() if planar is None or m.planar == planar]
