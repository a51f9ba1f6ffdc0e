"""Is it enough? What is left, against the noise and against everything that was recorded.

The kernel (score) test asks whether residuals of nearby inputs are alike: e^T K e, with K a
sum of two Gaussian kernels over the inputs, against the same figure of simulated noise
that went through the same projections. It describes; it never names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, gammaincc, ndtri

from ppmcal.calibration.fit import ENOUGH_REPEATS, noise_source
from ppmcal.diagnosis.added_variable_test import squares
from ppmcal.diagnosis.linear_system import System
from ppmcal.diagnosis.stage import Stage, explained
from ppmcal.diagnosis.whitening import PureError, simulated
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array

MOST_ROWS = 600
DRAWS = 1000
LEAST_PIVOT = 1e-12
"""Of a kernel's trace: what is left of it is round-off then."""
COLUMNS = 512
"""Values of all rows that are worked on at a time."""
LEVEL = 0.01
"""What is left follows an input where chance would show it more rarely over all inputs."""
LEAST_SKEW = 0.05
"""The gamma distribution is as good as normal then."""
TOO_MUCH = 3.5
"""Residuals exceed the noise where their mean square does so by this many sigmas."""


@dataclass(frozen=True)
class Remainder:
    """What is left.

    Attributes:
        ratio: rms over the noise reference; excess: how many sigmas above it.
        reference: noise over the stated noise, and where it is from.
        follows: the input that residuals follow most, and p over all inputs.
        by_input: p of each input alone.
    """

    ratio: float
    excess: float
    reference: float
    source: str
    follows: str
    p_value: float
    by_input: dict[str, float]

    @property
    def adequate(self) -> bool:
        """Whether nothing is left to explain."""
        return self.p_value >= LEVEL and self.excess < TOO_MUCH


def remainder(stage: Stage, seed: int) -> Remainder:
    """Return what the chosen effects leave."""
    basis, left = explained(stage)
    freedom = max(stage.system.count - basis.shape[1], 1)
    ratio, excess, reference, source = _against_noise(stage, left, freedom)
    by_input, p, follows = kernel_test(stage, basis, left, seed)
    return Remainder(ratio, excess, reference, source, follows, p, by_input)


def against_noise(stage: Stage) -> tuple[float, float, float, str]:
    """Return rms of what the chosen effects leave over the noise, its excess, the reference."""
    basis, left = explained(stage)
    return _against_noise(stage, left, max(stage.system.count - basis.shape[1], 1))


def _against_noise(stage: Stage, left: Array, freedom: int) -> tuple[float, float, float, str]:
    """Return rms over the noise, its excess in sigmas, the reference and its source."""
    rows = np.sum(left.reshape(stage.system.residual.shape) ** 2, axis=1)
    mean = float(rows.sum()) / freedom
    error = float(rows.std()) * np.sqrt(rows.size) / freedom
    reference, source, own = 1.0, noise_source(stage.system.problem.datasets), 0.0
    pure: PureError | None = stage.pure
    if pure is not None and pure.freedom >= ENOUGH_REPEATS:
        reference, source = pure.ratio, "repeats"
        own = pure.ratio**2 * np.sqrt(2.0 / pure.freedom)
    # a correlation that is off by so much whitens to another scale
    rho, off = stage.noise.rho, stage.noise.rho_error
    scale = mean * 2.0 * abs(rho) / (1.0 - rho**2) * off
    # both as they would be at the noise's own level: few rows far above it scatter as far
    error, scale = (e * min(reference**2 / mean, 1.0) for e in (error, scale))
    sigma = np.sqrt(error**2 + own**2 + scale**2)
    excess = (mean - reference**2) / max(sigma, 1e-300)
    # a handful of values is not normal: chi-squared says what chance gives
    excess = min(excess, -float(ndtri(chdtrc(freedom, freedom * mean / reference**2))))
    return float(np.sqrt(mean)) / reference, float(excess), reference, source


def inputs(system: System) -> dict[str, tuple[Array, tuple[float, ...]]]:
    """Return what residuals might follow: name -> (N, p) values and kernel widths."""
    def stacked(name: str) -> Array:
        return np.concatenate([np.asarray(getattr(p.response.rows, name)).reshape(
            p.at.stop - p.at.start, -1) for p in system.firsts])

    pose = pose_vector(np.concatenate([p.response.pose for p in system.firsts]))
    travel = np.concatenate([p.setting.travel for p in system.firsts])
    mechanism = system.problem.mechanism
    places = [c for c in mechanism.dof if c < 3]
    turns = [c for c in mechanism.dof if c >= 3]
    wide, fine, slow = (0.6, 1.5), (0.25, 1.0), (0.1, 0.5)
    out = {"position": (pose[:, places], wide)}
    if turns:
        out["rotation"] = (pose[:, turns], wide)
    out |= {name: (travel[:, [a]], fine) for a, name in enumerate(mechanism.actuators)}
    out |= {"direction": (stacked("approach"), wide), "velocity": (stacked("velocity"), wide),
            "temperature": (stacked("temperature"), fine), "payload": (stacked("wrench"), fine)}
    order = np.arange(len(travel), dtype=float)[:, None]
    time = stacked("time")
    out["time"] = (time if np.isfinite(time).all() and np.ptp(time) > 0 else order, slow)
    out["previous move"] = (np.diff(travel, axis=0, prepend=travel[:1]), wide)
    return {n: (v[:, varies(v)], w) for n, (v, w) in out.items()
            if np.isfinite(v).all() and varies(v).any()}


def varies(values: Array) -> NDArray[np.bool_]:
    """Return which columns (N, p) change by more than round-off."""
    return np.asarray(np.ptp(values, axis=0) > 1e-9 * np.max(np.abs(values), axis=0))


def kernel_test(stage: Stage, basis: Array, left: Array, seed: int
                ) -> tuple[dict[str, float], float, str]:
    """Return p by input, p over all inputs, and the input followed most."""
    rng = np.random.default_rng(seed)
    system = stage.system
    n, m = system.residual.shape
    draws = simulated(stage.noise, system, basis, left, DRAWS, rng)
    across = basis.T @ draws
    square = np.append(left @ left, squares(draws) - squares(across))
    some = np.sort(rng.permutation(n)[:MOST_ROWS])
    both = np.empty((some.size, m, DRAWS + 1))
    both[..., 0] = left.reshape(n, m)[some]
    both[..., 1:] = draws.reshape(n, m, -1)[some]
    both[..., 1:] -= basis.reshape(n, m, -1)[some] @ across
    both /= np.sqrt(square / (n * m))
    known = inputs(system)
    figures = _along([_kernel(values[some], widths) for values, widths in known.values()], both)
    p_values = {name: float(np.mean(figure >= figure[0]))
                for name, figure in zip(known, figures, strict=True)}
    tails = [_tail(figure) for figure in figures]
    table = np.stack(tails)
    smallest = table.min(axis=0)
    p = float(np.mean(smallest <= smallest[0]))
    return p_values, p, list(p_values)[int(np.argmin(table[:, 0]))]


def _along(kernels: Sequence[Array], values: Array) -> Array:
    """Return v^T K v (k, B) over the rows of values (N, m, B), for centred kernels K (N, N).

    Without K's diagonal: a row's likeness to itself says nothing of its neighbours. Kernels of one
    input or two are of low rank.
    """
    flat = values.reshape(len(values), -1)
    roots = [low_rank(kernel, len(kernel) // 2) for kernel in kernels]
    own = np.array([np.diagonal(kernel) for kernel in kernels])
    out = np.empty((len(kernels), flat.shape[1]))
    for begin in range(0, flat.shape[1], COLUMNS):
        some = flat[:, begin:begin + COLUMNS]
        square = out[:, begin:begin + COLUMNS]
        for n, (root, kernel) in enumerate(zip(roots, kernels, strict=True)):
            seen = some if root is None else root.T @ some
            np.einsum("nc,nc->c", seen, kernel @ some if root is None else seen, out=square[n])
        square -= own @ some**2
    return np.asarray(out.reshape(len(kernels), *values.shape[1:]).sum(axis=1))


def low_rank(matrix: Array, most: int) -> Array | None:
    """Return R (n, r) with R R^T a positive matrix (n, n) to round-off; None beyond ``most``.

    Cholesky's factorisation with pivots, stopped where nothing is left (Higham 1990).
    """
    left = np.diagonal(matrix).copy()
    least = LEAST_PIVOT * float(left.sum())
    root = np.zeros((most, len(matrix)))
    for k in range(most):
        if left.sum() <= least:
            return root[:k].T
        at = int(np.argmax(left))
        row = (matrix[at] - root[:k, at] @ root[:k]) / np.sqrt(left[at])
        root[k] = row
        left = np.maximum(left - row**2, 0.0)
    return None


def _tail(figure: Array) -> Array:
    """Return how rarely noise exceeds each figure (B,); the first is of the data.

    A gamma distribution with the noise's mean, variance and skewness. Ranks among the draws
    would not do: over a dozen inputs a dozen draws are first in one, and p over all inputs
    could not fall below a dozen in B, whatever the data follow.
    """
    noise = figure[1:]
    sigma = float(noise.std()) or 1.0
    x = (figure - noise.mean()) / sigma
    skew = max(float(np.mean(x[1:] ** 3)), LEAST_SKEW)
    shape = 4.0 / skew**2
    return np.asarray(gammaincc(shape, np.maximum(shape + x * np.sqrt(shape), 0.0)))


def _kernel(values: Array, widths: tuple[float, ...]) -> Array:
    """Return the centred kernel (N, N) of standardised inputs, summed over widths."""
    sigma = values.std(axis=0)
    x = (values - values.mean(axis=0)) / np.where(sigma > 0.0, sigma, 1.0)
    square = np.sum(x**2, axis=1)
    apart = np.maximum(square[:, None] + square[None, :] - 2.0 * x @ x.T, 0.0) / x.shape[1]
    kernel = sum((np.exp(-apart / (2.0 * w * w)) for w in widths), np.zeros_like(apart))
    kernel = kernel - kernel.mean(axis=0)
    return np.asarray(kernel - kernel.mean(axis=1, keepdims=True))
