"""The noise of measurements that frozen machines are to predict: stated, or as the day shows it.

The noise decides which errors exceed it, and which registration the data need. A file may state it
only as the start of an estimate, or may be plainly wrong. Errors of a frozen machine are not noise;
the residuals of a fit to that day, with geometry and registration free, are.
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
    """A row, by its number in the CSV, that is off the others by so many ``times`` the noise."""

    row: int
    times: float


@dataclass(frozen=True)
class DayNoise:
    """The noise by which a day is judged.

    Attributes:
        factor: over the stated noise.
        sigma: of a typical value or position, SI; nan if neither was measured.
        source: ``stated``; ``residuals`` of a fit to that day alone, or its ``repeats``.
        unlike: rows left out by such a fit of the first machine.
        quantity: of ``sigma``.
    """

    factor: float
    sigma: float
    source: str
    unlike: tuple[UnlikeRow, ...] = ()
    quantity: str = "length"


def day_noise(machines: Sequence[Mechanism], data: Dataset) -> DayNoise:
    """Return the noise of a data set; as stated if it cannot be determined.

    It is estimated if the file asks for that. Stated noise is replaced if the data plainly
    contradict it: residuals far smaller than it, or repeats that scatter more. Larger residuals
    alone do not: they may be errors of the model.

    Args:
        machines: with their free geometry, which may differ that day; the least noise counts.
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
    """Return a fit to that day alone and its noise over the stated noise, None without one."""
    try:
        fit, factors = with_estimated_noise(
            Problem(machine, (data,), machine.free), FitOptions(), [data.estimated])
    except PpmcalError:
        return None
    return fit, float(factors[0])


def _unlike(fit: Fit, data: Dataset) -> tuple[UnlikeRow, ...]:
    """Return the rows that surely do not belong, by a fit to that day alone, worst first."""
    times = fit.times[0] if fit.times else {}
    return tuple(sorted((UnlikeRow(int(data.rows[n]), size) for n, size in times.items()
                         if fit.outliers[0][n]), key=lambda row: -row.times))


def _noise(fit: Fit, factor: float, data: Dataset) -> tuple[float, str]:
    """Return the noise over the stated noise, and its source."""
    check = noise_check(fit)
    repeats = check.repeat_ratio if check.repeat_degrees >= ENOUGH_REPEATS else None
    if data.estimated:
        if repeats and repeats < 1.0:    # the rest is the model's error
            return factor * repeats, REPEATS
        return factor, RESIDUALS
    if check.overstated and check.by_dataset:    # with enough redundancy
        return (repeats, REPEATS) if repeats and repeats < check.sigma_ratio else (
            check.sigma_ratio, RESIDUALS)
    degrees = check.repeat_degrees
    larger = repeats is not None and noise_state(
        repeats, float(chdtrc(degrees, degrees * repeats**2))) == LARGER
    return (repeats, REPEATS) if repeats and larger else (1.0, STATED)


def with_day_noise(machines: Sequence[Mechanism], datasets: Sequence[Dataset], notes: list[Note]
                   ) -> tuple[list[Dataset], list[DayNoise]]:
    """Return data sets with the noise by which they are judged, and its source.

    ``notes``: receives a note if it could not be examined and is as stated.
    """
    found = [secondary(f"the noise that {d.name} shows", partial(day_noise, machines, d),
                       DayNoise(1.0, float("nan"), STATED), notes) for d in datasets]
    return [replace(d.noisier(n.factor), estimated=False)
            for d, n in zip(datasets, found, strict=True)], found
