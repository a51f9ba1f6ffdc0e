"""Common errors of machines of one design: the mean over units, and their spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from ppmcal.calibration.fit import coverage_by
from ppmcal.linalg import Array

FEWEST = 3
"""Fewest machines for statements about what is common."""
CERTAIN = 0.01
"""Chance below which a mean error is not that of units scattered around nominal."""


@dataclass(frozen=True)
class CommonError:
    """The error of one number over n machines of one design, in its unit.

    ``mean`` +- ``half`` at 95 %, ``spread``: standard deviation between units, ``p_value`` of
    a mean of 0, corrected for all numbers tested (Holm).
    """

    machines: int
    mean: float
    half: float
    spread: float
    p_value: float

    @property
    def of_design(self) -> bool:
        """Whether the nominal value is off, rather than single units."""
        return self.p_value < CERTAIN


def common_errors(errors: Sequence[Array]) -> list[CommonError | None]:
    """Return the mean of each number over machines, None if there are too few.

    t = mean sqrt(n)/s with n - 1 degrees of freedom does not use the stated sigmas; shrinkage
    towards nominal by the prior makes it conservative. Source: Holm, Scand. J. Statist. 6 (1979).

    Args:
        errors: value - nominal of each number, one array (n,) for each, any unit.
    """
    found: list[CommonError | None] = []
    for e in errors:
        n = len(e)
        if n < FEWEST:
            found.append(None)
            continue
        mean, s = float(np.mean(e)), float(np.std(e, ddof=1))
        error = s / np.sqrt(n)
        # equal to round-off: there is no spread to judge by
        p = (1.0 if error <= 1e-12 * abs(mean)
             else float(2.0 * special.stdtr(n - 1, -abs(mean) / error)))
        found.append(CommonError(n, mean, error * coverage_by(n - 1), s, p))
    known = sorted(((f.p_value, i, f) for i, f in enumerate(found) if f is not None),
                   key=lambda k: k[:2])
    worst = 0.0
    for rank, (p, i, f) in enumerate(known):
        worst = max(worst, min(1.0, p * (len(known) - rank)))
        found[i] = replace(f, p_value=worst)
    return found


def share_interval(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % interval of a share if ``count`` of ``total`` were seen.

    Source: Clopper, Pearson, Biometrika 26 (1934).
    """
    low = 0.0 if count == 0 else float(special.betaincinv(count, total - count + 1, 0.025))
    high = 1.0 if count == total else float(special.betaincinv(count + 1, total - count, 0.975))
    return low, high
