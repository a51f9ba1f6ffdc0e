"""Outlying rows, each a block with its own size.

There may be hundreds. Each affects only its own values, so their sizes need no joint search.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.inference.blocks import Block
from ppmcal.inference.evidence import odds_by_size, small_eigh
from ppmcal.inference.given import Conditioned
from ppmcal.inference.ranges import SIZES
from ppmcal.linalg import Array

SWEEPS = 8
"""Maximum sweeps in which each row's size is chosen again, given the others."""
LOST = 1.0
"""Sizes are kept if all rows together lose at most this much log evidence."""


@dataclass(frozen=True)
class RowSize:
    """An outlying row at one size: its number, and the row's log odds over all sizes.

    ``slack``: excess of these over the log odds at that size. Conditional on everything else taken.
    """

    size: int
    log_odds: float
    slack: float

    @classmethod
    def of(cls, log_odds: Array, size: int) -> RowSize:
        """Return it from the log odds at each size (S,)."""
        whole = float(linalg.logsumexp(log_odds)) - float(np.log(log_odds.size))
        return cls(size, whole, whole - float(log_odds[size]))


def sized_rows(given: Conditioned, blocks: Mapping[int, Block], near: Mapping[int, int]
               ) -> dict[int, RowSize]:
    """Return rows outside the conditioning, each at a probable size given the others.

    ``near``: numbers of known sizes; they are kept if hardly worse.
    """
    sizes = {i: near.get(i, SIZES.size // 2) for i in blocks}
    every = rows_left_out(given, blocks, sizes)
    for _ in range(SWEEPS):
        most = {i: int(np.argmax(odds)) for i, odds in every.items()}
        if sum(float(o[most[i]] - o[sizes[i]]) for i, o in every.items()) <= LOST:
            break
        sizes, every = most, rows_left_out(given, blocks, most)
    return {i: RowSize.of(odds, sizes[i]) for i, odds in every.items()}


def rows_left_out(given: Conditioned, blocks: Mapping[int, Block], sizes: Mapping[int, int]
                  ) -> dict[int, Array]:
    """Return the log odds (S,) of each row being an outlier, given that the others are.

    With U of all rows at their sizes, P = (I + U'MU)^-1 and z = P U'My: given the others, a row has
    G = P_ii^-1 - I and b = P_ii^-1 z_i, both at its size.

    Args:
        given: the conditioned data, without any of the rows.
        blocks: the rows, by number, each with one diagonal root.
        sizes: number of each row's size.
    """
    at = [c for b in blocks.values() for c in b.columns]
    if not at:
        return {}
    units = given.columns.some(at)
    seen = given.seen[at]
    ends = np.cumsum([0, *(len(b.columns) for b in blocks.values())])
    scale = np.concatenate([np.diagonal(b.roots[0]) for b in blocks.values()])
    size = np.repeat([SIZES[sizes[i]] for i in blocks], np.diff(ends))
    inner = (scale * size)[:, None] * (units.T @ units - seen @ seen.T) * (scale * size)
    right = scale * size * given.right[at]
    inverse = linalg.inv(np.eye(len(inner)) + inner)
    z = inverse @ right
    explained, numbers = float(right @ z), np.array(list(blocks))
    out: dict[int, Array] = {}
    for width in np.unique(np.diff(ends)).tolist():
        which = np.flatnonzero(np.diff(ends) == width)
        mine = ends[which][:, None] + np.arange(width)                       # (R, k)
        alone = linalg.inv(inverse[mine[:, :, None], mine[:, None, :]])      # (R, k, k)
        own, turn = small_eigh((alone - np.eye(width)) / size[mine[:, :1], None] ** 2)
        past = np.einsum("rkl,rl->rk", alone, z[mine])
        part = np.einsum("rkp,rk->rp", turn, past) / size[mine[:, :1]]
        gone = explained - np.sum(z[mine] * past, axis=1, keepdims=True)     # by the other rows
        none = -0.5 * given.freedom * np.log1p(-gone / given.spread)
        odds = odds_by_size(given, own, part**2, gone) - none
        out |= dict(zip(numbers[which].tolist(), odds, strict=True))
    return {i: out[i] for i in blocks}
