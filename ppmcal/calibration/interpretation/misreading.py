"""Do measurements and machine belong together at all? Asked before anything is fitted.

Every row is compared with the nominal machine through the best registration, against what
the stated noise *and* the tolerances explain: V = I + J T^2 J^T in units of the noise, T the
tolerances of the free geometry. A single row far beyond that is a gross error (a value typed
wrong) and must not lead the fit. If half of the rows are, the file is read wrongly, or the
mechanism file is of another machine: then a short fit of few rows decides, and where that
does not come near the noise either, a calibration would only bend the geometry.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    Problem,
    State,
    beyond,
    coordinates,
    distances,
    explained_distances,
    gross_errors,
    huber_weights,
    least_squares,
    prior_weights,
    toleranced,
)
from ppmcal.calibration.interpretation.misread import Misread
from ppmcal.calibration.interpretation.negative_struts import negative_struts, with_positive_struts
from ppmcal.calibration.interpretation.obvious_mistakes import other_zeros
from ppmcal.calibration.interpretation.reading_trial import (
    NOISE,
    Misreading,
    Trial,
    find_misreading,
)
from ppmcal.calibration.interpretation.small_misreading import find_small_misreading
from ppmcal.errors import BadInput, NoResult, PpmcalError
from ppmcal.linalg import Array, Bools, Ints, finite_rows, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.units import Units
from ppmcal.wording.progress import stage

log = logging.getLogger(__package__)

MANY_GROSS = 0.2
"""If more than this part are, they may be read wrongly, and no others."""
DOUBTED = 5.0
"""Half of the rows are so many times beyond what noise and tolerances explain: try a fit."""
FAR_FROM_NOISE = 10.0
"""A short fit that leaves half of the rows so many times beyond the noise explains nothing,"""
HARDLY_LESS = 0.05
"""and is not on its way either if that is more than this part of what it began with."""
TRIAL_ROWS, TRIAL_ITERATIONS = 48, 10
TELLING = 2.0
"""A fit that leaves more than this times the noise is worth a look at other readings."""
LOST = 0.5
"""More rows than this part without a pose are doubted too."""
PARTS = 3
"""A third of the rows, the first or the last, is looked at alone where nothing explains all."""
MEND = ("Check the order and signs of the q columns, their units, and how the rotation is written "
        "(rotation vector rx, ry, rz; quaternion x, y, z, w; from platform to base). If the "
        "machine really is that far from its nominal geometry, give larger tolerances")


@dataclass(frozen=True)
class Misfit:
    """How far measurements are from a machine, half of the rows being farther.

    Attributes:
        times: of what noise and tolerances explain, nominal machine, best registration.
        position, rotation: of the measured point, m, and of the body, rad; nan where not
            measured. A height or a distance counts as a position.
        before, after: times the noise, without and with a short fit; nan where none was needed.
        lost: rows without a pose, of ``rows``; gross: part of them that are gross errors.
        readings: how the files are to be read instead, where that explains everything.
    """

    times: float
    position: float
    rotation: float
    before: float
    after: float
    lost: int
    rows: int
    readings: tuple[Misreading, ...] = ()
    gross: float = 0.0

    @property
    def doubted(self) -> bool:
        """Whether so much is wrong that a fit of all rows may go astray."""
        return self.times > DOUBTED or self.gross > MANY_GROSS

    @property
    def misread(self) -> bool:
        """Whether neither tolerances nor another geometry explain the measurements."""
        return bool(self.readings) or self.after > max(FAR_FROM_NOISE, HARDLY_LESS * self.before)

    def sentence(self, units: Units) -> str:
        """Return what was seen, in file units."""
        parts = [f"{value / units.factor(quantity):.3g} {units.name(quantity)}"
                 for value, quantity in ((self.position, "length"), (self.rotation, "angle"))
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
    found = _misfit(replace(problem, given=None, datasets=tuple(
        with_positive_struts(d, mechanism) for d in problem.datasets)))
    other = {m.source: m for m in found.readings}
    readings = []
    for data, sign in zip(problem.datasets, signs, strict=True):
        one = other.get(data.source)
        if one is not None:
            readings.append(replace(one, mistakes=(*sign, *one.mistakes)))
        elif sign:
            readings.append(Misreading(data.source, sign, dict(with_positive_struts(
                data, mechanism).read), NOISE, np.nan, np.nan, np.nan))
    return replace(found, readings=tuple(readings))


def _misfit(problem: Problem) -> Misfit:
    """Return what :func:`misfit` does, of joints whose signs are right."""
    few = _few(toleranced(problem))
    try:
        state = few.start()
    except BadInput:
        nothing = Trial(np.inf, np.nan, np.nan, np.inf)
        found = _sure(_misreadings(problem, nothing)) or _other_zeros(problem)
        if not found:
            raise
        return Misfit(np.inf, np.nan, np.nan, np.nan, np.nan, 0, 0, found)
    keep = [finite_rows(p) for p in state.poses]
    rows, lost = sum(k.size for k in keep), sum(int((~k).sum()) for k in keep)
    explained = explained_distances(few, state)
    times = explained.times(keep)
    gross = sum(int(g.sum()) for g in beyond(explained, keep)) / max(rows, 1)
    position, rotation = _medians(few, state)
    before = after = float("nan")
    found = ()
    if times > DOUBTED or lost > LOST * rows:
        # a reading that explains everything needs no fit of what is read wrongly, which is slow
        likely = _misreadings(problem, Trial(times, position, rotation, np.inf))
        found = _sure(likely)
        if not found:
            before = distances(few, state).times(keep)
            after = distances(few, _after_trial(few, state, keep)).times(keep)
            found = _other_zeros(problem) if after > TELLING else ()
            if not found and any(True for _ in right_parts(problem)):
                before = after = float("nan")
            elif not found and after > max(FAR_FROM_NOISE, HARDLY_LESS * before):
                # what no geometry explains and a reading does, but for an effect of some size
                found = tuple(m for m in likely if m.noise_after <= FAR_FROM_NOISE)
    return Misfit(times, position, rotation, before, after, lost, rows, found, gross)


@stage("trying other readings")
def refuse_misread(problem: Problem) -> Misfit:
    """Refuse measurements that are not of this machine as the files are read.

    Args:
        problem: machine and data.

    Raises:
        Misread: neither tolerances nor another geometry explain them; it says how they are to be
            read, where that is found.
    """
    found = misfit(problem)
    log.info("other readings of the files: %s", f"{len(found.readings)} found" if found.readings
             else "none needed" if not found.misread else "none found")
    if found.readings:
        raise Misread.of(found.readings, problem.mechanism.units)
    if found.misread:
        raise Misread(found.sentence(problem.mechanism.units),
                      ", ".join(d.source for d in problem.datasets), MEND)
    return found


def explained_times(problem: Problem) -> float:
    """Return how far the nominal machine is from few rows, times what tolerances and noise explain.

    Raises:
        BadInput: as :meth:`ppmcal.calibration.fit.Problem.start`.
    """
    few = _few(toleranced(problem))
    state = few.start()
    return explained_distances(few, state).times([finite_rows(p) for p in state.poses])


def short_fit(problem: Problem, lands: float = np.inf) -> tuple[Problem, State, float]:
    """Return few rows of a problem, where a short robust fit ends, and the noise it leaves, times.

    Args:
        problem: machine and data.
        lands: the fit is not made of a nominal machine farther off than this, see
            :func:`explained_times`.

    Raises:
        BadInput: as :meth:`ppmcal.calibration.fit.Problem.start`. NoResult: it is farther off.
    """
    few = _few(toleranced(problem))
    state = few.start()
    keep = [finite_rows(p) for p in state.poses]
    if np.isfinite(lands) and not explained_distances(few, state).times(keep) <= lands:
        raise NoResult("the nominal machine is too far off for a fit",
                       ", ".join(d.source for d in problem.datasets))
    keep = [k & ~g for k, g in zip(keep, gross_errors(few, state, keep), strict=True)]
    end = _after_trial(few, state, keep)
    return few, end, distances(few, end).times(keep)


def refuse_small_misreading(fit: Fit) -> None:
    """Refuse measurements that a fit does not explain, and another reading of the file does.

    A mistake that tolerances could explain, such as Euler angles of small turns, passes
    :func:`refuse_misread` and shows in what the fit leaves.

    Raises:
        Misread: with how the file is to be read.
    """
    if distances(fit.problem, fit.state).times(fit.keep) <= TELLING:
        return
    found = tuple(m for i in range(len(fit.problem.datasets))
                  if (m := find_small_misreading(fit, i, trial)) is not None)
    if found:
        raise Misread.of(found, fit.problem.mechanism.units)


def _sure(readings: Sequence[Misreading]) -> tuple[Misreading, ...]:
    """Return the readings with which the data sets come to the noise."""
    return tuple(m for m in readings if m.noise_after <= TELLING)


def right_parts(problem: Problem) -> Iterator[tuple[Dataset, Ints]]:
    """Yield data sets and their first or last rows that fit alone: something happened in between.

    What is read wrongly is wrong from the first row to the last.
    """
    for data, part, alone in end_parts(problem):
        few = _few(toleranced(alone))
        try:
            state = few.start()
        except PpmcalError:
            continue
        keep = [finite_rows(p) for p in state.poses]
        if keep[0].mean() > LOST and explained_distances(few, state).times(keep) <= DOUBTED:
            yield data, part


def end_parts(problem: Problem) -> Iterator[tuple[Dataset, Ints, Problem]]:
    """Yield each data set with its first and its last rows, and the problem of these alone."""
    for data in problem.datasets:
        for part in np.array_split(np.arange(len(data)), PARTS)[::PARTS - 1]:
            yield data, part, problem.alone(data.take(part))


def _other_zeros(problem: Problem) -> tuple[Misreading, ...]:
    return tuple(m for d in problem.datasets for m in other_zeros(d, problem.mechanism))


def _misreadings(problem: Problem, whole: Trial) -> tuple[Misreading, ...]:
    """Return how the data sets that do not fit the machine are to be read.

    ``whole``: what they leave together.
    """
    out = []
    for i, data in enumerate(problem.datasets):
        as_read = whole
        if len(problem.datasets) > 1:
            try:
                as_read = trial(problem.alone(data), 0.0)
            except PpmcalError:
                as_read = Trial(np.inf, np.nan, np.nan, np.inf)
        if as_read.times > DOUBTED:
            found = find_misreading(problem, i, as_read, trial)
            out += [found] if found else []
    return tuple(out)


def trial(problem: Problem, lands: float = np.inf) -> Trial:
    """Return what the measurements leave, nominal machine and after a short fit of few rows.

    ``lands``: the fit is not made where more than so many times what tolerances and noise explain
    is left without it.
    """
    few = _few(toleranced(problem))
    state = few.start()
    keep = [finite_rows(p) for p in state.poses]
    if sum(int((~k).sum()) for k in keep) > LOST * sum(k.size for k in keep):
        raise NoResult("most rows have no pose", ", ".join(d.source for d in problem.datasets))
    times = explained_distances(few, state).times(keep)
    if times > lands:
        return Trial(times, *_medians(few, state), np.inf)
    # values typed wrong are no sign of how a file is to be read
    keep = [k & ~g for k, g in zip(keep, gross_errors(few, state, keep), strict=True)]
    end = _after_trial(few, state, keep)
    return Trial(times, *_medians(few, state), distances(few, end).times(keep),
                 _medians(few, end))


def _few(problem: Problem) -> Problem:
    keep = subsample([np.ones(len(d), dtype=bool) for d in problem.datasets], TRIAL_ROWS)
    datasets = tuple(d.take(np.flatnonzero(k)) if k.any() else d
                     for d, k in zip(problem.datasets, keep, strict=True))
    return replace(problem, datasets=datasets, earlier=None)


def _medians(problem: Problem, state: State) -> tuple[float, float]:
    """Return the median miss of positions, m, and rotations, rad."""
    out: dict[bool, list[float]] = {False: [], True: []}
    for rows in problem.rows(state, False):
        places = np.array(coordinates(problem.datasets[rows.dataset], problem.mechanism.motion))
        for turn in out:
            raw = np.where(rows.observed, rows.raw, 0.0)[:, (places >= 3) == turn]
            if raw.shape[1]:
                out[turn] += np.linalg.norm(raw, axis=1).tolist()
    position, rotation = (float(np.median(v)) if v else float("nan") for v in out.values())
    return position, rotation


def _after_trial(problem: Problem, state: State, keep: Sequence[Bools]) -> State:
    """Return where a short robust fit ends."""
    prior = prior_weights(problem, "prior")

    def weigh(at: State) -> Sequence[Array]:
        return huber_weights(problem, at, keep)

    return least_squares(problem, state, keep, prior, TRIAL_ITERATIONS, weigh).state
