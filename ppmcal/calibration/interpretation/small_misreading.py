"""Mistakes in a file so small that tolerances hide them from a look at the nominal machine.

Euler angles of small turns, a row's shift on a dense path: a fit bends the geometry a little and
leaves more than noise. Each other reading of the measured columns changes the residuals by a known
amount; what of them the fit's own columns cannot explain falls to the noise for the right one.
Those readings, and the likeliest against the nominal machine, are then fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, State, column_scale
from ppmcal.calibration.interpretation.mistakes import mistakes, read_block
from ppmcal.calibration.interpretation.reading_candidates import (
    position_readings,
    rotation_readings,
    whole_pose_readings,
)
from ppmcal.calibration.interpretation.reading_search import SHIFTS, search_readings
from ppmcal.calibration.interpretation.reading_trial import (
    Judge,
    Misreading,
    Trial,
    Way,
    other_machines,
    telling,
)
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.pose_readings import FileReading, JointReading
from ppmcal.linalg import Array, Bools, range_basis, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import SCALARS
from ppmcal.model.mechanism import Mechanism

ROWS = 120
SCREENED = 0.5
"""A reading is fitted where it lowers what the fit cannot explain to this part,"""
FITTED = 4
"""the best so many of them."""
HALF, AT_NOISE = 0.5, 1.6
"""It is right where its fit leaves at most this part, and no more than this times the noise."""
NEAR = 2.0
"""A way that leaves more than so many times what noise and tolerances explain, and more than the
present one, is not worth a fit."""
RANK = 1e-9


def find_small_misreading(fit: Fit, index: int, judge: Judge) -> Misreading | None:
    """Return how one data set of a fit is to be read, None where it is read rightly.

    Args:
        fit: of the files as they were read; it leaves more than noise.
        index: of the data set.
        judge: gives what a problem leaves after a short fit, from few rows.
    """
    data, mechanism = fit.problem.datasets[index], fit.problem.mechanism
    if data.kind in SCALARS or data.commanded is not None:
        return None
    problem = replace(fit.problem, earlier=None)
    as_read = _judged(problem, judge)
    if as_read is None:
        return None
    found: list[tuple[Way, Trial]] = []
    # a registration that was kept closed is told beside the fit, which stands without it
    for way in (*_ways(fit, index), *other_machines(problem)):
        left = _judged(way[2], judge, max(NEAR, as_read.times))
        if left is not None and left.after <= min(AT_NOISE, HALF * as_read.after):
            found.append((way, left))
    if not found:
        return None
    (reading, what, _), left = min(
        found, key=lambda f: (round(f[1].after, 1), f[0][0].parts if f[0][0] else len(f[0][1])))
    block = None if reading is None else read_block(reading, mechanism, data)
    return Misreading(data.source, what, block, *telling(as_read.left, left.left), left.after)


def _ways(fit: Fit, index: int) -> Iterator[Way]:
    """Yield the readings of one data set that are worth a fit."""
    data, mechanism = fit.problem.datasets[index], fit.problem.mechanism
    best = dict.fromkeys([*(r for _, r in _screened(fit, index)), *_likely(mechanism, data)])
    yield from read_as(fit.problem, index, [*best])


def read_as(problem: Problem, index: int, readings: Sequence[FileReading]) -> Iterator[Way]:
    """Yield a problem with one data set read in other ways, and with all that are written alike.

    Who has mistaken the columns of one file has mistaken those of the next day.
    """
    data, mechanism = problem.datasets[index], problem.mechanism
    only = [i == index for i in range(len(problem.datasets))]
    alike = [(d.kind, d.convention, d.units) == (data.kind, data.convention, data.units)
             for d in problem.datasets]
    for reading in readings:
        what = mistakes(reading, mechanism, data)
        for those in (only,) if alike == only else (only, alike):
            yield reading, what, replace(problem, datasets=tuple(
                reading.of(d, mechanism) if mine else d for d, mine in zip(
                    problem.datasets, those, strict=True)), given=None, earlier=None)


def nearest_readings(mechanism: Mechanism, data: Dataset) -> list[FileReading]:
    """Return the readings nearest to the nominal machine, and all shifts of the rows.

    On a dense path a row more or less is hardly seen by the nominal machine.
    """
    plain = JointReading.plain(len(mechanism.actuators))
    near = [s.reading for s in search_readings(mechanism, data) if s.reading.parts][:FITTED]
    return [*dict.fromkeys([*near, *(FileReading(plain, shift=s) for s in SHIFTS)])]


def _likely(mechanism: Mechanism, data: Dataset) -> list[FileReading]:
    """Return the readings that come much nearer to the nominal machine than the present one."""
    found = search_readings(mechanism, data)
    now = min((s.score for s in found if not s.reading.parts), default=np.inf)
    return [s.reading for s in found if s.reading.parts and s.score < HALF * now][:FITTED]


def _judged(problem: Problem, judge: Judge, lands: float = np.inf) -> Trial | None:
    try:
        return judge(problem, lands)
    except PpmcalError:
        return None


def _screened(fit: Fit, index: int) -> list[tuple[float, FileReading]]:
    """Return the readings that lower what the fit cannot explain by far, best first."""
    data, mechanism = fit.problem.datasets[index], fit.problem.mechanism
    edge = max(abs(s) for s in SHIFTS)
    usable = fit.keep[index].copy()
    usable[:edge] = usable[len(usable) - edge:] = False
    keep = subsample([usable], ROWS)[0]
    if keep.sum() < 6:
        return []
    alone = replace(fit.problem, datasets=(data.alone(),), given=(fit.problem.environments[index],),
                    pivots=(fit.problem.opens[index].about,), earlier=None)
    state = State(fit.state.g, (fit.state.registrations[index],), (fit.state.poses[index],))
    basis, now = _basis(alone, state, keep)
    start = _unexplained(basis, now)
    found = []
    for reading in _readings(mechanism, data):
        other = _residual(alone, state, keep, reading)
        if other is not None and other.shape == now.shape:
            score = _unexplained(basis, other)
            if score < SCREENED * start:
                found.append((score, reading))
    return sorted(found, key=lambda f: (round(f[0], 2), f[1].parts))[:FITTED]


def _readings(mechanism: Mechanism, data: Dataset) -> Iterator[FileReading]:
    """Yield single changes of how the measured columns are read."""
    plain, planar = JointReading.plain(len(mechanism.actuators)), mechanism.motion == "planar"
    poses = [*position_readings(data, planar)[1:], *rotation_readings(data, planar)[1:],
             *whole_pose_readings(data, planar)]
    yield from (FileReading(plain, pose) for pose in poses)
    yield from (FileReading(plain, shift=s) for s in SHIFTS)


def _basis(problem: Problem, state: State, keep: Bools) -> tuple[Array, Array]:
    """Return an orthonormal basis of the fit's columns (n m, r) and its residuals (n, m)."""
    jacobian, residual = [], []
    for rows in problem.rows(state, True, [keep]):
        jacobian.append(rows.jacobian)
        residual.append(rows.residual)
    whole = np.concatenate(jacobian)
    flat = whole.reshape(-1, whole.shape[-1]) * column_scale(problem)
    return range_basis(flat, RANK), np.concatenate(residual)


def _residual(problem: Problem, state: State, keep: Bools, reading: FileReading) -> Array | None:
    """Return the white residuals (n, m) of the rows ``keep`` read in another way."""
    data = problem.datasets[0]
    if reading.shift:
        at = np.flatnonzero(keep)
        late = at + reading.shift
        other = replace(data.take(at), position=data.position[late], rotation=data.rotation[late])
        keep = np.ones(len(at), dtype=bool)
        problem = replace(problem, given=(problem.environments[0].take(at),))
        state = replace(state, poses=(state.poses[0][at],))
    else:
        other = reading.of(data, problem.mechanism)
    problem = replace(problem, datasets=(other,))
    parts = [rows.residual for rows in problem.rows(state, False, [keep])]
    return np.concatenate(parts) if parts else None


def _unexplained(basis: Array, residual: Array) -> float:
    """Return the median length of a row of what the columns cannot explain, (n, m) given."""
    flat = residual.reshape(-1)
    rest = (flat - basis @ (basis.T @ flat)).reshape(residual.shape)
    return float(np.median(np.linalg.norm(rest, axis=1)))
