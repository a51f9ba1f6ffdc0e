"""Whether files were read as intended: one path for check, identify and diagnose.

Every candidate reading of a file is scored like the declared one; of equally good readings, the
one with the fewest changes was meant, provided it explains more of the error than it leaves. Before
the fit this is done for files that the tolerances do not explain, along with units of the
environment and parts of the rows that go astray; after it for files that leave more than noise or
bend the geometry, along with faults of some rows. What nothing explains is another machine's file.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, State, identify, shown
from ppmcal.calibration.interpretation.assembly import other_assembly
from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    InterpretationError,
)
from ppmcal.calibration.interpretation.joint_columns import fit_score, refuse_read_otherwise
from ppmcal.calibration.interpretation.joint_zeros import zeros_elsewhere
from ppmcal.calibration.interpretation.joints_alone import refuse_joints_alone
from ppmcal.calibration.interpretation.limits import (
    ALLOWED,
    AS_GOOD,
    FAR,
    FEWEST_PARAMETERS,
    LANDS,
    LITTLE,
    TELLING,
    WORST,
    explains,
)
from ppmcal.calibration.interpretation.mechanism_unit import other_unit
from ppmcal.calibration.interpretation.number_units import number_units
from ppmcal.calibration.interpretation.obvious_mistakes import (
    other_zeros,
    refuse_wrong_units,
    with_positive_struts,
)
from ppmcal.calibration.interpretation.readings import of_a_joint, readable
from ppmcal.calibration.interpretation.score import (
    Look,
    Score,
    end_parts,
    right_parts,
    rms,
    score,
    tolerances_away,
)
from ppmcal.calibration.interpretation.search import Way, ways
from ppmcal.calibration.interpretation.stated_places import stated_places
from ppmcal.calibration.interpretation.targets_read import left_out_whole, targets_read
from ppmcal.calibration.interpretation.wrong_rows import wrong_parts, wrong_rows
from ppmcal.calibration.knowledge import farthest
from ppmcal.calibration.validation import unused_sentences
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.model.parameters import NO_TOLERANCE
from ppmcal.notes import about
from ppmcal.wording.progress import stage

log = logging.getLogger(__package__)

LARGER = "If the machine really is that far from its nominal geometry, give larger tolerances"
HINT = ("Check the order and signs of the q columns, their units, and how the rotation is written "
        "(rotation vector rx, ry, rz; quaternion x, y, z, w; from platform to base). " + LARGER)
HINT_WITHOUT_ROTATION = ("Check the order and signs of the q columns, their units, and what the "
                         "sidecar states of the instrument: frame, point and target. " + LARGER)
HINT_AT_JOINT = ("Check the joint that the encoder is at (`instrument.at`), the unit and sign of "
                 "its column, and the q columns. " + LARGER)
HINT_ALONE = ("Check the order and signs of the q columns, their units and zeros, and the points "
              "in the mechanism file. " + LARGER)


def _hint(problem: Problem) -> str:
    """Return what to check if measurements are far from the machine under every reading."""
    if problem.blind:
        return HINT_ALONE
    if all(map(of_a_joint, problem.datasets)):
        return HINT_AT_JOINT
    return HINT if any(d.kind.sees_rotation for d in problem.datasets) else HINT_WITHOUT_ROTATION


def find_misreading(problem: Problem, index: int) -> Interpretation | None:
    """Return how to read one data set instead, None if it is right or nothing explains it."""
    data = problem.datasets[index]
    other = readable(data) or of_a_joint(data)
    return _read_otherwise(problem.alone(data)) if other else None


def _read_otherwise(alone: Problem, held: bool = False) -> Interpretation | None:
    """Return :func:`find_misreading` for the single data set of a problem.

    ``held``: its frame is not the sidecar's but that of other data.
    """
    data, as_read = alone.datasets[0], score(alone)
    # a misreading affects all rows, including those that have a pose
    if as_read.total <= TELLING or (np.isinf(as_read.total) and as_read.nominal <= LANDS):
        return None
    good = _better(alone, as_read, held)
    if not good:
        return None
    way, best, alternatives = _chosen(good)
    # the residuals may be due to a fault in some of the rows; and a fit may explain them as well
    if best.total > TELLING and any(True for _ in right_parts(alone)):
        return None
    # a reading has to be better than a fit of the file as it is read
    if np.isinf(as_read.noise) and not explains(score(alone, np.inf).total, best.total):
        return None
    block, sigma, headers, at = None, dict[str, float](), dict[str, str](), ""
    if way.reading is not None:
        block, sigma = way.reading.block(data), way.reading.sigma(data, best.left)
        headers, at = way.reading.headers(data), way.reading.at
    told = (as_read.miss, best.miss) if as_read.nominal > LANDS else (as_read.left, best.left)
    if np.isinf(as_read.total):
        told = (np.nan, np.nan), told[1]
    return Interpretation(data.source, way.what, block, *_telling(*told), best.noise, sigma,
                          alternatives, way.problem.datasets[0], headers, at)


def _better(alone: Problem, as_read: Score, held: bool) -> list[tuple[Way, Score]]:
    """Return readings that explain the error; the search ends at one with residuals like noise.

    Later ones would change more. ``held``: the frame cannot be wrong.
    """
    out: list[tuple[Way, Score]] = []
    enough = np.inf
    lands = min(LANDS, max(TELLING, as_read.nominal))
    for way in ways(alone, as_read):
        if way.parts > enough:
            break
        if held and any(m.kind == "frame" for m in way.what):
            continue
        found = score(way.problem, lands)
        fitted = np.isfinite(found.noise + found.total)
        if fitted and explains(as_read.total, found.total) and _tells(way.problem, found):
            out.append((way, found))
            if found.total <= AS_GOOD:
                enough = min(enough, way.parts)
    return out


def _chosen(good: Sequence[tuple[Way, Score]]
            ) -> tuple[Way, Score, tuple[tuple[FileFault, ...], ...]]:
    """Return the reading with the fewest changes among the best, its score, and alternatives.

    Alternatives are of another kind and change no more. Readings with the same residuals to
    round-off are the same file up to a rotation of its frame: the first stands for all.
    """
    least = min(s.total for _, s in good)
    near = [g for g in good if g[1].total <= AS_GOOD * least]
    distinct: list[tuple[Way, Score]] = []
    for way, found in near:
        if way.parts <= min(w.parts for w, _ in near) and not any(
                np.isclose(found.nominal, s.nominal, rtol=1e-6) for _, s in distinct):
            distinct.append((way, found))
    best = min(distinct, key=lambda g: g[1].total)
    kinds: dict[frozenset[str], tuple[FileFault, ...]] = {}
    for way, _ in (best, *distinct):
        kinds.setdefault(frozenset(m.kind for m in way.what), way.what)
    return *best, tuple(kinds.values())[1:]


def _tells(alone: Problem, found: Score) -> bool:
    """Whether the residuals are small relative to the range of the measurements."""
    data = alone.datasets[0]
    for values, left in zip(np.hsplit(shown(data), 2), found.left, strict=True):
        known = values[:, np.isfinite(values).any(axis=0)]
        if known.size and np.isfinite(left):
            away = np.linalg.norm(known - np.nanmedian(known, axis=0), axis=1)
            if left <= LITTLE * float(np.nanmedian(away)):
                return True
    return not np.isfinite(found.left).any()


def _telling(before: tuple[float, float], after: tuple[float, float]) -> tuple[str, float, float]:
    """Return the quantity whose error falls most, position or rotation, before and after."""
    falls = [b / max(a, 1e-300) for b, a in zip(before, after, strict=True)]
    turned = falls[1] > 2.0 * falls[0] or not np.isfinite(after[0])
    return "angle" if turned else "length", before[turned], after[turned]


# --- what is refused, before a fit and after it ---------------------------------------------------

def misfit(problem: Problem, part: bool = False) -> Score:
    """Return how far measurements are from a machine, and how they may have been meant.

    Args:
        problem: machine and data; with many rows only some of them are examined.
        part: whether other files beside them show how the machine is assembled.

    Raises:
        BadInput: see :meth:`ppmcal.calibration.fit.Problem.start`.
    """
    turned = [with_positive_struts(d, problem.mechanism) for d in problem.datasets]
    if not any(sign for _, sign in turned):
        return _misfit(problem, part)
    found = _misfit(replace(problem, given=None, datasets=tuple(d for d, _ in turned)), part)
    other = {m.source: m for m in found.readings}
    readings = ((sign, other.get(d.source, Interpretation(d.source, (), dict(d.read))))
                for d, sign in turned)
    return replace(found, readings=tuple(replace(m, mistakes=(*sign, *m.mistakes))
                                         for sign, m in readings if sign or m.mistakes))


def _misfit(problem: Problem, part: bool) -> Score:
    """Return :func:`misfit` for joints whose signs are right."""
    try:
        look = Look.at(problem)
    except BadInput:
        found = tuple(m for m in _misreadings(problem) if m.noise_after <= TELLING)
        found = found or other_unit(problem, np.inf) or _other_zeros(problem)
        if not found:
            raise
        return Score(readings=found)
    as_read = look.score(0.0)
    if as_read.total <= LANDS:
        # among more rows of other files those of one would count as single mistakes
        worst = max(map(look.times, range(len(problem.datasets))))
        found = () if worst <= LANDS else _single_numbers(problem, replace(as_read, nominal=worst))
        return replace(as_read, readings=found)
    # a reading that explains everything saves the fit of a misread file, which is slow
    found = _misreadings(problem)
    if not part and not any(m.noise_after <= TELLING for m in found):
        found = other_unit(problem, as_read.total) or found
    found = found or (() if part else other_assembly(problem) or _single_numbers(problem, as_read))
    if found:
        return replace(as_read, readings=found)
    fitted = look.score(np.inf)
    found = _other_zeros(problem) if fitted.noise > TELLING else ()
    if not found and any(True for _ in right_parts(problem)):
        return as_read
    return replace(fitted, readings=found)


def _single_numbers(problem: Problem, as_read: Score) -> tuple[Interpretation, ...]:
    """Return what is wrong with heights or distances: their unit, or a point that is stated."""
    return number_units(problem, as_read.total) or stated_places(problem, as_read)


def _misreadings(problem: Problem, astray: frozenset[int] = frozenset()
                 ) -> tuple[Interpretation, ...]:
    """Return how data sets should be read; ``astray``: those that do not fit beside others."""
    found = {i: m for i in range(len(problem.datasets))
             if (m := find_misreading(problem, i)) is not None}
    return targets_read(problem, found, astray, partial(_read_otherwise, held=True))


def _other_zeros(problem: Problem) -> tuple[Interpretation, ...]:
    return tuple(m for d in problem.datasets for m in other_zeros(d, problem.mechanism))


@stage("trying other readings")
def refuse_misread(problem: Problem) -> None:
    """Refuse measurements that, as the files are read, are not of this machine.

    Raises:
        InterpretationError: neither tolerances nor another geometry explain them, or they explain
            the first rows but not others; it says how they should be read, if that is found.
        BadInput: see :func:`refuse_joints_alone`.
    """
    refuse_joints_alone(problem)
    found = misfit(problem)
    log.info("other readings of the files: %s", f"{len(found.readings)} found" if found.readings
             else "none needed" if not found.misread else "none found")
    # among more rows of other files those of an encoder would count as single mistakes
    encoders = [problem.alone(d) for d in problem.datasets
                if of_a_joint(d) and len(problem.datasets) > 1]
    each = [(problem, found), *((alone, misfit(alone, part=True)) for alone in encoders)]
    sources = {m.source for m in found.readings}
    _refuse([*found.readings, *(m for _, one in each[1:] for m in one.readings
                                if m.source not in sources)], problem)
    for part, one in each:
        if one.misread:
            raise InterpretationError(one.sentence(problem.mechanism.units),
                                      ", ".join(d.source for d in part.datasets), _hint(part))
    if found.doubted:
        _refuse(wrong_parts(problem), problem)


def _refuse(found: Sequence[Interpretation], problem: Problem) -> None:
    if found:
        raise InterpretationError.of(found, problem.mechanism.units)


def refuse_before_fit(problem: Problem, every_column: bool = False) -> None:
    """Refuse measurements that are recognised as misread without a fit of all rows.

    Args:
        problem: machine and data.
        every_column: whether columns of the environment count even if no effect of the machine
            uses them.

    Raises:
        InterpretationError: with how they should be read, if that is found.
    """
    if every_column or problem.mechanism.effects:
        refuse_wrong_units(problem.mechanism, problem.datasets)
    refuse_misread(problem)


def refuse_after_fit(fit: Fit) -> None:
    """Refuse measurements that the fit shows to be misread, or some of their rows.

    Raises:
        InterpretationError: with how they should be read.
    """
    found = fit_score(fit)
    if found.noise > TELLING or left_out_whole(fit) or found.geometry > FAR:
        refuse_columns(fit)
    _refuse(wrong_rows(fit), fit.problem)


def refuse_columns(fit: Fit) -> None:
    """Refuse measurements that agree better with another reading of their columns.

    Raises:
        InterpretationError: with how they should be read.
    """
    # unmodelled effects contradict a machine as smoothly as a few constants, which absorb them
    beyond = fit_score(fit).total > WORST**0.5
    if beyond:
        _refuse(zeros_elsewhere(fit.problem), fit.problem)
    _refuse(_misreadings(replace(fit.problem, earlier=None), left_out_whole(fit)), fit.problem)
    _refuse(stated_places(fit.problem, fit_score(fit)), fit.problem)
    if beyond:
        _refuse(other_assembly(fit.problem), fit.problem)
    refuse_read_otherwise(fit)


def other_machine(problem: Problem, state: State) -> Interpretation | None:
    """Return that a geometry is not of this machine, None if the tolerances allow it.

    A fit with tolerances moves the geometry by about one of them, whatever else is wrong with the
    data; the file of a sister machine moves it by 5 to 60, and often comes down to the noise.
    Zeros of drives do not count, nor do tolerances that the file does not state. If the first
    or the last rows alone are of this machine, something happened in between, and bent it.

    Args:
        problem: machine and data, whose files no other reading explains.
        state: where a fit with the tolerances as prior ended.
    """
    mechanism = problem.mechanism
    if about(mechanism.findings, (NO_TOLERANCE,)):
        return None
    away = tolerances_away(problem, state)
    far = sorted((name for name, times in away.items() if times > FAR), key=lambda n: -away[n])
    if rms(away) <= FAR or len(far) < FEWEST_PARAMETERS:
        return None
    if any(part.noise <= TELLING and part.geometry <= ALLOWED
           for *_, part in end_parts(problem, np.inf)):
        return None
    words = ", ".join(f"{name} by {away[name]:.0f}" for name in far[:3])
    text = f"the geometry comes out {rms(away):.0f} tolerances from nominal (RMS; {words})"
    return Interpretation(mechanism.source, (FileFault("other-machine", tuple(far), text),))


@stage("is it this machine")
def refuse_other_machine(fit: Fit) -> None:
    """Refuse a fit, with tolerances as prior, whose geometry is not of this machine.

    Raises:
        InterpretationError: with how far it is from nominal, and where most.
    """
    found = other_machine(fit.problem, fit.state)
    _refuse([found] if found else [], fit.problem)


def refusal(problem: Problem) -> tuple[InterpretationError | None, Fit | None]:
    """Return the refusal of measurements, None if they are accepted, and their fit.

    A file of which a fit uses hardly any row is refused too, although it would give a result.
    All rows are fitted only if a short fit leaves more than noise, or goes far.
    """
    try:
        refuse_joints_alone(problem)
    except BadInput as error:
        return InterpretationError(error.what, error.where, error.hint), None
    except InterpretationError as error:
        return error, None
    try:
        refuse_misread(problem)
    except InterpretationError as error:
        return error, None
    short = score(problem, np.inf)
    if short.total > TELLING or short.farthest > farthest(1):
        # a fit that fails says nothing about the file
        with suppress(PpmcalError):
            try:
                fit = identify(problem)
                refuse_after_fit(fit)
                refuse_other_machine(fit)
            except InterpretationError as error:
                return error, None
            unused = unused_sentences(fit)
            return (InterpretationError(unused[0]) if unused else None), fit
    return None, None
