"""Noise that is correlated from row to row, against its whole covariance."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.dense import density, summed
from scipy.special import logsumexp

from ppmcal.inference.block_sets import state
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.correlation import RowNoise, Whitened
from ppmcal.inference.priors import CORRELATIONS
from ppmcal.inference.question import Question

ROWS, WIDTH = 12, 2


def tied(share: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return steps (N - 1,) with a gap and another sequence, and what is observed (N, m)."""
    apart = np.ones(ROWS - 1, dtype=np.int64)
    apart[3], apart[7] = 2, 0
    return apart, np.random.default_rng(seed).uniform(size=(ROWS, WIDTH)) < share


def covariance(rho: float, apart: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Return the correlation of all values that were observed, by how far rows are apart."""
    place = np.concatenate([[0], np.cumsum(apart)])
    sequence = np.concatenate([[0], np.cumsum(apart == 0)])
    rows = np.where(sequence[:, None] == sequence, rho ** np.abs(place[:, None] - place), 0.0)
    there = observed.ravel()
    return np.kron(rows, np.eye(WIDTH))[np.ix_(there, there)]


@pytest.mark.parametrize("rho", CORRELATIONS)
@pytest.mark.parametrize("share", [1.0, 0.7, 0.3])
def test_white_values_have_the_density_of_their_correlation(rho: float, share: float) -> None:
    apart, observed = tied(share)
    noise, whole = RowNoise(rho, apart, observed), covariance(rho, apart, observed)
    values = np.where(observed.ravel(), np.random.default_rng(1).normal(size=observed.size), 0.0)
    white = noise.apply(values[:, None])[:, 0]
    seen = values[observed.ravel()]
    assert white @ white == pytest.approx(seen @ np.linalg.solve(whole, seen))
    assert noise.log_det == pytest.approx(0.5 * np.linalg.slogdet(whole)[1])
    assert not white[~observed.ravel()].any()


def test_products_with_white_columns_are_those_of_the_columns() -> None:
    apart, observed = tied(0.6)
    rng = np.random.default_rng(2)
    matrix = rng.normal(size=(observed.size, 100)) * observed.reshape(-1, 1)
    columns = Whitened(MatrixColumns(matrix), RowNoise(0.8, apart, observed))
    values = rng.normal(size=(observed.size, 3))
    assert columns.along(values) == pytest.approx(columns.some(range(100)).T @ values)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_a_set_has_the_density_of_all_correlations_together(share: float) -> None:
    apart, observed = tied(share, 3)
    rng = np.random.default_rng(4)
    there = observed.ravel()
    matrix = rng.normal(size=(observed.size, 3)) * there[:, None]
    geometry = 3.0 * rng.normal(size=(observed.size, 2)) * there[:, None]
    values = (rng.normal(size=observed.size) + matrix[:, 0]) * there
    blocks = tuple(Block(f"b{i}", f"b{i}", (i,), np.log(0.02)) for i in range(3))
    asked = Question(MatrixColumns(matrix), values, geometry, blocks, observed, apart)
    rhos = (0.0, *CORRELATIONS)
    for chosen in ((), (0,), (1, 2)):
        every = []
        for view, rho in zip(asked.views, rhos, strict=True):
            whole = covariance(rho, apart, observed)
            root = np.linalg.cholesky(whole)
            white, known, seen = (np.linalg.solve(root, part[there])
                                  for part in (values, geometry, matrix))
            log_z = summed(white, np.eye(white.size) + known @ known.T, seen,
                           [blocks[i] for i in chosen]) if chosen else (
                density(white, np.eye(white.size) + known @ known.T))
            prior = np.log(0.5) if rho == 0.0 else np.log(0.5 / len(CORRELATIONS))
            every.append(prior + log_z - float(np.sum(np.log(np.diagonal(root)))))
            assert view.log_prior == pytest.approx(prior - np.sum(np.log(np.diagonal(root))))
        brute = float(logsumexp(every))
        if not chosen:
            base, empty = brute, state(asked, ()).log_p
        found = state(asked, chosen).log_p - asked.log_prior(chosen) - empty
        assert found == pytest.approx(brute - base, abs=0.1 * (len(chosen) > 1) + 1e-7)
