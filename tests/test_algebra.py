"""The laws of motors, points, surfaces, lines and point pairs, over batch shapes."""

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
    close(cga.motor_exp(cga.motor_log(motor)) * np.sign(motor[3]), motor * np.sign(motor[3]))
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
@given(batch(6, 8), st.floats(0.1, 10))
def test_normalise_mends_scale_and_slip(drawn: list[cga.Array], scale: float) -> None:
    motor = cga.motor_exp(drawn[0])
    close(cga.normalise(scale * motor), motor, atol=1e-14)
    dirty = motor + 1e-3 * drawn[1]
    clean = cga.normalise(dirty)
    assert_unit(clean)
    close(clean, motor, atol=2e-2)
    close(cga.normalise(clean), clean, atol=1e-15)


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


# --- point pairs ------------------------------------------------------------------------------


def well_shaped(rng: np.random.Generator, shape: tuple[int, ...]) -> cga.Array:
    """Return three centres whose triangle is not thin, `(3, *shape, 3)`."""
    corners = np.array([[1.0, 0, 0], [-0.5, 0.9, 0], [-0.5, -0.9, 0.2]])
    corners = corners.reshape((3, *(1,) * len(shape), 3))
    return corners + 0.2 * rng.uniform(-1, 1, size=(3, *shape, 3))


@pytest.mark.parametrize("flat", [0, 1, 2], ids=["spheres", "one plane", "two planes"])
@pytest.mark.parametrize("first", [0, 1, 2])
@pytest.mark.parametrize("shape", [*SHAPES, (1000,)])
def test_three_surfaces_through_a_known_point(
    shape: tuple[int, ...], first: int, flat: int
) -> None:
    rng = np.random.default_rng(7)
    x = rng.uniform(-1, 1, size=(*shape, 3)) + [0, 0, 1.5]
    centers = well_shaped(rng, shape)
    surfaces = list(cga.sphere(centers, np.linalg.norm(centers - x, axis=-1)))
    for index in range(flat):
        normal = centers[index] + [0, 0, 0.3]
        surfaces[index] = cga.plane(normal, np.sum(normal * x, axis=-1))
    pair = cga.meet(*surfaces[first:], *surfaces[:first])
    plus, minus, discriminant = cga.split(pair)
    near = [np.linalg.norm(cga.coordinates(p) - x, axis=-1) for p in (plus, minus)]
    assert np.all(np.minimum(*near) < 1e-12)
    assert np.all(discriminant > 0)
    for surface in surfaces:
        close(cga.inner(plus, surface), np.zeros(shape), atol=1e-12)
        close(cga.inner(minus, surface), np.zeros(shape), atol=1e-12)
    ends = cga.coordinates(plus), cga.coordinates(minus)
    close(cga.middle(pair), (ends[0] + ends[1]) / 2, atol=1e-12)
    half = np.sum((ends[0] - ends[1]) ** 2, axis=-1) / 4
    close(cga.pair_radius_squared(pair), half, atol=1e-12)
    close(cga.middle(-3 * pair), cga.middle(pair), atol=1e-13)
    close(cga.split(-3 * pair)[0], minus, atol=1e-12)


def test_plus_lies_on_the_documented_side() -> None:
    centers = well_shaped(np.random.default_rng(3), (50,))
    plus, minus, _ = cga.split(cga.meet(*cga.sphere(centers, 2.0)))
    side = np.cross(centers[1] - centers[0], centers[2] - centers[0])
    assert np.all(np.sum((plus - minus)[:, :3] * side, axis=-1) > 0)


def test_pairs_move_with_their_spheres() -> None:
    rng = np.random.default_rng(5)
    motor = cga.motor_exp(rng.normal(size=6))
    spheres = cga.sphere(well_shaped(rng, ()), [2.0, 1.9, 2.1])
    pair = cga.meet(*spheres)
    moved = cga.meet(*cga.move_vector(motor, spheres))
    close(moved, cga.sandwich(cga.MOTOR, cga.PAIR)(motor, pair), atol=1e-12)
    close(cga.middle(moved), cga.move_point(motor, cga.middle(pair)), atol=1e-13)


@pytest.mark.parametrize("height", [1e-1, 1e-3, 1e-5, 1e-7])
def test_accuracy_near_tangency(height: float) -> None:
    # The points are at ±height: rounding ρ² by ε moves them by ε / height, the middle by ε.
    centers = well_shaped(np.random.default_rng(11), (1000,))
    centers[..., 2] = 0
    foot = np.array([0.1, 0.2, 0.0])
    squared = np.sum((centers - foot) ** 2, axis=-1) + height**2
    pair = cga.meet(*cga.sphere_squared(centers, squared))
    close(cga.middle(pair), np.broadcast_to(foot, (1000, 3)), atol=1e-14)
    close(cga.pair_radius_squared(pair), height**2, rtol=0, atol=1e-14)
    plus, minus, _ = cga.split(pair)
    if height > 1e-6:
        close(cga.coordinates(plus)[:, 2], height, rtol=0, atol=1e-14 / height)
        close(cga.coordinates(minus)[:, 2], -height, rtol=0, atol=1e-14 / height)


def test_imaginary_and_degenerate_pairs() -> None:
    centers = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0]])
    pair = cga.meet(*cga.sphere_squared(centers, 0.96))  # misses the centre line by 0.04
    plus, minus, discriminant = cga.split(pair)
    assert discriminant < 0
    assert np.all(np.isnan(plus)) and np.all(np.isnan(minus))
    close(cga.middle(pair), np.zeros(3), atol=1e-15)
    close(cga.pair_radius_squared(pair), -0.04, atol=1e-15)
    mixed = np.stack((pair, cga.meet(*cga.sphere(centers, 2.0))))
    assert np.isnan(cga.split(mixed)[0]).all(axis=-1).tolist() == [True, False]
    planes = cga.plane(np.eye(3), [1, 2, 3])
    collinear = cga.sphere([[0, 0, 0], [1, 0, 0], [2, 0, 0]], 2.0)
    for none in (cga.meet(*planes), cga.meet(*collinear)):
        assert np.all(np.isnan(cga.middle(none))) and np.isnan(cga.pair_radius_squared(none))
        assert np.all(np.isnan(cga.split(none)[0])) and np.all(np.isnan(cga.split(none)[1]))


# --- the contract of all functions ------------------------------------------------------------

FUNCTIONS: dict[str, tuple[int, ...]] = {
    "point": (3,),
    "coordinates": (5,),
    "inner": (5, 5),
    "translator": (3,),
    "motor_exp": (6,),
    "motor_log": (8,),
    "compose": (8, 8),
    "reverse": (8,),
    "normalise": (8,),
    "rotation_matrix": (8,),
    "translation": (8,),
    "rotation_vector": (8,),
    "motor_from_quaternion": (4, 3),
    "motor_from_rotation_vector": (3, 3),
    "move_point": (8, 3),
    "move_vector": (8, 5),
    "move_line": (8, 6),
    "adjoint_twist": (8, 6),
    "leg_line": (5, 5),
    "pair": (6, 6),
    "meet": (5, 5, 5),
    "middle": (10,),
    "pair_radius_squared": (10,),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_batches_broadcast_and_equal_single_calls(name: str) -> None:
    function, sizes = getattr(cga, name), FUNCTIONS[name]
    rng = np.random.default_rng(1)
    shapes = [(2, 1), (3,), ()][: len(sizes)]
    args = [rng.normal(size=(*s, n)) for s, n in zip(shapes, sizes, strict=True)]
    copies = [arg.copy() for arg in args]
    out = function(*args)
    full = np.broadcast_shapes(*shapes)
    for index in np.ndindex(*full):
        single = (np.broadcast_to(a, (*full, a.shape[-1]))[index] for a in args)
        close(out[index], function(*single), rtol=1e-10, atol=1e-13)
    assert out.dtype == np.float64
    for arg, copy in zip(args, copies, strict=True):
        np.testing.assert_array_equal(arg, copy)
    empty = function(*(np.zeros((0, n)) for n in sizes))
    assert empty.shape == (0, *out.shape[len(full) :])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_wrong_axis_is_named(name: str) -> None:
    with pytest.raises(ValueError, match=r"needs \d+ components .* got an array of shape \(2,\)"):
        getattr(cga, name)(*(np.zeros(2) for _ in FUNCTIONS[name]))


def test_surfaces_broadcast_their_numbers() -> None:
    assert cga.sphere(np.zeros((2, 1, 3)), np.ones(4)).shape == (2, 4, 5)
    assert cga.plane(np.zeros(3), np.ones(4)).shape == (4, 5)
    assert cga.rotor([0, 0, 1], np.ones((2, 3))).shape == (2, 3, 8)
    assert cga.identity_motor((2, 3)).shape == (2, 3, 8)
    R = np.broadcast_to(np.eye(3), (2, 1, 3, 3))
    assert cga.motor_from_matrix(R, np.zeros((4, 3))).shape == (2, 4, 8)


def test_refusals() -> None:
    with pytest.raises(ValueError, match=r"R of shape \(\.\.\., 3, 3\), got \(3,\)"):
        cga.motor_from_matrix(np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="length zero"):
        cga.motor_from_quaternion(np.zeros(4), np.zeros(3))
