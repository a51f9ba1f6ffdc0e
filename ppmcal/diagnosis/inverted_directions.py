"""Directions that are recorded with another sign in one stretch of the rows than in the others.

Either sign of a direction's effect is a machine's, but one and the same sign in all rows. Where the
column changed its meaning, the effect explains far more with it turned in these rows. Every stretch
on a grid is tried, all from the same running sums. Turning all rows changes nothing, and a stretch
and all rows but these are one thing: the shorter is told.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.interpretation import Misreading, Mistake, with_line
from ppmcal.diagnosis.added_variable_test import VISIBLE
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.plausibility import MUCH_BETTER, nearest, of_column
from ppmcal.diagnosis.result import Found
from ppmcal.diagnosis.selection import bic
from ppmcal.diagnosis.stage import Stage, form_columns
from ppmcal.linalg import Array, Bools, Ints

ENDS = 60
"""Ends of stretches that are tried; then every row near the best."""
FEWEST = 6
"""Rows that a stretch must have, and leave."""
MOSTLY = 0.25
"""Of what exceeds the noise no more than this may be left."""
SURE_SIZE = 2.5
"""A size may miss its range by so many standard deviations."""
SAME = 9
"""Digits in which what two stretches leave is compared: else rounding would choose."""


@dataclass(frozen=True)
class _Stretch:
    """Rows ``begin`` to ``end`` of a system, turned, and what is left with them turned.

    ``absent``: the BIC at best if some rows show nothing of the effect instead.
    """

    begin: int
    end: int
    bic: float
    left: float
    absent: float
    hypothesis: Hypothesis

    @property
    def order(self) -> tuple[float, int]:
        """What the best has least of."""
        return round(self.bic, SAME - 3), self.end - self.begin


def inverted_directions(found: Found, chosen: Sequence[Hypothesis]) -> Misreading | None:
    """Return in which rows directions are recorded another way than in the rest, None if in none.

    Args:
        found: the search.
        chosen: what was chosen at last.
    """
    stage = found.first
    search = stage.search
    now = bic(search, nearest(search, chosen)) - MUCH_BETTER
    best: _Stretch | None = None
    for hypothesis in stage.library.hypotheses:
        kind = hypothesis.effect
        if kind is None or kind.title or kind.needs != ("dir",) or hypothesis.searched:
            continue
        for stretch in _stretches(stage, hypothesis):
            if stretch.bic < now and (best is None or stretch.order < best.order):
                best = stretch
    if best is None or best.absent <= best.bic or not _clean(stage, best):
        return None     # in rows that do not show it at all, nothing has turned
    return _told(found, best)


def _clean(stage: Stage, stretch: _Stretch) -> bool:
    """Whether hardly anything is left with these rows turned: else something else is wrong.

    Where nothing exceeded the noise before, nothing is wrong.
    """
    n = stage.search.test.freedom
    before, after = (max(square / n - 1.0, 0.0) for square in (stage.search.test.square,
                                                               stretch.left))
    return before > 0.0 and after <= MOSTLY * before


def _stretches(stage: Stage, hypothesis: Hypothesis) -> Iterator[_Stretch]:
    """Yield the best stretch of each file that records its directions."""
    for i, data in enumerate(stage.system.problem.datasets):
        rows = np.flatnonzero(stage.system.dataset == i)
        if data.approach == "sequence" or rows.size < 2 * FEWEST:
            continue
        sums = _Sums(stage, hypothesis)
        ends = np.append(rows, rows[-1] + 1)
        coarse = np.unique(ends[np.linspace(0, rows.size, min(ENDS, rows.size) + 1).astype(int)])
        turned, absent = (_nearer(sums, ends, coarse, shown) for shown in (-1.0, 0.0))
        if turned is not None:
            yield _Stretch(*turned, np.inf if absent is None else absent[2], hypothesis)


def _nearer(sums: _Sums, ends: Ints, coarse: Ints, shown: float
            ) -> tuple[int, int, float, float] | None:
    """Return the best rows, as :meth:`_Sums.best` does: of a few ends, then of those around."""
    one = sums.best(coarse, coarse, shown)
    if one is None:
        return None
    step = max(1, (ends.size - 1) // ENDS)
    near = [np.intersect1d(ends, np.arange(at - step, at + step + 1)) for at in one[:2]]
    return sums.best(near[0], near[1], shown) or one


class _Sums:
    """Running sums over rows of a hypothesis's columns with the residual and the geometry."""

    def __init__(self, stage: Stage, hypothesis: Hypothesis) -> None:
        n, m = stage.system.residual.shape
        self.stage, self.hypothesis = stage, hypothesis
        columns = form_columns(stage, hypothesis)
        length = np.linalg.norm(columns, axis=0)
        self.length = np.where(length > 0.0, length, 1.0)
        unit = (columns / self.length).reshape(n, m, -1)
        free = stage.residual - stage.basis @ (stage.basis.T @ stage.residual)
        basis = stage.basis.reshape(n, m, -1)

        def running(values: Array) -> Array:
            return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])

        self.right = running(np.einsum("nmk,nm->nk", unit, free.reshape(n, m)))
        self.hidden = running(np.einsum("nmr,nmk->nrk", basis, unit))
        self.square = float(free @ free)
        self.own = running(np.einsum("nmk,nml->nkl", unit, unit))

    def best(self, begins: Ints, ends: Ints, shown: float
             ) -> tuple[int, int, float, float] | None:
        """Return the best rows that show ``shown`` times the effect, -1 if they are turned.

        First, last + 1, BIC, and the sum of squares left.
        """
        b, e = (p.reshape(-1) for p in np.meshgrid(begins, ends, indexing="ij"))
        long = e - b
        b, e = (p[(long >= FEWEST) & (long <= self.right.shape[0] - 1 - FEWEST)] for p in (b, e))
        order = np.argsort(e - b, kind="stable")    # of what is the same the shortest
        b, e = b[order], e[order]
        right = self.right[-1] - (1.0 - shown) * (self.right[e] - self.right[b])
        hidden = self.hidden[-1] - (1.0 - shown) * (self.hidden[e] - self.hidden[b])
        gram = self.own[-1] - (1.0 - shown**2) * (self.own[e] - self.own[b])
        inverse = linalg.pinv(gram - np.swapaxes(hidden, 1, 2) @ hidden, VISIBLE,
                                 hermitian=True)
        value = np.einsum("pkl,pl->pk", inverse, right)
        left = self.square - np.sum(right * value, axis=1)
        n = self.stage.search.test.freedom
        noise = np.sqrt(np.maximum(np.diagonal(inverse, axis1=1, axis2=2) * left[:, None], 0.0) / n)
        left = np.where(self._physical(value, noise), left, np.inf)
        if not np.isfinite(left).any():
            return None
        i = int(np.argmin(np.round(left / max(self.square, 1e-300), SAME)))
        gain = np.log(max(left[i], 1e-300) / max(self.square, 1e-300))
        change = n * gain + (right.shape[1] + 2.0) * np.log(n)
        return (int(b[i]), int(e[i]), bic(self.stage.search, ()) + float(change),
                float(left[i]))

    def _physical(self, value: Array, noise: Array) -> Bools:
        """Whether sizes (p, k) are in the range of machines (p,)."""
        slack = SURE_SIZE * noise / self.length
        size = value / self.length
        h = self.hypothesis
        usual = h.usual or ((-np.inf, np.inf),) * h.size
        low = np.maximum(h.low, [u[0] for u in usual]) - slack
        high = np.minimum(h.high, [u[1] for u in usual]) + slack
        return np.asarray(np.all((size >= low) & (size <= high), axis=1))


def _told(found: Found, stretch: _Stretch) -> Misreading:
    stage = found.first
    problem = stage.system.problem
    at = slice(stretch.begin, stretch.end)
    data = problem.datasets[int(stage.system.dataset[stretch.begin])]
    own = np.flatnonzero(stage.system.dataset == stage.system.dataset[stretch.begin])
    numbers = data.rows[stage.system.row[at]]
    rows = tuple(range(int(numbers[0]), int(numbers[-1]) + 1))
    names = tuple(f"dir_{a}" for a in stretch.hypothesis.on or problem.mechanism.actuators)
    whole = own.size == stretch.end - stretch.begin
    block = with_line(data, "signs", dict.fromkeys(names, -1)) if whole else None
    where, others = ("", "files") if whole else (f"rows {rows[0]} to {rows[-1]}: ", "rows")
    text = (f"{where}dir_ of {', '.join(stretch.hypothesis.on)} has another sign than in the other "
            f"{others}: {stretch.hypothesis.label} then explains all of them alike")
    mistake = Mistake("sign", names, text, () if whole else rows)
    return of_column(data.source, mistake, block, stage, stretch.left)
