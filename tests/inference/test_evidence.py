"""The evidence of blocks, against integrals made by brute force, and facts that any has."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from helpers.dense import density, summed
from helpers.odds import odds as odds_of_batch
from helpers.odds import odds_of_all
from scipy import integrate, special, stats

from ppmcal.inference.blocks import Block, batches
from ppmcal.inference.columns import JoinedColumns, MatrixColumns
from ppmcal.inference.evidence import odds_of_narrow, odds_of_wide
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import joint
from ppmcal.inference.priors import NOISE_FREEDOM, OWN_NOISE_FREEDOM
from ppmcal.inference.ranges import SIZES, all_between, student, together_between

ROWS = 40
NU = float(NOISE_FREEDOM)


def drawn(columns: int, seed: int = 0, effect: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return columns (n, T) of unlike lengths, and values (n,) with some of the first in them."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(ROWS, columns)) * rng.uniform(0.1, 20.0, columns)
    values = rng.normal(size=ROWS) + effect * matrix[:, 0] / np.std(matrix[:, 0])
    return matrix, values


def odds(given: Conditioned, blocks: list[Block]) -> np.ndarray:
    return odds_of_all(given, batches(blocks, given.columns, given.values.size, given.known),
                       len(blocks))


OWN = float(OWN_NOISE_FREEDOM)


@pytest.mark.parametrize("known", [NU, OWN])
@pytest.mark.parametrize("geometry", [0, 3])
@pytest.mark.parametrize("size", [1, 2, 5])
def test_odds_are_those_of_whole_covariances(geometry: int, size: int, known: float) -> None:
    matrix, values = drawn(8, seed=size, effect=0.5)
    nuisance = matrix[:, 8 - geometry:] * 3.0
    given = Conditioned.nothing(MatrixColumns(matrix), values, known=known).taking(nuisance)
    block = Block("", "", tuple(range(size)), 0.0)
    batch, = batches([block], given.columns, ROWS)
    found = odds_of_batch(given, batch)[0, 0]
    without = np.eye(ROWS) + nuisance @ nuisance.T
    part = matrix[:, :size] @ batch.roots[0, 0]
    base = density(values, without, known)
    for s in (0, 12, 20, 33):
        brute = density(values, without + SIZES[s] ** 2 * part @ part.T, known) - base
        assert found[s] == pytest.approx(brute, abs=1e-7)


def test_a_root_makes_one_sigma_rms() -> None:
    matrix, values = drawn(4)
    given = Conditioned.nothing(MatrixColumns(matrix), values)
    batch, = batches([Block("", "", (0, 1, 2), 0.0)], given.columns, ROWS)
    made = matrix[:, :3] @ batch.roots[0, 0]
    assert np.sum(made**2) / ROWS == pytest.approx(1.0)


@pytest.mark.slow
def test_noise_of_any_scale_makes_students_density() -> None:
    """The density that all else is compared with, against the integral over s^2."""
    matrix, values = drawn(4)
    covariance = np.eye(ROWS) + matrix @ matrix.T

    def integrand(log_s: float) -> float:
        s2 = np.exp(2.0 * log_s)
        prior = stats.chi2(NU).logpdf(NU / s2) + np.log(NU / s2) + np.log(2.0)
        normal = stats.multivariate_normal(np.zeros(ROWS), s2 * covariance).logpdf(values)
        return float(np.exp(prior + normal - density(values, covariance)))

    assert integrate.quad(integrand, -2.0, 2.0)[0] == pytest.approx(1.0, abs=1e-7)


def test_what_is_taken_has_the_density_of_its_covariance() -> None:
    matrix, values = drawn(6, effect=2.0)
    constant = (special.gammaln(0.5 * (NU + ROWS)) - special.gammaln(0.5 * NU)
                - 0.5 * ROWS * np.log(np.pi) + 0.5 * NU * np.log(NU))
    given, covariance = Conditioned.nothing(MatrixColumns(matrix), values), np.eye(ROWS)
    for part in (30.0 * matrix[:, :3], 0.1 * matrix[:, 2:5], np.zeros((ROWS, 2)), matrix[:, 5:]):
        given, covariance = given.taking(part), covariance + part @ part.T
        assert given.log_evidence + constant == pytest.approx(density(values, covariance), abs=1e-7)


@pytest.mark.parametrize("geometry", [0, 2])
def test_roots_of_a_grid_are_summed_over(geometry: int) -> None:
    matrix, values = drawn(6, effect=0.6)
    nuisance = 5.0 * matrix[:, 6 - geometry:]
    given = Conditioned.nothing(MatrixColumns(matrix), values).taking(nuisance)
    roots = (np.array([[0.1], [0.0], [0.2]]), np.array([[0.0], [1.0], [0.1]]))
    without = np.eye(ROWS) + nuisance @ nuisance.T
    for block in (Block("", "", (0, 1, 2), 0.0, roots=roots), Block("", "", (0,), 0.0),
                  Block("", "", (0, 0, 3), 0.0)):
        brute = summed(values, without, matrix, [block]) - density(values, without)
        assert odds(given, [block])[0] == pytest.approx(brute, abs=1e-7)


def ranged(values: np.ndarray, without: np.ndarray, column: np.ndarray, low: float, high: float,
           roots: tuple[float, ...], known: float) -> float:
    """Return the log odds of a coefficient between two ends, by quadrature over it."""
    nu = known
    inverse = np.linalg.inv(without)
    own, mixed, rest = (float(a @ inverse @ b) for a, b in (
        (column, column), (column, values), (values, values)))
    inside, mass = [], []
    for scale in (s * r for r in roots for s in SIZES):
        mean = mixed / (own + scale**-2)
        width = np.sqrt((nu + rest) / (nu + values.size) / (own + scale**-2))
        ends = np.clip([low, high], mean - 60.0 * width, mean + 60.0 * width)
        grid = np.linspace(*ends, 20_001)
        square = rest - 2.0 * grid * mixed + grid**2 * (own + scale**-2)
        power = -0.5 * (nu + values.size + 1.0) * np.log1p(square / nu)
        base = -0.5 * (nu + values.size) * np.log1p(rest / nu)
        constant = (special.gammaln(0.5 * (nu + values.size + 1.0))
                    - special.gammaln(0.5 * (nu + values.size)) - 0.5 * np.log(np.pi * nu))
        inside.append(integrate.trapezoid(np.exp(constant + power - base), grid) / scale)
        mass.append(stats.t(nu).cdf(high / scale) - stats.t(nu).cdf(low / scale))
    return float(np.log(np.mean(inside) / np.mean(mass)))


@pytest.mark.long_cases(
    "30.0-roots0-2", "30.0-roots1-0", "30.0-roots1-2", "30.0-roots2-0", "5.0-roots0-0",
    "5.0-roots1-2", "5.0-roots2-0", "5.0-roots2-2")
@pytest.mark.slow
@pytest.mark.parametrize("geometry", [0, 2])
@pytest.mark.parametrize("roots", [(), (0.3, 2.0), (-0.5,)])
@pytest.mark.parametrize("known", [NU, OWN])
def test_sign_and_range_are_those_of_the_integral_over_the_coefficient(
        geometry: int, roots: tuple[float, ...], known: float) -> None:
    matrix, values = drawn(3, effect=0.4)
    nuisance = 2.0 * matrix[:, 3 - geometry:]
    without = np.eye(ROWS) + nuisance @ nuisance.T
    given = Conditioned.nothing(MatrixColumns(matrix), values, known=known).taking(nuisance)
    best = float(matrix[:, 0] @ values / (matrix[:, 0] @ matrix[:, 0]))
    each = tuple(abs(r) for r in roots) or (1.0 / np.sqrt(np.mean(matrix[:, 0] ** 2)),)
    for low, high in ((0.0, np.inf), (-np.inf, 0.0), (0.5 * best, 1.1 * best), (-best, 0.0),
                      (-np.inf, -0.1 * best), (2.0 * best, np.inf)):
        block = Block("", "", (0,), 0.0, low=low, high=high,
                      roots=tuple(np.array([[r]]) for r in roots))
        brute = ranged(values, without, matrix[:, 0], low, high, each, known)
        assert odds(given, [block])[0] == pytest.approx(brute, abs=1e-4), (low, high)
        assert joint(given, [block]).log_evidence - given.log_evidence == pytest.approx(
            odds(given, [block])[0], abs=1e-8)


@pytest.mark.parametrize(("lean", "within"), [(0.0, 0.02), (0.5, 0.25)])
@pytest.mark.parametrize("signs", [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)])
def test_several_coefficients_have_their_signs_as_in_drawn_machines(
        lean: float, within: float, signs: tuple[float, float]) -> None:
    """By draws from prior and posterior at each size; ``lean``: correlation of the columns."""
    matrix, values = drawn(3, seed=2)
    first = matrix[:, 0] / np.std(matrix[:, 0])
    second = matrix[:, 1] - first * (matrix[:, 1] @ first) / (first @ first)
    second = np.sqrt(1.0 - lean**2) * second / np.std(second) + lean * first
    columns = np.stack([first, second], axis=1)
    values = values + 0.3 * first + 0.2 * second
    given = Conditioned.nothing(MatrixColumns(columns), values)
    ends = (tuple(np.minimum(np.multiply(signs, np.inf), 0.0)),
            tuple(np.maximum(np.multiply(signs, np.inf), 0.0)))
    rng, parts, free = np.random.default_rng(0), [], Block("", "", (0, 1), 0.0)
    root = batches([free], given.columns, ROWS)[0].roots[0, 0]
    plain = odds_of_batch(given, batches([free], given.columns, ROWS)[0])[0, 0]
    for s, log_odds in zip(SIZES, plain, strict=True):
        block = s * columns @ root
        inverse = np.linalg.inv(np.eye(2) + block.T @ block)
        mean = inverse @ block.T @ values
        spread = (NU + values @ values - values @ block @ mean) / (NU + ROWS)
        z = rng.multivariate_normal(mean, spread * inverse, 20_000)
        parts.append(np.exp(log_odds) * np.mean(np.all(z @ root.T * signs > 0.0, axis=1)))
    found = odds(given, [Block("", "", (0, 1), 0.0, low=ends[0], high=ends[1])])[0]
    assert found == pytest.approx(np.log(np.mean(parts) / 0.25), abs=within)


def test_a_range_that_no_size_comes_to_is_not_in_the_data() -> None:
    """Beyond 1e4 times the largest size neither prior nor posterior has anything."""
    matrix, values = drawn(1, effect=1.0)
    given = Conditioned.nothing(MatrixColumns(matrix), values)
    far = 1e4 * SIZES[-1] / np.sqrt(np.mean(matrix[:, 0] ** 2))
    for low, high in ((far, 2.0 * far), (-2.0 * far, -far), (far, np.inf)):
        assert odds(given, [Block("", "", (0,), 0.0, low=low, high=high)])[0] < -100.0


def test_a_row_that_stands_twice_at_half_its_weight_is_that_row() -> None:
    matrix, values = drawn(6, effect=1.0)
    blocks = [Block("", "", (0,), 0.0, low=0.0), Block("", "", (1, 2), 0.0)]

    def found(weight: np.ndarray) -> tuple[float, np.ndarray, float]:
        rows = np.repeat(np.arange(ROWS), weight)
        root = 1.0 / np.sqrt(weight[rows])
        given = Conditioned.nothing(MatrixColumns(root[:, None] * matrix[rows]),
                                    root * values[rows], ROWS).taking(
            3.0 * root[:, None] * matrix[rows, 4:])
        return (given.log_evidence, odds_of_all(given, batches(blocks, given.columns, ROWS), 2),
                joint(given, blocks).log_evidence)

    plain = found(np.ones(ROWS, dtype=int))
    copied = found(np.random.default_rng(2).integers(1, 4, ROWS))
    for one, other in zip(plain, copied, strict=True):
        assert other == pytest.approx(one, abs=1e-8)


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


@pytest.mark.slow
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


def test_columns_that_are_asked_for_again_are_not_made_again(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Every correlation asks for the same in turn."""
    matrix, _ = drawn(4)
    joined, made = JoinedColumns((MatrixColumns(matrix[:, :2]), MatrixColumns(matrix[:, 2:]))), []
    as_it_is = MatrixColumns.some
    monkeypatch.setattr(MatrixColumns, "some", lambda self, which: (
        made.append(which), as_it_is(self, which))[1])
    for which in ((0, 3), (0, 3), (3, 0)):
        assert np.array_equal(joined.some(which), matrix[:, which])
    assert made == [[0], [1], [0], [1]]


@pytest.mark.parametrize("freedom", [NU, NU + 20.0, NU + 1000.0])
def test_students_t_is_that_of_tables(freedom: float) -> None:
    x = np.concatenate([np.linspace(-8.0, 8.0, 161), [-1e300, 1e300, -np.inf, np.inf]])
    assert student(freedom, x) == pytest.approx(special.stdtr(freedom, x), rel=1e-6)
    far = np.geomspace(8.0, 1e4, 20)
    known = np.maximum(special.stdtr(freedom, -far), 1e-300)
    assert np.log(np.maximum(student(freedom, -far), 1e-300)) == pytest.approx(
        np.log(known), rel=3e-3)


def test_several_coefficients_are_between_their_ends_at_once() -> None:
    """Six that look alike are hardly all above zero where some of them are found below."""
    off, apart = [], []
    for count, seed in itertools.product((2, 3, 6), range(6)):
        rng = np.random.default_rng([count, seed])
        spread = rng.normal(size=(count, count + 1))
        covariance = spread @ spread.T
        deviation = np.sqrt(np.diagonal(covariance))
        mean = 0.5 * rng.normal(size=count) * deviation
        high = np.where(np.arange(count) % 2 == 1, 2.0 * deviation, np.inf)
        drawn = rng.multivariate_normal(mean, covariance, size=100_000)
        inside = ((drawn > 0.0) & (drawn < high)).all(axis=1).mean()
        if inside > 1e-3:
            off.append(together_between(1e4, -mean, high - mean, covariance) - np.log(inside))
            apart.append(all_between(1e4, -mean, high - mean, deviation) - np.log(inside))
    assert len(off) > 10
    assert np.sqrt(np.mean(np.square(off))) < 0.5
    assert np.sqrt(np.mean(np.square(off))) < 0.5 * np.sqrt(np.mean(np.square(apart)))


def test_what_is_far_from_its_ends_has_a_small_finite_probability() -> None:
    far = together_between(100.0, np.array([50.0, 0.0]), np.full(2, np.inf),
                           np.array([[1.0, 0.99], [0.99, 1.0]]))
    assert np.isfinite(far)
    assert far < -100.0


@pytest.mark.parametrize("rank", [3, 12])
def test_odds_are_the_same_with_and_without_eigenvectors(rank: int) -> None:
    rng = np.random.default_rng(11)
    matrix = rng.normal(size=(ROWS, rank)) @ rng.normal(size=(4, 2, rank, 12))
    values = rng.normal(size=ROWS)
    given = Conditioned.nothing(MatrixColumns(matrix[0, 0]), values)
    square, right = np.swapaxes(matrix, 2, 3) @ matrix, values @ matrix
    right[0, 0] = 0.0
    np.testing.assert_allclose(odds_of_wide(given, square, right),
                               odds_of_narrow(given, square, right), atol=1e-5)
