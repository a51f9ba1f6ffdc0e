"""The mechanism file of another machine: a geometry that no tolerance allows.

A fit with tolerances moves the geometry by about one of them, whatever else is wrong with the
data (files of `benchmarks/wild` with causes of three times the noise: at most 1.1, RMS). The file
of a sister machine moves it by five to sixty, and often comes to the noise.
"""

from __future__ import annotations

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.misread import Misread
from ppmcal.calibration.mistakes import Mistake
from ppmcal.calibration.problem import Problem, State
from ppmcal.calibration.reading_trial import NOISE, Misreading
from ppmcal.model.parameters import NO_TOLERANCE

FAR = 4.0
"""Tolerances from nominal, RMS over the geometry without the drives' zeros,"""
FEWEST = 3
"""and of at least so many parameters: one number typed wrong is no other machine."""
OFFSET = "offset"


def other_machine(problem: Problem, state: State) -> Misreading | None:
    """Return that a geometry is none of this machine's, None where tolerances allow it.

    Zeros of drives have no say, nor has a tolerance that the file does not give.

    Args:
        problem: machine and data.
        state: where a fit with the tolerances as prior ended.
    """
    mechanism = problem.mechanism
    if any(NO_TOLERANCE in f for f in mechanism.findings):
        return None
    away = {}
    for i in problem.free:
        parameter = mechanism.parameters[i]
        tau = parameter.prior_sigma
        if tau and parameter.tolerance_class and parameter.tolerance_class != OFFSET:
            away[parameter.name] = abs(float(state.g[i]) - parameter.nominal) / tau
    size = float(np.sqrt(np.mean(np.square([*away.values()])))) if away else 0.0
    far = sorted((name for name, times in away.items() if times > FAR), key=lambda n: -away[n])
    if size <= FAR or len(far) < FEWEST:
        return None
    words = ", ".join(f"{name} by {away[name]:.0f}" for name in far[:3])
    text = (f"geometry {size:.0f} tolerances from nominal (RMS; {words}): the file of another "
            "machine?")
    return Misreading(mechanism.source, (Mistake("other-machine", tuple(far), text),), None, NOISE,
                      np.nan, np.nan, np.nan)


def refuse_other_machine(fit: Fit) -> None:
    """Refuse a fit, with tolerances as prior, whose geometry is none of this machine's.

    Raises:
        Misread: with how far it is from nominal, and where most.
    """
    found = other_machine(fit.problem, fit.state)
    if found is not None:
        raise Misread.of([found], fit.problem.mechanism.units)
