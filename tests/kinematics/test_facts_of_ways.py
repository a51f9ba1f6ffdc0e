"""Straight ways: what settles a stretch, and what is said of a place, by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ppmcal
from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import smallest_singular_value
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.tables import SINGULAR
from ppmcal.kinematics.ways import LEEWAY, Ways, _Places, between

Array = NDArray[np.float64]
NONE = np.zeros(3)


def motor(turn: Array | list[float], place: Array | list[float]) -> Array:
    return np.asarray(cga.motor_from_rotation_vector(np.asarray(turn), np.asarray(place)))


def place(q: list[float], value: float = 1.0, part: float = 0.0, turn: float = 0.0,
          away: float = 0.0, sign: float = 1.0) -> _Places:
    """Return one place: its joints, smallest singular value, an entry of A, and its pose."""
    matrix = np.zeros((1, 3, 3))
    matrix[0, 0, 1] = part
    return _Places(motor([turn, 0.0, 0.0], [0.0, away, 0.0])[None], np.array([q]), matrix,
                   np.array([value]), np.array([sign]))


def ways(quantity: tuple[str, ...] = ("length", "length"), home: float = 1.0) -> Ways:
    """Return ways of a machine of reach 1 whose joints go from -1 to 1."""
    made = Ways.__new__(Ways)
    mechanism: Any = SimpleNamespace(
        limits=np.array([[-1.0, 1.0]] * len(quantity)), reach=1.0, actuator_quantity=quantity,
        actuators=tuple(f"leg{i + 1}" for i in range(len(quantity))), limbs=(),
        joint_units=((1.0, "m"),) * len(quantity))
    made.mechanism, made.home_value, made.home_sign = mechanism, home, 1.0
    return made


def settled(left: _Places, right: _Places, added: float = 0.0, bend: float = np.inf,
            made: Ways | None = None) -> bool:
    more = [np.full_like(left.q, added)] * 2
    return bool((made or ways())._settled(left, right, more, np.full_like(left.q, bend))[0])


def test_a_short_stretch_is_settled_and_a_long_one_once_it_was_looked_at() -> None:
    here = place([0.0, 0.0])
    assert settled(here, here)
    assert settled(here, place([0.0, 0.0], away=0.009, turn=0.009))
    for far in (place([0.0, 0.0], away=0.011), place([0.0, 0.0], turn=-0.011)):
        assert not settled(here, far)
        assert settled(here, far, bend=0.0)


@pytest.mark.parametrize("end", ["left", "right"])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("far", "step", "bend", "added", "room"), [
    (0.95, 0.08, np.inf, 0.0, True), (0.95, 0.12, np.inf, 0.0, False),
    (0.95, 0.08, 0.016, 0.0, True), (0.95, 0.08, 0.024, 0.0, False),
    (0.90, 0.08, np.inf, 0.05, True), (0.90, 0.08, np.inf, 0.07, False)])
def test_joints_keep_off_their_limits_by_half_of_step_and_bend(
        end: str, side: float, far: float, step: float, bend: float, added: float, room: bool
        ) -> None:
    """At either end, of either joint: what effects add counts too."""
    for joint in range(2):
        near, other = [0.0, 0.0], [0.0, 0.0]
        near[joint], other[joint] = side * far, side * (far - step)
        both = (place(near), place(other))
        found = settled(*(both if end == "left" else both[::-1]), added=side * added, bend=bend)
        assert found is room


@pytest.mark.parametrize(("values", "part", "clear"), [
    ((1.0, 1.0), 1.3, True), ((1.0, 1.0), 1.35, False), ((1.5, 0.5), 1.3, True),
    ((0.6, 0.6), 0.75, True), ((0.6, 0.6), 0.85, False)])
def test_nothing_singular_between_where_the_matrix_changes_little(
        values: tuple[float, float], part: float, clear: bool) -> None:
    """By three quarters of what it changes by, below the mean of both ends."""
    assert LEEWAY == 0.75
    left, right = place([0.0, 0.0], values[0]), place([0.0, 0.0], values[1], part)
    assert settled(left, right) is clear
    assert settled(right, left) is clear


def test_singular_is_a_part_of_what_it_is_at_home() -> None:
    for home in (1.0, 50.0):
        for factor in (0.9, 1.1):
            here = place([0.0, 0.0], factor * SINGULAR * home)
            assert settled(here, here, made=ways(home=home)) is (factor > 1.0)


def test_joints_bend_little_by_the_longest_step_of_joints_alike() -> None:
    """By a quarter of it. Lengths and angles are not compared; what bends much is not known."""
    made = ways(("length", "length", "angle"))
    left, right = np.zeros((1, 3)), np.array([[0.4, 0.0, 0.8]])
    little = np.array([[0.25, 0.04, 0.45]])
    np.testing.assert_allclose(made._bend(left, little, right), [[0.1, 0.08, 0.1]])
    for middle in ([[0.26, 0.0, 0.4]], [[0.2, 0.06, 0.4]], [[0.2, 0.0, 0.52]]):
        assert np.isinf(made._bend(left, np.array(middle), right)).all()
    np.testing.assert_array_equal(made._bend(left, left, left), 0.0)


def test_what_is_wrong_with_a_place_is_said_once() -> None:
    made = ways(home=1.0)
    row, q = np.array([4]), [0.0, 0.0]

    def said(at: _Places, sent: list[float] = q) -> list[str]:
        return [reason for _, reason in made._wrong(at, np.array([sent]), row)]

    assert said(place(q)) == []
    assert said(place(q), [1.0, -1.0]) == []
    assert "leaves the limits" in said(place(q), [0.0, 1.01])[0]
    assert "leaves the limits" in said(place(q), [-1.01, 0.0])[0]
    assert "from row 5 goes through a singularity" in said(place(q, sign=-1.0))[0]
    near = said(place(q, 0.9 * SINGULAR))
    assert f"condition {0.9 * SINGULAR:.2g}, 1 at home" in near[0]
    lost = place([np.nan, np.nan], np.nan, sign=np.nan)
    assert "leaves the machine's reach" in said(lost, [np.nan, np.nan])[0]
    assert len(said(place(q, 0.0, sign=-1.0), [2.0, 2.0])) == 1


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS", "linapod", "delta-rotary"])
def test_home_is_as_far_from_singular_as_home(name: str) -> None:
    """And of a table with a row that has no pose the others are what they are alone."""
    mechanism = ppmcal.load(ppmcal.shipped(name))
    pose = np.repeat(mechanism.home[None], 3, axis=0)
    pose[1] = np.nan
    pose[2] = cga.compose(motor(NONE, 0.05 * mechanism.reach * np.array([1.0, 0.5, 0.0])), pose[2])
    if mechanism.motion.turns_freely:
        pose[2] = cga.compose(pose[2], motor([0.3, -0.1, 0.05], NONE))
    made = Ways(mechanism, pose, inverse(Model(mechanism), pose).q)
    at = made._places(pose, made.q)
    assert at.value[0] == pytest.approx(made.home_value, rel=1e-9)
    away = smallest_singular_value(Model(mechanism).closure(made.q[2:]), pose[2:])[0]
    np.testing.assert_allclose(at.value[2:], away, rtol=1e-9)
    assert (at.sign[[0, 2]] == made.home_sign).all()
    assert np.isnan(at.value[1])
    assert np.isnan(at.matrix[1]).all()


def test_what_is_settled_is_not_looked_at_and_the_rest_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """A row that is asked again costs nothing; one beyond the limits is found beside it."""
    mechanism = ppmcal.load(ppmcal.shipped("6-UPS"))
    pose = np.repeat(mechanism.home[None], 3, axis=0)
    pose[2] = cga.compose(motor(NONE, [0.0, 0.0, 0.5 * mechanism.reach]), pose[2])
    made = Ways(mechanism, pose, inverse(Model(mechanism), pose).q)
    looked: list[int] = []
    joints = Ways._joints

    def counted(self: Ways, pose: Array) -> tuple[Array, Array]:
        looked.append(len(pose))
        return joints(self, pose)

    monkeypatch.setattr(Ways, "_joints", counted)
    assert made.judged(np.array([0]), np.array([1])) == {}
    assert looked == []
    found = made.judged(np.array([0, 0, 1]), np.array([1, 2, 0]))
    assert list(found) == [1]
    assert looked[0] == 1


def test_half_way_is_half_of_the_way_and_half_of_the_turn() -> None:
    """Straight and even: whatever the place, and back again the same."""
    start, end = motor([0.0, 0.0, 0.2], [1.0, 2.0, 3.0]), motor([0.0, 0.0, 1.0], [3.0, 2.0, 1.0])
    for part in (0.0, 0.25, 1.0):
        found = between(start[None], end[None], np.array([part]))
        np.testing.assert_allclose(cga.translation(found), [[1 + 2 * part, 2.0, 3 - 2 * part]])
        np.testing.assert_allclose(cga.rotation_vector(found), [[0.0, 0.0, 0.2 + 0.8 * part]],
                                   atol=1e-12)
        back = between(end[None], start[None], np.array([1.0 - part]))
        np.testing.assert_allclose(cga.translation(back), cga.translation(found))
        np.testing.assert_allclose(cga.rotation_vector(back), cga.rotation_vector(found),
                                   atol=1e-12)
