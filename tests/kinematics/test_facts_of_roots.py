"""Roots of a limb's closure in its joint, from three of its values."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.machines import offset_joints, spread

import ppmcal
from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.limb_roots import (
    _distance,
    _inner_product,
    _OneLimb,
    _polished,
    _polynomial_roots,
    _trigonometric_roots,
    _turned_root,
    all_roots,
    limb_roots,
    nearest_joint,
)


@pytest.mark.parametrize("h", [1.0, 0.01])
@pytest.mark.parametrize("size", [-0.5, 3.0, 1e-3])
def test_a_parabola_is_found_from_three_values(size: float, h: float) -> None:
    """Two roots, one twice, none; and its vertex, where it comes nearest to 0."""
    x = h * np.array([1.0, 2.0, 3.0])
    f = size * np.stack([(x - 0.3) * (x + 1.7), (x - 2.0 * h) ** 2, (x - 1.0) ** 2 + 4.0])
    roots, middle = _polynomial_roots(f, h, linear=False)
    np.testing.assert_allclose(roots[0], [-1.7, 0.3], atol=1e-9 / h)
    np.testing.assert_allclose(roots[1], [2.0 * h, 2.0 * h], rtol=1e-6)
    assert np.isnan(roots[2]).all()
    np.testing.assert_allclose(middle, [-0.7, 2.0 * h, 1.0], atol=1e-9 / h)


@pytest.mark.parametrize("h", [1.0, 0.01])
def test_a_line_is_found_from_three_values(h: float) -> None:
    x = h * np.array([1.0, 2.0, 3.0])
    roots, _ = _polynomial_roots(np.stack([4.0 * (x - 0.7), -0.1 * (x + 9.0), 0.0 * x + 1.0]), h,
                                 linear=True)
    np.testing.assert_allclose(roots[:2], [[0.7, 0.7], [-9.0, -9.0]], atol=1e-9)
    assert np.isnan(roots[2]).all()


@pytest.mark.parametrize("size", [-0.5, 3.0])
@pytest.mark.parametrize("turn", [0.4, -2.5])
def test_a_wave_is_found_from_three_values(size: float, turn: float) -> None:
    """k + cos(u - turn): two roots, one twice at the end of reach, none."""
    u = np.array([0.0, 2.0, -2.0])
    f = size * np.stack([np.cos(u - turn) + 0.5, np.cos(u - turn) - 1.0, np.cos(u - turn) + 1.5])
    roots, nearest = _trigonometric_roots(f)
    for root in roots[0]:
        assert np.cos(root - turn) == pytest.approx(-0.5)
    assert abs(np.cos(roots[0, 0] - roots[0, 1])) == pytest.approx(0.5)
    np.testing.assert_allclose(np.cos(roots[1] - turn), 1.0, atol=1e-9)
    assert np.isnan(roots[2]).all()
    assert np.cos(nearest[2] - turn) == pytest.approx(-1.0)


@pytest.mark.parametrize("name", ["6-UPS", "linapod", "6-RUS"])
def test_a_newton_step_squares_what_a_root_is_off_if_it_is_little(name: str) -> None:
    """A thousandth of the reach, or a mrad, is too much: that is no round-off but another root."""
    mechanism = ppmcal.load(ppmcal.shipped(name))
    model, pose = Model(mechanism), mechanism.home[None]
    scale = mechanism.reach if mechanism.actuator_quantity[0] == "length" else 1.0
    for index in range(2):
        roots = limb_roots(model, index, pose)[0]
        near = _polished(_OneLimb.of(model, [index], pose), roots + 1e-5 * scale)
        np.testing.assert_allclose(near, roots, rtol=0.0, atol=2e-9 * scale)
        far = roots + 1e-2 * scale
        np.testing.assert_array_equal(_polished(_OneLimb.of(model, [index], pose), far), far)
        assert np.isnan(_polished(_OneLimb.of(model, [index], pose), np.full((1, 2), np.nan))).all()


@pytest.mark.parametrize("most", [0.0, 0.3])
@pytest.mark.parametrize(("kind", "body"), [("U(P)S", "base"), ("(P)US", "platform")])
@pytest.mark.slow_cases("(P)US-platform-0.0")
def test_an_offset_joint_is_turned_until_it_stands_still(kind: str, body: str, most: float) -> None:
    """In every row, those that start at the root too: to the last digits, without a polish."""
    mechanism = offset_joints(kind, body, size=60.0)
    model = Model(mechanism)
    _, pose = spread(model)
    for index in range(2):
        exact = limb_roots(model, index, pose)[0]
        for which in range(2):
            start = exact[:, which] + np.linspace(most, 0.3, len(pose)) * mechanism.reach
            found, near = _turned_root(_OneLimb.of(model, [index], pose), start, which)
            miss = _inner_product(_OneLimb.of(model, [index], pose), found)
            assert np.abs(miss).max() < 1e-11 * mechanism.reach**2
            np.testing.assert_array_equal(near, found)


@pytest.mark.parametrize("varied", [False, True])
@pytest.mark.parametrize("name", ["6-UPS", "6-RUS", "linapod", "cable-4-pulleys", "tricept",
                                  "mixed-spatial", "3-RPS"])
def test_limbs_together_have_the_roots_of_each(name: str, varied: bool) -> None:
    """With parameters of their own in each row, too, and where a limb does not reach."""
    mechanism = ppmcal.load(ppmcal.shipped(name))
    pose = np.repeat(mechanism.home[None], 5, axis=0)
    pose[3] = cga.compose(cga.translator(np.array([9.0, 0.0, 0.0]) * mechanism.reach), pose[3])
    rng = np.random.default_rng(1)
    g = np.tile(mechanism.values, (5, 1)) + 1e-4 * mechanism.reach * rng.uniform(
        -1.0, 1.0, (5, mechanism.values.size))
    model = Model(mechanism, g if varied else None)
    found = all_roots(model, pose)
    assert list(found) == list(mechanism.driven)
    for i, (roots, missing) in found.items():
        alone = limb_roots(model, i, pose)
        np.testing.assert_allclose(roots, alone[0], rtol=1e-12)
        np.testing.assert_allclose(missing, alone[1], rtol=1e-9)


def test_where_nothing_is_known_the_nearest_joint_is_0() -> None:
    mechanism = ppmcal.load(ppmcal.shipped("6-UPS"))
    model = Model(mechanism)
    pose = np.stack([mechanism.home, np.full(8, np.nan)])
    assert nearest_joint(model, 0, pose)[1] == 0.0
    assert np.isnan(inverse(model, pose).q[1]).all()


@pytest.mark.parametrize("body", ["base", "platform"])
def test_the_nearest_joint_is_where_the_limb_misses_least(body: str) -> None:
    """Out of reach: to either side it misses by more, its joint turned as it then stands."""
    mechanism = offset_joints("(P)US", body, size=60.0)
    model = Model(mechanism)
    away = cga.motor_from_rotation_vector(
        np.zeros(3), np.array([0.6, -0.8, 0.1]) * 3.0 * mechanism.reach)
    pose = cga.compose(away, spread(model)[1])
    for index in range(2):
        at, h = nearest_joint(model, index, pose), 1e-4 * mechanism.reach
        limb = _OneLimb.of(model, [index], pose)
        here, below, above = (_distance(limb, at + s * h) for s in (0, -1, 1))
        assert (here > mechanism.reach).all()
        assert np.abs(above - below).max() < 1e-3 * h
