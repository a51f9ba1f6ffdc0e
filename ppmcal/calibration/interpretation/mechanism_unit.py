"""A mechanism file whose lengths are in another unit than it says, or measurements whose are."""

from __future__ import annotations

import numpy as np

from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    unit_words,
)
from ppmcal.calibration.interpretation.limits import TELLING, explains
from ppmcal.calibration.interpretation.score import score
from ppmcal.model.scaled_points import scaled_lengths
from ppmcal.units import LENGTHS


def other_unit(problem: Problem, before: float) -> tuple[Interpretation, ...]:
    """Return in which unit the machine's lengths fit the measurements; empty if in none.

    A machine of another size is the same as measurements of which all lengths are in another
    unit: which file is wrong does not show.

    Args:
        problem: machine and data.
        before: the score of the files as they are read.
    """
    mechanism = problem.mechanism
    stated = mechanism.units.length
    for unit, size in LENGTHS.items():
        factor = size / LENGTHS[stated]
        if unit == stated:
            continue
        other = scaled_lengths(mechanism, factor)
        found = score(problem.afresh(mechanism=other))
        if np.isfinite(found.noise) and found.total <= TELLING and explains(before, found.total):
            times, than = (1.0 / factor, "larger") if factor < 1.0 else (factor, "smaller")
            text = (f"the machine of {mechanism.source} is {times:.4g} times {than} than the one "
                    f"that was measured: its lengths seem to be in {unit_words(unit)}, not in "
                    f"{unit_words(stated)}")
            return (Interpretation(mechanism.source, (FileFault("machine-unit", (), text),), {},
                                   noise_after=found.noise),)
    return ()
