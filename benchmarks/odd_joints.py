"""What may be wrong with a machine's joints, in mm: most of it is in no library."""

from __future__ import annotations

import numpy as np
from odd_campaign import Campaign


def ball_out_of_round(c: Campaign) -> None:
    """A ball is longer in two directions of the platform's way."""
    c.joints[:, 2] += 0.12 * np.cos(2.0 * np.arctan2(c.away(1), c.away(0)))


def product(c: Campaign) -> None:
    """A leg gives way by the lengths of two others at once."""
    c.joints[:, 0] += 0.15 * c.along(1) * c.along(2)


def stick_slip(c: Campaign) -> None:
    """A leg stays behind by chance, always to one side."""
    c.joints[:, 1] += 0.12 * np.abs(c.rng.standard_normal(len(c.joints)))


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


def unlike_heat(c: Campaign) -> None:
    """Legs grow by the square of how warm it is, each by another amount."""
    for joint in range(c.joints.shape[1]):
        c.joints[:, joint] -= 0.006 * (joint + 1.0) * (c.warmth - 20.0) ** 2


def settling(c: Campaign) -> None:
    """A leg jumps after a third of the rows, and creeps back."""
    since = np.arange(len(c.joints)) - len(c.joints) // 3
    c.joints[:, 2] += np.where(since >= 0, 0.3 * np.exp(-np.maximum(since, 0) / 12.0), 0.0)


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


def ratchet(c: Campaign) -> None:
    """A coupling gives a little each time a leg turns back, and keeps it."""
    back = np.diff(np.sign(c.way(1)), prepend=0.0) != 0.0
    c.joints[:, 1] += 0.006 * np.cumsum(back)


def move_before_last(c: Campaign) -> None:
    """A leg stands by the direction of the move before the last."""
    c.joints[1:, 0] += 0.08 * np.sign(c.way(0)[:-1])


def twist(c: Campaign) -> None:
    """A plate is wrung by two legs: a third is off by the square of their difference."""
    c.joints[:, 2] += 0.08 * (c.along(0) - c.along(1)) ** 2


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


def reversal(c: Campaign) -> None:
    """A leg turns back late: in the library."""
    c.joints[:, 1] += 0.06 * np.sign(c.way(1))


def homed_anew(c: Campaign) -> None:
    """A leg is homed anew half way: in the library."""
    c.joints[len(c.joints) // 2:, 1] += 0.15


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


def heat_and_turn(c: Campaign) -> None:
    """Heat bends the platform: a leg is off by the warmth times the platform's turn."""
    angle = c.turn.as_rotvec()
    c.joints[:, 1] += 0.04 * (c.warmth - 20.0) * np.linalg.norm(angle, axis=1) / (
        np.linalg.norm(angle, axis=1).max() or 1.0)


def shaking(c: Campaign) -> None:
    """A leg shakes at one length."""
    c.joints[:, 0] += 0.3 * np.exp(-((c.along(0) - 0.5) / 0.4) ** 2) * c.rng.standard_normal(
        len(c.joints))


def slackening(c: Campaign) -> None:
    """A screw gives in the middle third of the campaign."""
    c.joints[:, 2] += 0.2 * np.clip(3.0 * np.linspace(0.0, 1.0, len(c.joints)) - 1.0, 0.0, 1.0)


def side_under_load(c: Campaign) -> None:
    """A leg turns back late, but only under load."""
    c.joints[:, 1] += 0.1 * np.sign(c.way(1)) * (c.payload > 6.0)


def staircase(c: Campaign) -> None:
    """A drive loses a little with each turn of its motor, and knows it not."""
    c.joints[:, 0] += 0.06 * np.floor((c.joints[:, 0] - c.joints[:, 0].min()) / 9.0)


def wave_under_load(c: Campaign) -> None:
    """A screw runs out by its payload."""
    c.joints[:, 2] += 0.012 * c.payload * np.sin(2.0 * np.pi * c.joints[:, 2] / 6.0)


def hot_only(c: Campaign) -> None:
    """Legs grow once a cooler no longer keeps up, each by another amount."""
    for joint in range(c.joints.shape[1]):
        c.joints[:, joint] -= 0.03 * (1.0 + joint) * np.maximum(c.warmth - 21.0, 0.0)


def three_ago(c: Campaign) -> None:
    """A leg is off by where it was three rows ago."""
    c.joints[3:, 1] += 0.06 * c.along(1)[:-3]


def three_at_once(c: Campaign) -> None:
    """A leg gives by its length, its payload and how late it is, all at once."""
    c.joints[:, 0] += 0.02 * c.along(0) * c.payload * np.linspace(0.0, 1.0, len(c.joints))
