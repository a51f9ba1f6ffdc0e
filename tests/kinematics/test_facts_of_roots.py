"""Roots of a limb's closure in its joint, from three of its values."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.kinematics.limb_roots import _polynomial_roots, _trigonometric_roots


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
