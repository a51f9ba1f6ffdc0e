"""What chains of slots are made of: turns and their derivatives near zero, and axes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.model.limbs.chain import (
    Chain,
    cross_matrix,
    joint,
    left_jacobian,
    orientation,
    slide,
)

Array = NDArray[np.float64]
AXIS = np.array([2.0, -3.0, 6.0]) / 7.0


@pytest.mark.parametrize("t", [1e-6, 3e-5, 9.9e-5, 1.01e-4, 1e-3])
def test_the_derivative_of_a_turn_near_zero(t: float) -> None:
    """J = I + a [r] + b [r]^2, a = 1/2 - t^2/24 + ..., b = 1/6 - t^2/120 + ..."""
    r = t * AXIS
    j = left_jacobian(r)
    a = (j - j.T)[1, 0] / (2.0 * r[2])
    b = (j + j.T)[1, 0] / (2.0 * r[0] * r[1])
    assert a - 0.5 == pytest.approx(-t**2 / 24.0, abs=3e-12 if t < 1e-4 else 2e-8)
    assert b == pytest.approx(1.0 / 6.0 - t**2 / 120.0, abs=1e-9 if t < 1e-4 else 1e-6)
    assert np.trace(j) == pytest.approx(3.0 - t**2 / 3.0, rel=1e-14)


@pytest.mark.parametrize("t", [0.0, 0.3, 2.0, 3.1])
def test_the_derivative_of_a_turn_by_differences(t: float) -> None:
    """exp(r + dr) = exp(J dr) exp(r)."""
    r, h = t * AXIS, 1e-6
    none = np.zeros(3)
    for k in range(3):
        ends = [cga.motor_from_rotation_vector(r + s * h * np.eye(3)[k], none) for s in (1, -1)]
        turn = cga.rotation_vector(cga.compose(ends[0], cga.reverse(ends[1]))) / (2.0 * h)
        np.testing.assert_allclose(left_jacobian(r)[:, k], turn, atol=1e-8)
    np.testing.assert_allclose(left_jacobian(r) @ r, r, atol=1e-12)     # a turn about its own axis


def test_a_cross_matrix_is_the_cross_product() -> None:
    rng = np.random.default_rng(1)
    v, w = rng.normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose((cross_matrix(v) @ w[..., None])[..., 0], np.cross(v, w))


@pytest.mark.parametrize("axis", [[0.0, 0.0, 2.0], [0.0, -3.0, 0.0], [1.0, 2.0, -2.0]])
def test_an_orientation_has_its_axis_and_turns_right(axis: list[float]) -> None:
    """Of any length; towards ``zero`` as far as that is not along the axis. In batches alike."""
    for zero in (None, np.array([1.0, 1.0, 5.0])):
        made = orientation(axis, zero)
        np.testing.assert_allclose(made.T @ made, np.eye(3), atol=1e-12)
        assert np.linalg.det(made) == pytest.approx(1.0)
        np.testing.assert_allclose(made[:, 2], np.array(axis) / np.linalg.norm(axis))
        if zero is not None:
            assert made[:, 0] @ zero > 0.0
            assert made[:, 1] @ zero == pytest.approx(0.0, abs=1e-12)
        batch = orientation(np.array([axis, [3.0, 4.0, 0.0]]),
                            None if zero is None else np.array([zero, [0.0, 0.0, 1.0]]))
        np.testing.assert_allclose(batch[0], made)
        np.testing.assert_allclose(batch[1][:, 2], [0.6, 0.8, 0.0])


@pytest.mark.parametrize("wanted", [(), ("rz",), ("x", "y", "z", "rx", "ry", "rz")])
def test_a_joints_frame_is_there_where_it_is_asked_for_or_not_zero(wanted: tuple[str, ...]) -> None:
    """As many twists as are asked for, at zero too; what is neither moves nothing."""
    chain = Chain((slide("length", "x"), joint(1)))
    names = tuple(f"joint1.{c}" for c in wanted)
    still, twists = chain.evaluate({"length": np.array(2.0)}, names)
    np.testing.assert_allclose(cga.translation(still), [2.0, 0.0, 0.0])
    assert tuple(n for t in twists for n in t.names) == names
    bent, _ = chain.evaluate({"length": np.array(2.0), "joint1.x": np.array(0.5)}, names)
    np.testing.assert_allclose(cga.translation(bent), [2.5, 0.0, 0.0])
