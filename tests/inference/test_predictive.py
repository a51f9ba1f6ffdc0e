"""Rows left out, against fits that are made without them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.special import gammaln

from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.given import Conditioned
from ppmcal.inference.predictive import averaged, predicted
from ppmcal.inference.priors import NOISE_FREEDOM

NU = float(NOISE_FREEDOM)


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    block = rng.normal(size=(50, 6)) * rng.uniform(0.1, 50.0, 6)
    return block, rng.normal(size=50) + block @ rng.normal(size=6)


@pytest.mark.parametrize("size", [1, 5, 10])
def test_a_group_is_predicted_as_a_fit_without_it_predicts(size: int) -> None:
    block, values = drawn(size)
    given = Conditioned.nothing(MatrixColumns(np.zeros((50, 1))), values).taking(block)
    group = np.arange(50) // size
    found = predicted(given, group)
    for g in range(50 // size):
        out, rest = group == g, group != g
        kept = block[rest]
        posterior = np.linalg.inv(np.eye(6) + kept.T @ kept)
        mean = posterior @ kept.T @ values[rest]
        left = values[rest] @ values[rest] - mean @ kept.T @ values[rest]
        freedom = NU + rest.sum()
        scale = (NU + left) / freedom
        covariance = np.eye(size) + block[out] @ posterior @ block[out].T
        assert found.error[out] == pytest.approx(values[out] - block[out] @ mean, abs=1e-7)
        assert found.spread[out] == pytest.approx(np.sqrt(scale * np.diagonal(covariance)))
        score = stats.multivariate_t(block[out] @ mean, scale * covariance, freedom).logpdf(
            values[out])
        assert found.log_score[g] == pytest.approx(score, abs=1e-7)


def test_values_in_turn_make_up_the_evidence() -> None:
    """The density of all values is the product of each given those before it."""
    block, values = drawn(3)
    columns = MatrixColumns(np.zeros((50, 1)))
    total = 0.0
    for n in range(1, 51):
        given = Conditioned.nothing(MatrixColumns(np.zeros((n, 1))), values[:n]).taking(block[:n])
        last = np.full(n, -1)
        last[-1] = 0
        total += float(predicted(given, last).log_score[0])
    whole = Conditioned.nothing(columns, values).taking(block)
    constant = (gammaln(0.5 * (NU + 50)) - gammaln(0.5 * NU) - 25 * np.log(np.pi)
                + 0.5 * NU * np.log(NU))
    assert total == pytest.approx(whole.log_evidence + constant, abs=1e-6)


def test_what_was_not_measured_is_not_predicted() -> None:
    block, values = drawn(4)
    group = np.arange(50) // 5
    group[7] = -1
    block[7], values[7] = 0.0, 0.0
    given = Conditioned.nothing(MatrixColumns(np.zeros((50, 1))), values, 49).taking(block)
    found = predicted(given, group)
    assert np.isnan(found.error[7]) and np.isfinite(np.delete(found.error, 7)).all()
    keep = np.delete(np.arange(50), 7)
    without = predicted(Conditioned.nothing(MatrixColumns(np.zeros((49, 1))), values[keep])
                        .taking(block[keep]), group[keep])
    assert found.log_score == pytest.approx(without.log_score, abs=1e-9)


@pytest.mark.slow
def test_errors_are_as_large_as_is_said() -> None:
    rng = np.random.default_rng(5)
    within = []
    for _ in range(200):
        block = rng.normal(size=(30, 6)) * 3.0
        scale = np.sqrt(NU / rng.chisquare(NU))
        values = scale * (rng.normal(size=30) + block @ rng.normal(size=6))
        given = Conditioned.nothing(MatrixColumns(np.zeros((30, 1))), values).taking(block)
        found = predicted(given, np.arange(30) // 5)
        freedom = NU + 25
        within.append(np.abs(found.error / found.spread) < stats.t(freedom).ppf(0.975))
    # 6000 values of 200 draws; those of a draw hang together, so that draws are counted
    share = np.mean(within, axis=1)
    assert np.mean(share) == pytest.approx(0.95, abs=4 * np.std(share) / np.sqrt(200))


def test_models_are_averaged_by_what_the_other_groups_say_of_them() -> None:
    """p(y_g | rest) = sum of p_h(y) / sum of p_h(rest), each a multivariate t density."""
    block, values = drawn(11)
    columns, group = MatrixColumns(np.zeros((50, 1))), np.arange(50) // 5
    blocks = [block[:, :2], block]
    models = [Conditioned.nothing(columns, values).taking(b) for b in blocks]
    found = averaged([(m.log_evidence, m) for m in models], group)
    for g in range(10):
        rest = group != g
        log_p = np.array([[stats.multivariate_t(
            np.zeros(own.sum()), np.eye(own.sum()) + b[own] @ b[own].T, NU).logpdf(values[own])
            for b in blocks] for own in (np.ones(50, dtype=bool), rest)])
        score = np.logaddexp(*log_p[0]) - np.logaddexp(*log_p[1])
        assert found.log_score[g] == pytest.approx(score, abs=1e-6)
        weight = np.exp(log_p[1] - np.logaddexp(*log_p[1]))
        error = sum(w * predicted(m, group).error[~rest]
                    for w, m in zip(weight, models, strict=True))
        assert found.square[g] == pytest.approx(np.sum(error**2))
    assert found.count.tolist() == [5] * 10


def test_a_value_in_no_group_is_in_no_score() -> None:
    block, values = drawn(4)
    given = Conditioned.nothing(MatrixColumns(np.zeros((50, 1))), values).taking(block)
    group = np.where(np.arange(50) < 10, -1, np.arange(50) // 10 - 1)
    found = averaged([(0.0, given)], group)
    assert found.count.tolist() == [10] * 4
    assert found.log_score == pytest.approx(predicted(given, group).log_score)


def test_a_frame_that_only_a_group_tells_of_is_no_error_of_its_prediction() -> None:
    """Two sessions, each with an offset of its own that nobody knew."""
    rng = np.random.default_rng(3)
    session = np.repeat([0, 1], 25)
    offsets = 1e3 * np.eye(2)[session]
    values = rng.normal(size=50) + offsets @ [0.4, -0.7]
    given = Conditioned.nothing(MatrixColumns(np.zeros((50, 1))), values).taking(offsets)
    found = averaged([(0.0, given)], session)
    own = [values[session == s] - values[session == s].mean() for s in (0, 1)]
    assert found.count.tolist() == [24, 24]
    assert found.square == pytest.approx([np.sum(v**2) for v in own], rel=1e-4)
