"""Columns of joint values alone that are read wrongly: exchanged, or in other units.

Nothing measures the platform then. But with columns read rightly, surplus limbs contradict each
other only by what noise and tolerances of the nominal machine explain; in another unit, or
exchanged, by far more. The same holds for the unit of all of them: such data do not determine the
size of a machine, but its drawing does. Misreadings that wide tolerances could explain show in a
fit, which leaves larger residuals or ends farther from nominal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    Problem,
    distances,
    gap_noise,
    identify,
    mirror_images,
)
from ppmcal.calibration.interpretation.candidates import joint_readings
from ppmcal.calibration.interpretation.interpretation_error import (
    Interpretation,
    InterpretationError,
)
from ppmcal.calibration.interpretation.limits import LANDS, TELLING
from ppmcal.calibration.interpretation.readings import ColumnInterpretation
from ppmcal.calibration.interpretation.score import Score, rms, score, tolerances_away
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.least_squares_closure import with_gaps
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import number

ROWS = 60
"""Number of rows examined, evenly spread."""
MANY = 1.0 / 3.0
"""Part of rows with a contradiction below which they are gross errors, which the fit leaves out."""
FITS = 6
"""Maximum number of readings that are fitted."""


@dataclass(frozen=True, eq=False)
class AgainstNominal:
    """Rows q (n, k) of one data set against the nominal machine, and how far it may be off.

    ``allowed``: (n,) contradiction of the limbs that noise and tolerances explain, m.
    """

    model: Model
    q: Array
    allowed: Array

    @cached_property
    def as_read(self) -> tuple[Array, Array]:
        """:meth:`times` of the rows as they are read."""
        return self.times(self.q)

    def times(self, q: Array) -> tuple[Array, Array]:
        """Return contradictions (n,), m, and relative to the allowed ones; inf without a pose."""
        pose = self.pose(self.model, q)
        with np.errstate(invalid="ignore"):
            gap = np.linalg.norm(self.model.closure(q).lengths(pose), axis=1)
        gap = np.where(np.isfinite(gap), gap, np.inf)
        return gap, gap / self.allowed

    def pose(self, model: Model, q: Array) -> Array:
        """Return the poses (n, 8) where the limbs contradict each other least, nan without one."""
        home = np.tile(model.mechanism.home, (len(q), 1))
        pose, good, _ = newton(model.closure(q), home)
        return np.where(good[:, None], pose, np.nan)


def against_nominal(problem: Problem, data: Dataset) -> AgainstNominal | None:
    """Return rows against the nominal machine, None if it allows no judgement."""
    mechanism = replace(problem.mechanism.nominal(), effects=())
    q = data.q[finite_rows(data.q)]
    q = q[np.linspace(0, len(q) - 1, min(len(q), ROWS)).astype(int)] if len(q) else q
    if len(q) < 3 or any(mechanism.parameters[p].prior_sigma is None for p in mechanism.free):
        return None
    model = Model(mechanism)
    rows = AgainstNominal(model, q, np.ones(len(q)))
    pose = rows.pose(model, q)
    # limbs close at these joint values; the values read may be in another unit, far from them
    closed = np.full_like(q, np.nan)
    known = finite_rows(pose)
    if known.any():
        closed[known] = inverse(model, pose[known]).q
    good = finite_rows(closed)
    if not good.any():
        return None
    # the allowance of the tolerances where there is a pose; elsewhere the largest of them
    sigma = np.array([mechanism.parameters[p].prior_sigma or 0.0 for p in mechanism.free])
    closure, at = model.closure(closed[good], mechanism.free), pose[good]
    moved = np.concatenate([closure.error_matrix(at, mechanism.free) * sigma,
                            with_gaps(closure.joint_matrix(at) * data.sigma_actuator,
                                      gap_noise(mechanism, data))], axis=-1)
    allowed = np.full(len(q), np.linalg.norm(moved, axis=(-2, -1)).max())
    allowed[good] = np.linalg.norm(moved, axis=(-2, -1))
    return replace(rows, allowed=allowed)


@dataclass(frozen=True, eq=False)
class _RankedReading:
    """One reading of the columns, and how far limbs contradict each other with it.

    ``part``, ``gap``: the median contradiction, relative to the allowed one and in m.
    """

    part: float
    gap: float
    reading: ColumnInterpretation


def _ways(rows: AgainstNominal, data: Dataset) -> list[_RankedReading]:
    """Return single changes of the columns' reading that the tolerances allow, best first.

    Without changes that make no difference, such as a sign where limbs depend on the square, and
    without units in which values are so small that tolerances explain any rows, even mixed-up ones.
    """
    mechanism = rows.model.mechanism
    plain, as_read = ColumnInterpretation.as_declared(mechanism, data), rows.as_read[0]
    out = []
    for joints in joint_readings(mechanism, data)[1:]:
        q = joints.of(rows.q)
        gap, times = rows.times(q)
        part = float(np.median(times))
        if part > LANDS or np.allclose(gap, as_read, rtol=1e-6):
            continue
        if not any(joints.units) or np.median(rows.times(_rolled(q))[1]) > max(
                1.0, TELLING * part):
            out.append(_RankedReading(part, float(np.median(gap)), replace(plain, joints=joints)))
    return sorted(out, key=lambda w: w.part)


def _rolled(q: Array) -> Array:
    """Return joint values (n, k) with each joint taken from another row, so without common pose."""
    n, k = q.shape
    return np.stack([np.roll(q[:, i], i * n // k) for i in range(k)], axis=1)


def contradicted(problem: Problem, data: Dataset) -> AgainstNominal | None:
    """Return rows against the nominal machine, None unless most of them contradict it."""
    rows = against_nominal(problem, data)
    if rows is None or np.mean(rows.as_read[1] > LANDS) <= MANY:
        return None
    return rows


def refuse_joint_columns(mechanism: Mechanism, data: Dataset, rows: AgainstNominal) -> None:
    """Refuse columns with which limbs contradict each other far more than with another reading.

    Raises:
        InterpretationError: with how they should be read.
    """
    units, (gap, times) = mechanism.units, (np.median(v) for v in rows.as_read)
    found = [w for w in _ways(rows, data) if w.part * TELLING <= times]
    now = (f"not by {units.words(float(gap), 'length')}" if np.isfinite(gap) else
           "while most rows have no pose as they are read")
    _refuse(mechanism, data, [
        (w.reading, f"limbs contradict each other by {units.words(w.gap, 'length')} then, {now}")
        for w in found if w.part <= TELLING * found[0].part])


def refuse_read_otherwise(fit: Fit) -> None:
    """Refuse joint values alone that a fit explains far better with another reading of columns.

    By its residuals, and by how far it moves the geometry. The nominal machine alone need not
    distinguish them: with one surplus equation per row its tolerances may explain either.

    Raises:
        InterpretationError: with the columns.
    """
    problem, left = fit.problem, fit_score(fit)
    if not _kept(fit):
        return
    for i, data in enumerate(problem.datasets):
        rows = against_nominal(problem, data) if data.kind.blind else None
        found, most = [], LANDS
        for way in [] if rows is None else _ways(rows, data)[:FITS]:
            if way.part > most:
                break
            other = _fitted(fit, i, way.reading, left)
            if other is not None and other.total * TELLING <= left.total:
                found.append((other, way.reading))
                # readings that put the geometry farther from nominal cannot compete
                most = min(most, TELLING * max(1.0, way.part))
        found.sort(key=lambda f: f[0].total)
        _refuse(problem.mechanism, data, [
            (way, _better(other, left)) for other, way in found
            if other.total <= TELLING * found[0][0].total])


def _fitted(fit: Fit, index: int, way: ColumnInterpretation, left: Score) -> Score | None:
    """Return the score of a fit with one data set read differently, None without a sound one.

    A short fit of some rows comes first: one with columns read wrongly takes long.
    """
    datasets = list(fit.problem.datasets)
    datasets[index] = way.of(datasets[index])
    problem = replace(fit.problem, datasets=tuple(datasets), pivots=None, given=None)
    if not score(problem).total * TELLING <= left.total:
        return None
    try:
        other = identify(problem)
    except PpmcalError:
        return None
    return fit_score(other) if other.converged and _kept(other) >= _kept(fit) else None


def fit_score(fit: Fit) -> Score:
    """Return the residuals of a fit of all rows, and how far it moves the geometry."""
    return Score(noise=distances(fit.problem, fit.state).times(fit.keep),
                 geometry=rms(tolerances_away(fit.problem, fit.state)))


def _kept(fit: Fit) -> int:
    """Return the number of rows that a fit uses."""
    return sum(int(np.count_nonzero(k)) for k in fit.keep)


def _better(other: Score, left: Score) -> str:
    """Return in words what falls most: the residuals, or the distance of the geometry."""
    if left.noise * other.geometry >= other.noise * left.geometry:
        return (f"residuals are {number(other.noise, 3)} times the noise then, not "
                f"{number(left.noise, 3)} times")
    return (f"the geometry is {number(other.geometry, 2)} tolerances from nominal then (RMS), not "
            f"{number(left.geometry, 3)}")


# --- in words -------------------------------------------------------------------------------------

def _refuse(mechanism: Mechanism, data: Dataset,
            found: Sequence[tuple[ColumnInterpretation, str]]) -> None:
    """Refuse columns if another reading is better; ``found``: readings and reasons, best first."""
    if not found:
        return
    (best, why), *others = found
    where = " (in the table, or the points of these limbs in the mechanism file)"
    *first, last = [replace(f, text=f"{f.text}{where * (f.kind == 'permuted')}")
                    for f in best.joints.mistakes("permuted")]
    raise InterpretationError.of([Interpretation(
        data.source, (*first, replace(last, text=f"{last.text}: {why}")), best.block(data),
        headers=best.headers(data), right=best.of(data),
        alternatives=tuple(tuple(way.joints.mistakes("permuted")) for way, _ in others),
        alternative_blocks=tuple(way.block(data) for way, _ in others),
        alike=_alike(mechanism, best, [way for way, _ in others]))], mechanism.units)


def _alike(mechanism: Mechanism, best: ColumnInterpretation,
           others: Sequence[ColumnInterpretation]) -> str:
    """Return that several readings fit equally, and whether they are equivalent machines."""
    if len(others) != 1:
        return "all fit equally" * bool(others)
    between = [best.joints.order.index(a) for a in others[0].joints.order]
    images = mirror_images(mechanism.nominal())
    turned = [[one[i] for i in two] for one, two in combinations(images, 2)]
    limbs = [(i, limb.actuator) for i, limb in enumerate(mechanism.limbs) if limb.driven]
    for found, words in ((images, ", and are mirror images of one another"),
                         (turned, ", and are the same machine turned by half a turn")):
        if best.joints.order != others[0].joints.order and any(
                all(between[a] == mechanism.limbs[image[i]].actuator for i, a in limbs)
                for image in found):
            return f"both fit equally{words}"
    return "both fit equally"
