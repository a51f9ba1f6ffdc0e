"""Densities of values by whole covariances: what the evidence is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from ppmcal.inference.blocks import Block
from ppmcal.inference.priors import NOISE_FREEDOM
from ppmcal.inference.ranges import SIZES


def density(values: np.ndarray, covariance: np.ndarray,
            known: float = float(NOISE_FREEDOM)) -> float:
    """Return the log density of values (n,) ~ N(0, s^2 C), s^2 about 1 as its prior has it.

    Chi-squared noise integrated makes Student's t of the prior's degrees of freedom.
    """
    student = multivariate_t(np.zeros(values.size), covariance, known)
    return float(student.logpdf(values))


def roots_of(block: Block, matrix: np.ndarray, count: int) -> list[np.ndarray]:
    """Return a block's roots (k, q): its own, or those of one sigma rms."""
    if block.roots:
        return list(block.roots)
    own = matrix[:, list(block.columns)]
    length = np.sqrt(np.sum(own**2, axis=0) / count)
    safe = np.where(length > 0.0, length, 1.0)
    return [np.diag((length > 0.0) / safe) / np.sqrt(len(length))]


def summed(values: np.ndarray, without: np.ndarray, matrix: np.ndarray,
           blocks: Sequence[Block]) -> float:
    """Return the log density with blocks, summed over all their sizes and roots one by one.

    ``without`` (n, n): covariance without them, of noise and geometry. Ranges are not asked.
    """
    parts = []
    for block in blocks:
        own = matrix[:, list(block.columns)]
        shapes = [own @ root @ root.T @ own.T
                  for root in roots_of(block, matrix, values.size)]
        parts.append([size**2 * shape for shape in shapes for size in SIZES])
    every = []
    nu, n = float(NOISE_FREEDOM), values.size
    for some in product(*parts[:-1]):
        whole = np.array([without + sum(some, np.zeros_like(without)) + last
                          for last in parts[-1]])
        _, log_det = np.linalg.slogdet(whole)
        square = np.linalg.solve(whole, np.broadcast_to(values[:, None], (len(whole), n, 1)))
        every.append(-0.5 * log_det - 0.5 * (nu + n) * np.log1p(values @ square[..., 0].T / nu))
    base = density(values, without)
    _, log_det = np.linalg.slogdet(without)
    same = -0.5 * log_det - 0.5 * (nu + n) * np.log1p(
        float(values @ np.linalg.solve(without, values)) / nu)
    return base - same + float(logsumexp(every)) - float(np.log(np.concatenate(every).size))
