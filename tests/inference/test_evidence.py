"""The evidence of blocks, against integrals made by brute force, and facts that any has."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, special, stats

from ppmcal.inference.blocks import Block, batches
from ppmcal.inference.columns import JoinedColumns, MatrixColumns
from ppmcal.inference.evidence import SIZES, odds_of_all
from ppmcal.inference.evidence import odds as odds_of_batch
from ppmcal.inference.given import Conditioned
from ppmcal.inference.priors import NOISE_FREEDOM

ROWS = 40
NU = float(NOISE_FREEDOM)


def drawn(columns: int, seed: int = 0, effect: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return columns (n, T) of unlike lengths, and values (n,) with some of the first in them."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(ROWS, columns)) * rng.uniform(0.1, 20.0, columns)
    values = rng.normal(size=ROWS) + effect * matrix[:, 0] / np.std(matrix[:, 0])
    return matrix, values


def odds(given: Conditioned, blocks: list[Block]) -> np.ndarray:
    return odds_of_all(given, batches(blocks, given.columns, given.values.size), len(blocks))


def density(values: np.ndarray, covariance: np.ndarray) -> float:
    """Return the log density of values ~ N(0, s^2 C), the scale s^2 integrated numerically."""
    _, log_det = np.linalg.slogdet(covariance)
    square = float(values @ np.linalg.solve(covariance, values))
    n = values.size

    def integrand(log_s: float) -> float:
        s2 = np.exp(2.0 * log_s)
        prior = stats.chi2(NU).logpdf(NU / s2) + np.log(NU / s2) + np.log(2.0)
        return float(np.exp(prior - 0.5 * (n * np.log(2 * np.pi * s2) + log_det + square / s2)
                            + 0.5 * square + 0.5 * n * np.log(2 * np.pi)))

    whole = integrate.quad(integrand, -2.0, 3.0, limit=400, epsabs=0.0)[0]
    return float(np.log(whole)) - 0.5 * square


@pytest.mark.parametrize("geometry", [0, 3])
@pytest.mark.parametrize("size", [1, 2, 5])
def test_odds_are_those_of_integrals_made_by_brute_force(geometry: int, size: int) -> None:
    matrix, values = drawn(8, seed=size, effect=0.5)
    nuisance = matrix[:, 8 - geometry:] * 3.0
    given = Conditioned.nothing(MatrixColumns(matrix), values).taking(nuisance)
    block = Block("", "", tuple(range(size)), 0.0)
    batch, = batches([block], given.columns, ROWS)
    found = odds_of_batch(given, batch)[0, 0]
    without = np.eye(ROWS) + nuisance @ nuisance.T
    part = matrix[:, :size] @ batch.roots[0, 0]
    base = density(values, without)
    for s in (0, 12, 20):
        brute = density(values, without + SIZES[s] ** 2 * part @ part.T) - base
        assert found[s] == pytest.approx(brute, abs=1e-5)


def test_a_root_makes_one_sigma_rms() -> None:
    matrix, values = drawn(4)
    given = Conditioned.nothing(MatrixColumns(matrix), values)
    batch, = batches([Block("", "", (0, 1, 2), 0.0)], given.columns, ROWS)
    made = matrix[:, :3] @ batch.roots[0, 0]
    assert np.sum(made**2) / ROWS == pytest.approx(1.0)


@pytest.mark.slow
def test_sign_and_range_are_those_of_the_integral_over_the_coefficient() -> None:
    matrix, values = drawn(1, effect=0.4)
    given = Conditioned.nothing(MatrixColumns(matrix), values)
    best = float(matrix[:, 0] @ values / (matrix[:, 0] @ matrix[:, 0]))
    for low, high in ((0.0, np.inf), (-np.inf, 0.0), (0.5 * best, 1.1 * best), (-best, 0.0)):
        block = Block("", "", (0,), 0.0, low=low, high=high)
        length = np.sqrt(np.mean(matrix[:, 0] ** 2))
        ends = np.clip([low, high], -400.0 / length, 400.0 / length)
        grid = np.linspace(*ends, 400_001)
        prior = np.mean([stats.norm.pdf(grid, scale=s / length) for s in SIZES], axis=0)
        inside = np.mean([np.diff(stats.norm.cdf([low, high], scale=s / length))[0] for s in SIZES])
        squares = (values @ values - 2 * grid * (matrix[:, 0] @ values)
                   + grid**2 * (matrix[:, 0] @ matrix[:, 0]))
        # with the noise's scale at its posterior, which n + nu0 values know
        log_likelihood = -0.5 * (NU + ROWS) * (np.log(NU + squares) - np.log(NU + values @ values))
        brute = np.log(integrate.trapezoid(prior * np.exp(log_likelihood), grid) / inside)
        assert odds(given, [block])[0] == pytest.approx(brute, abs=0.15)


def test_units_and_order_of_columns_and_rows_do_not_matter() -> None:
    matrix, values = drawn(6, effect=1.0)
    nuisance = matrix[:, 4:]

    def found(columns: np.ndarray, y: np.ndarray, other: np.ndarray, factor: float) -> np.ndarray:
        given = Conditioned.nothing(MatrixColumns(columns), y).taking(other)
        return odds(given, [Block("", "", (0,), 0.0, low=0.0, high=2.0 / factor),
                            Block("", "", (1, 2), 0.0)])

    plain = found(matrix, values, nuisance, 1.0)
    assert found(matrix * 1e4, values, nuisance, 1e4) == pytest.approx(plain, abs=1e-7)
    order = np.random.default_rng(1).permutation(ROWS)
    assert found(matrix[order], values[order], nuisance[order][:, ::-1], 1.0) == pytest.approx(
        plain, abs=1e-7)
    swapped = matrix[:, [0, 2, 1, 3]]
    assert found(swapped, values, nuisance, 1.0) == pytest.approx(plain, abs=1e-7)


def test_what_is_taken_together_is_taken_one_after_the_other() -> None:
    matrix, values = drawn(7, effect=1.0)
    plain = Conditioned.nothing(MatrixColumns(matrix), values)
    at_once = plain.taking(matrix[:, :4])
    in_turn = plain.taking(matrix[:, :1]).taking(matrix[:, 1:3]).taking(matrix[:, 3:4])
    assert in_turn.log_evidence == pytest.approx(at_once.log_evidence, abs=1e-9)
    assert in_turn.right == pytest.approx(at_once.right, abs=1e-8)
    blocks = [Block("", "", (5,), 0.0), Block("", "", (5, 6), 0.0)]
    assert odds(in_turn, blocks) == pytest.approx(odds(at_once, blocks), abs=1e-9)


def test_a_taken_block_adds_what_its_odds_say() -> None:
    matrix, values = drawn(5, effect=1.0)
    given = Conditioned.nothing(MatrixColumns(matrix), values).taking(5.0 * matrix[:, 3:])
    batch, = batches([Block("", "", (0, 1), 0.0)], given.columns, ROWS)
    seen = odds_of_batch(given, batch)
    for s in (3, 15, 30):
        with_it = given.taking(SIZES[s] * matrix[:, :2] @ batch.roots[0, 0])
        assert with_it.log_evidence - given.log_evidence == pytest.approx(
            seen[0, 0, s], abs=1e-8)


def test_what_geometry_does_as_well_is_not_in_the_data() -> None:
    matrix, values = drawn(4, effect=5.0)
    given = Conditioned.nothing(MatrixColumns(np.column_stack([matrix, matrix[:, 0]])), values)
    wide = given.taking(1e3 * matrix[:, :1])
    assert odds(given, [Block("", "", (4,), 0.0)])[0] > 20.0
    assert abs(odds(wide, [Block("", "", (4,), 0.0)])[0]) < 0.5


def test_a_column_of_nothing_says_nothing() -> None:
    matrix, values = drawn(2)
    matrix[:, 0] = 0.0
    given = Conditioned.nothing(MatrixColumns(matrix), values)
    assert odds(given, [Block("", "", (0,), 0.0), Block("", "", (0,), 0.0, low=0.0)]) == (
        pytest.approx([0.0, 0.0], abs=1e-9))


def test_joined_columns_are_those_of_each() -> None:
    matrix, values = drawn(6)
    both = JoinedColumns((MatrixColumns(matrix[:, :2]), MatrixColumns(matrix[:, 2:])))
    which = [5, 0, 2, 1]
    assert both.count == 6
    assert np.array_equal(both.some(which), matrix[:, which])
    assert both.along(values[:, None]) == pytest.approx(matrix.T @ values[:, None])


def test_odds_against_nothing_keep_to_their_bound_where_nothing_is() -> None:
    """Markov: with prior odds of one, odds of k come up in at most one of k empty data sets."""
    rng = np.random.default_rng(3)
    matrix, _ = drawn(30)
    blocks = [Block("", "", (i,), -np.log(30.0), low=0.0 if i % 2 else -np.inf) for i in range(30)]
    sets = batches(blocks, MatrixColumns(matrix), ROWS)
    prior = np.array([b.log_prior for b in blocks])
    totals = []
    for _ in range(400):
        # the noise's scale as its prior has it
        scale = np.sqrt(NU / rng.chisquare(NU))
        given = Conditioned.nothing(MatrixColumns(matrix), scale * rng.normal(size=ROWS))
        totals.append(float(special.logsumexp(odds_of_all(given, sets, 30) + prior)))
    ratio = np.exp(totals)
    assert np.mean(ratio > 19.0) <= 1 / 19 + 3 * np.sqrt(1 / 19 / 400)
