"""95 % intervals of reported error figures: rms, 95 % point, differences of rms.

Rows at one commanded pose share the model's error there, so poses are resampled, not rows. What a
registration to the same rows absorbed of the errors is restored by its degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import bdtr, ndtr, stdtrit

from ppmcal.calibration.fit import coverage_by
from ppmcal.inference.priors import SURE
from ppmcal.linalg import Array, Ints

FEWEST = 3
"""Fewest poses for an interval."""
DRAWS = 2000
AT_ONCE = 1_000_000
"""Maximum number of drawn poses held at once: more draws are repeated for each machine."""
LONGEST = 10.0
"""Half width of the logarithm beyond which an interval is useless and counts as unknown."""


def rms_interval(squares: Array, groups: Ints, kept: float = 1.0) -> tuple[float, float]:
    """Return the 95 % interval of the rms that more such poses would have; nan: unknown.

    The logarithm of the mean square is taken as Student's t with as many degrees as poses less
    one, times the part kept; its standard error is the scatter of the poses' own sums.

    Args:
        squares: squared errors of rows (R,).
        groups: commanded pose of each row (R,).
        kept: part of the degrees of freedom that fits to these rows left, 0 to 1.
    """
    sums, counts = _by_pose(squares, groups)
    poses, mean = counts.size, float(squares.mean()) if squares.size else 0.0
    if poses < FEWEST or kept <= 0.0:
        return np.nan, np.nan
    if mean <= 0.0:
        return 0.0, 0.0
    # for a ratio of sums over poses with different numbers of rows
    away = (sums - mean * counts) / (mean * counts.mean())
    error = float(np.sqrt(np.sum(away**2) / (poses * (poses - 1.0))))
    kept = min(kept, 1.0)
    reach = 0.5 * error * coverage_by(kept * (poses - 1.0))
    if reach > LONGEST:
        return np.nan, np.nan
    reach, middle = np.exp(reach), np.sqrt(mean / kept)
    return float(middle / reach), float(middle * reach)


def quantile_interval(values: Array, groups: Ints, share: float) -> tuple[float, float]:
    """Return the 95 % interval of a quantile, by order statistics alone; an open end is nan.

    Ranks are those of as many independent values as there are poses: for the 95 % point fewer
    than 72 give no upper end.
    """
    poses = np.unique(groups).size
    tail = 0.5 * (1.0 - SURE.value)
    # the binomial distribution: scipy.stats has its inverse but takes a second to load
    chance = bdtr(np.arange(poses + 1.0), poses, share)
    low, high = np.searchsorted(chance, [tail, 1.0 - tail]).tolist()
    ordered = np.sort(values)
    # in whole numbers: as fractions, ranks would be off by one now and then
    below = low * ordered.size // poses - 1
    above = -(-(high + 1) * ordered.size // poses) - 1
    return (float(ordered[below]) if below >= 0 else np.nan,
            float(ordered[above]) if above < ordered.size else np.nan)


class RmsDraws:
    """Draws of poses with replacement, the same for all machines that are compared."""

    def __init__(self, groups: Ints, seed: int) -> None:
        """Draw from the poses of rows (R,)."""
        self.groups, self.seed = groups, seed
        self.poses = np.unique(groups).size

    def _blocks(self) -> Iterator[Ints]:
        """Yield the poses of some draws (d, G), the same each time; never many at once."""
        rng = np.random.default_rng(self.seed)
        size = max(1, AT_ONCE // self.poses)
        for begin in range(0, DRAWS, size):
            yield rng.integers(self.poses, size=(min(size, DRAWS - begin), self.poses))

    def rms(self, squares: Array) -> Array:
        """Return the rms of squared errors (R,) in every draw (D,)."""
        sums, counts = _by_pose(squares, self.groups)
        return np.concatenate([np.sqrt(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1))
                               for drawn in self._blocks()])

    def interval(self, values: Array, together: int = 1) -> tuple[float, float]:
        """Return the 95 % interval of draws (D,), widened because few poses scatter too little.

        ``together``: number of intervals that hold simultaneously (Bonferroni).

        Percentiles at the levels of Student's t in place of the normal distribution's, with the
        variance's n / (n - 1): T. Hesterberg, The American Statistician 69 (2015), section 4.2.
        """
        n = self.poses
        if n < FEWEST:
            return -np.inf, np.inf
        level = 1.0 - 0.5 * (1.0 - SURE.value) / together
        tail = float(ndtr(-np.sqrt(n / (n - 1.0)) * stdtrit(n - 1.0, level)))
        low, high = np.quantile(values, [tail, 1.0 - tail])
        return float(low), float(high)


def _by_pose(squares: Array, groups: Ints) -> tuple[Array, Array]:
    """Return the sums of rows' values (R,) and the number of rows, by pose (G,)."""
    _, place = np.unique(groups, return_inverse=True)
    place = place.reshape(-1)
    return (np.asarray(np.bincount(place, weights=squares), dtype=float),
            np.asarray(np.bincount(place), dtype=float))
