"""One thing that nobody listed looks like several: another look of it is more usual."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.priors import FURTHER
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior

ROWS = 40


def asked(values: np.ndarray, columns: np.ndarray, subjects: tuple[str, ...]) -> Question:
    """Return a question of a known cause (column 0) and looks of unknown ones."""
    blocks = tuple(Block(f"b{i}", "unknown" if subject else f"k{i}", (i,),
                         np.log(0.02 if not subject else 0.001), subject=subject, form=f"b{i}")
                   for i, subject in enumerate(subjects))
    return Question(MatrixColumns(columns), values, np.zeros((ROWS, 1)), blocks,
                    np.ones((ROWS, 1), dtype=bool), np.zeros(ROWS - 1, dtype=np.int64))


def drawn(subjects: tuple[str, ...], sizes: dict[int, float]) -> Question:
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(ROWS, len(subjects)))
    columns[:, 0] = columns[:, 2] + 0.05 * rng.normal(size=ROWS)    # imitates a second look
    return asked(rng.normal(size=ROWS) + sum(
        size * columns[:, i] for i, size in sizes.items()), columns, subjects)


def test_the_prior_of_a_set_has_no_order_and_is_that_of_one_more() -> None:
    question = drawn(("", "leg1", "leg1", "leg1", "leg2"), {})
    alone = question.log_prior([1])
    assert question.log_prior([1, 2]) == pytest.approx(
        alone + np.log(float(FURTHER) / 3.0))
    assert question.log_prior([1, 4]) == pytest.approx(2.0 * alone)
    for order in permutations((0, 1, 2, 4)):
        assert question.log_prior(order) == pytest.approx(question.log_prior((0, 1, 2, 4)))
    for chosen in ((), (1,), (1, 2), (0, 4)):
        more = question.more(chosen)
        for i in set(range(5)) - set(chosen):
            assert more[i] == pytest.approx(
                question.log_prior((*chosen, i)) - question.log_prior(chosen))


@pytest.mark.parametrize(("subject", "second"), [("leg1", 2), ("leg2", 0)])
def test_a_known_cause_that_imitates_a_part_of_an_unknown_one_is_not_named(
        subject: str, second: int) -> None:
    """Of two columns as good, beside an unknown cause of leg1: another look of it, or a name."""
    question = drawn(("", "leg1", subject, "leg1", "leg2"), {1: 8.0, 2: 3.0})
    found = posterior(question)
    assert set(found.best.chosen) == {1, second}
