"""Uncertainty of a position by the GUM: contributions, combined, expanded; and the decision. SI.

The measurand is the error of the platform's position along any one direction, so that each
contribution is that of one coordinate: of several, the root of their mean variance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.special import stdtrit

from ppmcal.commands.certify.about import GUARDED, K2, NONE

COVERED = 0.95
TYPE_A, TYPE_B = "A", "B"
PASS, FAIL = "pass", "fail"


@dataclass(frozen=True)
class Contribution:
    """One line of the budget; ``degrees`` inf where it is taken as known.

    ``sensitivity``: of the measurand to it, bare; ``note``: where the number is from.
    """

    source: str
    kind: str
    distribution: str
    standard: float
    degrees: float
    sensitivity: float = 1.0
    note: str = ""

    @property
    def part(self) -> float:
        """Its contribution to the measurand, m."""
        return abs(self.sensitivity) * self.standard


@dataclass(frozen=True)
class Budget:
    """All contributions; ``coverage`` as the file about the certificate says it."""

    lines: tuple[Contribution, ...]
    coverage: str

    @property
    def combined(self) -> float:
        """The combined standard uncertainty, m."""
        return math.sqrt(sum(c.part**2 for c in self.lines))

    @property
    def degrees(self) -> float:
        """Effective degrees of freedom by Welch and Satterthwaite; inf where all are known."""
        below = sum(c.part**4 / c.degrees for c in self.lines if math.isfinite(c.degrees))
        return self.combined**4 / below if below > 0.0 else math.inf

    @property
    def factor(self) -> float:
        """The coverage factor: 2, or Student's t of whole degrees for 95 %."""
        if self.coverage == K2:
            return 2.0
        degrees = max(math.floor(self.degrees), 1) if math.isfinite(self.degrees) else 1e9
        return float(stdtrit(degrees, 0.5 * (1.0 + COVERED)))

    @property
    def expanded(self) -> float:
        """The expanded uncertainty, m."""
        return self.factor * self.combined


def decided(rule: str, value: float, limit: float | None, expanded: float
            ) -> tuple[str, float | None]:
    """Return pass or fail, and the acceptance limit; both empty without a rule.

    Guarded acceptance keeps a guard band of the expanded uncertainty below the limit.
    """
    if rule == NONE or limit is None:
        return "", None
    accepted = limit - expanded if rule == GUARDED else limit
    return PASS if value <= accepted else FAIL, accepted


def of_repeats(sums: Sequence[tuple[float, int]]) -> tuple[float, float]:
    """Return the pooled standard deviation of (sum of squares, degrees), and all degrees."""
    degrees = sum(n for _, n in sums)
    return (math.sqrt(sum(s for s, _ in sums) / degrees) if degrees else math.nan), float(degrees)
