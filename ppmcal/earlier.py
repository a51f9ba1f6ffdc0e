"""What earlier measurements knew: a calibration carried on with new data.

A posterior of covariance C about g1, with tolerances tau about g0 in it, says of the data alone

    D = C^-1 - diag(1/tau^2)    about mu, with    D (mu - g1) = diag(1/tau^2) (g1 - g0).

As rows |R (g - g1) - r|^2 with R^T R = D these go into the new fit like measurements, so that
the tolerances count once, and what no data ever saw stays redundant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal.mechanism import Mechanism

Array = NDArray[np.float64]

SEEN = 1e-4
"""A direction counts as seen from this part of the information that the tolerances hold."""
ROUND_OFF = 1e-12
"""Information below this part of the largest is round-off of the inversion."""
NOTHING = 1e-15
"""Without tolerances, a variance below this part of the largest stands for a direction unseen."""


@dataclass(frozen=True, eq=False)
class Earlier:
    """Rows |matrix s - right|^2 of steps s from ``value``, per parameter.

    ``places`` (F,): indices of the machine's parameters; ``matrix`` (k, F), ``right`` (k,)
    white; ``value`` (F,) where the earlier fit ended, SI. ``source``: where it is from.
    """

    places: tuple[int, ...]
    matrix: Array
    right: Array
    value: Array
    source: str = ""

    def rows(self, mechanism: Mechanism, free: Sequence[int], g: Array) -> tuple[Array, Array]:
        """Return residual (k,) and Jacobian (k, F) at g (P,); what is not free counts as it is."""
        away = g[list(self.places)] - self.value
        slope = np.ones(len(self.places))
        for c, p in enumerate(self.places):
            if mechanism.parameters[p].reciprocal:
                slope[c] = (self.value[c] / g[p]) ** 2
                away[c] = self.value[c] - self.value[c] ** 2 / g[p]
        jacobian = np.zeros((self.right.size, len(free)))
        column = {p: c for c, p in enumerate(free)}
        for c, p in enumerate(self.places):
            if p in column:
                jacobian[:, column[p]] = self.matrix[:, c] * slope[c]
        return self.right - self.matrix @ away, jacobian


@dataclass(frozen=True, eq=False)
class Posterior:
    """What an identification ended with, SI.

    Attributes:
        places: parameters that were free (F,).
        value, nominal: the estimate, and where tolerances are counted from (F,).
        covariance: of the estimate (F, F), ``inflation`` in it; singular where nothing was known.
        tolerance: the prior's standard deviation (F,), inf where there was none.
        inflation: factor on all standard deviations that the noise check had asked for.
        inputs: content hash -> name of the measurement tables behind it.
        source: the file.
    """

    places: tuple[int, ...]
    value: Array
    nominal: Array
    covariance: Array
    tolerance: Array
    inflation: float
    inputs: Mapping[str, str]
    source: str

    def data(self) -> Earlier:
        """Return the data's part, without the prior."""
        sigma = np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))
        flat = ~np.isfinite(self.tolerance)
        scale = np.where(flat, np.where(sigma > 0.0, sigma, 1.0), self.tolerance)
        inner = self.covariance / np.outer(scale, scale) / self.inflation**2
        prior = np.diag((scale / self.tolerance) ** 2)
        w, v = np.linalg.eigh((inner + inner.T) / 2.0)
        least = float(w.max(initial=0.0)) * NOTHING
        # with a tolerance on each nothing is unseen, and a tiny variance is much knowledge
        inverse = np.where(w > least, 1.0 / np.maximum(w, 1e-300),
                           0.0 if flat.any() else 1.0 / max(least, 1e-300))
        w, v = np.linalg.eigh((v * inverse) @ v.T - prior)
        seen = w > max(SEEN * float(prior.max(initial=0.0)),
                       ROUND_OFF * float(w.max(initial=0.0)))
        root = np.sqrt(w[seen])
        right = (v[:, seen].T @ (prior @ ((self.value - self.nominal) / scale))) / root
        return Earlier(self.places, (v[:, seen] * root).T / scale / self.inflation,
                       right / self.inflation, self.value, self.source)
