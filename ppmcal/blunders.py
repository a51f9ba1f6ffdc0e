"""Rows and sessions that do not belong: which, by how much, and what they would have done.

A row that was left out is shown with what the others predict for it, and with what the fit would
be with it. A row that alone tells what it tells cannot be checked by any other: that is said
too. Sessions in which a joint's zero was elsewhere are found in :mod:`ppmcal.zeros`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ppmcal.arrays import Array
from ppmcal.fit import Fit, prediction_covariance
from ppmcal.kinematics.registration import measured_pose
from ppmcal.observation import NUMBERS, SCALARS, coordinates, shown
from ppmcal.zeros import Shift, zeros

UNCHECKED = 0.1
"""A row keeps less than this part of its own error in its residual: none would be seen."""
SHIFTS = 4.0
"""A left-out row is said to change a parameter where it would by so many sigmas."""
FIRST_ORDER = 100.0
"""And by fewer tolerances than these."""


@dataclass(frozen=True)
class Blunder:
    """One row that was left out.

    Attributes:
        dataset, row: its data set and its number in the CSV.
        coordinate: index among x, y, z, rx, ry, rz (a height is z, a distance x) that is
            farthest off, measured over noise; ``value``, ``predicted``: there, SI.
        times: how far, in standard deviations.
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
class Blunders:
    """What does not belong.

    ``rows``: left out; ``would``: parameter -> (value now, value with those rows), SI;
    ``unchecked``: (data set, CSV rows) that nothing else checks; ``shifts``: of zeros.
    """

    rows: tuple[Blunder, ...]
    would: dict[str, tuple[float, float]]
    unchecked: tuple[tuple[str, tuple[int, ...]], ...]
    shifts: tuple[Shift, ...]


def blunders(fit: Fit) -> Blunders:
    """Return what does not belong in a fit's data."""
    covariance = prediction_covariance(fit)
    rows = tuple(_left_out(fit))
    return Blunders(rows, _would(fit, covariance) if rows else {},
                    tuple(_unchecked(fit, covariance)), tuple(zeros(fit)))


def _left_out(fit: Fit) -> Iterator[Blunder]:
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
                station = fit.state.stations[rows.dataset]
                pose = fit.state.poses[rows.dataset][index][None]
                predicted = float(measured_pose(station, pose)[0, places[c]])
            yield Blunder(data.name, int(data.rows[index]), places[c], value, predicted,
                          float(abs(rows.residual[n, c])), NUMBERS.get(data.kind, ""))


def _would(fit: Fit, covariance: Array) -> dict[str, tuple[float, float]]:
    """Return parameters that the left-out rows would change, to first order."""
    count = len(fit.problem.free)
    gain, right = np.zeros_like(covariance), np.zeros(len(covariance))
    for rows in fit.problem.rows(fit.state, True, fit.outliers):
        flat = rows.jacobian.reshape(-1, len(covariance))
        gain += flat.T @ flat
        right += flat.T @ rows.residual.reshape(-1)
    step = np.linalg.solve(np.eye(len(covariance)) + covariance @ gain, covariance @ right)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    out = {}
    for c in np.argsort(-np.abs(step[:count]) / sigma[:count]).tolist():
        # beyond that a first-order figure says nothing
        if SHIFTS * sigma[c] < abs(step[c]) < FIRST_ORDER * fit.scale[c]:
            p = fit.problem.free[c]
            now = float(fit.state.g[p])
            out[fit.problem.mechanism.names[p]] = (now, now + float(step[c]))
    return out


def _unchecked(fit: Fit, covariance: Array) -> Iterator[tuple[str, tuple[int, ...]]]:
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
