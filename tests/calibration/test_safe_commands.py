"""Commands are safe: no jump, no way through a singularity, none that is worse than none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.paths import ROOT
from numpy.typing import NDArray

import ppmcal
from ppmcal.calibration.compensation.commands import Compensation, compensate
from ppmcal.calibration.compensation.safe_commands import _followed, unsafe_ways, worse_rows
from ppmcal.commands.compensate.run import _refuse_worse
from ppmcal.errors import BadInput, NoResult
from ppmcal.io.effects import with_effects
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.region import largest_box, named, placed
from ppmcal.kinematics.registration import measured_pose
from ppmcal.kinematics.tables import SINGULAR, inverse_table
from ppmcal.kinematics.ways import Ways, between
from ppmcal.model.effects import effect_kinds
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import PLANAR, SPATIAL
from ppmcal.model.registration import Registration
from ppmcal.units import SI

Array = NDArray[np.float64]
CONFIGS = sorted(p.stem for p in (ROOT / "configs").glob("*.yaml"))


@cache
def machine(name: str) -> Mechanism:
    return ppmcal.load(ROOT / "configs" / f"{name}.yaml")


@cache
def box(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return the ends of the box about home inside all limits."""
    return largest_box(mechanism, named(mechanism), 3)


def wide(mechanism: Mechanism, count: int, size: float, seed: int = 0) -> Array:
    """Return wanted poses of a box about home, ``size`` times the one inside all limits."""
    chosen = named(mechanism)
    low, high = box(mechanism)
    middle, half = (low + high) / 2.0, size * (high - low) / 2.0
    rng = np.random.default_rng(seed)
    return placed(mechanism, chosen, rng.uniform(middle - half, middle + half,
                                                 (count, len(chosen))))


def off(mechanism: Mechanism, scale: float = 1.0, seed: int = 3) -> Mechanism:
    """Return the machine as it is made: within its tolerances."""
    rng = np.random.default_rng(seed)
    g = mechanism.values.copy()
    for i in mechanism.free:
        g[i] += scale * (mechanism.parameters[i].tolerance or 0.0) * rng.standard_normal()
    return mechanism.with_values(g)


# --- ways -------------------------------------------------------------------------------------


@pytest.mark.long_cases("3-RPS", "6-RUS", "delta-rotary")
@pytest.mark.parametrize("name", ["3-RPR", "3-RRR-1", "3-RPS", "6-RUS", "6-UPS", "delta-rotary"])
@pytest.mark.slow
def test_ways_that_a_fine_search_finds_unsound_are_found(name: str) -> None:
    """Beyond the box inside limits some ways lead out of limits, or through singularities."""
    mechanism = machine(name)
    table = inverse_table(Model(mechanism), wide(mechanism, 200, 2.5))
    rows = np.flatnonzero([s == "ok" for s in table.status])
    ways = Ways(mechanism, pose_motor(table.pose), table.q)
    before, after = rows[:-1], rows[1:]
    mine = np.zeros(len(before), dtype=bool)
    mine[list(ways.judged(before, after))] = True
    wrong = np.zeros_like(mine)
    low, high = mechanism.limits.T
    for part in np.linspace(0.0, 1.0, 65)[1:-1]:
        pose, q = ways._joints(between(ways.pose[before], ways.pose[after],
                                        np.full(len(before), part)))
        at = ways._places(pose, q)
        wrong |= (~(at.value >= SINGULAR * ways.home_value) | (at.sign != ways.home_sign)
                  | ((q < low) | (q > high)).any(axis=1))
    assert len(before) > 30
    np.testing.assert_array_equal(mine, wrong)


@pytest.mark.slow_cases(
    "6-UPS", "cable-4-planar", "stewart-7", "3-RPS", "3-UPU", "6-PUS", "6-RUS", "cable-4-pulleys",
    "linapod", "maslow", "mixed-spatial", "passive-legs", "tricept", "3-RRR-1", "five-bar",
    "3-PPR-2", "3-PRP-1", "3-PRR-2", "3-RPP-2", "3-RPR-1", "3-RRP-1", "3-RRP-2", "3-RRR-2",
    "delta-rotary")
@pytest.mark.long_cases(
    "cable-8-pulleys", "delta-parallelograms", "delta-rotary-6rods", "delta-linear-6rods",
    "cable-8", "hangprinter")
@pytest.mark.parametrize("name", CONFIGS)
def test_no_way_inside_the_workspace_is_refused(name: str) -> None:
    mechanism = machine(name)
    # poses of surplus limbs take a search each
    wanted = wide(mechanism, 50 if mechanism.surplus else 200, 0.9)
    found = compensate(off(mechanism), wanted, Registration())
    assert set(found.status) == {"ok"}
    assert unsafe_ways(off(mechanism), found) == {}


@pytest.mark.slow
def test_a_way_through_a_singularity_is_refused_and_the_next_row_is_come_to_again() -> None:
    """A 3-RRR has sound poses on both ends of ways that cross where det A changes its sign."""
    mechanism = machine("3-RRR-1")
    table = inverse_table(Model(mechanism), wide(mechanism, 3000, 3.0))
    rows = np.flatnonzero([s == "ok" for s in table.status])
    ways = Ways(mechanism, pose_motor(table.pose), table.q)
    wrong = ways.judged(rows[:-1], rows[1:])
    first = next(n for n, why in wrong.items() if "singularity" in why)
    a, b = rows[first], rows[first + 1]
    path = table.pose[[a, a, b, a, a]]
    found = compensate(mechanism, path, Registration())
    assert found.status == ("ok",) * 5
    refused = unsafe_ways(mechanism, found)
    assert list(refused) == [2]
    assert "from row 2" in refused[2] and "singularity" in refused[2]


def test_rows_are_followed_from_the_last_one_that_is_not_refused() -> None:
    """As one pass row by row does it, whatever is refused."""
    rng = np.random.default_rng(5)
    for part in (0.02, 0.1, 0.3, 0.9) * 5:
        group = (rng.random(300) < part).astype(int) + 2 * (rng.random(300) < 0.1)

        def judge(a: Any, b: Any, group: Any = group) -> dict[int, str]:
            return {int(n): f"{a[n]}" for n in np.flatnonzero(group[a] != group[b])}

        rows = np.flatnonzero(rng.random(300) < 0.8)
        want, last = {}, rows[0]
        for n in rows[1:]:
            if group[n] != group[last]:
                want[int(n)] = f"{last}"
            else:
                last = n
        assert _followed(rows, judge) == want


def test_all_rows_behind_a_wall_are_refused_in_few_rounds() -> None:
    calls = []

    def judge(a: Any, b: Any) -> dict[int, str]:
        calls.append(len(a))
        return {int(n): "wall" for n in np.flatnonzero((a < 10) & (b >= 10))}

    assert list(_followed(np.arange(50_000), judge)) == list(range(10, 50_000))
    assert len(calls) < 40
    assert sum(calls) < 200_000


# --- jumps ------------------------------------------------------------------------------------


def path_of(mechanism: Mechanism, count: int = 60) -> Array:
    """Return a smooth closed path, nan where open."""
    chosen = named(mechanism)
    low, high = largest_box(mechanism, chosen, 3)
    t = np.linspace(0.0, 2.0 * np.pi, count)[:, None] + np.arange(len(chosen))
    return placed(mechanism, chosen, (low + high) / 2.0 + 0.4 * (high - low) * np.sin(t))


@pytest.mark.long_cases("6-RUS", "3-RPS", "6-UPS")
@pytest.mark.parametrize("name", ["3-RPR", "6-UPS", "3-RPS", "delta-rotary", "6-RUS"])
@pytest.mark.slow
def test_a_joint_that_jumps_between_neighbours_is_refused(name: str) -> None:
    """Another root, a turn too many: the targets do not jump, so the commands must not."""
    mechanism = off(machine(name))
    found = compensate(mechanism, path_of(mechanism), Registration())
    assert unsafe_ways(mechanism, found) == {}
    q = found.q.copy()
    own = np.abs(np.diff(found.q_nominal, axis=0)).max()
    q[20:40, 1] += 30.0 * own
    refused = unsafe_ways(mechanism, replace(found, q=q))
    assert set(range(20, 40)) <= set(refused)
    assert set(refused) <= set(range(20, 40)), "rows that are come to again stay"
    assert "leg2" in refused[20] or "b" in refused[20]
    assert "jump" in refused[20]


@pytest.mark.slow
def test_a_jump_is_seen_where_effects_take_the_pose_off_the_geometry() -> None:
    """A 3-RPS that drifts stands beside its own surface, where the geometry alone has no joints."""
    mechanism = off(machine("3-RPS"))
    specs = effect_kinds()["drift"].parameters(SPATIAL)
    mechanism = with_effects(mechanism, [{"kind": "drift", "parameters": {
        s.name: 10.0 * s.size for s in specs}}], SI, "test")
    path = path_of(mechanism, 30)
    path = path.mean(axis=0) + 0.3 * (path - path.mean(axis=0))
    found = compensate(mechanism, path, Registration(), columns={"time": np.full(30, 60.0)})
    assert set(found.status) == {"ok"}
    assert unsafe_ways(mechanism, found) == {}
    pose = found.pose.copy()
    pose[10:20, 2] += np.ptp(pose[:, 2])
    refused = unsafe_ways(mechanism, replace(found, pose=pose))
    assert set(refused) == set(range(10, 20))
    assert "jump" in refused[10]


@pytest.mark.slow
def test_a_turn_the_long_way_round_is_refused() -> None:
    mechanism = off(machine("delta-rotary"))
    free = replace(mechanism, limits=np.tile([-np.inf, np.inf], (3, 1)))
    found = compensate(free, path_of(mechanism), Registration())
    turned = {"q": found.q.copy(), "q_nominal": found.q_nominal.copy()}
    for q in turned.values():
        q[30:, 0] += 2.0 * np.pi
    refused = unsafe_ways(free, replace(found, **turned))
    assert set(refused) == set(range(30, 60))
    assert "long way round" in refused[30]


# --- worse than none --------------------------------------------------------------------------


def commands(mechanism: Mechanism, count: int = 8) -> Compensation:
    found = compensate(off(mechanism), wide(mechanism, count, 0.5), Registration())
    assert set(found.status) == {"ok"}
    return found


@pytest.mark.slow
def test_rows_that_are_better_left_alone_are_refused() -> None:
    mechanism = machine("6-UPS")
    found = commands(mechanism)
    small = found.position_before / 10.0
    assert worse_rows(mechanism, replace(found, sigma_position=small)) == {}
    sigma = np.where(np.arange(8) == 3, 1.1 * found.position_before, small)
    refused = worse_rows(mechanism, replace(found, sigma_position=sigma))
    assert list(refused) == [3]
    assert "worse than none" in refused[3] and "mm without" in refused[3]
    # what is left counts as well as what is not known
    after = np.where(np.arange(8) == 5, 0.9 * found.position_before, 0.0)
    sigma = 0.5 * found.position_before
    assert list(worse_rows(mechanism, replace(
        found, position_after=after, sigma_position=sigma))) == [5]


@pytest.mark.slow
def test_a_row_of_which_nobody_knows_what_is_left_is_refused() -> None:
    mechanism = machine("3-RPR")
    found = compensate(off(mechanism), wide(mechanism, 300, 2.5), Registration(), None)
    unknown = np.isnan(found.position_after) & [s == "ok" for s in found.status]
    assert unknown.any()
    refused = worse_rows(mechanism, found)
    assert {n for n, why in refused.items() if "cannot be predicted" in why} == set(
        np.flatnonzero(unknown).tolist())


@pytest.mark.slow
def test_a_few_rows_that_are_worse_do_not_refuse_the_others() -> None:
    """One row far beyond what the model knows has the rms of all of them for itself."""
    mechanism = machine("6-UPS")
    poses = wide(mechanism, 8, 0.5) / [*[1e-3] * 3, *[np.radians(1.0)] * 3]
    result = ppmcal.compensate(off(mechanism), poses, frame="base")
    before = result.compensation.position_before

    def judged(*rows: int) -> None:
        sigma = np.where(np.isin(np.arange(8), rows), 10.0, 0.1) * before
        worse = replace(result.compensation, sigma_position=sigma)
        _refuse_worse(replace(result, compensation=worse), worse_rows(result.mechanism, worse),
                      "model")

    judged(3)
    with pytest.raises(NoResult, match="worse than none"):
        judged(0, 1, 2, 3, 4)


@pytest.mark.slow
def test_rotation_counts_by_itself() -> None:
    mechanism = machine("6-UPS")
    found = commands(mechanism)
    sigma = 1.1 * found.rotation_before
    refused = worse_rows(mechanism, replace(found, sigma_rotation=np.where(
        np.arange(8) == 2, sigma, 0.0)))
    assert list(refused) == [2]
    assert "of rotation with it" in refused[2]


def test_a_machine_that_is_as_drawn_is_commanded_as_ever() -> None:
    """Nothing to correct: what is left is arithmetic, and no worse than none."""
    mechanism = machine("3-RPR")
    found = compensate(mechanism, wide(mechanism, 20, 0.8), Registration())
    assert worse_rows(mechanism, found) == {}


# --- beyond what was measured -----------------------------------------------------------------


def measured(mechanism: Mechanism, size: float, **more: Any) -> Mechanism:
    """Return the machine as if measured in a box of this size."""
    chosen = named(mechanism)
    low, high = largest_box(mechanism, chosen, 3)
    middle, half = (low + high) / 2.0, size * (high - low) / 2.0
    ranges = {"xyz"[c] if c < 3 else f"r{'xyz'[c - 3]}": (float(m - h), float(m + h))
              for c, m, h in zip(chosen, middle, half, strict=True)}
    return replace(off(mechanism), measured=MeasurementBasis(1.0, 0.5, ranges | more))


@pytest.mark.slow
def test_what_was_measured_is_known_without_the_file_beside() -> None:
    """The ranges are in the machine's own file: far outside is refused, a little outside said."""
    mechanism = machine("3-RPR")
    known = measured(mechanism, 0.3)
    poses = wide(mechanism, 60, 1.0)[:, [0, 1, 5]] / [1e-3, 1e-3, np.radians(1.0)]
    found = ppmcal.compensate(known, poses, frame="base", path=False)
    why = [r for _, r in found.refused]
    assert any("far outside the measured volume" in r for r in why)
    assert any("outside the measured range: x" in n for n in found.notes)
    inside = ppmcal.compensate(measured(mechanism, 1.1), poses, frame="base", path=False)
    assert inside.refused == []
    assert not any("outside" in n for n in inside.notes)


# --- conditions -------------------------------------------------------------------------------


CONDITIONS = {"temperature": (24.0, 31.0), "payload": (10.0, 25.0), "time": (60.0, 400.0)}
SPECIAL: dict[str, dict[str, Any]] = {
    "periodic": {"parameters": {"cos": 2e-5, "period": 0.3}},
    "compliance": {"parameters": {"stiffness": 1e6}},
    "friction": {"parameters": {"static": 2e-5, "dynamic": 1e-5, "speed": 0.04}},
    "creep": {"parameters": {"give": 1e-7, "tau": 90.0}},
    "plate_compliance": {"parameters": {"base": 1e-7, "platform": 1e-7, "reach": 0.5}}}
KINDS = [k for k, kind in effect_kinds().items()
         if kind.exists_in(PLANAR) and kind.joints != "turning"
         and not kind.instrument and not kind.onset and k not in ("product", "learned")]
QUICK = {"drift"}
"""What every test run can bear."""


def bare(kind: str) -> Mechanism:
    """Return the machine of :func:`acting` without its effect."""
    return machine("cable-4-planar" if effect_kinds()[kind].joints == "ropes" else "3-RPR")


def acting(kind: str) -> Mechanism:
    """Return a planar machine with an effect of one kind: of ropes where only these have it."""
    found = effect_kinds()[kind]
    mechanism = bare(kind)
    special = SPECIAL.get(kind)
    if special is None:
        specs = found.parameters(PLANAR)
        special = {"parameters": {s.name: 10.0 * s.size for s in specs
                                  if not s.constant and not s.needs}}
    if found.carried is not None:
        mechanism = with_effects(mechanism, [{"kind": "compliance", **SPECIAL["compliance"]}], SI,
                                 "test")
    if found.opposed:
        special["on"] = list(mechanism.actuators[:mechanism.surplus])
    return with_effects(mechanism, [{"kind": kind, **special}], SI, "test")


def conditions(mechanism: Mechanism, count: int) -> dict[str, Array]:
    rng = np.random.default_rng(2)
    out = {name: np.sort(rng.uniform(*ends, count)) for name, ends in CONDITIONS.items()}
    kinds = [e.kind for e in mechanism.effects]
    if any("tension" in k.needs for k in kinds):
        out |= {f"tension_{a}": rng.uniform(20.0, 90.0, count) for a in mechanism.actuators}
    if any({"order", "past"} & set(k.needs) for k in kinds):
        return out     # directions follow from the times then
    for a in mechanism.actuators:
        out[f"dir_{a}"] = rng.choice([-1.0, 1.0], count)
        out[f"vel_{a}"] = 30.0 * out[f"dir_{a}"]
    return out


@pytest.mark.long_cases(
    "anchor_give", "compliance", "friction", "gravity_tilt", "lag", "missing_length",
    "payload_offset", "rope_elasticity", "rope_height", "rope_stretch", "windup", "backlash",
    "base_thermal", "platform_thermal")
@pytest.mark.parametrize("kind", [
    k if k in QUICK else pytest.param(k, marks=pytest.mark.slow) for k in KINDS])
@pytest.mark.slow
def test_a_condition_that_changes_commands_is_never_taken_as_zero(kind: str) -> None:
    """Whatever column moves a command: without it the targets are refused, or the row is."""
    mechanism = acting(kind)
    poses = wide(bare(kind), 6, 0.6)
    table: dict[str, Any] = {"x": poses[:, 0] * 1e3, "y": poses[:, 1] * 1e3,
                             "rz": np.degrees(poses[:, 5]), **conditions(mechanism, 6)}

    def sent(columns: dict[str, Any]) -> Array:
        return ppmcal.compensate(mechanism, columns, frame="base", path=False).compensation.q

    whole = sent(table)
    assert np.isfinite(whole).all()
    for name in [n for n in table if n not in ("x", "y", "rz")]:
        other = {**table, name: -table[name] if name[:3] in ("dir", "vel") else
                 table[name] + 5.0 * np.arange(6.0)}
        if np.abs(sent(other) - whole).max() < 1e-12:
            continue
        lacking = {n: v for n, v in table.items() if n != name}
        with pytest.raises(BadInput, match=name.partition("_")[0]):
            sent(lacking)
        if name in ("temperature", "payload") or name.startswith(("dir", "vel")):
            # one value for all is said, not guessed
            value = float(table[name][0])
            told = ppmcal.compensate(mechanism, lacking, frame="base", path=False,
                                     assume={name: value})
            np.testing.assert_allclose(told.compensation.q, sent(
                {**table, name: np.full(6, value)}), rtol=0.0, atol=1e-15)
        one = table[name].copy()
        one[4] = np.nan
        gap = ppmcal.compensate(mechanism, {**table, name: one}, frame="base", path=False)
        if not np.isnan(gap.compensation.q[4]).all():
            # effects with memory may do without a row of the past, but must not count it as 0
            zero = table[name].copy()
            zero[4] = 0.0
            assert np.abs(gap.compensation.q - sent({**table, name: zero})).max() > 0.0


def test_a_load_that_the_measurements_had_is_not_taken_as_zero() -> None:
    mechanism = replace(acting("compliance"), measured=MeasurementBasis(1.0, 0.5, {
        "payload": (0.0, 20.0), "fx": (-5.0, 5.0)}))
    poses = {"x": [500.0], "y": [290.0], "rz": [30.0], "fx": [3.0]}
    with pytest.raises(BadInput, match="payload"):
        ppmcal.compensate(mechanism, poses, frame="base")
    found = ppmcal.compensate(mechanism, poses, frame="base", assume={"payload": 5.0})
    assert found.refused == []


@pytest.mark.slow
def test_open_coordinates_stay_open_in_the_frame_of_an_instrument() -> None:
    """A 3-RPS names three of six; where an effect moves its surface, in whatever frame it is."""
    mechanism = off(machine("3-RPS"))
    specs = effect_kinds()["drift"].parameters(SPATIAL)
    mechanism = with_effects(mechanism, [{"kind": "drift", "parameters": {
        s.name: 10.0 * s.size for s in specs}}], SI, "test")
    path, given = path_of(mechanism, 5), {"time": np.full(5, 60.0)}
    base = compensate(mechanism, path, Registration(), columns=given)
    stands = Registration(pose_motor(np.array([[0.3, 0.2, 0.1, 0.02, -0.03, 1.0]]))[0],
                          np.array([0.01, 0.02, 0.03]), np.array([0.01, 0.0, 0.02]))
    wanted = np.where(np.isnan(path), np.nan, measured_pose(stands, pose_motor(base.pose)))
    found = compensate(mechanism, wanted, stands, columns=given)
    assert found.status == base.status == ("ok",) * 5
    np.testing.assert_allclose(found.q, base.q, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(found.pose, base.pose, rtol=0.0, atol=1e-13)
    assert found.position_after.max() < 1e-13


def test_what_is_assumed_must_be_a_condition_that_is_not_there() -> None:
    mechanism = acting("leg_thermal")
    poses = {"x": [500.0], "y": [290.0], "rz": [30.0], "temperature": [22.0]}
    with pytest.raises(BadInput, match="there already"):
        ppmcal.compensate(mechanism, poses, frame="base", assume={"temperature": 20.0})
    with pytest.raises(BadInput, match="temperature"):
        ppmcal.compensate(mechanism, poses, frame="base", assume={"temprature": 20.0})


# --- models that miss their own data ----------------------------------------------------------


@pytest.mark.slow_cases("8.0-0.0-True", "5.1-1e-30-True")
@pytest.mark.parametrize(("ratio", "p", "bad"), [
    (1.0, 0.4, False), (4.9, 1e-30, False), (5.1, 1e-30, True), (50.0, 0.2, False),
    (float("nan"), float("nan"), False), (8.0, 0.0, True)])
def test_a_model_that_misses_its_own_data_is_refused_as_a_whole(ratio: float, p: float, bad: bool
                                                                ) -> None:
    mechanism = replace(off(machine("3-RPR")), measured=MeasurementBasis(ratio, p))
    poses = {"x": [500.0], "y": [290.0], "rz": [30.0]}
    if not bad:
        assert ppmcal.compensate(mechanism, poses, frame="base").refused == []
        return
    for run in (lambda **more: ppmcal.compensate(mechanism, poses, frame="base", **more),
                lambda **more: ppmcal.export("grid", mechanism, **more)):
        with pytest.raises(NoResult, match=r"does not fit its own calibration data.*--regardless"):
            run()
        forced = run(regardless=True)
        assert any("--regardless" in n for n in forced.findings) and forced.has_findings
