"""What repeats of a pose say of the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal.diagnosis.linear_system import System
from ppmcal.model.repeats import repeats


@dataclass(frozen=True)
class PureError:
    """Scatter of repeats in the same environment: sigma over the stated one, freedom."""

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
    """Return one label per pose and environment (N,); different ones hide no effect."""
    own = np.zeros(system.dataset.size, dtype=np.int64)
    for i, data in enumerate(system.problem.datasets):
        mine = system.dataset == i
        own[mine] = repeats(data)[system.row[mine]]
    label = system.dataset * (int(own.max(initial=0)) + 1) + own
    label = np.unique(label, return_inverse=True)[1].reshape(-1)
    return np.asarray(label, dtype=np.int64) if label.max() + 1 < label.size else None
