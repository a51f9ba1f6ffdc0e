"""The mechanism file of another machine: a geometry that no tolerance allows.

A fit with tolerances moves the geometry by about one of them, whatever else is wrong with the
data, unless something happens in mid-run. The file of a sister machine moves it by five to sixty
(RMS), and often comes to the noise.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, State
from ppmcal.calibration.interpretation.misread import Misread
from ppmcal.calibration.interpretation.misreading import (
    TELLING,
    end_parts,
    explained_times,
    short_fit,
)
from ppmcal.calibration.interpretation.mistakes import Mistake, read_block
from ppmcal.calibration.interpretation.reading_trial import (
    AS_GOOD,
    NOISE,
    Misreading,
    other_registrations,
)
from ppmcal.calibration.interpretation.small_misreading import nearest_readings, read_as
from ppmcal.errors import PpmcalError
from ppmcal.model.instruments import SCALARS
from ppmcal.model.parameters import NO_TOLERANCE
from ppmcal.wording.progress import stage

FAR = 4.0
"""Tolerances from nominal, RMS over the geometry without the drives' zeros,"""
FEWEST = 3
"""and of at least so many parameters: one number typed wrong is no other machine."""
NEAR = 2.0
"""If the first or the last rows alone are this near, and at the noise, it is the machine."""
OFFSET = "offset"


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
    away = _away(problem, state)
    far = sorted((name for name, times in away.items() if times > FAR), key=lambda n: -away[n])
    size = _size(away)
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


def far_from_nominal(problem: Problem, state: State) -> bool:
    """Whether a geometry, zeros of drives left out, is farther than tolerances allow."""
    return _size(_away(problem, state)) > FAR


@stage("is it this machine")
def refuse_other_machine(fit: Fit) -> None:
    """Refuse a fit, with tolerances as prior, whose geometry is none of this machine's.

    Raises:
        Misread: with how far it is from nominal, and where most.
    """
    found = other_machine(fit.problem, fit.state)
    if found is not None:
        raise Misread.of([found], fit.problem.mechanism.units)


def _away(problem: Problem, state: State) -> dict[str, float]:
    """Return by how many tolerances the geometry is from nominal, zeros of drives left out."""
    out = {}
    for i in problem.free:
        parameter = problem.mechanism.parameters[i]
        tau = parameter.prior_sigma
        if tau and parameter.tolerance_class and parameter.tolerance_class != OFFSET:
            out[parameter.name] = abs(float(state.g[i]) - parameter.nominal) / tau
    return out


def _size(away: dict[str, float]) -> float:
    return float(np.sqrt(np.mean(np.square([*away.values()])))) if away else 0.0


def _otherwise(problem: Problem) -> Misreading | None:
    """Return how files would have to be read for the machine to be this one, None if in no way.

    A mistake that bends the geometry leaves little more than noise.
    """
    mechanism = problem.mechanism
    problem = replace(problem, earlier=None)
    try:
        lands = max(NEAR, explained_times(problem))
    except PpmcalError:
        return None
    found: list[tuple[float, float, Misreading]] = []
    for i, data in enumerate(problem.datasets):
        if data.kind in SCALARS or data.commanded is not None:
            continue
        for reading, what, other in (*other_registrations(problem, i), *read_as(
                problem, i, nearest_readings(mechanism, data))):
            with suppress(PpmcalError):
                few, state, left = short_fit(other, lands)
                size = _size(_away(few, state))
                if left <= TELLING and size <= NEAR:
                    block = None if reading is None else read_block(reading, mechanism, data)
                    found.append((left + size, len(what) if reading is None else reading.parts,
                                  Misreading(data.source, what, block, NOISE, np.nan, np.nan,
                                             np.nan)))
    least = min((cost for cost, _, _ in found), default=np.inf)
    near = [f for f in found if f[0] <= AS_GOOD * least]
    return min(near, key=lambda f: f[:2][::-1])[2] if near else None


def _right_in_part(problem: Problem) -> bool:
    for *_, alone in end_parts(problem):
        with suppress(PpmcalError):
            few, state, left = short_fit(alone)
            if left <= TELLING and _size(_away(few, state)) <= NEAR:
                return True
    return False
