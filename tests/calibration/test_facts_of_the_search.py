"""The damped search on problems whose minimum, and whose way there, is known."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.calibration.fit import gauss_newton
from ppmcal.calibration.fit.gauss_newton import Minimum, least_squares
from ppmcal.calibration.fit.linearisation import NormalStep, SummedStep

Array = NDArray[np.float64]


class Search:
    """Least squares of residuals r(x) with derivatives J(x), in units of one, without a prior."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, residual: Callable[[Array], Array],
                 slope: Callable[[Array], Array], condition: float | None = None) -> None:
        self.residual, self.slope = residual, slope
        self.costs = 0

        def linear(problem: Any, state: Any, *_: Any) -> Any:
            r, j = residual(state.x), slope(state.x)
            return SimpleNamespace(square=float(r @ r), count=r.size, r=r, j=j)

        def summed(problem: Any, state: Any, sums: Any, prior: Array) -> Any:
            found = SummedStep(sums.j.T @ sums.j, -sums.j.T @ sums.r, np.ones(sums.j.shape[1]))
            return found if condition is None else SimpleNamespace(condition=condition)

        def normal(problem: Any, state: Any, reduced: Any, prior: Array) -> NormalStep:
            u, s, vt = np.linalg.svd(reduced.j, full_matrices=False)
            return NormalStep(s, -u.T @ reduced.r, vt, np.ones(s.size))

        for name, value in (("normal_sums", linear), ("qr_factor", linear),
                            ("summed_step", summed), ("normal_step", normal), ("cost", self.cost),
                            ("column_scale", lambda p: np.ones(p.size)),
                            ("prior_square", lambda *_: 0.0)):
            monkeypatch.setattr(gauss_newton, name, value)

    def cost(self, problem: Any, state: Any, *_: Any) -> float:
        self.costs += 1
        return float(np.sum(self.residual(state.x) ** 2))

    def run(self, *start: float, iterations: int = 50, **options: Any) -> Minimum:
        def at(x: Array) -> Any:
            return SimpleNamespace(x=x, poses=(np.zeros((1, 8)),))

        problem: Any = SimpleNamespace(size=len(start), datasets=(), noisy_closure=(),
                                       moved=lambda s, step, wary=True: at(s.x + step),
                                       kept=lambda s, _: s)
        return least_squares(problem, at(np.array(start)), [np.ones(1, dtype=bool)],
                             np.zeros(len(start)), iterations, **options)


def valley(x: Array) -> Array:
    """Rosenbrock's: a curved valley with its end at (1, 1)."""
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def valley_slope(x: Array) -> Array:
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def test_two_plain_steps_go_through_a_curved_valley(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one of them is up the wall, the second is exact: no damping is needed.

    Steps come from sums, the last one from the triangle.
    """
    search = Search(monkeypatch, valley, valley_slope)
    found = search.run(-1.2, 1.0)
    at: Any = found.state
    np.testing.assert_allclose(at.x, [1.0, 1.0], atol=1e-12)
    assert found.converged
    assert (found.iterations, found.summed) == (2, 1)
    assert found.information is not None
    assert search.costs == 2


def test_ill_conditioned_sums_are_left_for_the_triangle(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Search(monkeypatch, valley, valley_slope, gauss_newton.WORST_CONDITION).run(-1.2, 1.0)
    at: Any = found.state
    np.testing.assert_allclose(at.x, [1.0, 1.0], atol=1e-12)
    assert (found.iterations, found.summed) == (2, 0)


def test_a_rough_search_makes_no_triangle(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Search(monkeypatch, valley, valley_slope).run(-1.2, 1.0, rough=True)
    assert found.information is None
    assert (found.converged, found.summed) == (True, found.iterations)


def test_where_plain_steps_overshoot_damping_leads_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """arctan from 1.5: Newton's steps grow without end, damped ones do not."""
    search = Search(monkeypatch, lambda x: 100.0 * np.arctan(x),
                    lambda x: np.diag(100.0 / (1.0 + x**2)))
    found = search.run(1.5)
    at: Any = found.state
    assert found.converged
    np.testing.assert_allclose(at.x, [0.0], atol=1e-6)
    assert 2 < found.iterations < 25


@pytest.mark.parametrize(("size", "promise", "level"), [
    (1e-2, 1.0, True), (1.0, 0.0099, True), (1.0, 0.0101, False), (1.0, 1.0, False),
    (1e3, 0.004, True), (1e3, 0.006, False)])
def test_no_way_down_is_a_minimum_where_next_to_nothing_was_promised(
        monkeypatch: pytest.MonkeyPatch, size: float, promise: float, level: bool) -> None:
    """Derivatives of the wrong sign: no step helps.

    A hundredth of what one value scatters by may be left, or of one where values scatter less.
    """
    search = Search(monkeypatch, lambda x: size * np.array([np.sqrt(promise) + x[0], 1.0]),
                    lambda x: size * np.array([[-1.0], [0.0]]))
    monkeypatch.setattr(gauss_newton, "CONVERGED", 0.0)
    monkeypatch.setattr(gauss_newton, "ROUND_OFF", 0.0)
    found = search.run(0.0)
    at: Any = found.state
    assert at.x.tolist() == [0.0]
    assert found.converged is level
    assert found.iterations == 1
    assert found.information is not None


@pytest.mark.parametrize(("left", "near"), [(1e-2, True), (1.0, True), (10.0, False)])
def test_out_of_iterations_near_the_end_or_not(monkeypatch: pytest.MonkeyPatch, left: float,
                                               near: bool) -> None:
    """r = x^2 + 1: a plain step promises far more than it keeps, for ever."""
    search = Search(monkeypatch, lambda x: left * np.exp(-x), lambda x: -left * np.diag(np.exp(-x)))
    found = search.run(0.0, iterations=3)
    assert found.iterations == 3
    assert found.converged is near


def test_a_step_too_small_to_be_judged_is_taken_unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    """It only polishes."""
    search = Search(monkeypatch, lambda x: 1e-6 * (x - 1.0), lambda x: 1e-6 * np.eye(1))
    found = search.run(0.0)
    at: Any = found.state
    np.testing.assert_allclose(at.x, [1.0])
    assert (found.converged, found.iterations, found.summed, search.costs) == (True, 1, 0, 0)


def test_a_last_step_that_loses_a_pose_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    search = Search(monkeypatch, lambda x: 1e-6 * (x - 1.0), lambda x: 1e-6 * np.eye(1))

    def moved(state: Any, step: Array, wary: bool = True) -> Any:
        return SimpleNamespace(x=state.x + step, poses=(np.full((1, 8), np.nan),))

    start: Any = SimpleNamespace(x=np.zeros(1), poses=(np.zeros((1, 8)),))
    problem: Any = SimpleNamespace(size=1, datasets=(), noisy_closure=(), moved=moved,
                                   kept=lambda s, _: s)
    found = least_squares(problem, start, [np.ones(1, dtype=bool)], np.zeros(1), 5)
    assert found.state is start
    assert (found.converged, search.costs) == (True, 0)


def test_nothing_is_linearised_where_no_row_has_a_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    """The way to the minimum at 1 ends at 0.95, where poses are lost: it is gone so far."""
    asked: list[float] = []

    def slope(x: Array) -> Array:
        asked.append(float(x[0]))
        return np.eye(1)

    Search(monkeypatch, lambda x: x - 1.0, slope)

    def moved(state: Any, step: Array, wary: bool = True) -> Any:
        x = state.x + step
        return SimpleNamespace(x=x, poses=(np.array([[0.0], [np.nan if x[0] > 0.95 else 0.0]]),))

    def cost(problem: Any, state: Any, *_: Any) -> float:
        return np.inf if state.x[0] > 0.95 else float((state.x[0] - 1.0) ** 2)

    monkeypatch.setattr(gauss_newton, "cost", cost)
    start: Any = SimpleNamespace(x=np.zeros(1), poses=(np.zeros((2, 1)),))
    problem: Any = SimpleNamespace(size=1, datasets=(), noisy_closure=(), moved=moved,
                                   kept=lambda s, _: s)
    found: Any = least_squares(problem, start, [np.ones(2, dtype=bool)], np.zeros(1), 3).state
    assert 0.4 < found.x[0] <= 0.95
    assert max(asked) <= 0.95


@pytest.mark.parametrize(("poses", "keep", "whole"), [
    ([[1.0, 2.0], [3.0]], [[1, 1], [1]], True), ([[1.0, np.nan], [3.0]], [[1, 1], [1]], False),
    ([[1.0, np.nan], [3.0]], [[1, 0], [1]], True), ([[1.0, 2.0], [np.nan]], [[1, 1], [1]], False)])
def test_solved_is_every_row_in_use_of_every_file(poses: list[list[float]], keep: list[list[int]],
                                                  whole: bool) -> None:
    state: Any = SimpleNamespace(poses=tuple(np.array(p)[:, None] for p in poses))
    assert gauss_newton.solved(state, [np.array(k, dtype=bool) for k in keep]) is whole
