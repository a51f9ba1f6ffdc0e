"""A block that is only there beside another: an offset of the load beside what gives way to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.inference.block_sets import state
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior

ROWS, WIDTH = 60, 2
ALIKE, EACH, SOFTER, OFFSET = range(4)


def asked(values: np.ndarray, columns: np.ndarray) -> Question:
    """Return a question of what gives way alike, each by itself or softer, and of an offset."""
    prior = float(np.log(1 / 50))
    blocks = (Block("all give way alike", "gives", (0,), prior, gives="load"),
              Block("each gives way by itself", "gives", (1, 2), prior, gives="load"),
              Block("one is softer", "gives", (2,), prior),
              Block("offset of the load", "offset", (3,), prior, needs="load"))
    return Question(MatrixColumns(columns), values, np.ones((len(values), 1)), blocks,
                    np.ones((ROWS, WIDTH), dtype=bool), np.zeros(ROWS - 1, dtype=np.int64))


def drawn(offset: float) -> Question:
    """Return what all give way alike, and an offset, which softening of one imitates in part."""
    rng = np.random.default_rng(4)
    first, second = rng.normal(size=(2, ROWS * WIDTH))
    lever = 0.6 * second + rng.normal(size=first.size)
    columns = np.column_stack([first + second, first, second, lever])
    return asked(rng.normal(size=first.size) + 5.0 * columns[:, ALIKE] + offset * lever, columns)


def test_it_is_found_beside_what_it_needs() -> None:
    assert set(posterior(drawn(3.0)).best.chosen) == {ALIKE, OFFSET}
    assert set(posterior(drawn(0.0)).best.chosen) == {ALIKE}


def test_what_it_needs_can_be_exchanged_beside_it() -> None:
    question = drawn(3.0)
    alone = state(question, (OFFSET,))
    assert not np.isfinite(alone.log_p)
    assert np.isfinite(alone.scores).tolist() == [True, True, False, False]
    empty = state(question, ())
    assert np.isfinite(empty.scores).tolist() == [True, True, True, False]
    whole = state(question, (EACH, OFFSET))
    assert np.isfinite(whole.log_p)
    assert abs(alone.scores[ALIKE] - state(question, (ALIKE, OFFSET)).log_p) < 5.0


def test_no_set_takes_an_input_in_two_ways() -> None:
    """Half of an effect and half of it turned in some rows are an effect of the other rows."""
    rng = np.random.default_rng(7)
    whole = rng.normal(size=ROWS * WIDTH)
    turned = whole * np.where(np.arange(whole.size) < 50, -1.0, 1.0)
    prior = float(np.log(1 / 50))
    blocks = (Block("as read", "a", (0,), prior, reads=frozenset({"dir"})),
              Block("turned in some rows", "b", (1,), prior, reads=frozenset({"dir"}),
                    way="turned"),
              Block("another effect as read", "c", (2,), prior, reads=frozenset({"dir", "load"})))
    columns = np.column_stack([whole, turned, rng.normal(size=whole.size)])
    question = Question(MatrixColumns(columns), rng.normal(size=whole.size)
                        + 2.0 * (whole + turned), np.ones((whole.size, 1)), blocks,
                        np.ones((ROWS, WIDTH), dtype=bool), np.zeros(ROWS - 1, dtype=np.int64))
    assert not np.isfinite(state(question, (0, 1)).log_p)
    assert np.isfinite(state(question, (0, 2)).log_p)
    assert np.isfinite(state(question, (0,)).scores).tolist() == [False, False, True]
    assert np.isfinite(state(question, (1,)).scores).tolist() == [False, False, False]
    assert len(posterior(question).best.chosen) == 1


def test_it_is_found_with_what_it_needs_where_another_does_what_both_do() -> None:
    """A base that gives way: what legs do under a weight in a wrong direction, nearly."""
    rng = np.random.default_rng(6)
    columns = rng.normal(size=(ROWS * WIDTH, 5))
    both = 4.0 * columns[:, ALIKE] - 20.0 * columns[:, OFFSET]
    base = 4
    columns[:, base] = both + 8.0 * rng.normal(size=len(both))
    plain = asked(rng.normal(size=len(both)) + both, columns)
    blocks = (*plain.blocks, Block("base", "base", (base,), plain.blocks[0].log_prior))
    question = replace(plain, blocks=blocks)
    assert state(question, (base,)).log_p > state(question, (ALIKE,)).log_p
    assert set(posterior(question, (base,)).best.chosen) == {ALIKE, OFFSET}


def test_what_leans_keeps_within_the_ratio_that_machines_have() -> None:
    """An angle of 600 rad is none; a set with it is no candidate, and none is likelier for it."""
    def with_ratio(offset: float, most: float) -> Question:
        plain = drawn(offset)
        return replace(plain, blocks=tuple(
            replace(b, ratio=((-most, most),) if b.needs else ()) for b in plain.blocks))

    far = with_ratio(300.0, 1.6)
    assert set(posterior(far).best.chosen) != {ALIKE, OFFSET}
    assert state(far, (ALIKE,)).scores[OFFSET] < state(far, (ALIKE,)).log_p
    near = with_ratio(3.0, 1.6)
    assert set(posterior(near).best.chosen) == {ALIKE, OFFSET}
    # at most as if no more were possible beforehand than what is
    gain = state(near, (ALIKE, OFFSET)).log_p - state(drawn(3.0), (ALIKE, OFFSET)).log_p
    assert 0.0 < gain < 3.0
