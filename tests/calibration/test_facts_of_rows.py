"""What rows come to: one triangle, ranges that were measured, poses beyond them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.calibration.compensation import ParameterCovariance, compensate
from ppmcal.calibration.fit import linearisation as least_squares
from ppmcal.calibration.fit.linearisation import qr_factor
from ppmcal.calibration.fit.observation import pivot
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.response import ClosedRows, Response
from ppmcal.calibration.knowledge.extrapolation import extrapolated, far_outside, measured_ranges
from ppmcal.io import read_mechanism
from ppmcal.model.effects import Shift
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.motions import PLANAR, SPATIAL, Motion
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]
CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@pytest.mark.parametrize("sizes", [(4000,), (10, 3000), (2, 1), ()])
def test_one_triangle_is_all_rows_and_the_earlier_ones(monkeypatch: pytest.MonkeyPatch,
                                                       sizes: tuple[int, ...]) -> None:
    """R^T R = A^T A and R^T y = A^T b; nothing of chi-squared is lost, no value is forgotten."""
    rng = np.random.default_rng(1)
    pieces = [rng.normal(size=(n, 2, 4)) for n in sizes]
    before = rng.normal(size=(7, 3))

    def blocks(problem: Any, state: Any, i: int, keep: Any, weights: Any, given: Any) -> Any:
        yield SimpleNamespace(index=np.arange(len(pieces[i])), rows=pieces[i],
                              values=np.full(len(pieces[i]), 2))

    monkeypatch.setattr(least_squares, "white_blocks", blocks)
    problem: Any = SimpleNamespace(
        columns=range(3), datasets=sizes, free=(0, 1), mechanism=None,
        shared_stands=lambda state, keep: None,
        values=lambda index, rows, each: int(each.sum()),
        earlier=SimpleNamespace(rows=lambda *known: (before[:, 2], before[:, :2])))
    problem.earlier_rows = lambda state, size: Problem.earlier_rows(problem, state, size)
    state: Any = SimpleNamespace(g=None)
    found = qr_factor(problem, state, [np.ones(n, dtype=bool) for n in sizes])
    a = np.concatenate([*(p.reshape(-1, 4)[:, :3] for p in pieces),
                        np.column_stack([before[:, :2], np.zeros(7)])])
    b = np.concatenate([*(p.reshape(-1, 4)[:, 3] for p in pieces), before[:, 2]])
    np.testing.assert_allclose(found.root.T @ found.root, a.T @ a, atol=1e-9)
    np.testing.assert_allclose(found.root.T @ found.right, a.T @ b, atol=1e-9)
    assert found.square == pytest.approx(float(b @ b))
    assert found.count == b.size
    problem.earlier = None
    assert qr_factor(problem, state, [np.ones(n, dtype=bool) for n in sizes]).count == b.size - 7


def test_a_frame_turns_about_the_middle_of_what_was_measured() -> None:
    """Coordinate by coordinate; where nothing was measured about 0."""
    data: Any = SimpleNamespace(position=np.array(
        [[1.0, np.nan, np.nan], [3.0, 5.0, np.nan], [8.0, 7.0, np.nan]]))
    np.testing.assert_array_equal(pivot(data), [4.0, 6.0, 0.0])


def machine(motion: Motion = SPATIAL, effects: tuple[Any, ...] = ()) -> Any:
    """Return as much of a machine as is asked for; lengths are shown in mm, its reach is 1 km."""
    dof = motion.dof
    return SimpleNamespace(
        dof=dof, coordinates=tuple(("x", "y", "z", "rx", "ry", "rz")[c] for c in dof), reach=1000.0,
        home_pose=np.zeros(6), effects=effects, measured=None, units=SimpleNamespace(
            factor=lambda quantity: np.pi / 180.0 if quantity == "angle" else 1e-3,
            name=lambda quantity: "deg" if quantity == "angle" else "mm"))


@pytest.mark.parametrize(("coordinate", "still"), [("x", 1.0), ("y", 1.0), ("rz", 0.9999e-3)])
def test_half_the_width_beyond_is_the_end(coordinate: str, still: float) -> None:
    """Of 2 to 6: 8 and 0, and a thousandth of the reach or of a radian more. There, but no more."""
    for motion in (SPATIAL, PLANAR):
        place = ("x", "y", "z", "rx", "ry", "rz").index(coordinate)
        full = np.zeros((6, 6))
        low, high = (0.2, 0.6) if coordinate == "rz" else (2.0, 6.0)
        half = 0.5 * (high - low)
        full[:, place] = (low + half, high + half + still, low - half - still,
                          high + half + 1.001 * still, low - half - 1.001 * still, np.nan)
        found = dict(far_outside(machine(motion), full, {coordinate: (low, high)}))
        assert list(found) == [3, 4]
        assert f"far outside the measured volume: {coordinate} = " in found[3]


def test_what_was_touched_in_one_plane_is_known_as_far_above_it_as_beside_it() -> None:
    """A printer's bed of 200 by 150 mm: 100 mm above are told, more is refused; turns by turns."""
    ranges = {"x": (-0.1, 0.1), "y": (-0.075, 0.075), "z": (1.48e-3, 1.53e-3), "rx": (0.0, 0.4),
              "ry": (0.0, 0.0)}
    printer = machine()
    printer.reach = 0.2
    full = np.zeros((6, 6))
    full[:4, 2] = 0.2e-3, 0.05, 0.1016, 0.103
    full[4:, 4] = 0.19, 0.21
    assert list(dict(far_outside(printer, full, ranges))) == [3, 5]
    told = [*extrapolated(printer, full, np.ones(6, dtype=bool), ranges, {})]
    assert told[0].startswith("6 rows outside the measured range: z up to 101.5 mm beyond")


def test_turns_about_half_a_turn_are_held_against_those_beside_home() -> None:
    """A platform that hangs upside down: its rotation vectors flip from one end to the other."""
    hung = machine()
    hung.home_pose = np.array([0.0, 0.0, 2.0, np.pi, 0.0, 0.0])
    full = np.zeros((4, 6))
    full[:, 3] = np.radians([176.0, -179.0, -176.0, -150.0])
    ranges = {"rx": (np.radians(170.0), np.radians(180.0))}
    (row, reason), = far_outside(hung, full, ranges)
    assert row == 3
    assert "rx = 210 deg, measured 170 to 180" in reason
    told, = extrapolated(hung, full, np.array([True, True, True, False]), ranges, {})
    assert told.startswith("1 row outside the measured range: rx up to 4 deg beyond 170 to 180")


def test_a_row_that_is_refused_already_keeps_its_reason() -> None:
    """Far beside what was measured, one target is out of reach, and the other goes too far."""
    mechanism = read_mechanism(CONFIGS / "3-RPR.yaml")
    wanted = np.tile(mechanism.home_pose, (2, 1))
    wanted[:, 0] += [100.0, 1e-3]
    wanted[:, 1] += 1e-3
    volume = {"x": (-1.0, -0.9), "y": (-1.0, -0.9)}
    known = ParameterCovariance((), np.zeros((0, 0)), volume, {}, {})
    found = compensate(mechanism, wanted, Registration(), known)
    assert found.status == ("refused", "refused")
    assert "measured volume" not in found.reason[0]
    assert "far outside the measured volume: x = " in found.reason[1]
    assert not list(far_outside(mechanism, wanted, {}))


def test_a_tenth_of_the_width_beyond_is_told() -> None:
    """Rows without a command do not count; conditions count where there are effects."""
    full = np.zeros((4, 6))
    full[:, 0] = 0.0, 11.9, 12.2, -2.3
    ranges = {"x": (0.0, 10.0), "temperature": (293.15, 303.15)}
    good = np.array([True, True, True, False])
    columns = {"temperature": np.array([293.15, 305.1, 280.0, 100.0])}
    told, = extrapolated(machine(), full, good, ranges, columns)
    assert told.startswith("1 row outside the measured range: x up to 2200 mm beyond 0 to 10000;")
    both = list(extrapolated(machine(effects=(1,)), full, good, ranges, columns))
    assert len(both) == 2
    assert both[1].startswith(
        "1 row outside the measured range: temperature up to 13.15 C beyond 20 to 30;")
    low = list(extrapolated(machine(), -full, np.ones(4, dtype=bool), ranges, {}))
    assert low[0].startswith("2 rows outside the measured range: x up to 1.22e+04 mm")
    assert list(extrapolated(machine(), full, np.zeros(4, dtype=bool), ranges, columns)) == []
    assert list(extrapolated(machine(), full, good, {"y": (0.0, 1.0)}, columns)) == []


@pytest.mark.parametrize(("ends", "inside", "beyond"), [
    ((0.02, 0.02), 0.0219, 0.03), ((-9e3, -8e3), -9.8e3, -9.95e3), ((0.0, 0.0), 0.0, 0.001),
    ((0.0, 50.0), 54.0, 56.0)])
def test_loads_are_held_against_the_measured_ones(ends: tuple[float, float], inside: float,
                                                  beyond: float) -> None:
    """A micrometre stage carries grams, a press tons."""
    full, good = np.zeros((2, 6)), np.ones(2, dtype=bool)
    columns = {"fz": np.array([inside, beyond])}
    told, = extrapolated(machine(effects=(1,)), full, good, {"fz": ends}, columns)
    assert told.startswith("1 row outside the measured range: fz")


@pytest.mark.parametrize(("name", "unit"), [("payload", "kg"), ("fx", "N"), ("fz", "N"),
                                            ("mx", "N.m"), ("mz", "N.m"), ("time", "s")])
def test_conditions_are_told_in_their_units(name: str, unit: str) -> None:
    columns = {name: np.array([0.0, 5.0, -4.0])}
    told, = extrapolated(machine(effects=(1,)), np.zeros((3, 6)), np.ones(3, dtype=bool),
                         {name: (0.0, 1.0)}, columns)
    assert f"2 rows outside the measured range: {name} up to 4 {unit} beyond 0 to 1;" in told


def test_the_file_of_the_machine_is_asked_before_the_file_beside() -> None:
    own = machine()
    assert measured_ranges(own, None) == {}
    assert measured_ranges(own, {"x": (0.0, 1.0)}) == {"x": (0.0, 1.0)}
    own.measured = MeasurementBasis(1.0, 0.5, {"x": (2.0, 3.0), "y": (4.0, 5.0)})
    assert measured_ranges(own, {"x": (0.0, 1.0), "z": (6.0, 7.0)}) == {
        "x": (2.0, 3.0), "y": (4.0, 5.0), "z": (6.0, 7.0)}


def test_predictions_move_with_whatever_a_shift_moves() -> None:
    """With the platform as their derivatives say, with a stretch of what is seen too; all add."""
    rng = np.random.default_rng(3)
    n, m = 4, 3
    by_poses, by_points = rng.normal(size=(n, m, 6)), rng.normal(size=(n, m, 3))
    points, twist, stretch = rng.normal(size=(n, 3)), rng.normal(size=(n, 6)), np.diag([1.0, 2, 3])
    pose = np.tile([1.0, *[0.0] * 7], (n, 1))
    seen: Any = SimpleNamespace(residual=np.zeros((n, m)), by_poses=(by_poses,), points=(points,),
                                by_points=(by_points,), inside=None)
    closure: Any = SimpleNamespace(model=SimpleNamespace(shift=None))
    unknown: Any = None
    response = Response(ClosedRows(closure, pose), seen, unknown)
    moved = np.einsum("nmi,ni->nm", by_poses, twist)
    grown = np.einsum("nmi,ni->nm", by_points, points * [1.0, 2.0, 3.0])
    assert not response.column(Shift()).any()
    np.testing.assert_allclose(response.column(Shift(pose=twist)), moved)
    # of a platform that stands as the base does a step of frame or target is a step of the pose
    np.testing.assert_allclose(response.column(Shift(frame=twist)), moved)
    np.testing.assert_allclose(response.column(Shift(target=twist)), moved)
    both = Shift(pose=twist, frame=2.0 * twist, stretch=np.tile(stretch, (n, 1, 1)))
    np.testing.assert_allclose(response.column(both), 3.0 * moved + grown)
