"""Blocks together, against sums over all their sizes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers.dense import density, summed
from helpers.odds import odds
from scipy.special import logsumexp

from ppmcal.inference.blocks import Block, batches
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.evidence import total
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import _System as system
from ppmcal.inference.joint import coefficients, joint, joint_of_each, taken_blocks
from ppmcal.inference.ranges import SIZES
from ppmcal.linalg import Array


def drawn(seed: int) -> Conditioned:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(80, 7)) * rng.uniform(0.1, 20.0, 7)
    matrix[:, 1] += 0.5 * matrix[:, 0] * np.std(matrix[:, 1]) / np.std(matrix[:, 0])
    values = rng.normal(size=80) + matrix[:, 0] / np.std(matrix[:, 0]) + (
        0.7 * matrix[:, 1] / np.std(matrix[:, 1]))
    return Conditioned.nothing(MatrixColumns(matrix), values).taking(4.0 * matrix[:, 5:])


def test_one_block_is_as_likely_as_its_odds_say() -> None:
    given = drawn(0)
    for block in (Block("", "", (0,), 0.0), Block("", "", (2, 3), 0.0),
                  Block("", "", (0, 3), 0.0, roots=(np.eye(2), np.diag([0.1, 2.0])))):
        batch, = batches([block], given.columns, 80)
        assert joint(given, [block]).log_evidence - given.log_evidence == pytest.approx(
            total(odds(given, batch))[0], abs=1e-9)


@pytest.mark.parametrize("roots", [(), (np.eye(2), np.diag([0.1, 2.0]), np.array([
    [1.0, 0.0], [1.0, 0.0]]))])
def test_coefficients_are_those_of_all_sizes_and_roots(roots: tuple[Array, ...]) -> None:
    """Mean and covariance of the mixture, each part a Gaussian of its own, by dense matrices."""
    given, block = drawn(3), Block("", "", (0, 3), 0.0, roots)
    geometry, columns = 4.0 * given.columns.some([5, 6]), given.columns.some(block.columns)
    past = np.linalg.inv(np.eye(80) + geometry @ geometry.T)
    log_p, means, squares = [], [], []
    for root in block.own_roots(columns.T @ columns, 80):
        for size in SIZES:
            along = columns @ root * size
            narrow = np.linalg.inv(np.eye(root.shape[1]) + along.T @ past @ along)
            mean = size * root @ narrow @ along.T @ past @ given.values
            left = given.values @ past @ (given.values - columns @ mean)
            log_p.append(0.5 * np.linalg.slogdet(narrow)[1] - 0.5 * (given.known + 80.0) * np.log(
                given.known + left))
            means.append(mean)
            squares.append((given.known + left) / (given.known + 80.0) * size**2
                           * root @ narrow @ root.T + np.outer(mean, mean))
    share = np.exp(np.array(log_p) - logsumexp(log_p))
    mean, covariance = coefficients(given, block)
    wanted = share @ np.array(means)
    np.testing.assert_allclose(mean, wanted, rtol=1e-6)
    np.testing.assert_allclose(covariance, np.tensordot(share, squares, 1) - np.outer(
        wanted, wanted), rtol=1e-5, atol=1e-9 * np.abs(wanted).max() ** 2)


PAIRS = (
    (Block("", "", (0,), 0.0), Block("", "", (1, 2), 0.0)),
    (Block("", "", (0, 1), 0.0), Block("", "", (2,), 0.0,
                                       roots=(np.array([[0.05]]), np.array([[2.0]])))),
    (Block("", "", (3,), 0.0), Block("", "", (4,), 0.0)),
)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("seed", [1, 2])
def test_two_blocks_are_as_likely_as_the_sum_over_their_sizes(
        pair: tuple[Block, Block], seed: int) -> None:
    given = drawn(seed)
    geometry = 4.0 * given.columns.some([5, 6])
    without = np.eye(80) + geometry @ geometry.T
    brute = (summed(given.values, without, given.columns.some(range(7)), pair)
             - density(given.values, without))
    found = joint(given, pair).log_evidence
    assert found - given.log_evidence == pytest.approx(brute, abs=0.1)
    assert joint(given, pair[::-1]).log_evidence == pytest.approx(found, abs=1e-9)


@pytest.mark.slow
def test_three_blocks_are_as_likely_as_the_sum_over_their_sizes() -> None:
    rng = np.random.default_rng(5)
    matrix = rng.normal(size=(12, 3))
    values = rng.normal(size=12) + matrix @ [2.0, 0.7, 0.0]
    given = Conditioned.nothing(MatrixColumns(matrix), values)
    three = [Block("", "", (i,), 0.0) for i in range(3)]
    brute = summed(values, np.eye(12), matrix, three) - density(values, np.eye(12))
    assert joint(given, three).log_evidence - given.log_evidence == pytest.approx(brute, abs=0.2)


@pytest.mark.slow
def test_a_block_that_stands_twice_is_hardly_likelier_or_less_than_once() -> None:
    """Two of the same share their size: the ridge of sums is more than one size each at its best.

    What one size at its best and the others around it leave out of the ridge is log 2 at most.
    """
    rng = np.random.default_rng(6)
    column = rng.normal(size=(80, 1))
    matrix = np.hstack([column, column])
    for size in (0.0, 0.5, 5.0):
        values = rng.normal(size=80) + size * column[:, 0]
        given = Conditioned.nothing(MatrixColumns(matrix), values)
        both = [Block("", "", (0,), 0.0), Block("", "", (1,), 0.0)]
        brute = summed(values, np.eye(80), matrix, both) - density(values, np.eye(80))
        found = joint(given, both).log_evidence - given.log_evidence
        assert -np.log(2.0) < found - brute < 0.1


@pytest.mark.parametrize(("low", "high"), [(0.0, np.inf), (-np.inf, 0.0), (0.3, 0.9)])
def test_a_range_beside_another_block_is_that_of_the_sum_over_the_others_sizes(
        low: float, high: float) -> None:
    given = drawn(4)
    length = np.std(given.columns.some([1])[:, 0])
    ranged = Block("", "", (1,), 0.0, low=low / length, high=high / length)
    other = Block("", "", (0,), 0.0)
    one, = batches([other], given.columns, 80)
    every = []
    for size in SIZES:
        with_it = given.taking(size * given.columns.some([0]) @ one.roots[0, 0])
        two, = batches([ranged], given.columns, 80)
        every.append(with_it.log_evidence + total(odds(with_it, two))[0])
    brute = float(logsumexp(every)) - np.log(len(SIZES))
    for order in ([ranged, other], [other, ranged]):
        assert joint(given, order).log_evidence == pytest.approx(brute, abs=0.1)


def test_nothing_is_asked_twice_of_a_block_beside_the_same_others(
        monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[object, ...]] = []
    as_it_is = system.along
    monkeypatch.setattr(system, "along", lambda self, k, sizes, grid: (asked.append(
        (k, *np.delete(sizes[0], k), *np.delete(grid[0], k))), as_it_is(self, k, sizes, grid))[1])
    for blocks in ([Block("", "", (0,), 0.0)], PAIRS[0]):
        asked.clear()
        joint(drawn(1), blocks)
        assert len(asked) == len(set(asked))


def test_what_is_taken_is_what_was_chosen() -> None:
    given = drawn(4)
    blocks = [Block("", "", (0,), 0.0), Block("", "", (1,), 0.0)]
    both = joint(given, blocks)
    block = taken_blocks(given, blocks, both.sizes, both.grid)
    taken = given.taking(block)
    assert block.shape == (80, 2)
    # sizes are integrated, so that less is there than where they are largest
    assert taken.log_evidence - 2 * np.log(len(SIZES)) < both.log_evidence < taken.log_evidence
    assert np.abs(taken.right[:2]).max() < 0.2 * np.abs(given.right[:2]).max()


def test_a_wide_block_that_is_worked_out_apart_changes_nothing(monkeypatch: pytest.MonkeyPatch
                                                               ) -> None:
    """For each correlation, with sizes on the way to the likeliest that move it."""
    rng, widths = np.random.default_rng(5), [5, 40, 1, 24]
    columns = rng.normal(size=(120, sum(widths)))
    values = columns[:, :45] @ rng.normal(0.0, 0.3, 45) + rng.normal(size=120)
    ends = np.cumsum([0, *widths]).tolist()
    blocks = [Block(f"b{n}", f"f{n}", tuple(range(*own)), 0.0)
              for n, own in enumerate(pairwise(ends))]
    given = [Conditioned.nothing(MatrixColumns(columns), scale * values) for scale in (1.0, 1.3)]
    whole = joint_of_each(given, [blocks, blocks])
    monkeypatch.setattr("ppmcal.inference.joint.WIDEST", 8)
    for one, apart in zip(whole, joint_of_each(given, [blocks, blocks]), strict=True):
        assert apart.log_evidence == pytest.approx(one.log_evidence, abs=1e-6)
        assert np.array_equal(apart.sizes, one.sizes)
        np.testing.assert_allclose(apart.without, one.without, atol=1e-6)
