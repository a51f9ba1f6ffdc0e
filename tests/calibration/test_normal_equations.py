"""Normal equations against the triangle that QR makes of the same rows, and the fits of both."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from helpers import constrained, machines
from helpers.instruments import joints

import ppmcal
from ppmcal import algebra as cga
from ppmcal.calibration.fit import gauss_newton, normal_equations
from ppmcal.calibration.fit import problem as calibration_problem
from ppmcal.calibration.fit.fit_result import Fit, FitOptions, posterior
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.gauss_newton import cost
from ppmcal.calibration.fit.linearisation import (
    column_scale,
    normal_step,
    prior_weights,
    qr_factor,
    summed_step,
)
from ppmcal.calibration.fit.normal_equations import normal_sums, row_squares, white_blocks
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.calibration.fit.row_distances import _freed, distances
from ppmcal.kinematics import compiled_limbs
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

COUNT = 43
"""Rows: no multiple of those that are summed together."""
CASES = {
    "pose, all open": ("U(P)S", "pose", ("frame", "target", "turn", "scale", "homing")),
    "pose, cranks, frame known": ("(R)US", "pose", ("target",)),
    "pose, circles": ("R(P)S", "pose", ("frame", "turn")),
    "position": ("(P)US", "position", ("frame", "target", "scale")),
    "plane": ("(P)US", "plane", ("frame", "target")),
    "planar pose": ("(R)RR", "pose", ("frame", "target", "turn", "homing")),
    "planar pose on lines": ("(R)RP", "pose", ("frame", "target")),
    "planar position": ("R(P)R", "position", ("frame",)),
    "delta": ("delta", "position", ("frame",)),
    "passive limb": ("UP", "pose", ("frame", "target", "homing")),
    "limbs that hold rotations": ("U(P)U", "pose", ("frame", "turn")),
}


@contextmanager
def rows_from(count: int) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled_limbs, "MANY", count)
        yield


@contextmanager
def pieces_of(count: int) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for place in (calibration_problem, normal_equations):
            patch.setattr(place, "PIECE", count)
        yield


def case(name: str) -> tuple[Problem, State, list[np.ndarray], list[np.ndarray]]:
    """Return a problem off its minimum, rows to use and weights."""
    kind, instrument, opened = CASES[name]
    mechanism = (machines.delta("(R)US", 3) if kind == "delta" else
                 constrained.with_joint_frames(kind) if kind in constrained.MACHINES else
                 machines.plain(kind))
    rng = np.random.default_rng(7)
    planar, still = mechanism.motion.planar, not mechanism.motion.turns
    turns = np.array([0.0, 0.0, 1.0]) if planar else np.ones(3)
    level = np.array([1.0, 1.0, 0.0]) if planar else np.ones(3)
    frame = np.concatenate([rng.normal(size=3) * level, 0.5 * rng.normal(size=3) * turns])
    registration = Registration.of_pose(
        frame, 0.1 * rng.normal(size=3) * level,
        0.3 * rng.normal(size=3) * turns * (instrument == "pose" and not still),
        1.002 if "scale" in opened else 1.0)
    homing = 1e-4 * rng.normal(size=len(mechanism.actuators)) if "homing" in opened else 0.0
    registration = replace(registration, homing=np.asarray(homing))
    q, pose = machines.spread(Model(mechanism), COUNT)
    seen = measured_pose(registration, pose) + 1e-3 * rng.normal(size=(COUNT, 6))
    if planar:
        seen[:, 2:5] = np.nan
        seen[:, 5] += 2.0 * np.pi * (rng.random(COUNT) < 0.3)
    blank = np.full(COUNT, np.nan)
    height = seen[:, 2].copy() if instrument == "plane" else blank
    if instrument != "pose" or still:
        seen[:, 3:] = np.nan
    if instrument == "plane":
        seen[:] = np.nan
    seen[5, 0] = seen[6, 5] = np.nan
    data = Dataset.of_poses("a", q - homing, seen, (1e-3, 2e-3), False)
    data = replace(
        data, kind=find_instrument(instrument), value=height,
        sigma_value=np.linspace(1e-3, 2e-3, COUNT),
        sigma_position=data.sigma_position * np.linspace(1.0, 2.0, COUNT)[:, None],
        frame=Unknown("frame" in opened, frame),
        target=Unknown("target" in opened, registration.target),
        target_rotation=Unknown("turn" in opened, registration.target_rotation),
        scale=Unknown("scale" in opened, np.array([registration.scale])),
        homing="alone" if "homing" in opened else "shared")
    g = mechanism.values.copy()
    problem = Problem(mechanism, (data,), tuple(range(len(mechanism.parameters))))
    keep = np.ones(COUNT, dtype=bool)
    keep[[3, 11]] = False
    state = State(g, (registration,), (pose,))
    return problem, state, [keep], [np.linspace(0.5, 1.0, COUNT)]


@pytest.mark.slow_cases("pose, cranks, frame known")
@pytest.mark.long_cases("pose, all open")
@pytest.mark.parametrize("name", CASES)
def test_rows_in_pieces_are_those_of_the_whole(name: str) -> None:
    """Blocks, sums and squares do not depend on how many rows are made at once."""
    problem, state, keep, weights = case(name)
    free = tuple(p for p in problem.free if not problem.mechanism.names[p].endswith("axis_offset"))
    problem = replace(problem, free=free)
    covariance = np.diag(column_scale(problem) ** 2)
    with rows_from(1):
        whole = normal_sums(problem, state, keep, weights)
        squares, far = (row_squares(problem, state, 0, keep[0]),
                        distances(problem, state, covariance, keep))
        with pieces_of(7):
            cut = normal_sums(replace(problem), state, keep, weights)
            np.testing.assert_array_equal(row_squares(replace(problem), state, 0, keep[0]), squares)
            apart = distances(replace(problem), state, covariance, keep)
            blocks = list(white_blocks(replace(problem), state, 0, keep[0]))
    np.testing.assert_allclose(cut.matrix, whole.matrix, rtol=1e-12, atol=1e-13 * abs(
        whole.matrix).max())
    np.testing.assert_allclose(cut.square, whole.square, rtol=1e-13)
    assert cut.count == whole.count
    assert [len(b.index) for b in blocks] == [7] * (int(keep[0].sum()) // 7) + [
        n for n in [int(keep[0].sum()) % 7] if n]
    np.testing.assert_array_equal(np.concatenate([b.index for b in blocks]),
                                  np.flatnonzero(keep[0]))
    with rows_from(10 * COUNT):
        plain = distances(replace(problem), state, covariance, keep)
    for found in (far, apart):
        np.testing.assert_allclose(found.square[0], plain.square[0], rtol=1e-7)
        np.testing.assert_array_equal(found.size[0], plain.size[0])


@pytest.mark.parametrize("used", [1.0, 0.3, 0.0])
def test_distances_are_freed_of_leverage_by_the_whole_formula(used: float) -> None:
    """Rows of all leverages: those of small ones skip the eigenvalues and change nothing."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(50, 3, 5)) * np.geomspace(1e-3, 10.0, 50)[:, None, None]
    root = rng.normal(size=(4, 4)) * 0.3
    covariance = root @ root.T
    found = _freed(rows, covariance, np.full(50, used))
    for row, square in zip(rows, found, strict=True):
        jacobian, r = row[:, :-1], row[:, -1]
        hat = jacobian @ covariance @ jacobian.T
        left = (np.eye(3) - used * hat) @ (np.eye(3) + (1.0 - used) * hat)
        if used == 1.0 and np.linalg.eigvalsh(left)[0] < 1e-3:
            left = np.eye(3)
        if used in (0.0, 1.0) or np.linalg.eigvalsh(left)[0] >= 1e-3:
            assert square == pytest.approx(float(r @ np.linalg.solve(left, r)), rel=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_compiled_sums_are_those_of_the_rows(name: str) -> None:
    problem, state, keep, weights = case(name)
    free = tuple(p for p in problem.free if not problem.mechanism.names[p].endswith("axis_offset"))
    problem = replace(problem, free=free)
    with rows_from(10 * COUNT):
        reduced = qr_factor(problem, state, keep, weights)
        plain = normal_sums(problem, state, keep, weights)
        few = row_squares(problem, state, 0, keep[0])
        by_rows = next(np.sum(rows.residual**2, axis=1)
                   for rows in problem.rows(state, False, keep))
        whole = cost(problem, state, keep, np.zeros(len(problem.columns)), weights)
    with rows_from(1):
        fast = normal_sums(problem, state, keep, weights)
        squares = row_squares(problem, state, 0, keep[0])
    np.testing.assert_allclose(squares, by_rows, rtol=1e-10)
    np.testing.assert_allclose(few, by_rows, rtol=1e-10)
    matrix = reduced.root.T @ reduced.root
    gradient = reduced.root.T @ reduced.right
    size = np.sqrt(np.diagonal(matrix))
    floor = 1e-3 * size.max()
    for found in (plain, fast):
        apart = np.abs(found.matrix - matrix) / np.outer(size + floor, size + floor)
        assert apart.max() < 1e-12
        assert np.abs((found.gradient - gradient) / (size + floor)).max() < 1e-11 * np.sqrt(
            reduced.square)
        assert found.square == pytest.approx(reduced.square, rel=1e-12)
        assert found.count == reduced.count
    np.testing.assert_array_equal(fast.matrix, fast.matrix.T)
    assert float(np.sum(squares * weights[0][keep[0]] ** 2)) == pytest.approx(whole, rel=1e-12)


def test_drives_that_scatter_are_in_the_sums_of_many_rows_too() -> None:
    """Their noise goes through the machine's Jacobian, which the compiled loops know nothing of."""
    problem, state, keep, weights = case("pose, circles")
    data, = problem.datasets
    sigma = np.full(len(problem.mechanism.actuators), 2e-3)
    problem = replace(problem, datasets=(replace(data, sigma_actuator=sigma),))
    with rows_from(10 * COUNT):
        reduced = qr_factor(problem, state, keep, weights)
    with rows_from(1):
        fast = normal_sums(problem, state, keep, weights)
    matrix = reduced.root.T @ reduced.root
    np.testing.assert_allclose(fast.matrix, matrix, rtol=0.0, atol=1e-10 * matrix.max())
    assert fast.square == pytest.approx(reduced.square, rel=1e-10)


def test_steps_of_sums_are_those_of_the_triangle() -> None:
    problem, state, keep, _ = case("pose, all open")
    prior = prior_weights(problem, "prior") + 1.0 / column_scale(problem)
    sums = summed_step(problem, state, normal_sums(problem, state, keep), prior)
    rows = normal_step(problem, state, qr_factor(problem, state, keep), prior)
    assert sums.condition < gauss_newton.WORST_CONDITION
    for damping in (0.0, 1e-6, 1e-2):
        (x, gain), (y, promised) = sums.step(damping), rows.step(damping)
        np.testing.assert_allclose(x / column_scale(problem), y / column_scale(problem), rtol=0.0,
                                   atol=1e-7 * np.abs(y / column_scale(problem)).max())
        assert gain == pytest.approx(promised, rel=1e-9)


def test_what_nothing_knows_has_no_condition() -> None:
    """All six points and the frame free, no prior: seven directions that nobody sees."""
    problem, state, keep, _ = case("pose, all open")
    none = np.zeros(len(problem.columns))
    assert summed_step(problem, state, normal_sums(problem, state, keep),
                       none).condition > gauss_newton.WORST_CONDITION


def measured(mechanism: Mechanism, count: int, noise: float = 1e-5) -> Problem:
    """Return a problem with a frame and a target to find, all free parameters off nominal."""
    rng = np.random.default_rng(3)
    g = mechanism.values.copy()
    for p in mechanism.free:
        g[p] += rng.normal() * float(mechanism.parameters[p].tolerance or 0.0)
    q = joints(mechanism, "6-UPS", count, rng)
    pose = forward(Model(mechanism, g), q).pose
    registration = Registration.of_pose(np.array([0.3, -0.2, 0.5, 0.1, 0.2, -0.3]),
                                        np.array([0.02, 0.01, 0.05]))
    seen = measured_pose(registration, pose)
    turn = cga.motor_from_rotation_vector(noise * rng.normal(size=(count, 3)), np.zeros(3))
    seen[:, 3:] = cga.rotation_vector(cga.compose(
        turn, cga.motor_from_rotation_vector(seen[:, 3:], np.zeros(3))))
    seen[:, :3] += noise * rng.normal(size=(count, 3))
    data = Dataset.of_poses("a", q, seen, (noise, noise), True)
    return Problem(mechanism, (data,), mechanism.free)


def same_fit(one: Fit, other: Fit) -> None:
    sigma = np.sqrt(np.diagonal(posterior(one)))[:len(one.problem.free)]
    free = list(one.problem.free)
    assert np.abs((one.state.g - other.state.g)[free] / sigma).max() < 1e-7
    assert np.abs((one.state.g - other.state.g)[free]).max() < 1e-11
    assert one.iterations == other.iterations
    assert one.information.square == pytest.approx(other.information.square, rel=1e-9)
    np.testing.assert_allclose(np.diagonal(posterior(other)), np.diagonal(posterior(one)),
                               rtol=1e-9)


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.slow
def test_all_three_ways_end_at_the_same_minimum(robust: bool,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    problem = measured(ppmcal.load(ppmcal.shipped("6-UPS")), 60)
    options = FitOptions(robust=robust)
    with rows_from(1000):
        sums = identify(problem, options)
        monkeypatch.setattr(gauss_newton, "WORST_CONDITION", 0.0)
        rows = identify(problem, options)
        monkeypatch.undo()
    with rows_from(1):
        fast = identify(problem, options)
    assert sums.summed == sums.iterations - 1 > 0
    assert rows.summed == 0
    same_fit(rows, sums)
    same_fit(rows, fast)


def test_a_fit_without_a_prior_takes_its_steps_from_rows() -> None:
    """Points of both sides and the frame: no data tell them apart, sums would be noise."""
    problem = measured(ppmcal.load(ppmcal.shipped("6-UPS")), 60)
    found = identify(problem, FitOptions("flat", robust=False))
    assert found.summed == 0
    assert found.converged
