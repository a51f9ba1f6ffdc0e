"""A map of the 126-parameter error amplification index, beside the raw linear algebra.

    python -m pytest benchmarks/test_map_speed.py --benchmark-only -o addopts= -s

100 x 100 poses of the Linapod. The same matrices A (10^4, 6, 6) and Bg (10^4, 6, 126) go through
numpy.linalg; making them is not counted there. The map needs neither Bg nor J_g as a whole: it
builds the legs' lines, A and each leg's columns, and sums squares leg by leg.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
import pytest  # noqa: E402

from ppmcal.design.error_jacobian import Poses, covariance, root_sum_square  # noqa: E402
from ppmcal.design.error_sources import all_components  # noqa: E402
from ppmcal.io import read_mechanism  # noqa: E402
from ppmcal.kinematics.closure import Model  # noqa: E402
from ppmcal.kinematics.inverse import inverse  # noqa: E402
from ppmcal.kinematics.partial_pose import pose_motor  # noqa: E402
from ppmcal.kinematics.region import slice_grid  # noqa: E402

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
ROUNDS = 9


def best(work: Callable[[], object]) -> float:
    """Return the shortest of some runs, s."""
    times = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def test_map(benchmark: object) -> None:
    machine = all_components(read_mechanism(CONFIGS / "linapod.yaml"))
    model, free = Model(machine), list(machine.free)
    grid = slice_grid(machine, (0, 1), (100, 100), {0: (-0.3, 0.3), 1: (-0.3, 0.3)})
    pose = pose_motor(grid.poses(machine))
    at = Poses(inverse(model, pose).q, pose, np.zeros(3))
    ones = np.ones(len(free))

    def index() -> np.ndarray:
        return root_sum_square(covariance(model, at, free, ones))[0]

    closure = model.closure(at.q, free)
    a, b = closure.pose_matrix(pose), closure.error_matrix(pose, free)

    def raw() -> np.ndarray:
        return np.sqrt(np.sum(np.linalg.solve(a, b)[:, :3] ** 2, axis=(1, 2)))

    def outer() -> np.ndarray:
        return np.sqrt(np.sum((np.linalg.inv(a) @ b)[:, :3] ** 2, axis=(1, 2)))

    np.testing.assert_allclose(index(), raw(), rtol=1e-9)
    ours, solved, inverted = best(index), best(raw), best(outer)
    joints = best(lambda: inverse(model, pose))
    print(f"\n100 x 100 poses, 126 errors: index {1e3 * ours:.0f} ms (lines, A, Bg and all); "
          f"numpy.linalg.solve on ready matrices {1e3 * solved:.0f} ms, ratio "
          f"{ours / solved:.2f}; numpy.linalg.inv and a product {1e3 * inverted:.0f} ms, ratio "
          f"{ours / inverted:.2f}; inverse kinematics before it {1e3 * joints:.0f} ms")
    benchmark(index)  # type: ignore[operator]


if __name__ == "__main__":
    pytest.main([__file__, "--benchmark-only", "-o", "addopts=", "-s"])
