"""Two events at once: what all pairs explain, against least squares of each pair by itself."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from ppmcal.inference.block_sets import state
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.given import Conditioned
from ppmcal.inference.moves import SetSearch
from ppmcal.inference.pairs import Events
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior

COUNT = 60


def drawn(seed: int, widths: tuple[int, ...]) -> tuple[np.ndarray, list[Block]]:
    """Return columns (n, T), of scales that differ much, and events of so many columns each."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(COUNT, sum(widths))) * 10.0 ** rng.uniform(-6.0, 6.0, sum(widths))
    ends = np.cumsum([0, *widths])
    return matrix, [Block(f"e{n}", "e", tuple(range(ends[n], ends[n + 1])), -3.0, group="e")
                    for n in range(len(widths))]


def explained(matrix: np.ndarray, values: np.ndarray, pair: tuple[int, int],
              blocks: list[Block]) -> float:
    """Return by how much the sum of squares is less for two events."""
    columns = matrix[:, [c for i in pair for c in blocks[i].columns]]
    basis, size, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return float(np.sum((basis[:, size > 1e-6].T @ values) ** 2))


@pytest.mark.parametrize("widths", [(1, 1, 1, 1), (3, 3, 3), (1, 3, 2, 6, 2)])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_two_that_explain_most_are_those_of_all_pairs(
        widths: tuple[int, ...], seed: int) -> None:
    matrix, blocks = drawn(seed, widths)
    values = np.random.default_rng([seed, 1]).normal(size=COUNT)
    given = Conditioned.nothing(MatrixColumns(matrix), values)
    every = Events.of(blocks, range(len(blocks)), given.columns)
    each = {pair: explained(matrix, values, pair, blocks)
            for pair in combinations(range(len(blocks)), 2)}
    best = max(each, key=lambda pair: each[pair])
    i, j, gain = every.most(given, range(len(blocks)))
    assert (i, j) == best and gain == pytest.approx(each[best], rel=1e-6)
    some = [i for i in range(len(blocks)) if i != best[0]]
    i, j, gain = every.most(given, some)
    assert gain == pytest.approx(max(v for pair, v in each.items() if best[0] not in pair),
                                 rel=1e-6)


def test_events_that_geometry_explains_explain_nothing() -> None:
    """Nor does the second of two that are the same."""
    matrix, blocks = drawn(3, (2, 2, 2, 2))
    matrix[:, 6:8] = matrix[:, 4:6] @ [[1.0, 2.0], [0.5, -1.0]]
    values = np.random.default_rng(4).normal(size=COUNT)
    nothing = Conditioned.nothing(MatrixColumns(matrix), values)
    geometry = matrix[:, :2] / np.linalg.norm(matrix[:, :2], axis=0)
    given = nothing.taking(1e9 * geometry)
    past = values - geometry @ np.linalg.lstsq(geometry, values, rcond=None)[0]
    every, own = Events.of(blocks, range(4), given.columns), np.linalg.qr(geometry)[0]
    rest = matrix - own @ (own.T @ matrix)
    assert every.most(given, [0, 2])[2] == pytest.approx(np.sum(
        (np.linalg.qr(rest[:, 4:6])[0].T @ past) ** 2), rel=1e-3)
    assert every.most(given, [2, 3])[2] == pytest.approx(every.most(given, [0, 2])[2], rel=1e-3)


def off_and_on(seed: int) -> Question:
    """Return a joint that is off for a while, its events, and rows that may be correlated."""
    rows = 60
    lever = np.random.default_rng(seed).uniform(0.5, 1.5, size=rows)
    matrix = np.column_stack([lever * (np.arange(rows) >= o) for o in range(3, rows - 2)])
    blocks = tuple(Block(f"at {o + 3}", "shift", (o,), float(np.log(0.02 / len(matrix.T))),
                         group="shift") for o in range(matrix.shape[1]))
    values = np.random.default_rng([seed, 1]).normal(size=rows) + 3.0 * (
        matrix[:, 17] - matrix[:, 37])
    return Question(MatrixColumns(matrix), values, np.ones((rows, 1)), blocks,
                    np.ones((rows, 1), dtype=bool), np.ones(rows - 1, dtype=np.int64))


@pytest.mark.parametrize("seed", [5, 7])
def test_two_events_are_looked_for_at_every_correlation(seed: int) -> None:
    """Without both, the rows look correlated; as they look, other pairs are likelier."""
    question = off_and_on(seed)
    assert SetSearch(question).settle(()).likeliest[0] > 0
    best = posterior(question).best
    assert len(best.chosen) == 2
    assert np.abs(np.sort(best.chosen) - [17, 37]).max() <= 1
    assert best.log_p >= state(question, (17, 37)).log_p - 1e-9
