"""How likely a row belongs: against quadrature, and what it must not depend on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gammaln, logsumexp

from ppmcal.inference.priors import GROSS_ROW, NO_WEIGHT
from ppmcal.inference.row_weights import BEYOND_NOISE, improbability, log_ratio, row_weights

FREEDOM = 40.0


def by_quadrature(square: float, values: int, size: float) -> float:
    """The logarithm of a density, the noise's variance integrated: scaled inverse chi-squared."""
    v = np.geomspace(0.05, 500.0, 20_001)
    half = 0.5 * FREEDOM
    prior = half * np.log(half) - gammaln(half) - (half + 1.0) * np.log(v) - half / v
    own = v * (1.0 + size**2)
    density = -0.5 * values * np.log(2.0 * np.pi * own) - 0.5 * square / own
    return float(logsumexp(prior + density + np.log(v)) + np.log(np.log(v[1] / v[0])))


@pytest.mark.parametrize("values", [1, 3, 6])
@pytest.mark.parametrize("square", [0.0, 4.0, 30.0, 400.0])
def test_the_ratio_is_that_of_both_integrals(square: float, values: int) -> None:
    gross = logsumexp([by_quadrature(square, values, s) for s in BEYOND_NOISE])
    expected = gross - np.log(BEYOND_NOISE.size) - by_quadrature(square, values, 0.0)
    found = log_ratio(np.array([square]), np.array([float(values)]), FREEDOM)[0]
    assert found == pytest.approx(expected, abs=1e-6)


def rows(seed: int, count: int, values: int = 3) -> np.ndarray:
    return np.sum(np.random.default_rng(seed).normal(size=(count, values)) ** 2, axis=1)


def weights(square: np.ndarray, values: int = 3) -> np.ndarray:
    size = np.full(square.size, float(values))
    return row_weights(square, size, 30.0 + size.sum(), square.size)


@pytest.mark.parametrize(("count", "values"), [(20, 1), (60, 3), (60, 6), (2000, 6)])
@pytest.mark.slow_cases("2000-6")
def test_noise_keeps_its_weight(count: int, values: int) -> None:
    """Of two hundred campaigns without a gross error hardly any leaves a row out."""
    found = [weights(rows(seed, count, values), values) for seed in range(200)]
    assert sum(bool((w < float(NO_WEIGHT)).any()) for w in found) <= 4
    assert np.mean([w.mean() for w in found]) > 0.995


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2])
def test_gross_rows_lose_theirs_however_many_they_are(share: float) -> None:
    square = rows(1, 200)
    gross = np.arange(200) < 200 * share
    square[gross] += np.random.default_rng(2).uniform(8.0, 300.0, gross.sum()) ** 2
    found = weights(square)
    assert (found[gross] < float(NO_WEIGHT)).all() and (found[~gross] > 0.5).all()


def test_the_more_rows_belong_the_surer_does_one_more() -> None:
    """With no row seen it is one in a hundred that does not."""
    one, three = np.array([25.0]), np.array([3.0])
    found = [float(row_weights(one, three, 1e6, n)[0]) for n in (0, 1000, 100_000)]
    assert found[0] < found[1] < found[2]
    gross, none = (float(np.exp(log_ratio(d, three, 1e6))[0]) for d in (one, 0.0 * one))
    odds = 1.0 / float(GROSS_ROW) - 1.0
    assert found[0] == pytest.approx((odds + none) / (odds + gross))


def test_what_a_row_weighs_falls_with_its_distance_and_is_whole_at_none() -> None:
    square = np.linspace(0.0, 200.0, 2001)
    found = weights(square)
    assert found[0] == 1.0 and (np.diff(found) < 0.0).all()


def test_the_order_of_rows_is_nothing() -> None:
    square, turn = rows(3, 100), np.random.default_rng(4).permutation(100)
    square[7] = 40.0
    np.testing.assert_allclose(weights(square)[turn], weights(square[turn]), rtol=1e-12)


def test_a_row_that_is_far_off_adds_little_more_than_one_that_is_farther() -> None:
    """What decides between two starts: near the noise chi-squared, far from it a logarithm."""
    found = improbability(np.array([0.0, 1.0, 1e4, 1e6]), np.full(4, 3.0))
    assert found[1] - found[0] == pytest.approx(1.0, abs=0.15)
    assert 0.0 < found[3] - found[2] < 0.01 * 1e4
    assert found[2] - found[0] > 2.0 * -np.log(float(GROSS_ROW))
