"""Columns: what the geometry leaves of them, whitening, and shapes without a cause."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.diagnosis.hypotheses import SHAPES, Hypothesis, shapes
from ppmcal.diagnosis.linear_system import System, SystemPart, Whitening, _groups
from ppmcal.diagnosis.linearisation import Linearisation

Array = NDArray[np.float64]


def made(geometry: Array, columns: Array, residual: Array) -> Linearisation:
    """Return a stage of n values in one file, each column a hypothesis."""
    n = len(residual)
    every = tuple(Hypothesis(f"kind{c}", (), True, ("c",), (-np.inf,), (np.inf,), (c,))
                  for c in range(columns.shape[1]))
    system: Any = SimpleNamespace(observed=np.ones((n, 1), dtype=bool), count=n,
                                  apart=np.ones(n - 1, dtype=int))
    library: Any = SimpleNamespace(hypotheses=every, some=lambda which: columns[:, None, which])
    return Linearisation(system, library, Whitening(), np.linalg.qr(geometry)[0], residual, ())


@pytest.mark.parametrize("chosen", [(), (0,), (2, 0), (3, 1, 4)])
def test_what_is_left_beside_chosen_columns_is_that_of_a_fit(chosen: tuple[int, ...]) -> None:
    """Of the residual and of the freedom; and sizes are those of least squares."""
    rng = np.random.default_rng(1)
    geometry, columns = rng.normal(size=(60, 4)), rng.normal(size=(60, 6)) * 10.0 ** np.arange(6)
    residual = rng.normal(size=60) + 0.5 * columns[:, 0]
    stage = made(geometry, columns, residual)
    whole = np.column_stack([geometry, columns[:, list(chosen)]])
    best = np.linalg.lstsq(whole, residual)[0]
    np.testing.assert_allclose(stage.left(chosen), residual - whole @ best, atol=1e-9)
    assert stage.explained(chosen).shape == (60, 4 + len(chosen))
    assert stage.freedom == 56
    if chosen:
        np.testing.assert_allclose(stage.sizes(chosen[:1]), np.linalg.lstsq(np.column_stack(
            [geometry, columns[:, chosen[0]]]), residual)[0][4:], rtol=1e-7)


def test_a_column_within_the_geometry_explains_nothing() -> None:
    """Nor does one that is made of two that are chosen take freedom."""
    rng = np.random.default_rng(2)
    geometry, columns = rng.normal(size=(60, 4)), rng.normal(size=(60, 3))
    columns[:, 1] = geometry @ [1.0, 2.0, 0.0, -1.0]
    columns = np.column_stack([columns, columns[:, 0] + columns[:, 2]])
    stage = made(geometry, columns, rng.normal(size=60))
    np.testing.assert_allclose(stage.left((1,)), stage.left(()), atol=1e-9)
    assert stage.visibility((1,)) == pytest.approx(0.0, abs=1e-9)
    assert stage.explained((0, 2, 3)).shape == (60, 6)


def test_what_the_geometry_leaves_of_a_column_is_its_sine() -> None:
    columns = np.array([[3.0, 0.0, 4.0, 0.0], [0.0, 0.0, 0.0, 2.0], [1.0, 1.0, 0.0, 1e-9]]).T
    stage = made(np.eye(4)[:, :2], columns, np.array([9.0, 9.0, 1.0, 2.0]))
    assert stage.visibility([0]) == pytest.approx(0.8)
    assert stage.visibility([1]) == pytest.approx(1.0)
    assert stage.visibility([2]) == pytest.approx(0.0, abs=1e-8)
    assert stage.visibility([0, 1]) == pytest.approx(np.sqrt((0.64 + 1.0) / 2.0))
    assert float(np.sum(stage.left(()) ** 2)) == pytest.approx(5.0)


def test_rows_of_another_file_have_nothing_to_do_with_the_last_one() -> None:
    """And rows in between that are not in use weaken what there is: 0.5, 0.25, 0.125."""
    system: Any = SimpleNamespace(observed=np.ones((4, 1), dtype=bool), apart=np.array([1, 0, 3]))
    white = Whitening(0.5).apply(np.ones((4, 1, 1)), system)[:, 0]
    np.testing.assert_allclose(white, [1.0, 0.5 / 0.75**0.5, 1.0, 0.875 / (1.0 - 2.0**-6) ** 0.5])


def test_values_that_were_not_measured_are_no_residuals() -> None:
    """Whitened they are zero, whatever stood there; with all measured all stay."""
    seen = np.array([[True, False], [True, True]])
    for observed, want in ((seen, [1.0, 0.0, 1.0, 1.0]), (np.ones_like(seen), [1.0] * 4)):
        system: Any = SimpleNamespace(observed=observed, apart=np.ones(1, dtype=int))
        np.testing.assert_array_equal(Whitening().apply(np.ones((2, 2, 1)), system)[:, 0], want)


# --- rows and parts -------------------------------------------------------------------------------

def test_poses_of_files_are_labelled_apart() -> None:
    problem: Any = SimpleNamespace(datasets=(
        SimpleNamespace(groups=np.array([3, 1, 3, 0]), campaign="", name="a"),
        SimpleNamespace(groups=np.array([3, 0]), campaign="", name="b")))
    found = _groups(problem, np.array([0, 0, 1, 0, 1]), np.array([0, 2, 0, 1, 1]))
    assert found.shape == (5,)
    same = found[:, None] == found
    assert same.sum() == 7
    assert same[0, 1]
    assert set(found) == {0, 1, 2, 3}


def test_the_stroke_is_the_longest_way_of_a_joint() -> None:
    """Over all parts; values that were measured are counted; pairs are one row."""
    def part(travel: Array, end: int) -> Any:
        return SimpleNamespace(setting=SimpleNamespace(travel=travel), response=SimpleNamespace(
            end=end))

    none: Any = None
    pieces = (part(np.array([[1.0, 5.0], [4.0, 6.0]]), 0), part(np.array([[-1.0, 7.0]]), 1))
    observed = np.array([[True, False], [True, True]])
    system = System(none, none, pieces, np.zeros((2, 2)), none, observed, none, none, none)
    assert system.stroke == 5.0
    assert system.count == 3
    assert system.firsts == pieces[:1]


def test_a_column_is_the_sum_of_both_ends_whitened() -> None:
    """Where nothing was observed it is 0; columns that a part has not are 0 too."""
    rng = np.random.default_rng(8)
    raw = rng.normal(size=(2, 3, 2))
    seen: Any = SimpleNamespace(observed=np.array([[True, True], [True, False], [True, True]]))
    whitener = rng.normal(size=(3, 2, 2))
    parts = tuple(SystemPart(slice(1, 4), 0, SimpleNamespace(  # type: ignore[arg-type]
        seen=seen, column=lambda shift, n=n: raw[n]), whitener) for n in (0, 1))
    none: Any = None
    system = System(none, none, parts, np.zeros((5, 3)), none, none, none, none, none)
    found = system.column([none, none])
    want = np.zeros((5, 3))
    for n in range(3):
        want[1 + n, :2] = whitener[n] @ np.where(seen.observed[n], raw[0, n] + raw[1, n], 0.0)
    np.testing.assert_allclose(found, want, atol=1e-14)


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


def test_a_lens_swells_with_the_cube_of_the_way_from_the_middle() -> None:
    points = np.random.default_rng(5).normal(size=(30, 3))
    hypotheses, shifts = shaped(np.ones((30, 2)), points)
    away = points - points.mean(axis=0)
    moved = (shifts[hypotheses[-1].columns[0]].stretch @ points[..., None])[..., 0]
    np.testing.assert_allclose(moved, np.sum(away**2, axis=1)[:, None] * away, atol=1e-9)
