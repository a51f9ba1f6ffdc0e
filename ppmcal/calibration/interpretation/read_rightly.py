"""Whether files were read as they were meant: one path for check, identify and diagnose.

Before the fit: units of the environment, files that the tolerances do not explain, and a part of
the rows that goes astray. After it: files that leave more than noise or bend the geometry, mistakes
in some of the rows, and the file of another machine, which is what is left where nothing else
explains it.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, State, beyond, distances, identify
from ppmcal.calibration.interpretation.judgement import find_misreading
from ppmcal.calibration.interpretation.limits import (
    ALLOWED,
    FAR,
    FEWEST_PARAMETERS,
    HARDLY_LESS,
    LANDS,
    MANY_GROSS,
    MOST,
    TELLING,
    WORST,
)
from ppmcal.calibration.interpretation.misread import Misread, Misreading
from ppmcal.calibration.interpretation.mistakes import Mistake
from ppmcal.calibration.interpretation.obvious_mistakes import (
    negative_struts,
    other_zeros,
    refuse_wrong_units,
    with_positive_struts,
)
from ppmcal.calibration.interpretation.score import (
    Look,
    Score,
    end_parts,
    medians,
    right_parts,
    rms,
    score,
    tolerances_away,
)
from ppmcal.calibration.interpretation.wrong_rows import wrong_parts, wrong_rows
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.model.parameters import NO_TOLERANCE
from ppmcal.units import Units
from ppmcal.wording.progress import stage

log = logging.getLogger(__package__)

MEND = ("Check the order and signs of the q columns, their units, and how the rotation is written "
        "(rotation vector rx, ry, rz; quaternion x, y, z, w; from platform to base). If the "
        "machine really is that far from its nominal geometry, give larger tolerances")


@dataclass(frozen=True)
class Misfit:
    """How far measurements are from a machine, half of the rows being farther.

    Attributes:
        score: of the nominal machine, all files together, without a fit.
        before, after: times the noise, without and with a short fit; nan where none was needed.
        lost: rows without a pose, of ``rows``; gross: part of them that are gross errors.
        readings: how the files are to be read instead, where that explains everything.
    """

    score: Score
    before: float = np.nan
    after: float = np.nan
    lost: int = 0
    rows: int = 0
    readings: tuple[Misreading, ...] = ()
    gross: float = 0.0

    @property
    def times(self) -> float:
        """Times what noise and tolerances explain, nominal machine, best registration."""
        return self.score.nominal

    @property
    def doubted(self) -> bool:
        """Whether so much is wrong that a fit of all rows may go astray."""
        return self.times > LANDS or self.gross > MANY_GROSS

    @property
    def misread(self) -> bool:
        """Whether neither tolerances nor another geometry explain the measurements."""
        return bool(self.readings) or self.after > max(WORST**0.5, HARDLY_LESS * self.before)

    def sentence(self, units: Units) -> str:
        """Return what was seen, in file units."""
        parts = [f"{value / units.factor(quantity):.3g} {units.name(quantity)}"
                 for value, quantity in zip(self.score.miss, ("length", "angle"), strict=True)
                 if np.isfinite(value)]
        lost = f"; {self.lost} of {self.rows} rows have no pose at all" if self.lost else ""
        return ("the measurements do not fit this machine: registered as well as can be, half of "
                f"the rows miss by more than {' and '.join(parts)}, {self.times:.3g} times what "
                f"tolerances and noise explain{lost}; other dimensions of the machine still leave "
                f"{self.after:.3g} times the noise")


def misfit(problem: Problem) -> Misfit:
    """Return how far measurements are from a machine, and how they may have been meant.

    Args:
        problem: machine and data; where there are many rows, some of them are looked at.

    Raises:
        BadInput: as :meth:`ppmcal.calibration.fit.Problem.start`.
    """
    mechanism = problem.mechanism
    signs = [negative_struts(d, mechanism) for d in problem.datasets]
    if not any(signs):
        return _misfit(problem)
    turned = replace(problem, given=None, datasets=tuple(
        with_positive_struts(d, mechanism) for d in problem.datasets))
    found = _misfit(turned)
    other = {m.source: m for m in found.readings}
    readings = []
    for data, sign in zip(turned.datasets, signs, strict=True):
        one = other.get(data.source, Misreading(data.source, (), dict(data.read)))
        if sign or one.mistakes:
            readings.append(replace(one, mistakes=(*sign, *one.mistakes)))
    return replace(found, readings=tuple(readings))


def _misfit(problem: Problem) -> Misfit:
    """Return what :func:`misfit` does, of joints whose signs are right."""
    try:
        look = Look.at(problem)
    except BadInput:
        found = tuple(m for m in _misreadings(problem) if m.noise_after <= TELLING)
        found = found or _other_zeros(problem)
        if not found:
            raise
        return Misfit(Score(), readings=found)
    lost, rows = look.lost
    gross = sum(int(g.sum()) for g in beyond(look.explained, look.posed)) / max(rows, 1)
    out = Misfit(Score(look.nominal, medians(look.problem, look.state)), lost=lost, rows=rows,
                 gross=gross)
    if out.times <= LANDS and lost <= MOST * rows:
        return out
    # a way that explains everything needs no fit of what is read wrongly, which is slow
    found = _misreadings(problem)
    if found:
        return replace(out, readings=found)
    before, after = (distances(look.problem, state).times(look.posed)
                     for state in (look.state, look.fitted()))
    found = _other_zeros(problem) if after > TELLING else ()
    if not found and any(True for _ in right_parts(problem)):
        return out
    return replace(out, before=before, after=after, readings=found)


def _misreadings(problem: Problem) -> tuple[Misreading, ...]:
    found = (find_misreading(problem, i) for i in range(len(problem.datasets)))
    return tuple(m for m in found if m is not None)


def _other_zeros(problem: Problem) -> tuple[Misreading, ...]:
    return tuple(m for d in problem.datasets for m in other_zeros(d, problem.mechanism))


@stage("trying other readings")
def refuse_misread(problem: Problem) -> Misfit:
    """Refuse measurements that are not of this machine as the files are read.

    Raises:
        Misread: neither tolerances nor another geometry explain them; it says how they are to be
            read, where that is found.
    """
    found = misfit(problem)
    log.info("other readings of the files: %s", f"{len(found.readings)} found" if found.readings
             else "none needed" if not found.misread else "none found")
    _refuse(found.readings, problem)
    if found.misread:
        raise Misread(found.sentence(problem.mechanism.units),
                      ", ".join(d.source for d in problem.datasets), MEND)
    return found


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
    if refuse_misread(problem).doubted:
        _refuse(wrong_parts(problem), problem)


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
    for *_, alone in end_parts(problem):
        part = score(alone, np.inf)
        if part.noise <= TELLING and part.geometry <= ALLOWED:
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
    as_read = score(problem, np.inf)
    if as_read.noise <= TELLING and as_read.geometry <= FAR:
        return ()
    try:
        fit = identify(problem)
        refuse_after_fit(fit)
        refuse_other_machine(fit)
    except Misread as error:
        return error.found
    except PpmcalError:
        pass    # a fit that cannot be had tells nothing of the file
    return ()
