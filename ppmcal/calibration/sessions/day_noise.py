"""The noise of measurements that frozen machines are to predict: stated, or as the day shows it.

What exceeds noise, and which registration data demand, rests on the noise. A file may say that its
stated one only begins an estimate, or may plainly be wrong. A frozen machine's own errors are no
noise; what a fit to that day leaves, geometry and registration free, is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chdtrc

from ppmcal.calibration.fit import (
    ENOUGH_REPEATS,
    LARGER,
    Fit,
    FitOptions,
    Problem,
    noise_check,
    noise_quantity,
    noise_state,
    opened,
    secondary,
    typical_noise,
    with_estimated_noise,
)
from ppmcal.errors import PpmcalError
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

STATED, RESIDUALS, REPEATS = "stated", "residuals", "repeats"


@dataclass(frozen=True)
class UnlikeRow:
    """A row, by its number in the CSV, that is so many ``times`` the noise off the others."""

    row: int
    times: float


@dataclass(frozen=True)
class DayNoise:
    """The noise that a day is judged by.

    Attributes:
        factor: over the stated one.
        sigma: of a typical value or position, SI; nan where neither was measured.
        source: ``stated``; ``residuals`` of a fit to that day alone, or its ``repeats``.
        unlike: rows that such a fit of the first machine leaves out.
        quantity: of ``sigma``.
    """

    factor: float
    sigma: float
    source: str
    unlike: tuple[UnlikeRow, ...] = ()
    quantity: str = "length"


def day_noise(machines: Sequence[Mechanism], data: Dataset) -> DayNoise:
    """Return the noise of a data set; where it cannot be told, as it is stated.

    It is estimated where the file wants that. Stated noise gives way where the data plainly say
    otherwise: residuals far smaller than it, or repeats that scatter more. Larger residuals alone
    do not: they may be what the model misses.

    Args:
        machines: with their free geometry, which may be another that day; the least noise counts.
        data: the data set.
    """
    wide = opened(data, data.kind.opened)
    known = float("nan") if data.kind.sees_rotation and not np.isfinite(
        data.sigma_position).any() else typical_noise(data)
    fits = [f for m in machines if (f := _own_fit(m, wide)) is not None]
    factor, source = min((_noise(fit, own, data) for fit, own in fits), default=(1.0, STATED))
    return DayNoise(factor, factor * known, source, _unlike(fits[0][0], data) if fits else (),
                    noise_quantity(data))


def _own_fit(machine: Mechanism, data: Dataset) -> tuple[Fit, float] | None:
    """Return a fit to that day alone and its noise over the stated one, None without one."""
    try:
        fit, factors = with_estimated_noise(
            Problem(machine, (data,), machine.free), FitOptions(), [data.estimated])
    except PpmcalError:
        return None
    return fit, float(factors[0])


def _unlike(fit: Fit, data: Dataset) -> tuple[UnlikeRow, ...]:
    """Return the rows that surely do not belong to a day's own fit, worst first."""
    times = fit.times[0] if fit.times else {}
    return tuple(sorted((UnlikeRow(int(data.rows[n]), size) for n, size in times.items()
                         if fit.outliers[0][n]), key=lambda row: -row.times))


def _noise(fit: Fit, factor: float, data: Dataset) -> tuple[float, str]:
    """Return the noise over the stated one and its source."""
    check = noise_check(fit)
    repeats = check.repeat_ratio if check.repeat_degrees >= ENOUGH_REPEATS else None
    if data.estimated:
        if repeats and repeats < 1.0:    # the rest is what the model misses
            return factor * repeats, REPEATS
        return factor, RESIDUALS
    if check.overstated and check.by_dataset:    # on redundancy enough
        return (repeats, REPEATS) if repeats and repeats < check.sigma_ratio else (
            check.sigma_ratio, RESIDUALS)
    degrees = check.repeat_degrees
    larger = repeats is not None and noise_state(
        repeats, float(chdtrc(degrees, degrees * repeats**2))) == LARGER
    return (repeats, REPEATS) if repeats and larger else (1.0, STATED)


def with_day_noise(machines: Sequence[Mechanism], datasets: Sequence[Dataset], notes: list[Note]
                   ) -> tuple[list[Dataset], list[DayNoise]]:
    """Return data sets with the noise that they are judged by, and where it is from.

    ``notes``: to which is added where it could not be looked at, and is as stated.
    """
    found = [secondary(f"the noise that {d.name} shows", partial(day_noise, machines, d),
                       DayNoise(1.0, float("nan"), STATED), notes) for d in datasets]
    return [replace(d.noisier(n.factor), estimated=False)
            for d, n in zip(datasets, found, strict=True)], found
