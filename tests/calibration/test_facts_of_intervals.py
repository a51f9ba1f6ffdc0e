"""Which rows are asked as clusters, and which answer counts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.calibration.knowledge import intervals
from ppmcal.calibration.knowledge.intervals import (
    BLOCKS,
    LEAST_ROWS,
    by_blocks,
    by_sessions,
    cluster_robust,
    in_words,
    spatial_blocks,
)
from ppmcal.calibration.knowledge.session_variance import SessionVariance

Array = NDArray[np.float64]


class Rows(SimpleNamespace):
    """As much of a data set as clusters ask for."""

    def __len__(self) -> int:
        return len(self.q)


def fit_of(*files: Array, keep: list[NDArray[np.bool_]] | None = None, free: tuple[int, ...] = (0,),
           earlier: Any = None) -> Any:
    """Return a fit of files with joint values (N, k) each; two columns in units of 1 and 100."""
    datasets = [Rows(q=q, name=f"run{i + 1}", sessions=(), campaign="", body="")
                for i, q in enumerate(files)]
    return SimpleNamespace(
        keep=keep or [np.ones(len(q), dtype=bool) for q in files], scale=np.array([1.0, 100.0]),
        problem=SimpleNamespace(datasets=datasets, free=free, earlier=earlier, blind=False))


def answer(half: tuple[float, float], labels: tuple[str, ...] = ("a 1", "a 2"),
           **more: Any) -> SessionVariance:
    none = np.zeros((2, 1))
    return SessionVariance(labels, np.eye(2), np.array(half), 0.0, none, none, np.ones(1),
                           np.zeros(1), {}, **more)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Record masks by label; whatever is asked differs, and blocks in order by more."""
    seen: dict[str, Any] = {}

    def clusters(fit: Any, labels: Any, masks: Any) -> Any:
        seen.update(zip(labels, masks, strict=True))
        return labels

    monkeypatch.setattr(intervals, "clusters", clusters)
    monkeypatch.setattr(intervals, "differs", lambda fit, labels, inflation: True)
    monkeypatch.setattr(intervals, "session_variance", lambda fit, labels, *more, **said: answer(
        (2.0, 0.0) if labels[0].startswith("order") else (1.0, 999.0), tuple(labels)))
    return seen


@pytest.mark.parametrize("rows", [BLOCKS * LEAST_ROWS, BLOCKS * LEAST_ROWS - 1])
def test_three_rows_in_each_of_eight_blocks_are_enough(asked: dict[str, Any], rows: int) -> None:
    """Rows that are not in use count for nothing, nor does a frame's column in what is wider."""
    q = np.random.default_rng(1).normal(size=(rows + 5, 3))
    keep = np.arange(rows + 5) >= 5
    found = by_blocks(fit_of(q, keep=[keep]), 1.0)
    assert (found is not None) == (rows == 24)
    if found is None:
        return
    assert (found.labels[0], found.sessions) == ("order 1", False)
    for name in ("joint space", "order"):
        masks = np.array([asked[f"{name} {b + 1}"][0] for b in range(8)])
        assert (masks.sum(axis=1) == 3).all()
        np.testing.assert_array_equal(masks.sum(axis=0), keep)
    np.testing.assert_array_equal(np.argmax(masks, axis=0)[5:], np.arange(24) // 3)
    labels, = spatial_blocks(fit_of(q, keep=[keep]))
    assert (labels[:5] == -1).all()
    np.testing.assert_array_equal(np.bincount(labels[5:]), [3] * 8)


@pytest.mark.parametrize("more", [{"free": ()}, {"earlier": object()}])
def test_with_nothing_free_or_with_earlier_rows_nothing_is_asked(asked: dict[str, Any],
                                                                 more: dict[str, Any]) -> None:
    q = np.random.default_rng(2).normal(size=(40, 3))
    assert by_blocks(fit_of(q, **more), 1.0) is None
    assert by_sessions(fit_of(q, q, **more), 1.0) is None
    assert asked == {}


def test_a_session_without_rows_in_use_is_none(asked: dict[str, Any]) -> None:
    q = np.random.default_rng(3).normal(size=(5, 3))
    all_, none = np.ones(5, dtype=bool), np.zeros(5, dtype=bool)
    assert by_sessions(fit_of(q, q, keep=[all_, none]), 1.0) is None
    found = by_sessions(fit_of(q, q, q, keep=[all_, none, all_]), 1.0)
    assert found is not None
    assert found.labels == ("run1", "run3")
    assert [m.tolist() for m in asked["run3"]] == [none.tolist(), none.tolist(), all_.tolist()]


def test_neighbours_are_halved_where_they_are_widest() -> None:
    """Rows on a long line with a little width: blocks are its eighths in their order."""
    q = np.stack([np.linspace(0.0, 80.0, 64), np.random.default_rng(4).normal(size=64)], axis=-1)
    labels, = spatial_blocks(fit_of(q))
    assert [len(set(labels[8 * b:8 * b + 8])) for b in range(8)] == [1] * 8
    assert sorted(set(labels.tolist())) == list(range(8))


def test_intervals_of_sessions_hold_those_of_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(intervals, "by_sessions", lambda fit, inflation: answer((3.0, 4.0)))
    monkeypatch.setattr(intervals, "by_blocks", lambda fit, inflation: answer((5.0, 1.0)))
    sessions, blocks = cluster_robust(fit_of(), 1.0)
    assert sessions is not None
    assert blocks is not None
    assert (sessions.half.tolist(), blocks.half.tolist()) == ([5.0, 4.0], [5.0, 1.0])


@pytest.mark.parametrize("count", [2, 3, 5])
def test_three_parameters_are_named_and_the_others_counted(monkeypatch: pytest.MonkeyPatch,
                                                           count: int) -> None:
    monkeypatch.setattr(intervals, "_values", lambda fit, found, c: f"p{c}")
    found = replace(answer((2.0, 2.0)), p_value=np.array([1e-9 * (6 - c) if c >= 6 - count else 1.0
                                                          for c in range(6)]),
                    apart=np.array([0.96 if c >= 6 - count else 0.94 for c in range(6)]),
                    half=np.full(6, 2.0))
    fit = fit_of(free=tuple(range(6)))
    assert int(found.disagree.sum()) == count
    said, = in_words(fit, found, np.ones(6))
    assert f"sessions disagree about {count} of 6 parameters" in said
    assert "; ".join(f"p{c}" for c in range(5, 5 - min(count, 3), -1)) in said
    assert ("; and 2 more" in said) == (count == 5)
    assert ("more" in said) == (count > 3)
