"""Steps, jumps and refusals, by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ppmcal
from ppmcal.calibration.compensation import commands as compensation
from ppmcal.calibration.compensation.commands import Compensation
from ppmcal.calibration.compensation.safe_commands import (
    JUMP,
    NOTHING,
    _followed,
    _jumps,
    own_steps,
    refused,
    worse_rows,
)
from ppmcal.io.effects import with_effects
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import inverse_table
from ppmcal.model.registration import Registration
from ppmcal.units import SI

Array = NDArray[np.float64]
REACH = 2.0


def machine(ratio: float = 1.0) -> Any:
    """Return as much of a machine as is asked for: two slides and a motor of some gear ratio."""
    return SimpleNamespace(
        actuators=("leg1", "leg2", "arm"), actuator_quantity=("length", "length", "angle"),
        joint_units=((1e-3, "mm"), (1e-3, "mm"), (np.pi / 180.0, "deg")), reach=REACH, values=None,
        joint_ratios=np.abs([1.0, 1.0, ratio]), length_scale=0.5,
        units=SimpleNamespace(factor=lambda quantity: 1e-3,
                              name={"length": "mm", "angle": "mrad"}.get))


def commands(q: Array, nominal: Array, **more: Any) -> Compensation:
    none = np.zeros(len(q))
    parts: dict[str, Any] = dict.fromkeys(
        ("position_before", "position_after", "rotation_before", "rotation_after",
         "sigma_position", "sigma_rotation", "sigma_position_before", "sigma_rotation_before"),
        none) | more
    pose = np.zeros((len(q), 6))
    return Compensation(q, nominal, pose, pose, pose, status=("ok",) * len(q),
                        reason=("",) * len(q), **parts)


STEPS = np.array([0, 1]), np.array([1, 2])


@pytest.mark.parametrize("ratio", [1.0, -4.0])
def test_a_correction_may_change_by_a_quarter_of_the_targets_step(ratio: float) -> None:
    """Of the longest step of joints alike: slides and motors are not compared. By ratio."""
    nominal = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.4]])
    fine = nominal + np.array([[0.0, 0.0, 0.0], [0.0, 0.0249, 0.0], [0.0, 0.0, 0.0999]])
    assert own_steps(machine(ratio), commands(fine, nominal)).beyond.tolist() == [0.0, 0.0]
    assert _jumps(machine(ratio), fine, nominal, *STEPS) == {}
    far = nominal + np.array([[0.0, 0.0, 0.0], [0.0, 0.0251, 0.0], [0.0, 0.0251, 0.1001]])
    found = own_steps(machine(ratio), commands(far, nominal))
    np.testing.assert_allclose(found.beyond, [0.0251, 0.1001 * abs(ratio)])
    assert (found.joint.tolist(), found.rows.tolist()) == ([1, 2], [1, 2])
    said = _jumps(machine(ratio), far, nominal, *STEPS)
    assert said[0].startswith("leg2 would jump by 25.1 mm from row 1")
    assert said[1].startswith("arm would jump by 28.6536 deg from row 2")
    assert JUMP == 0.25


def test_round_off_is_no_step() -> None:
    nominal = np.zeros((3, 3))
    q = nominal + [[0, 0, 0], [0.9 * NOTHING * REACH, 0, 0], [0, 0, 0.9 * NOTHING]]
    assert not own_steps(machine(), commands(q, nominal)).beyond.any()
    assert own_steps(machine(), commands(3.0 * q, nominal)).beyond.all()


def test_rows_without_a_command_are_stepped_over() -> None:
    nominal = np.zeros((3, 3))
    q = np.array([[0.0, 0.0, 0.0], [np.nan] * 3, [0.3, 0.0, 0.0]])
    found = own_steps(machine(), commands(q, nominal))
    assert (found.rows.tolist(), found.beyond.tolist()) == ([2], [0.3])


@pytest.mark.parametrize(("turn", "ratio", "long"), [
    (179.0, 1.0, False), (-181.0, 1.0, True), (61.0, -3.0, True), (59.0, 3.0, False)])
def test_more_than_half_a_turn_is_the_long_way_round(turn: float, ratio: float, long: bool) -> None:
    """Of the joint, not of the motor before its gear; a slide goes as far as it likes."""
    q = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, np.radians(turn)]])
    said = _jumps(machine(ratio), q, q, np.array([0]), np.array([1]))
    assert (said == {}) != long
    assert not long or said[0].startswith(
        f"arm would turn by {abs(turn * ratio):.4g} deg from row 1")


def test_worse_is_worse_in_position_or_in_rotation_with_what_is_not_known_in_both() -> None:
    """What is left and what is not known add as squares, with correction and without."""
    n = 8
    found = commands(
        np.zeros((n, 3)), np.zeros((n, 3)), position_before=np.full(n, 3e-3),
        rotation_before=np.full(n, 8e-3), sigma_position_before=np.full(n, 4e-3),
        position_after=np.array([3e-3, 3e-3, 0.0, 0.0, np.nan, 5.04e-3, 0.0, 0.0]),
        sigma_position=np.array([4.1e-3, 3.9e-3, 5.1e-3, 4e-3, 1e-4, 0.0, 4e-3, np.nan]),
        rotation_after=np.array([0.0, 0.0, 0.0, 7e-3, np.nan, 0.0, 0.0, 8.1e-3]),
        sigma_rotation=np.array([0.0, 0.0, 0.0, 5e-3, 1e-4, 0.0, 0.0, np.nan]))
    refused_rows = worse_rows(machine(), found)
    assert sorted(refused_rows) == [0, 2, 3, 4, 7]
    assert "cannot be predicted" in refused_rows[4]
    assert "5.08 mm of position with it, 5 mm without" in refused_rows[0]
    assert f"{1e3 * np.hypot(7e-3, 5e-3):.3g} mrad of rotation with it, 8 mrad without" in (
        refused_rows[3])
    # the same model is not known to the same part, whatever is sent
    doubtful = commands(np.zeros((2, 3)), np.zeros((2, 3)), position_before=np.full(2, 1e-3),
                        sigma_position=np.full(2, 9e-3), sigma_position_before=np.full(2, 9e-3))
    assert worse_rows(machine(), doubtful) == {}


def test_arithmetic_is_not_worse_than_none() -> None:
    size = NOTHING * np.array([0.9, 1.1])
    found = commands(np.zeros((2, 3)), np.zeros((2, 3)), position_after=REACH * size)
    assert list(worse_rows(machine(), found)) == [1]
    turned = commands(np.zeros((2, 3)), np.zeros((2, 3)), rotation_after=size)
    assert list(worse_rows(machine(), turned)) == [1]
    # the uncertainty itself is predicted linearly: a hair more of it is none
    for more, worse in ((1.009, []), (1.011, [0, 1])):
        one = commands(np.zeros((2, 3)), np.zeros((2, 3)), sigma_position=np.full(2, more * 1e-3),
                       sigma_position_before=np.full(2, 1e-3))
        assert list(worse_rows(machine(), one)) == worse


def test_what_is_told_of_commands_is_the_same_row_by_row_and_together() -> None:
    """Error to expect: of uncorrected and corrected commands, the uncertainty in both."""
    found = commands(np.zeros((2, 3)), np.zeros((2, 3)), position_before=np.array([3.0, 0.0]),
                     sigma_position_before=np.array([4.0, 1.0]), sigma_position=np.full(2, 2.0))
    before, after = found.expected("position")
    assert before.tolist() == [5.0, 1.0] and after.tolist() == [2.0, 2.0]
    assert found.rms("position") == (np.sqrt(13.0), 2.0, 2.0)
    unknown = np.full(2, np.nan)
    found = commands(np.zeros((2, 3)), np.zeros((2, 3)), position_before=np.full(2, 3.0),
                     sigma_position_before=unknown, sigma_position=unknown)
    assert found.rms("position") == (3.0, None, None)


def test_a_refused_row_has_no_command_and_says_why() -> None:
    found = commands(np.ones((3, 3)), np.ones((3, 3)))
    assert refused(found, {}) is found
    one = refused(found, {1: "why"})
    assert (one.status, one.reason) == (("ok", "refused", "ok"), ("", "why", ""))
    assert np.isnan(one.q).all(axis=1).tolist() == [False, True, False]
    assert np.isnan(one.command).all(axis=1).tolist() == [False, True, False]
    assert np.isfinite(one.pose).all()
    assert refused(one, {0: "too"}).status == ("refused", "refused", "ok")


def test_whatever_ways_fail_rows_are_followed_as_one_by_one() -> None:
    """Each is judged from the last one that is not refused, even if that was refused a while."""
    rng = np.random.default_rng(6)
    for _ in range(300):
        wrong = rng.random((12, 12)) < 0.6

        def judge(a: Any, b: Any, wrong: Any = wrong) -> dict[int, str]:
            return {int(n): f"{a[n]}" for n in np.flatnonzero(wrong[a, b])}

        want, last = {}, 0
        for n in range(1, 12):
            if wrong[last, n]:
                want[n] = f"{last}"
            else:
                last = n
        assert _followed(np.arange(12), judge) == want


def test_behind_a_wall_twice_as_many_are_tried_each_time() -> None:
    asked: list[int] = []

    def judge(a: Any, b: Any) -> dict[int, str]:
        asked.append(len(a))
        return {int(n): "wall" for n in np.flatnonzero((a < 5) & (b >= 5))}

    assert list(_followed(np.arange(40), judge)) == list(range(5, 40))
    assert asked == [39, 2, 4, 8, 16, 5]


@pytest.mark.parametrize(("kind", "sequence", "asked"), [
    ("play", True, 2), ("play", False, 1), ("gain", True, 1), ("gain", False, 1)])
def test_only_what_remembers_its_way_is_solved_for_the_joints_that_are_sent(
        monkeypatch: pytest.MonkeyPatch, kind: str, sequence: bool, asked: int) -> None:
    """Targets in their order make a way; what remembers none of it is as it is at once."""
    mechanism = with_effects(ppmcal.load(ppmcal.shipped("3-RPR")),
                             [{"kind": kind, "parameters": {
                                 "play": {"width": 1e-4}, "gain": {"gain": 1e-3}}[kind]}], SI, "e")
    tables: list[int] = []

    def counted(model: Any, *known: Any) -> Any:
        tables.append(len(model.mechanism.effects))
        return inverse_table(model, *known)

    monkeypatch.setattr(compensation, "inverse_table", counted)
    wanted = np.full((4, 6), np.nan)
    wanted[:, [0, 1, 5]] = pose_vector(mechanism.home[None])[0, [0, 1, 5]] + np.outer(
        [0.0, 0.01, 0.02, 0.01], [1.0, 0.5, 0.2])
    found = compensation.compensate(mechanism, wanted, Registration(), sequence=sequence)
    assert np.isfinite(found.q).all() == (kind == "gain" or sequence)
    assert sum(n > 0 for n in tables) == asked
