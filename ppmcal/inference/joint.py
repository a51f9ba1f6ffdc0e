"""Blocks that are in the data together: their sizes, and how likely the values are with them.

Where the geometry is taken, all that some blocks say of the values is in the inner products of
their columns, so that any sizes of theirs cost no more than small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from ppmcal import linalg
from ppmcal.inference.blocks import Block
from ppmcal.inference.evidence import odds_by_size, small_eigh, within
from ppmcal.inference.given import Conditioned
from ppmcal.inference.ranges import LEAST, SIZES, bounded, usual
from ppmcal.linalg import Array, Ints

SWEEPS = 6
"""Each size is chosen again, given the others, at most so often."""


@dataclass(frozen=True, eq=False)
class JointBlocks:
    """Some blocks at the sizes and roots where all together are likeliest.

    Attributes:
        log_evidence: logarithm of the values' density with them, sizes and roots integrated.
        sizes: number of each block's size. grid: of its root.
        values, sigmas: each block's coefficients (k,), mean and standard deviation in units of the
            stated noise.
    """

    log_evidence: float
    sizes: Ints
    grid: Ints
    values: tuple[Array, ...] = ()
    sigmas: tuple[Array, ...] = ()


def joint(given: Conditioned, blocks: Sequence[Block],
          near: Sequence[tuple[int, int] | None] = ()) -> JointBlocks:
    """Return blocks in the data together, given what is taken.

    ``near``: numbers of the size and root of each from which the search for the likeliest starts.
    """
    if not blocks:
        none = np.zeros(0, dtype=np.int64)
        return JointBlocks(given.log_evidence, none, none)
    system = _System(given, blocks)
    start = [own or (len(SIZES) // 2, 0) for own in near or [None] * len(blocks)]
    sizes, grid = (np.array([own[n] for own in start], dtype=np.int64) for n in (0, 1))
    order = sorted(range(len(blocks)), key=lambda k: bool(near and near[k]))
    known: dict[tuple[object, ...], tuple[Array, Array]] = {}

    def along(k: int) -> tuple[Array, Array]:
        """Return what is known of a block beside the others as they are now, asked once."""
        rest = np.arange(len(blocks)) != k
        key = (k, *sizes[rest].tolist(), *grid[rest].tolist())
        if key not in known:
            known[key] = system.along(k, sizes, grid)
        return known[key]

    for _ in range(SWEEPS):
        before = (sizes.copy(), grid.copy())
        for k in order:
            found = along(k)[1]
            sizes[k], grid[k] = np.unravel_index(int(np.argmax(found)), found.shape)
        if np.array_equal(before[0], sizes) and np.array_equal(before[1], grid):
            break
    slack = 0.0
    for k in order:
        free, found = along(k)
        best = float(free[sizes[k], grid[k]])
        slack += float(logsumexp(found)) - float(np.log(found.size)) - best
    return JointBlocks(given.log_evidence + best + slack, sizes, grid,
                       *system.coefficients(sizes, grid))


def taken_blocks(given: Conditioned, blocks: Sequence[Block], sizes: Sequence[int] | Ints,
                 grid: Sequence[int] | Ints | None = None) -> Array:
    """Return columns times roots times sizes (n, q): the block that all of them are.

    ``sizes``, ``grid``: numbers of each block's size and root; default the first root.
    """
    if not blocks:
        return np.zeros((given.values.size, 0))
    columns = given.columns.some([c for b in blocks for c in b.columns])
    each = np.split(columns, np.cumsum([len(b.columns) for b in blocks])[:-1], axis=1)
    return np.hstack([
        own @ b.own_roots(own.T @ own, given.count)[g] * SIZES[s] for own, b, s, g in
        zip(each, blocks, sizes, [0] * len(blocks) if grid is None else grid, strict=True)])


class _System:
    """Inner products of the columns of some blocks, given what is taken."""

    def __init__(self, given: Conditioned, blocks: Sequence[Block]) -> None:
        self.given = given
        every = list(dict.fromkeys(c for b in blocks for c in b.columns))
        at = {c: n for n, c in enumerate(every)}
        values = given.columns.some(every)
        gram = values.T @ values
        seen = given.seen[every]
        self.inner, self.right = gram - seen @ seen.T, given.right[every]
        self.values, self.at = values, [[at[c] for c in b.columns] for b in blocks]
        self.roots = [b.own_roots(gram[np.ix_(i, i)], given.count)
                      for b, i in zip(blocks, self.at, strict=True)]
        self.ends = [b.ends for b in blocks]
        self.usual = [float(usual(np.array(r), *ends, given.known)) for r, ends in
                      zip(self.roots, self.ends, strict=True)]

    def along(self, k: int, sizes: Ints, grid: Ints) -> tuple[Array, Array]:
        """Return log odds against none of them (S, G), block k at every size, the others as set.

        First wherever its coefficient is, then with it between its ends.
        """
        rest = [i for i in range(len(self.roots)) if i != k]
        fixed = self._lifted([(i, int(grid[i]), float(SIZES[sizes[i]])) for i in rest])
        inner, right = fixed.T @ self.inner @ fixed, fixed.T @ self.right
        factor = linalg.cholesky(np.eye(len(inner)) + inner)
        held = linalg.solve(factor, np.column_stack([fixed.T @ self.inner, right]))
        base = -float(np.sum(np.log(np.diagonal(factor))))
        gone = float(held[:, -1] @ held[:, -1])
        left = self.inner - held[:, :-1].T @ held[:, :-1]
        along = self.right - held[:, :-1].T @ held[:, -1]
        at, roots = self.at[k], np.array(self.roots[k])                    # (G, c, q)
        own, turn = small_eigh(roots.transpose(0, 2, 1) @ left[np.ix_(at, at)] @ roots)
        part = np.einsum("gqp,gcq,c->gp", turn, roots, along[at], optimize=True)
        out = np.asarray(base + odds_by_size(self.given, own, part**2, gone).T)
        low, high = self.ends[k]
        if not bounded(low, high).size:
            return out, out
        inside = within(self.given, roots @ turn, own, part, low[None], high[None], gone)
        return out, out + inside.T - self.usual[k]

    def coefficients(self, sizes: Ints, grid: Ints) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Return mean and standard deviation of each block's coefficients (k,)."""
        lift = self._lifted([(i, int(grid[i]), float(SIZES[sizes[i]]))
                             for i in range(len(self.roots))])
        inner, right = lift.T @ self.inner @ lift, lift.T @ self.right
        inverse = linalg.inv(np.eye(len(inner)) + inner)
        mean = inverse @ right
        scale = max(self.given.spread - float(right @ mean), LEAST) / self.given.freedom
        value = lift @ mean
        sigma = np.sqrt(scale * np.maximum(np.sum((lift @ inverse) * lift, axis=1), 0.0))
        return (tuple(value[i] for i in self.at), tuple(sigma[i] for i in self.at))

    def _lifted(self, some: Sequence[tuple[int, int, float]]) -> Array:
        """Return roots times sizes in the rows of all columns (c, q)."""
        out = [np.zeros((self.values.shape[1], 0))]
        for i, g, size in some:
            root = np.zeros((self.values.shape[1], self.roots[i][g].shape[1]))
            np.add.at(root, self.at[i], self.roots[i][g] * size)
            out.append(root)
        return np.hstack(out)
