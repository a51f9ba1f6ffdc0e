"""Array types, and the one question asked everywhere: which rows are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def known(rows: Array) -> Bools:
    """Return which rows of (N, m) hold a number everywhere (N,).

    >>> known(np.array([[1.0, 2.0], [np.nan, 3.0]])).tolist()
    [True, False]
    """
    return np.asarray(np.isfinite(rows).all(axis=1), dtype=np.bool_)
