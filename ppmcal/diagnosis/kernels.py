"""Kernels of unknown smooth functions: Gaussian processes with correlated nearby values."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Array
from ppmcal.model.effects.learned_curve import LearnedCurve, spline_basis

LENGTHS = (0.06, 0.12, 0.25, 0.5, 1.0)
"""Length scales of a kernel, as fractions of the input's range."""
FINER = (0.015, 0.03)
"""Length scales of finer functions."""
SECOND = 2.0
"""Length scale of the second of two inputs."""


def matern(nodes: Array, length: float) -> Array:
    """Return the Matern kernel (5/2) between nodes (n, n); ``length`` as a part of their range."""
    far = np.abs(nodes[:, None] - nodes[None, :]) / np.ptp(nodes)
    x = np.sqrt(5.0) * far / length
    return np.asarray((1.0 + x + x**2 / 3.0) * np.exp(-x))


def whole_kernels(curve: LearnedCurve) -> list[Array]:
    """Return the kernels (K, K) of a curve's values, by length, including main effects."""
    second = matern(curve.by_nodes, SECOND) if curve.by else np.ones((1, 1))
    return [np.asarray(np.kron(matern(curve.nodes, length), second)) for length in LENGTHS]


def product_kernels(nodes: Array, by: Array, x: Array, y: Array) -> list[Array]:
    """Return kernels (K, K), by length, of functions of two inputs without their main effects.

    ``nodes``, ``by``: of the first and the second; ``x``, ``y``: their values in the rows.
    """
    second, = beyond_mean([matern(by, SECOND)], by, y)
    return [np.asarray(np.kron(first, second)) for first in beyond_mean(
        [matern(nodes, length) for length in LENGTHS], nodes, x)]


def bends(x: Array, degree: int) -> Array:
    """Return the monomials (N, p) of one degree in the varying, standardised columns of x (N, c).

    >>> bends(np.array([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0]]), 2).shape
    (3, 1)
    """
    spread = np.std(x, axis=0)
    x = (x - np.mean(x, axis=0))[:, spread > 1e-9 * np.abs(x).max(initial=1e-9)]
    x = x / np.std(x, axis=0)
    out = [np.prod(x[:, some], axis=1)
           for some in map(list, combinations_with_replacement(range(x.shape[1]), degree))]
    return np.stack(out, axis=1) if out else np.zeros((len(x), 0))


def courses(wave: Array) -> list[Array]:
    """Return kernels (k, k) of half waves: smooth ones, by length, and a Wiener process."""
    smooth = [np.diag((1.0 + (length * wave) ** 2 / 5.0) ** -3.0) for length in LENGTHS]
    return [*smooth, np.diag(wave**-2.0)]


def roots(kernels: Sequence[Array], gram: Array, count: int) -> tuple[Array, ...]:
    """Return the roots (K, K) of kernels, each scaled to an effect of one sigma rms.

    ``gram`` (K, K): inner products of the columns; ``count``: number of measured values.
    """
    return tuple(_root(kernel) / np.sqrt(np.sum(gram * kernel) / count) for kernel in kernels)


def _root(kernel: Array) -> Array:
    """Return the root R (n, n) of a kernel R R' (n, n); each kernel is decomposed once."""
    return _roots(kernel.tobytes(), len(kernel))


@lru_cache(maxsize=256)
def _roots(kernel: bytes, size: int) -> Array:
    w, v = linalg.eigh(np.frombuffer(kernel).reshape(size, size))
    return np.asarray(v * np.sqrt(np.maximum(w, 0.0)))


def beyond_mean(kernels: Sequence[Array], nodes: Array, x: Array) -> list[Array]:
    """Return kernels of values at nodes (n, n) for functions whose mean over inputs x is 0."""
    mean = spline_basis(nodes, x[np.isfinite(x)]).mean(axis=0)
    along = [kernel @ mean for kernel in kernels]
    return [np.asarray(kernel - np.outer(a, a) / float(mean @ a))
            for kernel, a in zip(kernels, along, strict=True)]
