"""``ppmcal diagnose`` on campaigns as people bring them: in order, incomplete, in wrong units."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import number, ppmcal, rows, write_csv
from helpers.diagnoses import (
    BACKLASH,
    CONFIGS,
    DATA,
    diagnose,
    drop,
    effect,
    found_in,
    named,
    simulate,
    value,
)
from scipy.stats import binom

from ppmcal.calibration.fit.fit_result import OUTLIER, Fit
from ppmcal.calibration.fit.fit_result import FitOptions as FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis import diagnose as diagnosing
from ppmcal.diagnosis.refit import of_rows
from ppmcal.inference.priors import SURE
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.model.dataset import Dataset
from ppmcal.notes import NOTE, Note

SIDECAR = "s/measurements.yaml"
LOADED: dict[str, Any] = {"payload": [0, 15], "temperature": {"mean": 24, "swing": 6}}
SINGLE: dict[str, Any] = {"approach": "one", "conditions": {"temperature": {"mean": 24,
                                                                            "swing": 6}}}


def edit(folder: Path, **changes: Any) -> None:
    """Change the sidecar as its owner would."""
    file = folder / SIDECAR
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | changes))


def not_used(folder: Path, out: str = "d") -> dict[int, str]:
    """Return row number -> reason of the rows that were not used."""
    return {int(r["row"]): r["reason"] for r in rows(folder / out / "residuals.csv")
            if r["reason"]}


def data_of(folder: Path) -> Dataset:
    (data,) = read_campaign([folder / DATA], read_mechanism(folder / "m.yaml"))
    return data


def problem_of(folder: Path) -> Problem:
    data = data_of(folder)
    mechanism = read_mechanism(folder / "m.yaml")
    return Problem(mechanism, (data,), mechanism.free)


# --- rows visited in order ------------------------------------------------------------------------


def in_sequence(folder: Path, effects: list[dict[str, Any]], **changes: Any) -> Path:
    """Simulate rows visited in order, whose file has no dir_ columns, only that it is so."""
    simulate(folder, "6-UPS", effects, **({"count": 30, "approach": "sequence",
                                           "conditions": LOADED} | changes))
    drop(folder, "dir_")
    edit(folder, approach="sequence")
    return folder


@pytest.mark.long
@pytest.mark.parametrize("seed", [4])
def test_backlash_in_a_sequence_is_named(tmp_path: Path, seed: int) -> None:
    """The direction of approach follows from the order, also where rows are held out.

    Of moves longer than it, play is the same, with the other sign.
    """
    _, found = diagnose(in_sequence(tmp_path, [BACKLASH], seed=seed))
    (only,) = found["effects"]
    assert only["on"] == ["leg3"]
    assert "backlash on leg3" in {f"{only['kind']} on leg3", *only["alternatives_on"]}
    width = only["parameters"]["width"]
    assert abs(abs(width["value"]) - 0.03) < 4.0 * width["sigma"] < 0.015
    # nobody knows from where the first rows were approached: two loads at the first pose
    assert not_used(tmp_path) == {1: "dir_leg1 is not known here", 2: "dir_leg1 is not known here"}


@pytest.mark.long
@pytest.mark.parametrize("seed", [5])
def test_no_backlash_in_a_sequence_without(tmp_path: Path, seed: int) -> None:
    _, found = diagnose(in_sequence(tmp_path, [], seed=seed))
    assert "backlash" not in named(found)
    assert found["verdict"] in ("none", "weak")


def test_the_same_with_the_directions_written_down(tmp_path: Path) -> None:
    """What the order tells is what the simulator had written into the columns."""
    simulate(tmp_path, "6-UPS", [BACKLASH], count=20, approach="sequence", conditions=LOADED)
    written = data_of(tmp_path).columns
    drop(tmp_path, "dir_")
    edit(tmp_path, approach="sequence")
    data = data_of(tmp_path)
    told = data.directions()
    assert told is not None
    known = np.isfinite(told)
    assert not known[:2].any() and known[2:].all()
    np.testing.assert_array_equal(told[2:], np.stack(
        [written[f"dir_leg{i}"] for i in range(1, 7)], axis=1)[2:])


@pytest.mark.parametrize("seed", range(5))
def test_rows_keep_their_direction_in_any_subset(tmp_path_factory: pytest.TempPathFactory,
                                                 seed: int) -> None:
    folder = in_sequence(tmp_path_factory.mktemp("s"), [], count=12)
    data, rng = data_of(folder), np.random.default_rng(seed)
    whole = data.directions()
    assert whole is not None
    mask = rng.random(len(data)) < 0.4
    np.testing.assert_array_equal(data.take(mask).directions(), whole[mask])
    order = rng.permutation(len(data))[:9]
    again = data.take(order).take(np.arange(3, 7))
    np.testing.assert_array_equal(again.directions(), whole[order[3:7]])


def test_a_joint_that_rests_for_long_at_the_start(tmp_path: Path) -> None:
    """Leg 2 stands still for 4 of 40 rows: these are not known, and nothing else goes."""
    in_sequence(tmp_path, [], count=40, approach="sequence",
                conditions={"temperature": {"mean": 24, "swing": 6}})
    data = data_of(tmp_path)
    q = data.q.copy()
    q[:4, 1] = q[0, 1]
    way = replace(data, q=q).directions()
    assert way is not None
    assert np.isnan(way[:4, 1]).all() and np.isfinite(way[4:, 1]).all()


# --- columns recorded in part ---------------------------------------------------------------------


def emptied(folder: Path, column: str, where: range) -> None:
    table = rows(folder / DATA)
    for n in where:
        table[n][column] = ""
    write_csv(folder / DATA, table)


@pytest.mark.long
def test_a_temperature_that_few_rows_lack(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=120, **SINGLE)
    emptied(tmp_path, "temperature", range(50, 53))
    run, found = diagnose(tmp_path)
    out = {n: r for n, r in not_used(tmp_path).items() if "temperature" in r}
    assert out == dict.fromkeys((51, 52, 53), "temperature is not known here")
    assert run.code == 1 and found["verdict"] in ("none", "weak")
    assert any("rows left out" in f for f in found["findings"])
    assert "leg_thermal" not in {e["kind"] for e in found["not_testable"]}


@pytest.mark.long
def test_a_temperature_that_most_rows_lack(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=120, **SINGLE)
    emptied(tmp_path, "temperature", range(20, 110))
    run, found = diagnose(tmp_path)
    assert not any("temperature" in r for r in not_used(tmp_path).values())
    assert run.code == 1
    assert any("temperature is known in only 30 of 120 rows: not used" in f
               for f in found["findings"])
    assert "leg_thermal" in {e["kind"] for e in found["not_testable"]}
    assert not found["effects"]
    assert len(not_used(tmp_path)) <= 3



# --- rows left out --------------------------------------------------------------------------------


def repeated(folder: Path, seed: int, **changes: Any) -> list[int]:
    """Simulate 60 poses measured twice each; return the places of the first rows at their pose."""
    simulate(folder, "3-RPR", [], **({"count": 60, "repeats": 2, "seed": seed} | SINGLE | changes))
    poses = [r["pose"] for r in rows(folder / DATA)]
    return [n for n in range(len(poses)) if n == 0 or poses[n] != poses[n - 1]]


@pytest.mark.long
@pytest.mark.parametrize("how", ["by some sigma", "by a part of the move"])
def test_first_rows_that_fall_short_have_a_pattern(tmp_path: Path, how: str) -> None:
    rng = np.random.default_rng(6)
    picked = rng.permutation(repeated(tmp_path, 6)[1:])[:11]
    table = rows(tmp_path / DATA)
    for n in picked:
        for c in "xy":
            move = number(table[n], c) - number(table[n - 1], c)
            short = 0.02 * move if "part" in how else 0.005 * rng.uniform(15.0, 30.0)
            table[n][c] = str(number(table[n], c) - short)
    write_csv(tmp_path / DATA, table)
    run, found = diagnose(tmp_path)
    assert set(picked + 1) <= set(not_used(tmp_path))
    assert run.code == 1 and not found["effects"]
    assert any("left out as outliers" in f and "are the first row at their pose" in f
               for f in found["findings"])


@pytest.mark.long
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_gross_errors_have_no_pattern(tmp_path: Path, seed: int) -> None:
    repeated(tmp_path, seed, noise={"outliers": 0.1})
    _, found = diagnose(tmp_path)
    assert len(not_used(tmp_path)) >= 6
    assert found["verdict"] == "none" and found["remainder"]["follows"] is None
    assert not any("pattern" in f for f in found["findings"])


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    """A fit of 120 rows, two at each pose, with directions, temperature and loads."""
    folder = tmp_path_factory.mktemp("plain")
    repeated(folder, 3, approach="both", repeats=1, conditions=LOADED, count=30)
    return identify(problem_of(folder))


def without(fit: Fit, gone: np.ndarray) -> Fit:
    """Return the fit as if the rows ``gone`` had been left out as outliers."""
    return replace(fit, keep=(~gone,), reasons=({
        int(n): Note(f"{OUTLIER}: test", NOTE, OUTLIER) for n in np.flatnonzero(gone)},))


@pytest.mark.long
@pytest.mark.parametrize("count", [4, 12, 30])
def test_chance_has_a_pattern_as_rarely_as_its_prior_says(plain: Fit, count: int) -> None:
    module = pytest.importorskip("ppmcal.calibration.validation.left_out_rows")
    rng, rows_ = np.random.default_rng(count), len(plain.keep[0])
    found = 0
    for _ in range(300):
        gone = np.zeros(rows_, dtype=bool)
        gone[rng.permutation(rows_)[:count]] = True
        out = module.left_out(without(plain, gone))
        assert out.count == count and out.rows == rows_
        found += bool(out.follows)
    # as the odds that a pattern has against rows hit anywhere are 1 : 1, and 95 % are asked for
    assert found <= binom.ppf(0.999, 300, 1.0 - SURE.value)


@pytest.mark.parametrize("what", ["first", "leg2 moving +", "last third", "highest part by load"])
def test_a_pattern_is_told_as_what_it_is(plain: Fit, what: str) -> None:
    """Fifteen rows that have one thing in common, picked at random among those that have it."""
    module = pytest.importorskip("ppmcal.calibration.validation.left_out_rows")
    data, n = plain.problem.datasets[0], len(plain.keep[0])
    has = {"first": np.r_[True, np.diff(data.groups) != 0],
           "leg2 moving +": data.columns["dir_leg2"] == 1.0,
           "last third": np.arange(n) >= 2 * n // 3,
           "highest part by load": data.columns["payload"] > 0.0}[what]
    gone = np.zeros(n, dtype=bool)
    gone[np.random.default_rng(1).permutation(np.flatnonzero(has))[:15]] = True
    out = module.left_out(without(plain, gone))
    assert out.follows and out.share == 1.0 and out.probability > SURE.value
    assert what in out.follows
    assert out.sentence.startswith(f"15 rows of {n} left out")


@pytest.mark.parametrize("where", ["corner", "side", "joint"])
def test_a_place_is_told_as_what_it_is(plain: Fit, where: str) -> None:
    """Every row in one corner of the workspace: a reflection, an edge of the instrument's view."""
    module = pytest.importorskip("ppmcal.calibration.validation.left_out_rows")
    (data,), pose = plain.problem.datasets, pose_vector(plain.state.poses[0])
    x, y = pose.T[:2]
    has = {"corner": (x > np.median(x)) & (y <= np.median(y)), "side": y > np.quantile(y, 2 / 3),
           "joint": data.q[:, 1] <= np.quantile(data.q[:, 1], 1 / 3)}[where]
    each = replace(plain, problem=replace(plain.problem, datasets=(
        replace(data, groups=np.arange(len(data))),)))
    out = module.left_out(without(each, has))
    assert out.follows and out.share == 1.0 and out.probability > SURE.value
    words = {"corner": ("x above", "y up to"), "side": ("highest third by y",),
             "joint": ("lowest third by leg2",)}[where]
    assert all(w in out.follows for w in words)
    # a third of a joint's travel is a stretch of it
    assert (out.stretch is not None) == (where == "joint")


def reflected(folder: Path) -> set[int]:
    """Write 108 poses without effects, 13 at one corner moved by a reflection: which."""
    simulate(folder, "3-RPR", [], count=108, **SINGLE)
    table = rows(folder / DATA)
    x, y = (np.array([float(r[c]) for r in table]) for c in "xy")
    deep = np.minimum((x - np.median(x)) / np.ptp(x), (np.median(y) - y) / np.ptp(y))
    moved = np.argsort(deep)[-13:]
    for n in moved.tolist():
        table[n] |= {"x": str(x[n] + 0.5), "y": str(y[n] + 0.3)}
    write_csv(folder / DATA, table)
    return {n + 1 for n in moved.tolist()}


CORNER = r"100% of them have x above [\d.]+ mm and y up to [\d.]+ mm"


@pytest.mark.slow
def test_identify_tells_the_corner_where_rows_are_wrong(tmp_path: Path) -> None:
    """Those rows and no other."""
    moved = reflected(tmp_path)
    run = ppmcal("identify", "m.yaml", DATA, "--seed", "1", "--out", "i", cwd=tmp_path, expect=1)
    assert moved == {n for n, why in not_used(tmp_path, "i").items() if why.startswith(OUTLIER)}
    assert re.search(CORNER, " ".join(run.out.split()))


@pytest.mark.long
def test_diagnose_tells_the_corner_where_rows_are_wrong(tmp_path: Path) -> None:
    """What hits rows at one place has no name, and is something all the same."""
    moved = reflected(tmp_path)
    run, found = diagnose(tmp_path, DATA, "--seed", "1")
    assert found["verdict"] == "unnamed" and not found["effects"]
    assert moved == {n for n, why in not_used(tmp_path).items() if "weight" not in why}
    said = " ".join(run.out.split())
    assert re.search(CORNER, said) and "gross errors have no such pattern" in said
    assert "no missing effect is detectable" not in said.lower()


@pytest.mark.parametrize("count", [2, 4])
def test_a_stretch_of_travel_is_of_several_poses(plain: Fit, count: int) -> None:
    """Two poses typed wrong, of several rows each, are near in a joint's travel by chance."""
    module = pytest.importorskip("ppmcal.calibration.validation.left_out_rows")
    data = plain.problem.datasets[0]
    labels = list(dict.fromkeys(data.groups[np.argsort(data.q[:, 1], kind="stable")].tolist()))
    out = module.left_out(without(plain, np.isin(data.groups, labels[:count])))
    assert out.count >= 4 * count
    assert bool(out.follows) == (out.stretch is not None) == (count == 4)


def test_rows_of_one_pose_are_one_at_a_place(plain: Fit) -> None:
    """A pose typed wrong takes all its rows with it: two such poses are near by chance."""
    module = pytest.importorskip("ppmcal.calibration.validation.left_out_rows")
    data, pose = plain.problem.datasets[0], pose_vector(plain.state.poses[0])
    labels = data.groups[np.argsort(pose[:, 0], kind="stable")]
    out = module.left_out(without(plain, np.isin(data.groups, list(dict.fromkeys(labels))[-3:])))
    assert out.count == 12
    assert "x" not in out.follows.split()


def test_more_rows_than_gross_errors_explain(plain: Fit) -> None:
    module = pytest.importorskip("ppmcal.calibration.validation.left_out_rows")
    n = len(plain.keep[0])
    gone = np.zeros(n, dtype=bool)
    gone[np.random.default_rng(2).permutation(n)[:n // 4]] = True
    out = module.left_out(without(plain, gone))
    assert out.too_many and "more than gross errors explain" in out.sentence
    nobody = module.left_out(without(plain, np.zeros(n, dtype=bool)))
    assert not nobody.too_many and not nobody.follows and nobody.sentence == ""


# --- the gap on stretches of time and conditions --------------------------------------------------


@pytest.mark.long
def test_a_block_is_predicted_as_by_a_fit_without_it(tmp_path: Path) -> None:
    """By the formula and by honest refits: to 1 % of the noise, without and with the effect."""
    gap = pytest.importorskip("ppmcal.diagnosis.held_out_gap")
    schemes = pytest.importorskip("ppmcal.diagnosis.left_out_schemes").schemes
    simulate(tmp_path, "3-RPR", [effect("leg_thermal", ["leg2"], expansion=15e-6)], count=60,
             conditions={"temperature": {"mean": 24, "swing": 6}})
    told = diagnosing.diagnose(problem_of(tmp_path), diagnosing.DiagnosisOptions())
    assert [e.kind for e in told.effects] == ["leg_thermal"]
    assert {b.by for b in told.predictive} == {"pose", "time", "temperature"}
    keep = [a & b for a, b in zip(told.before.keep, told.identification.fit.keep, strict=True)]
    plain_fit = FitOptions(robust=False)
    for by, folds in schemes(told.before.problem):
        (own,) = (b for b in told.predictive if b.by == by)
        for fit, rms in ((told.before, own.geometry.error),
                         (told.identification.fit, own.averaged.error)):
            square = count = 0.0
            for fold in folds:
                rest = of_rows(fit, [k & ~f for k, f in zip(keep, fold, strict=True)], plain_fit)
                errors = gap._errors(rest, *gap._predictor(rest, [d.take(k & f) for d, k, f in zip(
                    fit.problem.datasets, keep, fold, strict=True)]))
                square, count = square + errors.square.sum(), count + errors.count.sum()
            assert abs(rms - (square / count) ** 0.5) < 0.01, (by, rms)


@pytest.mark.long
@pytest.mark.parametrize("hidden", [effect("backlash", ["leg3"], width=0.1),
                                    effect("leg_thermal", ["leg2"], expansion=25e-6)])
def test_what_is_there_predicts_every_stretch(tmp_path: Path, hidden: dict[str, Any]) -> None:
    simulate(tmp_path, "6-UPS", [hidden], count=60,
             conditions={"temperature": {"mean": 24, "swing": 6}})
    _, found = diagnose(tmp_path)
    assert found["verdict"] == "named"
    assert named(found) == {hidden["kind"]: set(hidden["on"])}
    assert {b["by"] for b in found["predictive"]} == {"pose", "time", "temperature"}
    for block in found["predictive"]:
        assert block["gain"] > 2.0 * block["gain_sigma"]
        assert block["averaged"]["error"] < 1.2 < block["geometry"]["error"]


def with_jump(folder: Path, shift: float, seed: int, at: float = 0.5) -> Path:
    """Simulate a leg whose zero jumps by ``shift`` mm while the temperature rises with time."""
    more: dict[str, Any] = {"count": 60, "seed": seed,
                            "conditions": {"temperature": {"mean": 24, "swing": 6}}}
    simulate(folder, "6-UPS", [], out="later", errors={"leg2.offset": shift}, **more)
    simulate(folder, "6-UPS", [], errors={"leg2.offset": 0.0}, **more)
    table = rows(folder / DATA)
    n = round(at * len(table))
    table[n:] = rows(folder / "later" / "measurements.csv")[n:]
    rng = np.random.default_rng(seed)
    for i, row in enumerate(table):
        row["temperature"] = str(20.0 + 8.0 * i / len(table) + 0.3 * rng.normal())
    write_csv(folder / DATA, table)
    return folder


@pytest.mark.long
@pytest.mark.parametrize(("seed", "at"), [(4, 0.5), (5, 0.5), (4, 0.8)])
def test_a_jump_while_it_gets_warmer_is_not_heat(tmp_path: Path, seed: int, at: float) -> None:
    """Leg 2 loses its zero by 30 um: it is called that, alone or in a set of events."""
    _, found = diagnose(with_jump(tmp_path, 0.03, seed, at))
    assert found["verdict"] in ("named", "named-set")
    (jump,) = found["effects"]
    assert (jump["kind"], jump["on"]) == ("zero_shift", ["leg2"])
    assert not any("thermal" in a for a in jump["alternatives"])
    shift = jump["parameters"]["shift"]
    assert abs(shift["value"] - 0.03) < 3.0 * shift["sigma"]
    first = round(at * int(found["fit"]["rows"])) + 1
    assert jump["row"]["low"] <= first <= jump["row"]["high"]


# --- units ----------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_payload_in_grams_is_not_a_stiffer_machine(tmp_path: Path) -> None:
    """Where the file says kg, stiffness comes out a thousand times too large."""
    simulate(tmp_path, "6-UPS", [effect("compliance", stiffness=5900.0)], count=40,
             conditions={"payload": [0, 15, 30], "temperature": {"mean": 24, "swing": 6}})
    table = rows(tmp_path / DATA)
    for row in table:
        row["payload"] = str(1000.0 * number(row, "payload"))
    write_csv(tmp_path / DATA, table)
    run = ppmcal("diagnose", "m.yaml", DATA, "--out", "d", cwd=tmp_path, expect=3)
    text = " ".join(run.err.split())
    assert "payload" in text and "`read: {units: {payload: g}}`" in text
    edit(tmp_path, read={"units": {"payload": "g"}})
    _, found = diagnose(tmp_path)
    assert named(found) == {"compliance": {f"leg{i}" for i in range(1, 7)}}
    stiffness = value(found, "compliance", "stiffness")
    assert abs(stiffness["value"] - 5900.0) < 3.0 * stiffness["sigma"]


@pytest.mark.long
@pytest.mark.parametrize("seed", [4, 5])
def test_gains_of_a_tenth_are_no_gains(tmp_path: Path, seed: int) -> None:
    """No machine has them: refused, or told as implausible."""
    simulate(tmp_path, "6-UPS", [], count=40, seed=seed,
             conditions={"temperature": {"mean": 24, "swing": 6}})
    gains = np.random.default_rng(seed).uniform(-0.12, 0.12, 6)
    table = rows(tmp_path / DATA)
    for row in table:
        for i, gain in enumerate(gains, 1):
            row[f"q_leg{i}"] = str(number(row, f"q_leg{i}") / (1.0 + gain))
    write_csv(tmp_path / DATA, table)
    run = ppmcal("diagnose", "m.yaml", DATA, "--out", "d", cwd=tmp_path)
    assert run.code in (1, 3), run.out
    if run.code == 1:
        found = found_in(tmp_path)
        assert found["effects"] == [] and found["verdict"] == "unnamed"
        assert any("no machine has that; check the unit of" in f for f in found["findings"])


@pytest.mark.long
def test_a_sigma_a_thousand_times_too_large(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=40, **SINGLE)
    edit(tmp_path, instrument={"kind": "pose", "sigma": {"position": 5.0, "rotation": 1.0}})
    run, found = diagnose(tmp_path)
    assert run.code == 1 and found["effects"] == []
    assert any("sigma is too large" in f for f in found["findings"])


# --- poses that tell little -----------------------------------------------------------------------


FLAT: list[tuple[str, str, float, str, int]] = [
    ("sample", "unknown", 1.0, "one", 1), ("sample", "known", 1.0, "one", 2),
    ("6-UPS", "unknown", 1.0, "one", 3), ("6-UPS", "known", 1.0, "one", 4),
    ("sample", "unknown", 10.0, "one", 5), ("6-UPS", "known", 10.0, "one", 6)]


@pytest.mark.long
@pytest.mark.parametrize(("machine", "frame", "looser", "approach", "seed"), FLAT)
def test_a_flat_grid_shows_no_effect_that_is_not_there(
        tmp_path: Path, machine: str, frame: str, looser: float, approach: str, seed: int) -> None:
    """A hundred poses at one height and orientation, nothing hidden, noise as stated."""
    own = CONFIGS.parent / "sample_data" / "hexapod.yaml" if machine == "sample" else (
        CONFIGS / f"{machine}.yaml")
    drawn = yaml.safe_load(own.read_text(encoding="utf-8"))
    height, half = (400, 40) if machine == "sample" else (2000, 200)
    scenario: dict[str, Any] = {
        "format": "ppmcal/scenario/1", "units": drawn["units"], "seed": seed,
        "poses": {"grid": {"center": {"x": 0, "y": 0, "z": height, "rx": 0, "ry": 0, "rz": 0},
                           "half_range": {"x": half, "y": half}, "counts": {"x": 10, "y": 10}}},
        "errors": {"random": {"scale": 1.0}}, "approach": approach,
        "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.002}},
        "conditions": {"temperature": {"mean": 24, "swing": 6}}}
    if frame == "unknown":
        scenario |= {"frame": {"x": 4, "y": -3, "z": 2, "rx": 0.2, "ry": -0.1, "rz": 1},
                     "target": [3, -2, 5]}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", own, "s.yaml", "--out", "s", cwd=tmp_path, expect=0)
    wide = {k: looser * v for k, v in drawn["tolerances"].items()}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(drawn | {"tolerances": wide}))
    run = ppmcal("diagnose", "m.yaml", DATA, "--out", "d", cwd=tmp_path)
    assert run.code in (0, 1) or (run.code == 3 and "converge" in run.err), run.err
    if run.code != 3:
        found = found_in(tmp_path)
        assert found["verdict"] in ("none", "weak") and named(found) == {}


@pytest.mark.long
def test_a_wave_that_is_there_is_named(tmp_path: Path) -> None:
    """An eighth of the stroke on one leg, in 120 rows."""
    simulate(tmp_path, "6-UPS", [effect("periodic", ["leg3"], cos=0.02, sin=0.01, period=68.0)],
             count=120, **SINGLE)
    stroke = np.ptp(data_of(tmp_path).q[:, 2]) * 1e3
    assert 7.0 < stroke / 68.0 < 9.0
    _, found = diagnose(tmp_path)
    assert named(found) == {"periodic": {"leg3"}}
    period = value(found, "periodic", "period")
    assert abs(period["value"] - 68.0) < 4.0 * period["sigma"] < 4.0


# --- identification -------------------------------------------------------------------------------


def wrong_then_right(folder: Path, wrong: dict[int, tuple[str, float]]) -> tuple[Fit, Fit]:
    """Return the fits with values typed wrong (10 times, or so much more) and without the rows."""
    table = rows(folder / DATA)
    for n, (column, more) in wrong.items():
        was = number(table[n], column)
        table[n][column] = str(was + more if more else was * 10.0)
    write_csv(folder / DATA, table)
    fit = identify(problem_of(folder))
    write_csv(folder / DATA, [r for n, r in enumerate(table) if n not in wrong])
    return fit, identify(problem_of(folder))


def assert_same(typed: Fit, other: Fit, wrong: set[int]) -> None:
    free = list(typed.problem.free)
    tolerance = np.array([typed.problem.mechanism.parameters[p].tolerance for p in free])
    assert wrong <= set(typed.reasons[0])
    assert len(typed.reasons[0]) == len(wrong) + len(other.reasons[0])
    assert np.abs((typed.state.g - other.state.g)[free] / tolerance).max() < 1e-6
    assert typed.converged and typed.iterations <= other.iterations + 3


@pytest.mark.slow
def test_two_of_240_rows_typed_wrong(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=240, approach="one", conditions={})
    wrong = {37: ("y", 0.0), 181: ("q_leg2", 100.0)}
    assert_same(*wrong_then_right(tmp_path, wrong), set(wrong))


@pytest.mark.slow
def test_a_tenth_typed_wrong_of_positions_only(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=120, approach="one", conditions={},
             instrument={"kind": "position", "sigma": {"position": 0.005}})
    rng = np.random.default_rng(1)
    wrong = {int(n): (str(rng.choice(["x", "y", "z", "q_leg1", "q_leg4"])),
                      100.0 if rng.random() < 0.5 else 0.0) for n in rng.permutation(120)[:12]}
    assert_same(*wrong_then_right(tmp_path, wrong), set(wrong))
