"""A Gaussian process of one input at a time, and the candidate that looks most like its mean.

For each input (a joint, a place, a direction, time, temperature, order) a squared exponential, its
length and size by the marginal likelihood of what the geometry leaves; the best input against noise
alone. A process has no names: its mean takes the name of the candidate whose columns it is to most
of its length, and is something unknown where there is none. Readings that do not belong are put
aside before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labelled.linear import LinearProblem, gains, gross_readings, without
from labelled.score import Name
from ppmcal.linalg import Array

LENGTHS = (0.1, 0.3, 1.0)
"""Of the input's range."""
SIZES = np.geomspace(0.03, 30.0, 13)
"""Standard deviation of the process over that of the noise."""
SURE = float(np.log(19.0))
"""By so much the logarithm of the marginal likelihood has to rise, beside the choices made."""
ALIKE = 0.9
"""A candidate gives its name where it explains this part of the mean's square."""


@dataclass(frozen=True, eq=False)
class Best:
    """The best process: by how much the log marginal likelihood rises, and its covariance."""

    rise: float
    kernel: Array


def names(problem: LinearProblem, seed: int) -> tuple[tuple[Name, ...], float]:
    """Return what the process looks like, unknown where that has no name, and gross readings."""
    problem, gone = gross_readings(problem)
    rest = complement(problem)
    found = [b for values in problem.inputs.values() for b in _processes(problem, values, rest)]
    count = max(1, len(found))
    best = max(found, key=lambda b: b.rise, default=None)
    there = best is not None and best.rise > SURE + np.log(count)
    if best is None or not there:
        return gone, 0.0
    kernel = best.kernel
    mean = kernel @ rest @ np.linalg.solve(
        rest.T @ (np.eye(len(kernel)) + kernel) @ rest, rest.T @ problem.residual)
    named = _looks_like(problem, without(mean, problem.basis))
    return (*gone, *([named] if named else [])), 0.0 if named else 1.0


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
    part = gains(without(problem.matrix, problem.basis), mean, problem.candidates) / square
    # of those as good as the best the one with the fewest columns
    good = [(len(c.columns), -p, g) for g, (c, p) in enumerate(
        zip(problem.candidates, part, strict=True)) if p >= ALIKE]
    return problem.candidates[min(good)[2]].name() if good else None


def complement(problem: LinearProblem) -> Array:
    """Return a basis (n, n - r) of what the geometry does not take."""
    basis = problem.basis
    n = problem.residual.size
    whole = np.linalg.qr(np.concatenate([basis, np.eye(n)], axis=1))[0]
    return np.asarray(whole[:, basis.shape[1]:n])
