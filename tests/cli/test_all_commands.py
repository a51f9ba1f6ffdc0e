"""The commands as the contract states them: run for real, on real files."""

import itertools
import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
import yaml
from helpers.commands import columns, number, pick, ppmcal, ppmcal_process, rows, tree, write_csv

from ppmcal.cli import cli
from ppmcal.commands import command, names
from ppmcal.store.folder import RECORD

MACHINES = {"planar": "3-RPR", "translational": "delta-linear", "spatial": "6-UPS"}

PARAMETERS = ["name", "nominal", "value", "error", "sigma", "sigma_data", "tolerance", "unit",
              "status", "low", "high"]
PREDICTED = ["error_position_before", "error_position_after", "error_rotation_before",
             "error_rotation_after", "sigma_position", "sigma_rotation", "status", "reason"]
SIDECAR = """format: ppmcal/dataset/1
units: {length: mm, angle: deg}
instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}
frame: unknown
target: known
"""
SCENARIO = """format: ppmcal/scenario/1
units: {length: mm, angle: deg}
poses: {random: {center: {x: 500, y: 260, rz: 25}, half_range: {x: 70, y: 70, rz: 8}, count: 30}}
errors: {random: {scale: 1.0}}
instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}
frame: {x: 5, y: -3, rz: 10}
target: [1, 2]
seed: 7
"""


def scenario(folder, name="s.yaml", **changes):
    """Write the planar scenario with some top-level keys replaced."""
    data = yaml.safe_load(SCENARIO) | changes
    (folder / name).write_text(yaml.safe_dump(data))
    return name


def copy(source, target):
    """Copy a campaign so that a test may write into it."""
    shutil.copytree(source, target, dirs_exist_ok=True)
    return target


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    """Every motion once: initialised, simulated, identified; made on first use."""
    made = {}

    def campaign(motion):
        if motion not in made:
            folder = tmp_path_factory.mktemp(motion)
            kind = MACHINES[motion]
            ppmcal("init", kind, "--out", "m.yaml", cwd=folder, expect=0)
            ppmcal("simulate", "m.yaml", "m.scenario.yaml", "--out", "s", cwd=folder, expect=0)
            ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=folder,
                   expect=0)
            made[motion] = folder
        return made[motion]

    return campaign


@pytest.fixture
def bench(campaigns, tmp_path):
    """A planar campaign of its own."""
    return copy(campaigns("planar"), tmp_path / "bench")


def coordinates(folder):
    """Return the pose columns of the simulated measurements."""
    names = columns(folder / "s" / "measurements.csv")
    return [n for n in ("x", "y", "z", "rx", "ry", "rz") if n in names]


def actuators(path):
    """Return the actuators named by a measurement file's q_ columns."""
    return [name[2:] for name in columns(path) if name.startswith("q_")]


# ---------------------------------------------------------------- help and start


@pytest.mark.parametrize("name", names())
def test_every_command_and_option_has_help(name):
    shown, spec = cli.get_command(click.Context(cli), name), command(name)
    assert shown.help
    for option in shown.params:
        if isinstance(option, click.Option):
            assert option.help, option.name
    names = {word for option in shown.params for word in option.opts}
    assert {"--quiet", "--json"} <= names or spec.data    # JSON is all that it prints
    assert ("--out" in names) == bool({"--force", "--overwrite"} & names)
    shown = ppmcal(name, "--help", expect=0).out
    assert max(map(len, shown.splitlines())) <= 80


def test_main_help_names_every_command():
    shown = ppmcal("--help", expect=0).out
    assert all(name in shown for name in names())


@pytest.mark.parametrize("args", [["--help"], ["--version"], ["identify", "--help"]])
def test_help_imports_no_heavy_library(args):
    done = subprocess.run([sys.executable, "-X", "importtime", "-c",
                           "from ppmcal.cli import main; main()", *args],
                          capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0
    loaded = {line.split("|")[-1].strip().split(".")[0] for line in done.stderr.splitlines()}
    assert not loaded & {"numpy", "scipy", "matplotlib"}


@pytest.mark.slow
def test_no_command_loads_statistics_or_pictures():
    """Each takes as long to load as the rest; scipy.special has what is needed."""
    code = ("import sys\nfrom ppmcal.commands import names, work\n"
            "for name in {*names()} - {'report', 'figures', 'certify'}: work(name)\n"
            "print({'scipy.stats', 'matplotlib'} & {*sys.modules} or False)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60,
                          check=False)
    assert (done.returncode, done.stdout) == (0, "False\n"), done.stderr


@pytest.mark.long
def test_installed_command_runs(tmp_path):
    script = Path(sys.executable).with_name("ppmcal")
    done = subprocess.run([script, "init", "3-RPR", "--out", "m.yaml"], cwd=tmp_path, timeout=60,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "Written: m.yaml" in done.stdout + done.stderr
    assert ppmcal_process("check", "m.yaml", cwd=tmp_path).code == 0


@pytest.mark.parametrize("args", [["identfy"], ["identify"], ["check"], ["identify", "--nope"],
                                  ["kinematics", "sideways", "m", "t"]])
def test_usage_errors(args):
    run = ppmcal(*args, expect=2)
    assert not run.out
    assert "Error" in run.err


def test_near_command_and_kind_are_named(tmp_path):
    assert "identify" in ppmcal("identfy", expect=2).err
    assert "6-UPS" in ppmcal("init", "6-UPSS", cwd=tmp_path, expect=2).err
    assert tree(tmp_path) == {}


# ---------------------------------------------------------------- exit codes and streams


def test_init_does_not_overwrite(tmp_path):
    (tmp_path / "m.yaml").write_text("mine")
    run = ppmcal("init", "3-RPR", "--out", "m.yaml", cwd=tmp_path, expect=2)
    assert "m.yaml" in run.err
    assert "--force" in run.err
    assert tree(tmp_path) == {"m.yaml": b"mine"}
    ppmcal("init", "3-RPR", "--out", "m.yaml", "--force", cwd=tmp_path, expect=0)
    assert b"format: ppmcal/mechanism/1" in tree(tmp_path)["m.yaml"]


@pytest.mark.slow
def test_a_command_replaces_only_what_it_wrote_itself(bench):
    measurements = (bench / "s" / "measurements.csv", "--quiet")
    again = ("identify", "m.yaml", *measurements, "--out", "i")
    ppmcal(*again, cwd=bench, expect=0)
    (bench / "i" / "notes.txt").write_text("mine")
    ppmcal(*again, cwd=bench, expect=0)
    model = bench / "i" / "identified.yaml"
    model.write_text(model.read_text() + "# my own line\n")
    before = tree(bench)
    run = ppmcal(*again, cwd=bench, expect=2)
    assert "identified.yaml was edited" in run.err and "--force" in run.err
    assert tree(bench) == before
    ppmcal(*again, "--force", cwd=bench, expect=0)
    assert "my own line" not in model.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("args", [
    ("identify", "m.yaml", "residuals.csv"), ("identify", "identified.yaml", "measurements.csv"),
    ("simulate", "m.yaml", "measurements.yaml"), ("plan", "m.yaml", "--candidates", "poses.csv"),
    ("compensate", "identified.yaml", "commands.csv"),
    ("kinematics", "inverse", "m.yaml", "kinematics.csv")])
def test_no_command_replaces_its_inputs(bench, args):
    """Not even where files may be replaced, whatever the input is called."""
    force = "--overwrite" if args[0] in ("compensate", "export") else "--force"
    for name in ("measurements", "residuals"):
        for end in ("csv", "yaml"):
            shutil.copy(bench / "s" / f"measurements.{end}", bench / f"{name}.{end}")
    shutil.copy(bench / "i" / "identified.yaml", bench)
    if args[0] == "simulate":
        scenario(bench, "measurements.yaml")
    for name in ("poses", "commands", "kinematics"):
        (bench / f"{name}.csv").write_text("x,y,rz\n500,260,25\n510,270,22\n495,255,21\n"
                                           "505,250,27\n520,262,24\n")
    before = tree(bench)
    more = ("--count", "3") if args[0] == "plan" else ()
    assert force in ppmcal(*args, *more, "--out", ".", cwd=bench, expect=2).err
    run = ppmcal(*args, *more, "--out", ".", force, cwd=bench, expect=2)
    named = next(a for a in reversed(args) if a not in ("m.yaml", "measurements.csv"))
    assert f"{named}: is an input of this run" in run.err
    assert tree(bench) == before


def test_demo_refuses_a_folder_of_somebody_else(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    assert "mine.txt" in ppmcal("demo", "--out", tmp_path, expect=2).err
    assert tree(tmp_path) == {"mine.txt": b"mine"}


@pytest.mark.slow
def test_check_with_findings_is_1(bench):
    text = (bench / "m.yaml").read_text()
    # equal triangles at equal orientation: all struts meet in one point
    (bench / "m.yaml").write_text(text.replace("rz: 30}}", "rz: 0}}"))
    run = ppmcal("check", "m.yaml", cwd=bench, expect=1)
    assert "singular" in run.out + run.err


@pytest.mark.slow
def test_outlier_is_excluded_with_reason_and_exit_1(bench):
    table = rows(bench / "s" / "measurements.csv")
    table[4]["x"] = str(float(table[4]["x"]) + 3)
    write_csv(bench / "s" / "measurements.csv", table)
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "o", cwd=bench, expect=1)
    found = rows(bench / "o" / "residuals.csv")
    assert [r["row"] for r in found if r["used"] == "0"] == ["5"]
    assert found[4]["reason"]
    assert not found[3]["reason"]


@pytest.mark.slow
def test_failed_noise_check_is_1(bench):
    path = bench / "s" / "measurements.yaml"
    path.write_text(path.read_text().replace("position: 0.01", "position: 0.001"))
    run = ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "o", cwd=bench, expect=1)
    assert "noise" in run.out + run.err
    assert json.loads((bench / "o" / "identification.json").read_text())["noise"]["chi2_p"] < 1e-3


@pytest.mark.slow
def test_not_converged_is_3_and_leaves_nothing(bench):
    """A hopeless start: the joint values are of another machine."""
    table = rows(bench / "s" / "measurements.csv")
    for k, row in enumerate(table):
        row.update(q_leg1="5", q_leg2=str(5 + k % 2), q_leg3="5")
    write_csv(bench / "s" / "measurements.csv", table)
    before = tree(bench)
    run = ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "o", cwd=bench)
    assert run.code in (2, 3), run
    assert "fault of ppmcal" not in run.err
    assert tree(bench) == before


@pytest.mark.slow
def test_redundancy_alone_is_0(bench):
    found = json.loads((bench / "i" / "identification.json").read_text())
    assert found["redundant"]


COMMAND_LINES = {
    "check": ["m.yaml", "s/measurements.csv"],
    "kinematics": ["inverse", "m.yaml", "poses.csv", "--out", "o"],
    "simulate": ["m.yaml", "m.scenario.yaml", "--out", "o"],
    "identify": ["m.yaml", "s/measurements.csv", "--out", "o"],
    "compensate": ["i/identified.yaml", "poses.csv", "--frame", "base", "--out", "o"],
    "init": ["6-UPS", "--out", "o.yaml"],
}


@pytest.mark.parametrize("name", COMMAND_LINES)
@pytest.mark.slow_cases("identify")
def test_quiet_and_json(bench, name):
    write_csv(bench / "poses.csv", [{"x": 500, "y": 280, "rz": 28}])
    quiet = ppmcal(name, *COMMAND_LINES[name], "--quiet", cwd=bench, expect=0)
    assert quiet.out == ""
    assert quiet.err == ""
    again = ["--force"] if name == "init" else []
    run = ppmcal(name, *COMMAND_LINES[name], *again, "--json", cwd=bench, expect=0)
    assert run.json
    assert "NaN" not in run.out


@pytest.mark.parametrize("flag", ["--json", "--quiet"])
def test_errors_are_shown_in_quiet_and_json(bench, flag):
    run = ppmcal("check", "absent.yaml", flag, cwd=bench, expect=2)
    assert run.out == ""
    assert "absent.yaml" in run.err


@pytest.mark.slow
def test_seed_reproduces_bytes(bench):
    def once(seed, out):
        ppmcal("simulate", "m.yaml", "m.scenario.yaml", "--seed", seed, "--out", f"s{out}",
               cwd=bench, expect=0)
        ppmcal("identify", "m.yaml", f"s{out}/measurements.csv", "--seed", seed, "--out",
               f"i{out}", cwd=bench)
        return {n: (bench / n.format(out)).read_bytes()
                for n in ("s{}/measurements.csv", "i{}/parameters.csv")}

    first, again, other = once(4, "1"), once(4, "2"), once(5, "3")
    assert first == again
    assert first["s{}/measurements.csv"] != other["s{}/measurements.csv"]


@pytest.mark.slow
def test_seed_reproduces_residuals_and_model(bench):
    for out in ("a", "b"):
        ppmcal("identify", "m.yaml", "s/measurements.csv", "--seed", 3, "--out", out, cwd=bench,
               expect=0)
    for name in ("parameters.csv", "residuals.csv", "identified.yaml"):
        assert (bench / "a" / name).read_bytes() == (bench / "b" / name).read_bytes(), name


def test_failing_run_leaves_existing_output_alone(bench):
    before = tree(bench)
    table = (bench / "s" / "measurements.csv").read_text()
    (bench / "s" / "measurements.csv").write_text(table.replace("q_leg3", "q_leg9"))
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=bench, expect=2)
    (bench / "s" / "measurements.csv").write_text(table)
    assert tree(bench) == before


@pytest.mark.slow
def test_output_keeps_foreign_files(bench):
    (bench / "i" / "notes.txt").write_text("mine")
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=bench, expect=0)
    assert (bench / "i" / "notes.txt").read_text() == "mine"


@pytest.mark.long_cases("translational")
@pytest.mark.slow
@pytest.mark.parametrize("motion", MACHINES)
def test_output_is_no_wider_than_a_terminal(campaigns, tmp_path, motion):
    folder = copy(campaigns(motion), tmp_path / "c")
    for args in (["check", "m.yaml"], ["check", "m.yaml", "s/measurements.csv"],
                 ["simulate", "m.yaml", "m.scenario.yaml", "--out", "t"],
                 ["identify", "m.yaml", "s/measurements.csv", "--out", "j"]):
        run = ppmcal(*args, cwd=folder, expect=0)
        lines = (run.out + run.err).splitlines()
        assert max(map(len, lines)) <= 80
        assert "nan" not in run.out.split()


# ---------------------------------------------------------------- what is written


@pytest.mark.slow
@pytest.mark.parametrize("motion", MACHINES)
def test_files_and_columns(campaigns, motion):
    folder = campaigns(motion)
    assert set(tree(folder / "s")) == {RECORD, "measurements.csv", "measurements.yaml",
                                       "truth.json"}
    assert set(tree(folder / "i")) == {RECORD, "identified.yaml", "parameters.csv",
                                       "residuals.csv", "identification.json"}
    pose = coordinates(folder)
    expected = {"planar": ["x", "y", "rz"], "translational": ["x", "y", "z"],
                "spatial": ["x", "y", "z", "rx", "ry", "rz"]}
    assert pose == expected[motion]
    residuals = [f"{part}_{name}" for name in pose for part in ("before", "after", "sigma")]
    assert columns(folder / "i" / "residuals.csv") == ["row", "dataset", *residuals, "used",
                                                       "reason"]


@pytest.mark.parametrize("motion", MACHINES)
@pytest.mark.slow
def test_parameters_columns(campaigns, motion):
    assert columns(campaigns(motion) / "i" / "parameters.csv") == PARAMETERS


@pytest.mark.slow
@pytest.mark.parametrize("motion", MACHINES)
def test_numbers_have_17_digits(campaigns, motion):
    folder = campaigns(motion)
    for row in rows(folder / "i" / "parameters.csv"):
        found = float(row["value"])
        assert float(row["value"]) == found
        written = {p["name"]: p["value"] for p in json.loads(
            (folder / "i" / "identification.json").read_text())["parameters"]}
        assert written[row["name"]] == pytest.approx(found, rel=1e-15, abs=1e-300)


@pytest.mark.slow_cases("spatial")
@pytest.mark.parametrize("motion", MACHINES)
def test_identification_json(campaigns, motion):
    folder = campaigns(motion)
    found = json.loads((folder / "i" / "identification.json").read_text())
    assert found["format"] == "ppmcal/identification/1"
    assert {"parameters", "rank", "redundant", "iterations", "converged", "residual", "noise",
            "provenance"} <= set(found)
    assert found["converged"] is True
    nominal = {row["name"]: float(row["nominal"]) for row in rows(folder / "i" / "parameters.csv")}
    redundant = {entry["name"] for entry in found["redundant"]}
    for p in found["parameters"]:
        assert {"name", "value", "error", "sigma", "sigma_data", "unit", "status"} <= set(p)
        assert p["status"] in ("identified", "fixed", "redundant")
        assert p["error"] == pytest.approx(p["value"] - nominal[p["name"]], abs=1e-9)
        assert (p["status"] == "redundant") == (p["name"] in redundant), p["name"]
        if p["status"] == "identified":
            assert p["sigma"] > 0
            assert p["sigma_data"] >= p["sigma"] * (1 - 1e-6), p["name"]
        else:
            assert p["sigma_data"] is None, p["name"]
    for when in ("before", "after", "holdout"):
        position = found["residual"][when]["position"]
        assert set(position) == {"mean", "rms", "p95", "max", "unit",
                                 *["count"] * (when == "holdout")}
        assert 0 < position["mean"] <= position["rms"] <= position["max"]
        assert {"rms", "max", "unit"} <= set(found["residual"][when]["closure"])
    assert found["residual"]["after"]["position"]["rms"] < (
        found["residual"]["before"]["position"]["rms"])
    assert 0.8 < found["noise"]["sigma_ratio"] < 1.2
    assert found["noise"]["chi2_p"] > 1e-3
    assert len(found["provenance"]["inputs"]) == 3
    assert {"version", "inputs", "command", "seed"} <= set(found["provenance"])


def test_truth_within_posterior(bench):
    """Errors over sigma of the injected machine: the sigmas are honest."""
    truth = json.loads((bench / "s" / "truth.json").read_text())["errors"]
    found = json.loads((bench / "i" / "identification.json").read_text())["parameters"]
    scores = [(p["error"] - truth[p["name"]]) / p["sigma"] for p in found
              if p["status"] == "identified"]
    assert len(scores) > 5
    assert max(map(abs, scores)) < 4
    assert math.sqrt(sum(s * s for s in scores) / len(scores)) < 1.6


@pytest.mark.long_cases("translational")
@pytest.mark.slow
@pytest.mark.parametrize("motion", MACHINES)
def test_identified_is_a_mechanism_file(campaigns, tmp_path, motion):
    folder = copy(campaigns(motion), tmp_path / "c")
    model = yaml.safe_load((folder / "i" / "identified.yaml").read_text())
    assert model["format"] == "ppmcal/mechanism/1"
    frame = model["measurement"]["datasets"]["s"]["frame"]
    assert "rz" in frame
    ppmcal("check", "i/identified.yaml", "s/measurements.csv", cwd=folder, expect=0)
    pick(folder / "s" / "measurements.csv", coordinates(folder), folder / "targets.csv")
    ppmcal("kinematics", "inverse", "i/identified.yaml", "targets.csv", cwd=folder)
    ppmcal("compensate", "i/identified.yaml", "targets.csv", cwd=folder, expect=0)
    ppmcal("identify", "i/identified.yaml", "s/measurements.csv", "--out", "j", cwd=folder,
           expect=0)
    first, second = (json.loads((folder / out / "identification.json").read_text())
                     for out in ("i", "j"))
    for p, q in zip(first["parameters"], second["parameters"], strict=True):
        assert p["name"] == q["name"]
        if p["sigma"]:  # same data, same prior about the same nominal: the same answer
            assert q["value"] == pytest.approx(p["value"], abs=0.02 * p["sigma"]), p["name"]
            assert q["error"] == pytest.approx(p["error"], abs=0.02 * p["sigma"]), p["name"]


# ---------------------------------------------------------------- kinematics


@pytest.mark.parametrize("motion", MACHINES)
def test_forward_of_inverse_through_files(campaigns, tmp_path, motion):
    folder = copy(campaigns(motion), tmp_path / "c")
    data = folder / "s" / "measurements.csv"
    pose, joints = coordinates(folder), [f"q_{name}" for name in actuators(data)]
    pick(data, joints, folder / "q.csv")
    ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--out", "f", cwd=folder, expect=0)
    assert columns(folder / "f" / "kinematics.csv") == [*joints, *pose, "condition", "status",
                                                        "reason"]
    pick(folder / "f" / "kinematics.csv", pose, folder / "p.csv")
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--out", "g", cwd=folder, expect=0)
    assert columns(folder / "g" / "kinematics.csv") == [*pose, *joints, "condition", "status",
                                                        "reason"]
    for there, back in zip(rows(folder / "q.csv"), rows(folder / "g" / "kinematics.csv"),
                           strict=True):
        for name in joints:
            assert number(there, name) == pytest.approx(number(back, name), rel=1e-9, abs=1e-9)
        assert back["status"] == "ok"
    said = json.loads((folder / "g" / "kinematics.json").read_text())["units"]
    assert set(said) >= {*pose, *joints}


def test_forward_of_a_file_that_already_has_poses(bench):
    """The poses must be computed ones, not those that the input happens to hold."""
    data = bench / "s" / "measurements.csv"
    pick(data, ["q_leg1", "q_leg2", "q_leg3"], bench / "q.csv")
    ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--out", "f", cwd=bench, expect=0)
    run = ppmcal("kinematics", "forward", "m.yaml", data, "--out", "g", cwd=bench)
    if run.code == 2:
        assert "x" in run.err
        return
    for right, found in zip(rows(bench / "f" / "kinematics.csv"),
                            rows(bench / "g" / "kinematics.csv"), strict=True):
        for name in ("x", "y", "rz"):
            assert number(found, name) == pytest.approx(number(right, name), abs=1e-9)


def test_status_of_this_run_not_of_the_input(bench):
    write_csv(bench / "p.csv", [{"x": 500, "y": 280, "rz": 25}, {"x": 5000, "y": 280, "rz": 25}])
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--out", "g", cwd=bench, expect=1)
    first = rows(bench / "g" / "kinematics.csv")
    assert first[0]["status"] == "ok"
    assert first[1]["status"] != "ok"
    assert first[1]["reason"]
    table = [{**row, "x": 500, "y": 280} for row in first]
    for row in table:
        row["status"] = "stale"
    write_csv(bench / "p.csv", table)
    run = ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--out", "h", cwd=bench)
    assert run.code in (0, 2)
    if run.code == 0:
        assert [row["status"] for row in rows(bench / "h" / "kinematics.csv")] == ["ok", "ok"]


def test_input_is_repeated_as_it_was(bench):
    write_csv(bench / "p.csv", [{"label": "a b", "x": 500, "y": 280, "rz": 25},
                                {"label": "c", "x": 500, "y": 280, "rz": ""}])
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--out", "g", cwd=bench, expect=1)
    found = rows(bench / "g" / "kinematics.csv")
    assert [row["label"] for row in found] == ["a b", "c"]
    assert found[1]["status"] != "ok"
    assert math.isnan(number(found[1], "rz")), "an empty cell must not become the home's angle"


@pytest.mark.parametrize("motion", MACHINES)
def test_dataset_gives_the_measured_pose(campaigns, tmp_path, motion):
    folder = copy(campaigns(motion), tmp_path / "c")
    data = folder / "s" / "measurements.csv"
    pick(data, [f"q_{name}" for name in actuators(data)], folder / "q.csv")
    ppmcal("kinematics", "forward", "i/identified.yaml", "q.csv", "--dataset", "s", cwd=folder,
           expect=0)
    found = json.loads((folder / "i" / "identification.json").read_text())
    largest = found["residual"]["after"]["position"]["max"]
    for seen, said in zip(rows(data), rows(folder / "kinematics" / "kinematics.csv"),
                          strict=True):
        off = [number(seen, n) - number(said, n) for n in ("x", "y", "z") if n in seen]
        assert math.hypot(*off) <= largest * 1.001


def test_unknown_dataset(bench):
    write_csv(bench / "q.csv", [{"q_leg1": 400, "q_leg2": 400, "q_leg3": 400}])
    run = ppmcal("kinematics", "forward", "i/identified.yaml", "q.csv", "--dataset", "t",
                 cwd=bench, expect=2)
    assert "Allowed: s" in run.err
    assert not (bench / "kinematics").exists()


@pytest.mark.slow
def test_velocity_is_the_derivative(bench):
    step = 1e-4
    pose, speed = (500.0, 280.0, 25.0), (3.0, -2.0, 4.0)
    moved = [p + step * v for p, v in zip(pose, speed, strict=True)]
    names = ("x", "y", "rz")
    write_csv(bench / "p.csv", [dict(zip(names, pose, strict=True)),
                                dict(zip(names, moved, strict=True))])
    write_csv(bench / "v.csv", [dict(zip((*names, "vx", "vy", "wz"), (*pose, *speed),
                                         strict=True))])
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--out", "g", cwd=bench, expect=0)
    ppmcal("kinematics", "velocity", "m.yaml", "v.csv", "--out", "v", cwd=bench, expect=0)
    first, second = rows(bench / "g" / "kinematics.csv")
    rate = rows(bench / "v" / "kinematics.csv")[0]
    for leg in ("leg1", "leg2", "leg3"):
        slope = (number(second, f"q_{leg}") - number(first, f"q_{leg}")) / step
        assert number(rate, f"rate_{leg}") == pytest.approx(slope, rel=1e-4, abs=1e-5)


@pytest.mark.long
def test_empty_coordinates_are_solved_for(tmp_path):
    ppmcal("init", "3-RPS", "--out", "m.yaml", cwd=tmp_path, expect=0)
    write_csv(tmp_path / "p.csv", [{"x": "", "y": "", "z": z, "rx": rx, "ry": -3, "rz": ""}
                                   for z, rx in ((105, 0), (100, 4))])
    run = ppmcal("kinematics", "inverse", "m.yaml", "p.csv", "--json", cwd=tmp_path, expect=0)
    assert run.json["rows"] == 2
    found = rows(tmp_path / "kinematics" / "kinematics.csv")
    assert all(math.isfinite(number(r, n)) for r in found for n in ("q_leg1", "q_leg2", "q_leg3"))
    write_csv(tmp_path / "p.csv", [{"x": 30, "y": 0, "z": 100, "rx": 4, "ry": -3, "rz": 0}])
    ppmcal("kinematics", "inverse", "m.yaml", "p.csv", cwd=tmp_path, expect=1)


# ---------------------------------------------------------------- compensate


@pytest.mark.parametrize("motion", MACHINES)
def test_compensated_machine_reaches_its_targets(campaigns, tmp_path, motion):
    """What the true machine does with the commands, seen by the instrument, is what was wanted."""
    folder = copy(campaigns(motion), tmp_path / "c")
    data = folder / "s" / "measurements.csv"
    pose, joints = coordinates(folder), [f"q_{name}" for name in actuators(data)]
    pick(data, pose, folder / "t.csv")
    ppmcal("compensate", "i/identified.yaml", "t.csv", "--out", "c", cwd=folder, expect=0)
    cmd = [f"cmd_{name}" for name in pose]
    assert columns(folder / "c" / "commands.csv") == [
        *pose, *joints, *(f"{q}_nominal" for q in joints), *cmd, *PREDICTED]
    pick(folder / "c" / "commands.csv", joints, folder / "q.csv")
    ppmcal("kinematics", "forward", "i/identified.yaml", "q.csv", "--dataset", "s", "--out", "f",
           cwd=folder, expect=0)
    for wanted, reached in zip(rows(folder / "t.csv"), rows(folder / "f" / "kinematics.csv"),
                               strict=True):
        for name in pose:
            assert number(reached, name) == pytest.approx(number(wanted, name), abs=1e-6)
    for row in rows(folder / "c" / "commands.csv"):
        assert row["status"] == "ok"
        assert number(row, "error_position_after") <= number(row, "error_position_before")
        assert number(row, "sigma_position") > 0
    # a pose-commanded controller turns cmd_ into the same joints with the nominal model
    pick(folder / "c" / "commands.csv", dict(zip(cmd, pose, strict=True)), folder / "n.csv")
    ppmcal("kinematics", "inverse", "m.yaml", "n.csv", "--out", "n", cwd=folder, expect=0)
    for sent, made in zip(rows(folder / "c" / "commands.csv"),
                          rows(folder / "n" / "kinematics.csv"), strict=True):
        for name in joints:
            assert number(made, name) == pytest.approx(number(sent, name), rel=1e-7, abs=1e-6)


def test_base_frame_differs_by_the_frame(bench):
    write_csv(bench / "t.csv", [{"x": 500, "y": 280, "rz": 28}])
    ppmcal("compensate", "i/identified.yaml", "t.csv", "--frame", "base", cwd=bench, expect=0)
    found = rows(bench / "compensated" / "commands.csv")
    pick(bench / "compensated" / "commands.csv", ["q_leg1", "q_leg2", "q_leg3"], bench / "q.csv")
    ppmcal("kinematics", "forward", "i/identified.yaml", "q.csv", cwd=bench, expect=0)
    reached = rows(bench / "kinematics" / "kinematics.csv")[0]
    for name, wanted in (("x", 500), ("y", 280), ("rz", 28)):
        assert number(reached, name) == pytest.approx(wanted, abs=1e-8)
    assert 0.01 < number(found[0], "error_position_before") < 3
    run = ppmcal("compensate", "i/identified.yaml", "t.csv", "--frame", "S", cwd=bench, expect=2)
    assert "'s'" in run.err
    assert "base" in run.err


def test_refused_rows_have_reasons_and_exit_1(bench):
    table = [{"x": 500, "y": 280, "rz": 28}, {"x": 9000, "y": 0, "rz": 0},
             {"x": "", "y": 280, "rz": 28}, {"x": 500, "y": 280, "rz": 150}]
    write_csv(bench / "t.csv", table)
    run = ppmcal("compensate", "i/identified.yaml", "t.csv", "--frame", "base", cwd=bench,
                 expect=1)
    found = rows(bench / "compensated" / "commands.csv")
    assert [row["status"] for row in found] == ["ok", "refused", "refused", "refused"]
    assert all(row["reason"] for row in found[1:])
    assert not found[0]["reason"]
    for row in found[1:]:
        assert math.isnan(number(row, "q_leg1"))
    for line in ("row 2", "row 3", "row 4"):
        assert line in run.out + run.err


def test_compensate_needs_a_known_frame_name_if_there_is_none(bench):
    """A nominal model without data sets: the targets can only be in the base frame."""
    write_csv(bench / "t.csv", [{"x": 500, "y": 280, "rz": 28}])
    run = ppmcal("compensate", "m.yaml", "t.csv", cwd=bench)
    assert run.code in (0, 2)
    if run.code == 2:
        assert "--frame" in run.err
        assert "base" in run.err
    else:
        row = rows(bench / "compensated" / "commands.csv")[0]
        assert number(row, "q_leg1") == pytest.approx(number(row, "q_leg1_nominal"))


# ---------------------------------------------------------------- simulate


METRES = {"x: 500": "x: 0.5", "y: 288.675": "y: 0.288675", "radius: 250": "radius: 0.25",
          "[1000, 0]": "[1, 0]", "[500, 866.025]": "[0.5, 0.866025]", "200, 700": "0.2, 0.7",
          "point: 0.3, length: 0.3": "point: 0.0003, length: 0.0003",
          "offset: 0.4": "offset: 0.0004", "length: mm": "length: m", "angle: deg}": "angle: rad}",
          "angle: 0.1,": f"angle: {math.radians(0.1)!r},",
          "rz: 30}": f"rz: {math.radians(30)!r}}}"} | {
    f"angle: {{value: {a}": f"angle: {{value: {math.radians(a)!r}" for a in (210, 330, 90)}


@pytest.mark.slow
def test_same_machine_in_metres(bench):
    text = (bench / "m.yaml").read_text()
    for old, new in METRES.items():
        assert old in text, old
        text = text.replace(old, new)
    (bench / "metres.yaml").write_text(text)
    name = scenario(bench)
    ppmcal("simulate", "m.yaml", name, "--out", "a", cwd=bench, expect=0)
    ppmcal("simulate", "metres.yaml", name, "--out", "b", cwd=bench, expect=0)
    for mm, m in zip(rows(bench / "a" / "measurements.csv"),
                     rows(bench / "b" / "measurements.csv"), strict=True):
        for column in ("x", "y", "q_leg1", "q_leg2", "q_leg3"):
            assert number(mm, column) == pytest.approx(1000 * number(m, column), rel=1e-9)
        assert number(mm, "rz") == pytest.approx(math.degrees(number(m, "rz")), rel=1e-9)
    ppmcal("identify", "m.yaml", "a/measurements.csv", "--out", "ia", cwd=bench)
    ppmcal("identify", "metres.yaml", "b/measurements.csv", "--out", "ib", cwd=bench)
    ppmcal("identify", "metres.yaml", "a/measurements.csv", "--out", "ic", cwd=bench)
    mm, m, mixed = (json.loads((bench / out / "identification.json").read_text())
                    for out in ("ia", "ib", "ic"))
    for p, q, r in zip(mm["parameters"], m["parameters"], mixed["parameters"], strict=True):
        scale = {"mm": 1000, "deg": math.degrees(1)}[p["unit"]]
        assert (q["unit"], r["unit"]) == ({"mm": "m", "deg": "rad"}[p["unit"]],) * 2
        assert p["value"] == pytest.approx(scale * q["value"], rel=1e-6, abs=1e-6)
        assert r["value"] == pytest.approx(q["value"], rel=1e-6, abs=1e-9)


def test_outputs_are_in_the_mechanism_units(bench):
    """The scenario is in metres, the mechanism in millimetres: written are millimetres."""
    scenario(bench, units={"length": "m", "angle": "rad"}, target=[0.0, 0.0],
             poses={"grid": {"center": {"x": 0.5, "y": 0.26, "rz": 0.4},
                             "half_range": {"x": 0.05}, "counts": {"x": 3}}}, errors={},
             instrument={"kind": "pose", "sigma": {"position": 1e-9, "rotation": 1e-9}},
             frame={"x": 0, "y": 0, "rz": 0})
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "o", cwd=bench, expect=0)
    found = rows(bench / "o" / "measurements.csv")
    assert [number(r, "x") for r in found] == pytest.approx([450, 500, 550], abs=1e-4)
    assert number(found[0], "rz") == pytest.approx(math.degrees(0.4), abs=1e-4)


PLANS = {
    "circle": ({"center": {"x": 500, "y": 260, "rz": 25}, "radius": 50, "count": 12,
                "swing": {"rz": 5}}, 12),
    "grid": ({"center": {"x": 500, "y": 260, "rz": 25}, "half_range": {"x": 50, "rz": 5},
              "counts": {"x": 3, "rz": 4}}, 12),
    "random": ({"center": {"x": 500, "y": 260, "rz": 25}, "half_range": {"x": 50, "rz": 5},
                "count": 9}, 9),
    "file": ("poses.csv", 2),
}


@pytest.mark.parametrize("plan", PLANS)
def test_pose_plans(bench, plan):
    value, count = PLANS[plan]
    write_csv(bench / "poses.csv", [{"x": 500, "y": 260, "rz": 25}, {"x": 510, "y": 250, "rz": 20}])
    scenario(bench, poses={plan: value}, repeats=2)
    run = ppmcal("simulate", "m.yaml", "s.yaml", "--out", "o", "--json", cwd=bench, expect=0)
    assert run.json
    found = rows(bench / "o" / "measurements.csv")
    assert len(found) == 2 * count
    assert len({row["pose"] for row in found}) == count


def test_injected_errors_are_the_truth(bench):
    scenario(bench, errors={"leg1.base.point.x": 0.5, "leg2.offset": -0.3})
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "o", cwd=bench, expect=0)
    truth = json.loads((bench / "o" / "truth.json").read_text())["errors"]
    assert {k: v for k, v in truth.items() if v} == pytest.approx(
        {"leg1.base.point.x": 0.5, "leg2.offset": -0.3})


# ---------------------------------------------------------------- measurement files


def refit(bench, sidecar=SIDECAR, expect=0, **options):
    """Identify from d.csv with this sidecar; return the identification."""
    (bench / "d.yaml").write_text(sidecar)
    flags = itertools.chain.from_iterable((f"--{k}", v) for k, v in options.items())
    ppmcal("identify", "m.yaml", "d.csv", "--out", "o", *flags, cwd=bench, expect=expect)
    return json.loads((bench / "o" / "identification.json").read_text())


def values(found):
    """Return the identified values by name."""
    return {p["name"]: p["value"] for p in found["parameters"]}


UNKNOWN_TARGET = SIDECAR.replace("target: known", "target: unknown")


@pytest.mark.slow
def test_without_optional_columns(bench):
    pick(bench / "s" / "measurements.csv", ["q_leg1", "q_leg2", "q_leg3", "x", "y", "rz"],
         bench / "d.csv")
    found = refit(bench, UNKNOWN_TARGET)
    assert found["noise"]["sigma_ratio"] == pytest.approx(1, abs=0.2)


@pytest.mark.slow
def test_column_order_and_line_ends_do_not_matter(bench):
    wanted = ["rz", "q_leg3", "y", "q_leg1", "x", "q_leg2"]
    pick(bench / "s" / "measurements.csv", wanted, bench / "d.csv")
    first = values(refit(bench, UNKNOWN_TARGET))
    pick(bench / "s" / "measurements.csv", sorted(wanted), bench / "d.csv")
    text = (bench / "d.csv").read_text().replace("\n", "\r\n")
    (bench / "d.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert values(refit(bench, UNKNOWN_TARGET)) == pytest.approx(first, rel=1e-9, abs=1e-9)


@pytest.mark.slow
def test_commanded_poses_instead_of_joints(bench):
    """cmd_ columns are turned into joints with the nominal model."""
    data = bench / "s" / "measurements.csv"
    pick(data, ["q_leg1", "q_leg2", "q_leg3", "x", "y", "rz"], bench / "d.csv")
    first = values(refit(bench, UNKNOWN_TARGET))
    pick(data, ["q_leg1", "q_leg2", "q_leg3"], bench / "q.csv")
    ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--out", "f", cwd=bench, expect=0)
    write_csv(bench / "d.csv", [
        {"cmd_x": p["x"], "cmd_y": p["y"], "cmd_rz": p["rz"], "x": m["x"], "y": m["y"],
         "rz": m["rz"]}
        for p, m in zip(rows(bench / "f" / "kinematics.csv"), rows(data), strict=True)])
    assert values(refit(bench, UNKNOWN_TARGET)) == pytest.approx(first, rel=1e-6, abs=1e-6)


def to_quaternion(row):
    """Return x, y, z, w of a rotation vector in degrees."""
    vector = [math.radians(number(row, n)) for n in ("rx", "ry", "rz")]
    angle = math.hypot(*vector)
    scale = math.sin(angle / 2) / angle
    return [*(scale * v for v in vector), math.cos(angle / 2)]


@pytest.mark.slow
def test_quaternions(campaigns, tmp_path):
    folder = copy(campaigns("spatial"), tmp_path / "c")
    table = []
    for k, row in enumerate(rows(folder / "s" / "measurements.csv")):
        quaternion = [(-1) ** k * part for part in to_quaternion(row)]
        for name in ("rx", "ry", "rz"):
            del row[name]
        row.update(zip(("quat_x", "quat_y", "quat_z", "quat_w"), quaternion, strict=True))
        table.append(row)
    (folder / "t").mkdir()
    write_csv(folder / "t" / "measurements.csv", table)
    shutil.copy(folder / "s" / "measurements.yaml", folder / "t")
    ppmcal("identify", "m.yaml", "t/measurements.csv", "--out", "j", cwd=folder, expect=0)
    first, second = (values(json.loads((folder / out / "identification.json").read_text()))
                     for out in ("i", "j"))
    assert second == pytest.approx(first, rel=1e-6, abs=1e-6)


@pytest.mark.slow
def test_two_files_with_a_frame_each(bench):
    for k, frame in enumerate(({"x": 5, "y": -3, "rz": 10}, {"x": -900, "y": 40, "rz": 170})):
        # the same machine twice: errors named, only the instrument moved
        scenario(bench, frame=frame, errors={"leg1.offset": 0.5, "leg2.base.point.x": -0.4},
                 seed=k)
        ppmcal("simulate", "m.yaml", "s.yaml", "--out", f"r{k}", cwd=bench, expect=0)
    ppmcal("identify", "m.yaml", "r0/measurements.csv", "r1/measurements.csv", "--out", "o",
           cwd=bench, expect=0)
    model = yaml.safe_load((bench / "o" / "identified.yaml").read_text())
    frames = {name: d["frame"] for name, d in model["measurement"]["datasets"].items()}
    assert len(frames) == 2
    assert sorted(frame["rz"] for frame in frames.values()) == pytest.approx([10, 170], abs=0.1)
    assert {row["dataset"] for row in rows(bench / "o" / "residuals.csv")} == set(frames)
    assert len(rows(bench / "o" / "residuals.csv")) == 60
    write_csv(bench / "t.csv", [{"x": 500, "y": 280, "rz": 28}])
    run = ppmcal("compensate", "o/identified.yaml", "t.csv", cwd=bench, expect=2)
    assert all(name in run.err for name in frames), "with two frames the user must name one"


@pytest.mark.slow
def test_known_frame_and_target(bench):
    scenario(bench, frame={"x": 0, "y": 0, "rz": 0}, target=[0, 0])
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "r", cwd=bench, expect=0)
    pick(bench / "r" / "measurements.csv", ["q_leg1", "q_leg2", "q_leg3", "x", "y", "rz"],
         bench / "d.csv")
    found = refit(bench, SIDECAR.replace("frame: unknown", "frame: known"))
    assert found["rank"] == 12
    assert found["redundant"] == []
    assert all(p["sigma_data"] for p in found["parameters"] if p["status"] == "identified")


@pytest.mark.slow
def test_partly_measured_rows(bench):
    table = rows(bench / "s" / "measurements.csv")
    table[2]["rz"], table[5]["x"], table[7]["y"] = "", "nan", "NaN"
    write_csv(bench / "d.csv", table)
    found = refit(bench, UNKNOWN_TARGET)
    residual = rows(bench / "o" / "residuals.csv")
    assert len(residual) == len(table)
    assert math.isnan(number(residual[2], "after_rz"))
    assert not math.isnan(number(residual[2], "after_x"))
    assert found["noise"]["sigma_ratio"] == pytest.approx(1, abs=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_few_rows_with_unknown_frame_are_refused(bench, count):
    write_csv(bench / "d.csv", rows(bench / "s" / "measurements.csv")[:count])
    (bench / "d.yaml").write_text(UNKNOWN_TARGET)
    run = ppmcal("identify", "m.yaml", "d.csv", "--out", "o", cwd=bench, expect=2)
    assert "d.csv" in run.err
    assert "rows" in run.err
    assert not (bench / "o").exists()
    run = ppmcal("check", "m.yaml", "d.csv", cwd=bench)
    assert run.code in (1, 2)


@pytest.mark.parametrize("count", [1, 2])
def test_few_rows_with_known_frame_are_a_fit_or_refused(bench, count):
    scenario(bench, frame={"x": 0, "y": 0, "rz": 0}, target=[0, 0])
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "r", cwd=bench, expect=0)
    write_csv(bench / "d.csv", rows(bench / "r" / "measurements.csv")[:count])
    (bench / "d.yaml").write_text(SIDECAR.replace("frame: unknown", "frame: known"))
    for flag in ([], ["--prior", "flat"], ["--method", "gcv"]):
        run = ppmcal("identify", "m.yaml", "d.csv", "--out", "o", *flag, cwd=bench)
        assert run.code in (0, 1, 2), run
        if run.code == 2:
            assert "d.csv" in run.err
            assert "row" in run.err
            assert not (bench / "o").exists()
            continue
        found = json.loads((bench / "o" / "identification.json").read_text())
        assert found["rank"] <= 3 * count
        assert "nan" not in run.out.split()


PAPER_HEADER = "x1,y1,z1,phix1,phiy1,phiz1"


@pytest.mark.slow
def test_paper_header(campaigns, tmp_path):
    """x1,y1,z1,phix1,phiy1,phiz1 and the joints by their names are read by header alone."""
    folder = copy(campaigns("spatial"), tmp_path / "c")
    data = folder / "s" / "measurements.csv"
    pose = ["x", "y", "z", "rx", "ry", "rz"]
    names = dict(zip(pose, PAPER_HEADER.split(","), strict=True))
    pick(data, names | {f"q_{a}": a for a in actuators(data)}, folder / "d.csv")
    shutil.copy(folder / "s" / "measurements.yaml", folder / "d.yaml")
    run = ppmcal("identify", "m.yaml", "d.csv", "--out", "o", cwd=folder)
    assert run.code in (0, 1), run
    assert len(rows(folder / "o" / "residuals.csv")) == len(rows(data))


@pytest.mark.slow
def test_leg_length_header(campaigns, tmp_path):
    folder = copy(campaigns("spatial"), tmp_path / "c")
    data = folder / "s" / "measurements.csv"
    table = []
    for row in rows(data):
        new = {f"leg_length_{k}": row[f"q_leg{k}"] for k in range(1, 7)}
        new |= {f"position_{n}": row[n] for n in "xyz"}
        new |= {f"orientation_{n}": v for n, v in zip("xyzw", to_quaternion(row), strict=True)}
        table.append(new)
    write_csv(folder / "d.csv", table)
    sidecar = (folder / "s" / "measurements.yaml").read_text()
    (folder / "d.yaml").write_text(sidecar.replace("approach: columns", "approach: unknown"))
    ppmcal("identify", "m.yaml", "d.csv", "--out", "o", cwd=folder, expect=0)
    first, second = (values(json.loads((folder / out / "identification.json").read_text()))
                     for out in ("i", "o"))
    assert second == pytest.approx(first, rel=1e-6, abs=1e-6)


# ---------------------------------------------------------------- options of identify


@pytest.mark.slow
def test_free_patterns(bench):
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--free", "*.offset", "--out", "o",
           cwd=bench)
    found = json.loads((bench / "o" / "identification.json").read_text())
    free = {p["name"] for p in found["parameters"] if p["status"] != "fixed"}
    assert free == {"leg1.offset", "leg2.offset", "leg3.offset"}
    text = (bench / "m.yaml").read_text()
    (bench / "m.yaml").write_text(text + '\nfree: ["*.offset"]\n')
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "p", cwd=bench)
    again = json.loads((bench / "p" / "identification.json").read_text())
    assert values(again) == pytest.approx(values(found), rel=1e-9, abs=1e-12)
    assert yaml.safe_load((bench / "p" / "identified.yaml").read_text())["free"] == ["*.offset"]


@pytest.mark.slow
def test_free_fifteen_of_the_paper(bench):
    """[PPM]: fifteen, of which the passive angles joint1.rz are redundant."""
    text = (bench / "m.yaml").read_text()
    (bench / "m.yaml").write_text(text + '\nfree: ["*.base.point.?", "*.offset", '
                                  '"*.platform.point.radius", "*.joint1.rz"]\n')
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "o", cwd=bench, expect=0)
    found = json.loads((bench / "o" / "identification.json").read_text())
    status = {p["name"]: p["status"] for p in found["parameters"] if p["status"] != "fixed"}
    assert len(status) == 15
    assert {status[f"leg{k}.joint1.rz"] for k in (1, 2, 3)} == {"redundant"}
    ppmcal("identify", "o/identified.yaml", "s/measurements.csv", "--out", "p", cwd=bench,
           expect=0)


@pytest.mark.slow
def test_flat_prior(bench):
    scenario(bench, frame={"x": 0, "y": 0, "rz": 0}, target=[0, 0])
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "r", cwd=bench, expect=0)
    write_csv(bench / "d.csv", rows(bench / "r" / "measurements.csv"))
    found = refit(bench, SIDECAR.replace("frame: unknown", "frame: known"), prior="flat")
    for p in found["parameters"]:
        if p["status"] == "identified":
            assert p["sigma"] == pytest.approx(p["sigma_data"], rel=1e-6)


@pytest.mark.slow
def test_flat_prior_with_redundancy_has_no_nan(bench):
    run = ppmcal("identify", "m.yaml", "s/measurements.csv", "--prior", "flat", "--out", "o",
                 "--json", cwd=bench, expect=0)
    assert run.json
    text = (bench / "o" / "identification.json").read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    for p in json.loads(text)["parameters"]:
        if p["status"] == "identified":
            assert p["sigma_data"] is not None, p["name"]
    ppmcal("check", "o/identified.yaml", cwd=bench, expect=0)


@pytest.mark.slow
def test_gcv(bench):
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--method", "gcv", "--out", "o",
           cwd=bench, expect=0)
    found = json.loads((bench / "o" / "identification.json").read_text())
    assert found["method"] == "gcv"
    assert 0.8 < found["noise"]["sigma_ratio"] < 1.2


@pytest.mark.long
def test_damped(bench):
    """The scheme of the PPM paper, on what it can do: known frame, few parameters."""
    scenario(bench, frame={"x": 0, "y": 0, "rz": 0}, target=[0, 0],
             errors={"leg1.offset": 0.5, "leg2.offset": -0.4})
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "r", cwd=bench, expect=0)
    write_csv(bench / "d.csv", rows(bench / "r" / "measurements.csv"))
    (bench / "d.yaml").write_text(SIDECAR.replace("frame: unknown", "frame: known"))
    run = ppmcal_process("identify", "m.yaml", "d.csv", "--method", "damped", "--free", "*.offset",
                         "--out", "o", "--holdout", "0", cwd=bench)
    assert run.code == 0, run.err
    found = json.loads((bench / "o" / "identification.json").read_text())
    assert found["method"] == "damped"
    assert values(found)["leg1.offset"] == pytest.approx(0.5, abs=0.02)
    assert values(found)["leg2.offset"] == pytest.approx(-0.4, abs=0.02)


@pytest.mark.slow
def test_holdout_other_file(bench):
    errors = {"leg1.offset": 0.5, "leg2.base.point.x": -0.4}
    for k in range(2):
        scenario(bench, errors=errors, seed=k)
        ppmcal("simulate", "m.yaml", "s.yaml", "--out", f"r{k}", cwd=bench, expect=0)
    ppmcal("identify", "m.yaml", "r0/measurements.csv", "--holdout", "r1/measurements.csv",
           "--out", "o", cwd=bench, expect=0)
    found = json.loads((bench / "o" / "identification.json").read_text())
    assert 0.005 < found["residual"]["holdout"]["position"]["rms"] < 0.05
    assert "r1/measurements.csv" in found["provenance"]["inputs"]
    assert len(rows(bench / "o" / "residuals.csv")) == 30
    ppmcal("identify", "m.yaml", "r0/measurements.csv", "--holdout", "0", "--out", "p",
           cwd=bench, expect=0)
    without = json.loads((bench / "p" / "identification.json").read_text())
    assert not without["residual"].get("holdout")
    assert values(without) == pytest.approx(values(found), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("share", ["-0.1", "1", "nan", "absent.csv", "0.5.csv"])
def test_bad_holdout(bench, share):
    run = ppmcal("identify", "m.yaml", "s/measurements.csv", f"--holdout={share}", "--out", "o",
                 cwd=bench, expect=2)
    assert share in run.err
    assert not (bench / "o").exists()


# ---------------------------------------------------------------- mechanism files


@pytest.mark.slow
def test_extends(bench):
    (bench / "mine.yaml").write_text(
        "extends: m.yaml\nname: mine\nlimbs:\n  - name: leg2\n    offset: 0.25\n"
        "tolerances: {offset: 5}\n")
    ppmcal("check", "mine.yaml", cwd=bench, expect=0)
    write_csv(bench / "p.csv", [{"x": 500, "y": 280, "rz": 28}])
    for name in ("m", "mine"):
        ppmcal("kinematics", "inverse", f"{name}.yaml", "p.csv", "--out", name, cwd=bench,
               expect=0)
    base, mine = (rows(bench / n / "kinematics.csv")[0] for n in ("m", "mine"))
    assert number(mine, "q_leg2") == pytest.approx(number(base, "q_leg2") - 0.25)
    assert number(mine, "q_leg1") == pytest.approx(number(base, "q_leg1"))
    ppmcal("identify", "mine.yaml", "s/measurements.csv", "--out", "sub/o", cwd=bench, expect=0)
    ppmcal("check", "sub/o/identified.yaml", cwd=bench, expect=0)
    found = {r["name"]: r for r in rows(bench / "sub" / "o" / "parameters.csv")}
    assert number(found["leg1.offset"], "tolerance") == 5
    inputs = json.loads((bench / "sub/o/identification.json").read_text())["provenance"]["inputs"]
    assert "m.yaml" in inputs, "the file that is extended decides the result too"


SHARED = """format: ppmcal/mechanism/1
name: shared
units: {length: mm, angle: deg}
motion: planar
limbs:
  - {name: leg1, kind: R(P)R, base: {point: [0, 0]},
     platform: {point: {radius: {value: 250, share: b}, angle: {value: 210, fixed: true}}}}
  - {name: leg2, kind: R(P)R, base: {point: [1000, 0]},
     platform: {point: {radius: {share: b}, angle: {value: 330, fixed: true}}}}
  - {name: leg3, kind: R(P)R, base: {point: [500, 866.025]},
     platform: {point: {radius: {share: b}, angle: {value: 90, fixed: true}}}}
home: {pose: {x: 500, y: 288.675, rz: 30}}
tolerances: {point: 0.3, length: 0.3, angle: 0.1, offset: 0.4}
"""


@pytest.mark.slow
def test_share(bench):
    (bench / "shared.yaml").write_text(SHARED)
    scenario(bench, errors={"b": 0.4})
    run = ppmcal("simulate", "shared.yaml", "s.yaml", "--out", "r", cwd=bench)
    if run.code == 2:  # the parameter may be called by its first slot
        scenario(bench, errors={"leg1.platform.point.radius": 0.4})
        ppmcal("simulate", "shared.yaml", "s.yaml", "--out", "r", cwd=bench, expect=0)
    ppmcal("identify", "shared.yaml", "r/measurements.csv", "--out", "o", cwd=bench, expect=0)
    found = json.loads((bench / "o" / "identification.json").read_text())
    free = [p["name"] for p in found["parameters"] if p["status"] != "fixed"]
    assert len(free) == 10
    model = yaml.safe_load((bench / "o" / "identified.yaml").read_text())
    assert "share: b" in (bench / "o" / "identified.yaml").read_text()
    slot = model["limbs"][0]["platform"]["point"]["radius"]
    assert slot["value"] == pytest.approx(250.4, abs=0.15)
    assert slot["nominal"] == 250
    ppmcal("check", "o/identified.yaml", cwd=bench, expect=0)


def test_polar_points_are_the_cartesian_ones(bench):
    text = (bench / "m.yaml").read_text()
    for angle in (210, 330, 90):
        old = f"point: {{radius: 250, angle: {{value: {angle}, fixed: true}}}}"
        assert old in text
        x, y = (250 * f(math.radians(angle)) for f in (math.cos, math.sin))
        text = text.replace(old, f"point: [{x!r}, {y!r}]")
    (bench / "xy.yaml").write_text(text)
    write_csv(bench / "p.csv", [{"x": 500, "y": 280, "rz": 28}])
    for name in ("m", "xy"):
        ppmcal("kinematics", "inverse", f"{name}.yaml", "p.csv", "--out", name, cwd=bench,
               expect=0)
    polar, flat = (rows(bench / n / "kinematics.csv")[0] for n in ("m", "xy"))
    for leg in ("q_leg1", "q_leg2", "q_leg3"):
        assert number(polar, leg) == pytest.approx(number(flat, leg), rel=1e-12)


@pytest.mark.slow
def test_ratio_in_revolutions(bench):
    text = (bench / "m.yaml").read_text()
    (bench / "rev.yaml").write_text(
        text.replace("base: {point: [1000, 0]}", "base: {point: [1000, 0]}\n    ratio: 71.2")
        .replace("leg2: [200, 700]", "leg2: [2.8, 9.8]"))
    write_csv(bench / "p.csv", [{"x": 500, "y": 280, "rz": 28}])
    for name in ("m", "rev"):
        ppmcal("kinematics", "inverse", f"{name}.yaml", "p.csv", "--out", name, cwd=bench,
               expect=0)
    plain, turned = (rows(bench / n / "kinematics.csv")[0] for n in ("m", "rev"))
    assert number(turned, "q_leg2") == pytest.approx(number(plain, "q_leg2") / 71.2)
    assert number(turned, "q_leg1") == pytest.approx(number(plain, "q_leg1"))
    units = json.loads((bench / "rev" / "kinematics.json").read_text())["units"]
    assert units["q_leg1"] == "mm"
    assert units["q_leg2"] != "mm"
    # the same measurements with leg2 in revolutions give the same geometry
    table = rows(bench / "s" / "measurements.csv")
    for row in table:
        row["q_leg2"] = repr(float(row["q_leg2"]) / 71.2)
    write_csv(bench / "d.csv", table)
    (bench / "d.yaml").write_text(UNKNOWN_TARGET)
    ppmcal("identify", "rev.yaml", "d.csv", "--out", "o", cwd=bench, expect=0)
    found = json.loads((bench / "o" / "identification.json").read_text())
    write_csv(bench / "d.csv", rows(bench / "s" / "measurements.csv"))
    assert refit(bench, UNKNOWN_TARGET)["rank"] == found["rank"]
    first, second = values(refit(bench, UNKNOWN_TARGET)), values(found)
    assert second["leg2.offset"] == pytest.approx(first["leg2.offset"], abs=1e-6)
    ppmcal("compensate", "o/identified.yaml", "p.csv", "--frame", "base", cwd=bench, expect=0)


@pytest.mark.slow
def test_missing_tolerances_warn(bench):
    text = (bench / "m.yaml").read_text()
    kept = [line for line in text.splitlines() if not line.startswith("tolerances")]
    (bench / "m.yaml").write_text("\n".join(kept))
    run = ppmcal("check", "m.yaml", cwd=bench)
    assert run.code in (0, 1)
    assert "tolerances" in run.out + run.err
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "o", cwd=bench)
    found = json.loads((bench / "o" / "identification.json").read_text())
    assert {p["status"] for p in found["parameters"]} >= {"identified"}


def test_gauge_of_home_with_joint_values(bench):
    text = (bench / "m.yaml").read_text()
    home = "rz: 30}, q: {leg1: 381.8813, leg2: 381.8812, leg3: 381.8811}}"
    (bench / "m.yaml").write_text(text.replace("rz: 30}}", home))
    ppmcal("check", "m.yaml", cwd=bench, expect=0)
    (bench / "m.yaml").write_text(text.replace("rz: 30}}", home.replace("leg2: 381", "leg2: 391")))
    run = ppmcal("check", "m.yaml", cwd=bench)
    assert run.code in (1, 2)
    assert "leg2" in run.out + run.err
    assert "home" in run.out + run.err


# ---------------------------------------------------------------- report


@pytest.mark.slow
def test_report(bench):
    run = ppmcal("report", "s", "i", "--out", "r", "--json", cwd=bench)
    assert run.code in (0, 1), run
    assert run.json
    assert {"report.html", "report.json"} <= set(tree(bench / "r"))
    page = (bench / "r" / "report.html").read_text()
    for loaded in ('src="http', "src='http", '<link rel="stylesheet"', "@import", "<script src"):
        assert loaded not in page, "self-contained"
    assert "3-RPR" in page
    assert "NaN" not in (bench / "r" / "report.json").read_text()


def test_report_of_nothing(bench):
    (bench / "empty").mkdir()
    before = tree(bench)
    for folder in ("empty", "absent", "m.yaml"):
        run = ppmcal("report", folder, "--out", "r", cwd=bench, expect=2)
        assert folder in run.err
    assert tree(bench) == before
