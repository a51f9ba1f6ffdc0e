"""Inner products of the projected columns: every test is a small solve on them.

With J the geometry, M = I - QQ^T and Q a basis of J's range, the added-variable test of
columns C on the residual r needs only C^T M C, b = C^T M r and |M r|^2. Of C^T M C, which is
large, only those parts are made that a test asks for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.special import betainc, betaln

from ppmcal import linalg
from ppmcal.linalg import Array, Ints, column_lengths

VISIBLE = 1e-8
"""Squared length left of a column, over its own, below which the geometry swallows it."""
TINY = 1e-200


FEW = 64
"""Fewer columns than this are looked at one by one."""
DRAWS = 250
"""Draws of noise that are worked on at a time."""
CHUNK = 2**20
"""So many numbers of columns are gathered at a time."""


class ProjectedColumns(Protocol):
    """Columns M C of unit length before M, however they are kept."""

    def __len__(self) -> int:
        """How many there are."""

    def some(self, which: Sequence[int]) -> Array:
        """Return some of them, no two the same (k, n)."""

    def along(self, values: Array, out: Array | None = None) -> Array:
        """Return the inner products (T, b) of all of them with values (n, b)."""


@dataclass(frozen=True, eq=False)
class GivenColumns:
    """Columns that are there (T, n)."""

    unit: Array

    def __len__(self) -> int:
        """See :class:`ProjectedColumns`."""
        return len(self.unit)

    def some(self, which: Sequence[int]) -> Array:
        """See :class:`ProjectedColumns`."""
        return self.unit[list(which)]

    def along(self, values: Array, out: Array | None = None) -> Array:
        """See :class:`ProjectedColumns`."""
        return np.matmul(self.unit, values, out=out)


@dataclass(frozen=True, eq=False)
class AddedVariableTest:
    """Tests for T columns of n values.

    Attributes:
        first: M C (T columns) and right: C^T M r (T,) of columns scaled to unit length.
        length: their length (T,) before M.
        square: |M r|^2; freedom: n - rank J.
        hidden: Q^T C (r, T), the part that geometry swallows.
        more: (M C)^T (E, n) of columns that were added; they are counted after the others.
        taken: columns that are in the model; cross: C^T M C_taken (T + E, s); back: the same
            times the inverse of its rows ``taken``.
        blocks, rows: C^T M C of groups of columns, and of single ones with the first T, once they
            were asked for.
    """

    first: ProjectedColumns
    right: Array
    length: Array
    square: float
    freedom: int
    hidden: Array
    more: Array
    taken: tuple[int, ...] = ()
    cross: Array | None = None
    back: Array | None = None
    blocks: dict[tuple[tuple[int, ...], bytes], Array] = field(default_factory=dict)
    rows: dict[int, Array] = field(default_factory=dict)

    def given(self, chosen: Sequence[int]) -> AddedVariableTest:
        """Return the tests that are left when the columns ``chosen`` are in the model."""
        if not chosen:
            return self
        s = list(chosen)
        cross = np.concatenate([self._with_first(s), self.more @ self._columns(np.array(s)).T])
        inverse = pseudo_inverse(cross[s])
        back = cross @ inverse
        rank = int(np.round(np.trace(inverse @ cross[s])))
        return replace(
            self, right=self.right - back @ self.right[s], square=self.left(s),
            freedom=self.freedom - rank, taken=tuple(s), cross=cross, back=back)

    def only(self, columns: Sequence[int]) -> AddedVariableTest:
        """Return the tests of a few columns, counted anew; none must be in the model."""
        which = np.array(columns, dtype=np.int64)
        return replace(self, first=GivenColumns(self._columns(which)), right=self.right[which],
                       length=self.length[which], hidden=self.hidden[:, which],
                       more=self.more[:0], blocks={}, rows={})

    def block(self, rows: Ints, columns: Ints) -> Array:
        """Return C^T M C between columns (..., a) and (..., b), the chosen ones taken out."""
        found = self._columns(rows) @ np.swapaxes(self._columns(columns), -1, -2)
        return self._without_chosen(found, rows, columns)

    def _with_first(self, chosen: Sequence[int]) -> Array:
        """Return C^T M C (T, s) of the first T columns with some, none taken out."""
        first = len(self.first)
        new = list(dict.fromkeys(c for c in chosen if c < first and c not in self.rows))
        if new:
            self.rows.update(zip(new, self.first.along(self.first.some(new).T).T, strict=True))
        return np.stack([self.rows[c] if c < first else
                         self.first.along(self.more[c - first, :, None])[:, 0]
                         for c in chosen], axis=1)

    def _columns(self, which: Ints) -> Array:
        """Return columns (..., n), none taken out."""
        first = len(self.first)
        few = which.tolist() if which.ndim == 1 and which.size < FEW else []
        if few and max(few) < first and len(set(few)) == len(few):
            return self.first.some(few)
        need, place = np.unique(which, return_inverse=True)
        out = self.first.some(need[need < first].tolist())
        if len(out) < need.size:
            out = np.concatenate([out, self.more[need[need >= first] - first]])
        return np.asarray(out[place.reshape(which.shape)])

    def _without_chosen(self, found: Array, rows: Ints, columns: Ints) -> Array:
        if self.back is None or self.cross is None:
            return found
        return np.asarray(found - self.back[rows] @ np.swapaxes(self.cross[columns], -1, -2))

    def _own_blocks(self, groups: Ints) -> Array:
        """Return the blocks (F, k, k) of groups of columns (F, k), none taken out."""
        key = groups.shape, groups.tobytes()
        if key not in self.blocks:
            keys = [(g.shape, g.tobytes()) for g in groups]
            new = np.array([n for n, k in enumerate(keys) if k not in self.blocks], dtype=np.int64)
            step = max(1, CHUNK // max(groups.shape[1] * self.more.shape[1], 1))
            for begin in range(0, len(new), step):
                some = new[begin:begin + step]
                own = self._columns(groups[some])
                self.blocks.update(zip([keys[n] for n in some], own @ np.swapaxes(own, -1, -2),
                                       strict=True))
            self.blocks[key] = np.stack([self.blocks[k] for k in keys])
        return self.blocks[key]

    def _inverse(self, chosen: Sequence[int]) -> Array:
        if not chosen:
            return np.zeros((0, 0))
        return pseudo_inverse(self._own_blocks(np.array([chosen], dtype=np.int64))[0])

    def left(self, chosen: Sequence[int]) -> float:
        """Return |M r|^2 with the columns ``chosen`` in the model."""
        s = list(chosen)
        if not s:
            return self.square
        return self.square - float(self.right[s] @ self._inverse(s) @ self.right[s])

    def extended(self, weights: Array) -> AddedVariableTest:
        """Return the tests with further columns: combinations C ``weights`` (T + E, e)."""
        used = np.flatnonzero(weights.any(axis=1))
        w = weights[used] * self.length[used, None]
        made = w.T @ self._columns(used)
        hidden = self.hidden[:, used] @ w
        norm = np.sqrt(np.sum(made**2, axis=1) + np.sum(hidden**2, axis=0))
        # blocks of the first columns alone stay what they are
        return replace(self, blocks=dict(self.blocks),
                       more=np.concatenate([self.more, made / norm[:, None]]),
                       right=np.append(self.right, self.right[used] @ w / norm),
                       length=np.append(self.length, norm),
                       hidden=np.concatenate([self.hidden, hidden / norm], axis=1))

    def fit(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return coefficients of the columns ``chosen`` and their covariance, SI."""
        s = list(chosen)
        inverse = self._inverse(s)
        left = self.square - float(self.right[s] @ inverse @ self.right[s])
        variance = max(left, 0.0) / max(self.freedom - len(s), 1)
        scale = 1.0 / self.length[s]
        return inverse @ self.right[s] * scale, inverse * variance * np.outer(scale, scale)

    def survival(self, chosen: Sequence[int]) -> float:
        """Return which part of the columns' length the geometry leaves."""
        own = self._columns(np.array(chosen, dtype=np.int64))
        return float(np.sqrt(np.mean(np.sum(own**2, axis=1))))

    def explained(self, groups: Ints) -> tuple[Array, Ints]:
        """Return |P^T r|^2 of groups of columns (F, k), and the ranks (F,)."""
        root, rank = self.roots(groups)
        return squares_of(root, self.right[groups][..., None])[:, 0], rank

    def roots(self, groups: Ints) -> tuple[Array, Ints]:
        """Return roots (F, k, k) of the inverse blocks of groups of columns (F, k), and ranks."""
        blocks = self._without_chosen(self._own_blocks(groups), groups, groups)
        w, v = linalg.eigh(blocks)
        use = w > VISIBLE
        root = np.where(use, 1.0 / np.sqrt(np.where(use, w, 1.0)), 0.0)
        return root[..., None] * np.swapaxes(v, -1, -2), use.sum(axis=1)


def squares_of(root: Array, right: Array) -> Array:
    """Return the squared lengths (F, B) of roots (F, k, k) times what they act on (F, k, B)."""
    parts = root @ right
    return np.asarray(np.einsum("fkb,fkb->fb", parts, parts))


def pseudo_inverse(block: Array) -> Array:
    """Return the inverse of a symmetric block, its invisible directions left out."""
    w, v = linalg.eigh(block)
    use = w > VISIBLE
    return np.asarray((v[:, use] / w[use]) @ v[:, use].T)


def build_test(basis: Array, columns: Array, residual: Array, count: int) -> AddedVariableTest:
    """Return the tests of columns (n, T) on a residual (n,), J having the basis (n, r).

    ``count``: how many of the n values were measured, the others being zero everywhere.
    """
    length = column_lengths(columns)
    unit = columns.T / length[:, None]
    hidden = unit @ basis
    unit -= hidden @ basis.T
    return prepared(GivenColumns(unit), length, hidden.T, basis, residual, count)


def prepared(
    first: ProjectedColumns, length: Array, hidden: Array, basis: Array, residual: Array, count: int
) -> AddedVariableTest:
    """Return the tests of columns that were scaled and projected already; as :func:`build_test`."""
    clean = residual - basis @ (basis.T @ residual)
    return AddedVariableTest(first, first.along(clean[:, None])[:, 0], length, float(clean @ clean),
                             count - basis.shape[1], hidden, np.zeros((0, len(basis))))


Noise = Iterable[tuple[Array, Array]]
"""Simulated noise as tests see it, some draws at a time: C^T M z (T, b) and |M z|^2 (b,)."""


def seen_noise(first: ProjectedColumns, basis: Array, noise: Array
               ) -> Iterator[tuple[Array, Array]]:
    """Yield simulated noise (n, B) as tests see it; each block is good until the next."""
    room = np.empty((len(first), DRAWS))
    for begin in range(0, noise.shape[1], DRAWS):
        draws = noise[:, begin:begin + DRAWS]
        across = basis.T @ draws
        # columns of unit length are M C already
        right = first.along(draws, room if draws.shape[1] == DRAWS else None)
        yield right, squares(draws) - squares(across)


def squares(columns: Array) -> Array:
    """Return the squared lengths (c,) of columns (n, c)."""
    return np.asarray(np.einsum("nc,nc->c", columns, columns))


def probability(value: float) -> float:
    """Return the p-value of a log p, above 0 however small it is."""
    return float(np.exp(max(value, -740.0)))


def log_p(explained: Array, square: Array | float, size: Array | Ints | int, freedom: int) -> Array:
    """Return the log p-value of the F test (added variable), also where p underflows.

    R^2 = explained/square has a Beta(k/2, (nu - k)/2) distribution under the null. Columns
    that leave no freedom prove nothing: log p = 0.
    """
    a = np.asarray(size, dtype=float) / 2.0
    b = np.maximum(freedom / 2.0 - a, 0.5)
    x = np.clip(np.asarray(explained) / np.maximum(square, 1e-300), 0.0, 1.0 - 1e-15)
    safe = np.where(a > 0.0, a, 0.5)
    p = betainc(b, safe, 1.0 - x)
    with np.errstate(divide="ignore"):
        far = b * np.log1p(-x) + (safe - 1.0) * np.log(np.maximum(x, 1e-300)) - np.log(
            b) - betaln(safe, b)
        out = np.where(p > TINY, np.log(np.maximum(p, 1e-300)), np.minimum(far, np.log(TINY)))
    return np.asarray(np.where((a > 0.0) & (2.0 * a < freedom), out, 0.0), dtype=float)
