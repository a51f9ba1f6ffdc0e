"""A check that selects nothing: predictions of left-out rows by geometry and by model averaging."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.held_out_gap import Gap
from ppmcal.diagnosis.left_out_schemes import SESSION, schemes
from ppmcal.diagnosis.result import LeftOutBlocks, Predictions
from ppmcal.inference.block_sets import state
from ppmcal.inference.given import Conditioned
from ppmcal.inference.predictive import LeftOutGroups, averaged
from ppmcal.inference.priors import COUNTS
from ppmcal.linalg import Array, Ints


def predictions(asked: Round) -> tuple[LeftOutBlocks, ...]:
    """Return how well left-out rows are predicted, at the most probable noise.

    Outliers count for neither model: both treat the outliers of the most probable set as such.

    Raises:
        LinearAlgebraError: if rows are determined exactly by the others.
    """
    answer, question = asked.answer, asked.asked.question
    noise, rows = answer.best.likeliest[0], list(asked.wrong)
    sets = [sorted(key) for key, p in answer.log_p.items() if p > np.log(COUNTS.value)]
    whole, bare = (list(_models(asked, some, noise)) for some in (sets or [rows], [rows]))
    belong = question.observed.copy()
    belong[[n for own in asked.wrong.values() for n in own]] = False
    out = []
    for by, label in _labels(asked):
        group = np.where(belong, label[:, None], -1).reshape(-1)
        numbers, places = np.unique(group[group >= 0], return_inverse=True)
        if numbers.size > 1:
            group[group >= 0] = places.reshape(-1)
            out.append(_compared(by, averaged(bare, group), averaged(whole, group)))
    return tuple(out)


def session_gap(found: Sequence[LeftOutBlocks]) -> Gap | None:
    """Return the gap on sessions left out in turn, None without sessions."""
    by = next((b for b in found if b.by == SESSION), None)
    if by is None:
        return None
    before, after = by.geometry.error, by.averaged.error
    closed = 1.0 - float(np.sqrt(max(after**2 - 1.0, 0.0) / (before**2 - 1.0))) if (
        before > 1.0) else None
    return Gap(1.0, before, after, closed, None, by.surely_better, by.surely_worse, by.blocks)


def _models(asked: Round, sets: Sequence[Sequence[int]], noise: int
            ) -> Iterator[tuple[float, Conditioned]]:
    for chosen in sets:
        at = state(asked.asked.question, chosen, [noise])
        _, log_p, found = at.likeliest
        yield log_p, at.given(noise, found)


def _labels(asked: Round) -> Iterator[tuple[str, Ints]]:
    """Yield each scheme of leaving rows out, and the block (N,) of each row, -1 for none."""
    system = asked.asked.system
    yield "pose", system.group
    for by, folds in schemes(asked.fit.problem):
        label = np.full(system.row.size, -1, dtype=np.int64)
        for n, masks in enumerate(folds):
            label[[bool(masks[d][r]) for d, r in zip(system.dataset, system.row, strict=True)]] = n
        yield by, label


def _compared(by: str, bare: LeftOutGroups, whole: LeftOutGroups) -> LeftOutBlocks:
    gain = whole.log_score - bare.log_score
    return LeftOutBlocks(by, gain.size, _told(bare), _told(whole), float(gain.sum()),
                         _sigma(gain))


def _told(found: LeftOutGroups) -> Predictions:
    count = max(int(found.count.sum()), 1)
    mean = float(found.square.sum()) / count
    error = float(np.sqrt(mean))
    apart = _sigma(found.square - mean * found.count) / count
    return Predictions(float(found.log_score.sum()), _sigma(found.log_score), error,
                       apart / max(2.0 * error, 1e-300))


def _sigma(each: Array) -> float:
    """Return the standard error of the sum of the blocks' values (G,)."""
    return float(np.sqrt(each.size) * np.std(each, ddof=1))
