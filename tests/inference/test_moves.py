"""What each move of the search is for: a case that is not found without it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations

import numpy as np
import pytest
from scipy.special import logsumexp

from ppmcal.inference import moves as steps
from ppmcal.inference import sets
from ppmcal.inference.block_sets import BlockSet, state
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns, UnitColumns
from ppmcal.inference.moves import SetSearch
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior

ROWS, WIDTH = 30, 2
COUNT = ROWS * WIDTH
Without = Callable[..., None]


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Without:
    """Return what takes moves out of the search, by their names."""
    as_it_is = SetSearch._likelier

    def take_out(*moves: str) -> None:
        def likelier(self: SetSearch, now: BlockSet,
                     some: Iterable[tuple[float, tuple[int, ...]]]) -> BlockSet | None:
            names = {1: "more", 0: "exchange", -1: "drop"}
            return as_it_is(self, now, [move for move in some if names[
                len(move[1]) - len(now.chosen)] not in moves])

        monkeypatch.setattr(SetSearch, "_likelier", likelier)
        for move in set(moves) & {"split", "merged", "pairs", "masked", "reshaped", "whole",
                                  "renamed"}:
            monkeypatch.setattr(SetSearch, f"_{move}", lambda self, *of: iter(()))
        if "many" in moves:
            monkeypatch.setattr(SetSearch, "_with_others", lambda self, now, more: more)

    return take_out


def asked(matrix: np.ndarray, effect: np.ndarray, blocks: tuple[Block, ...],
          seed: int) -> Question:
    """Return a question of columns (n, T) with noise of one sigma over an effect (n,)."""
    rng = np.random.default_rng([seed, 1])
    return Question(MatrixColumns(matrix), rng.normal(size=COUNT) + effect,
                    3.0 * rng.normal(size=(COUNT, 3)), blocks,
                    np.ones((ROWS, WIDTH), dtype=bool), np.zeros(ROWS - 1, dtype=np.int64))


def kinds(count: int, prior: float = 0.05) -> tuple[Block, ...]:
    return tuple(Block(f"k{i}", f"k{i}", (i,), float(np.log(prior))) for i in range(count))


def found(question: Question) -> set[int]:
    return set(posterior(question).best.chosen)


def compound(seed: int, unlike: float, effect: tuple[float, float]) -> Question:
    """Return two causes, a third that does nearly what both do together, and others."""
    matrix = np.random.default_rng(seed).normal(size=(COUNT, 5))
    matrix[:, 2] = matrix[:, 0] + matrix[:, 1] + unlike * matrix[:, 2]
    return asked(matrix, matrix[:, :2] @ effect, kinds(5), seed)


@pytest.mark.parametrize("seed", [1, 2, 6])
def test_two_take_the_place_of_one_that_did_what_both_do(seed: int, without: Without) -> None:
    question = compound(seed, 0.4, (1.8, 1.8))
    assert found(question) == {0, 1}
    without("split")
    assert found(question) != {0, 1}


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_one_takes_the_place_of_another_once_others_are_there(
        seed: int, without: Without) -> None:
    """Without what comes to it by several steps: the compound first, then one of its parts."""
    question = compound(seed, 0.5, (1.6, 1.0))
    without("split", "merged", "pairs")
    assert found(question) == {0, 1}
    without("split", "merged", "pairs", "exchange")
    assert found(question) != {0, 1}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_was_first_goes_once_it_is_not_needed(seed: int, without: Without) -> None:
    question = compound(seed, 0.9, (4.0, 4.0))
    without("split", "merged", "pairs", "exchange")
    assert found(question) == {0, 1}
    without("split", "merged", "pairs", "exchange", "drop")
    assert found(question) > {0, 1}


def test_all_alike_and_another_take_the_place_of_values_of_their_own(without: Without) -> None:
    """Four joints alike, and what another cause does to each: of their own each explains both."""
    rng = np.random.default_rng(5)
    matrix, _ = np.linalg.qr(rng.normal(size=(COUNT, 5)))
    matrix *= np.sqrt(COUNT)
    alike, other = matrix[:, :4].sum(axis=1), matrix[:, :4] @ np.array([1.0, -1.0, 2.0, -2.0])
    columns = np.column_stack([matrix[:, :4], alike, other])
    blocks = (Block("own", "play", (0, 1, 2, 3), np.log(0.01)),
              Block("alike", "play", (4,), np.log(0.01)),
              Block("other", "tilt", (5,), np.log(0.02)))
    question = asked(columns, 2.0 * alike + 0.5 * other, blocks, 5)

    def from_own() -> set[int]:
        seen = SetSearch(question)
        now = seen.whole(seen.visit((0,)))
        while (better := seen.better(now) or seen.far(now)) is not None:
            now = seen.whole(better)
        return set(now.chosen)

    assert from_own() == {1, 2}
    without("reshaped", "merged", "split")
    assert from_own() == {0}


def test_one_takes_the_place_of_several(without: Without) -> None:
    """From a set of three parts to what all are together, less likely before than each of them."""
    rng = np.random.default_rng(3)
    matrix, _ = np.linalg.qr(rng.normal(size=(COUNT, 5)))
    matrix *= np.sqrt(COUNT)
    matrix[:, 3] = matrix[:, :3].sum(axis=1)
    blocks = (*kinds(3), Block("whole", "whole", (3,), np.log(1e-5)), kinds(5)[4])
    question = asked(matrix, 0.8 * matrix[:, 3], blocks, 3)

    def from_parts() -> set[int]:
        seen = SetSearch(question)
        now = seen.whole(seen.visit((0, 1, 2)))
        while (better := seen.better(now) or seen.far(now)) is not None:
            now = seen.whole(better)
        return set(now.chosen)

    assert from_parts() == {3}
    without("merged")
    assert from_parts() == {0, 1, 2}


def joints(seed: int, values: tuple[float, ...], apart: float, other: float = 0.0) -> Question:
    """Return joints, each by itself, all with values of their own, all with one, another cause.

    The second moves as the first where they are not ``apart``; the others are unlike each other.
    """
    count = len(values)
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(COUNT, count + 1)))
    matrix *= np.sqrt(COUNT)
    matrix[:, 1] = (1.0 - apart) * matrix[:, 0] + apart * matrix[:, 1]
    own = matrix[:, :count]
    blocks = (*(Block(f"on {j}", "play", (j,), np.log(0.004), group="play of a joint")
                for j in range(count)),
              Block("on each", "play", tuple(range(count)), np.log(0.005)),
              Block("on all", "play", (count,), np.log(0.005)),
              Block("other", "other", (count + 1,), np.log(0.02)))
    return asked(np.column_stack([own, own.sum(axis=1), matrix[:, count]]),
                 own @ np.array(values) + other * matrix[:, count], blocks, seed)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_parts_are_those_that_are_surely_there(seed: int) -> None:
    """Of two joints that look alike one surely has it, though neither is sure by itself."""
    seen = SetSearch(joints(seed, (3.0, 0.0, 1.0, 0.0), 0.1))
    now = seen.settle((4,))
    sure = np.abs(now.likeliest[2].values[0]) / now.likeliest[2].sigmas[0]
    assert max(sure[:2]) < sure[2]
    assert seen._by_need(now, 4)[-2:] in ([2, 0], [0, 2], [2, 1], [1, 2])
    assert all({2} < set(parted.chosen) != {2, 3} for parted in seen._parted(now))


def test_joints_that_may_as_well_have_none_are_left_out() -> None:
    question = joints(4, (30.0, 0.0, 20.0, 0.0, 0.0, 0.0), 1.0)
    seen = SetSearch(question)
    (parted,) = seen._parted(seen.settle((6,)))
    assert set(parted.chosen) == found(question) == {0, 2}


@pytest.mark.slow
def test_values_of_their_own_take_the_place_of_joints_by_themselves(without: Without) -> None:
    """Beside another cause, without which one value for all joints would be likelier."""
    question = joints(5, (2.0, 1.5, 1.5, 2.4, 1.2, 2.6), 1.0, 20.0)

    def from_joints() -> set[int]:
        seen = SetSearch(question)
        now = seen.whole(seen.visit((0, 1, 2, 3, 4, 5, 8)))
        while (better := seen.better(now) or seen.far(now)) is not None:
            now = seen.whole(better)
        return set(now.chosen)

    assert from_joints() == {6, 8}
    without("whole")
    assert 6 not in from_joints()


@pytest.mark.parametrize("seed", [6, 8, 9])
def test_an_event_and_the_one_that_undoes_it_come_together(seed: int, without: Without) -> None:
    """Four rows are off: neither event alone explains them."""
    lever = np.random.default_rng(seed).normal(size=COUNT)
    onsets = range(4, ROWS - 2, 2)
    matrix = np.column_stack([lever * np.repeat(np.arange(ROWS) >= o, WIDTH) for o in onsets])
    blocks = tuple(Block(f"slip {o}", "slip", (i,), np.log(0.02 / len(onsets)), group="slip")
                   for i, o in enumerate(onsets))
    question = asked(matrix, 3.0 * (matrix[:, 5] - matrix[:, 7]), blocks, seed)
    assert found(question) == {5, 7}
    without("pairs")
    assert found(question) != {5, 7}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_events_may_both_have_another_name(seed: int, without: Without) -> None:
    """What was off for a while may be either body: neither has moved alone."""
    base = np.random.default_rng(seed).normal(size=COUNT)
    target = base + 0.1 * np.random.default_rng([seed, 2]).normal(size=COUNT)
    onsets = range(4, ROWS - 2, 4)
    matrix = np.column_stack([lever * np.repeat(np.arange(ROWS) >= o, WIDTH)
                              for lever in (base, target) for o in onsets])
    count = len(onsets)
    blocks = tuple(Block(f"{body} {i}", body, (i + n * count,), np.log(0.02 / count), group=body)
                   for n, body in enumerate(("base", "target")) for i in range(count))
    question = asked(matrix, 4.0 * (matrix[:, 2] - matrix[:, 4]), blocks, seed)
    true = {pair: state(question, pair).log_p for pair in combinations(range(2 * count), 2)}
    alike = {body: logsumexp([v for pair, v in true.items() if {i // count for i in pair} == {n}])
             for n, body in enumerate(("base", "target"))}
    base_twice = float(1.0 / (1.0 + np.exp(alike["target"] - alike["base"])))
    best = posterior(question)
    assert set(best.best.chosen) == set(max(true, key=lambda pair: true[pair]))
    assert all(best.families(place)["base"] == pytest.approx(base_twice, abs=0.06)
               for place in (0, 1))
    without("renamed")
    best = posterior(question)
    assert abs(best.families(1)["base"] - base_twice) > 0.1


def with_rows(rows: int, spoiled: set[int], sigmas: float) -> Question:
    """Return noise in which some rows are off by so many sigma, and rows as what may be there."""
    values = np.random.default_rng(0).normal(size=(rows, WIDTH))
    values[list(spoiled)] += sigmas
    blocks = tuple(Block(f"row {i}", "row", (2 * i, 2 * i + 1), np.log(0.01)) for i in range(rows))
    return Question(UnitColumns(values.size), values.ravel(), np.zeros((values.size, 0)), blocks,
                    np.ones_like(values, dtype=bool), np.zeros(rows - 1, dtype=np.int64),
                    frozenset({"row"}))


def test_rows_that_hide_each_other_are_found_together(without: Without) -> None:
    """One in six is off by 20 sigma: each by itself is no more than noise of that size."""
    spoiled = set(range(0, 60, 6))
    question = with_rows(60, spoiled, 20.0)
    assert found(question) == spoiled
    without("masked")
    assert found(question) == set()


def test_where_no_row_is_off_few_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    asked_of: list[int] = []
    as_it_is = steps.state
    monkeypatch.setattr(steps, "state", lambda question, chosen, *more: (
        asked_of.append(len(chosen)), as_it_is(question, chosen, *more))[1])
    assert found(with_rows(60, set(), 0.0)) == set()
    assert max(asked_of) <= 4


def test_many_rows_that_do_not_belong_are_found_in_few_moves(
        without: Without, monkeypatch: pytest.MonkeyPatch) -> None:
    spoiled = set(range(0, 100, 12))
    question = with_rows(100, spoiled, 10.0)
    monkeypatch.setattr(sets, "MOVES", 5)
    assert found(question) == spoiled
    without("many")
    assert found(question) < spoiled
