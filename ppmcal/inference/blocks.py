"""Blocks of columns that may be in the data, and what is believed of them before."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.inference.columns import ColumnSource
from ppmcal.linalg import Array, Ints


@dataclass(frozen=True, eq=False)
class Block:
    """Columns that act together, b = s R z with z standard normal.

    Attributes:
        name: for people.
        family: the cause that it stands for; what is told apart.
        columns: their numbers, k of them.
        roots: one R (k, q) for each value of what lies on a grid, such that R z makes one sigma
            rms; empty: of each column alone, scaled so.
        log_prior: logarithm of its prior probability.
        low, high: between which the coefficient of a single column is.
        group: what one thing does share it, events of one kind at one place, errors of one sort in
            several limbs: one more of them costs less than another cause; empty: it is by itself.
        form: what it looks like, where a family has several that differ much; empty: one.
        starts: of its last columns, one each, the number of the column whose coefficient, times
            a standard normal, theirs is: what a memory was before the first row.
        least: rms, in sigmas, below which a column is nothing but round-off.
        gives, needs: a block with ``needs`` can only be there beside one that ``gives`` the same.
    """

    name: str
    family: str
    columns: tuple[int, ...]
    log_prior: float
    roots: tuple[Array, ...] = ()
    low: float = -np.inf
    high: float = np.inf
    group: str = ""
    form: str = ""
    starts: tuple[int, ...] = ()
    least: float = 0.0
    gives: str = ""
    needs: str = ""


@dataclass(frozen=True, eq=False)
class Batch:
    """B blocks of the same shape, so that they are asked together.

    ``which`` (B,) numbers of the blocks; ``columns`` (B, k); ``gram`` (B, k, k) inner products of
    their raw columns; ``roots`` (B, G, k, q); ``low``, ``high`` (B,).
    """

    which: Ints
    columns: Ints
    gram: Array
    roots: Array
    low: Array
    high: Array

    @property
    def bounded(self) -> bool:
        """Whether any coefficient has a sign or a range."""
        return bool(np.isfinite(self.low).any() or np.isfinite(self.high).any())


def scaled_root(gram: Array, count: int, starts: Sequence[int] = (), least: float = 0.0) -> Array:
    """Return the root (k, k) that gives each column one sigma rms over ``count`` values.

    ``gram`` (k, k): inner products; a column of nothing stays nothing. ``starts``: of the last
    columns those whose coefficients, times standard normal ones, theirs are. ``least``: rms below
    which a column is nothing but round-off.
    """
    own = len(gram) - len(starts)
    length = np.sqrt(np.maximum(np.diagonal(gram)[:own] / max(count, 1), 0.0))
    seen = length > max(least, float(np.sqrt(np.finfo(float).tiny)))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=seen) / np.sqrt(max(own, 1))
    return np.diag(np.concatenate([scale, scale[list(starts)]]))


CHUNK = 512
"""Columns that are made at a time."""


def batches(blocks: Sequence[Block], columns: ColumnSource, count: int) -> list[Batch]:
    """Return blocks as batches of one shape; ``count``: number n of values."""
    grams = _grams(blocks, columns)
    linalg.finite("the length of columns", *grams)
    roots = [b.roots or (scaled_root(g, count, b.starts, b.least),)
             for b, g in zip(blocks, grams, strict=True)]
    alike: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for i, r in enumerate(roots):
        alike[(len(r), *r[0].shape)].append(i)
    return [Batch(np.array(own), np.array([blocks[i].columns for i in own], dtype=np.int64),
                  np.array([grams[i] for i in own]), np.array([np.array(roots[i]) for i in own]),
                  np.array([blocks[i].low for i in own]), np.array([blocks[i].high for i in own]))
            for own in alike.values()]


def _grams(blocks: Sequence[Block], columns: ColumnSource) -> list[Array]:
    """Return the inner products (k, k) of each block's columns, some columns at a time."""
    out: list[Array] = []
    begin = 0
    while begin < len(blocks):
        end, need = begin, dict[int, int]()
        while end < len(blocks) and (end == begin or len(need) < CHUNK):
            for c in blocks[end].columns:
                need.setdefault(c, len(need))
            end += 1
        values = columns.some(list(need))
        for block in blocks[begin:end]:
            own = values[:, [need[c] for c in block.columns]]
            out.append(own.T @ own)
        begin = end
    return out
