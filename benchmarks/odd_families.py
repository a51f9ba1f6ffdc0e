"""What may be wrong with a machine or its measurement: most of it is in no library.

Each changes the joints' values or what is seen of the platform, by tenths of a millimetre.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from odd_afterwards import AFTERWARDS, AFTERWARDS_RIGHT
from odd_campaign import SIGMA, Campaign


def nothing(_: Campaign) -> None:
    """Do nothing."""


def lens(c: Campaign) -> None:
    """A camera's picture is bent outwards, by the cube of the distance from its middle."""
    flat = c.place[:, :2] - c.place[:, :2].mean(axis=0)
    reach = np.abs(flat).max()
    c.seen[:, :2] += 0.3 * flat / reach * np.sum((flat / reach) ** 2, axis=1, keepdims=True)


def refraction(c: Campaign) -> None:
    """Y reads long by the square of the distance."""
    c.seen[:, 1] += 0.3 * c.away(1) ** 2


def ball_out_of_round(c: Campaign) -> None:
    """A ball is longer in two directions of the platform's way."""
    c.joints[:, 2] += 0.12 * np.cos(2.0 * np.arctan2(c.away(1), c.away(0)))


def product(c: Campaign) -> None:
    """A leg gives way by the lengths of two others at once."""
    c.joints[:, 0] += 0.15 * c.along(1) * c.along(2)


def stick_slip(c: Campaign) -> None:
    """A leg stays behind by chance, always to one side."""
    c.joints[:, 1] += 0.12 * np.abs(c.rng.standard_normal(len(c.joints)))


def walk(c: Campaign) -> None:
    """The stand wanders."""
    c.seen[:, 0] += 0.04 * np.cumsum(c.rng.standard_normal(len(c.seen)))


def dent(c: Campaign) -> None:
    """A screw has a dent."""
    c.joints[:, 1] += 0.3 * np.exp(-0.5 * ((c.along(1) - 0.5) / 0.25) ** 2)


def two_steps(c: Campaign) -> None:
    """Two legs have a step in their screws."""
    for joint in (0, 2):
        c.joints[:, joint] += 0.2 * np.tanh(4.0 * (c.along(joint) - 0.3))


def crooked_wave(c: Campaign) -> None:
    """A wave of a screw with its third harmonic: the first is in the library."""
    angle = 2.0 * np.pi * c.joints[:, 2] / 5.0
    c.joints[:, 2] += 0.08 * np.sin(angle) + 0.05 * np.sin(3.0 * angle + 1.0)


def lags_by_speed(c: Campaign) -> None:
    """The measurement lags behind by the way from the row before."""
    way = np.linalg.norm(np.diff(c.place, axis=0, prepend=c.place[:1]), axis=1)
    c.seen[:, 0] += 0.2 * way / way.max()


def some_rows(c: Campaign) -> None:
    """A leg is off in every seventh row, by chance."""
    off = np.arange(len(c.joints)) % 7 == 3
    c.joints[off, 0] += 0.15 * c.rng.standard_normal(int(off.sum()))


def late_heat(c: Campaign) -> None:
    """Legs grow as it was warm some time ago."""
    late = np.zeros(len(c.joints))
    for row in range(1, late.size):
        late[row] = late[row - 1] + 0.06 * (c.warmth[row] - 20.0 - late[row - 1])
    c.joints -= 0.05 * late[:, None]


def square_heat(c: Campaign) -> None:
    """Y reads long by the square of how warm it is."""
    c.seen[:, 1] += 0.02 * (c.warmth - 20.0) ** 2


def square_load(c: Campaign) -> None:
    """A leg gives way with the square of the payload."""
    c.joints[:, 1] += 0.002 * c.payload**2


def creep(c: Campaign) -> None:
    """A leg creeps by the logarithm of time."""
    c.joints[:, 2] += 0.08 * np.log1p(np.arange(len(c.joints)) / 5.0)


def cross_talk(c: Campaign) -> None:
    """A leg's drive is moved by its neighbour's, more at one end than at the other."""
    c.joints[:, 0] += 0.08 * np.exp(0.5 * c.along(1))


def swelling_wave(c: Campaign) -> None:
    """A wave of a pitch that nobody listed, that grows along the stroke."""
    c.joints[:, 1] += 0.06 * (1.0 + 0.5 * c.along(1)) * np.sin(2.0 * np.pi * c.joints[:, 1] / 3.7)


def chirp(c: Campaign) -> None:
    """A wave that turns faster along the stroke."""
    c.joints[:, 0] += 0.08 * np.sin(3.0 * (c.along(0) + 2.0) ** 2)


def coarse(c: Campaign) -> None:
    """A scale is read to 0.2 mm."""
    c.joints[:, 2] = np.round(c.joints[:, 2] / 0.2) * 0.2


def loaded_reversal(c: Campaign) -> None:
    """A leg turns back the later, the more it carries."""
    c.joints[:, 1] += 0.01 * c.payload * np.sign(c.way(1))


def by_way(c: Campaign) -> None:
    """A leg is off by the root of the way that it came."""
    c.joints[:, 0] += 0.015 * np.sqrt(np.abs(c.way(0))) * np.sign(c.way(0))


def saddle(c: Campaign) -> None:
    """X reads long in two corners and short in the others."""
    c.seen[:, 0] += 0.2 * c.away(0) * c.away(1)


def swaying(c: Campaign) -> None:
    """The stand sways twice in the campaign."""
    c.seen[:, 1] += 0.1 * np.sin(4.0 * np.pi * np.linspace(0.0, 1.0, len(c.seen)))


def floor_step(c: Campaign) -> None:
    """The stand drops on one side, as if it stood on two plates."""
    c.seen[:, 1] += 0.15 * (c.away(0) > 0.2)


def homed_often(c: Campaign) -> None:
    """A leg is homed every ten rows, each time elsewhere."""
    zeros = 0.08 * c.rng.standard_normal(len(c.joints) // 10 + 1)
    c.joints[:, 2] += zeros[np.arange(len(c.joints)) // 10]


def hinge(c: Campaign) -> None:
    """A base joint is out of round: a leg is off by twice the angle at which it leans."""
    c.joints[:, 1] += 0.15 * np.sin(2.0 * np.arctan2(c.away(1) + 0.3, c.away(0) - 0.4))


def interpolation(c: Campaign) -> None:
    """An encoder interpolates badly within a line of 0.02 mm."""
    c.joints[:, 0] += 0.05 * np.sin(2.0 * np.pi * c.joints[:, 0] / 0.02)


def sharp_bend(c: Campaign) -> None:
    """A rail has a kink in its middle."""
    c.joints[:, 1] += 0.15 * np.abs(c.along(1))


def next_move(c: Campaign) -> None:
    """Readings are early: they hold a part of the move to come."""
    ahead = np.diff(c.place, axis=0, append=c.place[-1:])
    c.seen += 0.002 * ahead


def bowl(c: Campaign) -> None:
    """Y reads long by the fourth power of the distance from the middle."""
    c.seen[:, 1] += 0.25 * (c.away(0) ** 2 + c.away(1) ** 2) ** 2


def beat(c: Campaign) -> None:
    """A leg trembles from row to row, nearly in step with the rows."""
    c.joints[:, 0] += 0.08 * np.sin(2.3 * np.arange(len(c.joints)))


def slips(c: Campaign) -> None:
    """A belt slips a little at eight rows."""
    steps = np.zeros(len(c.joints))
    steps[c.rng.choice(np.arange(5, steps.size - 5), 8, replace=False)] = 0.08
    c.joints[:, 2] += np.cumsum(steps * np.sign(c.rng.standard_normal(steps.size)))


def warm_end(c: Campaign) -> None:
    """Heat bends a leg the more, the farther it is out, by the square of both."""
    c.joints[:, 0] += 0.01 * (c.along(0) + 2.0) ** 2 * (c.warmth - 20.0) ** 2 / 4.0


def late_axis(c: Campaign) -> None:
    """X is read late, y is not."""
    c.seen[:, 0] -= 0.004 * np.diff(c.place[:, 0], prepend=c.place[0, 0])


def sag_by_place(c: Campaign) -> None:
    """A table gives way to the payload the more, the farther out it stands."""
    c.seen[:, 1] -= 0.02 * c.payload * (1.0 + c.away(0))


def unlike_heat(c: Campaign) -> None:
    """Legs grow by the square of how warm it is, each by another amount."""
    for joint in range(c.joints.shape[1]):
        c.joints[:, joint] -= 0.006 * (joint + 1.0) * (c.warmth - 20.0) ** 2


def settling(c: Campaign) -> None:
    """A leg jumps after a third of the rows, and creeps back."""
    since = np.arange(len(c.joints)) - len(c.joints) // 3
    c.joints[:, 2] += np.where(since >= 0, 0.3 * np.exp(-np.maximum(since, 0) / 12.0), 0.0)


def magnet(c: Campaign) -> None:
    """Steel bends the field of an instrument about one place."""
    far = (c.away(0) - 0.3) ** 2 + (c.away(1) + 0.2) ** 2
    c.seen[:, 0] += 0.3 * np.exp(-far / 0.18)


def half_a_reversal(c: Campaign) -> None:
    """A leg turns back late in one half of its stroke."""
    c.joints[:, 0] += 0.08 * np.sign(c.way(0)) * (c.along(0) > 0.0)


def every_other(c: Campaign) -> None:
    """Every other row a leg is somewhere else."""
    c.joints[::2, 1] += 0.12


def end_of_stroke(c: Campaign) -> None:
    """A leg does not quite reach its end."""
    c.joints[:, 1] -= 0.25 * np.maximum(c.along(1) - 0.8, 0.0)


def geared(c: Campaign) -> None:
    """A leg's drive takes its neighbour's along by a little, and in waves."""
    c.joints[:, 0] += 0.06 * c.along(1) + 0.06 * np.sin(3.0 * c.along(2))


def warm_scale(c: Campaign) -> None:
    """The scale of y changes with the square of how warm it is."""
    c.seen[:, 1] += 0.02 * c.away(1) * (c.warmth - 20.0) ** 2


def ratchet(c: Campaign) -> None:
    """A coupling gives a little each time a leg turns back, and keeps it."""
    back = np.diff(np.sign(c.way(1)), prepend=0.0) != 0.0
    c.joints[:, 1] += 0.006 * np.cumsum(back)


def move_before_last(c: Campaign) -> None:
    """A leg stands by the direction of the move before the last."""
    c.joints[1:, 0] += 0.08 * np.sign(c.way(0)[:-1])


def sun(c: Campaign) -> None:
    """The sun shines on the tripod for a while."""
    when = np.linspace(0.0, 1.0, len(c.seen))
    c.seen[:, 0] += 0.15 * np.exp(-0.5 * ((when - 0.6) / 0.08) ** 2)


def twist(c: Campaign) -> None:
    """A plate is wrung by two legs: a third is off by the square of their difference."""
    c.joints[:, 2] += 0.08 * (c.along(0) - c.along(1)) ** 2


def pressed_middle(c: Campaign) -> None:
    """An instrument reads x short in the middle of its range, and long at its ends."""
    c.seen[:, 0] += 0.2 * (c.away(0) - np.tanh(3.0 * c.away(0)))


def warming_up(c: Campaign) -> None:
    """All legs come to rest within some twenty rows, one way or the other."""
    for joint in range(c.joints.shape[1]):
        c.joints[:, joint] += 0.1 * (-1.0) ** joint * np.exp(-np.arange(len(c.joints)) / 10.0)


def bent_nut(c: Campaign) -> None:
    """A screw runs out by as much as another leg is out."""
    c.joints[:, 2] += 0.06 * c.along(0) * np.sin(2.0 * np.pi * c.joints[:, 2] / 5.0)


def touching_cover(c: Campaign) -> None:
    """A cover is touched where two legs are out at once."""
    c.joints[:, 1] -= 0.15 * np.maximum(c.along(0) + c.along(1) - 1.0, 0.0)


def drying_glue(c: Campaign) -> None:
    """A target gives way to the payload, the less the later."""
    c.seen[:, 1] -= 0.02 * c.payload * np.linspace(1.0, 0.0, len(c.seen))


def two_clocks(c: Campaign) -> None:
    """X is read a little early, y a little late."""
    c.seen[:, 0] += 0.002 * np.diff(c.place[:, 0], append=c.place[-1, 0])
    c.seen[:, 1] -= 0.002 * np.diff(c.place[:, 1], prepend=c.place[0, 1])


def noise_far(c: Campaign) -> None:
    """Far away readings scatter up to five times as much."""
    c.seen += 4.0 * SIGMA * np.abs(c.away(0))[:, None] * c.rng.standard_normal(c.seen.shape)


def noise_late(c: Campaign) -> None:
    """In the second half readings scatter four times as much."""
    half = len(c.seen) // 2
    c.seen[half:] += 4.0 * SIGMA * c.rng.standard_normal(c.seen[half:].shape)


def noise_of_joints(c: Campaign) -> None:
    """All joints scatter."""
    c.joints += 2.0 * SIGMA * c.rng.standard_normal(c.joints.shape)


def noise_along(c: Campaign) -> None:
    """Readings scatter along one slanted direction: the beam of a tracker."""
    c.seen += 4.0 * SIGMA * c.rng.standard_normal((len(c.seen), 1)) * np.array([0.6, 0.8, 0.0])


def noise_loaded(c: Campaign) -> None:
    """Under load readings scatter five times as much."""
    c.seen += 0.5 * SIGMA * c.payload[:, None] * c.rng.standard_normal(c.seen.shape)


def few_digits(c: Campaign) -> None:
    """Places are read to 0.1 mm."""
    c.seen = np.round(c.seen, 1)


def bursts(c: Campaign) -> None:
    """Now and then some rows in a row are off together, by chance."""
    for begin in c.rng.integers(0, len(c.seen) - 6, 4):
        c.seen[begin:begin + 5] += 0.1 * c.rng.standard_normal(3) * np.array([1.0, 1.0, 0.0])


def reversal(c: Campaign) -> None:
    """A leg turns back late: in the library."""
    c.joints[:, 1] += 0.06 * np.sign(c.way(1))


def homed_anew(c: Campaign) -> None:
    """A leg is homed anew half way: in the library."""
    c.joints[len(c.joints) // 2:, 1] += 0.15


UNLISTED = (lens, refraction, ball_out_of_round, product, stick_slip, walk, dent, two_steps,
            crooked_wave, lags_by_speed, some_rows, late_heat, square_heat, square_load, creep,
            cross_talk, swelling_wave, chirp, coarse, loaded_reversal, by_way, saddle, swaying,
            bursts, floor_step, homed_often, hinge, interpolation, sharp_bend, next_move, bowl,
            beat, slips, warm_end, late_axis, sag_by_place, unlike_heat, settling, magnet,
            half_a_reversal, every_other, end_of_stroke, geared, warm_scale,
            ratchet, move_before_last, sun, twist, pressed_middle, warming_up, bent_nut,
            touching_cover, drying_glue, two_clocks)
NOISE = (noise_far, noise_late, noise_of_joints, noise_along, few_digits, noise_loaded)
LISTED = (reversal, homed_anew)
FAMILIES: dict[str, Callable[[Campaign], None]] = {
    do.__name__: do for do in (nothing, *UNLISTED, *AFTERWARDS, *NOISE, *LISTED)}
GROUPS = {"nothing": (nothing,), "what no library has": UNLISTED,
          "the same, made up afterwards": AFTERWARDS,
          "noise that is not as stated": NOISE, "what the library has": LISTED}
REVERSAL = {"backlash", "play", "hysteresis"}
RIGHT: dict[str, set[str]] = {"crooked_wave": {"periodic"}, "swelling_wave": {"periodic"},
         "reversal": REVERSAL, "loaded_reversal": REVERSAL, "homed_anew": {"zero_shift"},
         "bursts": {"target_shift", "base_shift"},
         "bent_nut": {"periodic"},
         "homed_often": {"zero_shift"}, "slips": {"zero_shift"}, "settling": {"zero_shift"},
         "half_a_reversal": REVERSAL, "sag_by_place": {"base_compliance"},
         "lens": {"sensor_scale", "sensor_scale_axis"},
         **AFTERWARDS_RIGHT}
"""Kinds that are part of what was done."""
