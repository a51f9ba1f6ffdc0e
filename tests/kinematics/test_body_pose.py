"""Targets of one body, seen at one stand, are one measured pose with its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from ppmcal.kinematics.body_pose import IN_ONE_PLACE, ON_A_LINE, TOO_FEW, BodyPoses, body_poses

Floats = NDArray[np.float64]
POINTS = np.array([[0.11, 0.02, 0.05], [-0.06, 0.09, 0.06], [-0.05, -0.1, 0.04], [0.02, 0.0, 0.2]])
LEVEL = 1e-3
"""How seldom a right program would be refused by one of these checks."""


def stands(rng: np.random.Generator, n: int, targets: int, planar: bool = False
           ) -> tuple[Rotation, Floats, Floats, Floats]:
    """Return rotations, places (n, 3), positions (n, T, 3) as measured and covariances."""
    spun = rng.uniform(-3.0, 3.0, (n, 3)) * ([0.0, 0.0, 1.0] if planar else np.ones(3))
    turn, place = Rotation.from_rotvec(spun / np.sqrt(3.0)), rng.uniform(-2.0, 2.0, (n, 3))
    root = 2e-5 * (np.eye(3) + 0.4 * rng.normal(size=(n, targets, 3, 3)))
    points = POINTS[:targets]
    if planar:
        place[:, 2] = 0.0
        points = points * [1.0, 1.0, 0.0]
    exact = place[:, None] + points @ np.swapaxes(turn.as_matrix(), 1, 2)
    measured = exact + (root @ rng.normal(size=(n, targets, 3, 1)))[..., 0]
    if planar:
        measured[..., 2] = np.nan
    return turn, place, measured, root @ np.swapaxes(root, -1, -2)


def away(found: BodyPoses, turn: Rotation, place: Floats) -> Floats:
    """Return by what the poses are off (n, 6): displacement, and turn on the measuring side."""
    turned = Rotation.from_rotvec(found.pose[:, 3:]) * turn.inv()
    return np.concatenate([found.pose[:, :3] - place, turned.as_rotvec()], axis=1)


def mahalanobis(error: Floats, covariance: Floats) -> Floats:
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(
        covariance, error[..., None])[..., 0]))


@pytest.mark.parametrize("planar", [False, True])
def test_poses_are_those_of_a_general_solver(planar: bool) -> None:
    """SciPy minimises the same weighted squares, with derivatives of its own by differences."""
    targets, axes = (3, 2) if planar else (4, 3)
    parts = [0, 1, 5] if planar else list(range(6))
    turn, place, measured, covariance = stands(np.random.default_rng(11), 8, targets, planar)
    found = body_poses(POINTS[:targets], measured, covariance, planar)
    for i in range(8):
        white = np.linalg.inv(np.linalg.cholesky(covariance[i][:, :axes, :axes]))

        def missed(step: Floats, i: int = i, white: Floats = white) -> Floats:
            whole = np.zeros(6)
            whole[parts] = 1e-4 * step
            at = place[i] + whole[:3] + (Rotation.from_rotvec(whole[3:]) * turn[i]).apply(
                POINTS[:targets] * ([1.0, 1.0, 0.0] if planar else np.ones(3)))
            return np.asarray((white @ (measured[i] - at)[:, :axes, None]).ravel())

        best = least_squares(missed, np.zeros(len(parts)), "3-point", xtol=1e-15, ftol=1e-15,
                             gtol=1e-15)
        sigma = np.sqrt(np.diagonal(found.covariance[i])[parts])
        off = away(found, turn, place)[i, parts] - 1e-4 * best.x
        assert np.all(np.abs(off) < 1e-3 * sigma)
        other = 1e-8 * np.linalg.inv(best.jac.T @ best.jac)
        own = found.covariance[i][np.ix_(parts, parts)]
        assert np.all(np.abs(own - other) < 1e-3 * np.outer(sigma, sigma))
        assert found.chi_squared[i] == pytest.approx(2.0 * best.cost, rel=1e-4)
        assert found.freedom[i] == axes * targets - len(parts)


@pytest.mark.parametrize("planar", [False, True])
def test_errors_of_poses_are_as_their_covariances_say(planar: bool) -> None:
    """2000 stands, each with noise of its own, of which every fourth has a target hidden."""
    n, parts = 2000, [0, 1, 5] if planar else list(range(6))
    turn, place, measured, covariance = stands(np.random.default_rng(12), n, 4, planar)
    measured[::4, 1, 0] = np.nan
    found = body_poses(POINTS, measured, covariance, planar)
    square = mahalanobis(away(found, turn, place)[:, parts],
                         found.covariance[:, parts][:, :, parts])
    freedom = np.where(np.arange(n) % 4 == 0, 3, 4) * (2 if planar else 3) - len(parts)
    assert np.array_equal(found.freedom, freedom)
    for values, of in ((square, np.full(n, len(parts))), (found.chi_squared, freedom)):
        low, high = chi2.ppf([LEVEL / 2.0, 1.0 - LEVEL / 2.0], of.sum())
        assert low < values.sum() < high
        assert kstest(chi2.cdf(values, of), "uniform").pvalue > LEVEL


def test_a_covariance_without_its_correlations_is_refuted() -> None:
    """The check above is one that a wrong covariance does not pass."""
    turn, place, measured, covariance = stands(np.random.default_rng(12), 2000, 3)
    found = body_poses(POINTS[:3] + [0.3, 0.0, 0.0], measured, covariance)
    lever = place - turn.apply([0.3, 0.0, 0.0])
    error = away(found, turn, lever)
    assert kstest(chi2.cdf(mahalanobis(error, found.covariance), 6), "uniform").pvalue > LEVEL
    alone = found.covariance * np.eye(6)
    assert kstest(chi2.cdf(mahalanobis(error, alone), 6), "uniform").pvalue < LEVEL


def test_standard_deviations_are_diagonal_covariances() -> None:
    _, _, measured, covariance = stands(np.random.default_rng(13), 5, 3)
    sigma = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    one = body_poses(POINTS[:3], measured, sigma)
    two = body_poses(POINTS[:3], measured, covariance * np.eye(3))
    assert np.array_equal(one.pose, two.pose) and np.array_equal(one.covariance, two.covariance)


def test_stands_without_a_pose_say_why_and_leave_the_others_alone() -> None:
    _, _, measured, covariance = stands(np.random.default_rng(14), 6, 4)
    whole = body_poses(POINTS, measured, covariance)
    hidden = measured.copy()
    hidden[2, [0, 3], 1] = np.nan
    hidden[4] = np.nan
    part = body_poses(POINTS, hidden, np.where(np.isnan(hidden)[..., None], np.nan, covariance))
    kept = [0, 1, 3, 5]
    assert [part.reason[i] for i in (2, 4)] == [TOO_FEW] * 2
    assert not any(part.reason[i] for i in kept)
    for one, two in ((part.pose, whole.pose), (part.covariance, whole.covariance)):
        assert np.isnan(one[[2, 4]]).all() and one[kept] == pytest.approx(two[kept], rel=1e-9)
    assert part.freedom.tolist() == [6, 6, 0, 6, 0, 6]


@pytest.mark.parametrize("bent", [0.0, 1e-9, 1e-4])
def test_targets_on_a_line_tell_no_pose(bent: float) -> None:
    """Nor those that are so near one that the noise, here 20 um, hides the turn about it."""
    line = np.array([[-0.1, 0.0, 0.1], [0.0, bent, 0.1], [0.1, 0.0, 0.1]])
    found = body_poses(line, line[None] + [1.0, 2.0, 3.0], np.full((1, 3, 3), 2e-5))
    assert found.reason == (ON_A_LINE,)
    assert np.isnan(found.pose).all() and np.isnan(found.covariance).all()
    bulged = line + [[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 0.0]]
    assert body_poses(bulged, bulged[None], np.full((1, 3, 3), 2e-5)).reason == ("",)


def test_in_the_plane_two_targets_in_one_place_tell_no_pose() -> None:
    points = np.array([[0.1, 0.0, 0.0], [0.1, 0.0, 0.3]])
    found = body_poses(points, points[None], np.full((1, 2, 3), 2e-5), planar=True)
    assert found.reason == (IN_ONE_PLACE,)


def test_no_stands_have_no_poses() -> None:
    assert body_poses(POINTS, np.empty((0, 4, 3)), np.empty((0, 4, 3))).pose.shape == (0, 6)
