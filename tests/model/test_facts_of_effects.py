"""What effects and slots say of themselves: quantities, how long they hold, what is uncertain."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.model.effects import LimbSetting, ScanRange, Setting, effect_kinds
from ppmcal.model.effects.bed_shape import SHAPES
from ppmcal.model.effects.inputs import BY_NEED
from ppmcal.model.effects.learned import LearnedCurve
from ppmcal.model.effects.plate_compliance import _pushed
from ppmcal.model.effects.setting import PLACE, Shift, total
from ppmcal.model.effects.wave import wave
from ppmcal.model.limbs import kinds as limb_kinds
from ppmcal.model.motions import PLANAR, SPATIAL
from ppmcal.model.parameters import Parameter

Array = NDArray[np.float64]
TURNS = {"rx", "ry", "rz"}


@pytest.mark.parametrize("kind", ["drift", "target_shift", "base_shift"])
def test_turns_are_angles_and_ways_are_lengths(kind: str) -> None:
    found = effect_kinds()[kind]
    for motion in found.motions:
        specs = {s.name: s for s in found.parameters(motion) if s.name in PLACE}
        assert set(specs) >= set(motion.coordinates)
        for name, spec in specs.items():
            assert spec.quantity.split("/")[0] == ("angle" if name in TURNS else "length")


@pytest.mark.parametrize(("joints", "fine", "no"), [
    ((), (), (0.005, np.pi / 100)), (("length",), (0.001, 0.0025, 0.005), (0.012, np.pi / 100)),
    (("angle",), (np.pi / 100, np.pi / 160), (0.002, 0.005)),
    (("length", "angle"), (0.005, np.pi / 160), ())])
def test_beyond_the_scan_periods_are_those_that_drives_have(
        joints: tuple[str, ...], fine: tuple[float, ...], no: tuple[float, ...]) -> None:
    """Which are coarse enough for the scan are there already."""
    (scan,) = [s.scan for s in effect_kinds()["periodic"].parameters(SPATIAL) if s.scan]
    stroke = 3.0 if "angle" in joints else 0.8
    plain = list(scan(ScanRange(stroke, 90)))
    found = list(scan(ScanRange(stroke, 90, joints=frozenset(joints))))
    assert found[:len(plain)] == plain == sorted(plain, reverse=True)
    rest = found[len(plain):]
    assert rest == sorted(rest, reverse=True) and max([0.0, *rest]) < plain[-1]
    assert all(np.isclose(rest, p, rtol=1e-12).any() for p in fine)
    assert not any(np.isclose(rest, p, rtol=1e-12).any() for p in no)


@pytest.mark.parametrize("kind", limb_kinds())
def test_frame_errors_of_joints_are_three_ways_and_three_turns(kind: str) -> None:
    for slot in limb_kinds()[kind].slots:
        joint, _, part = slot.name.rpartition(".")
        if joint.startswith("joint") and part in {"x", "y", "z", *TURNS}:
            assert slot.quantity == ("angle" if part in TURNS else "length"), slot.name


@pytest.mark.parametrize(("acts", "joint", "quantity"), [
    ("joint", "length", "length"), ("joint", "angle", "angle"), ("z", "angle", "length"),
    ("rx", "length", "angle")])
def test_a_learned_term_is_of_what_it_acts_on(acts: str, joint: str, quantity: str) -> None:
    nodes = np.arange(3.0)
    made = LearnedCurve("travel", nodes, nodes, np.zeros((3, 3)), acts=acts, joint=joint)
    assert made.quantity == quantity
    assert made.input_quantity == joint


@pytest.mark.parametrize("size", [1.0, 1e-7, 1e-12])
def test_modes_are_the_covariance_however_small(size: float) -> None:
    """As many as it has rank; of certain values none."""
    a = size * np.random.default_rng(1).normal(size=(4, 2))
    made = LearnedCurve("travel", np.arange(4.0), np.zeros(4), a @ a.T)
    assert made.modes.shape == (4, 2)
    np.testing.assert_allclose(made.modes @ made.modes.T, a @ a.T, atol=1e-9 * size**2)
    certain = LearnedCurve("travel", np.arange(4.0), np.zeros(4), np.zeros((4, 4)))
    assert certain.modes.shape == (4, 0)


def rows(n: int, limbs: tuple[LimbSetting, ...] = (), until: Array | None = None) -> Setting:
    none: Any = np.zeros((n, 2))
    return Setting(SPATIAL, np.zeros(2, dtype=bool), none, np.zeros((2, 2)), none, none,
                   np.linspace(-2.0, 3.0, n), np.zeros((n, 6)), np.arange(float(n)),
                   np.arange(float(n)), limbs, lambda w: none, lambda w: none, np.zeros((n, 3)),
                   np.array([0.0, 0.0, -1.0]), np.tile(np.eye(3), (n, 1, 1)), until=until)


def test_an_event_holds_from_its_row_until_the_next_takes_its_place() -> None:
    at = rows(6, until=np.array([4.0, np.inf]))
    np.testing.assert_array_equal(at.since(2.0), [[0, 0], [0, 0], [1, 1], [1, 1], [0, 1], [0, 1]])
    np.testing.assert_array_equal(rows(3).since(1.0), [[0, 0], [1, 1], [1, 1]])


def test_joint_centres_of_each_row_or_of_all() -> None:
    """A coordinate that a limb has not is 0; one that changes from row to row makes rows."""
    def limb(**base: Any) -> LimbSetting:
        return LimbSetting(0, {}, {f"base.point.{c}": np.asarray(v) for c, v in base.items()}, {})

    still = rows(3, (limb(x=1.0, y=2.0), limb(x=3.0, z=4.0))).points("base")
    np.testing.assert_array_equal(still, [[[1, 2, 0], [3, 0, 4]]])
    moving = rows(3, (limb(x=1.0, y=2.0), limb(x=[3.0, 4.0, 5.0]))).points("base")
    np.testing.assert_array_equal(moving[:, 0], [[1, 2, 0]] * 3)
    np.testing.assert_array_equal(moving[:, 1, 0], [3, 4, 5])
    assert rows(3, (limb(),)).points("base").tolist() == [[[0, 0, 0]]]


@pytest.mark.parametrize("tau", [0.0, 0.5])
def test_what_lags_not_at_all_needs_no_past(tau: float) -> None:
    """Half a second is a lag like any other: without a past nothing is known of it."""
    found, slope = rows(4).late(tau)
    if tau:
        assert np.isnan(found).all()
        assert np.isnan(slope).all()
    else:
        np.testing.assert_array_equal(found, np.linspace(-2.0, 3.0, 4))
        assert not slope.any()


def test_shifts_add_slot_by_slot_and_part_by_part() -> None:
    one = Shift({(0, "length"): np.array([1.0]), (1, "offset"): np.array([2.0])},
                pose=np.ones((1, 6)))
    two = Shift({(0, "length"): np.array([3.0])}, pose=np.full((1, 6), 2.0),
                stretch=np.ones((1, 3, 3)))
    both = total([one, two, one.times(-1.0)])
    assert {k: v.tolist() for k, v in both.slots.items()} == {(0, "length"): [3.0],
                                                              (1, "offset"): [0.0]}
    np.testing.assert_array_equal(both.pose, two.pose)
    np.testing.assert_array_equal(both.stretch, two.stretch)
    assert (both.frame, both.target) == (None, None)


def test_scans_of_a_compliance_cover_what_they_say() -> None:
    """Under the largest load 1/1.3 to about 1/13 as soft; 12 to 84 % at the ends of the stroke."""
    data = ScanRange(0.4, 20, tuple(range(1, 21)), 50.0, 0.4, 0.2)
    specs = {s.name: s for s in effect_kinds()["compliance"].parameters(SPATIAL)}
    assert specs["hardening"].scan is not None
    assert specs["by_stroke"].scan is not None
    soft = np.array(specs["hardening"].scan(data)) * data.load + 1.0
    assert soft[[0, -1]] == pytest.approx([1.3, 1.0 + 0.3 * 1.4**11])
    np.testing.assert_allclose((soft[1:] - 1.0) / (soft[:-1] - 1.0), 1.4)
    assert specs["hardening"].scan(ScanRange(0.4, 20, (1,), 0.0, 0.4, 0.2)) == []
    ends = np.array(specs["by_stroke"].scan(data)) * data.stroke / 2.0
    np.testing.assert_allclose(ends, [s * 0.12 * i for s, i in [
        *((-1, i) for i in range(7, 0, -1)), *((1, i) for i in range(1, 8))]])


def test_usual_ranges_are_possible_and_as_wide_to_either_side() -> None:
    """What has a sign is as often above 0 as below; all else is never below."""
    for kind in effect_kinds().values():
        for spec in (s for motion in kind.motions for s in kind.parameters(motion)
                     if np.isfinite(s.usual).all()):
            low, high = spec.usual
            assert low < high, spec.name
            assert high <= spec.high, spec.name
            assert low >= 0.0 or low == -high, (kind.name, spec.name)
            if np.isfinite([spec.low, spec.high]).all() and spec.low < 0.0:
                assert spec.low == -spec.high, (kind.name, spec.name)


def test_what_is_named_is_possible_and_a_drives_error_is_a_small_part_of_its_stroke() -> None:
    for kind in effect_kinds().values():
        for spec in (s for motion in kind.motions for s in kind.parameters(motion)):
            if np.isfinite(spec.usual[0]) and not spec.of_stroke:
                assert spec.low <= spec.usual[0], (kind.name, spec.name)
            # a parameter's size is a step of it: lengths and angles move by little
            assert spec.size <= 0.01 or spec.quantity not in ("length", "angle"), spec.name
            if spec.of_stroke and spec.name != kind.period:
                assert max(map(abs, spec.usual)) <= 0.2, (kind.name, spec.name)


def test_play_is_looked_for_at_widths_that_some_moves_do_not_cross() -> None:
    """Within a twentieth and a ten thousandth of the stroke, none near the one before."""
    scan = effect_kinds()["play"].parameters(SPATIAL)[0].scan
    assert scan is not None
    stroke = 0.4

    def widths(*moves: float) -> Array:
        return np.array(scan(ScanRange(stroke, 20, moves=tuple(moves)))) / stroke

    without = widths()
    np.testing.assert_allclose(without[[0, 2]], [1e-4, 0.05])
    assert without[1] / without[0] == pytest.approx(without[2] / without[1])
    np.testing.assert_allclose(widths(*[0.01 * stroke] * 9), [0.01])
    np.testing.assert_allclose(widths(*[1e-6] * 9), [1e-4])
    np.testing.assert_allclose(widths(*[stroke] * 9), [0.05])
    several = widths(*(stroke * np.linspace(0.001, 0.041, 11)))
    np.testing.assert_allclose(several, [0.001, 0.009, 0.017])
    near = widths(*(stroke * np.linspace(0.01, 0.02, 11)))
    np.testing.assert_allclose(near, [0.01])


def test_of_hysteresis_as_much_is_unsettled_as_of_its_plays() -> None:
    """Each by its share, whatever the sign; of joints without the effect nothing."""
    kind = effect_kinds()["hysteresis"]
    assert kind.unsettled is not None
    at: Any = SimpleNamespace(stroke=np.array([[0.0, 1.0], [2.0, 5.0]]),
                              unsettled=lambda w, start: np.tile(np.asarray(w) / 2.0, (4, 1)))
    values = {"w1": 0.0, "w2": -0.5, "w3": 0.1, "low": np.nan, "high": np.nan}
    found = kind.unsettled(at, np.array([True, True]), values)
    np.testing.assert_allclose(found, [[0.0175, 0.0525]] * 4)
    own = kind.unsettled(at, np.array([True, False]), values | {"low": 1.0, "high": 3.0})
    np.testing.assert_allclose(own, [[0.035, 0.0]] * 4)


@pytest.mark.parametrize("kind", limb_kinds())
def test_what_a_file_may_leave_out_is_no_offset_and_no_gear(kind: str) -> None:
    for slot in limb_kinds()[kind].slots:
        if slot.default is not None:
            assert slot.default == (1.0 if slot.name == "ratio" else 0.0), slot.name


@pytest.mark.parametrize("turns", [0.3, -2.0, 40.0])
def test_a_waves_phase_is_where_it_is_at_mid_stroke(turns: float) -> None:
    """cos(w) c + sin(w) s = amplitude cos(phase + w - w0), whatever w; phases are in a turn."""
    amplitude, phase = wave("c", "s", lambda values, q: turns * q)
    values = {"c": 0.6, "s": -0.8}
    a, p = (part.value(values, 0.7) for part in (amplitude, phase))
    assert a == pytest.approx(1.0)
    assert abs(p) <= np.pi
    for q in (0.0, 0.7, 1.3):
        w, w0 = turns * q, turns * 0.7
        assert 0.6 * np.cos(w) - 0.8 * np.sin(w) == pytest.approx(np.cos(p + w - w0))


def test_traits_that_go_together() -> None:
    """What gives way under a constant weight follows the load; a vector is no joint's."""
    for kind in effect_kinds().values():
        assert kind.uses_load or not kind.under_weight, kind.name
    for known in (*BY_NEED.values(), *(k.follows for k in effect_kinds().values() if k.follows)):
        assert known.of_machine or not known.components, known.name


@pytest.mark.parametrize("away", [0.0, 1.0])
def test_a_plate_bends_along_its_normal_wherever_its_origin_is(away: float) -> None:
    """Of the base as it is pushed, of the platform by what pushes back, in its own axes."""
    rng = np.random.default_rng(7)
    normal, along = np.array([1.0, 2.0, 2.0]) / 3.0, np.array([[2.0, 1.0, -2.0], [2.0, -2.0, 1.0]])
    points = (rng.normal(size=(6, 2)) @ along + away * np.array([3.0, -1.0, 2.0]))[None]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    at: Any = SimpleNamespace(forces=rng.normal(size=(4, 6, 3)), motion=SPATIAL,
                              turn=np.repeat(turn[None], 4, axis=0))
    base = _pushed(at, "base", points)
    np.testing.assert_allclose(base, (at.forces @ normal)[..., None] * normal, atol=1e-12)
    own = _pushed(at, "platform", points)
    np.testing.assert_allclose(own, -(at.forces @ turn @ normal)[..., None] * normal, atol=1e-12)
    at.motion = PLANAR
    np.testing.assert_array_equal(_pushed(at, "base", points), at.forces)


def test_shapes_of_a_flat_are_waves_around_the_middle() -> None:
    """r^n cos k phi or sin k phi, n up to 3: 1 at the rim, and none of them a height or a tilt."""
    phi = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    waves = {"bowl": (2, 0, np.cos), "saddle": (2, 2, np.cos), "twist": (2, 2, np.sin),
             "coma_x": (3, 1, np.cos), "coma_y": (3, 1, np.sin), "trefoil_x": (3, 3, np.cos),
             "trefoil_y": (3, 3, np.sin)}
    assert set(waves) == set(SHAPES)
    for name, (n, k, wave_of) in waves.items():
        for r in (0.0, 0.6, 1.0):
            found = SHAPES[name](r * np.cos(phi), r * np.sin(phi))
            np.testing.assert_allclose(found, r**n * wave_of(k * phi), atol=1e-12)


def test_speeds_of_friction_go_up_by_even_parts_about_the_recorded_one() -> None:
    scan = effect_kinds()["friction"].parameters(SPATIAL)[2].scan
    assert scan is not None
    found = np.array(scan(ScanRange(0.4, 20, speed=0.03))) / 0.03
    assert 1.0 in found
    assert found[0] < 0.2
    assert found[-1] > 2.0
    np.testing.assert_allclose(found[1:] / found[:-1], 2.55, atol=0.15)


@pytest.mark.parametrize("value", [0.1, -2e7])
def test_what_steps_make_ever_smaller_is_never_nothing(value: float) -> None:
    """A stiffness or a reach of 0 would be divided by; steps in 1/value shrink it as they like."""
    parameter = Parameter("reach", "length", value, value, reciprocal=True)
    for _ in range(30):
        value = parameter.stepped(value, -1e9 * float(np.sign(value)))
        assert value * parameter.value > 0.0 and np.isfinite(1.0 / value)
    assert abs(value) < 1e-300
