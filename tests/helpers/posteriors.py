"""What the rows of a calibration and its tolerances know of the parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppmcal.calibration.fit import Posterior


def sigma_of(known: Posterior) -> NDArray[np.float64]:
    """Return the standard deviation of each parameter (F,), SI."""
    rows = np.concatenate([known.matrix * known.scale / known.inflation,
                           np.diag(known.scale / known.tolerance)])
    inverse = np.linalg.pinv(rows)
    return np.asarray(np.linalg.norm(inverse, axis=1) * known.scale)
