"""Point pairs: three surfaces through known points, near tangency, imaginary, degenerate."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal import algebra as cga

SHAPES = [(), (3,), (2, 3)]
close = np.testing.assert_allclose


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
