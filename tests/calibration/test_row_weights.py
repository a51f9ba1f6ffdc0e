"""A row's weight in the fit: the same in estimates, intervals, freedom and predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from campaigns import dataset, load
from numpy.typing import NDArray

from ppmcal import linalg
from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Problem,
    distances,
    identify,
    least_squares,
    noise_check,
    prediction_covariance,
    residual_freedom,
    values_taken,
)
from ppmcal.calibration.fit.normal_equations import normal_sums, row_squares
from ppmcal.calibration.fit.row_distances import Distances
from ppmcal.calibration.fit.row_weighing import fit_rows
from ppmcal.diagnosis.linear_system import build
from ppmcal.inference.priors import NO_WEIGHT
from ppmcal.kinematics.compiled_limbs import MANY
from ppmcal.model.dataset import Dataset
from ppmcal.simulation.simulate import simulate

Array = NDArray[np.float64]
ROW = 11


@pytest.fixture(scope="module")
def campaign() -> tuple[Problem, Fit]:
    mechanism, scenario = load("3-RPR")
    data = dataset(mechanism, scenario, simulate(mechanism, scenario, 3), "a")
    problem = Problem(mechanism, (data,), mechanism.free)
    return problem, identify(problem)


def off(fit: Fit, times: float) -> Dataset:
    """The data set with one row's x so many sigmas from where the fit has it."""
    rows = next(fit.problem.rows(fit.state, False))
    (data,) = fit.problem.datasets
    position = data.position.copy()
    sigma = float(data.sigma_position[ROW, 0])
    position[ROW, 0] += times * sigma - float(rows.raw[ROW, 0])
    return replace(data, position=position)


def again(fit: Fit, data: Dataset) -> Fit:
    return identify(replace(fit.problem, datasets=(data,)), start=fit.state, near=True)


def test_a_weight_is_a_larger_noise_of_the_row(campaign: tuple[Problem, Fit]) -> None:
    """In the minimum and the covariance; values count by it too."""
    problem, fit = campaign
    weight = np.random.default_rng(1).uniform(0.1, 1.0, len(problem.datasets[0]))
    (data,) = problem.datasets
    scale = 1.0 / np.sqrt(weight)[:, None]
    noisy = replace(problem, datasets=(replace(
        data, sigma_position=scale * data.sigma_position,
        sigma_rotation=scale * data.sigma_rotation),))
    ends = [fit_rows(p, fit.state, fit.keep, fit.reasons, fit.prior, FitOptions())
            for p in (problem.weighted([weight]), noisy)]
    np.testing.assert_allclose(ends[0].state.g, ends[1].state.g, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(*(prediction_covariance(e) for e in ends), rtol=1e-6, atol=1e-18)
    assert ends[0].information.count == pytest.approx(3.0 * weight.sum())
    assert ends[0].information.square == pytest.approx(ends[1].information.square)
    assert residual_freedom(ends[0]) == pytest.approx(3.0 * weight.sum() - values_taken(ends[1]))


@pytest.mark.slow
def test_compiled_rows_have_the_weights_of_those_of_numpy(campaign: tuple[Problem, Fit]) -> None:
    problem, fit = campaign
    many = np.tile(np.arange(len(problem.datasets[0])), 2 * MANY)[:2 * MANY]
    weight = np.random.default_rng(1).uniform(0.1, 1.0, many.size)
    weighted = replace(problem, datasets=(problem.datasets[0].take(many),)).weighted([weight])
    state, keep = replace(fit.state, poses=(fit.state.poses[0][many],)), [np.ones(many.size, bool)]
    rows = list(weighted.rows(state, True, keep))
    flat = np.concatenate([r.jacobian.reshape(-1, r.jacobian.shape[2]) for r in rows])
    sums = normal_sums(weighted, state, keep)
    np.testing.assert_allclose(sums.matrix, flat.T @ flat, rtol=1e-8, atol=1e-9 * flat.max()**2)
    assert sums.count == pytest.approx(3.0 * weight.sum()) == sum(r.count for r in rows)
    squares = row_squares(weighted, state, 0, keep[0])
    assert squares is not None
    np.testing.assert_allclose(squares, np.sum(np.concatenate([r.residual for r in rows])**2, 1))
    away = distances(weighted, state).square[0]
    np.testing.assert_allclose(away, distances(weighted.weighted(None), state).square[0])


@pytest.mark.parametrize("weight", [1.0, 0.4, 0.0])
def test_a_row_is_as_far_as_it_is_from_what_the_others_predict(
        campaign: tuple[Problem, Fit], weight: float) -> None:
    """Whatever it weighs itself, to first order; by a fit without it."""
    problem, fit = campaign
    ones = np.ones(len(problem.datasets[0]))
    at = np.arange(ones.size) == ROW
    keep = [fit.keep[0] & ~(at & (weight == 0.0))]
    own = fit_rows(problem.weighted([np.where(at & (weight > 0.0), weight, 1.0)]), fit.state, keep,
                   fit.reasons, fit.prior, FitOptions())
    found = distances(own.problem, own.state, prediction_covariance(own), keep).square[0][ROW]
    without = fit_rows(problem, fit.state, [fit.keep[0] & ~at], fit.reasons, fit.prior,
                       FitOptions())
    (rows,) = problem.rows(without.state, True, [at])
    covariance = np.eye(3) + rows.jacobian[0] @ prediction_covariance(without) @ rows.jacobian[0].T
    expected = rows.residual[0] @ linalg.solve(covariance, rows.residual[0])
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_a_row_that_moves_away_loses_its_weight_by_and_by(campaign: tuple[Problem, Fit]) -> None:
    """No estimate jumps to where it is without the row."""
    _, fit = campaign
    found = [again(fit, off(fit, times)) for times in np.arange(3.0, 10.0, 1.0 / 3.0)]
    sigma = np.sqrt(np.diagonal(prediction_covariance(fit)))[:len(fit.problem.free)]
    g = np.array([f.state.g[list(f.problem.free)] for f in found]) / sigma
    assert np.abs(np.diff(g, axis=0)).max() < 0.4 * np.abs(g - g[-1]).max()
    weight = np.array([f.problem.weights[0][ROW] * f.keep[0][ROW] for f in found])
    assert weight[0] > 0.9 and weight[-1] == 0.0 and (np.diff(weight) <= 0.02).all()
    assert ((weight > 0.1) & (weight < 0.9)).sum() >= 2
    assert [bool(f.reasons[0]) for f in found] == (weight == 0.0).tolist()
    np.testing.assert_allclose(found[-1].state.g, again(fit, off(fit, 1e3)).state.g, atol=1e-9)


def test_weights_are_those_of_the_fit_that_has_them(campaign: tuple[Problem, Fit]) -> None:
    """The fit is the minimum of the rows as it weighs them, and would weigh them so again."""
    _, fit = campaign
    own = again(fit, off(fit, 5.0))
    assert own.problem.datasets[0].weight is not None
    end = least_squares(own.problem, own.state, own.keep, own.prior, 5).state
    np.testing.assert_allclose(end.g, own.state.g, atol=1e-9)
    found = distances(own.problem, own.state, prediction_covariance(own), own.keep)
    weight = found.weights(own.keep, found.factor(own.keep))[0]
    np.testing.assert_allclose(weight, own.problem.weights[0], atol=0.03)


def test_causes_are_asked_for_in_whole_rows(campaign: tuple[Problem, Fit]) -> None:
    _, fit = campaign
    own = again(fit, off(fit, 5.0))
    plain = build(replace(own.problem, datasets=(replace(own.problem.datasets[0], weight=None),)),
                  own.state, own.keep)
    np.testing.assert_array_equal(build(own.problem, own.state, own.keep).residual, plain.residual)


def test_repeats_that_weigh_less_scatter_as_others_do(campaign: tuple[Problem, Fit]) -> None:
    """Their noise over the stated one does not depend on what they weigh: 400 of them."""
    problem, _ = campaign
    (data,) = problem.datasets
    many = data.take(np.tile(np.arange(len(data)), 20)[:400])
    noise = np.random.default_rng(1).normal(size=many.position.shape)
    many = replace(many, position=many.position + noise * many.sigma_position,
                   groups=np.tile(np.arange(len(data)), 20)[:400])
    alone = replace(problem, datasets=(many,))
    own = identify(alone, FitOptions(robust=False))
    light = np.where(np.arange(400) % 2 == 0, 0.25, 1.0)
    weighted = replace(own, problem=own.problem.weighted([light]))
    ratios = [noise_check(f).repeat_ratio for f in (own, weighted)]
    assert ratios[0] is not None and ratios[1] is not None
    # a row of weight w has w times the square, and the freedom of w values
    assert ratios[1] == pytest.approx(ratios[0], rel=0.05)


def test_a_third_of_wrong_rows_does_not_hide_itself(campaign: tuple[Problem, Fit]) -> None:
    """A plain fit to all of them would be as far from the others, and none would stand out."""
    _, fit = campaign
    (data,) = fit.problem.datasets
    wrong = np.arange(len(data)) % 3 == 1
    way = np.random.default_rng(5).choice([-1.0, 1.0], size=data.position.shape)
    position = data.position + 300.0 * wrong[:, None] * way * data.sigma_position
    found = identify(replace(fit.problem, datasets=(replace(data, position=position),)))
    np.testing.assert_array_equal(~found.keep[0], wrong)
    alone = identify(replace(fit.problem, datasets=(data.take(~wrong),)))
    np.testing.assert_allclose(found.state.g, alone.state.g, atol=1e-9)


def test_a_row_that_does_not_belong_pulls_as_much_as_one_that_hardly_does() -> None:
    """However far it is; rows of more values may be farther off, and those that belong count."""
    square = np.array([1.0, 6.0, 12.0, 1e4, 1e8, np.nan, 1e4])
    size = np.array([3.0, 3.0, 3.0, 3.0, 3.0, 0.0, 6.0])
    found, keep = Distances((square,), (size,), (False,)), [square < 100.0]
    (weight,) = found.held_back(keep, np.array([1.0]))
    np.testing.assert_array_equal(weight[[0, 1, 2, 5]], 1.0)
    pull = weight * square
    assert pull[3] == pytest.approx(pull[4], rel=1e-9) and pull[2] < pull[3] < pull[6] < 100.0
    there = np.where(np.isnan(square), square, np.minimum(square, pull[3]))
    (known,) = Distances((there,), (size,), (False,)).weights(keep, np.array([1.0]))
    assert known[3] == pytest.approx(float(NO_WEIGHT), rel=0.05)
