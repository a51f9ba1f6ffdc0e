"""Kinematics, one iteration and a whole fit beside the linear algebra they cannot do without.

    python benchmarks/test_kernel_speed.py

All in one process, CPU time, medians; read the ratios. J_g is that of the Linapod with 126 errors.
The fit is that of `test_speed.py`: a six-leg platform, 48 parameters, frame and target, 57 columns.
The floor of an iteration is dsyrk and dpotrf on a Jacobian that is there already. scipy gets the
same residuals, the same Jacobian and the same start, all columns in their natural units.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpotrf
from scipy.optimize import least_squares as scipy_least_squares
from test_speed import CONFIGS, problem_of

from ppmcal.calibration.fit import Problem, State, column_scale, prior_weights
from ppmcal.calibration.fit.gauss_newton import cost, least_squares, linearised
from ppmcal.design.error_jacobian import Poses, error_jacobian
from ppmcal.design.error_sources import all_components
from ppmcal.io import read_mechanism
from ppmcal.kinematics import compiled_limbs
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, newton
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

SMALL, LARGE, HUGE = 60, 10_000, 100_000
STEP = 1e-6
"""Of central differences, m and rad."""


def seconds(work: Callable[[], object], rounds: int = 7) -> float:
    """Return the median CPU time of some runs after a first."""
    work()
    times = []
    for _ in range(rounds):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return statistics.median(times)


@contextmanager
def numpy_alone() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled_limbs, "MANY", 10**9)
        yield


@cache
def linapod(count: int) -> tuple[Mechanism, Poses]:
    """Return the machine with 126 errors free and poses all over its field of work."""
    machine = all_components(read_mechanism(CONFIGS / "linapod.yaml"))
    rng = np.random.default_rng(1)
    wanted = np.tile(machine.home_pose, (count, 1))
    wanted[:, :2] = rng.uniform(-0.3, 0.3, (count, 2))
    wanted[:, 3:] += rng.uniform(-0.05, 0.05, (count, 3))
    pose = pose_motor(wanted)
    return machine, Poses(inverse(Model(machine), pose).q, pose, np.zeros(3))


def gram(jacobian: Array) -> float:
    """Seconds for dsyrk of a Jacobian that is there."""
    flat = np.asfortranarray(jacobian.reshape(-1, jacobian.shape[-1]))
    return seconds(lambda: dsyrk(1.0, flat, trans=1))


def differences(machine: Mechanism, at: Poses, columns: list[int]) -> float:
    """Seconds a column for central differences: Newton from the pose at g + h and g - h."""
    def one() -> None:
        for p in columns:
            for sign in (-1.0, 1.0):
                g = machine.values.copy()
                g[p] += sign * STEP
                newton(Model(machine, g).closure(at.q), at.motor)

    return seconds(one, 3) / len(columns)


@pytest.mark.parametrize("count", [SMALL, LARGE])
def test_error_jacobian(benchmark, count: int) -> None:  # type: ignore[no-untyped-def]
    machine, at = linapod(count)
    free = list(machine.free)
    jacobian = error_jacobian(Model(machine), at, free)
    with numpy_alone():
        plain = seconds(lambda: error_jacobian(Model(machine), at, free), 3)
        slow = differences(machine, at, free[::30]) * len(free)
    quick = differences(machine, at, free[::30]) * len(free)
    ours, floor = seconds(lambda: error_jacobian(Model(machine), at, free)), gram(jacobian)
    us = 1e6 / count
    print(f"\nJ_g, {len(free)} errors, {count} poses, us a pose: {us * ours:.2f}, by NumPy alone "
          f"{us * plain:.1f}; dsyrk of it {us * floor:.2f}, ratio {ours / floor:.2f}; central "
          f"differences by NumPy {slow / ours:.0f} times as long, compiled {quick / ours:.0f}")
    benchmark(lambda: error_jacobian(Model(machine), at, free))


@pytest.mark.parametrize("count", [SMALL, LARGE])
def test_forward(benchmark, count: int) -> None:  # type: ignore[no-untyped-def]
    machine, at = linapod(count)
    found = forward(Model(machine), at.q)
    assert found.converged.all()
    ours = seconds(lambda: forward(Model(machine), at.q))
    print(f"\nforward kinematics from home, {count} poses, us a pose: {1e6 * ours / count:.2f}")
    benchmark(lambda: forward(Model(machine), at.q))


@dataclass(frozen=True)
class Run:
    """A problem with its prior, started."""

    problem: Problem
    start: State
    keep: list[np.ndarray]
    prior: Array

    @classmethod
    def of(cls, count: int) -> Run:
        problem = problem_of(count)
        return cls(problem, problem.start(), [np.ones(count, dtype=bool)],
                   prior_weights(problem, "prior"))

    def iteration(self, state: State) -> State:
        """One iteration: linearise, step, poses anew, cost."""
        now = linearised(self.problem, state, self.keep, self.prior)
        trial = self.problem.moved(state, now.small.step()[0])
        cost(self.problem, trial, self.keep, self.prior, None)
        return trial

    def jacobian(self, state: State) -> Array:
        return np.concatenate([r.jacobian for r in self.problem.rows(state)]).reshape(
            -1, len(self.problem.columns))


@pytest.mark.parametrize("count", [SMALL, 1000, LARGE, HUGE])
def test_iteration(benchmark, count: int) -> None:  # type: ignore[no-untyped-def]
    run = Run.of(count)
    state = run.iteration(run.start)
    jacobian = np.asfortranarray(run.jacobian(state) * column_scale(run.problem))

    def floor() -> None:
        matrix = dsyrk(1.0, jacobian, trans=1)
        matrix[np.diag_indices_from(matrix)] += 1.0
        dpotrf(matrix)

    ours, least = seconds(lambda: run.iteration(state)), seconds(floor)
    print(f"\none iteration, {jacobian.shape[1]} columns, {count} poses: {1e3 * ours:.2f} ms; "
          f"dsyrk and dpotrf {1e3 * least:.2f} ms, ratio {ours / least:.1f}")
    benchmark(lambda: run.iteration(state))


class Scipy:
    """The same problem for scipy: columns in natural units, prior as rows."""

    def __init__(self, run: Run) -> None:
        self.run, self.scale = run, column_scale(run.problem)
        self.prior = run.prior * self.scale
        self.at: tuple[Array, State] = (np.zeros(self.scale.size), run.start)

    def state(self, x: Array) -> State:
        """Return the state at x; as ours do, from the last one on: frames add up turn by turn."""
        if not np.array_equal(x, self.at[0]):
            step = (x - self.at[0]) * self.scale
            self.at = (x.copy(), self.run.problem.moved(self.at[1], step))
        return self.at[1]

    def residual(self, x: Array) -> Array:
        state = self.state(x)
        rows = [r.residual.ravel() for r in self.run.problem.rows(state, False)]
        free = list(self.run.problem.free)
        away = np.zeros(self.scale.size)
        away[:len(free)] = state.g[free] - self.run.problem.mechanism.nominals[free]
        return np.concatenate([*(-r for r in rows), self.run.prior * away])

    def jacobian(self, x: Array) -> Array:
        return np.concatenate([self.run.jacobian(self.state(x)) * self.scale,
                               np.diag(self.prior)])


def ceres(run: Run) -> State:
    """Return where Ceres ends with the same residuals and Jacobian, in the units of scipy's."""
    pyceres = pytest.importorskip("pyceres")
    other = Scipy(run)
    x = np.zeros(other.scale.size)

    class Rows(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(other.residual(x).size)
            self.set_parameter_block_sizes([x.size])

        def Evaluate(self, parameters, residuals, jacobians) -> bool:  # type: ignore[no-untyped-def]
            at = np.array(parameters[0])
            residuals[:] = other.residual(at)
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = other.jacobian(at).ravel()
            return True

    problem, options, rows = pyceres.Problem(), pyceres.SolverOptions(), Rows()
    problem.add_residual_block(rows, None, [x])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_NORMAL_CHOLESKY
    options.function_tolerance, options.gradient_tolerance = 1e-15, 1e-15
    options.parameter_tolerance, options.num_threads, options.max_num_iterations = 1e-12, 1, 200
    options.minimizer_progress_to_stdout = False
    pyceres.solve(options, problem, pyceres.SolverSummary())
    return other.state(x)


@pytest.mark.parametrize("count", [SMALL, LARGE])
def test_whole_fit_of_ceres(benchmark, count: int) -> None:  # type: ignore[no-untyped-def]
    """Skipped where pyceres is not installed, which nothing else needs."""
    run = Run.of(count)
    free = list(run.problem.free)
    unit = column_scale(run.problem)[:len(free)]

    def ours() -> State:
        return least_squares(run.problem, run.start, run.keep, run.prior, 60).state

    state, there = ours(), ceres(run)
    apart = np.abs((there.g - state.g)[free] / unit).max()
    mine, spent = seconds(ours, 3), seconds(lambda: ceres(run), 1)
    print(f"\nwhole fit, {count} poses: {1e3 * mine:.0f} ms; Ceres {1e3 * spent:.0f} ms, "
          f"{spent / mine:.1f} times, optimum {apart:.0e} tolerances apart")
    benchmark.pedantic(ours, rounds=2, iterations=1)


@pytest.mark.parametrize("count", [SMALL, LARGE])
def test_whole_fit(benchmark, count: int) -> None:  # type: ignore[no-untyped-def]
    run = Run.of(count)

    def ours() -> State:
        return least_squares(run.problem, run.start, run.keep, run.prior, 60).state

    def theirs(method: str) -> State:
        other = Scipy(run)
        found = scipy_least_squares(other.residual, np.zeros(other.scale.size), other.jacobian,
                                    method=method, xtol=1e-12, ftol=1e-12, gtol=1e-12)
        return other.state(found.x)

    state = ours()
    free = list(run.problem.free)
    unit = column_scale(run.problem)[:len(free)]
    time_ours = seconds(ours, 3)
    told = []
    for method in ("lm", "trf"):
        apart = np.abs((theirs(method).g - state.g)[free] / unit).max()
        spent = seconds(lambda method=method: theirs(method), 1)
        told.append(f"scipy {method} {1e3 * spent:.0f} ms, {spent / time_ours:.1f} times, optimum "
                    f"{apart:.0e} tolerances apart")
    print(f"\nwhole fit, {len(run.problem.columns)} columns, {count} poses: {1e3 * time_ours:.0f} "
          f"ms; {'; '.join(told)}")
    benchmark.pedantic(ours, rounds=2, iterations=1)


if __name__ == "__main__":
    pytest.main([__file__, "--benchmark-only", "-q", "-s", "-o", "addopts="])
