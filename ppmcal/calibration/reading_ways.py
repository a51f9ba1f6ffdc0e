"""Ways in which files may have been meant, each of them a problem of its own to be weighed.

Readings that come near the nominal machine; shifts of the rows, which on a dense path hardly show
there; after a fit also those that lower what its columns cannot explain; a registration that the
sidecar gives; and a diameter for a radius in the machine's file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.gross_rows import toleranced
from ppmcal.calibration.least_squares import column_scale
from ppmcal.calibration.mistakes import Mistake, mistakes
from ppmcal.calibration.observation import SCALARS, coordinates
from ppmcal.calibration.problem import Problem, State
from ppmcal.calibration.reading_candidates import (
    position_readings,
    rotation_readings,
    whole_pose_readings,
)
from ppmcal.calibration.reading_evidence import SMALLEST, Way, evidence
from ppmcal.calibration.reading_search import SHIFTS, search_readings
from ppmcal.calibration.readings import FileReading, JointReading
from ppmcal.linalg import Array, Bools, range_basis, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.scaled_points import other_radii

TRIED, SCREENED = 12, 4
"""Readings that are weighed: the nearest to the nominal machine, and the best by a fit."""
ROWS = 120
"""Rows by which a fit tells which readings lower what it cannot explain."""
RANK = 1e-9
HELD = 0.5
"""Parts as which it counts that the machine is off where its file holds it to be right."""
REGISTERED = {"frame": ("frame", "the measuring frame is not where the sidecar has it"),
              "target": ("target", "the measured point is not where the sidecar has it"),
              "target_rotation": ("target-rotation", "the measured body is turned otherwise than "
                                  "the sidecar says")}
"""What a sidecar may give and be wrong about: kind of mistake and text, by its key."""


def of_registration(way: Way) -> bool:
    """Whether only what a sidecar says of a registration is otherwise."""
    kinds = {kind for kind, _ in REGISTERED.values()}
    return bool(way.mistakes) and all(m.kind in kinds for m in way.mistakes)


def may_be_misread(data: Dataset) -> bool:
    """Whether a data set has columns that may be read otherwise."""
    return data.kind not in SCALARS and data.commanded is None


def ways(problem: Problem, index: int, fit: Fit | None = None, hidden: bool = True) -> list[Way]:
    """Return the ways in which one data set may have been meant.

    Args:
        problem: machine and data.
        index: of the data set.
        fit: of the files as they were read, where there is one.
        hidden: what is wrong may be within the tolerances, as a row's shift on a dense path is.
    """
    data, mechanism = problem.datasets[index], problem.mechanism
    problem = replace(problem, given=None, earlier=None)
    plain = JointReading.plain(len(mechanism.actuators))
    near = [s for s in search_readings(mechanism, data) if s.reading.parts]
    near.sort(key=lambda s: evidence(max(s.score, SMALLEST), s.reading.parts), reverse=True)
    readings = [s.reading for s in near[:TRIED]]
    if hidden:
        readings += [FileReading(plain, shift=s) for s in SHIFTS]
    if fit is not None:
        readings += _screened(fit, index)
    return [*_read_as(problem, index, [*dict.fromkeys(readings)]),
            *_registrations(problem, index), *_machines(problem)]


def _read_as(problem: Problem, index: int, readings: Sequence[FileReading]) -> Iterator[Way]:
    """Yield a problem with one data set read in other ways, and with all that are written alike.

    Who has mistaken the columns of one file has mistaken those of the next day.
    """
    data, mechanism = problem.datasets[index], problem.mechanism
    only = [i == index for i in range(len(problem.datasets))]
    alike = [(d.kind, d.convention, d.units) == (data.kind, data.convention, data.units)
             for d in problem.datasets]
    columns = coordinates(data, mechanism.motion)
    for reading in readings:
        what, volume = mistakes(reading, mechanism, data), reading.volume(data, columns)
        for those in (only,) if alike == only else (only, alike):
            yield Way(replace(problem, datasets=tuple(
                reading.of(d, mechanism) if mine else d for d, mine in zip(
                    problem.datasets, those, strict=True))), what, reading, reading.parts, volume)


def _registrations(problem: Problem, index: int) -> Iterator[Way]:
    """Yield the problem with what a sidecar gives of one data set's registration open instead.

    Beside it, what is no mistake of the sidecar: the machine off where its file holds it.
    """
    data, motion = problem.datasets[index], problem.mechanism.motion
    given = [key for key in REGISTERED if not getattr(data, key).fitted]
    if motion == "translational":
        given = [key for key in given if key == "frame"]    # the platform never turns
    if data.kind != "pose":
        given = [key for key in given if key != "target_rotation"]
    held = toleranced(problem, fixed=True)
    if given and held.free != toleranced(problem).free:
        yield Way(held, parts=HELD)
    some = [(key,) for key in given]
    for keys in [*some, tuple(given)] if len(given) > 1 else some:
        other = replace(data, **{key: replace(getattr(data, key), fitted=True) for key in keys})
        opened = replace(problem, pivots=None, datasets=tuple(
            other if i == index else d for i, d in enumerate(problem.datasets)))
        what = tuple(Mistake(kind, (), text) for kind, text in (REGISTERED[k] for k in keys))
        yield Way(opened, what, parts=len(keys),
                  freedoms=len(opened.columns) - len(problem.columns))


def _machines(problem: Problem) -> Iterator[Way]:
    """Yield machines whose file gives a diameter for a radius, or the reverse."""
    for machine, ends, words in other_radii(problem.mechanism):
        text = f"{problem.mechanism.source}: {words.format(reason='the measurements say')}"
        what = (Mistake("radius", tuple(f"{e}.point" for e in ends), text),)
        yield Way(replace(problem, mechanism=machine, free=machine.free), what, parts=1.0)


def _screened(fit: Fit, index: int) -> list[FileReading]:
    """Return the readings that lower what a fit cannot explain, best first.

    Each other reading of the measured columns changes the residuals by a known amount; what of
    them the fit's own columns cannot explain falls to the noise for the right one.
    """
    data, mechanism = fit.problem.datasets[index], fit.problem.mechanism
    edge = max(abs(s) for s in SHIFTS)
    usable = fit.keep[index].copy()
    usable[:edge] = usable[len(usable) - edge:] = False
    keep = subsample([usable], ROWS)[0]
    if keep.sum() < edge:
        return []
    alone = replace(fit.problem, datasets=(data.alone(),), given=(fit.problem.environments[index],),
                    pivots=(fit.problem.opens[index].about,), earlier=None)
    state = State(fit.state.g, (fit.state.registrations[index],), (fit.state.poses[index],))
    basis, now = _basis(alone, state, keep)
    start = _unexplained(basis, now)
    found = []
    for reading in _single_changes(mechanism, data):
        other = _residual(alone, state, keep, reading)
        if other is not None and other.shape == now.shape:
            score = _unexplained(basis, other)
            if score < start:
                found.append((score, reading))
    return [r for _, r in sorted(found, key=lambda f: (round(f[0], 2), f[1].parts))[:SCREENED]]


def _single_changes(mechanism: Mechanism, data: Dataset) -> Iterator[FileReading]:
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
