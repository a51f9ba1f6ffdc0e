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

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.gross_rows import beyond, explained_distances, toleranced
from ppmcal.calibration.misread import Misread
from ppmcal.calibration.mistakes import NOISE, Misreading
from ppmcal.calibration.negative_struts import negative_struts, with_positive_struts
from ppmcal.calibration.outliers import distances
from ppmcal.calibration.plain_mistakes import other_zeros
from ppmcal.calibration.problem import Problem
from ppmcal.calibration.reading_evidence import (
    FAR_FROM_NOISE,
    LOST,
    AtNominal,
    Left,
    after_short_fit,
    best_way,
    few_rows,
    leaves,
    medians,
    misreading,
    of_noise,
)
from ppmcal.calibration.reading_ways import may_be_misread, of_registration, ways
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.linalg import Ints, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.units import Units
from ppmcal.wording.progress import stage

log = logging.getLogger(__package__)

MANY_GROSS = 0.2
"""If more than this part are, they may be read wrongly, and no others."""
DOUBTED = 5.0
"""Half of the rows are so many times beyond what noise and tolerances explain: try a fit."""
HARDLY_LESS = 0.05
"""A fit that explains nothing is on its way if it leaves less than this part of what it began
with."""
TELLING = 2.0
"""A fit that leaves more than this times the noise is worth a look at other readings."""
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
        BadInput: as :meth:`ppmcal.calibration.problem.Problem.start`.
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
    few = few_rows(toleranced(problem))
    try:
        state = few.start()
    except BadInput:
        found = _sure(_misreadings(problem, Left(np.inf))) or _other_zeros(problem)
        if not found:
            raise
        return Misfit(np.inf, np.nan, np.nan, np.nan, np.nan, 0, 0, found)
    keep = [finite_rows(p) for p in state.poses]
    rows, lost = sum(k.size for k in keep), sum(int((~k).sum()) for k in keep)
    explained = explained_distances(few, state)
    times = explained.times(keep)
    gross = sum(int(g.sum()) for g in beyond(explained, keep)) / max(rows, 1)
    nominal = medians(few, state)
    before = after = float("nan")
    found = ()
    if times > DOUBTED or lost > LOST * rows:
        # a reading that explains everything needs no fit of what is read wrongly, which is slow
        likely = _misreadings(problem, Left(times, nominal))
        found = _sure(likely)
        if not found:
            before = distances(few, state).times(keep)
            after = distances(few, after_short_fit(few, state, keep)).times(keep)
            found = _other_zeros(problem) if after > TELLING else ()
            if not found and any(True for _ in right_parts(problem)):
                before = after = float("nan")
            elif not found and after > max(FAR_FROM_NOISE, HARDLY_LESS * before):
                # what no geometry explains and a reading does, but for an effect of some size
                found = tuple(m for m in likely if m.noise_after <= FAR_FROM_NOISE)
    return Misfit(times, *nominal, before, after, lost, rows, found, gross)


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


def refuse_small_misreading(fit: Fit) -> None:
    """Refuse measurements that a fit does not explain, and another reading of the file does.

    A mistake that tolerances could explain, such as Euler angles of small turns, passes
    :func:`refuse_misread` and shows in what the fit leaves. A registration that is not quite as the
    sidecar says is no reason to refuse: :mod:`registration_freedoms` tells it.

    Raises:
        Misread: with how the file is to be read.
    """
    if distances(fit.problem, fit.state).times(fit.keep) <= TELLING:
        return
    problem = replace(fit.problem, given=None, earlier=None)
    try:
        as_read = leaves(problem)
    except PpmcalError:
        return
    found = []
    for i, data in enumerate(problem.datasets):
        if may_be_misread(data):
            best = best_way(ways(problem, i, fit), as_read.score, as_read.times)
            if best is not None and not of_registration(best[0]):
                found.append(misreading(best[0], problem, i, as_read.fitted, best[1].fitted,
                                        best[1]))
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
        few = few_rows(toleranced(alone))
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


def _misreadings(problem: Problem, whole: Left) -> tuple[Misreading, ...]:
    """Return how the data sets that do not fit the machine are to be read.

    ``whole``: what they leave together, nominal machine.
    """
    out = []
    for i, data in enumerate(problem.datasets):
        as_read, alone = whole, problem.alone(data)
        if len(problem.datasets) > 1:
            try:
                at = AtNominal.of(alone)
                as_read = Left(at.times, at.misses)
            except PpmcalError:
                as_read = Left(np.inf)
        if as_read.times > DOUBTED and may_be_misread(data):
            # without a fit: of no machine within its tolerances a file leaves much less
            best = best_way(ways(alone, 0, hidden=False), of_noise(as_read.times),
                            as_read.times)
            if best is not None:
                out.append(misreading(best[0], problem, i, as_read.nominal, best[1].nominal,
                                      best[1]))
    return tuple(out)
