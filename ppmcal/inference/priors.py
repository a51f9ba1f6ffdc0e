"""Every number that decides what is in the data, each with its reason.

Nothing else of the package, and nobody outside it, holds a number of this kind.
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


SMALLEST_SIZE = Prior(0.03, "an effect of 0.03 sigma rms needs 10,000 values to be seen at all")
LARGEST_SIZE = Prior(3000.0, "beyond it fits fail; ten times more of it would cost 0.2 nats")
NOISE_FREEDOM = Prior(30.0, "a stated sigma is as good as one of 30 values, within 13 %")
OWN_NOISE_FREEDOM = Prior(5.0, "noise estimated before anything is named holds what is missing: it "
                               "may be half of what was found")
FURTHER = Prior(1 / 4, "where one thing happened, or one joint has it, a second may: one in four")
CORRELATED = Prior(1 / 2, "noise from row to row is as often correlated as it is not")

WIDE = Prior(1e3, "frames, targets and offsets: known to nobody, yet within 1000 natural units")
FAMILY = Prior(1 / 50, "some 30 families; of three calibrations about one shows an effect of some")
MOVED = Prior(1 / 10, "joints are homed, instruments, beds, bodies set up anew between sessions: "
                      "of these five one has moved in every second pair")
WITHIN = Prior(3.0, "nobody knows how often machines have an effect better than within three times")
ALL_ALIKE = Prior(1 / 2, "actuators are built alike: what one has, all have, in half the machines")
UNKNOWN = Prior(0.15, "libraries are not complete: one machine in seven does what nobody listed")
PLAIN = Prior(1 / 2, "what an effect may have beside (late, harder under load), half of them have")
GOES_WITH = Prior(1 / 10, "one effect in ten has a size that goes with temperature or travel")
SELDOM = Prior(1 / 10, "a plate is stiffer than its legs: in one machine of ten it is what bends")
MISREAD = Prior(1 / 200, "one column in two hundred is in another unit or sign than is said")
GROSS_ROW = Prior(1 / 100, "one row in a hundred is a wrong point, a typo, or a broken beam")
FIRST_READING = Prior(1 / 10, "limbs settle as they are first pulled: of 796 places where a "
                              "router's belts were read, one in ten was read otherwise at first")
NO_WEIGHT = Prior(1 / 20, "a row that hardly counts is left out: by it nothing would move")
MOST_GROSS = Prior(1 / 4, "where more than a quarter of the rows do not belong, the others are it")

SHAPES = Prior(1 / 3, "of what nobody listed a third is one worn place, dent or kink of a travel")
UNSETTLED = Prior(1 / 2, "a start that may change half of an effect is not known")
SURE = Prior(0.95, "what is called sure is right 19 times in 20, like an interval")
COUNTS = Prior(1 / 100, "sets less probable than this change no prediction and no command")

CORRELATIONS = (0.3, 0.5, 0.7, 0.85, 0.95)
"""Correlations from row to row that noise may have; with the same prior each."""
SIZE_STEPS = 34
"""Points between the smallest and the largest size: three to the factor of two or so."""


SURE_ODDS = SURE.value / (1.0 - SURE.value)
SURE_SIGMAS = float(ndtri(SURE.value))
"""The same as odds, and as standard errors to one side."""


def sure(odds: float) -> bool:
    """Return whether odds for something are enough to tell it."""
    return odds > SURE_ODDS


def table() -> dict[str, Prior]:
    """Return all of them by name, as they stand above."""
    return {name: value for name, value in globals().items() if isinstance(value, Prior)}
