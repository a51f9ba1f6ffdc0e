"""Heights and distances that are in another unit than their file says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation.interpretation_error import Interpretation
from ppmcal.calibration.interpretation.limits import AS_GOOD, explains
from ppmcal.calibration.interpretation.readings import ColumnInterpretation
from ppmcal.calibration.interpretation.score import Score, score
from ppmcal.units import LENGTHS

Ways = dict[int, ColumnInterpretation]


def number_units(problem: Problem, before: float) -> tuple[Interpretation, ...]:
    """Return in which unit single numbers fit the machine; empty if in none but their own.

    One of the files may have the mistake, or all of them.

    Args:
        problem: machine and data.
        before: the score of the files as they are read.
    """
    own = [i for i, d in enumerate(problem.datasets)
           if d.kind.scalar and d.kind.of_poses and d.kind.quantity == "length"
           and np.any(np.nan_to_num(d.value))]    # touches at height 0 are so in any unit
    groups = [*([i] for i in own), *([own] if len(own) > 1 else [])]
    tried = (_scored(problem, group, unit) for group in groups for unit in LENGTHS)
    good = [t for t in tried if t is not None and explains(before, t[0].total)]
    if not good:
        return ()
    least = min(found.total for found, _ in good)
    found, ways = next(g for g in good if g[0].total <= AS_GOOD * least)
    return tuple(Interpretation(
        data.source, way.mistakes(data), way.block(data), noise_after=found.noise,
        headers=way.headers(data)) for i, way in ways.items() for data in [problem.datasets[i]])


def _scored(problem: Problem, group: list[int], unit: str) -> tuple[Score, Ways] | None:
    """Return the score with some files in a unit, None if it is their own or nothing fits."""
    datasets, ways = list(problem.datasets), Ways()
    for i in group:
        plain = ColumnInterpretation.as_declared(problem.mechanism, datasets[i])
        if plain.numbers.declared == (unit,):
            return None
        ways[i] = replace(plain, numbers=replace(plain.numbers, units=(unit,)))
        datasets[i] = ways[i].of(datasets[i])
    found = score(problem.afresh(datasets=tuple(datasets)))
    return (found, ways) if np.isfinite(found.noise) else None
