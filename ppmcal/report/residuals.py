"""What residuals.csv says: by coordinate, as norms, and thinned for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ppmcal.io.csv import Table
from ppmcal.io.results.identification_tables import quantity_of
from ppmcal.linalg import Array, Bools

POINTS = 1200
"""More rows than this are plotted thinned."""
BINS = 300
"""Thinned plots show the range of the rows in each of so many bins."""


@dataclass(frozen=True)
class LimbResiduals:
    """Coordinates that have one norm: position, rotation, or one distance.

    ``before`` and ``after`` (N,) are norms over the measured coordinates, nan where none is.
    """

    name: str
    quantity: str
    before: Array
    after: Array


def coordinates(table: Table) -> list[str]:
    """Return the measured coordinates, in the file's order."""
    return [h.removeprefix("after_") for h in table.header if h.startswith("after_")]


def used(table: Table) -> Bools:
    """Return which rows the fit used (N,); all of them if the file does not say."""
    if "used" not in table.numbers:
        return np.ones(table.size, dtype=bool)
    return np.asarray(table.number("used") != 0.0, dtype=bool)


def groups(table: Table) -> list[LimbResiduals]:
    """Return the norms of position and rotation, and further coordinates by themselves."""
    have = coordinates(table)
    parts: list[tuple[str, list[str]]] = [
        ("position", [c for c in have if c in ("x", "y", "z")]),
        ("rotation", [c for c in have if c in ("rx", "ry", "rz")]),
        *((c, [c]) for c in have if c not in ("x", "y", "z", "rx", "ry", "rz"))]
    return [LimbResiduals(name, quantity_of(members[0]),
                  norm([table.number(f"before_{c}") for c in members]),
                  norm([table.number(f"after_{c}") for c in members]))
            for name, members in parts if members]


def norm(parts: Sequence[Array]) -> Array:
    """Return the norm over the finite components (N,), nan where none is."""
    stack = np.stack(parts)
    seen = np.isfinite(stack)
    total = np.sqrt(np.sum(np.where(seen, stack, 0.0) ** 2, axis=0))
    return np.where(seen.any(axis=0), total, np.nan)


def white(table: Table) -> Array:
    """Return all residuals of used rows over their sigma, flat."""
    keep = used(table)
    out = []
    for c in coordinates(table):
        sigma = table.number(f"sigma_{c}")
        ratio = np.divide(table.number(f"after_{c}"), sigma, where=sigma > 1e-160,
                          out=np.full(table.size, np.nan))[keep]
        out.append(np.clip(ratio[np.isfinite(ratio)], -1e100, 1e100))
    return np.concatenate(out) if out else np.zeros(0)


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


def boundaries(table: Table) -> list[tuple[int, str]]:
    """Return where each data set begins: (row index, name)."""
    names = table.words("dataset")
    out: list[tuple[int, str]] = []
    for i, name in enumerate(names):
        if not out or name != out[-1][1]:
            out.append((i, name))
    return out


def predicted(table: Table, kind: str) -> dict[str, Array]:
    """Return by stage the errors (N,) that commands.csv says are to be expected of one kind.

    In its units; of corrected commands nan where the model's own uncertainty is unknown. In files
    of earlier versions that uncertainty, ``sigma``, is not in what is left of the arithmetic.
    """
    left = np.nan_to_num(table.number(f"error_{kind}_after"))
    return {"uncorrected": table.number(f"error_{kind}_before"),
            "corrected": np.maximum(left, table.number(f"sigma_{kind}"))}
