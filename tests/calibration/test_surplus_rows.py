"""What rows of a machine with surplus equations tell, against poses that are unknowns in full."""

import numpy as np
import pytest
from helpers.redundant import cables, gapped, machine, stewart
from scipy.optimize import least_squares

from ppmcal import algebra as cga
from ppmcal.calibration.fit.normal_equations import normal_sums
from ppmcal.calibration.fit.problem import Problem
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.inverse import inverse
from ppmcal.model.dataset import Dataset

JOINT, PLACE, TURN = 2e-4, 1e-4, 5e-4


@pytest.fixture(scope="module", params=[
    cables, stewart, lambda: gapped(cables()), lambda: gapped(stewart())],
    ids=["cables", "stewart", "cables that gap", "stewart that gaps"])
def bench(request, tmp_path_factory):
    """A machine, its rows as a problem, and the state at its nominal values."""
    mechanism = machine(tmp_path_factory.mktemp("m"), request.param())
    rng = np.random.default_rng(2)
    step = np.zeros((12, 6))
    step[:, mechanism.dof] = rng.uniform(-0.1, 0.1, (12, len(mechanism.dof)))
    there = moved(np.tile(mechanism.home, (12, 1)), step)
    q = inverse(Model(mechanism), there).q
    seen = np.concatenate([cga.translation(there), cga.rotation_vector(there)], axis=1)
    seen += rng.normal(size=seen.shape) * np.repeat([PLACE, TURN], 3)
    if mechanism.motion.planar:
        seen[:, 2:5] = np.nan
    data = Dataset.of_poses("d", q + rng.normal(0.0, JOINT, q.shape), seen, (PLACE, TURN), False)
    object.__setattr__(data, "sigma_actuator", np.full(q.shape[1], JOINT))
    problem = Problem(mechanism, (data,), mechanism.free)
    return problem, problem.start()


def residual(problem, state, row, x, step):
    """Return white residuals of one row at a pose ``x`` (d,) from its own, parameters moved."""
    mechanism, data = problem.mechanism, problem.datasets[0]
    g = state.g.copy()
    g[list(problem.free)] += step
    twist = np.zeros((1, 6))
    twist[:, mechanism.dof] = x
    pose = moved(state.poses[0][row:row + 1], twist)
    closure = Model(mechanism, g).closure(data.q[row:row + 1])
    gaps = [mechanism.gaps.get(limb.name, 0.0) for limb in mechanism.limbs]
    noise = np.hypot(np.diagonal(closure.joint_matrix(pose)[0]) * JOINT, gaps)
    own = [closure.misclosure(pose)[0] / noise]
    seen = np.concatenate([cga.translation(pose)[0], cga.rotation_vector(pose)[0]])
    measured = np.concatenate([data.position[row], data.rotation[row]])
    away = (measured - seen) / np.repeat([PLACE, TURN], 3)
    return np.concatenate([*own, away[np.isfinite(measured)]])


@pytest.mark.slow
def test_chi_squared_is_that_of_the_most_likely_poses(bench):
    problem, state = bench
    keep = [np.ones(12, dtype=bool)]
    found = normal_sums(problem, state, keep)
    still, d = np.zeros(len(problem.free)), len(problem.mechanism.dof)
    best = [least_squares(lambda x, n=n: residual(problem, state, n, x, still), np.zeros(d),
                          xtol=1e-15, ftol=1e-15, gtol=1e-15).cost * 2.0 for n in range(12)]
    # the scale of the closure moves with the pose by noise over length
    np.testing.assert_allclose(found.square, sum(best), rtol=1e-3)
    extra = problem.mechanism.surplus
    measured = 3 if problem.mechanism.motion.planar else 6
    assert found.count == 12 * (measured + extra)


@pytest.mark.long_cases("stewart", "stewart that gaps")
@pytest.mark.slow
def test_information_is_that_with_the_poses_eliminated(bench):
    """The normal equations of parameters and poses together, less the poses (Schur complement)."""
    problem, state = bench
    found = normal_sums(problem, state, [np.ones(12, dtype=bool)]).matrix
    d, size = len(problem.mechanism.dof), len(problem.free)
    total = np.zeros((size, size))
    for n in range(12):
        best = least_squares(lambda x, n=n: residual(problem, state, n, x, np.zeros(size)),
                             np.zeros(d), xtol=1e-15, ftol=1e-15, gtol=1e-15).x

        def at(v, n=n, best=best):
            return residual(problem, state, n, best + v[:d], v[d:])

        h = 1e-7
        columns = [(at(h * e) - at(-h * e)) / (2 * h) for e in np.eye(d + size)]
        whole = np.stack(columns, axis=1)
        normal = whole.T @ whole
        total += normal[d:, d:] - normal[d:, :d] @ np.linalg.solve(normal[:d, :d], normal[:d, d:])
    scale = np.sqrt(np.diagonal(total))
    np.testing.assert_allclose(found / scale / scale[:, None], total / scale / scale[:, None],
                               atol=5e-3)


@pytest.mark.long_cases("stewart", "stewart that gaps")
@pytest.mark.slow
def test_the_gradient_is_exact(bench):
    """Chi-squared's own differences, though what eliminates the poses is held in a step."""
    problem, state = bench
    keep = [np.ones(12, dtype=bool)]
    gradient = normal_sums(problem, state, keep).gradient
    scale = np.sqrt(np.diagonal(normal_sums(problem, state, keep).matrix))
    for column, size in enumerate(1e-3 / scale):
        step = np.zeros(len(problem.columns))
        step[column] = size
        ends = [normal_sums(problem, problem.moved(state, sign * step), keep).square
                for sign in (1.0, -1.0)]
        slope = -(ends[0] - ends[1]) / (4.0 * size)
        assert abs(slope - gradient[column]) < 2e-2 * scale[column]
