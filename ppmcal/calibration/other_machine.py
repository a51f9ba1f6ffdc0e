"""The mechanism file of another machine: a geometry that no tolerance allows.

A fit with tolerances moves the geometry by about one of them, whatever else is wrong with the
data, unless something happens in mid-run. The file of a sister machine moves it by five to sixty
(RMS), and often comes to the noise.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.misread import Misread
from ppmcal.calibration.misreading import TELLING, end_parts
from ppmcal.calibration.mistakes import NOISE, Misreading, Mistake
from ppmcal.calibration.problem import Problem, State
from ppmcal.calibration.reading_evidence import (
    away_from_nominal,
    best_way,
    leaves,
    misreading,
    rms,
)
from ppmcal.calibration.reading_ways import may_be_misread, ways
from ppmcal.errors import PpmcalError
from ppmcal.model.parameters import NO_TOLERANCE
from ppmcal.wording.progress import stage

FAR = 4.0
"""Tolerances from nominal, RMS over the geometry without the drives' zeros,"""
FEWEST = 3
"""and of at least so many parameters: one number typed wrong is no other machine."""
NEAR = 2.0
"""In a reading that leaves the geometry this near, it is the machine; so it is where the first or
the last rows alone do, and come to the noise."""
NOTHING = (float("nan"), float("nan"))


def other_machine(problem: Problem, state: State) -> Misreading | None:
    """Return that a geometry is none of this machine's, None where tolerances allow it.

    Zeros of drives have no say, nor has a tolerance that the file does not give. Where the first
    or the last rows alone are of this machine, something happened in between, and bent it.

    Args:
        problem: machine and data.
        state: where a fit with the tolerances as prior ended.
    """
    mechanism = problem.mechanism
    if any(NO_TOLERANCE in f for f in mechanism.findings):
        return None
    away = away_from_nominal(problem, state)
    far = sorted((name for name, times in away.items() if times > FAR), key=lambda n: -away[n])
    size = rms([*away.values()])
    if size <= FAR or len(far) < FEWEST or _right_in_part(problem):
        return None
    otherwise = _otherwise(problem)
    if otherwise is not None:
        return otherwise
    words = ", ".join(f"{name} by {away[name]:.0f}" for name in far[:3])
    text = (f"geometry {size:.0f} tolerances from nominal (RMS; {words}): the file of another "
            "machine?")
    return Misreading(mechanism.source, (Mistake("other-machine", tuple(far), text),), None, NOISE,
                      np.nan, np.nan, np.nan)


@stage("is it this machine")
def refuse_other_machine(fit: Fit) -> None:
    """Refuse a fit, with tolerances as prior, whose geometry is none of this machine's.

    Raises:
        Misread: with how far it is from nominal, and where most.
    """
    found = other_machine(fit.problem, fit.state)
    if found is not None:
        raise Misread.of([found], fit.problem.mechanism.units)


def _otherwise(problem: Problem) -> Misreading | None:
    """Return how files would have to be read for the machine to be this one, None if in no way."""
    problem = replace(problem, given=None, earlier=None)
    try:
        as_read = leaves(problem)
    except PpmcalError:
        return None
    found = []
    for i, data in enumerate(problem.datasets):
        if may_be_misread(data):
            best = best_way(ways(problem, i), as_read.score, as_read.times)
            if best is not None and best[1].size <= NEAR:
                found.append((best[1].score, misreading(
                    best[0], problem, i, NOTHING, NOTHING, replace(best[1], noise=np.nan))))
    return max(found, key=lambda f: f[0])[1] if found else None


def _right_in_part(problem: Problem) -> bool:
    for *_, alone in end_parts(problem):
        with suppress(PpmcalError):
            left = leaves(alone)
            if left.noise <= TELLING and left.size <= NEAR:
                return True
    return False
