"""The laws of motors, points, surfaces and lines, over batch shapes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm

from ppmcal import algebra as cga

SHAPES = [(), (3,), (2, 3)]
laws = settings(max_examples=60, deadline=None)
close = np.testing.assert_allclose


def batch(*sizes: int, bound: float = 2.0) -> st.SearchStrategy[list[cga.Array]]:
    """Draw arrays of one batch shape; the last axis of each has the given size."""
    number = st.floats(-bound, bound)
    return st.sampled_from(SHAPES).flatmap(
        lambda shape: st.tuples(*(arrays(np.float64, (*shape, n), elements=number) for n in sizes))
    )


def matrices(motor: cga.Array) -> cga.Array:
    """Return the homogeneous matrices of motors, `(..., 4, 4)`."""
    out = np.zeros((*motor.shape[:-1], 4, 4))
    out[..., :3, :3] = cga.rotation_matrix(motor)
    out[..., :3, 3] = cga.translation(motor)
    out[..., 3, 3] = 1.0
    return out


def twist_matrix(twist: cga.Array) -> cga.Array:
    """Return the 4×4 matrix of the velocity field v + ω × x."""
    x, y, z = twist[:3]
    out = np.zeros((4, 4))
    out[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    out[:3, 3] = twist[3:]
    return out


def assert_unit(motor: cga.Array) -> None:
    """M M~ = 1, scalar and e123∞ part."""
    product = cga.compose(motor, cga.reverse(motor))
    close(product, cga.identity_motor(motor.shape[:-1]), atol=1e-14)


# --- motors -----------------------------------------------------------------------------------


@laws
@given(batch(6, 6, 6, 3))
@pytest.mark.slow
def test_motors_are_a_group_that_acts(drawn: list[cga.Array]) -> None:
    a, b, c = (cga.motor_exp(twist) for twist in drawn[:3])
    x = drawn[3]
    for motor in (a, b, c):
        assert_unit(motor)
    ab = cga.compose(a, b)
    close(cga.compose(ab, c), cga.compose(a, cga.compose(b, c)), atol=1e-13)
    close(cga.compose(a, cga.identity_motor()), a, rtol=0, atol=0)
    close(cga.move_point(ab, x), cga.move_point(a, cga.move_point(b, x)), atol=1e-13)
    close(cga.move_point(-a, x), cga.move_point(a, x), rtol=0, atol=0)
    close(matrices(ab), matrices(a) @ matrices(b), atol=1e-13)
    close(matrices(cga.reverse(a)), np.linalg.inv(matrices(a)), atol=1e-13)


@laws
@given(batch(6, 3))
def test_exp_is_the_matrix_exponential(drawn: list[cga.Array]) -> None:
    twist, x = drawn
    motor = cga.motor_exp(twist)
    flat = twist.reshape(-1, 6)
    expected = np.array([expm(twist_matrix(row)) for row in flat])
    close(matrices(motor).reshape(-1, 4, 4), expected, atol=1e-13)
    moved = (matrices(motor)[..., :3, :3] @ x[..., None])[..., 0] + cga.translation(motor)
    close(cga.move_point(motor, x), moved, atol=1e-14)


@laws
@given(batch(6, bound=1.8))
def test_log_inverts_exp(drawn: list[cga.Array]) -> None:
    (twist,) = drawn
    motor = cga.motor_exp(twist)
    close(cga.motor_log(motor), twist, atol=1e-13)
    close(cga.motor_log(-motor), twist, atol=1e-13)
    close(cga.rotation_vector(-motor), twist[..., :3], atol=1e-14)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    "angle", [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-7, 1e-3, 0.199, 0.201, 3.0, np.pi - 1e-7]
)
def test_exp_and_log_at_special_angles(angle: float, sign: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3
    twist = np.array([*(angle * axis), 0.3, -0.8, 0.5])
    motor = cga.motor_exp(twist)
    assert_unit(motor)
    back = cga.motor_log(sign * motor)
    close(back[3:], twist[3:], rtol=1e-15, atol=1e-15)
    close(back[:3], twist[:3], rtol=1e-14, atol=1e-155)
    close(matrices(motor), expm(twist_matrix(twist)), atol=3e-15)
    again = cga.motor_from_matrix(cga.rotation_matrix(motor), cga.translation(motor))
    close(cga.motor_log(again), twist, atol=1e-14)


def test_log_at_and_beyond_half_a_turn() -> None:
    twist = np.array([0, 0, np.pi, 0.1, 0.2, 0.3])
    motor = cga.motor_exp(twist)
    sign = np.sign(motor[3])
    close(cga.motor_exp(cga.motor_log(motor)) * sign, motor * sign, atol=1e-16)
    over = cga.motor_log(cga.motor_exp([0, 0, np.pi + 0.1, 0, 0, 0.7]))
    close(over, [0, 0, 0.1 - np.pi, 0, 0, 0.7], atol=1e-15)


def test_rotor_and_translator() -> None:
    turned = cga.move_point(cga.rotor([0, 0, 1], np.pi / 2), [1, 0, 0])
    close(turned, [0, 1, 0], atol=1e-15)
    close(cga.move_point(cga.translator([1, 2, 3]), [4, 4, 4]), [5, 6, 7])
    axis, angle = np.array([0.6, 0.0, 0.8]), np.array([0.3, 2.0])
    twist = np.concatenate((angle[:, None] * axis, np.zeros((2, 3))), axis=-1)
    close(cga.rotor(axis, angle), cga.motor_exp(twist), atol=1e-16)
    screw = cga.compose(cga.translator([0, 0, 0.7]), cga.rotor([0, 0, 1], 1.1))
    close(cga.motor_log(screw), [0, 0, 1.1, 0, 0, 0.7], atol=1e-15)


@laws
@given(batch(6, 3))
def test_rotated_is_the_rotor_of_the_product(drawn: list[cga.Array]) -> None:
    """To the last digit."""
    motor = cga.motor_exp(drawn[0])
    turn = np.concatenate([drawn[1][..., :3], 0.0 * drawn[1][..., :3]], axis=-1)
    want = cga.compose(cga.motor_exp(turn), motor)
    want[..., 4:] = 0.0
    np.testing.assert_array_equal(cga.rotated(motor, turn[..., :3]), want)


@laws
@given(batch(6, 8), st.floats(0.1, 10))
def test_normalise_mends_scale_and_slip(drawn: list[cga.Array], scale: float) -> None:
    motor = cga.motor_exp(drawn[0])
    close(cga.normalise(scale * motor), motor, atol=1e-14)
    dirty = motor + 1e-3 * drawn[1]
    clean = cga.normalise(dirty)
    assert_unit(clean)
    close(clean, motor, atol=2e-2)
    close(cga.normalise(clean), clean, atol=1e-15)


@pytest.mark.slow
@laws
@given(batch(6))
def test_other_rotation_forms_round_trip(drawn: list[cga.Array]) -> None:
    motor = cga.motor_exp(drawn[0])
    R, t = cga.rotation_matrix(motor), cga.translation(motor)
    close(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    close(np.linalg.det(R), np.ones(R.shape[:-2]), atol=1e-14)
    from_matrix = cga.motor_from_matrix(R, t)
    assert np.all(from_matrix[..., 0] >= 0)
    from_vector = cga.motor_from_rotation_vector(cga.rotation_vector(motor), t)
    xyzw = 3 * np.concatenate((-motor[..., 1:4], motor[..., :1]), axis=-1)
    from_quaternion = cga.motor_from_quaternion(xyzw, t)
    close(from_quaternion, motor, atol=1e-14)
    for other in (from_matrix, from_vector):
        assert_unit(other)
        close(matrices(other), matrices(motor), atol=3e-15)


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-7, 1e-3])
def test_from_matrix_near_half_a_turn(gap: float) -> None:
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [-1, 1, 1], [1e-9, 0, 1]], float)
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    R = cga.rotation_matrix(cga.rotor(axes, np.pi - gap))
    close(cga.rotation_matrix(cga.motor_from_matrix(R, np.zeros(3))), R, atol=1e-15)


# --- points, surfaces, lines ------------------------------------------------------------------


@pytest.mark.slow
@laws
@given(batch(6, 3, 3, 3))
def test_motors_move_everything_alike(drawn: list[cga.Array]) -> None:
    motor, (x, y, c) = cga.motor_exp(drawn[0]), drawn[1:]
    moved_x, moved_y, moved_c = (cga.move_point(motor, p) for p in (x, y, c))
    close(cga.move_vector(motor, cga.point(x)), cga.point(moved_x), atol=1e-12)
    close(cga.move_vector(motor, cga.sphere(c, 0.5)), cga.sphere(moved_c, 0.5), atol=1e-12)
    plane = cga.move_vector(motor, cga.plane(y, np.sum(x * y, axis=-1)))
    close(cga.inner(plane, cga.point(moved_x)), np.zeros(x.shape[:-1]), atol=1e-12)
    through = np.concatenate((y - x, np.cross(x, y - x)), axis=-1)
    line = np.concatenate((moved_y - moved_x, np.cross(moved_x, moved_y - moved_x)), axis=-1)
    close(cga.move_line(motor, through), line, atol=1e-12)


@laws
@given(batch(6, 6, 6))
@pytest.mark.slow
def test_adjoint_and_pairing(drawn: list[cga.Array]) -> None:
    motor, twist, line = cga.motor_exp(drawn[0]), drawn[1], drawn[2]
    moved = cga.adjoint_twist(motor, twist)
    conjugate = cga.compose(cga.compose(motor, cga.motor_exp(twist)), cga.reverse(motor))
    close(cga.motor_exp(moved), conjugate, atol=1e-12)
    close(cga.pair(cga.move_line(motor, line), moved), cga.pair(line, twist), atol=1e-11)


@laws
@given(batch(3, 3))
def test_inner_products_are_distances(drawn: list[cga.Array]) -> None:
    x, c = drawn
    squared = np.sum((x - c) ** 2, axis=-1)
    close(cga.inner(cga.point(x), cga.point(c)), -0.5 * squared, atol=1e-14)
    close(cga.inner(cga.point(x), cga.sphere(c, 0.7)), -0.5 * (squared - 0.49), atol=1e-14)
    close(cga.sphere_squared(c, 0.7**2), cga.sphere(c, 0.7), atol=1e-15)
    close(cga.inner(cga.point(x), cga.plane([0, 0, 1], 0.3)), x[..., 2] - 0.3, atol=1e-15)
    close(cga.coordinates(-2.5 * cga.sphere(c, 0.7)), c, atol=1e-15)


@pytest.mark.slow
@laws
@given(batch(3, 3, 6), st.booleans())
def test_leg_line_is_the_derivative(drawn: list[cga.Array], flat: bool) -> None:
    x, c, twist = drawn
    P = cga.point(x)
    S = cga.plane(c, 0.3) if flat else cga.sphere(c, 1.1)
    step = 1e-5

    def slope(rate: Callable[[cga.Array], Any]) -> Any:
        forward, back = cga.motor_exp(step * twist), cga.motor_exp(-step * twist)
        return (rate(forward) - rate(back)) / (2 * step)

    line = cga.leg_line(P, S)
    close(line[..., :3], c if flat else c - x, atol=1e-15)
    close(line[..., 3:], np.cross(x, line[..., :3]), atol=1e-14)
    change = cga.pair(line, twist)
    close(slope(lambda m: cga.inner(cga.move_vector(m, P), S)), change, atol=1e-7)
    close(slope(lambda m: cga.inner(P, cga.move_vector(m, S))), -change, atol=1e-7)
