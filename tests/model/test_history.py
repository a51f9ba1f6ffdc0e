"""Effects with memory: operators against plain loops, rows that are left out, what is refused.

The loops are written here from the definitions, a row at a time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.paths import ROOT
from hypothesis import given
from hypothesis import strategies as st

from ppmcal.calibration.compensation.commands import compensate
from ppmcal.calibration.interpretation import unit_findings
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.effects import effects_tree, with_effects
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import effect_terms, environment_of, setting, with_strokes
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.needed_columns import ORDER, missing_columns
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import inverse_table, with_joints
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset, environment
from ppmcal.model.effects import effect_kinds
from ppmcal.model.history import lagged, slack, ways
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import PLANAR
from ppmcal.model.registration import Registration
from ppmcal.units import SI

CONFIGS = ROOT / "configs"
BENCH = read_mechanism(CONFIGS / "3-RPR.yaml")
seeds = st.integers(0, 2**31)


def looped_play(u: Array, half: float, start: float) -> Array:
    """Return play's output minus its input, from ``start`` half widths off the first input."""
    out, now = np.full(u.size, np.nan), np.nan
    for k, x in enumerate(u):
        if np.isfinite(x):
            now = x + start * half if np.isnan(now) else max(x - half, min(x + half, now))
            out[k] = now - x
    return out


def looped_lag(time: Array, drive: Array, tau: float) -> Array:
    """Return the state of x' = (drive - x)/tau in very small steps of Euler's method."""
    out, now, last = np.full(drive.size, np.nan), np.nan, np.nan
    for k, f in enumerate(drive):
        if np.isfinite(f):
            now = f if np.isnan(now) else f + (now - f) * np.exp(-(time[k] - last) / tau)
            last, out[k] = time[k], now
    return out


def walk(rng: np.random.Generator, n: int, gaps: bool = True) -> Array:
    """Return a path (n, 3) of short and long moves, rests and missing values."""
    step = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-3.0, 0.0, (n, 3))
    u = np.cumsum(np.where(rng.random((n, 3)) < 0.1, 0.0, step), axis=0)
    return np.where(rng.random((n, 3)) < 0.05, np.nan, u) if gaps else u


@given(seeds, st.integers(1, 90))
def test_play_against_a_loop(seed: int, n: int) -> None:
    """In the middle of what both ends of the unknown start make, and exact once they meet."""
    rng = np.random.default_rng(seed)
    u, half = walk(rng, n), rng.uniform(0.0, 0.5, 3)
    found = slack(u, half)[0]
    for a in range(3):
        low, high = (looped_play(u[:, a], half[a], s) for s in (-1.0, 1.0))
        np.testing.assert_allclose(found[:, a], (low + high) / 2.0, rtol=0.0, atol=1e-13)
        # the state is known from where the path has spanned a full width
        seen = np.where(np.isfinite(u[:, a]), u[:, a], np.inf)
        span = np.maximum.accumulate(np.where(np.isfinite(seen), seen, -np.inf)) - (
            np.minimum.accumulate(seen))
        sure = np.isfinite(u[:, a]) & (span > 2.0 * half[a] + 1e-12)
        any_start = looped_play(u[:, a], half[a], rng.uniform(-1.0, 1.0))
        np.testing.assert_allclose(found[sure, a], any_start[sure], rtol=0.0, atol=1e-13)


@given(seeds, st.integers(1, 90))
def test_lag_against_a_loop(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.exponential(20.0, n) * (rng.random(n) < 0.9))
    drive, tau = walk(rng, n), 10.0 ** rng.uniform(-1.0, 4.0)
    found = lagged(time, drive, tau)[0]
    for a in range(3):
        np.testing.assert_allclose(found[:, a], looped_lag(time, drive[:, a], tau), rtol=0.0,
                                   atol=1e-13 * max(1.0, np.nanmax(np.abs(drive), initial=0.0)))


def test_a_step_is_followed_exponentially() -> None:
    """Two time constants after a step e^-2 of it is left, in however many rows."""
    for times in ([0.0, 60.0], [0.0, 1.0, 7.0, 7.0, 60.0]):
        time = np.array(times)
        drive = np.where(time > 0.0, 10.0, 4.0)
        assert lagged(time, drive, 30.0)[0][-1] == pytest.approx(10.0 - 6.0 * np.exp(-2.0),
                                                                 rel=1e-14)


def test_what_is_unknown_of_play_is_what_its_start_changes() -> None:
    """Half of what lies between the loops that start at either end of the gap, 0 once crossed."""
    data = campaign()
    at = setting(Model(BENCH), environment_of(BENCH, data), data.q, np.full((len(data), 8), np.nan))
    for width in (1e-3, 0.02, 0.2, -0.02):
        found = at.unsettled(width)
        for a, q in enumerate(data.q.T):
            ends = [looped_play(q, 0.5 * abs(width), side) for side in (-1.0, 1.0)]
            np.testing.assert_allclose(found[:, a], 0.5 * (ends[1] - ends[0]), atol=1e-15)
            middle = at.slack(abs(width))[0][:, a]
            np.testing.assert_allclose(at.unsettled(width, -0.4)[:, a],
                                       looped_play(q, 0.5 * abs(width), -0.4) - middle, atol=1e-15)
        assert (found[0] > 0.0).all()
    assert (at.unsettled(0.02)[-1] == 0.0).all()


def test_derivatives_of_the_operators() -> None:
    rng = np.random.default_rng(8)
    u, half, time = walk(rng, 200), np.array([0.02, 0.1, 0.4]), np.cumsum(rng.uniform(0, 30, 200))
    e = 1e-7
    apart = (slack(u, half + e)[0] - slack(u, half - e)[0]) / (2.0 * e)
    np.testing.assert_allclose(slack(u, half)[1], apart, rtol=0.0, atol=1e-6)
    assert {-1.0, 0.0, 1.0} >= set(np.unique(slack(u, half)[1][np.isfinite(u)]).tolist())
    apart = (lagged(time, u, 80.001)[0] - lagged(time, u, 79.999)[0]) / 2e-3
    np.testing.assert_allclose(lagged(time, u, 80.0)[1], apart, rtol=0.0, atol=1e-9)


# --- rows ---------------------------------------------------------------------------------------

EFFECTS: dict[str, dict[str, Any]] = {
    "play": {"kind": "play", "parameters": {"width": 0.02}},
    "play ahead": {"kind": "play", "parameters": {"width": -0.02}},
    "hysteresis": {"kind": "hysteresis", "parameters": {"w1": 1e-3, "w2": 2e-3, "w3": -1e-3}},
    "creep": {"kind": "creep", "parameters": {"give": 1e-6, "tau": 90.0}},
    "leg": {"kind": "leg_thermal", "parameters": {"expansion": 1e-5, "tau": 200.0}},
    "base": {"kind": "base_thermal", "parameters": {"expansion": 1e-5, "tau": 200.0}},
    "platform": {"kind": "platform_thermal", "parameters": {"expansion": 1e-5, "tau": 200.0}},
    "motion": {"kind": "leg_thermal", "from": "motion",
               "parameters": {"growth": 1e-2, "tau": 200.0}},
    **{f"motion of the {body}": {"kind": f"{body}_thermal", "from": "motion",
                                 "parameters": {"growth": 1e-2, "tau": 200.0}}
       for body in ("base", "platform")}}
each_effect = pytest.mark.parametrize("name", EFFECTS)


def acting(name: str, machine: Mechanism = BENCH) -> Mechanism:
    return with_effects(machine, [EFFECTS[name]], SI, "effects.yaml")


def campaign(approach: str = "sequence", timed: bool = True, n: int = 60) -> Dataset:
    """Return rows in which joints make short and long moves, under loads and a warming hall."""
    rng = np.random.default_rng(4)
    q = 0.6 + 0.05 * np.clip(np.cumsum(walk(rng, n, gaps=False), axis=0), -1.0, 1.0)
    pose = np.zeros((n, 6))
    data = Dataset.of_poses("run", q, pose, (1e-5, 1e-5), fitted=True)
    columns = {"temperature": 293.15 + np.linspace(0.0, 9.0, n) + rng.normal(size=n),
               "payload": rng.choice([0.0, 10.0, 30.0], n)}
    if timed:
        columns["time"] = np.cumsum(rng.uniform(5.0, 120.0, n))
    return replace(data, columns=columns, approach=approach)


def added(mechanism: Mechanism, data: Dataset) -> Array:
    """Return what the effects add to slots, one column each (N, slots)."""
    model = Model(mechanism)
    pose = forward(Model(BENCH), data.q).pose
    at = setting(model, environment_of(mechanism, data), data.q, pose)
    (_, terms), = effect_terms(mechanism, mechanism.values, at)
    return np.stack([np.broadcast_to(v, (len(data),)) for v in terms.shift.slots.values()], axis=1)


@each_effect
@pytest.mark.slow_cases("creep")
def test_rows_that_are_left_out_were_visited_all_the_same(name: str) -> None:
    """A part of the rows, in any order, has the values that it has in the whole file."""
    mechanism, data = acting(name), campaign()
    whole = added(mechanism, data)
    assert np.isfinite(whole).all()
    assert np.ptp(whole) > 1e-9
    for part in (np.arange(30, 60), np.arange(60)[::-1], np.arange(0, 60, 7),
                 np.random.default_rng(1).permutation(60)[:20]):
        np.testing.assert_array_equal(added(mechanism, data.take(part)), whole[part])
        np.testing.assert_array_equal(added(mechanism, data.take(part).take(np.arange(8, 2, -1))),
                                      whole[part[8:2:-1]])


@each_effect
def test_a_file_out_of_order_whose_times_tell(name: str) -> None:
    """Without `approach: sequence` the times are the order, whatever the file's."""
    mechanism, data = acting(name), campaign("unknown")
    mixed = np.random.default_rng(2).permutation(len(data))
    other = replace(data, q=data.q[mixed], columns={n: c[mixed] for n, c in data.columns.items()})
    np.testing.assert_array_equal(added(mechanism, other), added(mechanism, data)[mixed])


def test_play_is_backlash_where_every_move_is_longer() -> None:
    """Of the other sign: behind the move. Where moves are shorter it is something else."""
    data = campaign()
    long = replace(data, q=0.6 + 0.1 * np.random.default_rng(3).uniform(-1.0, 1.0, data.q.shape))
    play = with_effects(BENCH, [{"kind": "play", "parameters": {"width": 2e-5}}], SI, "e")
    ahead = with_effects(BENCH, [{"kind": "play", "parameters": {"width": -2e-5}}], SI, "e")
    gap = with_effects(BENCH, [{"kind": "backlash", "parameters": {"width": 2e-5}}], SI, "e")
    np.testing.assert_allclose(added(play, long)[1:], -added(gap, long)[1:], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(added(ahead, long)[1:], added(gap, long)[1:], rtol=0.0, atol=1e-15)
    assert (added(play, long)[0] == 0.0).all()
    wide = acting("play")
    assert np.abs(added(wide, data)[1:] + 1e3 * added(gap, data)[1:]).max() > 5e-3


def test_a_ratio_below_zero_turns_nothing(tmp_path: Path) -> None:
    """Play is behind in u; counts down from an endstop make no difference."""
    text = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text(encoding="utf-8"))
    data = campaign()
    for limb in text["limbs"]:
        limb["ratio"] = -12.5    # mm per count
    text["home"] = {"pose": text["home"]["pose"]}
    text.pop("limits", None)
    (tmp_path / "counts.yaml").write_text(yaml.safe_dump(text))
    counts = read_mechanism(tmp_path / "counts.yaml")
    other = replace(data, q=data.q / -0.0125)
    for name in ("play", "motion"):
        np.testing.assert_allclose(added(acting(name, counts), other), added(acting(name), data),
                                   rtol=1e-9, atol=1e-15)


def test_late_heat_without_lag_is_plain_heat() -> None:
    """tau 0 is what the thermometer says, without any past."""
    data = campaign("unknown", timed=False)
    plain = with_effects(BENCH, [{"kind": "leg_thermal", "parameters": {"expansion": 1e-5}}], SI,
                         "e")
    warm = 1e-5 * (data.columns["temperature"] - 293.15)
    np.testing.assert_allclose(added(plain, data) / data.q, np.tile(warm[:, None], 3), rtol=1e-12)
    assert not missing_columns(plain, environment_of(plain, data))
    assert "tau" not in effects_tree(plain)[0]["parameters"]
    assert effects_tree(acting("leg"))[0]["parameters"]["tau"] == 200.0


def test_heat_of_motion() -> None:
    """A joint that has gone back and forth is warm; one at rest is not."""
    data = campaign()
    q = data.q.copy()
    q[:, 2] = q[0, 2]
    found = added(acting("motion"), replace(data, q=q)) / q
    assert (found[:, 2] == 0.0).all()
    time = data.columns["time"]
    rate = np.abs(np.diff(q, axis=0, prepend=q[:1])) / np.diff(time, prepend=-1.0)[:, None]
    wanted = np.stack([looped_lag(time, rate[:, a], 200.0) for a in (0, 1)], axis=1)
    np.testing.assert_allclose(found[:, :2], 1e-2 * wanted, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("body", ["base", "platform"])
def test_heat_of_the_motion_of_all_drives(body: str) -> None:
    """A body warms with the mean of all drives' travel per second: joint centres of it grow."""
    data = campaign()
    found = added(acting(f"motion of the {body}"), data)
    time, q = data.columns["time"], data.q
    rate = np.abs(np.diff(q, axis=0, prepend=q[:1])) / np.diff(time, prepend=-1.0)[:, None]
    warm = looped_lag(time, rate.mean(axis=1), 200.0)
    slots = [v for limb in BENCH.limbs for n, v in limb.slots.values(BENCH.values).items()
             if n.startswith(f"{body}.point")]
    np.testing.assert_allclose(found, 1e-2 * np.outer(warm, slots), rtol=1e-12, atol=1e-18)
    assert np.ptp(found) > 0.0


# --- what is not known --------------------------------------------------------------------------

LACKS = {"play": ORDER, "hysteresis": ORDER, "creep": "time", "leg": "time", "motion": "time",
         "motion of the base": "time"}


@pytest.mark.parametrize("name", LACKS)
def test_rows_in_no_order_are_refused(name: str) -> None:
    data = campaign("unknown", timed=False)
    mechanism = acting(name)
    assert LACKS[name] in missing_columns(mechanism, environment_of(mechanism, data))
    assert np.isnan(added(mechanism, data)).all()


def test_moves_that_the_file_does_not_hold() -> None:
    """Directions that are not those of the order: the joint moved in between, who knows how far."""
    data = campaign("columns")
    turned = {f"dir_{a}": way for a, way in zip(BENCH.actuators, ways(data.q).T, strict=True)}
    play = acting("play")
    straight = replace(data, columns={**data.columns, **turned})
    assert not missing_columns(play, environment_of(play, straight))
    turned["dir_leg2"] = np.random.default_rng(0).choice([-1.0, 1.0], len(data))
    between = replace(data, columns={**data.columns, **turned})
    assert missing_columns(play, environment_of(play, between)) == (ORDER,)
    assert np.isnan(added(play, between)[:, 1]).all()
    # heat asks for no more than the times
    assert not missing_columns(acting("leg"), environment_of(acting("leg"), between))


def test_directions_that_the_order_denies_are_told() -> None:
    """The sidecar says that rows were visited in order; a column says otherwise in row 8."""
    data = campaign()
    turned = {f"dir_{a}": way for a, way in zip(BENCH.actuators, ways(data.q).T, strict=True)}
    good = replace(data, columns={**data.columns, **turned})
    assert not [f for f in unit_findings(BENCH, [good]) if "dir_" in f]
    turned["dir_leg3"] = turned["dir_leg3"].copy()
    turned["dir_leg3"][7] *= -1.0
    told = [f for f in unit_findings(BENCH, [replace(data, columns={**data.columns, **turned})])
            if "dir_" in f]
    assert len(told) == 1
    assert "dir_leg3: row 8" in told[0]


def test_commanded_rows_have_a_path_too() -> None:
    """Joints that follow from commanded poses, rows left out before included."""
    data = campaign(n=12)
    pose = forward(Model(BENCH), data.q).pose
    asked = replace(data, q=np.full_like(data.q, np.nan), commanded=pose_vector(pose))
    keep = np.array([2, 3, 7, 11])
    found = added(acting("play"), with_joints(BENCH, asked.take(keep)))
    np.testing.assert_allclose(found, added(acting("play"), data)[keep], rtol=0.0, atol=1e-12)


def test_targets_in_order_have_a_past() -> None:
    """Commands that make up for play reach the wanted poses; targets in no order are refused."""
    play = with_effects(BENCH, [{"kind": "play", "parameters": {"width": 4e-4}}], SI, "e")
    data = campaign(n=25)
    wanted = pose_vector(forward(Model(BENCH), data.q).pose)
    found = compensate(play, wanted, Registration(), sequence=True)
    assert set(found.status) == {"ok"}
    rows_ = environment({}, play.actuators, play.gravity, found.q, True)
    reached = pose_vector(reached_poses(Model(play), found.q, rows_).pose)
    # where a short move is lost in the play, sending more would be another move
    np.testing.assert_allclose(reached, wanted, rtol=0.0, atol=1e-6)
    assert np.abs(found.q - found.q_nominal).max() > 1.9e-4
    lost = compensate(play, wanted, Registration())
    assert set(lost.status) == {"refused"}


@pytest.mark.parametrize(("entries", "place"), [
    ({"of": ["backlash"]}, "of"), ({}, "of"), ({"of": ["backlash", "humidity"]}, "of[2]"),
    ({"of": ["backlsh", "temperature"]}, "of[1]"), ({"of": ["periodic", "temperature"]}, "of[1]")])
def test_products_that_are_none(entries: dict[str, Any], place: str) -> None:
    with pytest.raises(BadInput) as caught:
        with_effects(BENCH, [{"kind": "product", **entries, "parameters": {"width": 1e-6}}], SI,
                     "m.yaml")
    assert caught.value.where == f"m.yaml: effects[1].{place}"


@pytest.mark.parametrize("kind", ["leg_thermal", "base_thermal", "platform_thermal"])
def test_heat_from_elsewhere_is_refused(kind: str) -> None:
    with pytest.raises(BadInput, match="from 'sunshine'") as caught:
        with_effects(BENCH, [{"kind": kind, "from": "sunshine",
                              "parameters": {"expansion": 1e-6}}], SI, "m.yaml")
    assert caught.value.where == "m.yaml: effects[1].from"


@pytest.mark.parametrize("kind", ["leg_thermal", "base_thermal", "platform_thermal"])
def test_heat_of_motion_is_written_as_it_was_read(kind: str) -> None:
    one = {"kind": kind, "from": "motion", "parameters": {"growth": 2e-6, "tau": 80.0}}
    tree = effects_tree(with_effects(BENCH, [one], SI, "m.yaml"))
    assert {k: tree[0][k] for k in ("kind", "from")} == {"kind": kind, "from": "motion"}
    assert effects_tree(with_effects(BENCH, tree, BENCH.units, "m.yaml")) == tree


@pytest.mark.parametrize("of", [["backlash", "temperature"], ["backlash", "travel"],
                                ["lag", "temperature"], ["gain", "travel"]])
def test_products_are_written_as_they_were_read(of: list[str]) -> None:
    kind = effect_kinds()[of[0]]
    name = kind.parameters(PLANAR)[0].name
    one = {"kind": "product", "of": of, "parameters": {name: 2e-6}}
    tree = effects_tree(with_effects(BENCH, [one], BENCH.units, "m.yaml"))
    assert tree[0]["of"] == of
    assert effects_tree(with_effects(BENCH, tree, BENCH.units, "m.yaml")) == tree


def test_play_of_a_product_with_travel() -> None:
    """A backlash that is w at one end of the stroke, 0 in its middle and -w at the other."""
    data = campaign()
    one = {"kind": "product", "of": ["backlash", "travel"],
           "parameters": {"width": 2e-5, "low": 0.5, "high": 0.7}}
    found = added(with_effects(BENCH, [one], SI, "e"), data)[1:]
    wanted = 1e-5 * ways(data.q)[1:] * (data.q[1:] - 0.6) / 0.1
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-18)


def test_a_product_with_travel_has_the_stroke_of_the_data() -> None:
    """Of a kind whose size is no part of the stroke, too."""
    open_ended = replace(BENCH, limits=np.full((3, 2), np.nan))
    one = {"kind": "product", "of": ["lag", "travel"], "parameters": {"tau": 1e-3}}
    data = campaign()
    known = with_strokes(with_effects(open_ended, [one], SI, "e"), data.q)
    ends = {n.rpartition(".")[2]: v for n, v in zip(known.names, known.values, strict=True)}
    assert (ends["low"], ends["high"]) == (data.q.min(), data.q.max())


# --- commands -----------------------------------------------------------------------------------

def simulated(folder: Path, effects: list[dict[str, Any]], **changes: Any) -> Any:
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 288.675, "rz": 30},
                                     "half_range": {"x": 3, "y": 3, "rz": 0.5}, "count": 60}},
                "effects": effects, "approach": "sequence", "seed": 3,
                "instrument": {"kind": "pose", "sigma": {"position": 1e-9, "rotation": 1e-9}}}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario | changes))
    return lambda expect: ppmcal("simulate", str(CONFIGS / "3-RPR.yaml"), "s.yaml", "--out", "s",
                                 cwd=folder, expect=expect)


@pytest.mark.parametrize("width", [0.5, 3.0])
def test_simulated_play_is_that_of_the_loop(tmp_path: Path, width: float) -> None:
    """The joints that the simulated poses need, less those that were sent, row by row."""
    simulated(tmp_path, [{"kind": "play", "on": ["leg2"], "parameters": {"width": width}}])(0)
    table = rows(tmp_path / "s" / "measurements.csv")
    q = np.array([[float(r[f"q_{a}"]) for a in BENCH.actuators] for r in table]) * 1e-3
    pose = np.zeros((len(q), 6))
    pose[:, :2] = np.array([[float(r[c]) for c in "xy"] for r in table]) * 1e-3
    pose[:, 5] = np.radians([float(r["rz"]) for r in table])
    real = inverse_table(Model(replace(BENCH, limits=np.tile([0.0, 9.0], (3, 1)))), pose).q
    half = 0.5e-3 * width
    wanted = (looped_play(q[:, 1], half, -1.0) + looped_play(q[:, 1], half, 1.0)) / 2.0
    np.testing.assert_allclose((real - q)[:, 1], wanted, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose((real - q)[:, [0, 2]], 0.0, rtol=0.0, atol=1e-10)
    # some moves are too short to cross it
    assert (np.abs(wanted) < 0.99 * half).sum() >= (1 if width < 1.0 else 20)


@pytest.mark.parametrize(("approach", "words"), [("both", "approach: sequence"),
                                                 ("one", "approach: sequence")])
def test_simulated_play_wants_an_order(tmp_path: Path, approach: str, words: str) -> None:
    run = simulated(tmp_path, [{"kind": "play", "parameters": {"width": 0.5}}],
                    approach=approach)(2)
    assert words in run.err


def test_distances_between_two_positions_have_no_order() -> None:
    data = campaign()
    pair = replace(data, to_q=data.q[::-1].copy())
    play = acting("play")
    assert missing_columns(play, environment_of(play, pair)) == (ORDER,)



SLOPES = {**EFFECTS, "friction": {"kind": "friction", "parameters": {
    "static": 3e-5, "dynamic": 1e-5, "speed": 0.02}}, **{
    f"product {c}": {"kind": "product", "of": ["backlash", c], "parameters": {"width": 2e-6}}
    for c in ("temperature", "travel")}}


@pytest.mark.parametrize("name", SLOPES)
def test_derivatives_against_differences(name: str) -> None:
    """By every parameter, of kinds that are made of what a file says too."""
    data = campaign()
    speed = np.random.default_rng(5).uniform(-0.05, 0.05, data.q.shape)
    data = replace(data, columns={**data.columns, **{
        f"vel_{a}": v for a, v in zip(BENCH.actuators, speed.T, strict=True)}})
    mechanism = with_effects(BENCH, [SLOPES[name]], SI, "effects.yaml")
    pose = forward(Model(BENCH), data.q).pose
    at = setting(Model(mechanism), environment_of(mechanism, data), data.q, pose)
    effect = mechanism.effects[0]
    values = {n: mechanism.parameters[p].value for n, p in effect.parameters.items()}
    on = np.ones(3, dtype=bool)

    def slots(shift: Any) -> Array:
        return np.stack([np.broadcast_to(v, (len(data),)) for v in shift.slots.values()])[:, 1:]

    for parameter in SLOPES[name]["parameters"]:
        step = 1e-4 * values[parameter]
        ahead, behind = (slots(effect.kind.evaluate(at, on, values | {
            parameter: values[parameter] + s}).shift) for s in (step, -step))
        found = slots(effect.kind.evaluate(at, on, values).by[parameter])
        scale = np.abs(found).max()
        assert scale > 0.0, parameter
        apart = np.abs((ahead - behind) / (2.0 * step) - found) / scale
        # where a move just crosses the play its slope jumps
        assert np.mean(apart > 1e-6) < (0.02 if "play" in name else 1e-9), parameter


@pytest.mark.slow
def test_an_export_at_rest_says_what_it_leaves_out(tmp_path: Path) -> None:
    """A table of poses has no past: the effects are 0 in it, and told."""
    text = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text(encoding="utf-8"))
    text["effects"] = [{"kind": "play", "parameters": {"width": 0.02}},
                       {"kind": "creep", "parameters": {"give": 1e-5, "tau": 90}},
                       {"kind": "leg_thermal", "parameters": {"expansion": 1e-5, "tau": 200}}]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(text))
    run = ppmcal("export", "grid", "m.yaml", "--out", "e", cwd=tmp_path)
    assert run.code in (0, 1), run.err
    for kind in ("play", "creep", "leg_thermal"):
        assert f"effect {kind}" in " ".join((run.out + run.err).split())
    bare = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text(encoding="utf-8"))
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(bare))
    ppmcal("export", "grid", "bare.yaml", "--out", "b", cwd=tmp_path)
    table, plain = (rows(next((tmp_path / f).glob("*.csv"))) for f in ("e", "b"))
    assert len(table) == len(plain)
    for one, other in zip(table, plain, strict=True):
        assert float(one["q_leg2"]) == pytest.approx(float(other["q_leg2"]), rel=1e-12)
