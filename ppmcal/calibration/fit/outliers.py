"""Rows that do not belong: down-weighted on the way, named and left out at the end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import Fit, prediction_covariance
from ppmcal.calibration.fit.homing_shift import HomingShift, homing_shifts
from ppmcal.calibration.fit.normal_equations import row_squares, white_blocks
from ppmcal.calibration.fit.observation import coordinates, shown
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.kinematics.registration import measured_pose
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.instruments import NUMBERS, SCALARS
from ppmcal.wording.progress import stage

HUBER = 1.5
"""Rows farther than this many standard deviations (root mean square) are down-weighted."""
ALONE = 1e-3
"""A row keeps less than this part of its own error where it alone fixes something."""
REJECT = 0.05
"""A row is left out when its p-value times the number of rows is below this."""


@dataclass(frozen=True)
class Distances:
    """How far rows are from the fit, by data set.

    ``square``: squared white distance (N,), nan where there is no pose; ``size``: number of
    coordinates behind it (N,).
    """

    square: tuple[Array, ...]
    size: tuple[Array, ...]

    def factor(self, keep: Sequence[Bools]) -> float:
        """Return the robust scale of the residuals over the stated noise, at least 1."""
        return max(1.0, self.times(keep))

    def times(self, keep: Sequence[Bools]) -> float:
        """Return the median distance of the rows in use over that of noise, 0 without rows."""
        ratios = np.concatenate([
            (d[k & (m > 0)] / chdtri(m[k & (m > 0)], 0.5)) for d, m, k in
            zip(self.square, self.size, keep, strict=True)])
        ratios = ratios[np.isfinite(ratios)]
        return float(np.sqrt(np.median(ratios))) if ratios.size else 0.0

    def over_noise(self, factor: float) -> list[Array]:
        """Return how many times the noise rows are off, rms of a row's values (N,)."""
        return [np.sqrt(d / np.maximum(m, 1.0)) / factor
                for d, m in zip(self.square, self.size, strict=True)]

    def p_values(self, factor: float) -> list[Array]:
        """Return the chance of a larger distance, by data set (N,); 1 where unknown."""
        return [np.where(~np.isnan(d) & (m > 0), chdtrc(np.maximum(m, 1), np.nan_to_num(
            d, nan=0.0, posinf=np.inf) / factor**2), 1.0)
            for d, m in zip(self.square, self.size, strict=True)]


def distances(problem: Problem, state: State, covariance: Array | None = None,
              keep: Sequence[Bools] | None = None) -> Distances:
    """Return every row's distance; with ``covariance`` (C, C) freed of its own leverage.

    A used row pulled the fit towards itself: its residual has covariance I - J C J^T. A row
    that was left out is predicted: I + J C J^T.
    """
    square = [np.full(len(d), np.nan) for d in problem.datasets]
    size = [np.zeros(len(d)) for d in problem.datasets]
    for i, pose in enumerate(state.poses):
        solved = finite_rows(pose)
        if covariance is not None and covariance.size:
            for block in white_blocks(problem, state, i, solved):
                used = np.ones(len(block.index)) if keep is None else np.where(
                    keep[i][block.index], 1.0, -1.0)
                square[i][block.index] = _freed(block.rows, covariance, used)
                size[i][block.index] = block.values
            continue
        own = row_squares(problem, state, i, solved)
        if own is not None:
            rows = np.flatnonzero(solved)
            square[i][rows], size[i][rows] = own, problem.measured(i, rows)[2]
            continue
        for part in problem.rows_of(i, state, False):
            square[i][part.index] = np.sum(part.residual * part.residual, axis=1)
            size[i][part.index] = part.observed.sum(axis=1)
    return Distances(tuple(square), tuple(size))


def _freed(rows: Array, covariance: Array, used: Array) -> Array:
    """Return squared distances (n,) of white rows (n, m, C + 1), residual last, less leverage.

    Args:
        rows: Jacobian and residual.
        covariance: of the columns (C, C).
        used: 1 where the fit used a row, -1 where not (n,).
    """
    jacobian, r = rows[..., :-1], rows[..., -1]
    spread = (jacobian.reshape(-1, len(covariance)) @ covariance).reshape(jacobian.shape)
    hat = spread @ np.swapaxes(jacobian, -1, -2)
    of_residual = np.eye(r.shape[1]) - used[:, None, None] * hat
    singular = ~np.isfinite(of_residual).all(axis=(1, 2))
    of_residual[singular] = np.eye(r.shape[1])
    # a row that alone fixes a parameter has no residual to judge; none does whose leverage is small
    heavy = np.flatnonzero((used > 0.0) & ~singular
                           & (np.trace(hat, axis1=1, axis2=2) > 1.0 - ALONE))
    weak = heavy[linalg.eigvalsh(of_residual[heavy])[:, 0] < ALONE]
    of_residual[weak] = np.eye(r.shape[1])
    squares = np.sum(r * linalg.solve(of_residual, r[..., None])[..., 0], axis=1)
    # round-off of a covariance that spans too many digits: the residual as it is
    squares = np.where(squares < 0.0, np.sum(r * r, axis=1), squares)
    squares[singular] = np.inf
    return np.asarray(squares)


def huber_weights(problem: Problem, state: State, keep: Sequence[Bools]) -> list[Array]:
    """Return the factor on each row's residual, by data set (N,)."""
    found = distances(problem, state)
    out = []
    for away in found.over_noise(found.factor(keep)):
        with np.errstate(invalid="ignore", divide="ignore"):
            weight = np.minimum(1.0, HUBER / away)
        out.append(np.sqrt(np.where(np.isfinite(weight), weight, 1.0)))
    return out


def worst(found: Distances, keep: Sequence[Bools], factor: float) -> list[tuple[int, int, float]]:
    """Return the used rows that do not belong, worst first: (data set, row, p)."""
    total = sum(int(k.sum()) for k in keep)
    bad = [(i, int(n), float(p[n])) for i, (p, k) in
           enumerate(zip(found.p_values(factor), keep, strict=True))
           for n in np.flatnonzero(k & (p * total < REJECT))]
    return sorted(bad, key=lambda b: (b[2], -found.square[b[0]][b[1]]))


UNCHECKED = 0.1
"""A row keeps less than this part of its own error in its residual: none would be seen."""
SHIFTS = 4.0
"""A left-out row is said to change a parameter where it would by so many sigmas."""
FIRST_ORDER = 100.0
"""And by fewer tolerances than these."""


@dataclass(frozen=True)
class GrossError:
    """One row that was left out.

    Attributes:
        dataset, row: its data set and its number in the CSV.
        coordinate: index among x, y, z, rx, ry, rz (a height is z, a distance x) that is
            farthest off, measured over noise; ``value``, ``predicted``: there, SI.
        times: how far, in standard deviations of the noise that the rows show.
        number: what an instrument of one number calls it.
    """

    dataset: str
    row: int
    coordinate: int
    value: float
    predicted: float
    times: float
    number: str = ""


@dataclass(frozen=True)
class GrossErrors:
    """What does not belong.

    ``rows``: left out; ``would``: parameter -> (value now, value with those rows), SI;
    ``unchecked``: (data set, CSV rows) that nothing else checks; ``homing_shifts``: of joints.
    """

    rows: tuple[GrossError, ...]
    would: dict[str, tuple[float, float]]
    unchecked: tuple[tuple[str, tuple[int, ...]], ...]
    homing_shifts: tuple[HomingShift, ...]


@stage("explaining gross errors")
def find_gross_errors(fit: Fit, told: Fit | None = None) -> GrossErrors:
    """Return what does not belong in a fit's data.

    Args:
        fit: with the stated noise, by which a row is judged.
        told: with the noise that is left, whose values people are told; None: the same.
    """
    covariance = prediction_covariance(fit)
    rows = tuple(_left_out(fit))
    told = told or fit
    return GrossErrors(rows, _would(told, prediction_covariance(told),
                                    told.noise / fit.noise) if rows else {},
                    tuple(unchecked(fit, covariance)), tuple(homing_shifts(fit)))


def _left_out(fit: Fit) -> Iterator[GrossError]:
    motion = fit.problem.mechanism.motion
    for rows in fit.problem.rows(fit.state, False, fit.outliers):
        data = fit.problem.datasets[rows.dataset]
        places = coordinates(data, motion)
        worst = np.argmax(np.abs(rows.residual), axis=1)
        for n, (index, c) in enumerate(zip(rows.index.tolist(), worst.tolist(), strict=True)):
            value = float(shown(data)[index, places[c]])
            predicted = value - float(rows.raw[n, c])
            if places[c] >= 3:
                # rotation vectors do not add up: what the others say of the whole rotation
                registration = fit.state.registrations[rows.dataset]
                pose = fit.state.poses[rows.dataset][index][None]
                predicted = float(measured_pose(registration, pose)[0, places[c]])
            yield GrossError(data.name, int(data.rows[index]), places[c], value, predicted,
                          _times(fit, rows.dataset, index, float(abs(rows.residual[n, c]))),
                          NUMBERS.get(data.kind, ""))


def _times(fit: Fit, dataset: int, row: int, plain: float) -> float:
    """Return how many times the noise a row was judged to be off, ``plain`` where nobody did."""
    return fit.times[dataset].get(row, plain) if fit.times else plain


def _would(fit: Fit, covariance: Array, noise: float) -> dict[str, tuple[float, float]]:
    """Return parameters that the left-out rows would change, to first order.

    ``noise``: what the fit counts rows as, times that of its problem.
    """
    count = len(fit.problem.free)
    gain, right = np.zeros_like(covariance), np.zeros(len(covariance))
    # a fit moves the poses of its own rows, not of those left out
    for rows in fit.problem.rows(fit.problem.solve(fit.state), True, fit.outliers):
        flat = rows.jacobian.reshape(-1, len(covariance)) / noise
        gain += flat.T @ flat
        right += flat.T @ rows.residual.reshape(-1) / noise
    step = linalg.solve(np.eye(len(covariance)) + covariance @ gain, covariance @ right)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    out = {}
    for c in np.argsort(-np.abs(step[:count]) / sigma[:count]).tolist():
        # beyond that a first-order figure says nothing
        if SHIFTS * sigma[c] < abs(step[c]) < FIRST_ORDER * fit.scale[c]:
            p = fit.problem.free[c]
            now = float(fit.state.g[p])
            out[fit.problem.mechanism.names[p]] = (now, now + float(step[c]))
    return out


def unchecked(fit: Fit, covariance: Array) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Yield rows of one-number instruments whose own error would hardly show."""
    found: dict[str, list[int]] = {}
    keep = [k & (d.kind in SCALARS) for d, k in zip(fit.problem.datasets, fit.keep, strict=True)]
    for rows in fit.problem.rows(fit.state, True, keep):
        data = fit.problem.datasets[rows.dataset]
        flat = rows.jacobian[:, 0]
        left = 1.0 - np.sum((flat @ covariance) * flat, axis=1)
        found.setdefault(data.name, []).extend(
            data.rows[rows.index[left < UNCHECKED]].astype(int).tolist())
    for name, numbers in found.items():
        if numbers:
            yield name, tuple(numbers)
