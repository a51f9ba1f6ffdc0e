"""Columns that are tested: scales, whitening, and which are projected out for the noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import f as fisher

from ppmcal.diagnosis import whitening
from ppmcal.diagnosis.added_variable_test import build_test, log_p, squares_of
from ppmcal.diagnosis.hypotheses import GEOMETRY, SHAPES, Hypothesis, shapes
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.whitening import MOST, _gains, _projected, _runs

Array = NDArray[np.float64]


@pytest.mark.parametrize("unit", [1e-40, 1e-9, 1.0, 1e9])
@pytest.mark.parametrize(("size", "freedom", "part"), [(1, 40, 0.1), (3, 12, 0.6), (2, 300, 0.05)])
def test_evidence_has_no_unit(unit: float, size: int, freedom: int, part: float) -> None:
    """A residual in metres or in micrometres says the same: the tail of F."""
    ratio = part / size / ((1.0 - part) / (freedom - size))
    found = float(log_p(np.array([part * unit]), unit, size, freedom)[0])
    assert found == pytest.approx(float(fisher.logsf(ratio, size, freedom - size)), rel=1e-9)


def test_columns_that_take_all_freedom_prove_nothing() -> None:
    assert log_p(np.array([0.9, 0.9, 0.9]), 1.0, np.array([0, 4, 5]), 4).tolist() == [0.0] * 3
    assert float(log_p(np.array([0.9]), 1.0, 3, 4)[0]) < 0.0
    assert log_p(np.zeros(1), 0.0, 1, 5).tolist() == [0.0]


def test_squares_are_of_what_the_roots_make() -> None:
    root = np.array([[[2.0, 0.0], [0.0, 1.0]], [[0.0, 3.0], [0.0, 0.0]]])
    right = np.array([[[1.0], [4.0]], [[5.0], [-1.0]]])
    np.testing.assert_allclose(squares_of(root, right), [[4.0 + 16.0], [9.0]])


@pytest.mark.parametrize("chosen", [(0,), (2, 0), (3, 1, 4)])
def test_what_is_left_beside_chosen_columns_is_that_of_a_fit(chosen: tuple[int, ...]) -> None:
    """Of the residual, of the freedom, and of what other columns then explain; survival too."""
    rng = np.random.default_rng(1)
    geometry, columns = rng.normal(size=(60, 4)), rng.normal(size=(60, 6)) * 10.0 ** np.arange(6)
    residual = rng.normal(size=60) + 0.5 * columns[:, 0]
    test = build_test(np.linalg.qr(geometry)[0], columns, residual, 60)

    def rss(*more: int) -> float:
        whole = np.column_stack([geometry, columns[:, list(more)]])
        return float(np.sum((residual - whole @ np.linalg.lstsq(whole, residual)[0]) ** 2))

    assert test.left(chosen) == pytest.approx(rss(*chosen))
    assert test.left(()) == pytest.approx(rss())
    given = test.given(chosen)
    assert given.square == pytest.approx(rss(*chosen))
    assert given.freedom == test.freedom - len(chosen) == 56 - len(chosen)
    groups = np.array([[5], [chosen[0]]])
    square, rank = given.explained(groups)
    assert square[0] == pytest.approx(rss(*chosen) - rss(*chosen, 5))
    assert rank.tolist() == [1, 0]
    value, covariance = test.fit(chosen)
    whole = np.column_stack([geometry, columns[:, list(chosen)]])
    np.testing.assert_allclose(value, np.linalg.lstsq(whole, residual)[0][4:], rtol=1e-7)
    own = np.linalg.inv(whole.T @ whole)[4:, 4:] * rss(*chosen) / (56 - len(chosen))
    np.testing.assert_allclose(covariance, own, rtol=1e-6, atol=1e-9 * own.max())


def test_what_the_geometry_leaves_of_a_column_is_its_sine() -> None:
    basis = np.eye(4)[:, :2]
    columns = np.array([[3.0, 0.0, 4.0, 0.0], [0.0, 0.0, 0.0, 2.0], [1.0, 1.0, 0.0, 1e-9]]).T
    test = build_test(basis, columns, np.array([9.0, 9.0, 1.0, 2.0]), 4)
    assert test.survival([0]) == pytest.approx(0.8)
    assert test.survival([1]) == pytest.approx(1.0)
    assert test.survival([2]) == pytest.approx(0.0, abs=1e-8)
    assert test.survival([0, 1]) == pytest.approx(np.sqrt((0.64 + 1.0) / 2.0))
    assert (test.square, test.freedom) == (pytest.approx(5.0), 2)


def test_rows_of_another_file_have_nothing_to_do_with_the_last_one() -> None:
    """And rows in between that are not in use weaken what there is: 0.5, 0.25, 0.125."""
    system: Any = SimpleNamespace(observed=np.ones((4, 1), dtype=bool),
                                  dataset=np.zeros(4, dtype=int), apart=np.array([1, 0, 3]))
    made = Whitening(np.eye(1)[None], 0.5).apply(np.ones((4, 1, 1)), system)[:, 0]
    np.testing.assert_allclose(made, [1.0, 0.5 / 0.75**0.5, 1.0, 0.875 / (1.0 - 2.0**-6) ** 0.5])


# --- what is projected out ------------------------------------------------------------------------

def form(kind: str, columns: tuple[int, ...], **traits: Any) -> Hypothesis:
    n = len(columns)
    shared = traits.pop("shared", True)
    return Hypothesis(kind, traits.pop("on", ()), shared, ("c",) * n, (-np.inf,) * n, (np.inf,) * n,
                      columns, **traits)


def projected(monkeypatch: pytest.MonkeyPatch, hypotheses: list[Hypothesis], count: int,
              gains: dict[int, float], extra: tuple[int, ...] = (), geometry: int = 10
              ) -> list[int]:
    """Return what is projected out; what a group explains is said by its first column."""
    monkeypatch.setattr(whitening, "_gains", lambda system, library, groups: [
        gains.get(g[0], 0.0) for g in groups])
    system: Any = SimpleNamespace(count=count, jacobian=np.zeros((count, 1, geometry)))
    library: Any = SimpleNamespace(hypotheses=hypotheses)
    return _projected(system, library, extra)


def test_of_each_kind_the_freest_and_of_a_grid_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """One value for all joints is in a value for each; all frozen slots count together."""
    grid = {"constants": {"tau": 1.0}, "searched": 1}
    every = [form("gain", (0,)), form("gain", (1, 2, 3), shared=False), form("lag", (4,), **grid),
             form("lag", (5,), **grid), form("lag", (6, 7), shared=False, **grid),
             form(GEOMETRY, (8,)), form(GEOMETRY, (9,)), form("tilt", (10,)),
             form("fixed", (11,), constants={"tau": 0.0})]
    gains = {0: 0.5, 4: 1.0, 5: 2.0, 6: 99.0, 1: 30.0, 10: 5.0, 8: 3.0, 11: 1.0}
    found = projected(monkeypatch, every, 1000, gains)
    assert found == [1, 2, 3, 10, 8, 9, 11, 5]
    assert projected(monkeypatch, every, 1000, gains, (7, 2))[:2] == [7, 2]
    assert sorted(projected(monkeypatch, every, 1000, gains, (7, 2))) == sorted([*found, 7])


@pytest.mark.parametrize(("count", "found"), [(35, [4, 1, 2, 3]), (34, [4, 1, 2]), (28, [4]),
                                              (25, [])])
def test_where_there_is_little_room_what_explains_most_comes_first(
        monkeypatch: pytest.MonkeyPatch, count: int, found: list[int]) -> None:
    """By column. Four tenths of the freedom, less what the geometry takes: 14 - 10 are four."""
    assert MOST == 0.4
    every = [form("gain", (1, 2)), form("tilt", (3,)), form("lag", (4,))]
    gains = {1: 6.0, 3: 2.0, 4: 5.0}
    assert projected(monkeypatch, every, count, gains) == found


def test_what_groups_explain_does_not_depend_on_how_many_go_together(
        monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    columns, residual = rng.normal(size=(30, 2, 5)), rng.normal(size=(30, 2))
    system: Any = SimpleNamespace(residual=residual)
    library: Any = SimpleNamespace(some=lambda which: columns[..., which])
    groups = [(0,), (1, 2), (4, 0, 3), (2,)]
    wanted = []
    for group in groups:
        a, r = columns[..., list(group)].reshape(60, -1), residual.reshape(-1)
        wanted.append(float(r @ r - np.sum((r - a @ np.linalg.lstsq(a, r)[0]) ** 2)))
    for together in (60 * 100, 60 * 3, 1):
        monkeypatch.setattr(whitening, "TOGETHER", together)
        np.testing.assert_allclose(_gains(system, library, groups), wanted)


def test_runs_are_as_long_as_they_may_be() -> None:
    assert list(_runs([2, 2, 2, 5, 1], 4)) == [(0, 2), (2, 3), (3, 4), (4, 5)]
    assert list(_runs([1, 1, 1], 3)) == [(0, 3)]
    assert list(_runs([3, 2, 2, 1, 3], 4)) == [(0, 1), (1, 3), (3, 5)]


# --- shapes without a cause -----------------------------------------------------------------------

def shaped(travel: Array, points: Array) -> Any:
    """Return what was collected of shapes: hypotheses, and the shifts of each."""
    response = SimpleNamespace(seen=SimpleNamespace(points=(points,)), end=0)
    setting = SimpleNamespace(travel=travel, at_joints=lambda change, on: change[:, on])
    shifts: list[Any] = []

    def shifted(own: list[Any]) -> int:
        shifts.append(own[0])
        return len(shifts) - 1

    to: Any = SimpleNamespace(
        turning=np.zeros(travel.shape[1], dtype=bool), hypotheses=[], actuators=("leg1", "leg2"),
        columns=SimpleNamespace(shifted=shifted),
        system=SimpleNamespace(parts=[SimpleNamespace(setting=setting, response=response)]))
    shapes(to)
    return to.hypotheses, shifts


def test_shapes_lie_over_the_stroke_the_same_from_either_end() -> None:
    """Bumps of two widths and kinks, each at a place of its own; ends have bumps, but no kinks."""
    bumps, kinks = ({(at, w) for at, w in SHAPES if bool(w) == wide} for wide in (True, False))
    for part in (bumps, kinks):
        mirrored = {(1.0 - at, w) for at, w in part}
        np.testing.assert_allclose(sorted(mirrored), sorted(part), atol=1e-12)
    assert len(bumps) + len(kinks) == len(SHAPES)
    assert {at for at, _ in bumps} >= {0.0, 1.0}
    assert min(kinks)[0] > 0.0
    assert max(kinks)[0] < 1.0
    rng = np.random.default_rng(4)
    travel = rng.uniform(2.0, 5.0, size=(50, 2))
    hypotheses, shifts = shaped(travel, rng.normal(size=(50, 3)))
    assert all(h.anonymous and h.shared for h in hypotheses)
    assert [h.follows for h in hypotheses] == [
        *["leg1"] * len(SHAPES), *["leg2"] * len(SHAPES), "position"]
    low, length = travel[:, 1].min(), np.ptp(travel[:, 1])
    for h, (at, width) in zip(hypotheses[len(SHAPES):-1], SHAPES, strict=True):
        x = (travel[:, 1] - low) / length - at
        want = np.exp(-0.5 * (x / width) ** 2) if width else length * np.maximum(x, 0.0)
        np.testing.assert_allclose(shifts[h.columns[0]][:, 0], want, atol=1e-12)
        assert h.searched == (2 if width else 1)


def test_a_lens_swells_with_the_cube_of_the_way_from_the_middle() -> None:
    points = np.random.default_rng(5).normal(size=(30, 3))
    hypotheses, shifts = shaped(np.ones((30, 2)), points)
    away = points - points.mean(axis=0)
    moved = (shifts[hypotheses[-1].columns[0]].stretch @ points[..., None])[..., 0]
    np.testing.assert_allclose(moved, np.sum(away**2, axis=1)[:, None] * away, atol=1e-9)
