"""Simulated noise for thresholds: normal, or with the heavy tails that the residuals have.

What a few large errors do to the smallest of a thousand tests is not what normal noise does:
where the residuals have more kurtosis than chance gives, whole rows of them are drawn instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppmcal.diagnose.system import System, Whitening
from ppmcal.linalg import Array

HEAVY = 3.0
"""Tails are heavy where the kurtosis is so many standard deviations above that of normal noise."""
ENOUGH = 100
"""Fewer values than this show no tails."""
LEAST_FREE = 0.05


def simulated(noise: Whitening, system: System, basis: Array, left: Array, count: int,
          rng: np.random.Generator) -> Array:
    """Return simulated noise (N m, count) after a whitening that knows ``rho`` only so well.

    Each draw has a correlation of its own, as far from ``rho`` as that may be off.

    Args:
        noise: the whitening.
        system: the rows.
        basis: of what was fitted, whitened (N m, r).
        left: whitened residual freed of it (N m,).
        count: how many draws.
        rng: where they come from.
    """
    n, m = system.residual.shape
    out = rng.normal(size=(n, m, count))
    if count:
        free = np.maximum(1.0 - np.sum(basis**2, axis=1), LEAST_FREE)
        scaled = (left / np.sqrt(free)).reshape(n, m)
        for i in range(len(system.problem.datasets)):
            mine = np.flatnonzero(system.dataset == i)
            if heavy(scaled[mine][system.observed[mine]]):
                _resample(out, mine, scaled, system, rng)
    if noise.rho_error > 0.0:
        _correlate(out, noise, system, rng)
    return np.asarray(out * system.observed[..., None]).reshape(n * m, count)


def heavy(values: Array) -> bool:
    """Whether values (n,) have heavier tails than normal noise would show by chance."""
    square = values**2
    mean = float(np.mean(square)) if values.size else 0.0
    if values.size < ENOUGH or mean == 0.0:
        return False
    excess = float(np.mean(square**2)) / mean**2 - 3.0
    return bool(excess > HEAVY * np.sqrt(24.0 / values.size))


def _resample(out: Array, mine: NDArray[np.int64], scaled: Array, system: System,
              rng: np.random.Generator) -> None:
    """Fill rows ``mine`` of ``out`` (N, m, count) with residuals of other rows, at random signs.

    A row is taken as a whole: what disturbs one coordinate may have disturbed all.
    """
    seen = system.observed[mine]
    source = scaled[mine] / np.sqrt(np.mean(scaled[mine][seen] ** 2))
    for row in mine:
        pick = rng.integers(mine.size, size=out.shape[2])
        sign = rng.choice((-1.0, 1.0), size=out.shape[2])
        out[row] = np.where(seen[pick].T, source[pick].T * sign, out[row])


def _correlate(out: Array, noise: Whitening, system: System, rng: np.random.Generator) -> None:
    """Give each draw of white noise (N, m, count) the correlation that the whitening may leave."""
    true = np.clip(noise.rho + noise.rho_error * rng.normal(size=out.shape[2]), -0.95, 0.95)
    before = out[0].copy()
    for row in range(1, len(out)):
        gap = int(system.apart[row - 1])
        if gap == 0:
            before = out[row].copy()
            continue
        tie, known = true**gap, noise.rho**gap
        now = tie * before + np.sqrt(1.0 - tie**2) * out[row]
        out[row] = (now - known * before) / np.sqrt(1.0 - known**2)
        before = now
