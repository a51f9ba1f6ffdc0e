"""What may be wrong too, of :mod:`odd_families`: made up when the engine's causes stood."""

from __future__ import annotations

import numpy as np
from odd_campaign import SIGMA, Array, Campaign


def heading(c: Campaign) -> Array:
    """Return the direction of the platform's last move (N, 3), 0 in the first row."""
    way = np.diff(c.place, axis=0, prepend=c.place[:1])
    return np.asarray(way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9))


def dragged(c: Campaign) -> None:
    """A hose drags the platform back against its last move."""
    c.seen -= 0.08 * heading(c)


def turns_back_in_y(c: Campaign) -> None:
    """X is off by the side from which the platform came in y."""
    c.seen[:, 0] += 0.08 * np.sign(heading(c)[:, 1])


def heated_by_use(c: Campaign) -> None:
    """A screw grows by the way that it made, and cools."""
    heat, way = np.zeros(len(c.joints)), np.abs(c.way(1))
    for row in range(1, heat.size):
        heat[row] = 0.9 * heat[row - 1] + way[row] / max(float(way.mean()), 1e-9)
    c.joints[:, 1] += 0.02 * heat


def two_waves(c: Campaign) -> None:
    """A gear's two wheels: waves of nearly one pitch, of one leg."""
    turns = 2.0 * np.pi * c.joints[:, 0]
    c.joints[:, 0] += 0.06 * np.sin(turns / 7.0) + 0.06 * np.sin(turns / 6.1)


def rolling_plate(c: Campaign) -> None:
    """A plate gives way: a leg is off by how far the platform is turned, squared."""
    angle = c.turn.as_rotvec()
    scale = np.abs(angle).max() or 1.0
    c.joints[:, 2] += 0.2 * (np.linalg.norm(angle, axis=1) / scale) ** 2 + 0.1 * c.away(0) ** 2


def loose_under_load(c: Campaign) -> None:
    """A leg scatters the more, the more it carries."""
    c.joints[:, 0] += 0.02 * c.payload * c.rng.standard_normal(len(c.joints))


def dead_zone(c: Campaign) -> None:
    """A leg does not follow the first part of a move."""
    c.joints[:, 1] += np.clip(0.3 * c.way(1) / max(float(np.abs(c.way(1)).max()), 1e-9),
                              -0.1, 0.1)


def bumpy_bed(c: Campaign) -> None:
    """Z, or y where there is no z, reads in bumps over the table."""
    axis = 2 if np.ptp(c.place[:, 2]) > 0.0 else 1
    c.seen[:, axis] += 0.08 * np.sin(5.0 * c.away(0)) * np.sin(5.0 * c.away(1))


def clipped(c: Campaign) -> None:
    """An instrument saturates: beyond it x reads short."""
    c.seen[:, 0] -= 0.3 * np.maximum(c.away(0) - 0.4, 0.0)


def warm_morning(c: Campaign) -> None:
    """A stand leans the more, the faster it warms up."""
    rate = np.gradient(np.convolve(np.pad(c.warmth, 8, mode="edge"), np.ones(17) / 17.0, "valid"))
    c.seen[:, 0] += 0.12 * rate / np.abs(rate).max()


def two_targets(c: Campaign) -> None:
    """Now one reflector is measured, now the other, by chance, and they do not sit alike."""
    c.seen[c.rng.random(len(c.seen)) < 0.3, 0] += 0.12


def opposite_pair(c: Campaign) -> None:
    """Two legs of one drive: what one is long the other is short, in waves of their sum."""
    wave = 0.08 * np.sin(2.0 * (c.along(0) + c.along(1)))
    c.joints[:, 0] += wave
    c.joints[:, 1] -= wave


def wrong_rows_of_joint(c: Campaign) -> None:
    """A drive loses steps now and then, and is set right two rows later."""
    for begin in c.rng.choice(len(c.joints) - 3, 9, replace=False):
        c.joints[begin:begin + 2, 2] += 0.15


def tired_spring(c: Campaign) -> None:
    """A spring that balances the payload tires: all legs give, the more the later."""
    late = np.linspace(0.0, 1.0, len(c.joints))
    c.joints += 0.015 * (c.payload * late)[:, None]


def scatter_by_way(c: Campaign) -> None:
    """After long moves readings scatter more: the platform still swings."""
    way = np.linalg.norm(np.diff(c.place, axis=0, prepend=c.place[:1]), axis=1)
    c.seen += 4.0 * SIGMA * (way / way.max())[:, None] * c.rng.standard_normal(c.seen.shape)


AFTERWARDS = (dragged, turns_back_in_y, heated_by_use, two_waves, rolling_plate, loose_under_load,
              dead_zone, bumpy_bed, clipped, warm_morning, two_targets, opposite_pair,
              wrong_rows_of_joint, tired_spring, scatter_by_way)
"""Run once."""
AFTERWARDS_RIGHT: dict[str, set[str]] = {
    "two_waves": {"periodic"},
    "dead_zone": {"backlash", "play", "hysteresis"}, "wrong_rows_of_joint": {"zero_shift"}}
"""Kinds that are part of what was done."""
