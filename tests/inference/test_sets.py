"""Sets of blocks: what is planted is found, and what is said is so often right."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ppmcal.inference.block_sets import BlockSet, state
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.moves import SetSearch
from ppmcal.inference.question import Question
from ppmcal.inference.sets import SetPosterior, posterior

ROWS, WIDTH, KINDS = 60, 2, 12


def library(rng: np.random.Generator) -> tuple[np.ndarray, tuple[Block, ...]]:
    """Return columns (n, T) of kinds on three joints and all, and events on one of them."""
    n = ROWS * WIDTH
    plain = rng.normal(size=(n, KINDS)) * rng.uniform(0.1, 10.0, KINDS)
    onsets = np.arange(6, ROWS - 5, 6)
    step = rng.normal(size=n)
    events = np.stack([np.where(np.arange(n) // WIDTH >= o, step, 0.0) for o in onsets], axis=1)
    blocks = [Block(f"kind{i}", f"kind{i}", (i,), np.log(1 / 50)) for i in range(KINDS)]
    blocks += [Block(f"slip at {o}", "slip", (KINDS + i,), np.log(1 / 50 / len(onsets)),
                     group="slip on a") for i, o in enumerate(onsets)]
    return np.hstack([plain, events]), tuple(blocks)


def question(matrix: np.ndarray, blocks: tuple[Block, ...], values: np.ndarray,
             geometry: np.ndarray, correlated: bool = False) -> Question:
    apart = np.full(ROWS - 1, int(correlated))
    return Question(MatrixColumns(matrix), values, geometry, blocks,
                    np.ones((ROWS, WIDTH), dtype=bool), apart)


def drawn(seed: int, sizes: dict[int, float], rho: float = 0.0) -> Question:
    """Return a campaign with blocks of some sizes (rms over sigma) in it."""
    rng = np.random.default_rng(seed)
    matrix, blocks = library(rng)
    geometry = 3.0 * rng.normal(size=(len(matrix), 6))
    noise = rng.normal(size=(ROWS, WIDTH))
    for i in range(1, ROWS if rho else 0):
        noise[i] = rho * noise[i - 1] + np.sqrt(1 - rho**2) * noise[i]
    values = geometry @ rng.normal(size=6) + noise.reshape(-1)
    for i, size in sizes.items():
        values = values + size * matrix[:, i] / np.sqrt(np.mean(matrix[:, i] ** 2))
    return question(matrix, blocks, values, geometry, bool(rho))


@pytest.mark.parametrize("planted", [{}, {3: 1.0}, {3: 1.0, 7: -0.8}, {0: 2.0, 5: 1.0, 9: 0.7}])
def test_what_is_planted_is_found(planted: dict[int, float]) -> None:
    found = posterior(drawn(1, planted))
    assert set(found.best.chosen) == set(planted)
    if planted:
        assert found.nothing() < 1e-3
        for place in range(len(planted)):
            name, p = next(iter(found.families(place).items()))
            assert name in {f"kind{i}" for i in planted} and p > 0.9
    else:
        assert found.nothing() > 0.5


def test_an_event_and_the_one_that_undoes_it_are_two_of_one_group() -> None:
    first, second = KINDS + 2, KINDS + 6
    rng = np.random.default_rng(2)
    matrix, blocks = library(rng)
    geometry = rng.normal(size=(len(matrix), 4))
    values = (rng.normal(size=len(matrix)) + 2.0 * matrix[:, first] - 2.0 * matrix[:, second])
    found = posterior(question(matrix, blocks, values, geometry))
    assert set(found.best.chosen) == {first, second}
    alone = found.best.question.log_prior([first])
    pair = found.best.question.log_prior([first, second])
    onsets = len(found.best.question.groups["slip on a"])
    assert pair - alone == pytest.approx(np.log(0.25 * 2.0 / (onsets - 1)))


def test_what_stands_in_elsewhere_is_not_in_a_place() -> None:
    """The likeliest set with a cause may have another in the place of the next one."""
    blocks = tuple(Block(f"cause {n}", f"family {n}", (n,), 0.0) for n in range(4))
    best: Any = SimpleNamespace(chosen=(0, 1), question=SimpleNamespace(
        blocks=blocks, alone=frozenset({"family 3"})))
    found = SetPosterior(best, {frozenset({0, 1}): np.log(0.3), frozenset({0, 2}): np.log(0.6),
                                frozenset({2, 3}): np.log(0.1)}, np.zeros(4))
    first, second = (found.members(place) for place in (0, 1))
    assert [(m.family, m.own) for m in first] == [("family 0", {0}), ("family 2", {2})]
    assert [(m.family, m.own) for m in second] == [("family 2", {2}), ("family 1", {1})]
    assert first[0].chosen == {0, 2} and first[0].probability == pytest.approx(0.9)


@pytest.mark.parametrize("acting", [(1,), (1, 4), (0, 2, 5), (0, 1, 2, 3, 4, 5)])
def test_as_many_joints_have_it_as_have_it(acting: tuple[int, ...]) -> None:
    """Six joints each by itself, all with their own values, or all with one."""
    joints, rng = 6, np.random.default_rng(4)
    matrix, _ = library(rng)
    own = matrix[:, :joints] / np.sqrt(np.mean(matrix[:, :joints] ** 2, axis=0))
    columns = np.column_stack([own, own.sum(axis=1)])
    of = np.log(1 / 50)
    blocks = (*(Block(f"on {j}", "play", (j,), of - np.log(12), group="play of a joint", low=0.0)
                for j in range(joints)),
              Block("on each", "play", tuple(range(joints)), of - np.log(4), low=0.0),
              Block("on all", "play", (joints,), of - np.log(4), low=0.0))
    values = rng.normal(size=len(columns))
    for j in acting:
        values = values + (3.0 + 0.3 * j) * own[:, j]
    found = posterior(question(columns, blocks, values, rng.normal(size=(len(columns), 4))))
    names = {found.best.question.blocks[i].name for i in found.best.chosen}
    assert names == ({"on each"} if len(acting) == joints else {f"on {j}" for j in acting})


def test_a_group_of_which_all_are_there_has_no_further_one() -> None:
    rng = np.random.default_rng(3)
    matrix = rng.normal(size=(30, 3))
    blocks = (Block("a", "a", (0,), np.log(0.02), group="of one"),
              Block("b", "b", (1,), np.log(0.02)))
    asked = Question(MatrixColumns(matrix), rng.normal(size=30) + 5.0 * matrix[:, 0],
                     np.zeros((30, 1)), blocks, np.ones((30, 1), dtype=bool),
                     np.zeros(29, dtype=np.int64))
    assert asked.more((0,))[1] == pytest.approx(np.log(0.02))
    assert posterior(asked).best.chosen == (0,)


def test_the_order_of_rows_of_columns_and_of_blocks_does_not_matter() -> None:
    asked = drawn(3, {3: 1.0, 7: 0.7})
    plain = posterior(asked)
    rows = np.random.default_rng(0).permutation(len(asked.values))
    turned = tuple(reversed(asked.blocks))
    other = posterior(question(asked.columns.values[rows], turned, asked.values[rows],
                               asked.geometry[rows][:, ::-1]))
    last = len(turned) - 1
    assert {last - i for i in other.best.chosen} == set(plain.best.chosen)
    assert other.best.log_p == pytest.approx(plain.best.log_p, abs=1e-7)
    assert other.nothing() == pytest.approx(plain.nothing(), abs=1e-9)


def test_correlated_noise_is_no_cause() -> None:
    """A walk of the noise is told as noise where correlation is asked for, and as cause else."""
    asked = drawn(4, {}, rho=0.8)
    found = posterior(asked)
    assert found.nothing() > 0.5
    likely = max(found.best.views, key=lambda v: v[1])[0]
    assert likely > 0


def test_sizes_that_are_integrated_do_not_depend_on_the_order_of_a_set() -> None:
    asked = drawn(5, {3: 1.0, 7: 0.7})
    assert state(asked, (3, 7)).log_p == pytest.approx(state(asked, (7, 3)).log_p, abs=1e-9)


def told(odds: float, other: tuple[int, ...]) -> list[str]:
    """Return what is likely in the place of a cause, at odds against another set."""
    best = posterior(drawn(1, {3: 1.0})).best
    assert best.chosen == (3,)
    each = {frozenset({3}): np.log(odds), frozenset(other): 0.0}
    total = np.log(odds + 1.0)
    found = SetPosterior(best, {key: p - total for key, p in each.items()}, np.zeros(0))
    return [m.family for m in found.likely(0, 0.95)]


@pytest.mark.parametrize(("odds", "other", "alone"), [
    (10.0, (), False), (30.0, (), False), (80.0, (), True),
    (30.0, (5,), True), (10.0, (5,), False),
    (30.0, (5, 7), False), (80.0, (5, 7), True), (170.0, (5, 7, 9), False)])
def test_a_name_stands_alone_where_other_priors_leave_it_so(
        odds: float, other: tuple[int, ...], alone: bool) -> None:
    """One cause against nothing, another, or several: priors of all may be three times off.

    Whether it is one cause or another does not depend on how often machines have either.
    """
    assert (len(told(odds, other)) == 1) == alone


def test_what_is_rare_or_frequent_is_how_often_a_family_acts() -> None:
    """Further events and rows that do not belong have priors of their own."""
    rng = np.random.default_rng(2)
    _, blocks = library(rng)
    row = Block("row", "row", (0,), np.log(0.01))
    asked = Question(MatrixColumns(rng.normal(size=(ROWS * WIDTH, len(blocks)))),
                     rng.normal(size=ROWS * WIDTH), np.zeros((ROWS * WIDTH, 1)), (*blocks, row),
                     np.ones((ROWS, WIDTH), dtype=bool), np.zeros(ROWS - 1, dtype=np.int64),
                     frozenset({"row"}))
    events = KINDS + 2, KINDS + 6
    for some, families in ((), 0), ((1,), 1), ((1, 4), 2), (events, 1), ((1, *events), 2), (
            (len(blocks),), 0), ((1, len(blocks)), 1):
        more = asked.log_prior(some, 0.5) - asked.log_prior(some)
        assert more == pytest.approx(0.5 * families)


def test_scores_that_matter_are_the_scores_and_the_others_are_no_more_than_what_matters() -> None:
    plain = drawn(3, {0: 1.0, 1: 0.4}, rho=0.5)
    signed = replace(plain, blocks=tuple(replace(b, low=0.0) for b in plain.blocks))
    at = state(signed, (0,))
    exact = at.scores
    for least in (at.log_p - 5.0, at.log_p, at.log_p + 3.0):
        again = state(signed, (0,)).scores_above(least)
        matters = exact > least
        np.testing.assert_allclose(again[matters], exact[matters], atol=1e-9)
        assert (again[~matters] <= least).all()


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_a_set_knows_what_it_would_be_without_each_of_its_causes(rho: float) -> None:
    """At the sizes that the others have: hardly less than at those they would have."""
    asked = drawn(1, {0: 2.0, 5: 1.0, 9: 0.2}, rho)
    at = state(asked, (0, 5, 9))
    for cause in at.causes:
        rest = state(asked, [i for i in at.causes if i != cause]).log_p
        assert at.about_without(cause) == pytest.approx(rest, abs=1.0)
    alone = state(asked, (5,))
    assert alone.about_without(5) == pytest.approx(state(asked, ()).log_p, abs=1e-9)


def test_what_was_looked_at_from_afar_is_not_looked_at_again(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked again from where the search ended, with what was likely there, the answer is the same.

    Where it ends elsewhere, it is looked at.
    """
    asked = drawn(1, {0: 2.0, 5: 1.0, 9: 0.4})
    first = posterior(asked)
    likely = [key for key, p in first.log_p.items() if p > np.log(0.01)]
    calls, far = list[BlockSet](), SetSearch.far

    def counted(self: SetSearch, now: BlockSet) -> BlockSet | None:
        calls.append(now)
        return far(self, now)

    monkeypatch.setattr(SetSearch, "far", counted)
    again = posterior(asked, first.best.chosen, known=likely)
    assert not calls and set(again.best.chosen) == set(first.best.chosen)
    for key in likely:
        assert again.log_p[key] == pytest.approx(first.log_p[key], abs=0.02)
    assert set(posterior(asked, (3,), known=likely[:1]).best.chosen) == set(first.best.chosen)
    assert calls
