"""How many rows do not belong, and whether it is a part of them: shares are integrated.

Gross errors come at about their prior. Something else may hit any share, of all rows or of a part.
"""

from __future__ import annotations

import numpy as np
from scipy.special import betaln

from ppmcal.inference.priors import GROSS_ROW, UNKNOWN


def everywhere(count: int, total: int) -> float:
    """Return the odds that ``count`` of ``total`` rows were hit by something, not by gross errors.

    0 where they are fewer than gross errors hit.
    """
    if count <= GROSS_ROW.value * total:
        return 0.0
    odds = UNKNOWN.value / (1.0 - UNKNOWN.value)
    return float(odds * np.exp(_at_any(count, total) - _usual(count, total)))


def in_a_part(hits: int, inside: int, count: int, total: int) -> float:
    """Return the odds that a part of the rows was hit by something, not all alike.

    ``hits`` of the ``inside`` rows of this part, ``count`` of all ``total`` rows. 0 where the
    others are hit as often.
    """
    if hits * total <= count * inside:
        return 0.0
    alike = np.logaddexp(np.log1p(-UNKNOWN.value) + _usual(count, total),
                         np.log(UNKNOWN.value) + _at_any(count, total))
    return float(np.exp(np.log(UNKNOWN.value) + _at_any(hits, inside)
                        + _usual(count - hits, total - inside) - alike))


def _at_any(hits: int, rows: int) -> float:
    """Return the logarithm of the chance of a sequence with so many hits, at any share."""
    return float(betaln(hits + 1.0, rows - hits + 1.0))


def _usual(hits: int, rows: int) -> float:
    """Return the same at the share of gross errors: as if one of 1/share had been seen."""
    seen = 1.0 / GROSS_ROW.value - 1.0
    return float(betaln(hits + 1.0, rows - hits + seen) - betaln(1.0, seen))
