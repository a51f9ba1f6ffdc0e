"""Whether files were read as they were meant: one path for check, identify and diagnose.

Before the fit: units of the environment, readings against the nominal machine, and a part of the
rows that goes astray. After it, in this order: mistakes that tolerances hide, mistakes in some of
the rows, and the file of another machine, which is what is left where nothing else explains it.
"""

from __future__ import annotations

from contextlib import suppress

from ppmcal.calibration.fit import Fit, Problem, identify
from ppmcal.calibration.interpretation.misread import Misread
from ppmcal.calibration.interpretation.misreading import (
    TELLING,
    Misfit,
    misfit,
    refuse_misread,
    refuse_small_misreading,
    short_fit,
)
from ppmcal.calibration.interpretation.obvious_mistakes import refuse_wrong_units
from ppmcal.calibration.interpretation.other_machine import far_from_nominal, refuse_other_machine
from ppmcal.calibration.interpretation.reading_trial import Misreading
from ppmcal.calibration.interpretation.wrong_rows import (
    refuse_wrong_part,
    refuse_wrong_rows,
    wrong_parts,
)
from ppmcal.errors import PpmcalError


def refuse_before_fit(problem: Problem, every_column: bool = False) -> None:
    """Refuse measurements that show without a fit of all rows that they are read wrongly.

    Args:
        problem: machine and data.
        every_column: columns of the environment count, also where no effect of the machine asks
            for them.

    Raises:
        Misread: with how they are to be read, where that is found.
    """
    if every_column or problem.mechanism.effects:
        refuse_wrong_units(problem.mechanism, problem.datasets)
    if refuse_misread(problem).doubted:
        refuse_wrong_part(problem)


def refuse_after_fit(fit: Fit) -> None:
    """Refuse measurements of which the fit shows that they, or some rows, are read wrongly.

    Raises:
        Misread: with how they are to be read.
    """
    refuse_small_misreading(fit)
    refuse_wrong_rows(fit)


def found_wrong(problem: Problem) -> tuple[Misfit, tuple[Misreading, ...]]:
    """Return how far measurements are from a machine, and what the refusals would say of them.

    A fit of all rows is made only where a short one leaves more than noise, or goes far.
    """
    found = misfit(problem)
    if found.readings or found.misread:
        return found, found.readings
    parts = wrong_parts(problem) if found.doubted else ()
    return found, parts or _by_fit(problem)


def _by_fit(problem: Problem) -> tuple[Misreading, ...]:
    try:
        with suppress(PpmcalError):
            few, state, left = short_fit(problem)
            if left <= TELLING and not far_from_nominal(few, state):
                return ()
        fit = identify(problem)
        refuse_after_fit(fit)
        refuse_other_machine(fit)
    except Misread as error:
        return error.found
    except PpmcalError:
        return ()    # a fit that cannot be had tells nothing of the file
    return ()
