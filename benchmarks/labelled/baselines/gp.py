"""A Gaussian process of one input at a time, and the candidate that looks most like its mean.

For each input (a joint, a place, a direction, time, temperature, order) a squared exponential, its
length and size by the marginal likelihood of what the geometry leaves; the best input against noise
alone. A process has no names: its mean takes the name of the candidate whose columns it is to most
of its length, and is something unknown where there is none. Readings far from what all others
predict do not belong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from labelled.linear import LinearProblem, gains, span, without
from labelled.score import Name
from scipy.special import log_ndtr

from ppmcal.linalg import Array

LENGTHS = (0.1, 0.3, 1.0)
"""Of the input's range."""
SIZES = np.geomspace(0.03, 30.0, 13)
"""Standard deviation of the process over that of the noise."""
SURE = float(np.log(19.0))
"""By so much the logarithm of the marginal likelihood has to rise, beside the choices made."""
ALIKE = 0.9
"""A candidate gives its name where it explains this part of the mean's square."""
GROSS = 0.01
"""Chance that any reading of a case that is in order is called one that does not belong."""


@dataclass(frozen=True, eq=False)
class Best:
    """The best process: by how much the log marginal likelihood rises, and its covariance."""

    rise: float
    kernel: Array


def names(problem: LinearProblem, seed: int) -> tuple[tuple[Name, ...], float]:
    """Return what the process looks like, unknown where that has no name, and gross readings."""
    rest = complement(problem)
    found = [b for values in problem.inputs.values() for b in _processes(problem, values, rest)]
    count = max(1, len(found))
    best = max(found, key=lambda b: b.rise, default=None)
    there = best is not None and best.rise > SURE + np.log(count)
    kernel = best.kernel if best is not None and there else np.zeros((problem.residual.size,) * 2)
    gross = tuple(Name("row", rows=(k + 1,)) for k in _gross(problem, kernel))
    if not there:
        return gross, 0.0
    mean = kernel @ rest @ np.linalg.solve(
        rest.T @ (np.eye(len(kernel)) + kernel) @ rest, rest.T @ problem.residual)
    named = _looks_like(problem, without(mean, problem.basis))
    return (*gross, *([named] if named else [])), 0.0 if named else 1.0


def _processes(problem: LinearProblem, values: Array, rest: Array) -> Iterator[Best]:
    """Yield the best process of each length along one input."""
    scaled = (values - values.min()) / np.ptp(values)
    seen = rest.T @ problem.residual
    m = seen.size
    if m < 2:
        return
    none = -0.5 * m * np.log(max(seen @ seen, np.finfo(float).tiny) / m)
    same = problem.coordinate[:, None] == problem.coordinate
    for length in LENGTHS:
        kernel = same * np.exp(-0.5 * ((scaled[:, None] - scaled) / length) ** 2)
        size, ways = np.linalg.eigh(rest.T @ kernel @ rest)
        along = (ways.T @ seen) ** 2
        spread = 1.0 + SIZES[:, None] ** 2 * np.maximum(size, 0.0)
        chance = -0.5 * np.log(spread).sum(axis=1) - 0.5 * m * np.log(
            np.maximum((along / spread).sum(axis=1), np.finfo(float).tiny) / m)
        at = int(np.argmax(chance))
        yield Best(float(chance[at] - none - np.log(SIZES.size)), SIZES[at] ** 2 * kernel)


def _looks_like(problem: LinearProblem, mean: Array) -> Name | None:
    square = float(mean @ mean)
    if square == 0.0 or not problem.candidates:
        return None
    part = gains(problem.matrix, mean, problem.candidates) / square
    # of those as good as the best the one with the fewest columns
    good = [(len(c.columns), -p, g) for g, (c, p) in enumerate(
        zip(problem.candidates, part, strict=True)) if p >= ALIKE]
    return problem.candidates[min(good)[2]].name() if good else None


def _gross(problem: LinearProblem, kernel: Array) -> list[int]:
    """Return readings that all others predict otherwise, one at a time, from 0 on."""
    gone: list[int] = []
    while len(gone) < problem.readings // 4:
        stay = ~np.isin(problem.reading, gone)
        own = problem.take(stay)
        left = complement(own)
        if left.shape[1] < 4:
            break
        precision = left @ np.linalg.solve(
            left.T @ (np.eye(int(stay.sum())) + kernel[np.ix_(stay, stay)]) @ left, left.T)
        square = np.maximum(np.diag(precision), 1e-9)
        away = precision @ own.residual / square
        noise = np.abs(away) * np.sqrt(square)
        scale = float(np.median(noise)) / 0.6745
        if scale == 0.0:
            break
        z = noise / scale
        worst = int(np.argmax(z))
        if np.log(2.0 * z.size) + log_ndtr(-z[worst]) > np.log(GROSS):
            break
        gone.append(int(own.reading[worst]))
    return gone


def complement(problem: LinearProblem) -> Array:
    """Return a basis (n, n - r) of what the geometry does not take."""
    basis = span(problem.geometry) if problem.geometry.size else problem.geometry[:, :0]
    n = problem.residual.size
    whole = np.linalg.qr(np.concatenate([basis, np.eye(n)], axis=1))[0]
    return np.asarray(whole[:, basis.shape[1]:n])
