"""When a fit is at its minimum, and that it is the same one from wherever it starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.campaigns_in_files import run
from helpers.paths import ROOT

from ppmcal.calibration.fit.fit_result import Fit, FitOptions, posterior
from ppmcal.calibration.fit.fitting import identify, loss
from ppmcal.calibration.fit.linearisation import normal_step, parameter_scale
from ppmcal.calibration.fit.problem import Problem, squares_by_noise_of, white_squares
from ppmcal.calibration.fit.registration_freedoms import opened, significant_improvement
from ppmcal.calibration.validation.frozen_models import _worth
from ppmcal.io import read_mechanism, read_scenario


def left_to_gain(fit: Fit) -> float:
    return normal_step(fit.problem, fit.state, fit.information, fit.prior).step()[1]


def bent(seed: int) -> Problem:
    """Joints that are known ten times worse than the pose, and bent by far more than that."""
    mechanism = read_mechanism(ROOT / "configs" / "3-RPR.yaml")
    scenario = read_scenario(ROOT / "configs" / "scenarios" / "3-RPR.yaml", mechanism)
    made = run(mechanism, replace(scenario, sigma_actuator=np.full(3, 2e-5)), seed)
    q = made.data.q
    middle = q.mean(axis=0)
    data = replace(made.data, q=q + 200e-5 * ((q - middle) / np.ptp(q, axis=0)) ** 2
                   + np.random.default_rng(seed).normal(scale=100e-5, size=q.shape))
    return replace(made.problem, datasets=(data,))


@pytest.mark.parametrize("seed", [0, 2, 6])
def test_noise_of_joints_that_moves_with_the_geometry_does_not_hide_the_minimum(seed: int) -> None:
    """Each step lowers chi-squared with the noise as it was, and raises it with the new one."""
    problem = bent(seed)
    fit = identify(problem, FitOptions(robust=False))
    assert fit.converged
    assert left_to_gain(fit) < 1e-5

    free = list(problem.free)
    g = problem.mechanism.values.copy()
    g[free] += np.where(np.arange(len(free)) % 2, 1.0, -1.0) * parameter_scale(problem)
    start = problem.solve(replace(problem.start(), g=g))
    other = identify(problem, FitOptions(robust=False), start)
    away = (other.state.g - fit.state.g)[free] / np.sqrt(np.diagonal(posterior(fit)))[:len(free)]
    assert other.converged
    assert np.max(np.abs(away)) < 1e-3


def hardly_turning(seed: int, joints: float) -> Problem:
    """A planar machine that misses by centimetres, whose platform turns by half a degree."""
    mechanism = read_mechanism(ROOT / "configs" / "3-RPR.yaml")
    scenario = read_scenario(ROOT / "configs" / "scenarios" / "3-RPR.yaml", mechanism)
    poses = replace(scenario.poses, swing=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.01]))
    made = run(mechanism, replace(scenario, poses=poses, error_scale=30.0, target=np.zeros(3),
                                  sigma_actuator=np.full(3, joints)), seed)
    return replace(made.problem, free=())


@pytest.mark.parametrize("seed", [2, 4])
@pytest.mark.slow
def test_a_registration_with_more_open_never_fits_worse(seed: int) -> None:
    """The closed form of frame and target together is decimetres off, of the frame alone not."""
    wide = hardly_turning(seed, 1e-3)
    data = wide.datasets[0]
    target = replace(data.target, fitted=False)
    narrow = replace(wide, datasets=(replace(data, target=target),))
    for robust in (False, True):
        before, after = (identify(p, FitOptions(method="flat", robust=robust))
                         for p in (narrow, wide))
        assert loss(after, robust) < (0, loss(before, robust)[1] * (1.0 + 1e-6))


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.slow
def test_registrations_are_compared_by_one_noise(seed: int) -> None:
    """Noise of joints moves with the target: by its own the wider registration seems the worse."""
    problem = hardly_turning(seed, 1e-3)
    data, rows = problem.datasets[0], [np.ones(len(problem.datasets[0]), dtype=bool)]
    narrow, wide = (identify(replace(problem, datasets=(opened(data, words, True),)),
                             FitOptions(method="flat", robust=False))
                    for words in (("frame", "rotation"), ("frame", "target", "rotation")))
    one, other = ((f.problem, f.state) for f in (narrow, wide))
    least = white_squares(*other, rows)[0]
    assert white_squares(*one, rows)[0] < least
    assert squares_by_noise_of(one, other, rows) > 1.5 * least
    assert significant_improvement(squares_by_noise_of(one, other, rows),
                                   least) > 0.2 and _worth(narrow, wide)
