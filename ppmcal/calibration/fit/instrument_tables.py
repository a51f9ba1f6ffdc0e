"""What an instrument sees, as numbers for the compiled path."""

from __future__ import annotations

from typing import NamedTuple

from ppmcal.linalg import Array, Ints

TARGET, TURN, SCALE = 6, 9, 12
"""Where parts of a registration begin; those of the frame come first."""


class InstrumentTables(NamedTuple):
    """What an instrument sees from where it stands.

    ``frame`` (12,): rotation row by row and translation; ``frame_rotor``, ``body`` (4,): rotors of
    the frame and of the measured body; ``target`` (3,); ``slope`` (9,): left Jacobian of the body's
    rotation vector; ``about`` (3,): the frame's pivot; ``scale`` of lengths; ``planar``: rotations
    are angles about z; ``coordinates`` (m,): which of x, y, z, rx, ry, rz are measured; ``parts``
    (f,): open parts, 0-5 of the frame, then target, turn and scale.
    """

    frame: Array
    frame_rotor: Array
    body: Array
    target: Array
    slope: Array
    about: Array
    scale: float
    planar: bool
    coordinates: Ints
    parts: Ints
