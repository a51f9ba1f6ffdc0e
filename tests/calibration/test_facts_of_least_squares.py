"""Least squares, rank, priors and predictions, against linear algebra in full."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.posteriors import sigma_of
from numpy.typing import NDArray

import ppmcal
from ppmcal.calibration.compensation.commands import compensate
from ppmcal.calibration.compensation.pose_sigma import ParameterCovariance, model_sigma
from ppmcal.calibration.fit.linearisation import (
    NormalStep,
    SummedStep,
    column_scale,
    parameter_scale,
    prior_weights,
)
from ppmcal.calibration.fit.prior_information import Posterior, PriorInformation, of_data
from ppmcal.calibration.fit.rank import analyse, observability, pivoted
from ppmcal.calibration.knowledge.extrapolation import FAR_OUTSIDE, STILL
from ppmcal.calibration.knowledge.identifiability_report import CALIPER, Scale
from ppmcal.calibration.knowledge.intervals import BLOCKS, LEAST_ROWS, _in_order, _near, by_blocks
from ppmcal.calibration.validation.left_out_rows import DoubtfulStretch
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.tables import pose_motor, pose_vector
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]


# --- one step -------------------------------------------------------------------------------------

def problem_of(seed: int, blind: int = 0) -> tuple[Array, Array, Array, NormalStep]:
    """Return A, b and the units of a least-squares problem, and its step."""
    rng = np.random.default_rng(seed)
    a, b, scale = rng.normal(size=(20, 5)), rng.normal(size=20), 10.0 ** rng.uniform(-3, 3, 5)
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    if blind:
        s[-blind:] = 0.0
        a = u @ np.diag(s) @ vt
    return a / scale, b, scale, NormalStep(s, u.T @ b, vt, scale)


@pytest.mark.parametrize("blind", [0, 2])
def test_a_plain_step_is_least_squares_and_keeps_what_it_promises(blind: int) -> None:
    """Of all that do as well it is the shortest, in natural units."""
    a, b, scale, small = problem_of(1, blind)
    x, gain = small.step()
    np.testing.assert_allclose(x / scale, np.linalg.lstsq(a * scale, b, rcond=1e-10)[0],
                               atol=1e-10)
    assert gain == pytest.approx(np.sum(b**2) - np.sum((b - a @ x) ** 2), rel=1e-9)


@pytest.mark.parametrize("damping", [1e-6, 1e-2, 1.0])
def test_a_damped_step_is_that_of_levenberg(damping: float) -> None:
    a, b, scale, small = problem_of(2)
    x, gain = small.step(damping)
    natural = a * scale
    strongest = np.linalg.norm(natural, 2) ** 2
    wanted = np.linalg.solve(natural.T @ natural + damping * strongest * np.eye(5), natural.T @ b)
    np.testing.assert_allclose(x / scale, wanted, atol=1e-9)
    assert gain == pytest.approx(np.sum(b**2) - np.sum((b - a @ x) ** 2), rel=1e-9)
    sums = SummedStep(natural.T @ natural, natural.T @ b, scale)
    summed, promised = sums.step(damping)
    np.testing.assert_allclose(summed / scale, wanted, atol=1e-9)
    assert promised == pytest.approx(gain, rel=1e-9)


def test_the_condition_is_that_of_unit_columns() -> None:
    """In the 1-norm, whatever the units; none where two columns are one."""
    rng = np.random.default_rng(3)
    a = rng.normal(size=(20, 4))
    matrix = a.T @ a
    size = np.sqrt(np.diagonal(matrix))
    unit = matrix / np.outer(size, size)
    wanted = np.linalg.norm(unit, 1) * np.linalg.norm(np.linalg.inv(unit), 1)
    for units in (np.ones(4), np.array([1e-6, 1.0, 1e4, 3.0])):
        step = SummedStep(matrix * np.outer(units, units), np.ones(4), np.ones(4))
        assert step.condition == pytest.approx(wanted, rel=1e-9)
    same = SummedStep(np.ones((2, 2)), np.ones(2), np.ones(2))
    nothing = SummedStep(np.diag([1.0, 0.0]), np.ones(2), np.ones(2))
    assert same.condition > 1e12
    assert nothing.condition == np.inf
    assert (nothing.step()[0].tolist(), nothing.step()[1]) == ([0.0, 0.0], 0.0)


def test_tolerances_are_priors_and_units() -> None:
    """Of a length without one a thousandth of the reach, of an angle a thousandth of a radian."""
    parameters = [SimpleNamespace(prior_sigma=p, size=s, quantity=q) for p, s, q in (
        (2e-5, 0.0, "length"), (None, 0.0, "length"), (None, 0.0, "angle"), (None, 7e-9, "1/N"))]
    problem: Any = SimpleNamespace(
        columns=("a", "b", "c", "d", "frame.x"), free=(0, 1, 2, 3), open_scale=lambda: np.ones(1),
        datasets=(), opens=(),
        mechanism=SimpleNamespace(parameters=parameters, reach=0.4))
    np.testing.assert_allclose(parameter_scale(problem), [2e-5, 4e-4, 1e-3, 7e-9])
    np.testing.assert_allclose(column_scale(problem), [2e-5, 4e-4, 1e-3, 7e-9, 1.0])
    np.testing.assert_allclose(prior_weights(problem, "prior"), [5e4, 0.0, 0.0, 0.0, 0.0])
    for method in ("flat", "damped"):
        assert not prior_weights(problem, method).any()


# --- rank -----------------------------------------------------------------------------------------

def test_dependent_columns_are_the_later_ones_and_are_made_of_the_kept() -> None:
    rng = np.random.default_rng(4)
    a = rng.normal(size=(12, 3))
    block = np.column_stack([a[:, 0], a[:, 1], 2.0 * a[:, 0] - 3.0 * a[:, 1], a[:, 2], a[:, 2]])
    kept, dropped, r = pivoted(block, 1e-9)
    assert dropped == sorted(dropped)
    assert 4 in dropped                     # of two that are alike the first in the file is kept
    assert len(kept) == 3
    arranged = block[:, kept + dropped]
    np.testing.assert_allclose(r.T @ r, arranged.T @ arranged, atol=1e-12)
    np.testing.assert_allclose(np.tril(r[:3, :3], -1), 0.0, atol=1e-12)
    found = analyse(np.linalg.qr(block)[1], 5, np.ones(5))
    np.testing.assert_allclose(block[:, found.kept] @ found.combination, block[:, found.dropped],
                               atol=1e-12)
    np.testing.assert_allclose(found.singular, np.linalg.svd(block)[1], atol=1e-12)


def test_rank_is_that_beside_open_frames_whatever_the_units() -> None:
    """A parameter that a frame imitates is not identifiable; mm or m make no difference."""
    rng = np.random.default_rng(5)
    frame = rng.normal(size=(30, 2))
    block = np.column_stack([rng.normal(size=(30, 2)), frame @ [1.0, -2.0]])
    for scale in (np.ones(3), np.array([1e-3, 1.0, 1e3])):
        triangle = np.linalg.qr(np.column_stack([block / scale, frame]))[1]
        found = analyse(triangle, 3, scale)
        assert (sorted(found.kept), found.dropped) == ([0, 1], (2,))
        alone = analyse(triangle[:, :3], 3, scale)
        assert sorted(alone.kept) == [0, 1, 2]


def test_observability_indices() -> None:
    found = observability(np.array([4.0, 2.0, 1.0, 1e-12]), 3, 25)
    assert found == pytest.approx({"O1": 2.0 / 5.0, "O2": 0.25, "O3": 1.0, "O4": 0.25,
                                   "O5": 4.0 / 7.0})
    assert set(observability(np.zeros(0), 0, 25).values()) == {0.0}
    for poses in (0, 1):
        assert observability(np.array([4.0, 1.0]), 2, poses)["O1"] == pytest.approx(2.0)


def test_a_distance_by_caliper_halves_what_is_uncertain() -> None:
    """Relative variances add as their inverses: 1/4 of what was."""
    scale = Scale(0.8, 2e-4, np.inf)
    before, caliper = 2e-4 / 0.8, CALIPER / scale.needed
    assert 1.0 / np.sqrt(before**-2 + caliper**-2) == pytest.approx(before / 2.0, rel=1e-12)
    assert Scale(0.8, 0.0, 0.0).needed == 0.0


@pytest.mark.parametrize(("sigma", "data", "prior", "lost", "left"), [
    (1e-4, 1.1e-4, False, False, False), (1e-4, 1.0, True, False, True),
    (1e-6, 1.0, True, False, False), (2e-3, 2e-3, False, False, True),
    (3e-2, 3e-2, False, True, True), (3e-2, 1.0, True, False, True)])
def test_who_knows_the_size(sigma: float, data: float, prior: bool, lost: bool, left: bool) -> None:
    """Tolerances where they know more than the data; nobody where neither does."""
    scale = Scale(1.0, sigma, data)
    assert (scale.prior_dominated, scale.unobservable, scale.open) == (prior, lost, left)


# --- what earlier data know -----------------------------------------------------------------------

def test_earlier_rows_and_their_slope() -> None:
    """Of a stiffness the rows are linear in its inverse; what is not free counts as it stands."""
    rng = np.random.default_rng(6)
    value = np.array([0.3, 2e7, -0.1])
    matrix, right = rng.normal(size=(5, 3)) / np.abs(value), rng.normal(size=5)
    earlier = PriorInformation((2, 0, 1), matrix[:, [2, 0, 1]], right, value[[2, 0, 1]])
    mechanism: Any = SimpleNamespace(parameters=[
        SimpleNamespace(reciprocal=r) for r in (False, True, False)])
    g = value * np.array([1.1, 0.7, 0.9])
    free = (1, 2)
    residual, jacobian = earlier.rows(mechanism, free, g)
    away = np.array([g[0] - value[0], value[1] - value[1] ** 2 / g[1], g[2] - value[2]])
    np.testing.assert_allclose(residual, right - matrix @ away, rtol=1e-12)
    np.testing.assert_allclose(earlier.rows(mechanism, free, value)[0], right, rtol=1e-12)
    for c, p in enumerate(free):
        step = np.zeros(3)
        step[p] = 1e-6 * abs(g[p])
        up, down = (earlier.rows(mechanism, free, g + s * step)[0] for s in (1.0, -1.0))
        np.testing.assert_allclose(jacobian[:, c], -(up - down) / (2.0 * step[p]), rtol=1e-6,
                                   atol=1e-9 * np.abs(jacobian[:, c]).max())


def test_data_with_frames_eliminated_are_the_schur_complement() -> None:
    rng = np.random.default_rng(7)
    scale = np.array([1.0, 1e-3, 1e3, 1.0])
    a, b = rng.normal(size=(40, 4)) / scale, rng.normal(size=(40, 2))
    residual = rng.normal(size=40)
    q, triangle = np.linalg.qr(np.concatenate([a, b], axis=1))
    matrix, right = of_data(triangle, q.T @ residual, 4, scale)
    off = np.eye(40) - b @ np.linalg.pinv(b)
    np.testing.assert_allclose(matrix.T @ matrix, a.T @ off @ a, rtol=1e-9)
    np.testing.assert_allclose(matrix.T @ right, a.T @ off @ residual, rtol=1e-9)


def test_the_posterior_is_data_and_tolerance() -> None:
    rng = np.random.default_rng(8)
    matrix = rng.normal(size=(6, 3)) * [1e3, 1e3, 0.0]
    scale, inflation = np.array([1e-3, 1e-3, 1e-2]), 2.0
    made = Posterior((0, 1, 2), np.zeros(3), matrix, np.ones(6), np.array([1e-3, np.inf, 5e-3]),
                     scale, inflation, {}, "a.json")
    information = matrix.T @ matrix / 4.0 + np.diag([1e6, 0.0, 4e4])
    np.testing.assert_allclose(sigma_of(made) ** 2, np.diagonal(np.linalg.inv(information)),
                               rtol=1e-9)
    data = made.data()
    np.testing.assert_allclose(data.matrix * 2.0, matrix)
    np.testing.assert_allclose(data.right * 2.0, 1.0)


# --- blocks ---------------------------------------------------------------------------------------

@pytest.mark.parametrize("count", [64, 67])
def test_blocks_share_the_rows_evenly(count: int) -> None:
    """In their order, or halved where joints are widest: neighbours are together."""
    q = np.random.default_rng(9).normal(size=(count, 3)) * [1.0, 5.0, 0.1]
    for label in (_in_order, _near):
        sizes = np.bincount(label(q), minlength=BLOCKS)
        assert sizes.sum() == count
        assert sizes.size == BLOCKS
        assert np.ptp(sizes) <= 1 + (label is _near)
    assert (np.diff(_in_order(q)) >= 0).all()
    block = _near(q)
    low = block % 2 == 0
    assert q[low, 1].max() <= q[~low, 1].min()
    assert _in_order(q[:0]).size == 0


def test_too_few_rows_tell_no_blocks_apart() -> None:
    few: Any = SimpleNamespace(keep=[np.ones(BLOCKS * LEAST_ROWS - 1, dtype=bool)],
                               problem=SimpleNamespace(free=(0,), earlier=None))
    assert by_blocks(few, 1.0) is None


# --- commands -------------------------------------------------------------------------------------

def machine() -> tuple[Mechanism, Array]:
    """Return a machine whose file is wrong by a tenth of a millimetre, and poses about home."""
    mechanism = ppmcal.load(ppmcal.shipped("6-UPS"))
    g = mechanism.values.copy()
    g[list(mechanism.free)] += 1e-4 * np.sin(np.arange(len(mechanism.free)) + 1.0)
    home = pose_vector(mechanism.home[None])
    wanted = np.repeat(home, 4, axis=0)
    wanted[:, :3] += 0.02 * np.random.default_rng(10).uniform(-1.0, 1.0, (4, 3))
    return mechanism.with_values(g), wanted


def test_commands_take_the_machine_to_where_it_is_wanted() -> None:
    """What is sent reaches the pose; what was sent before misses it as the nominal machine does."""
    mechanism, wanted = machine()
    found = compensate(mechanism, wanted, Registration())
    assert set(found.status) == {"ok"}
    reached = pose_vector(forward(Model(mechanism), found.q).pose)
    np.testing.assert_allclose(reached, wanted, atol=1e-9)
    assert found.position_after.max() < 1e-9
    assert found.rotation_after.max() < 1e-9
    missed = pose_vector(forward(Model(mechanism), found.q_nominal).pose)
    away = np.linalg.norm(missed[:, :3] - wanted[:, :3], axis=1)
    np.testing.assert_allclose(found.position_before, away, atol=1e-12)
    assert away.min() > 1e-5
    asked = pose_vector(forward(Model(mechanism.nominal()), found.q).pose)
    np.testing.assert_allclose(found.command, asked, atol=1e-9)
    assert np.isnan(found.sigma_position).all()


def knowledge(mechanism: Mechanism, sigma: float, **more: Any) -> ParameterCovariance:
    names = tuple(mechanism.names[p] for p in mechanism.free[:3])
    return ParameterCovariance(names, sigma**2 * np.eye(3), more.pop("volume", {}), {}, {}, **more)


def test_the_uncertainty_of_commands_is_that_of_the_parameters() -> None:
    """Three of them known to 20 um, each moved by that much; what is unexplained is added."""
    mechanism, wanted = machine()
    sigma, known = 2e-5, knowledge(machine()[0], 2e-5)
    found = compensate(mechanism, wanted, Registration(), known)
    moved = []
    for p in mechanism.free[:3]:
        ends = []
        for sign in (1.0, -1.0):
            g = mechanism.values.copy()
            g[p] += sign * sigma
            ends.append(forward(Model(mechanism, g), found.q, pose_motor(wanted)).pose)
        moved.append((pose_vector(ends[0]) - pose_vector(ends[1])) / 2.0)
    square = np.sum(np.square(moved), axis=0)
    position, rotation = (np.sqrt(square[:, c].sum(axis=1)) for c in (slice(3), slice(3, 6)))
    np.testing.assert_allclose(found.sigma_position, position, rtol=1e-4)
    np.testing.assert_allclose(found.sigma_rotation, rotation, rtol=1e-2)
    more = replace(known, unexplained=(3e-5, 4e-5))
    found = compensate(mechanism, wanted, Registration(), more)
    np.testing.assert_allclose(found.sigma_position, np.hypot(position, 3e-5), rtol=1e-4)
    np.testing.assert_allclose(found.sigma_rotation, np.hypot(rotation, 4e-5), rtol=1e-2)
    np.testing.assert_allclose(
        model_sigma(mechanism, wanted, Registration(), more, "", {})[0], found.sigma_position,
        rtol=1e-9)


def test_what_a_stretch_misses_is_added_there_only() -> None:
    mechanism, _ = machine()
    stretch = DoubtfulStretch(mechanism.actuators[1], 0.2, 0.3, 4e-5, 3e-4)
    known = knowledge(mechanism, 1e-5, unexplained=(3e-5, 4e-4), doubtful=(stretch,))
    q = np.zeros((2, 6))
    q[:, 1] = 0.25, 0.35
    np.testing.assert_allclose(known.missed(q, mechanism.actuators),
                               [[5e-5, 5e-4], [3e-5, 4e-4]], rtol=1e-12)


@pytest.mark.parametrize(("beyond", "fine"), [(-0.01, True), (0.01, False)])
def test_far_outside_what_was_measured_is_refused(beyond: float, fine: bool) -> None:
    """By half of the measured width, on either side; nearer is foretold by the model.

    And by a thousandth of the reach more: what was measured at one value holds around it.
    """
    mechanism, wanted = machine()
    width = 0.04
    for side in (1.0, -1.0):
        edge = wanted[0, 0] - side * ((FAR_OUTSIDE + beyond) * width + STILL * mechanism.reach)
        ends = (edge - width, edge) if side > 0 else (edge, edge + width)
        known = knowledge(mechanism, 1e-5, volume={"x": ends})
        found = compensate(mechanism, wanted[:1], Registration(), known)
        assert (found.status[0] == "ok") == fine
        assert fine or "far outside the measured volume: x" in found.reason[0]
        assert np.isnan(found.q).all() != fine
