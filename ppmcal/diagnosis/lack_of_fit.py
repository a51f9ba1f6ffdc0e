"""Lack of fit: residuals relative to the noise, as stated in the files or shown by repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri

from ppmcal.calibration.fit import ENOUGH_REPEATS, noise_source
from ppmcal.diagnosis.linear_system import System
from ppmcal.diagnosis.linearisation import Linearisation
from ppmcal.inference.priors import NOISE_FREEDOM, SURE_SIGMAS
from ppmcal.model.repeats import repeats


@dataclass(frozen=True)
class PureError:
    """Scatter of repeats in one environment: sigma over the stated one, degrees of freedom."""

    ratio: float
    freedom: int


def pure_error(system: System) -> PureError | None:
    """Return the scatter within rows of one pose and environment, or None."""
    label = _environments(system)
    if label is None:
        return None
    count = int(label.max()) + 1
    size = np.zeros((count, system.residual.shape[1]))
    total = np.zeros_like(size)
    np.add.at(size, label, system.observed.astype(float))
    np.add.at(total, label, system.residual)
    away = np.where(system.observed, system.residual - (total / np.maximum(size, 1.0))[label], 0.0)
    freedom = int(np.sum(np.maximum(size - 1.0, 0.0)))
    return PureError(float(np.sqrt(np.sum(away**2) / freedom)), freedom) if freedom else None


def _environments(system: System) -> NDArray[np.int64] | None:
    """Return one label per pose and environment (N,), or None without repeats."""
    own = np.zeros(system.dataset.size, dtype=np.int64)
    for i, data in enumerate(system.problem.datasets):
        mine = system.dataset == i
        own[mine] = repeats(data)[system.row[mine]]
    label = system.dataset * (int(own.max(initial=0)) + 1) + own
    label = np.unique(label, return_inverse=True)[1].reshape(-1)
    return np.asarray(label, dtype=np.int64) if label.max() + 1 < label.size else None


@dataclass(frozen=True)
class LackOfFit:
    """The size of the residuals relative to the noise.

    Attributes:
        ratio: rms over the noise reference; excess: how many sigmas above it.
        reference: noise over the stated noise; ``source``: its origin.
        follows: description of the most probable unknown cause; empty if there is none.
        known: probability that the residuals contain no unknown cause.
    """

    ratio: float
    excess: float
    reference: float
    source: str
    follows: str
    known: float

    @property
    def adequate(self) -> bool:
        """Whether nothing is left to explain."""
        return not self.follows and self.excess < SURE_SIGMAS


def lack_of_fit(stage: Linearisation, pure: PureError | None, follows: str,
                known: float) -> LackOfFit:
    """Return the lack of fit of geometry and the chosen effects.

    ``pure``: scatter of repeats, if any; ``follows``, ``known``: of unknown causes.
    """
    freedom = max(stage.system.count - stage.explained(stage.chosen).shape[1], 1)
    rows = np.sum(stage.left(stage.chosen).reshape(stage.system.residual.shape) ** 2, axis=1)
    mean = float(rows.sum()) / freedom
    error = float(rows.std()) * np.sqrt(rows.size) / freedom
    reference, source = 1.0, noise_source(stage.system.problem.datasets)
    own = float(np.sqrt(2.0 / NOISE_FREEDOM.value))
    if pure is not None and pure.freedom >= ENOUGH_REPEATS:
        reference, source = pure.ratio, "repeats"
        own = pure.ratio**2 * np.sqrt(2.0 / pure.freedom)
    # an error of the correlation changes the scale of the whitened residuals
    rho, off = stage.noise.rho, stage.noise.rho_error
    scale = mean * 2.0 * abs(rho) / (1.0 - rho**2) * off
    # both scaled to the noise level: a few rows far above it would inflate them
    error, scale = (e * min(reference**2 / mean, 1.0) for e in (error, scale))
    sigma = np.sqrt(error**2 + own**2 + scale**2)
    excess = (mean - reference**2) / max(sigma, 1e-300)
    # few values are not normally distributed: use chi-squared
    excess = min(excess, -float(ndtri(chdtrc(freedom, freedom * mean / reference**2))))
    return LackOfFit(float(np.sqrt(mean)) / reference, float(excess), reference, source, follows,
                     known)
