"""What may be wrong with what is read of a platform, in mm: most of it is in no library."""

from __future__ import annotations

import numpy as np
from odd_campaign import Array, Campaign


def _heading(c: Campaign) -> Array:
    """Return the direction of the platform's last move (N, 3), 0 in the first row."""
    way = np.diff(c.place, axis=0, prepend=c.place[:1])
    return np.asarray(way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9))


def lens(c: Campaign) -> None:
    """A camera's picture is bent outwards, by the cube of the distance from its middle."""
    flat = c.place[:, :2] - c.place[:, :2].mean(axis=0)
    reach = np.abs(flat).max()
    c.seen[:, :2] += 0.3 * flat / reach * np.sum((flat / reach) ** 2, axis=1, keepdims=True)


def refraction(c: Campaign) -> None:
    """Y reads long by the square of the distance."""
    c.seen[:, 1] += 0.3 * c.away(1) ** 2


def walk(c: Campaign) -> None:
    """The stand wanders."""
    c.seen[:, 0] += 0.04 * np.cumsum(c.rng.standard_normal(len(c.seen)))


def lags_by_speed(c: Campaign) -> None:
    """The measurement lags behind by the way from the row before."""
    way = np.linalg.norm(np.diff(c.place, axis=0, prepend=c.place[:1]), axis=1)
    c.seen[:, 0] += 0.2 * way / way.max()


def square_heat(c: Campaign) -> None:
    """Y reads long by the square of how warm it is."""
    c.seen[:, 1] += 0.02 * (c.warmth - 20.0) ** 2


def saddle(c: Campaign) -> None:
    """X reads long in two corners and short in the others."""
    c.seen[:, 0] += 0.2 * c.away(0) * c.away(1)


def swaying(c: Campaign) -> None:
    """The stand sways twice in the campaign."""
    c.seen[:, 1] += 0.1 * np.sin(4.0 * np.pi * np.linspace(0.0, 1.0, len(c.seen)))


def floor_step(c: Campaign) -> None:
    """The stand drops on one side, as if it stood on two plates."""
    c.seen[:, 1] += 0.15 * (c.away(0) > 0.2)


def next_move(c: Campaign) -> None:
    """Readings are early: they hold a part of the move to come."""
    ahead = np.diff(c.place, axis=0, append=c.place[-1:])
    c.seen += 0.002 * ahead


def bowl(c: Campaign) -> None:
    """Y reads long by the fourth power of the distance from the middle."""
    c.seen[:, 1] += 0.25 * (c.away(0) ** 2 + c.away(1) ** 2) ** 2


def late_axis(c: Campaign) -> None:
    """X is read late, y is not."""
    c.seen[:, 0] -= 0.004 * np.diff(c.place[:, 0], prepend=c.place[0, 0])


def sag_by_place(c: Campaign) -> None:
    """A table gives way to the payload the more, the farther out it stands."""
    c.seen[:, 1] -= 0.02 * c.payload * (1.0 + c.away(0))


def magnet(c: Campaign) -> None:
    """Steel bends the field of an instrument about one place."""
    far = (c.away(0) - 0.3) ** 2 + (c.away(1) + 0.2) ** 2
    c.seen[:, 0] += 0.3 * np.exp(-far / 0.18)


def warm_scale(c: Campaign) -> None:
    """The scale of y changes with the square of how warm it is."""
    c.seen[:, 1] += 0.02 * c.away(1) * (c.warmth - 20.0) ** 2


def sun(c: Campaign) -> None:
    """The sun shines on the tripod for a while."""
    when = np.linspace(0.0, 1.0, len(c.seen))
    c.seen[:, 0] += 0.15 * np.exp(-0.5 * ((when - 0.6) / 0.08) ** 2)


def pressed_middle(c: Campaign) -> None:
    """An instrument reads x short in the middle of its range, and long at its ends."""
    c.seen[:, 0] += 0.2 * (c.away(0) - np.tanh(3.0 * c.away(0)))


def drying_glue(c: Campaign) -> None:
    """A target gives way to the payload, the less the later."""
    c.seen[:, 1] -= 0.02 * c.payload * np.linspace(1.0, 0.0, len(c.seen))


def two_clocks(c: Campaign) -> None:
    """X is read a little early, y a little late."""
    c.seen[:, 0] += 0.002 * np.diff(c.place[:, 0], append=c.place[-1, 0])
    c.seen[:, 1] -= 0.002 * np.diff(c.place[:, 1], prepend=c.place[0, 1])


def bursts(c: Campaign) -> None:
    """Now and then some rows in a row are off together, by chance."""
    for begin in c.rng.integers(0, len(c.seen) - 6, 4):
        c.seen[begin:begin + 5] += 0.1 * c.rng.standard_normal(3) * np.array([1.0, 1.0, 0.0])


def dragged(c: Campaign) -> None:
    """A hose drags the platform back against its last move."""
    c.seen -= 0.08 * _heading(c)


def turns_back_in_y(c: Campaign) -> None:
    """X is off by the side from which the platform came in y."""
    c.seen[:, 0] += 0.08 * np.sign(_heading(c)[:, 1])


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


def tilting_floor(c: Campaign) -> None:
    """Far out on one side the floor tilts: y is off by the signed square of x."""
    c.seen[:, 1] += 0.2 * c.away(0) * np.abs(c.away(0))


def crooked_corner(c: Campaign) -> None:
    """X reads long in corners, by the third power of one side and the other side."""
    c.seen[:, 0] += 0.3 * c.away(0) ** 3 * c.away(1)


def running_late(c: Campaign) -> None:
    """Readings come late, the more the longer the campaign."""
    late = np.linspace(0.0, 0.006, len(c.seen))[:, None]
    c.seen -= late * np.diff(c.place, axis=0, prepend=c.place[:1])
