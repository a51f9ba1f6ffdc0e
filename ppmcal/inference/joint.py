"""Blocks present together: their sizes, and the evidence with them.

Conditioned on the geometry, the inner products of the blocks' columns are sufficient, so evaluating
any of their sizes takes only small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.inference.blocks import Block
from ppmcal.inference.evidence import odds_by_size, odds_of_wide, small_eigh, within
from ppmcal.inference.given import Conditioned
from ppmcal.inference.ranges import LEAST, SIZES, bounded, usual
from ppmcal.linalg import Array, Bools, Ints

SWEEPS = 6
"""Maximum sweeps in which each size is chosen again, given the others."""
WIDEST = 64
"""A block with more columns takes longer than all others together: it is eliminated first."""


@dataclass(frozen=True, eq=False)
class JointBlocks:
    """Blocks at their most probable joint sizes and roots.

    Attributes:
        log_evidence: log density of the values with them, sizes and roots integrated.
        sizes: number of each block's size. grid: of its root.
        values, sigmas: each block's coefficients (k,), mean and standard deviation in units of the
            stated noise.
        without: log evidence without each block, with the others at their present sizes (B,).
    """

    log_evidence: float
    sizes: Ints
    grid: Ints
    without: Array
    values: tuple[Array, ...] = ()
    sigmas: tuple[Array, ...] = ()


def joint(given: Conditioned, blocks: Sequence[Block],
          near: Sequence[tuple[int, int] | None] = ()) -> JointBlocks:
    """Return blocks present together, given the conditioning.

    ``near``: numbers of the size and root of each at which the search starts.
    """
    return joint_of_each([given], [blocks], near)[0]


def joint_of_each(given: Sequence[Conditioned], blocks: Sequence[Sequence[Block]],
                  near: Sequence[tuple[int, int] | None] = ()) -> list[JointBlocks]:
    """Return the same blocks present together, for each of V correlations.

    The results are independent; they are computed at once because call overhead dominates.
    ``blocks``: with roots for each correlation. ``near``: see :func:`joint`, for all of them.
    """
    count = len(blocks[0])
    if not count:
        empty = np.zeros(0, dtype=np.int64)
        return [JointBlocks(one.log_evidence, empty, empty, np.zeros(0)) for one in given]
    system, views = _System(given, blocks), np.arange(len(given))
    start = np.array([own or (len(SIZES) // 2, 0) for own in near or [None] * count])
    sizes, grid = (np.tile(start[:, n], (len(given), 1)) for n in (0, 1))      # (V, B)
    order = sorted(range(count), key=lambda k: bool(near and near[k]))
    known: dict[tuple[int, bytes, bytes], tuple[Array, Array, Array]] = {}

    def along(k: int) -> tuple[Array, Array, Array]:
        """Return the odds of a block given the others at their present sizes, cached."""
        rest = np.arange(count) != k
        key = (k, sizes[:, rest].tobytes(), grid[:, rest].tobytes())
        if key not in known:
            known[key] = system.along(k, sizes, grid)
        return known[key]

    for _ in range(SWEEPS):
        before = (sizes.copy(), grid.copy())
        for k in order:
            found = along(k)[1]
            most = found.reshape(len(found), -1).argmax(axis=1)
            sizes[:, k], grid[:, k] = np.unravel_index(most, found.shape[1:])
        if np.array_equal(before[0], sizes) and np.array_equal(before[1], grid):
            break
    slack, none = np.zeros((2, count, len(given)))
    for k in order:
        free, found, none[k] = along(k)
        best = free[views, sizes[:, k], grid[:, k]]
        slack[k] = linalg.logsumexp(found, axis=(1, 2)) - np.log(found[0].size) - best
    whole = np.sum(slack, axis=0)
    return [JointBlocks(one.log_evidence + float(odds), sizes[v], grid[v],
                        one.log_evidence + without, *coefficients)
            for v, (one, odds, without, coefficients) in enumerate(zip(
                given, best + whole, (none + whole - slack).T, system.coefficients(sizes, grid),
                strict=True))]


def taken_blocks(given: Conditioned, blocks: Sequence[Block], sizes: Sequence[int] | Ints,
                 grid: Sequence[int] | Ints | None = None) -> Array:
    """Return columns times roots times sizes (n, q): all blocks as one.

    ``sizes``, ``grid``: numbers of each block's size and root; default the first root.
    """
    if not blocks:
        return np.zeros((given.values.size, 0))
    columns = given.columns.some([c for b in blocks for c in b.columns])
    each = np.split(columns, np.cumsum([len(b.columns) for b in blocks])[:-1], axis=1)
    return np.hstack([
        own @ b.own_roots(own.T @ own, given.count)[g] * SIZES[s] for own, b, s, g in
        zip(each, blocks, sizes, [0] * len(blocks) if grid is None else grid, strict=True)])


def coefficients(given: Conditioned, block: Block) -> tuple[Array, Array]:
    """Return mean (k,) and covariance (k, k) of a block's coefficients, given the conditioning.

    Averaged over all sizes and roots by probability: the most probable alone is overconfident.
    """
    values, seen = given.columns.some(block.columns), given.seen[list(block.columns)]
    gram, right = values.T @ values, given.right[list(block.columns)]
    roots = np.array(block.own_roots(gram, given.count))
    own, turn = small_eigh(np.swapaxes(roots, 1, 2) @ (gram - seen @ seen.T) @ roots)
    own, lift = np.maximum(own, 0.0)[:, None], roots @ turn                 # (G, 1, q), (G, k, q)
    part, grown = (right @ lift)[:, None], SIZES[:, None] ** 2
    odds = odds_by_size(given, own[:, 0], part[:, 0] ** 2)                  # (G, S)
    share = np.exp(odds - linalg.logsumexp(odds))
    known = grown / (1.0 + grown * own)                                     # (G, S, q)
    rest = np.maximum(given.spread - np.sum(known * part**2, axis=2), LEAST) / given.freedom
    each = (known * part) @ np.swapaxes(lift, 1, 2)                         # (G, S, k)
    mean = np.einsum("gs,gsk->k", share, each)
    width = np.einsum("gs,gsq->gq", share * rest, known)
    away = (each - mean).reshape(-1, mean.size)
    return mean, np.asarray(np.sum((lift * width[:, None]) @ np.swapaxes(lift, 1, 2), axis=0)
                            + (away * share.reshape(-1, 1)).T @ away)


class _System:
    """Inner products of the columns of some blocks, given the conditioning, for V correlations.

    ``spread`` (V, 1, 1): of the conditioning. ``base``, ``gone`` (V, 1, 1): log odds of blocks
    conditioned on in addition, and the part of the squares that they explain.
    """

    def __init__(self, given: Sequence[Conditioned], blocks: Sequence[Sequence[Block]]) -> None:
        every = [list(dict.fromkeys(c for b in own for c in b.columns)) for own in blocks]
        values = [one.columns.some(own) for one, own in zip(given, every, strict=True)]
        seen = [one.seen[own] for one, own in zip(given, every, strict=True)]
        gram = np.array([own.T @ own for own in values])
        self.freedom, self.spread = given[0].freedom, np.array([
            one.spread for one in given])[:, None, None]
        self.inner = gram - np.array([own @ own.T for own in seen])             # (V, c, c)
        self.right = np.array([one.right[own] for one, own in zip(given, every, strict=True)])
        self.ends = [b.ends for b in blocks[0]]
        place = {c: n for n, c in enumerate(every[0])}
        self.at = [[place[c] for c in b.columns] for b in blocks[0]]
        self.roots = [np.array([own[k].own_roots(square[np.ix_(at, at)], given[0].count)
                                for own, square in zip(blocks, gram, strict=True)])
                      for k, at in enumerate(self.at)]                          # (V, G, k, q)
        self.usual = [usual(roots, *ends, given[0].known)
                      for roots, ends in zip(self.roots, self.ends, strict=True)]
        self.base = self.gone = np.zeros((len(given), 1, 1))
        self._begin()

    def _begin(self) -> None:
        """Count the blocks' columns, and reset their inner products."""
        widths = [roots.shape[3] for roots in self.roots]
        self.block = np.repeat(np.arange(len(widths)), widths)                  # (Q,)
        self.turned = _Turned.nothing(len(self.right), len(widths), self.right.shape[1],
                                      self.block.size)
        widest = int(np.argmax(widths))
        self.widest = widest if widths[widest] > WIDEST and len(widths) > 1 else None
        self._past: tuple[bytes, _System] | None = None

    def along(self, k: int, sizes: Ints, grid: Ints) -> tuple[Array, Array, Array]:
        """Return log odds relative to no block (V, S, G), for block k at every size, others as set.

        First without bounds on its coefficients, then within bounds; last without the block (V,).
        """
        if self.widest not in (None, k):
            others = np.arange(len(self.at)) != self.widest
            return self._past_widest(sizes, grid).along(
                int(np.sum(others[:k])), sizes[:, others], grid[:, others])
        at = self.at[k]
        held, base, gone = self._held(self.block != k, sizes, grid, at)
        taken = np.swapaxes(held[..., :-1], 1, 2) @ held                        # (V, k, k + 1)
        left = self.inner[:, at][..., at] - taken[..., :-1]
        along = (self.right[:, at] - taken[..., -1])[:, None, None]
        roots, (low, high) = self.roots[k], self.ends[k]
        square = np.swapaxes(roots, 2, 3) @ left[:, None] @ roots
        rest = np.maximum(1.0 - gone / self.spread, LEAST)
        none = (base - 0.5 * self.freedom * np.log(rest))[:, 0, 0]
        free = not bounded(low, high).size
        if free and square.shape[-1] > WIDEST:
            out = base + odds_of_wide(self, square, (along @ roots)[..., 0, :], gone)
            return np.swapaxes(out, 1, 2), np.swapaxes(out, 1, 2), none
        own, turn = small_eigh(square)
        part = (along @ roots @ turn)[..., 0, :]
        out = base + odds_by_size(self, own, part**2, gone)
        if free:
            return np.swapaxes(out, 1, 2), np.swapaxes(out, 1, 2), none
        inside = within(self, roots @ turn, own, part, low[None], high[None], gone)
        inside -= self.usual[k][:, None, None]
        return np.swapaxes(out, 1, 2), np.swapaxes(out + inside, 1, 2), none

    def _held(self, taken: Bools, sizes: Ints, grid: Ints, at: Sequence[int] | slice
              ) -> tuple[Array, Array, Array]:
        """Return projections of others and of the values on ``taken`` columns (Q,), (V, q, k + 1).

        Also the log odds of all columns taken, and the part of the squares explained (V, 1, 1).
        """
        turned, rest = self._at_roots(grid), np.flatnonzero(taken)
        scale = SIZES[sizes[:, self.block[rest]]][..., None]                    # (V, q, 1)
        factor = linalg.cholesky(np.eye(rest.size) + scale * np.swapaxes(scale, 1, 2)
                                 * turned.inner[:, rest[:, None], rest])
        held = linalg.solve_lower(factor, scale * np.concatenate(
            [turned.across[:, rest][..., at], turned.right[:, rest, None]], axis=2))
        base = -np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)[:, None, None]
        return held, self.base + base, self.gone + np.sum(held[..., -1:] ** 2, axis=1)[..., None]

    def _past_widest(self, sizes: Ints, grid: Ints) -> _System:
        """Return the system of the others given the widest as set, cached until that changes.

        It is needed repeatedly while the others are varied.
        """
        wide = self.widest
        assert wide is not None
        key = sizes[:, wide].tobytes() + grid[:, wide].tobytes()
        if self._past is None or self._past[0] != key:
            held, base, gone = self._held(self.block == wide, sizes, grid, slice(None))
            past = copy(self)
            past.base, past.gone = base, gone
            past.inner = self.inner - np.swapaxes(held[..., :-1], 1, 2) @ held[..., :-1]
            past.right = self.right - (np.swapaxes(held[..., :-1], 1, 2) @ held[..., -1:])[..., 0]
            for name in ("ends", "at", "roots", "usual"):
                own = getattr(self, name)
                setattr(past, name, [*own[:wide], *own[wide + 1:]])
            past._begin()
            self._past = key, past
        return self._past[1]

    def _at_roots(self, grid: Ints) -> _Turned:
        """Return the columns of all blocks at their roots, updating only changed ones."""
        now, views = self.turned, np.arange(len(grid))
        changed = np.flatnonzero((now.grid != grid).any(axis=0))
        places = [np.flatnonzero(self.block == k) for k in changed]
        for k, own in zip(changed, places, strict=True):
            now.lifts[:, np.array(self.at[k])[:, None], own] = self.roots[k][views, grid[:, k]]
        for own in places:
            lift = now.lifts[..., own]
            now.across[:, own] = np.swapaxes(lift, 1, 2) @ self.inner
            now.inner[:, own] = now.across[:, own] @ now.lifts
            now.inner[..., own] = np.swapaxes(now.inner[:, own], 1, 2)
            now.right[:, own] = np.einsum("vcq,vc->vq", lift, self.right)
        now.grid[:] = grid
        return now

    def coefficients(self, sizes: Ints, grid: Ints
                     ) -> list[tuple[tuple[Array, ...], tuple[Array, ...]]]:
        """Return mean and standard deviation of each block's coefficients (k,), V times."""
        turned, scale = self._at_roots(grid), SIZES[sizes[:, self.block]]       # (V, Q)
        lift, right = turned.lifts * scale[:, None], turned.right * scale
        inverse = linalg.inv(np.eye(self.block.size)
                             + scale[..., None] * scale[:, None] * turned.inner)
        mean = np.einsum("vpq,vq->vp", inverse, right)
        gone = np.sum(right * mean, axis=1, keepdims=True)
        rest = np.maximum(self.spread[..., 0] - gone, LEAST) / self.freedom
        value = np.einsum("vcq,vq->vc", lift, mean)
        sigma = np.sqrt(rest * np.maximum(np.sum((lift @ inverse) * lift, axis=2), 0.0))
        return [(tuple(v[at] for at in self.at), tuple(s[at] for at in self.at))
                for v, s in zip(value, sigma, strict=True)]


@dataclass(frozen=True, eq=False)
class _Turned:
    """Columns (Q) of all blocks multiplied by their roots, numbered by ``grid`` (V, B).

    ``lifts`` (V, c, Q): the roots, in rows of all columns c. Inner products with columns c are
    ``across`` (V, Q, c), with each other ``inner`` (V, Q, Q), with the values ``right`` (V, Q).
    """

    grid: Ints
    lifts: Array
    across: Array
    inner: Array
    right: Array

    @classmethod
    def nothing(cls, views: int, blocks: int, columns: int, count: int) -> _Turned:
        """Return empty arrays for V views, B blocks, c columns and Q root columns."""
        return cls(np.full((views, blocks), -1), np.zeros((views, columns, count)),
                   np.zeros((views, count, columns)), np.zeros((views, count, count)),
                   np.zeros((views, count)))
