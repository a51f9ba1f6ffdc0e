"""More rows than a picture shows: ranges of bins, the largest of cells."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ppmcal.linalg import Array

POINTS = 1200
"""More rows than this are plotted thinned."""
BINS = 300
"""Thinned plots show the range of the rows in each of so many bins."""


def envelope(y: Array, bins: int = BINS) -> tuple[Array, Array, Array, Array, Array]:
    """Return bin centres and the 0, 1/6, 5/6 and 1 quantiles of the finite values in each bin."""
    edges = np.linspace(0, y.size, bins + 1).astype(int)
    out = []
    for start, stop in pairwise(edges.tolist()):
        part = y[start:stop]
        part = part[np.isfinite(part)]
        if part.size:
            out.append([(start + stop - 1) / 2.0, *np.quantile(part, [0.0, 1 / 6, 5 / 6, 1.0])])
    centres, low, below, above, high = np.array(out).reshape(-1, 5).T
    return centres, low, below, above, high


def evenly_spread(places: Array, size: Array, cells: int = 22) -> NDArray[np.intp]:
    """Return one row for each cell of a square grid over the plane: the largest one."""
    good = np.flatnonzero(np.isfinite(places).all(axis=1) & np.isfinite(size))
    if good.size <= cells * cells:
        return np.asarray(good, dtype=np.intp)
    xy = places[good]
    low = xy.min(axis=0)
    width = max(float((xy.max(axis=0) - low).max()), 1e-300)
    cell = np.minimum(((xy - low) / width * cells).astype(int), cells - 1)
    key = cell[:, 0] * cells + cell[:, 1]
    order = np.lexsort((-size[good], key))
    _, first = np.unique(key[order], return_index=True)
    return np.asarray(good[order[first]], dtype=np.intp)
