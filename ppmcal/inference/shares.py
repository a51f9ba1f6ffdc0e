"""How many rows are outliers, and whether they are in one part: the share is integrated.

Gross errors occur at about their prior rate. Other causes may affect any share of a part or of all.
"""

from __future__ import annotations

import numpy as np
from scipy.special import betaln

from ppmcal.inference.priors import GROSS_ROW, UNKNOWN


def everywhere(count: int, total: int) -> float:
    """Return the odds that ``count`` of ``total`` rows have a cause other than gross errors.

    0 if there are fewer than gross errors would explain.
    """
    if count <= GROSS_ROW.value * total:
        return 0.0
    odds = UNKNOWN.value / (1.0 - UNKNOWN.value)
    return float(odds * np.exp(_at_any(count, total) - _usual(count, total)))


def in_a_part(hits: int, inside: int, count: int, total: int) -> float:
    """Return the odds that outliers are concentrated in a part of the rows.

    ``hits`` of the ``inside`` rows of this part, ``count`` of all ``total`` rows. 0 if the other
    rows are affected at least as often.
    """
    if hits * total <= count * inside:
        return 0.0
    alike = np.logaddexp(np.log1p(-UNKNOWN.value) + _usual(count, total),
                         np.log(UNKNOWN.value) + _at_any(count, total))
    return float(np.exp(np.log(UNKNOWN.value) + _at_any(hits, inside)
                        + _usual(count - hits, total - inside) - alike))


def _at_any(hits: int, rows: int) -> float:
    """Return the log probability of a sequence with this many hits, at any share."""
    return float(betaln(hits + 1.0, rows - hits + 1.0))


def _usual(hits: int, rows: int) -> float:
    """Return the same at the rate of gross errors, as if one in 1/rate rows had been observed."""
    seen = 1.0 / GROSS_ROW.value - 1.0
    return float(betaln(hits + 1.0, rows - hits + seen) - betaln(1.0, seen))
