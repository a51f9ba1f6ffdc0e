"""Whether files were read as they were meant: one path for check, identify and diagnose.

Before the fit: units of the environment, files that the tolerances do not explain, and a part of
the rows that goes astray. After it: files that leave more than noise or bend the geometry, mistakes
in some of the rows, and the file of another machine, which is what is left where nothing else
explains it.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, State, distances, identify
from ppmcal.calibration.interpretation.judgement import find_misreading
from ppmcal.calibration.interpretation.limits import (
    ALLOWED,
    FAR,
    FEWEST_PARAMETERS,
    LANDS,
    TELLING,
)
from ppmcal.calibration.interpretation.misread import Misread, Misreading, Mistake
from ppmcal.calibration.interpretation.obvious_mistakes import (
    other_zeros,
    refuse_wrong_units,
    with_positive_struts,
)
from ppmcal.calibration.interpretation.score import (
    Look,
    Score,
    end_parts,
    right_parts,
    rms,
    score,
    tolerances_away,
)
from ppmcal.calibration.interpretation.wrong_rows import wrong_parts, wrong_rows
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.model.parameters import NO_TOLERANCE
from ppmcal.wording.progress import stage

log = logging.getLogger(__package__)

MEND = ("Check the order and signs of the q columns, their units, and how the rotation is written "
        "(rotation vector rx, ry, rz; quaternion x, y, z, w; from platform to base). If the "
        "machine really is that far from its nominal geometry, give larger tolerances")


def misfit(problem: Problem) -> Score:
    """Return how far measurements are from a machine, and how they may have been meant.

    Args:
        problem: machine and data; where there are many rows, some of them are looked at.

    Raises:
        BadInput: as :meth:`ppmcal.calibration.fit.Problem.start`.
    """
    turned = [with_positive_struts(d, problem.mechanism) for d in problem.datasets]
    if not any(sign for _, sign in turned):
        return _misfit(problem)
    found = _misfit(replace(problem, given=None, datasets=tuple(d for d, _ in turned)))
    other = {m.source: m for m in found.readings}
    readings = ((sign, other.get(d.source, Misreading(d.source, (), dict(d.read))))
                for d, sign in turned)
    return replace(found, readings=tuple(replace(m, mistakes=(*sign, *m.mistakes))
                                         for sign, m in readings if sign or m.mistakes))


def _misfit(problem: Problem) -> Score:
    """Return what :func:`misfit` does, of joints whose signs are right."""
    try:
        look = Look.at(problem)
    except BadInput:
        found = tuple(m for m in _misreadings(problem) if m.noise_after <= TELLING)
        found = found or _other_zeros(problem)
        if not found:
            raise
        return Score(readings=found)
    as_read = look.score(0.0)
    if as_read.total <= LANDS:
        return as_read
    # a way that explains everything needs no fit of what is read wrongly, which is slow
    found = _misreadings(problem)
    if found:
        return replace(as_read, readings=found)
    fitted = look.score(np.inf)
    found = _other_zeros(problem) if fitted.noise > TELLING else ()
    if not found and any(True for _ in right_parts(problem)):
        return as_read
    return replace(fitted, readings=found)


def _misreadings(problem: Problem) -> tuple[Misreading, ...]:
    found = (find_misreading(problem, i) for i in range(len(problem.datasets)))
    return tuple(m for m in found if m is not None)


def _other_zeros(problem: Problem) -> tuple[Misreading, ...]:
    return tuple(m for d in problem.datasets for m in other_zeros(d, problem.mechanism))


@stage("trying other readings")
def refuse_misread(problem: Problem) -> None:
    """Refuse measurements that are not of this machine as the files are read.

    Raises:
        Misread: neither tolerances nor another geometry explain them, or the first rows do and
            others do not; it says how they are to be read, where that is found.
    """
    found = misfit(problem)
    log.info("other readings of the files: %s", f"{len(found.readings)} found" if found.readings
             else "none needed" if not found.misread else "none found")
    _refuse(found.readings, problem)
    if found.misread:
        raise Misread(found.sentence(problem.mechanism.units),
                      ", ".join(d.source for d in problem.datasets), MEND)
    if found.doubted:
        _refuse(wrong_parts(problem), problem)


def _refuse(found: Sequence[Misreading], problem: Problem) -> None:
    if found:
        raise Misread.of(found, problem.mechanism.units)


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
    refuse_misread(problem)


def refuse_after_fit(fit: Fit) -> None:
    """Refuse measurements of which the fit shows that they, or some rows, are read wrongly.

    Raises:
        Misread: with how they are to be read.
    """
    left = distances(fit.problem, fit.state).times(fit.keep)
    if left > TELLING or rms(tolerances_away(fit.problem, fit.state)) > FAR:
        _refuse(_misreadings(replace(fit.problem, earlier=None)), fit.problem)
    _refuse(wrong_rows(fit), fit.problem)


def other_machine(problem: Problem, state: State) -> Misreading | None:
    """Return that a geometry is none of this machine's, None where tolerances allow it.

    A fit with tolerances moves the geometry by about one of them, whatever else is wrong with the
    data; the file of a sister machine moves it by five to sixty, and often comes to the noise.
    Zeros of drives have no say, nor has a tolerance that the file does not give. Where the first
    or the last rows alone are of this machine, something happened in between, and bent it.

    Args:
        problem: machine and data, whose files no other reading explains.
        state: where a fit with the tolerances as prior ended.
    """
    mechanism = problem.mechanism
    if any(NO_TOLERANCE in f for f in mechanism.findings):
        return None
    away = tolerances_away(problem, state)
    far = sorted((name for name, times in away.items() if times > FAR), key=lambda n: -away[n])
    if rms(away) <= FAR or len(far) < FEWEST_PARAMETERS:
        return None
    if any(part.noise <= TELLING and part.geometry <= ALLOWED
           for *_, part in end_parts(problem, np.inf)):
        return None
    words = ", ".join(f"{name} by {away[name]:.0f}" for name in far[:3])
    text = (f"geometry {rms(away):.0f} tolerances from nominal (RMS; {words}): the file of another "
            "machine?")
    return Misreading(mechanism.source, (Mistake("other-machine", tuple(far), text),))


@stage("is it this machine")
def refuse_other_machine(fit: Fit) -> None:
    """Refuse a fit, with tolerances as prior, whose geometry is none of this machine's.

    Raises:
        Misread: with how far it is from nominal, and where most.
    """
    found = other_machine(fit.problem, fit.state)
    _refuse([found] if found else [], fit.problem)


def refusal(problem: Problem) -> Misread | None:
    """Return what the refusals say of measurements, None where they let them through.

    A fit of all rows is made only where a short one leaves more than noise, or goes far.
    """
    try:
        refuse_misread(problem)
    except Misread as error:
        return error
    if score(problem, np.inf).total > TELLING:
        # a fit that cannot be had tells nothing of the file
        with suppress(PpmcalError):
            try:
                fit = identify(problem)
                refuse_after_fit(fit)
                refuse_other_machine(fit)
            except Misread as error:
                return error
    return None
