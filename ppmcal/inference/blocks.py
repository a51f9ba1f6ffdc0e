"""Blocks of columns that may be in the data, with their priors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ppmcal import linalg
from ppmcal.inference.columns import ColumnSource
from ppmcal.inference.priors import NOISE_FREEDOM
from ppmcal.inference.ranges import usual
from ppmcal.linalg import Array, Bools, Ints


@dataclass(frozen=True, eq=False)
class Block:
    """Columns that act together, b = s R z with z standard normal.

    Attributes:
        name: readable.
        family: the cause that it represents, the unit of distinction.
        columns: their numbers, k of them.
        roots: one R (k, q) for each grid value, scaled so that R z makes one sigma rms; empty: each
            column by itself, so scaled.
        log_prior: logarithm of its prior probability.
        low, high: bounds of the coefficients, for all columns or for each; those of starts are
            unbounded.
        group: shared by blocks that often occur together, such as events of one kind at one place
            or errors of one sort in several limbs: a further one costs less than a separate cause;
            empty: none.
        subject: what an unlisted cause acts on: a further form of it there costs less than a
            separate cause; empty: none.
        form: its shape, if a family has several very different ones; empty: one.
        starts: for each of its last columns, the number of the column whose coefficient, times a
            standard normal, is its own: the state of a memory before the first row.
        least: rms, in sigmas, below which a column is only round-off.
        where: what it acts on; the same cause elsewhere is another answer.
        gives, needs: a block with ``needs`` requires one in the set that ``gives`` the same.
        reads: recorded inputs that it uses; ``way``: their interpretation, empty: as read. No set
            interprets one input in two ways.
        ratio: for a block with ``needs``, bounds of its coefficients over the mean of the other's;
            empty: none.
    """

    name: str
    family: str
    columns: tuple[int, ...]
    log_prior: float
    roots: tuple[Array, ...] = ()
    low: float | tuple[float, ...] = -np.inf
    high: float | tuple[float, ...] = np.inf
    group: str = ""
    subject: str = ""
    form: str = ""
    starts: tuple[int, ...] = ()
    least: float = 0.0
    where: str = ""
    gives: str = ""
    needs: str = ""
    reads: frozenset[str] = frozenset()
    way: str = ""
    ratio: tuple[tuple[float, float], ...] = ()

    def own_roots(self, gram: Array, count: int) -> tuple[Array, ...]:
        """Return its roots, or the default of independent columns; ``gram`` (k, k): of its columns.

        ``count``: number of measured values.
        """
        return self.roots or (scaled_root(gram, count, self.starts, self.least),)

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """Lower and upper bounds of each coefficient, (k,) and (k,)."""
        free = np.full(len(self.starts), np.inf)
        own = (len(self.columns) - free.size,)
        return (np.concatenate([np.broadcast_to(self.low, own), -free]),
                np.concatenate([np.broadcast_to(self.high, own), free]))


@dataclass(frozen=True, eq=False)
class Batch:
    """B blocks of the same shape, evaluated together.

    ``which`` (B,) numbers of the blocks; ``columns`` (B, k); ``gram`` (B, k, k) inner products of
    their raw columns; ``roots`` (B, G, k, q); ``low``, ``high`` (B, k);
    ``known``: degrees of freedom of the noise prior.
    """

    which: Ints
    columns: Ints
    gram: Array
    roots: Array
    low: Array
    high: Array
    known: float = float(NOISE_FREEDOM)

    @cached_property
    def usual(self) -> Array:
        """Log prior probability that coefficients are within their bounds (B,)."""
        return usual(self.roots, self.low, self.high, self.known)

    @cached_property
    def bounded(self) -> Bools:
        """Whether any coefficient of each block has a bound (B,)."""
        return np.asarray((np.isfinite(self.low) | np.isfinite(self.high)).any(axis=1))


def scaled_root(gram: Array, count: int, starts: Sequence[int] = (),
                least: Array | float = 0.0) -> Array:
    """Return the root (..., k, k) that gives each column one sigma rms over ``count`` values.

    ``gram`` (..., k, k): inner products; a zero column stays zero. ``starts``: see :class:`Block`.
    ``least`` (...): rms below which a column is only round-off.
    """
    own = gram.shape[-1] - len(starts)
    square = np.diagonal(gram, axis1=-2, axis2=-1)[..., :own]
    length = np.sqrt(np.maximum(square / max(count, 1), 0.0))
    seen = length > np.maximum(least, np.sqrt(np.finfo(float).tiny))[..., None]
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=seen) / np.sqrt(max(own, 1))
    every = np.concatenate([scale, scale[..., list(starts)]], axis=-1)
    return np.asarray(every[..., None] * np.eye(every.shape[-1]))


CHUNK = 512
"""Columns computed at a time."""


def batches(blocks: Sequence[Block], columns: ColumnSource, count: int,
            known: float = float(NOISE_FREEDOM)) -> list[Batch]:
    """Return blocks in batches of one shape; ``count``: number of values; ``known``: of a batch."""
    alike: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for i, b in enumerate(blocks):
        roots = (len(b.roots), *b.roots[0].shape) if b.roots else b.starts
        alike[len(b.columns), bool(b.roots), roots].append(i)
    return [_batch(np.array(own), [blocks[i] for i in own], columns, count, known)
            for own in alike.values()]


def _batch(which: Ints, blocks: Sequence[Block], columns: ColumnSource, count: int, known: float
           ) -> Batch:
    at = np.array([b.columns for b in blocks], dtype=np.int64)
    some = max(CHUNK // max(at.shape[1], 1), 1)
    gram = np.concatenate([_grams(at[i:i + some], columns) for i in range(0, len(at), some)])
    linalg.finite("the length of columns", gram)
    roots = np.array([b.roots for b in blocks]) if blocks[0].roots else scaled_root(
        gram, count, blocks[0].starts, np.array([b.least for b in blocks]))[:, None]
    ends = np.array([b.ends for b in blocks])                           # (B, 2, k)
    return Batch(which, at, gram, roots, ends[:, 0], ends[:, 1], known)


def _grams(at: Ints, columns: ColumnSource) -> Array:
    """Return the inner products (B, k, k) of the columns (B, k) of each block."""
    need, place = np.unique(at, return_inverse=True)
    values = columns.some(need.tolist())
    if at.shape[1] == 1:
        return np.asarray(np.einsum("nb,nb->b", values, values)[place].reshape(-1, 1, 1))
    own = values.T[place.reshape(at.shape)]
    return np.asarray(own @ own.transpose(0, 2, 1))
