"""Array types, and what is asked of rows everywhere: which are known, and some of them."""

from __future__ import annotations

from collections.abc import Sequence

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


def thinned(keep: Sequence[Bools], most: int) -> list[Bools]:
    """Return masks with at most ``most`` rows in all, evenly spread."""
    total = sum(int(k.sum()) for k in keep)
    if total <= most:
        return list(keep)
    out = []
    for k in keep:
        rows = np.flatnonzero(k)
        count = min(rows.size, max(1, most * rows.size // total))
        mask = np.zeros_like(k)
        mask[rows[np.linspace(0, rows.size - 1, count).astype(int)]] = True
        out.append(mask)
    return out
