"""Mistakes in some of the rows only: a misread stretch of rows, or rows exchanged.

A fit leaves such rows out, one by one. Together they show more: under another reading, or each
with the measurement of another one of them, they fit to within the noise, which nothing that
happens to a machine would make them do.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Problem,
    State,
    coordinates,
    distances,
    identify,
    prediction_covariance,
    shown,
)
from ppmcal.calibration.interpretation.candidates import joint_readings, pose_readings
from ppmcal.calibration.interpretation.exchanged_targets import (
    best_stretch,
    exchanged_in_part,
    exchanged_targets,
    within,
)
from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    lines_for,
)
from ppmcal.calibration.interpretation.limits import (
    AGAINST,
    FEWEST_ROWS,
    LANDS,
)
from ppmcal.calibration.interpretation.obvious_mistakes import rows_with_negative_struts
from ppmcal.calibration.interpretation.readings import ColumnInterpretation, readable
from ppmcal.calibration.interpretation.score import PARTS, read_in_ways, right_parts
from ppmcal.calibration.interpretation.targets_read import merged
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.registration import measured_pose
from ppmcal.linalg import Bools, Ints, finite_rows, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.wording import pluralize

SCREENED = 12
"""Number of rows by which readings are first compared; half of them have to fit."""


def wrong_rows(fit: Fit) -> tuple[Interpretation, ...]:
    """Return stretches of rows that are misread, or rows that are exchanged, by data set."""
    if any(k.any() for k in fit.outliers) and (told := exchanged_targets(fit)):
        return told
    return _with_lines(_wrong_rows(fit))


def _wrong_rows(fit: Fit) -> list[Interpretation]:
    apart = [_LeftOut(fit, i) for i, d in enumerate(fit.problem.datasets) if readable(d)]
    found = (_exchanged(a) or _stretch(a) for a in apart if len(a.rows) >= FEWEST_ROWS)
    return [m for m in found if m is not None]


def _with_lines(found: Sequence[Interpretation]) -> tuple[Interpretation, ...]:
    """Return stretches with the lines for a file of their own, once for targets of one file."""
    out: dict[object, list[Interpretation]] = {}
    for m in found:
        out.setdefault((m.source, m.mistakes), []).append(m)
    told = []
    for same in out.values():
        first = same[0]
        there = lines_for(merged(same), {h: new for m in same for h, new in m.headers.items()})
        last = first.mistakes[-1]
        last = replace(last, text=f"{last.text} ({there})" if there else last.text)
        told.append(replace(first, mistakes=(*first.mistakes[:-1], last), block=None, headers={}))
    return tuple(told)


def wrong_parts(problem: Problem) -> tuple[Interpretation, ...]:
    """Return which rows are wrong in measurements whose first or last third is right.

    For files in which so much is wrong that a fit of all rows goes astray: the rows that the third
    predicts are fitted, and the others are judged by this fit.

    Args:
        problem: machine and data; of several files each is examined alone.
    """
    if told := exchanged_in_part(problem):
        return told
    found: dict[str, Sequence[Interpretation]] = {}
    for data, part in right_parts(problem):
        if readable(data) and not found.get(data.name):
            with suppress(PpmcalError):
                fit = _fit_of_part(problem.alone(data), part)
                found[data.name] = _wrong_rows(fit) if fit else ()
    return _with_lines([m for own in found.values() for m in own])


def _fit_of_part(problem: Problem, part: Ints) -> Fit | None:
    """Return a fit of the rows that a part of them predicts, None if the part is not right."""
    keep = np.isin(np.arange(len(problem.datasets[0])), part)
    for _ in range(2):
        some = identify(replace(problem, datasets=(problem.datasets[0].take(keep),)),
                        FitOptions(iterations=12))
        if some.noise_factor[0] > LANDS:
            return None
        whole = replace(problem, pivots=(some.problem.opens[0].about,))
        state = whole.solve(State(some.state.g, some.state.registrations, whole.start().poses))
        found = distances(whole, state, prediction_covariance(some), [np.zeros_like(keep)])
        keep = within(found.square[0], found.size[0], float(some.noise_factor[0]))
    if keep.mean() < 1.0 / PARTS:
        return None
    return replace(some, problem=whole, state=state, keep=(keep,))


@dataclass(frozen=True, eq=False)
class _LeftOut:
    """One data set of a fit, and its complete rows that were left out."""

    fit: Fit
    index: int

    @property
    def data(self) -> Dataset:
        return self.fit.problem.datasets[self.index]

    @property
    def parts(self) -> list[int]:
        return list(coordinates(self.data, self.fit.problem.mechanism.motion))

    @cached_property
    def usable(self) -> Ints:
        """Complete rows."""
        data = self.data
        return np.flatnonzero(finite_rows(data.q) & finite_rows(shown(data)[:, self.parts])
                              & data.usable)

    @cached_property
    def rows(self) -> Ints:
        """Rows left out; those near the noise as they are need no other reading."""
        out = self.usable[~self.fit.keep[self.index][self.usable]]
        return out[~self.fits(self.data.take(out), out)] if len(out) else out

    def fits(self, data: Dataset, rows: Ints) -> Bools:
        """Return which rows fit to within the noise when replaced by ``data`` (n,)."""
        fit, i = self.fit, self.index
        alone = Problem(fit.problem.mechanism, (data,), fit.problem.free,
                        (fit.problem.opens[i].about,), (fit.problem.environments[i].take(rows),))
        registration = fit.state.registrations[i]
        pose = alone.reached(0, Model(fit.problem.mechanism, fit.state.g), registration.homing)
        found = distances(alone, State(fit.state.g, (registration,), (pose,)))
        return within(found.square[0], found.size[0], float(fit.noise_factor[i]))

    def read(self, readings: Sequence[ColumnInterpretation], rows: Ints) -> Bools:
        """Return which rows fit under which readings (R, n), all at once."""
        return self.fits(read_in_ways(self.data, rows, readings), np.tile(rows, len(readings))
                         ).reshape(len(readings), len(rows))


def _stretch(apart: _LeftOut) -> Interpretation | None:
    """Return a stretch of rows that another reading brings down to the noise, or None."""
    mechanism, data, rows = apart.fit.problem.mechanism, apart.data, apart.rows
    own, plain = data.take(rows), ColumnInterpretation.as_declared(mechanism, data)
    readings = [*(replace(plain, joints=j) for j in joint_readings(mechanism, own)[1:]),
                *pose_readings(plain, own)[1:]]
    few = rows[subsample([np.ones(len(rows), bool)], SCREENED)[0]]
    # a strut's length enters squared only: with the other sign it has another zero, not a mistake
    turned = rows_with_negative_struts(read_in_ways(data, few, readings), mechanism)
    readings = [r for r, t in zip(readings, turned.reshape(len(readings), -1), strict=True)
                if not t.any()]
    if not readings:
        return None
    share = apart.read(readings, few).mean(axis=1)
    best = max(range(len(share)), key=lambda i: (share[i], -readings[i].parts))
    if share[best] <= 0.5:
        return None
    right = apart.read([readings[best]], apart.usable)[0]
    gain = np.zeros(len(data))
    gain[apart.usable] = np.where(right, np.isin(apart.usable, rows), -AGAINST)
    begin, end, sure = best_stretch(gain)
    if sure < FEWEST_ROWS:
        return None
    numbers = tuple(data.rows[begin:end].tolist())
    told = [replace(m, rows=numbers) for m in readings[best].mistakes(data)]
    told[0] = replace(told[0], text=f"rows {numbers[0]} to {numbers[-1]}: {told[0].text}")
    return Interpretation(data.source, tuple(told), readings[best].block(data),
                          headers=readings[best].headers(data))


def _exchanged(apart: _LeftOut) -> Interpretation | None:
    """Return that left-out rows have each other's measurements, None if they do not."""
    from scipy.optimize import linear_sum_assignment  # slow to import, seldom needed
    from scipy.spatial.distance import cdist

    fit, data, parts = apart.fit, apart.data, apart.parts
    poses = fit.state.poses[apart.index]
    rows = apart.rows[finite_rows(poses[apart.rows])]
    if len(rows) < FEWEST_ROWS:
        return None
    scale = np.where(np.array(parts) < 3, 1.0, fit.problem.mechanism.length_scale)
    expected = measured_pose(fit.state.registrations[apart.index], poses[rows])[:, parts]
    own = data.take(rows)
    where = linear_sum_assignment(cdist(expected * scale, shown(own)[:, parts] * scale))[1]
    other = replace(own, position=own.position[where], rotation=own.rotation[where],
                    whole=None, place=None)
    # repeats of one pose are interchangeable
    moved = (own.q != own.q[where]).any(axis=1) & (own.groups != own.groups[where])
    right = apart.fits(other, rows) & moved
    if right.sum() < max(FEWEST_ROWS, AGAINST / (1.0 + AGAINST) * len(rows)):
        return None
    numbers = tuple(own.rows[right].tolist())
    pairs = ", ".join(f"row {own.rows[j]} with joints of row {own.rows[i]}"
                      for i, j in list(enumerate(where))[:3])
    return Interpretation(data.source, (FileFault(
        "shuffled", tuple(POSE_COORDINATES[c] for c in parts), f"rows are in another order: in "
        f"{pluralize(len(numbers), 'row')} between {numbers[0]} and {numbers[-1]} the "
        f"measurement belongs to the joint values of another row ({pairs} ...)", numbers),))
