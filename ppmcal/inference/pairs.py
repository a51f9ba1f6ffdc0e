"""The two events of a group that explain most together: all pairs at once.

Each event's columns are orthonormalised past the conditioning, so that the overlap of two events is
a small matrix K. With w the values projected on each, both together explain

    |w1|^2 + (w2 - K'w1)' (I - K'K)^-1 (w2 - K'w1)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import ColumnSource
from ppmcal.inference.evidence import small_eigh
from ppmcal.inference.given import Conditioned
from ppmcal.linalg import Array, Ints

ROUND_OFF = 1e-9
"""Relative size of a square below which it is only round-off."""


@dataclass(frozen=True, eq=False)
class Events:
    """Events of one group: the columns (E, k) of each, and inner products (E, k, E, k) of all.

    ``which`` (E,): numbers of the blocks, ascending; ``columns``: -1 where an event has fewer than
    others; ``gram`` is zero there.
    """

    which: Ints
    columns: Ints
    gram: Array

    @classmethod
    def of(cls, blocks: Sequence[Block], which: Sequence[int], source: ColumnSource) -> Events:
        """Return the events of some of the blocks."""
        most = max(len(blocks[i].columns) for i in which)
        columns = np.array([(*blocks[i].columns, *[-1] * (most - len(blocks[i].columns)))
                            for i in which])
        there = columns.ravel() >= 0
        values = source.some(columns.ravel()[there].tolist())
        gram = np.zeros((there.size, there.size))
        gram[np.ix_(there, there)] = values.T @ values
        return cls(np.array(which), columns, gram.reshape(*columns.shape, *columns.shape))

    def most(self, given: Conditioned, free: Sequence[int]) -> tuple[int, int, float]:
        """Return the two of some events that explain most of y'My together, and how much.

        Parts of an event that are only round-off past the conditioning, or past the other event,
        explain nothing.
        """
        shared, along = self._orthonormal(given, np.searchsorted(self.which, free))
        first, second = np.triu_indices(len(free), 1)
        both = shared.transpose(1, 3, 0, 2)[:, :, first, second]            # K (k, k, P)
        left = np.eye(len(both))[..., None] - np.einsum("abp,acp->bcp", both, both)
        right = along[second].T - np.einsum("abp,ap->bp", both, along[first].T)
        gain = np.sum(along**2, axis=1)[first]
        for j in range(len(left)):      # elimination column by column, for all pairs at once
            there = left[j, j] > np.sqrt(ROUND_OFF)
            over = np.divide(1.0, left[j, j], out=np.zeros_like(gain), where=there)
            gain += right[j] ** 2 * over
            right[j + 1:] -= left[j + 1:, j] * (right[j] * over)
            left[j + 1:, j + 1:] -= left[j + 1:, None, j] * (left[j, None, j + 1:] * over)
        best = int(np.argmax(gain))
        return free[first[best]], free[second[best]], float(gain[best])

    def _orthonormal(self, given: Conditioned, some: Ints) -> tuple[Array, Array]:
        """Return inner products (E, k, E, k) of the orthonormalised events, and w (E, k)."""
        at, each = self.columns[some], np.arange(some.size)
        there = (at >= 0)[..., None]
        seen = (given.seen[at] * there).reshape(at.size, -1)
        raw = self.gram[some][:, :, some]
        gram = raw - (seen @ seen.T).reshape(raw.shape)
        square = np.diagonal(raw[each, :, each], axis1=1, axis2=2)
        scale = np.divide(1.0, np.sqrt(square), out=np.zeros_like(square), where=square > 0.0)
        own, turn = small_eigh(gram[each, :, each] * scale[:, :, None] * scale[:, None, :])
        length = np.divide(1.0, np.sqrt(np.maximum(own, ROUND_OFF)), out=np.zeros_like(own),
                           where=own > ROUND_OFF)
        lift = scale[:, :, None] * turn * length[:, None, :]                # (E, k, q)
        half = np.einsum("akbl,blq->akbq", gram, lift, optimize=True)
        return (np.einsum("akp,akbq->apbq", lift, half, optimize=True),
                np.einsum("akp,ak->ap", lift, given.right[at] * there[..., 0]))
