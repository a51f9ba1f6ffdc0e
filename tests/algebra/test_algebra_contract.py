"""What all functions promise: batches broadcast, arguments stay, wrong shapes are named."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal import algebra as cga

close = np.testing.assert_allclose

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
