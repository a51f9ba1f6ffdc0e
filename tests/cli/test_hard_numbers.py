"""Numbers that cannot be had are refused by name; all others are had, whatever their size."""

import json
import math
import re
import warnings

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows, write_csv

MEASURED = ("x", "y", "rz")


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Return a planar machine's file, the sidecar and rows of a simulated campaign, the truth."""
    folder = tmp_path_factory.mktemp("bench")
    ppmcal("init", "3-RPR", "--out", folder / "mine.yaml", expect=0)
    ppmcal("simulate", folder / "mine.yaml", folder / "mine.scenario.yaml", "--seed", 1,
           "--out", folder / "s", expect=0)
    return (yaml.safe_load((folder / "mine.yaml").read_text()),
            yaml.safe_load((folder / "s" / "measurements.yaml").read_text()),
            rows(folder / "s" / "measurements.csv"),
            json.loads((folder / "s" / "truth.json").read_text())["parameters"])


def written(folder, machine, side, table):
    """Write the three files of a campaign."""
    folder.mkdir(exist_ok=True)
    (folder / "mine.yaml").write_text(yaml.safe_dump(machine))
    (folder / "run.yaml").write_text(yaml.safe_dump(side))
    write_csv(folder / "run.csv", table)
    return folder


def run(folder, *args):
    """Run a command; whatever it says, it is no traceback and no fault of the program's."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = ppmcal(*args, cwd=folder)
    words = " ".join((found.out + found.err).split())
    assert "Traceback" not in words and "fault of ppmcal" not in words, words[-900:]
    assert found.code in (0, 1, 2, 3)
    if found.code in (2, 3):
        assert re.search(r"(Error: |! row 1: ).{10}", words), words
    return found


def copy(value):
    """Return a copy of plain data."""
    return yaml.safe_load(yaml.safe_dump(value))


def with_sigma(side, **values):
    """Return a sidecar with other standard deviations."""
    out = copy(side)
    out["instrument"]["sigma"] |= values
    return out


def with_tolerance(machine, value):
    """Return a machine with one tolerance for all."""
    return {**copy(machine), "tolerances": dict.fromkeys(machine["tolerances"], value)}


def joints(row):
    """Return the names of the joint columns."""
    return [c for c in row if c.startswith("q_")]


def nearly_alike(table, size):
    """Return as many rows of the first pose, apart by ``size`` of each number."""
    rng = np.random.default_rng(0)
    return [{**table[0], "pose": str(i), "time": str(i),
             **{c: repr(float(table[0][c]) * (1.0 + size * rng.normal()))
                for c in (*joints(table[0]), *MEASURED)}} for i in range(len(table))]


def changed(table, cells):
    """Return the rows with some cells changed: (row, column) -> number."""
    out = [dict(r) for r in table]
    for (row, column), value in cells.items():
        out[row][column] = repr(value)
    return out


def gross(table, share):
    """Return the rows, so many of them with a gross error."""
    rng = np.random.default_rng(4)
    at = rng.choice(len(table), int(share * len(table)), replace=False)
    return changed(table, {(int(i), "x"): float(
        float(table[i]["x"]) + rng.choice([-1, 1]) * rng.uniform(5.0, 300.0)) for i in at})


# name: what is refused with (None: nothing is), what is written
ROWS = {
    "all rows the same": ("copied", lambda t: [t[0]] * len(t)),
    "all rows the same but for time": (
        "copied", lambda t: [{**t[0], "time": str(i), "pose": str(i)} for i in range(len(t))]),
    "a single pose": ("at least 3", lambda t: t[:1]),
    "two poses": ("at least 3", lambda t: t[:2]),
    "three poses": (None, lambda t: t[:3]),
    "poses apart by round-off": (None, lambda t: nearly_alike(t, 1e-12)),
    "poses hardly apart": (None, lambda t: nearly_alike(t, 1e-6)),
    "every row five times": (None, lambda t: [r for r in t for _ in range(5)]),
    "one in five wrong": (None, lambda t: gross(t, 0.2)),
    "no joint value fits": ("outside its limits in 30 rows", lambda t: [
        {**r, **dict.fromkeys(joints(r), "1e-3")} for r in t]),
    "two rows typed wrong": (None, lambda t: changed(t, {
        (3, "q_leg1"): 10.0 * float(t[3]["q_leg1"]), (7, "x"): 1e6 * float(t[7]["x"])})),
    "two rows far beyond any machine": (None, lambda t: changed(t, {
        (3, "x"): 1e14, (7, "y"): -1e14})),
}


@pytest.mark.long_cases(
    "one in five wrong-identify", "two rows far beyond any machine-check",
    "two rows far beyond any machine-identify", "two rows typed wrong-identify",
    "poses apart by round-off-identify", "two poses-identify")
@pytest.mark.slow_cases(
    "a single pose-check", "a single pose-identify", "two poses-check", "three poses-identify",
    "every row five times-identify", "one in five wrong-check", "no joint value fits-check",
    "no joint value fits-identify", "poses hardly apart-identify", "two rows typed wrong-check")
@pytest.mark.parametrize("command", ["check", "identify"])
@pytest.mark.parametrize("name", ROWS)
def test_rows_that_tell_little_or_nothing(bench, tmp_path, name, command):
    machine, side, table, _ = bench
    refusal, change = ROWS[name]
    found = run(written(tmp_path / "w", machine, side, change(table)), command, "mine.yaml",
                "run.csv")
    words = " ".join((found.out + found.err).split())
    if refusal is None:
        assert found.code in (0, 1), words[-600:]
    else:
        # what check says of it is a finding
        assert found.code in ((1, 2, 3) if command == "check" else (2, 3))
        assert refusal in words, words[-600:]
        assert "outside the limits of" not in words, "that is told already"


NOISE = {
    "0": ({"position": 0, "rotation": 0}, "greater than 0"),
    "1e-300": ({"position": 1e-300, "rotation": 1e-300}, "is implausible"),
    "1e-15": ({"position": 1e-15, "rotation": 1e-15}, "is implausible"),
    "a rotation of 1e-15": ({"rotation": 1e-15}, "is implausible"),
    "1e300": ({"position": 1e300, "rotation": 1e300}, "out of range"),
    "1e9": ({"position": 1e9}, "is implausible"),
    "drives of 1e-300": ({"actuator": 1e-300}, "is implausible"),
    "drives of 1e11": ({"actuator": 1e11}, "is implausible"),
    "a ten-millionth of the scatter": ({"position": 1e-9, "rotation": 1e-9}, "times the stated"),
}


@pytest.mark.long_cases(
    "a ten-millionth of the scatter-diagnose", "a ten-millionth of the scatter-identify")
@pytest.mark.parametrize("command", ["check", "identify", "diagnose"])
@pytest.mark.parametrize("name", NOISE)
def test_noise_that_cannot_be_meant_is_refused_at_once(bench, tmp_path, name, command):
    machine, side, table, _ = bench
    values, refusal = NOISE[name]
    if refusal == "times the stated" and command == "check":
        pytest.skip("no residuals are judged")
    found = run(written(tmp_path / "w", machine, with_sigma(side, **values), table), command,
                "mine.yaml", "run.csv")
    words = " ".join((found.out + found.err).split())
    # a sigma that is far too small is a finding: the result stands, and says how far off it is
    assert found.code == (1 if refusal == "times the stated" else 2)
    assert refusal in words, words


def test_noise_of_a_row_is_held_to_the_same(bench, tmp_path):
    machine, side, table, _ = bench
    rows_ = [{**r, "sigma_x": "1e-300" if i == 7 else "0.01"} for i, r in enumerate(table)]
    found = run(written(tmp_path / "w", machine, side, rows_), "identify", "mine.yaml", "run.csv")
    assert found.code == 2 and "is implausible" in found.err


TOLERANCES = {0.0: None, 1e-300: "is implausible", 1e-15: "is implausible", 1e-9: None,
              1e6: None, math.inf: None, 1e300: "cannot be"}


@pytest.mark.long_cases(
    "0.0-identify", "1000000.0-identify", "1000000.0-sensitivity", "1000000.0-tolerances",
    "1e-09-check", "1e-09-identify", "1e-09-sensitivity")
@pytest.mark.slow_cases(
    "inf-identify", "inf-sensitivity", "1e-09-tolerances", "inf-tolerances")
@pytest.mark.parametrize("command", ["check", "identify", "sensitivity", "tolerances"])
@pytest.mark.parametrize("value", TOLERANCES)
def test_tolerances_of_any_size(bench, tmp_path, value, command):
    machine, side, table, _ = bench
    folder = written(tmp_path / "w", with_tolerance(machine, value), side, table)
    data = ["run.csv"] if command in ("check", "identify") else []
    more = ["--accuracy", "0.5", "--machines", "100"] if command == "tolerances" else []
    found = run(folder, command, "mine.yaml", *data, *more)
    words = " ".join(found.err.split())
    if TOLERANCES[value]:
        assert found.code == 2 and ("implausible" in words or "out of range" in words), words
    elif command in ("check", "identify"):
        assert found.code in (0, 1), words


IN_SEQUENCE = ("three poses", "poses hardly apart", "two rows typed wrong",
               "two rows far beyond any machine")


@pytest.mark.long_cases(
    "one in five wrong", "poses apart by round-off", "two rows far beyond any machine",
    "two rows typed wrong", "poses hardly apart")
@pytest.mark.parametrize("name", [n for n, (refused, _) in ROWS.items() if not refused])
@pytest.mark.slow
def test_diagnose_of_rows_that_tell_little(bench, tmp_path, name):
    machine, side, table, _ = bench
    approach = "sequence" if name in IN_SEQUENCE else "columns"
    folder = written(tmp_path / "w", machine, {**side, "approach": approach},
                     ROWS[name][1](table))
    found = run(folder, "diagnose", "mine.yaml", "run.csv")
    assert found.code in ((0, 1) if name == "two rows typed wrong" else (0, 1, 3))


@pytest.mark.long_cases(
    "poses hardly apart-method0", "poses hardly apart-method1", "poses hardly apart-method2",
    "poses hardly apart-method4", "two rows typed wrong-method0", "two rows typed wrong-method2",
    "two rows typed wrong-method3", "two rows typed wrong-method4", "three poses-method1",
    "three poses-method3")
@pytest.mark.parametrize("method", [["--method", "gcv"], ["--method", "damped"],
                                    ["--prior", "flat"], ["--sigma", "estimated"],
                                    ["--keep-outliers"]])
@pytest.mark.parametrize("name", [
    *(pytest.param(n, marks=pytest.mark.slow) for n in ("poses hardly apart",
                                                        "two rows typed wrong")), "three poses"])
@pytest.mark.slow
def test_other_methods_refuse_by_name_too(bench, tmp_path, name, method):
    machine, side, table, _ = bench
    folder = written(tmp_path / "w", machine, side, ROWS[name][1](table))
    run(folder, "identify", "mine.yaml", "run.csv", "--iterations", 40, *method)


@pytest.mark.slow
def test_one_row_in_five_wrong_is_left_out_and_the_machine_found(bench, tmp_path):
    machine, side, table, truth = bench
    folder = written(tmp_path / "w", machine, side, gross(table, 0.2))
    found = run(folder, "identify", "mine.yaml", "run.csv", "--json")
    assert found.code == 1
    out = found.json
    assert len(out["excluded"]) == int(0.2 * len(table))
    far = [abs(p["value"] - truth[p["name"]]) / p["sigma"] for p in out["parameters"]
           if p["status"] == "identified"]
    assert max(far) < 4.5


# --- the same machine, a micrometre or a hundred metres large -----------------------------------


def scaled(value, factor):
    """Return a number, or a point or mapping of lengths, times a factor."""
    if isinstance(value, list):
        return [scaled(v, factor) for v in value]
    if isinstance(value, dict):
        return {k: v if k in ("angle", "share", "rz") else scaled(v, factor)
                for k, v in value.items()}
    return value * factor if isinstance(value, float | int) else value


def at_scale(bench, factor):
    """Return machine, sidecar and rows of which every length is so many times as long."""
    machine, side, table, _ = (copy(b) for b in bench)
    for limb in machine["limbs"]:
        for end in ("base", "platform"):
            limb[end] = scaled(limb[end], factor)
    machine["home"] = {"pose": scaled(machine["home"]["pose"], factor)}
    machine["limits"] = scaled(machine.get("limits", {}), factor)
    machine["tolerances"] = {k: v if k == "angle" else v * factor
                             for k, v in machine["tolerances"].items()}
    side["instrument"]["sigma"]["position"] *= factor
    long = {*joints(table[0]), "x", "y"}
    return machine, side, [{k: repr(float(v) * factor) if k in long else v for k, v in r.items()}
                           for r in table]


SCALES = [1e-6, 1e2]
"""Of a machine of a metre: a stage of a micrometre, a frame of 100 m."""


@pytest.fixture(scope="module")
def at_one(bench, tmp_path_factory):
    """Return what commands say of the machine as it is."""
    return answers(tmp_path_factory.mktemp("one"), *at_scale(bench, 1.0))


def answers(folder, machine, side, table):
    """Return what the commands say of a machine."""
    folder = written(folder / "w", machine, side, table)
    found = {"identify": run(folder, "identify", "mine.yaml", "run.csv", "--json").json}
    targets = [{"x": machine["home"]["pose"]["x"], "y": machine["home"]["pose"]["y"],
                "rz": machine["home"]["pose"]["rz"] + turn} for turn in (0.0, 3.0)]
    write_csv(folder / "targets.csv", targets)
    assert run(folder, "kinematics", "inverse", "mine.yaml", "targets.csv", "--out",
               "k").code == 0
    found["kinematics"] = rows(folder / "k" / "kinematics.csv")
    write_csv(folder / "seen.csv", [{c: r[c] for c in MEASURED} for r in table[:3]])
    assert run(folder, "compensate", "identified", "seen.csv").code in (0, 1)
    found["compensate"] = rows(folder / "compensated" / "commands.csv")
    found["check"] = run(folder, "check", "mine.yaml", "run.csv", "--json").json
    assert run(folder, "sensitivity", "mine.yaml").code in (0, 1)
    return found


@pytest.mark.long
@pytest.mark.parametrize("factor", SCALES)
def test_a_scaled_machine_gives_scaled_answers(bench, at_one, tmp_path, factor):
    found = answers(tmp_path, *at_scale(bench, factor))
    one, other = at_one["identify"], found["identify"]
    assert other["rank"] == one["rank"]
    assert other["noise"]["sigma_ratio"] == pytest.approx(one["noise"]["sigma_ratio"], rel=1e-5)
    assert [(s["slots"], s["combinations"]) for s in other["unidentifiable"]] == [
        (s["slots"], s["combinations"]) for s in one["unidentifiable"]]
    for a, b in zip(one["parameters"], other["parameters"], strict=True):
        times = factor if a["unit"] == "mm" else 1.0
        assert b["status"] == a["status"], a["name"]
        if a["sigma"]:
            assert b["sigma"] == pytest.approx(a["sigma"] * times, rel=1e-4)
            assert b["error"] == pytest.approx(a["error"] * times, abs=1e-3 * a["sigma"] * times)
    for a, b in zip(at_one["kinematics"], found["kinematics"], strict=True):
        assert b["status"] == a["status"]
        for name in joints(a):
            assert float(b[name]) == pytest.approx(float(a[name]) * factor, rel=1e-10)
    for a, b in zip(at_one["compensate"], found["compensate"], strict=True):
        assert b["status"] == a["status"]
        for name in joints(a):
            assert float(b[name]) == pytest.approx(float(a[name]) * factor, rel=1e-7)
    assert found["check"]["rank"] == at_one["check"]["rank"]
    assert found["check"]["condition"] == pytest.approx(at_one["check"]["condition"], rel=1e-9)


# --- rotations near half a turn -----------------------------------------------------------------


@pytest.mark.long_cases("-179.999999")
@pytest.mark.parametrize("turn", [179.999999, 180.0, -179.999999, 178.0])
@pytest.mark.slow
def test_measured_rotations_about_half_a_turn(tmp_path, turn):
    """A hexapod seen from a frame turned by about 180 degrees: the vectors flip from row to row."""
    ppmcal("init", "6-UPS", "--out", tmp_path / "mine.yaml", expect=0)
    scenario = yaml.safe_load((tmp_path / "mine.scenario.yaml").read_text())
    scenario["frame"] |= {"rx": turn, "ry": 0.0, "rz": 0.0}
    (tmp_path / "mine.scenario.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", "mine.yaml", "mine.scenario.yaml", "--seed", 2, "--out", "s", cwd=tmp_path)
    found = run(tmp_path, "identify", "mine.yaml", "s/measurements.csv", "--holdout", 0, "--json")
    assert found.code == 0, found.out[-500:]
    assert found.json["noise"]["chi2_p"] > 1e-3
    truth = json.loads((tmp_path / "s" / "truth.json").read_text())["parameters"]
    far = [abs(p["value"] - truth[p["name"]]) / p["sigma"] for p in found.json["parameters"]
           if p["status"] == "identified" and p["sigma"]]
    assert max(far) < 4.5


@pytest.mark.parametrize("turn", [179.9999, 180.0, 181.0, -180.0])
def test_commanded_rotations_about_half_a_turn(bench, tmp_path, turn):
    machine, side, table, _ = bench
    folder = written(tmp_path / "w", machine, side, table)
    write_csv(folder / "targets.csv", [{**machine["home"]["pose"], "rz": turn}])
    found = run(folder, "kinematics", "inverse", "mine.yaml", "targets.csv", "--out", "k")
    (row,) = rows(folder / "k" / "kinematics.csv")
    assert found.code in (0, 1, 3)
    assert row["status"] == "ok" or row["reason"]


# --- other commands -----------------------------------------------------------------------------


def test_plans_for_an_instrument_that_cannot_be_meant(bench, tmp_path):
    machine, side, table, _ = bench
    for sigma, code in ((1e-300, 2), (1e-15, 2), (1e9, 2)):
        folder = written(tmp_path / f"w{sigma}", machine, with_sigma(
            side, position=sigma, rotation=sigma), table)
        found = run(folder, "plan", "mine.yaml", "--instrument", "run.yaml", "--count", 8)
        assert found.code == code and "Error" in found.err


@pytest.mark.slow
def test_a_singular_home_is_said_by_every_command(bench, tmp_path):
    """Three struts at one point: the platform turns freely about it."""
    machine, side, table, _ = (copy(b) for b in bench)
    for limb in machine["limbs"]:
        limb["platform"] = {"point": [0.0, 0.0]}
    folder = written(tmp_path / "w", machine, side, table)
    assert "singular" in " ".join(run(folder, "check", "mine.yaml").out.split())
    write_csv(folder / "targets.csv", [machine["home"]["pose"]])
    for words in (["identify", "mine.yaml", "run.csv"], ["diagnose", "mine.yaml", "run.csv"],
                  ["sensitivity", "mine.yaml"], ["plan", "mine.yaml", "--count", "6"],
                  ["tolerances", "mine.yaml", "--accuracy", "0.5"],
                  ["kinematics", "inverse", "mine.yaml", "targets.csv"],
                  ["workspace", "mine.yaml"], ["stiffness", "mine.yaml"]):
        assert run(folder, *words).code != 0 or words[0] in ("kinematics", "workspace"), words
