"""What may be wrong where one thing goes by another, in mm: all of it is in no library."""

from __future__ import annotations

import numpy as np
from odd_campaign import Campaign


def leaning_stand(c: Campaign) -> None:
    """The stand leans where two legs are long at once."""
    lean = c.along(0) * c.along(1)
    c.seen[:, 0] += 0.05 * lean
    c.seen[:, 1] -= 0.03 * lean


def loose_bearing(c: Campaign) -> None:
    """A leg snaps over where its neighbour has passed the middle of its travel."""
    c.joints[:, 0] += 0.08 * np.sign(c.along(1))


def long_way(c: Campaign) -> None:
    """A leg is off by how far the whole platform came."""
    came = np.linalg.norm(np.diff(c.place, axis=0, prepend=c.place[:1]), axis=1)
    c.joints[:, 1] += 0.25 * came / came.max()


def loaded_step(c: Campaign) -> None:
    """A screw's worn half gives way under load only."""
    c.joints[:, 2] += 0.02 * c.payload * (c.along(2) > 0.0)


def wave_of_another(c: Campaign) -> None:
    """A leg has the wave of its neighbour's screw."""
    c.joints[:, 0] += 0.09 * np.sin(2.0 * np.pi * c.joints[:, 1] / 7.0)


def counterweight(c: Campaign) -> None:
    """What is carried pulls the target sideways, the more the farther out it is."""
    c.seen[:, 1] += 0.02 * c.payload * c.away(0)


def cold_corner(c: Campaign) -> None:
    """A stand bends by temperature, on one side of the workspace only."""
    c.seen[:, 0] += 0.06 * (c.warmth - c.warmth.mean()) * (c.away(1) > 0.0)


def fading_wave(c: Campaign) -> None:
    """A wave of a screw that wears off as it is run in."""
    wear = np.exp(-np.arange(len(c.joints)) / (0.4 * len(c.joints)))
    c.joints[:, 1] += 0.15 * wear * np.sin(2.0 * np.pi * c.joints[:, 1] / 6.0)
