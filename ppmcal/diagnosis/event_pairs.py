"""Slow noise, or a pair of events that looks like it?

A zero that is off for a while makes successive residuals alike, and no single step takes that
out: correlation estimated with it still there would whiten it away. Both are tried: noise with
any AR(1) coefficient against the same with the best pair of events besides, by their likelihoods.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ppmcal import linalg
from ppmcal.diagnosis.added_variable_test import log_p
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.linear_system import System, Whitening, plain, range_basis
from ppmcal.linalg import Array, unit_columns

LEVEL = float(np.log(0.01))
"""Log p, over all pairs that were tried, at which a pair is there and the noise is not slow."""
RHOS = np.linspace(0.0, 0.95, 20)
MOST_ONSETS = 150


def best_pair(system: System, library: Library, projected: Sequence[int], noise: Whitening
              ) -> list[int]:
    """Return the library's columns of two events that slow noise does not explain, or none.

    Args:
        system: rows with their residuals.
        library: columns of the hypotheses.
        projected: columns of the library that the noise is estimated free of.
        noise: the whitening found without a pair; its ``rho`` is not used.
    """
    white = replace(noise, rho=0.0)
    fixed = np.concatenate([system.jacobian, library.some(projected)], axis=-1)
    basis = range_basis(unit_columns(white.apply(fixed, system)))
    left = white.apply(system.residual[..., None], system)[:, 0]
    left = left - basis @ (basis.T @ left)
    tried, best = 0, (0.0, list[int]())
    for onsets in _places(library.hypotheses):
        columns = white.apply(library.some(onsets), system)
        pairs = np.array(list(combinations(range(len(onsets)), 2)), dtype=np.int64)
        tried += len(pairs)
        gain, pair = _strongest(unit_columns(columns - basis @ (basis.T @ columns)), left, pairs)
        if gain > best[0]:
            best = gain, [onsets[pair[0]], onsets[pair[1]]]
    if not best[1]:
        return []
    with_pair = np.concatenate([fixed, library.some(best[1])], axis=-1)
    before, rank = _likeliest(system, fixed, white)
    after, more = _likeliest(system, with_pair, white)
    freedom = system.count - rank - 1
    if more <= rank or freedom - (more - rank) < 2:
        return []
    # the likelihood's ratio, as the part of a sum of squares that would change it as much
    share = 1.0 - float(np.exp(min(after - before, 0.0) / system.count))
    value = float(log_p(np.array([share]), 1.0, more - rank, freedom)[0])
    return best[1] if value + np.log(tried) <= LEVEL else []


def _places(hypotheses: Sequence[Hypothesis]) -> list[list[int]]:
    """Return, by kind and joint, the columns of its onsets; events of one size only."""
    out: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for f in hypotheses:
        if f.effect is not None and f.effect.onset and f.size == 1:
            out.setdefault((f.family, f.on), []).append(f.columns[0])
    return [own for own in out.values() if 2 <= len(own) <= MOST_ONSETS]


def _strongest(columns: Array, left: Array, pairs: NDArray[np.int64]
               ) -> tuple[float, tuple[int, int]]:
    """Return what the best of pairs of unit columns (n, c) explains of ``left``, and the pair."""
    along, cosine = columns.T @ left, columns.T @ columns
    a, b, c = along[pairs[:, 0]], along[pairs[:, 1]], cosine[pairs[:, 0], pairs[:, 1]]
    free = 1.0 - c**2
    gain = np.where(free > 1e-6, (a**2 + b**2 - 2.0 * a * b * c) / np.maximum(free, 1e-6), 0.0)
    at = int(np.argmax(gain))
    return float(gain[at]), (int(pairs[at, 0]), int(pairs[at, 1]))


def _likeliest(system: System, columns: Array, white: Whitening) -> tuple[float, int]:
    """Return -2 log likelihood at the likeliest AR(1) coefficient, and the columns' rank."""
    plane = range_basis(unit_columns(white.apply(columns, system)))
    both = np.concatenate([plane, white.apply(system.residual[..., None], system)], axis=1)
    both = both.reshape(*system.residual.shape, -1)
    rows = plain(system)
    found = [_deviance(system, both, replace(rows, rho=float(r))) for r in RHOS]
    return min(found), plane.shape[1]


def _deviance(system: System, both: Array, noise: Whitening) -> float:
    """Return n log RSS + the sum of log(1 - rho^2gap) over values.

    ``both`` (N, m, r + 1): a basis, which no AR(1) makes ill-conditioned, and the residual.
    """
    seen = noise.apply(both, system)
    gram = seen.T @ seen
    square = float(gram[-1, -1] - gram[-1, :-1] @ linalg.solve(gram[:-1, :-1], gram[:-1, -1]))
    apart = system.apart
    tie = np.where(apart > 0, noise.rho ** np.maximum(apart, 1), 0.0)
    spread = float(np.sum(np.log(1.0 - tie**2) * system.observed[1:].sum(axis=1)))
    return system.count * float(np.log(max(square, 1e-300))) + spread
