"""Misinterpreted columns, as hypotheses next to those of the library.

A column in another unit gives its effect an implausible size: the hypothesis is the same effect of
any size. Directions recorded with the opposite sign in some rows reverse their effect there;
reversing all rows gives the same machine, so a block of rows is equivalent to its complement.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.hypotheses import Collector, Hypothesis
from ppmcal.diagnosis.linear_system import System
from ppmcal.linalg import Array, Ints

COLUMNS = {"load": "payload or fx ... mz", "wrench": "payload or fx ... mz",
           "vel": "vel_", "dir": "dir_", "temperature": "temperature", "time": "time"}
"""The columns to check, by an effect's input."""
TINY, SEEN = 1e-200, 1e-9
"""Round-off: of sizes, and of columns past the geometry."""
FEWEST = 6
"""Fewest rows in a block, and in the rest of its file."""
LIKELY = 16
"""Blocks of each effect that are examined further: those that explain most past the geometry."""


def misread_columns(to: Collector) -> list[Hypothesis]:
    """Return the library's effects as they would be if a column were misread.

    A size alone shows a wrong unit only for effects with one coefficient and no grid.
    """
    return [*_of_other_units(to), *_turned(to)]


def _of_other_units(to: Collector) -> Iterator[Hypothesis]:
    for h in to.hypotheses:
        if h.effect is None or h.size != 1 or h.scanned or h.requires:
            continue
        names = dict.fromkeys(COLUMNS[n] for n in h.effect.needs if n in COLUMNS)
        what = h.effect.doubt or " and ".join(names)
        ends = [h.low[0], h.high[0], *(h.usual[0] if h.usual else ())]
        if what and any(np.isfinite(end) and abs(end) > TINY for end in ends):
            low, high = max(ends[::2]), min(ends[1::2])
            yield replace(h, usual=(), starts=(), low=(0.0 if low >= 0.0 else -np.inf,),
                          high=(0.0 if high <= 0.0 else np.inf,),
                          misread=f"{what} in another unit")


def _turned(to: Collector) -> Iterator[Hypothesis]:
    """Yield effects of directions with these reversed in a block of rows, or in whole files."""
    effects = [h for h in to.hypotheses if h.effect and h.effect.needs == ("dir",)
               and not h.effect.title and not h.constants and not h.sessions]
    if not effects:
        return
    system = to.system
    past = _Past(system)
    begin, end = _stretches(system)
    if not begin.size:
        return
    for h in effects:
        columns = [to.columns.value(c) for c in h.columns]
        gain = sum(past.explained(column, begin, end) for column in columns)
        best = np.argsort(-gain, kind="stable")[:LIKELY]
        for b, e in zip(begin[best].tolist(), end[best].tolist(), strict=True):
            sign = np.ones(system.dataset.size)
            sign[b:e] = -1.0
            yield replace(h, starts=(), columns=tuple(to.columns.later(c, sign) for c in columns),
                          choices=float(np.log(begin.size)),
                          misread=f"dir_{' dir_'.join(h.on or to.actuators)} turned",
                          follows=_where(system, b, e), stretch=(b, e))


def _where(system: System, begin: int, end: int) -> str:
    """Return a description of rows of a system by their numbers in the file."""
    data = system.problem.datasets[int(system.dataset[begin])]
    first, last = data.rows[system.row[[begin, end - 1]]].tolist()
    return f"rows {first} to {last} of {data.name}"


def _stretches(system: System) -> tuple[Ints, Ints]:
    """Return the begins and ends of all blocks of rows within one file.

    If a block's complement is a block too, they are equivalent, and only the shorter is used.
    """
    out = [np.zeros((2, 0), dtype=np.int64)]
    for i, data in enumerate(system.problem.datasets):
        rows = np.flatnonzero(system.dataset == i)
        if data.approach == "sequence" or rows.size < 2 * FEWEST:
            continue
        begin, end = (rows[0] + at for at in np.triu_indices(rows.size + 1, FEWEST))
        left = system.dataset.size - (end - begin)
        other = (begin == 0) | (end == system.dataset.size)
        used = (left >= FEWEST) & ~(other & (left < end - begin))
        out.append(np.stack([begin[used], end[used]]))
    begin, end = np.concatenate(out, axis=1)
    return begin, end


class _Past:
    """The residual past the geometry, and how much of it columns reversed in a block explain."""

    def __init__(self, system: System) -> None:
        flat = system.jacobian.reshape(system.residual.size, -1) * system.observed.reshape(-1, 1)
        left, size, _ = linalg.svd(flat)
        self.basis = left[:, size > SEEN * size.max(initial=0.0)]
        residual = system.residual.reshape(-1) * system.observed.reshape(-1)
        self.residual = residual - self.basis @ (self.basis.T @ residual)
        self.observed = system.observed

    def explained(self, column: Array, begin: Ints, end: Ints) -> Array:
        """Return the drop in squares with a column (N, m) reversed in each block (S,)."""
        own = column * self.observed
        rows = len(own)
        value = np.sum(own * self.residual.reshape(rows, -1), axis=1)
        seen = np.einsum("nm,nmr->nr", own, self.basis.reshape(rows, own.shape[1], -1))
        value, seen = (np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)])
                       for x in (value, seen))
        along = value[-1] - 2.0 * (value[end] - value[begin])
        hidden = np.sum((seen[-1] - 2.0 * (seen[end] - seen[begin])) ** 2, axis=1)
        length = float(np.sum(own**2))
        return np.asarray(along**2 / np.maximum(length - hidden, SEEN * length + TINY))
