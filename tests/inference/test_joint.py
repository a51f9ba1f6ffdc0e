"""Blocks together, against sums over all their sizes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp

from ppmcal.inference.blocks import Block, batches
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.evidence import SIZES, odds, total
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import joint


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


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_blocks_are_as_likely_as_the_sum_over_their_sizes(seed: int) -> None:
    given = drawn(seed)
    first, second = Block("", "", (0,), 0.0), Block("", "", (1, 2), 0.0)
    one, = batches([first], given.columns, 80)
    every = []
    for size in SIZES:
        with_it = given.taking(size * given.columns.some([0]) @ one.roots[0, 0])
        two, = batches([second], given.columns, 80)
        every.append(with_it.log_evidence + total(odds(with_it, two))[0])
    brute = float(logsumexp(every)) - np.log(len(SIZES))
    assert joint(given, [first, second]).log_evidence == pytest.approx(brute, abs=0.1)
    assert joint(given, [second, first]).log_evidence == pytest.approx(
        joint(given, [first, second]).log_evidence, abs=1e-9)


def test_what_is_taken_is_what_was_chosen() -> None:
    given = drawn(4)
    blocks = [Block("", "", (0,), 0.0), Block("", "", (1,), 0.0)]
    both = joint(given, blocks)
    taken = given.taking(both.taken)
    assert both.taken.shape == (80, 2)
    # sizes are integrated, so that less is there than where they are largest
    assert taken.log_evidence - 2 * np.log(len(SIZES)) < both.log_evidence < taken.log_evidence
    assert np.abs(taken.right[:2]).max() < 0.2 * np.abs(given.right[:2]).max()
