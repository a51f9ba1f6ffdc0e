"""Gross errors: rows that do not belong and were left out, and rows that nothing else checks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import Fit, prediction_covariance
from ppmcal.calibration.fit.homing_shift import HomingShift, homing_shifts
from ppmcal.calibration.fit.observation import coordinates, gap_names, shown
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.calibration.fit.row_distances import Distances, explained_distances
from ppmcal.calibration.fit.white_rows import Rows
from ppmcal.inference.priors import MOST_GROSS
from ppmcal.kinematics.registration import measured_pose
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import abbreviate_list
from ppmcal.wording.progress import stage

UNCHECKED = 0.1
"""A row is unchecked if less than this part of its own error stays in its residual."""
SHIFTS = 4.0
"""A left-out row is reported to change a parameter if by at least this many standard deviations."""
FIRST_ORDER = 100.0
"""And by fewer tolerances than this."""


@dataclass(frozen=True)
class GrossError:
    """One row that was left out.

    Attributes:
        dataset, row: its data set and its number in the CSV.
            farthest off, relative to noise; ``value``, ``predicted``: of this coordinate, SI.
        times: its residual in standard deviations of the noise that the rows show.
        number: name of the value of an instrument with a single one; for limbs that contradict
            each other, ``gap_leg1`` of the one farthest from closing, with its gap.
        joint: for a row contradicted by its repeats, the actuator that differs most from
            them; ``value``, ``predicted``: of the joint, SI, and ``times`` relative to the
            scatter of repeats.
        slack: limbs (ropes) that, by the sign of a row's one contradiction, may be slack: they
            read longer than the others allow.
    """

    dataset: str
    row: int
    coordinate: int
    value: float
    predicted: float
    times: float
    number: str = ""
    slack: tuple[str, ...] = ()
    joint: str = ""


@dataclass(frozen=True)
class UncheckedRows:
    """CSV rows of a data set that nothing else checks."""

    dataset: str
    rows: tuple[int, ...]


@dataclass(frozen=True)
class GrossErrors:
    """The gross errors of a fit.

    ``rows``: left out; ``would``: parameter -> (value now, value with those rows), SI;
    ``unchecked``: rows that nothing else checks; ``homing_shifts``: of joints.
    """

    rows: tuple[GrossError, ...]
    would: dict[str, tuple[float, float]]
    unchecked: tuple[UncheckedRows, ...]
    homing_shifts: tuple[HomingShift, ...]


@stage("explaining gross errors")
def find_gross_errors(fit: Fit, told: Fit | None = None) -> GrossErrors:
    """Return the gross errors in a fit's data.

    Args:
        fit: with the stated noise, by which rows are judged.
        told: with the noise found in the residuals, whose values are reported; None: the same.
    """
    covariance = prediction_covariance(fit)
    rows = tuple(_left_out(fit))
    told = told or fit
    return GrossErrors(rows, _would(told, prediction_covariance(told),
                                    told.noise / fit.noise) if rows else {},
                    tuple(unchecked(fit, covariance)), tuple(homing_shifts(fit)))


def _left_out(fit: Fit) -> Iterator[GrossError]:
    motion = fit.problem.mechanism.motion
    # each by itself, as rows are judged
    for rows in (r for i, gone in enumerate(fit.outliers)
                 for r in fit.problem.rows_of(i, fit.state, False, gone)):
        data = fit.problem.datasets[rows.dataset]
        places = coordinates(data, motion)
        worst = np.argmax(np.abs(rows.residual), axis=1)
        gaps = _gaps(rows) if np.any(worst >= len(places)) else np.zeros((0, 0))
        for n, (index, c) in enumerate(zip(rows.index.tolist(), worst.tolist(), strict=True)):
            # as judged; for rows that were not judged, as they are
            times = (fit.times[rows.dataset] if fit.times else {}).get(
                index, float(abs(rows.residual[n, c])))
            again = (fit.repeated[rows.dataset] if fit.repeated else {}).get(index)
            if again is not None and again.size:
                yield _against_repeats(fit, data, index, again, times)
                continue
            if c >= len(places):
                name, gap = _widest(gaps[n], fit.problem.mechanism)
                slack = _may_be_slack(gaps[n], fit.problem.mechanism) if data.kind.blind else ()
                yield GrossError(data.name, int(data.rows[index]), 0, gap, 0.0, times, name, slack)
                continue
            value = float(shown(data)[index, places[c]])
            predicted = value - float(rows.raw[n, c])
            if places[c] >= 3 and data.kind.of_poses:
                # rotation vectors do not add up: take the prediction of the whole rotation
                registration = fit.state.registrations[rows.dataset]
                pose = fit.state.poses[rows.dataset][index][None]
                predicted = float(measured_pose(registration, pose)[0, places[c]])
            name = data.kind.number if data.kind.of_poses else data.kind.columns(motion)[c]
            yield GrossError(data.name, int(data.rows[index]), places[c], value, predicted, times,
                             name)


def _against_repeats(fit: Fit, data: Dataset, index: int, again: Ints, times: float) -> GrossError:
    """Return the error of a row of joint values that its repeats ``again`` contradict."""
    middle = np.median(data.q[again], axis=0)
    joint = _most_apart(fit, data, data.q[index] - middle)
    name = fit.problem.mechanism.actuators[joint]
    return GrossError(data.name, int(data.rows[index]), 0, float(data.q[index, joint]),
                      float(middle[joint]), times, f"q_{name}", joint=name)


def _most_apart(fit: Fit, data: Dataset, apart: Array) -> int:
    """Return the index of the joint whose values (k,) differ most relative to their noise."""
    sigma = fit.problem.sigma_joints[fit.problem.datasets.index(data)]
    return int(np.argmax(np.abs(apart) / np.maximum(sigma, 1e-300)))


def contradictions(fit: Fit) -> list[Note]:
    """Return notes on rows in use that were read at one place and contradict each other."""
    out = []
    for data, places in zip(fit.problem.datasets, fit.contradicting, strict=False):
        for rows in places:
            joint = _most_apart(fit, data, np.ptp(data.q[rows], axis=0))
            some = abbreviate_list([str(int(r)) for r in data.rows[rows]])
            out.append(Note(
                f"{data.name}: rows {some} were read at one place but contradict each other, most "
                f"in q_{fit.problem.mechanism.actuators[joint]}; which is wrong cannot be told, so "
                "they get less weight: read that place again", topic="row weights"))
    return out


def _gaps(rows: Rows) -> Array:
    """Return how far limbs are from closing at the best pose of all (n, m), m."""
    assert rows.response is not None
    return rows.response.closure.lengths(rows.response.pose)


def _widest(gaps: Array, mechanism: Mechanism) -> tuple[str, float]:
    """Return the limb of one row that is farthest from closing, and its gap, of all (m,)."""
    widest = int(np.argmax(np.abs(gaps)))
    return gap_names(mechanism)[widest], float(gaps[widest])


def _may_be_slack(gaps: Array, mechanism: Mechanism) -> tuple[str, ...]:
    """Return the ropes whose readings exceed their length in one row, if it has one contradiction.

    A single contradiction spreads over all limbs, so that its size points to none of them.
    """
    limbs = mechanism.limbs
    if mechanism.surplus != 1 or not all(limb.kind.pulls_only for limb in limbs):
        return ()
    return tuple(limb.name for limb, gap in zip(limbs, gaps, strict=True) if gap < 0.0)


def _would(fit: Fit, covariance: Array, noise: float) -> dict[str, tuple[float, float]]:
    """Return the parameters that the left-out rows would change, to first order.

    ``noise``: the fit's noise relative to that of its problem.
    """
    count = len(fit.problem.free)
    gain, right = np.zeros_like(covariance), np.zeros(len(covariance))
    # a fit moves the poses of its own rows, but not of those left out
    for rows in fit.problem.rows(fit.problem.solve(fit.state), True, fit.outliers):
        flat = rows.jacobian.reshape(-1, len(covariance)) / noise
        gain += flat.T @ flat
        right += flat.T @ rows.residual.reshape(-1) / noise
    step = linalg.solve(np.eye(len(covariance)) + covariance @ gain, covariance @ right)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    out = {}
    for c in np.argsort(-np.abs(step[:count]) / sigma[:count]).tolist():
        # beyond that a first-order figure is meaningless
        if SHIFTS * sigma[c] < abs(step[c]) < FIRST_ORDER * fit.scale[c]:
            p = fit.problem.free[c]
            now = float(fit.state.g[p])
            out[fit.problem.mechanism.names[p]] = (now, now + float(step[c]))
    return out


def unchecked(fit: Fit, covariance: Array) -> Iterator[UncheckedRows]:
    """Yield rows of single-value instruments whose own error would hardly show."""
    found: dict[str, list[int]] = {}
    keep = [k & (d.kind.scalar) for d, k in zip(fit.problem.datasets, fit.keep, strict=True)]
    for rows in fit.problem.rows(fit.state, True, keep):
        data = fit.problem.datasets[rows.dataset]
        flat = rows.jacobian[:, 0]
        left = 1.0 - np.sum((flat @ covariance) * flat, axis=1)
        found.setdefault(data.name, []).extend(
            data.rows[rows.index[left < UNCHECKED]].astype(int).tolist())
    for name, numbers in found.items():
        if numbers:
            yield UncheckedRows(name, tuple(numbers))


# --- rows far beyond what noise and tolerances explain, whatever the geometry ---------------------

GROSS = 5.0
"""Before a fit, a row is set aside if this many times beyond what noise and tolerances explain."""


def gross_errors(problem: Problem, state: State, keep: Sequence[Bools]) -> list[Bools]:
    """Return which of the rows ``keep`` cannot belong for any geometry, by data set (N,).

    None of them if there are too many to be single mistakes.
    """
    out = gross_mask(explained_distances(problem, state), keep)
    total = sum(int(k.sum()) for k in keep)
    if sum(int(o.sum()) for o in out) > float(MOST_GROSS) * total:
        return [np.zeros_like(o) for o in out]
    return out


def single_gross_rows(fit: Fit) -> list[Bools]:
    """Return rows (N,) of each data set that are gross errors while their neighbours are not."""
    out = []
    for gross in gross_errors(fit.problem, fit.state, rows_with_outliers(fit)):
        beside = np.convolve(gross, [1, 0, 1], mode="same") > 0 if gross.size > 1 else gross
        out.append(gross & ~beside)
    return out


def rows_with_outliers(fit: Fit) -> list[Bools]:
    """Return the rows (N,) of each data set that a fit used or left out as outliers."""
    return [k | o for k, o in zip(fit.keep, fit.outliers, strict=True)]


def gross_mask(found: Distances, keep: Sequence[Bools]) -> list[Bools]:
    """Return the rows ``keep`` beyond :data:`GROSS` times their median distance."""
    limit = GROSS * max(1.0, found.times(keep))
    return [k & (np.sqrt(np.where(np.isnan(d) | (m == 0), 0.0, d) / chdtri(np.maximum(m, 1.0), 0.5))
                 > limit) for k, d, m in zip(keep, found.square, found.size, strict=True)]
