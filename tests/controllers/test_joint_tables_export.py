"""Tables for single joints: what they hold, how LinuxCNC uses them, what they cannot hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, tree
from helpers.paths import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, fsolve

from ppmcal.controllers.joints.tables import (
    MOST,
    TARGET,
    Triplets,
    correction,
    format_triplets,
    joint_tables,
    knots,
    parse_triplets,
)
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism

CONFIGS = ROOT / "configs"
BASE = np.array([[0.0, 0.0], [1000.0, 0.0], [500.0, 866.025]])
PLATFORM = 250.0 * np.array([[np.cos(np.radians(a)), np.sin(np.radians(a))]
                             for a in (210.0, 330.0, 90.0)])
OFFSETS = (0.42, -0.31, 0.17)
WIDTH = 0.03
PERIODIC = {"cos": 0.012, "sin": -0.02, "period": 60.0}
DRIVES = [{"kind": "backlash", "parameters": {"width": WIDTH}},
          {"kind": "periodic", "parameters": PERIODIC}]


def read_triplets(path: Path) -> Triplets:
    return parse_triplets(path.read_text(), str(path))


def machine(folder: Path, name: str = "3-RPR", effects: list[dict[str, Any]] | None = None,
            change: dict[str, dict[str, Any]] | None = None, **more: Any) -> Path:
    """A shipped machine with effects, changed limbs (name -> key -> entry) and other keys."""
    tree_ = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())
    for limb in tree_["limbs"]:
        limb |= (change or {}).get(limb["name"], {})
    if effects:
        tree_["effects"] = effects
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in {**tree_, **more}.items() if v is not None}))
    return path


def offsets(values: tuple[float, ...] = OFFSETS) -> dict[str, dict[str, Any]]:
    return {f"leg{i + 1}": {"offset": {"value": v, "nominal": 0.0}} for i, v in enumerate(values)}


def lacking(found: dict[str, Any]) -> list[str]:
    return [lack["what"] for lack in found["not_expressed"]]


# ---------------------------------------------------------------- the file

NOMINALS = st.lists(st.floats(-1e4, 1e4).map(lambda v: round(v, 9)), min_size=1, max_size=MOST,
                    unique=True).map(sorted)
AWAY = st.floats(-10.0, 10.0)


@st.composite
def triplets(draw: st.DrawFn) -> Triplets:
    nominal = draw(NOMINALS)
    away = draw(st.lists(st.tuples(AWAY, AWAY), min_size=len(nominal), max_size=len(nominal)))
    return Triplets(tuple(nominal), tuple(n + a for n, (a, _) in zip(nominal, away, strict=True)),
                    tuple(n + b for n, (_, b) in zip(nominal, away, strict=True))).rounded()


@settings(max_examples=60, deadline=None)
@given(triplets())
def test_what_is_written_reads_back_equal(table: Triplets) -> None:
    assert parse_triplets(format_triplets(table), "x.comp") == table


@pytest.mark.parametrize(("text", "words"), [
    ("", ["holds no table"]),
    ("\n\n", ["holds no table"]),
    ("# made by ppmcal\n0 0 0\n", ["line 1", "three numbers", "no comments"]),
    ("0 0 0\n\n1 1 1\n", ["line 2", "empty", "stops reading"]),
    ("0 0 0\n1 1\n", ["line 2", "three numbers"]),
    ("0 0 0\n1 1 1 1\n", ["line 2", "three numbers"]),
    ("0 0 0\n1 1,5 1\n", ["line 2", "'1 1,5 1'"]),
    ("0 0 0\n1 nan 1\n", ["line 2", "three numbers"]),
    ("0 0 0\n1 1e999 1\n", ["line 2", "three numbers"]),
    ("0 0 0\n2 2 2\n2 2 2\n", ["line 3", "not above the one before", "Sort"]),
    ("1 1 1\n0 0 0\n", ["line 2", "the nominal 0"]),
    ("".join(f"{i} {i} {i}\n" for i in range(257)), ["257 lines", "line 257", "256"]),
    ("0 0 " + "0" * 300 + "\n", ["line 1", "characters"]),
])
def test_what_linuxcnc_would_not_take_is_refused(tmp_path: Path, text: str, words: list[str]
                                                 ) -> None:
    path = tmp_path / "leg1.comp"
    path.write_text(text)
    with pytest.raises(BadInput) as refusal:
        read_triplets(path)
    assert "leg1.comp" in str(refusal.value)
    assert all(w in str(refusal.value) for w in words), refusal.value


def test_a_table_that_linuxcnc_would_not_take_is_not_written() -> None:
    with pytest.raises(BadInput, match="not above"):
        format_triplets(Triplets((0.0, 1e-12), (0.0, 0.0), (0.0, 0.0)))


# ---------------------------------------------------------------- LinuxCNC's arithmetic

@settings(max_examples=60, deadline=None)
@given(triplets(), st.lists(st.floats(-2e4, 2e4), min_size=1, max_size=20),
       st.sampled_from([1.0, -1.0]))
def test_the_controller_adds_nominal_less_actual(table: Triplets, at: list[float], way: float
                                                 ) -> None:
    """Linear between the lines, constant beyond, up to single precision."""
    column = table.forward if way > 0 else table.reverse
    trim = np.subtract(table.nominal, column)
    expected = np.interp(at, table.nominal, trim)
    found = correction(table, np.array(at), np.full(len(at), way))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=3e-6)


def test_signs_are_those_of_the_documents_example() -> None:
    """At -1 the joint stands at -1.005 in positive travel: it is told 0.005 more."""
    table = parse_triplets("-1.000 -1.005 -0.995\n0.000 0.002 -0.003\n1.000 1.003 0.998\n", "x")
    at = np.array([-1.0, 0.0, 1.0, 0.5, -3.0, 3.0])
    np.testing.assert_allclose(correction(table, at, np.ones(6)),
                               [0.005, -0.002, -0.003, -0.0025, 0.005, -0.003], atol=1e-9)
    np.testing.assert_allclose(correction(table, at, -np.ones(6)),
                               [-0.005, 0.003, 0.002, 0.0025, -0.005, 0.002], atol=1e-9)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(st.floats(0.5, 12.0), st.floats(-3.0, 3.0), st.floats(1e-6, 1e-2))
def test_points_are_as_few_as_the_error_allows(waves: float, slope: float, target: float) -> None:
    x = np.linspace(0.0, 1.0, 2001)
    y = np.stack([np.sin(2 * np.pi * waves * x) + slope * x, 0.3 * x], axis=-1)
    at = knots(x, y, target, MOST)
    assert at[0] == 0 and at[-1] == 2000 and np.all(np.diff(at) > 0) and len(at) <= MOST
    error = max(np.abs(np.interp(x, x[at], y[at, i]) - y[:, i]).max() for i in range(2))
    even = x[np.linspace(0, 2000, MOST).astype(int)]
    best = np.abs(np.interp(x, even, np.interp(even, x, y[:, 0])) - y[:, 0]).max()
    assert error <= max(target, best) * (1 + 1e-9)
    if error > target:
        assert len(at) > MOST // 2
    straight = knots(x, 5.0 * x[:, None], 1e-12, MOST)
    assert straight.tolist() == [0, 2000]


# ---------------------------------------------------------------- tables of a machine

@pytest.mark.slow
def test_backlash_is_the_difference_of_the_columns(tmp_path: Path) -> None:
    path = machine(tmp_path, effects=DRIVES[:1])
    ppmcal("export", "joints", path, "--out", tmp_path / "o", expect=0)
    for i in (1, 2, 3):
        table = read_triplets(tmp_path / "o" / f"leg{i}.comp")
        assert table.nominal == (200.0, 700.0)
        np.testing.assert_allclose(np.subtract(table.forward, table.reverse), WIDTH, atol=1e-12)
        np.testing.assert_allclose(np.subtract(table.forward, table.nominal), WIDTH / 2,
                                   atol=1e-12)


def told(n: float, offset: float, way: float) -> float:
    """The value at which the joint stands where the drawing means n, mm; by bisection."""
    def off(m: float) -> float:
        w = 2 * np.pi * m / PERIODIC["period"]
        return (m + offset + PERIODIC["cos"] * np.cos(w) + PERIODIC["sin"] * np.sin(w)
                + way * WIDTH / 2 - n)
    return float(brentq(off, n - 2.0, n + 2.0, xtol=1e-13))


@pytest.mark.long
def test_tables_against_bisection_and_interpolation_by_hand(tmp_path: Path) -> None:
    path = machine(tmp_path, effects=DRIVES, change=offsets())
    run = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "o", expect=0)
    rng = np.random.default_rng(3)
    for i, offset in enumerate(OFFSETS):
        table = read_triplets(tmp_path / "o" / f"leg{i + 1}.comp")
        told_of = run.json["tables"][f"leg{i + 1}"]
        assert told_of["points"] == len(table.nominal) <= MOST and told_of["unit"] == "mm"
        assert 1e-6 < told_of["interpolation_error"] < 2e-4
        for way, column in ((1.0, table.forward), (-1.0, table.reverse)):
            trim = np.subtract(table.nominal, column)
            for n in rng.uniform(200.0, 700.0, 60):
                sent = n + np.interp(n, table.nominal, trim)
                assert sent == pytest.approx(told(n, offset, way), abs=1.2 * told_of[
                    "interpolation_error"])
            # at the lines themselves nothing is interpolated
            for n, t in list(zip(table.nominal, trim, strict=True))[::17]:
                assert n + t == pytest.approx(told(n, offset, way), abs=2e-9)


@pytest.mark.slow
def test_joint_errors_of_a_planar_machine_are_corrected(tmp_path: Path) -> None:
    """Driven by hand: strut lengths, interpolation, the joint's own equation, three circles."""
    path = machine(tmp_path, effects=DRIVES, change=offsets())
    run = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "o", expect=0)
    gain = run.json["gain"]
    worst = max(t["interpolation_error"] for t in run.json["tables"].values())
    assert run.json["exact"] and gain["before"]["rms"] > 0.2
    # interpolation errors of the struts reach the platform at most some three times larger
    assert gain["after"]["max"] < 3.0 * worst
    tables = [read_triplets(tmp_path / "o" / f"leg{i}.comp") for i in (1, 2, 3)]
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(40):
        pose = np.array([500.0, 288.675, np.radians(30.0)]) + rng.uniform(-1, 1, 3) * [40, 40, 0.1]
        way = rng.choice([-1.0, 1.0], 3)
        lengths = []
        for i, n in enumerate(strut_lengths(pose)):
            column = tables[i].forward if way[i] > 0 else tables[i].reverse
            m = n + np.interp(n, tables[i].nominal, np.subtract(tables[i].nominal, column))
            w = 2 * np.pi * m / PERIODIC["period"]
            lengths.append(m + OFFSETS[i] + PERIODIC["cos"] * np.cos(w)
                           + PERIODIC["sin"] * np.sin(w) + way[i] * WIDTH / 2)
        real = fsolve(lambda p, u=lengths: strut_lengths(p) - u, pose)
        errors.append(np.linalg.norm(real[:2] - pose[:2]))
    print(f"before {gain['before']['rms']:.4f} mm rms, after {gain['after']['rms']:.2e}, by hand "
          f"{np.sqrt(np.mean(np.square(errors))):.2e}; tables off by {worst:.2e}")
    assert max(errors) < 3.0 * worst
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(gain["after"]["rms"], rel=0.5)


def strut_lengths(pose: np.ndarray) -> np.ndarray:
    """Distances of the joints of the drawn 3-RPR (3,), mm, at x, y, rz."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ends = pose[:2] + PLATFORM @ np.array([[c, s], [-s, c]])
    return np.linalg.norm(ends - BASE, axis=1)


@pytest.mark.slow
def test_a_ratio_is_a_straight_line(tmp_path: Path) -> None:
    path = machine(tmp_path, change={"leg2": {"ratio": {"value": 1.002, "nominal": 1.0,
                                                        "tolerance": 0.01}}})
    run = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "o", expect=0)
    table = read_triplets(tmp_path / "o" / "leg2.comp")
    assert len(table.nominal) == 2 and table.forward == table.reverse
    np.testing.assert_allclose(np.subtract(table.nominal, table.forward),
                               np.array([200.0, 700.0]) * (1 / 1.002 - 1), atol=1e-9)
    assert run.json["gain"]["after"]["max"] < 1e-4 < 0.1 < run.json["gain"]["before"]["max"]
    assert any("bare numbers" in n for n in run.json["notes"])


@pytest.mark.slow
def test_steps_counted_down_have_their_own_direction(tmp_path: Path) -> None:
    """Forward is where the joint value, in steps, grows: the carriage goes down."""
    change = {name: {"ratio": {"value": -0.0125, "fixed": True}, "offset": {
        "value": 520.25, "nominal": 520.0}} for name in "abc"}
    path = machine(tmp_path, "delta-linear", DRIVES[:1], change,
                   limits={name: [0, 32000] for name in "abc"})
    run = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "o", expect=0)
    table = read_triplets(tmp_path / "o" / "b.comp")
    assert table.nominal == (0.0, 32000.0)
    # u = -0.0125 m + 520.25 + way 0.015 is to be -0.0125 n + 520
    np.testing.assert_allclose(np.subtract(table.nominal, table.forward), 0.265 / 0.0125)
    np.testing.assert_allclose(np.subtract(table.nominal, table.reverse), 0.235 / 0.0125)
    assert run.json["gain"]["after"]["max"] < 1e-5 < 0.2 < run.json["gain"]["before"]["max"]


@pytest.mark.slow
def test_turning_joints_are_in_degrees_and_metres_become_mm(tmp_path: Path) -> None:
    effect = [{"kind": "eccentricity", "on": ["a"], "parameters": {"cos": 0.05, "sin2": 0.02}}]
    path = machine(tmp_path, "delta-rotary", effect)
    run = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "o", expect=0)
    table = read_triplets(tmp_path / "o" / "a.comp")
    n = np.array(table.nominal)
    assert n[[0, -1]].tolist() == [-20.0, 95.0] and len(n) > 10
    # first order: what is told lacks the error, which is so small that its slope hardly counts
    error = 0.05 * np.cos(np.radians(n)) + 0.02 * np.sin(2 * np.radians(n))
    np.testing.assert_allclose(np.subtract(table.forward, n), error, atol=2e-4)
    assert run.json["gain"]["after"]["max"] < 1e-3 * run.json["gain"]["before"]["max"]
    path = machine(tmp_path, "linapod", change={"leg1": {"offset": {"value": 0.0003,
                                                                    "nominal": 0.0}}})
    run = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "p", expect=0)
    table = read_triplets(tmp_path / "p" / "leg1.comp")
    assert table.nominal == (700.0, 1700.0) and table.forward == (700.3, 1700.3)
    assert run.json["tables"]["leg1"]["unit"] == "mm"


@pytest.mark.long
def test_short_waves_need_more_points_than_there_are(tmp_path: Path) -> None:
    effect = [{"kind": "periodic", "on": ["leg3"], "parameters": {"sin": 0.02, "period": 3.0}}]
    path = machine(tmp_path, effects=effect)
    found = ppmcal("export", "joints", path, "--json", cwd=tmp_path, expect=1).json
    assert lacking(found) == ["what 256 points cannot follow of leg3"]
    lack = found["not_expressed"][0]["cost"]
    assert lack["rms"] == pytest.approx(found["gain"]["after"]["rms"], rel=1e-6) and lack["rms"] > 0
    assert found["gain"]["after"]["rms"] <= found["gain"]["before"]["rms"]
    one = joint_tables(read_mechanism(path))
    assert [t.coarse for t in one] == [False, False, True]
    assert len(one[0].table.nominal) == 2 and one[0].error < TARGET


# ---------------------------------------------------------------- what tables cannot hold

def moved(by: float) -> dict[str, dict[str, Any]]:
    return {"leg2": {"base": {"point": {"x": {"value": 1000.0 + by, "nominal": 1000.0}, "y": 0}}}}


@pytest.mark.long
def test_geometry_is_listed_with_its_cost(tmp_path: Path) -> None:
    costs = []
    for by in (0.3, 0.6):
        path = machine(tmp_path, effects=DRIVES, change={**moved(by), **{
            k: {**moved(by).get(k, {}), **v} for k, v in offsets().items()}})
        run = ppmcal("export", "joints", path, "--json", cwd=tmp_path, expect=1)
        found = run.json
        assert not found["exact"] and len(found["not_expressed"]) == 1
        lack = found["not_expressed"][0]
        assert "geometry beside the joints, 1 changed" in lack["what"]
        assert lack["parameters"] == ["leg2.base.point.x"]
        # the joints being right, it is what remains
        assert lack["cost"]["rms"] == pytest.approx(found["gain"]["after"]["rms"], rel=0.01)
        assert lack["cost"]["rotation"]["rms"] > 0.0
        costs.append(lack["cost"]["rms"])
    assert costs[1] / costs[0] == pytest.approx(2.0, rel=0.02)
    words = " ".join(ppmcal("export", "joints", path, cwd=tmp_path, expect=1).out.split())
    assert "cannot be expressed: the geometry beside the joints" in words
    assert "COMP_FILE = leg1.comp" in words and "HOME_OFFSET" in words


@pytest.mark.slow
def test_loads_temperature_and_speed_are_listed_without_a_cost(tmp_path: Path) -> None:
    effects = [{"kind": "compliance", "parameters": {"stiffness": 1000}},
               {"kind": "windup", "on": ["leg1"], "parameters": {"width": 1e-4}},
               {"kind": "leg_thermal", "parameters": {"expansion": 1e-5}},
               {"kind": "lag", "on": ["leg2"], "parameters": {"tau": 1e-3}},
               {"kind": "drift", "parameters": {"x": 1e-5}},
               {"kind": "sensor_scale", "parameters": {"scale": 1e-4}}, *DRIVES]
    path = machine(tmp_path, effects=effects)
    found = ppmcal("export", "joints", path, "--json", cwd=tmp_path, expect=1).json
    assert [w.split()[1].rstrip(",") for w in lacking(found)] == [
        "compliance", "windup", "leg_thermal", "lag", "drift"]
    assert all(lack["cost"] is None for lack in found["not_expressed"])
    assert any("sensor_scale belongs to the instrument" in n for n in found["notes"])
    assert found["gain"]["after"]["rms"] < 0.01 * found["gain"]["before"]["rms"]


@pytest.mark.long
def test_rods_of_one_drive_share_its_table(tmp_path: Path) -> None:
    names = [limb["name"] for limb in
             yaml.safe_load((CONFIGS / "delta-linear-6rods.yaml").read_text())["limbs"]]
    both = {n: {"offset": {"value": 0.2, "nominal": 0.0}} for n in names[:2]}
    path = machine(tmp_path, "delta-linear-6rods", change=both)
    found = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "o", expect=0).json
    assert found["gain"]["after"]["max"] < 1e-6
    both[names[1]] = {"offset": {"value": 0.1, "nominal": 0.0}}
    path = machine(tmp_path, "delta-linear-6rods", change=both)
    found = ppmcal("export", "joints", path, "--json", "--out", tmp_path / "o", expect=1).json
    assert "limbs on one drive, a, " in lacking(found)[0]
    table = read_triplets(tmp_path / "o" / "a.comp")
    np.testing.assert_allclose(np.subtract(table.forward, table.nominal), 0.15, atol=1e-9)
    assert 0 < found["gain"]["after"]["rms"] < found["gain"]["before"]["rms"]


# ---------------------------------------------------------------- refusals

def test_options_without_use_are_refused(tmp_path: Path) -> None:
    path = machine(tmp_path)
    for option, word in (("--old", "replace"), ("--poses", "along the joints")):
        run = ppmcal("export", "joints", path, option, path, cwd=tmp_path, expect=2)
        assert option in run.err and word in run.err and "Traceback" not in run.err
    run = ppmcal("export", "joint", path, cwd=tmp_path, expect=2)
    assert "Did you mean 'joints'?" in run.err
    assert sorted(tree(tmp_path)) == ["m.yaml"]


def test_a_machine_without_limits_is_refused(tmp_path: Path) -> None:
    path = machine(tmp_path, limits={"leg1": [200, 700], "leg3": [200, 700]})
    run = ppmcal("export", "joints", path, cwd=tmp_path, expect=2)
    assert "leg2 has no limits" in run.err and "m.yaml: limits" in run.err
    assert "limits: {leg2: [low, high]}" in run.err
    path = machine(tmp_path, limits=None)
    assert "leg1, leg2, leg3 have no" in ppmcal("export", "joints", path, cwd=tmp_path,
                                                expect=2).err


@pytest.mark.slow
def test_an_effect_steeper_than_the_joint_has_no_table(tmp_path: Path) -> None:
    effect = [{"kind": "periodic", "on": ["leg2"], "parameters": {"sin": 5.0, "period": 1.0}}]
    run = ppmcal("export", "joints", machine(tmp_path, effects=effect), cwd=tmp_path, expect=3)
    assert "leg2" in run.err and "steeper" in run.err and not (tmp_path / "exported").exists()


def test_a_broken_model_is_refused(tmp_path: Path) -> None:
    for content in (b"", b"\x00", b"format: x", b"[1, 2"):
        (tmp_path / "m.yaml").write_bytes(content)
        run = ppmcal("export", "joints", "m.yaml", cwd=tmp_path, expect=2)
        assert "m.yaml" in run.err and "fault of ppmcal" not in run.err
