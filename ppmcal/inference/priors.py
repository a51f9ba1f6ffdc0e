"""Every number that decides what is in the data, each with its reason.

No other module, inside or outside this package, contains a number of this kind.
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy.special import ndtri


@dataclass(frozen=True)
class Prior:
    """A number that decides: ``value``, and the ``reason`` for it."""

    value: float
    reason: str

    def __float__(self) -> float:
        return self.value


SMALLEST_SIZE = Prior(0.03, "detecting an effect of 0.03 sigma rms takes 10,000 values")
LARGEST_SIZE = Prior(3000.0, "larger effects make fits fail; ten times more would cost 0.2 nats")
NOISE_FREEDOM = Prior(30.0, "a stated sigma is as good as one from 30 values, within 13 %")
OWN_NOISE_FREEDOM = Prior(5.0, "noise estimated before effects are named includes them: the true "
                               "noise may be half of the estimate")
FURTHER = Prior(1 / 4, "after one event, or one affected joint, a second is likely: one in four")
CORRELATED = Prior(1 / 2, "noise is as often correlated from row to row as not")

WIDE = Prior(1e3, "frames, targets and offsets: unknown, but within 1000 natural units")
FAMILY = Prior(1 / 50, "some 30 families; about one calibration in three shows some effect")
MOVED = Prior(1 / 10, "joints are rehomed, instruments, beds and bodies set up again between "
                      "sessions: one of these five has moved in every second pair of sessions")
WITHIN = Prior(3.0, "how often machines have an effect is known only to within a factor of three")
ALL_ALIKE = Prior(1 / 2, "actuators are built alike: in half the machines all have what one has")
UNKNOWN = Prior(0.15, "libraries are incomplete: one machine in seven has an unlisted effect")
PLAIN = Prior(1 / 2, "half of the effects have an optional property (late, stiffer under load)")
GOES_WITH = Prior(1 / 10, "one effect in ten depends on temperature or travel in its size")
SELDOM = Prior(1 / 10, "a plate is stiffer than its legs: only in one machine in ten it bends")
MISREAD = Prior(1 / 200, "one column in two hundred has a unit or sign other than stated")
GROSS_ROW = Prior(1 / 100, "one row in a hundred is a wrong point, a typo, or a broken beam")
FIRST_READING = Prior(1 / 10, "limbs settle when first pulled: of 796 places where a router's "
                              "belts were read, the first reading differed in one in ten")
NO_WEIGHT = Prior(1 / 20, "a row of little weight is left out: it would change nothing")
MOST_GROSS = Prior(1 / 4, "if more than a quarter of the rows are outliers, they are not outliers")

SHAPES = Prior(1 / 3, "a third of unlisted effects is one worn place, dent or kink of a travel")
UNSETTLED = Prior(1 / 2, "a starting state that may change half of an effect counts as unknown")
SURE = Prior(0.95, "a sure statement is right 19 times in 20, like an interval")
COUNTS = Prior(1 / 100, "sets less probable than this change no prediction and no command")

CORRELATIONS = (0.3, 0.5, 0.7, 0.85, 0.95)
"""Possible correlations of noise from row to row, with equal priors."""
SIZE_STEPS = 34
"""Points between the smallest and the largest size: about two per factor of two."""


SURE_ODDS = SURE.value / (1.0 - SURE.value)
SURE_SIGMAS = float(ndtri(SURE.value))
"""The same as odds, and as one-sided standard errors."""


def sure(odds: float) -> bool:
    """Return whether odds are high enough for a sure statement."""
    return odds > SURE_ODDS


def table() -> dict[str, Prior]:
    """Return all priors by name, in the order above."""
    return {name: value for name, value in globals().items() if isinstance(value, Prior)}
