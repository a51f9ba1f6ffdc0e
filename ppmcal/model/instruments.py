"""What instruments measure: kinds whose readings are one number, and which machines they fit."""

from __future__ import annotations

from ppmcal.errors import BadInput
from ppmcal.model.motions import Motion

SCALARS = {"plane": 2, "distance": 0}
"""Instruments that measure one number, and its place among x, y, z, rx, ry, rz."""
NUMBERS = {"plane": "height", "distance": "distance"}
"""What that number is called, as a column and among the sigmas."""


def refuse_flat(kind: str, motion: Motion, source: str) -> None:
    """Refuse heights of a machine that has none.

    Raises:
        BadInput: touches of a flat by a planar machine; ``source``: the file that says so.
    """
    if kind == "plane" and motion.planar:
        raise BadInput("a planar machine cannot touch a flat: it has no z",
                       f"{source}: instrument.kind", "Use pose, position or distance")
