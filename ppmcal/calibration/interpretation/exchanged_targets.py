"""Targets of one body that stand in each other's columns in a stretch of rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.special import chdtri

from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Problem,
    State,
    distances,
    identify,
    prediction_covariance,
)
from ppmcal.calibration.interpretation.interpretation_error import FileFault, Interpretation
from ppmcal.calibration.interpretation.limits import AGAINST, CHANCE, FEWEST_ROWS, LANDS, SLACK
from ppmcal.calibration.interpretation.readings import readable
from ppmcal.calibration.interpretation.score import PARTS
from ppmcal.errors import PpmcalError
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.dataset import Dataset


def exchanged_in_part(problem: Problem) -> tuple[Interpretation, ...]:
    """Return exchanged targets by a fit of the first or the last rows, where they are in order."""
    for own in _bodies(problem):
        datasets = tuple(problem.datasets[i] for i in own)
        body = problem.afresh(datasets=datasets)
        for part in np.array_split(np.unique(np.concatenate([*map(_stands, datasets)])),
                                   PARTS)[::PARTS - 1]:
            with suppress(PpmcalError):
                found = exchanged_targets(_continued(body, part))
                if found:
                    return found
    return ()


def _continued(body: Problem, part: Ints) -> Fit | None:
    """Return a fit of the rows at some stands with all rows as it has them; None if it fails."""
    few = tuple(d.take(np.isin(_stands(d), part)) for d in body.datasets)
    fit = identify(replace(body, datasets=few), FitOptions(iterations=12))
    if fit.noise_factor.max() > LANDS:
        return None
    whole = replace(body, pivots=tuple(o.about for o in fit.problem.opens))
    state = whole.solve(State(fit.state.g, fit.state.registrations, whole.start().poses))
    return replace(fit, problem=whole, state=state)


def exchanged_targets(fit: Fit | None) -> tuple[Interpretation, ...]:
    """Return targets of one body that fit only if exchanged, in a stretch of rows."""
    if fit is None:
        return ()
    found = (_exchanged(fit, i, j) for own in _bodies(fit.problem)
             for i, j in combinations(own, 2))
    return tuple(m for m in found if m is not None)


def _bodies(problem: Problem) -> Iterator[list[int]]:
    """Yield the targets of each body that has several, by number."""
    for body in dict.fromkeys(d.body for d in problem.datasets if d.body):
        own = [i for i, d in enumerate(problem.datasets) if d.body == body and readable(d)]
        if len(own) > 1:
            yield own


def _stands(data: Dataset) -> Ints:
    """Return a label of where the machine stood, by row (N,)."""
    return data.numbers() if data.stands is None else data.stands


def _exchanged(fit: Fit, i: int, j: int) -> Interpretation | None:
    """Return that two targets are exchanged in a stretch of rows, None if they are not."""
    one, two = (fit.problem.datasets[n] for n in (i, j))
    _, a, b = np.intersect1d(_stands(one), _stands(two), return_indices=True)
    swapped = list(fit.problem.datasets)
    swapped[i], swapped[j] = _with(one, a, two, b), _with(two, b, one, a)
    own, other = _fit_rows(fit, fit.problem.datasets), _fit_rows(fit, swapped)
    right, exchanged = (k[i][a] & k[j][b] for k in (own, other))
    order = np.argsort(one.rows[a])
    gain = np.where(exchanged, np.where(right, 0.0, 1.0), -AGAINST)[order]
    begin, end, sure = best_stretch(gain)
    if sure < FEWEST_ROWS:
        return None
    numbers = tuple(one.rows[a][order][begin:end].tolist())
    text = (f"rows {numbers[0]} to {numbers[-1]}: targets {one.mark} and {two.mark} are exchanged, "
            "each measured where the other one should be")
    return Interpretation(one.source, (FileFault("targets", (one.mark, two.mark), text, numbers),))


def _with(data: Dataset, at: Ints, other: Dataset, there: Ints) -> Dataset:
    """Return a data set with what was measured of another target in some rows."""
    position, rotation = data.position.copy(), data.rotation.copy()
    position[at], rotation[at] = other.position[there], other.rotation[there]
    return replace(data, position=position, rotation=rotation, whole=None, place=None)


def _fit_rows(fit: Fit, datasets: Sequence[Dataset]) -> list[Bools]:
    """Return which rows (N,) of data sets a fit predicts."""
    problem = replace(fit.problem, datasets=tuple(datasets), pivots=tuple(
        o.about for o in fit.problem.opens), given=fit.problem.environments)
    nobody = [np.zeros(len(d), dtype=bool) for d in datasets]
    found = distances(problem, fit.state, prediction_covariance(fit), nobody)
    return [within(*parts) for parts in zip(found.square, found.size, fit.noise_factor.tolist(),
                                            strict=True)]


def within(square: Array, size: Array, factor: float) -> Bools:
    """Return which rows (N,) are within the noise, times a fit's factor and some slack."""
    limit = (SLACK * factor)**2 * chdtri(np.maximum(size, 1.0), CHANCE)
    with np.errstate(invalid="ignore"):
        return np.asarray((square <= limit) & (size > 0))


def best_stretch(gain: Array) -> tuple[int, int, float]:
    """Return the stretch of rows (N,) with the largest gain: first, end, and the gain."""
    total = np.append(0.0, np.cumsum(gain))
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    begin = int(np.flatnonzero(total[:end + 1] == lowest[end])[-1])
    return begin, end, float(total[end] - lowest[end])
