"""Which columns are kept, which depend on which, and what belongs together: by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.calibration.fit.rank import (
    TAKES_PART,
    Unidentifiable,
    analyse,
    by_name,
    pivoted,
    unidentifiable,
    whole_rank,
)

Array = NDArray[np.float64]


@pytest.mark.parametrize(("more", "first"), [(0.0, "leg2.offset"), (5e-7, "leg2.offset"),
                                             (5e-6, "leg10.offset")])
def test_of_columns_as_long_the_first_by_name_is_kept(more: float, first: str) -> None:
    """Wherever it stands in the file, unless another is longer by more than round-off makes it."""
    names = ["leg1.offset", "leg10.offset", "leg2.offset"]
    long, short = np.array([0.0, 3.0]), np.array([1.0, 0.0])
    block = np.column_stack([short, (1.0 + more) * long, long])
    kept, dropped, _ = pivoted(block, 1e-9, names)
    assert [names[c] for c in kept] == [first, "leg1.offset"]
    assert len(dropped) == 1
    turned, _, _ = pivoted(block[:, [2, 1, 0]], 1e-9, [names[c] for c in (2, 1, 0)])
    assert names[2 - turned[0]] == first


def test_ties_below_the_first_pivot_too() -> None:
    """Three unit vectors: kept in the order of their names, each from where it stands."""
    names = ["c", "a", "b"]
    kept, dropped, r = pivoted(np.eye(3), 1e-9, names)
    assert [names[c] for c in kept] == ["a", "b", "c"]
    assert dropped == []
    np.testing.assert_allclose(np.abs(r), np.eye(3), atol=1e-15)


@pytest.mark.parametrize("shape", [(3, 2), (0, 2), (3, 0)])
def test_of_nothing_nothing_is_kept(shape: tuple[int, int]) -> None:
    """Not even with no tolerance at all: a column of zeros is no pivot."""
    kept, dropped, r = pivoted(np.zeros(shape), 0.0)
    assert (kept, dropped) == ([], list(range(shape[1])))
    assert r.shape == shape
    found = analyse(np.zeros(shape), shape[1], np.ones(shape[1]))
    assert (found.kept, found.dropped) == ((), tuple(range(shape[1])))
    assert found.combination.shape == (0, shape[1])


@pytest.mark.parametrize(("part", "rank"), [(1e-8, 2), (1e-10, 1)])
def test_a_column_depends_where_next_to_nothing_of_it_is_its_own(part: float, rank: int) -> None:
    block = np.array([[1.0, 1.0], [0.0, part]])
    assert len(analyse(block, 2, np.ones(2)).kept) == rank


def test_frames_are_judged_among_themselves() -> None:
    """Two frame columns that are one count once; what geometry shares with them is not its own."""
    rng = np.random.default_rng(1)
    own, frame = rng.normal(size=(20, 2)), rng.normal(size=(20, 1))
    block = np.column_stack([own, frame, 2.0 * frame])
    rank, kept, dropped = whole_rank(np.linalg.qr(block)[1], 2, np.ones(4), names=list("abcd"))
    assert sorted(rank.kept) == [0, 1]
    assert (sorted(kept), dropped) == ([0, 1, 3], [2])
    alone = whole_rank(np.linalg.qr(own)[1], 2, np.ones(2), names=["a", "b"])
    assert (sorted(alone[1]), alone[2]) == ([0, 1], [])


NAMES = ["leg2.base.point.x", "leg10.offset", "leg2.base.point.y", "leg1.length", "leg3.length",
         "leg1.offset"]


def sets_of(block: Array, names: list[str]) -> tuple[Unidentifiable, ...]:
    triangle = np.linalg.qr(block)[1]
    return unidentifiable(analyse(triangle, block.shape[1], np.ones(block.shape[1]), names=names),
                          names)


def test_what_is_seen_only_together_is_a_set_and_a_point_is_whole() -> None:
    """x = offset of leg 10, and y = length of leg 1: one set by way of the point."""
    a = np.random.default_rng(2).normal(size=(20, 4))
    block = np.column_stack([a[:, 0], a[:, 0], a[:, 1], 2.0 * a[:, 1], a[:, 2], a[:, 3]])
    assert sets_of(block, NAMES) == (Unidentifiable(
        2, ("leg1.length", "leg2.base.point", "leg10.offset"),
        ("leg1.length", "leg2.base.point.x", "leg2.base.point.y", "leg10.offset")),)


def test_sets_apart_and_what_has_no_effect_at_all() -> None:
    a = np.random.default_rng(3).normal(size=(20, 3))
    block = np.column_stack([a[:, 0], a[:, 1], np.zeros(20), a[:, 2], a[:, 2], 0.0 * a[:, 2]])
    # the point's y is without effect, its x is not: its set is not unseen as a whole
    assert sets_of(block, NAMES) == (
        Unidentifiable(1, ("leg1.length", "leg3.length"), ("leg1.length", "leg3.length")),
        Unidentifiable(1, ("leg1.offset",), ("leg1.offset",), unseen=True),
        Unidentifiable(1, ("leg2.base.point",), ("leg2.base.point.y",)))


@pytest.mark.parametrize(("share", "there"), [(10.0, True), (0.1, False)])
def test_a_part_in_a_million_is_no_part(share: float, there: bool) -> None:
    a = np.random.default_rng(4).normal(size=(20, 2))
    a /= np.linalg.norm(a, axis=0)
    block = np.column_stack([3.0 * a[:, 0], 3.0 * a[:, 1],
                             a[:, 0] + share * TAKES_PART * a[:, 1]])
    found, = sets_of(block, ["leg1.offset", "leg2.offset", "leg3.offset"])
    assert ("leg2.offset" in found.slots) is there
    assert found.combinations == 1


@pytest.mark.parametrize(("share", "there"), [(5.0, True), (0.2, False)])
def test_a_part_is_that_of_the_whole_column(share: float, there: bool) -> None:
    """Also where most of that column is along another: 100 of it, and 1 of its own."""
    a = np.linalg.qr(np.random.default_rng(5).normal(size=(20, 2)))[0]
    first, second = 1000.0 * a[:, 0], 100.0 * a[:, 0] + a[:, 1]
    block = np.column_stack([first, second, 0.1 * first + share * TAKES_PART * second])
    found, = sets_of(block, ["leg1.offset", "leg2.offset", "leg3.offset"])
    assert ("leg2.offset" in found.slots) is there


def test_legs_are_counted_and_words_come_behind() -> None:
    names = ["leg10.a", "legs.z", "leg2.b", "leg2.a", "base.x"]
    assert [names[i] for i in np.argsort(by_name(names))] == ["base.x", "leg2.b", "leg2.a",
                                                              "leg10.a", "legs.z"]
