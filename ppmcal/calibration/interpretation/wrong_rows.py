"""Mistakes in some of the rows only: another reading from row a to row b, or rows exchanged.

A fit leaves such rows out, one by one. Together they say more: read in another way, or each with
the measurement of another one of them, they fit to the noise, which nothing that happens to a
machine makes them do.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri

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
from ppmcal.calibration.interpretation.misread import Misread
from ppmcal.calibration.interpretation.misreading import PARTS, right_parts
from ppmcal.calibration.interpretation.mistakes import Mistake, block_text, mistakes, read_block
from ppmcal.calibration.interpretation.reading_candidates import (
    joint_readings,
    position_readings,
    rotation_readings,
    whole_pose_readings,
)
from ppmcal.calibration.interpretation.reading_trial import NOISE, Misreading
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.pose_readings import FileReading, JointReading
from ppmcal.kinematics.registration import measured_pose
from ppmcal.linalg import Array, Bools, Ints, finite_rows, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import SCALARS
from ppmcal.wording import counted

FEWEST = 6
"""Rows that show a mistake together; fewer are single values typed wrong."""
SCREENED = 12
"""Rows with which readings are compared first."""
ENOUGH = 0.5
"""of which so large a part has to fit;"""
MENDED = 0.8
"""A reading mends a stretch, or an order the left-out rows, where so large a part then fits:"""
ASTRAY = 5.0
"""A part of the rows is not right where its own fit leaves more than so many times the noise."""
ROUGH = FitOptions(iterations=12)
"""How that is made."""
CHANCE, SLACK = 1e-3, 2.0
"""within this chance of the noise, and a factor for what the fit does not know there."""


def refuse_wrong_rows(fit: Fit) -> None:
    """Refuse measurements of which a stretch is read wrongly, or rows are exchanged.

    Raises:
        Misread: with the rows, and how they were meant.
    """
    found = []
    for i, data in enumerate(fit.problem.datasets):
        if data.kind not in SCALARS and data.commanded is None:
            apart = _LeftOut(fit, i)
            if len(apart.rows) >= FEWEST:
                one = apart.exchanged() or apart.read_otherwise()
                found += [one] if one else []
    if found:
        raise Misread.of(found, fit.problem.mechanism.units)


def wrong_parts(problem: Problem) -> tuple[Misreading, ...]:
    """Return in which rows measurements are wrong that are right in their first or last third.

    For files in which so much is wrong that a fit of all rows goes astray: what the third fits is
    fitted, and the others are judged by it.

    Args:
        problem: machine and data; of several files only what happens in one alone is looked at.
    """
    found: dict[str, Misreading] = {}
    for data, part in right_parts(problem):
        if data.kind in SCALARS or data.commanded is not None or data.source in found:
            continue
        with suppress(PpmcalError):
            one = _judged_by(problem.alone(data), part)
            found |= {data.source: one} if one else {}
    return tuple(found.values())


def refuse_wrong_part(problem: Problem) -> None:
    """Refuse measurements with :func:`wrong_parts`.

    Raises:
        Misread: with the rows, and how they were meant.
    """
    found = wrong_parts(problem)
    if found:
        raise Misread.of(found, problem.mechanism.units)


def _judged_by(problem: Problem, part: Ints) -> Misreading | None:
    """Return what is wrong in rows that a part does not predict, None if nothing explains them."""
    keep = np.isin(np.arange(len(problem.datasets[0])), part)
    for _ in range(2):
        some = identify(replace(problem, datasets=(problem.datasets[0].take(keep),)), ROUGH)
        if some.noise_factor > ASTRAY:
            return None
        whole = replace(problem, pivots=(some.problem.opens[0].about,))
        state = whole.solve(State(some.state.g, some.state.registrations, whole.start().poses))
        found = distances(whole, state, prediction_covariance(some), [np.zeros_like(keep)])
        keep = _within(found.square[0], found.size[0], some.noise_factor)
    if keep.mean() < 1.0 / PARTS or (~keep).sum() < FEWEST:
        return None
    apart = _LeftOut(replace(some, problem=whole, state=state, keep=(keep,)), 0)
    return apart.exchanged() or apart.read_otherwise()


def _within(square: Array, size: Array, factor: float) -> Bools:
    """Return which rows are within the noise, a fit's factor and some slack (N,)."""
    limit = (SLACK * factor)**2 * chdtri(np.maximum(size, 1.0), CHANCE)
    with np.errstate(invalid="ignore"):
        return np.asarray((square <= limit) & (size > 0))


@dataclass(frozen=True, eq=False)
class _LeftOut:
    """The rows of one data set that a fit left out although everything is there."""

    fit: Fit
    index: int

    @property
    def data(self) -> Dataset:
        return self.fit.problem.datasets[self.index]

    @cached_property
    def rows(self) -> Ints:
        data = self.data
        parts = list(coordinates(data, self.fit.problem.mechanism.motion))
        whole = finite_rows(data.q) & np.isfinite(shown(data)[:, parts]).all(axis=1)
        out = np.flatnonzero(whole & ~self._unusable & ~self.fit.keep[self.index])
        # what is near the noise as it is needs no other reading
        return out[~self.fits(data.take(out), out, True)] if len(out) else out

    @property
    def _unusable(self) -> Bools:
        return np.array([bool(why) for why in self.data.unusable or [""] * len(self.data)])

    def fits(self, data: Dataset, rows: Ints, solved: bool) -> Bools:
        """Return which rows fit to the noise if they are ``data`` (n,).

        ``solved``: the joint values are those of the fit, and so are the poses.
        """
        fit, i = self.fit, self.index
        alone = Problem(fit.problem.mechanism, (data,), fit.problem.free,
                        (fit.problem.opens[i].about,), (fit.problem.environments[i].take(rows),))
        homing = fit.state.registrations[i].homing
        pose = fit.state.poses[i][rows] if solved else alone.reached(
            0, Model(fit.problem.mechanism, fit.state.g), homing)
        found = distances(alone, State(fit.state.g, (fit.state.registrations[i],), (pose,)))
        return _within(found.square[0], found.size[0], fit.noise_factor)

    def read_otherwise(self) -> Misreading | None:
        """Return a stretch of rows that another reading brings to the noise, None if none does."""
        mechanism, data = self.fit.problem.mechanism, self.data
        few = self.rows[subsample([np.ones(len(self.rows), bool)], SCREENED)[0]]
        own = data.take(self.rows)
        planar, plain = mechanism.motion == "planar", JointReading.plain(len(mechanism.actuators))
        joints = [FileReading(j) for j in joint_readings(mechanism, own)[1:]]
        poses = [FileReading(plain, p) for p in (
            *position_readings(own, planar)[1:], *rotation_readings(own, planar)[1:],
            *whole_pose_readings(own, planar))]
        right = np.concatenate([self._read(joints, few, False), self._read(poses, few, True)])
        share = right.mean(axis=1)
        best = max(range(len(share)), key=lambda i: (share[i], -(joints + poses)[i].parts))
        if share[best] <= ENOUGH:
            return None
        reading = (joints + poses)[best]
        mended = self.rows[self._read([reading], self.rows, reading in poses)[0]]
        inside = np.arange(mended.min(), mended.max() + 1)
        known = inside[finite_rows(data.q[inside]) & ~self._unusable[inside]]
        if len(mended) < max(FEWEST, MENDED * len(known)):
            return None
        numbers = tuple(int(n) for n in data.rows[inside])
        block = block_text(read_block(reading, mechanism, data))
        told = [Mistake(m.kind, m.columns, m.text, numbers)
                for m in mistakes(reading, mechanism, data)]
        told[0] = replace(told[0], text=f"rows {numbers[0]} to {numbers[-1]}: {told[0].text}")
        told[-1] = replace(told[-1], text=f"{told[-1].text} (`read: {block}` there)")
        return _misreading(data, tuple(told))

    def _read(self, readings: Sequence[FileReading], rows: Ints, solved: bool) -> Bools:
        """Return which rows fit under which of some readings (R, n), all of them at once.

        ``solved``: no joint value changes.
        """
        mechanism, own = self.fit.problem.mechanism, self.data.take(rows)
        if not readings:
            return np.zeros((0, len(rows)), dtype=bool)
        read = [r.of(own, mechanism) for r in readings]
        every = np.tile(rows, len(read))
        data = replace(self.data.take(every), q=np.concatenate([d.q for d in read]),
                       position=np.concatenate([d.position for d in read]),
                       rotation=np.concatenate([d.rotation for d in read]))
        return self.fits(data, every, solved).reshape(len(read), len(rows))

    def exchanged(self) -> Misreading | None:
        """Return that left-out rows hold each other's measurements, None if they do not."""
        from scipy.optimize import linear_sum_assignment  # slow to import, seldom asked
        from scipy.spatial.distance import cdist

        fit, data = self.fit, self.data
        motion = fit.problem.mechanism.motion
        rows = self.rows[finite_rows(fit.state.poses[self.index][self.rows])]
        if len(rows) < FEWEST:
            return None
        parts = list(coordinates(data, motion))
        scale = np.where(np.array(parts) < 3, 1.0, fit.problem.mechanism.length_scale)
        expected = measured_pose(fit.state.registrations[self.index],
                                 fit.state.poses[self.index][rows])[:, parts]
        own = data.take(rows)
        where = linear_sum_assignment(cdist(expected * scale, shown(own)[:, parts] * scale))[1]
        other = replace(own, position=own.position[where], rotation=own.rotation[where],
                        whole=None, place=None)
        # repeats of one pose are as good as each other
        moved = (own.q != own.q[where]).any(axis=1) & (own.groups != own.groups[where])
        right = self.fits(other, rows, True) & moved
        if right.sum() < max(FEWEST, MENDED * len(rows)):
            return None
        numbers = tuple(int(n) for n in own.rows[right])
        pairs = ", ".join(f"row {own.rows[j]} with joints of row {own.rows[i]}"
                          for i, j in list(zip(np.arange(len(rows)), where, strict=True))[:3])
        return _misreading(data, (Mistake(
            "shuffled", tuple(_names(parts)), f"rows are in another order: in "
            f"{counted(len(numbers), 'row')} between {numbers[0]} and {numbers[-1]} the "
            f"measurement belongs to the joint values of another row ({pairs} ...)", numbers),))


def _names(parts: list[int]) -> list[str]:
    return [("x", "y", "z", "rx", "ry", "rz")[c] for c in parts]


def _misreading(data: Dataset, what: tuple[Mistake, ...]) -> Misreading:
    return Misreading(data.source, what, None, NOISE, np.nan, np.nan, np.nan)
