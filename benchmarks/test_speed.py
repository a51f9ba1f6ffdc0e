"""How much of a fit is linear algebra, how it grows, and where the rest of the time goes.

    python -m pytest benchmarks/test_speed.py --benchmark-only -o addopts= -s

The machine is a six-leg platform with points, offsets and drive ratios free: 48 parameters,
measured in full from an unknown place.
"""

from __future__ import annotations

import cProfile
import os
import pstats
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
import pytest  # noqa: E402
import yaml  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from ppmcal.calibration.fit import (  # noqa: E402
    Fit,
    FitOptions,
    identify,
)
from ppmcal.calibration.fit.problem import CHUNK, Problem  # noqa: E402
from ppmcal.io import read_mechanism, read_scenario  # noqa: E402
from ppmcal.kinematics.closure import Model  # noqa: E402
from ppmcal.kinematics.forward import forward  # noqa: E402
from ppmcal.kinematics.registration import predict  # noqa: E402
from ppmcal.kinematics.tables import inverse_table, pose_vector  # noqa: E402
from ppmcal.model.dataset import Dataset, Unknown  # noqa: E402
from ppmcal.model.instruments import POSE  # noqa: E402
from ppmcal.model.registration import Registration  # noqa: E402

Array = NDArray[np.float64]

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
TOP = 10


@cache
def problem_of(count: int) -> Problem:
    """Return ``count`` noisy poses of a six-leg machine with errors in all 48 parameters."""
    tree = yaml.safe_load((CONFIGS / "6-UPS.yaml").read_text(encoding="utf-8"))
    for limb in tree["limbs"]:
        limb["ratio"] = {"value": 10.0, "tolerance": 0.005}
    del tree["limits"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "machine.yaml"
        path.write_text(yaml.safe_dump(tree), encoding="utf-8")
        mechanism = read_mechanism(path)
    assert len(mechanism.free) == 48
    scenario = read_scenario(CONFIGS / "scenarios" / "6-UPS.yaml", mechanism)
    rng = np.random.default_rng(1)
    half = scenario.poses.half_range  # type: ignore[union-attr]
    wanted = scenario.poses.center + rng.uniform(-1.0, 1.0, (count, 6)) * half  # type: ignore[union-attr]
    q = inverse_table(Model(mechanism), wanted).q
    g = mechanism.nominals.copy()
    for p in mechanism.free:
        g[p] += (mechanism.parameters[p].tolerance or 0.0) * rng.normal()
    pose = forward(Model(mechanism, g), q).pose
    registration = Registration.of_pose(scenario.frame, scenario.target)
    sigma = np.repeat([scenario.sigma_position, scenario.sigma_rotation], 3)
    seen, turn = predict(registration, pose)
    vector = pose_vector(_motors(turn)) + rng.normal(size=(count, 6)) * sigma
    data = Dataset(
        name="a", source="a", kind=POSE, rows=np.arange(1, count + 1), q=q, commanded=None,
        position=seen + vector[:, :3], rotation=vector[:, 3:], value=np.full(count, np.nan),
        to_q=None, sigma_position=np.tile(sigma[:3], (count, 1)),
        sigma_rotation=np.tile(sigma[3:], (count, 1)), sigma_value=np.ones(count),
        sigma_actuator=np.zeros(6), groups=np.arange(count), columns={}, sessions=None,
        frame=Unknown(True, np.zeros(6)), target=Unknown(True, np.zeros(3)),
        target_rotation=Unknown(False, np.zeros(3)))
    return Problem(mechanism, (data,), mechanism.free)


def _motors(turn: Array) -> Array:
    from ppmcal import algebra as cga

    return cga.motor_from_matrix(turn, np.zeros(3))


@contextmanager
def counted() -> Iterator[list[int]]:
    """Count how often a fit reduces all its rows to a triangle."""
    from ppmcal.calibration.fit import fitting as loop
    from ppmcal.calibration.fit import gauss_newton
    from ppmcal.calibration.fit import linearisation as least_squares

    calls = [0]
    plain = least_squares.qr_factor

    def counting(*args: object, **more: object) -> object:
        calls[0] += 1
        return plain(*args, **more)  # type: ignore[arg-type]

    places = [m for m in (least_squares, gauss_newton, loop) if hasattr(m, "qr_factor")]
    with pytest.MonkeyPatch.context() as patch:
        for m in places:
            patch.setattr(m, "qr_factor", counting)
        yield calls


def algebra_alone(blocks: list[Array], times: int) -> float:
    """Seconds for the accumulated QR of the same rows in the same chunks, so many times."""
    began = time.perf_counter()
    for _ in range(times):
        stack = np.zeros((0, blocks[0].shape[1]))
        for block in blocks:
            stack = np.linalg.qr(np.concatenate([stack, block]), mode="r")
    return time.perf_counter() - began


def rows_of(fit: Fit) -> list[Array]:
    return [np.concatenate([r.jacobian, r.residual[..., None]], axis=-1).reshape(
        -1, len(fit.problem.columns) + 1) for r in fit.problem.rows(fit.state)]


def best(problem: Problem, options: FitOptions, repeats: int = 2) -> float:
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        identify(problem, options)
        seconds.append(time.perf_counter() - began)
    return min(seconds)


@pytest.mark.parametrize("robust", [False, True], ids=["plain", "robust"])
def test_a_fit_of_ten_thousand_poses(benchmark, robust: bool) -> None:  # type: ignore[no-untyped-def]
    problem, options = problem_of(10_000), FitOptions(robust=robust)
    fit = benchmark.pedantic(identify, (problem, options), rounds=2, iterations=1)
    assert fit.converged
    with counted() as calls:
        identify(problem, options)
    blocks = rows_of(fit)
    assert all(len(b) <= 6 * CHUNK for b in blocks)
    algebra = min(algebra_alone(blocks, calls[0]) for _ in range(2))
    whole = benchmark.stats.stats.min
    print(f"\n{'robust' if robust else 'plain'}: fit {whole:.2f} s, {calls[0]} reductions, QR of "
          f"the same rows {algebra:.2f} s: ratio {whole / algebra:.2f}")


def test_growth_from_a_thousand_to_ten_thousand() -> None:
    options = FitOptions(robust=False)
    small, large = best(problem_of(1_000), options), best(problem_of(10_000), options)
    print(f"\n1000 poses {small:.3f} s, 10000 poses {large:.3f} s: factor {large / small:.1f}")


def test_where_the_time_goes() -> None:
    problem = problem_of(10_000)
    problem = replace(problem)
    profile = cProfile.Profile()
    profile.runcall(identify, problem, FitOptions(robust=False))
    stats = pstats.Stats(profile)
    total = stats.total_tt  # type: ignore[attr-defined]
    entries = sorted(stats.stats.items(), key=lambda e: -e[1][2])  # type: ignore[attr-defined]
    print(f"\n{total:.2f} s in all; own time, then with callees")
    for (file, line, name), (_, calls, own, with_callees, _) in entries[:TOP]:
        place = f"{Path(file).name}:{line}" if line else ""
        print(f"{own / total:6.1%} {with_callees / total:6.1%} {calls:7} {name} {place}")
