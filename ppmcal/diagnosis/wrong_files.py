"""Files that are outliers as a whole: they are inferred like causes, and then left out."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Problem
from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.question import FILE_FAMILY
from ppmcal.inference.priors import SURE

REASON = "the whole file contradicts the other files: it is of another machine, or misread"


def wrong_files(asked: Round) -> frozenset[str]:
    """Return the names of the files that are almost certainly outliers."""
    blocks, answer = asked.asked.question.blocks, asked.answer
    return frozenset(blocks[i].name for i in answer.best.chosen if blocks[i].family == FILE_FAMILY
                     and answer.probability[i] > SURE.value)


def without(problem: Problem, names: Container[str]) -> Problem:
    """Return a problem in which no row of the named files is used."""
    return replace(problem, datasets=tuple(
        d.without(np.ones(len(d), dtype=bool), REASON) if d.name in names else d
        for d in problem.datasets))
