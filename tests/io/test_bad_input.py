"""Broken files given to the real commands: one message that says what, where and how to mend it.

Every refusal has exit code 2, leaves nothing behind, and never shows a traceback.
"""

import json
import os
import random
import shutil
from pathlib import Path

import pytest
from helpers.commands import ppmcal, rows, tree, write_csv

from ppmcal.errors import BadInput
from ppmcal.io.schema import check
from ppmcal.io.sidecar import SidecarFile

MECHANISM = """format: ppmcal/mechanism/1
name: bench
units: {length: mm, angle: deg}
motion: planar
limbs:
  - name: leg1
    kind: R(P)R
    base: {point: [0, 0]}
    platform: {point: [-120, -69.282]}
  - name: leg2
    kind: R(P)R
    base: {point: [1000, 0]}
    platform: {point: [120, -69.282]}
  - name: leg3
    kind: R(P)R
    base: {point: [500, 866.025]}
    platform: {point: [0, 138.564]}
home: {pose: {x: 500, y: 260, rz: 25}}
tolerances: {point: 0.5, length: 0.3, angle: 0.1, offset: 0.4}
limits: {leg1: [200, 900]}
"""
SCENARIO = """format: ppmcal/scenario/1
units: {length: mm, angle: deg}
poses: {random: {center: {x: 500, y: 260, rz: 25}, half_range: {x: 60, y: 60, rz: 8}, count: 12}}
errors: {random: {scale: 1.0}}
instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}
frame: {x: 5, y: -3, rz: 10}
seed: 7
"""
TARGETS = "x,y,rz\n500,280,20\n510,270,22\n"

CHECK = ["check", "m.yaml"]
DATA = ["identify", "m.yaml", "d.csv", "--out", "o"]
SIMULATE = ["simulate", "m.yaml", "s.yaml", "--out", "o"]
TARGET = ["compensate", "i/identified.yaml", "t.csv", "--out", "o"]
INVERSE = ["kinematics", "inverse", "m.yaml", "t.csv", "--out", "o"]
FORWARD = ["kinematics", "forward", "m.yaml", "t.csv", "--out", "o"]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A campaign that works: m.yaml, s.yaml, d.csv, d.yaml, t.csv and i/ identified."""
    folder = tmp_path_factory.mktemp("good")
    (folder / "m.yaml").write_text(MECHANISM)
    (folder / "s.yaml").write_text(SCENARIO)
    (folder / "t.csv").write_text(TARGETS)
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "r", cwd=folder, expect=0)
    for end in ("csv", "yaml"):
        shutil.move(folder / "r" / f"measurements.{end}", folder / f"d.{end}")
    shutil.rmtree(folder / "r")
    ppmcal("identify", "m.yaml", "d.csv", "--out", "i", cwd=folder)
    assert (folder / "i" / "identified.yaml").exists()
    return folder


@pytest.fixture
def files(good, tmp_path):
    """A copy of the good campaign to be broken."""
    return shutil.copytree(good, tmp_path / "c")


def refuse(folder, args, *said):
    """Run a command that must be refused; return its message."""
    before = tree(folder)
    run = ppmcal(*args, cwd=folder)
    text = run.out + run.err
    assert run.code == 2, f"exit {run.code}\n{text}"
    assert run.out == ""
    assert "Traceback" not in text
    assert "fault of ppmcal" not in text
    assert run.err.count("Error:") == 1, run.err
    for word in said:
        assert word in run.err, f"{word!r} is not in: {run.err}"
    assert tree(folder) == before, "something was written"
    return run.err


def replace(path, old, new):
    """Replace text that must be there."""
    text = path.read_text()
    assert old in text, f"{old!r} is not in {path}"
    path.write_text(text.replace(old, new, 1))


# ---------------------------------------------------------------- mechanism files

LEG4 = "  - {name: leg4, kind: R(P)R, base: {point: [9, 9]}, platform: {point: [1, 1]}}\n"

# (what, old text, new text, words of the message)
MECHANISMS = {
    "unknown unit": ("length: mm", "length: ft", ["units.length", "um"]),
    "no units": ("units: {length: mm, angle: deg}\n", "", ["units"]),
    "units not a map": ("units: {length: mm, angle: deg}", "units: mm", ["units"]),
    "kind with near match": ("kind: R(P)R", "kind: R(P)Q", ["leg1", "kind", "R(P)R"]),
    "kind that no actuator holds": ("kind: R(P)R", "kind: RPR", ["leg1", "R(P)R"]),
    "two limbs": (MECHANISM[MECHANISM.index("  - name: leg3"):MECHANISM.index("home:")], "",
                  ["2", "3"]),
    "no limbs": (MECHANISM[MECHANISM.index("limbs:"):MECHANISM.index("home:")], "", ["limbs"]),
    "duplicate limb": ("name: leg2", "name: leg1", ["leg1", "limbs"]),
    "unreachable home": ("kind: R(P)R\n    base: {point: [0, 0]}",
                         "kind: R(R)R\n    proximal: 10\n    distal: 10\n    base: {point: [0, 0]}",
                         ["home", "leg1"]),
    "home joint unknown": ("rz: 25}}", "rz: 25}, q: {leg9: 400}}", ["home", "leg9", "leg1"]),
    "home coordinate unknown": ("rz: 25}}", "rx: 25}}", ["home", "rx"]),
    "no home": ("home: {pose: {x: 500, y: 260, rz: 25}}\n", "", ["home"]),
    "yaml syntax": ("units: {length: mm,", "units: {length: mm", ["m.yaml:3:"]),
    "tab": ("  - name: leg1", "\t- name: leg1", ["m.yaml:6:"]),
    "duplicate key": ("motion: planar", "motion: planar\nmotion: planar",
                      ["m.yaml:5:", "motion", "twice"]),
    "unknown key": ("limits:", "limit:", ["limit", "limits"]),
    "negative tolerance": ("point: 0.5", "point: -0.5", ["tolerances.point"]),
    "unknown tolerance": ("point: 0.5", "points: 0.5", ["points", "point"]),
    "tolerance text": ("point: 0.5", "point: small", ["tolerances.point", "small"]),
    "limits reversed": ("[200, 900]", "[900, 200]", ["limits", "leg1"]),
    "limits of no joint": ("limits: {leg1", "limits: {leg9", ["limits", "leg9", "leg1"]),
    "limits of one number": ("[200, 900]", "[200]", ["limits", "leg1"]),
    "nan": ("[1000, 0]", "[.nan, 0]", ["leg2.base.point"]),
    "inf": ("[1000, 0]", "[.inf, 0]", ["leg2.base.point"]),
    "huge": ("[1000, 0]", "[1.0e+308, 0]", ["leg2"]),
    "huge exponent": ("[1000, 0]", "[1e999, 0]", ["leg2.base.point"]),
    "huge integer": ("[1000, 0]", f"[{'9' * 400}, 0]", ["leg2.base.point"]),
    "free matches nothing": ("limits:", 'free: ["leg9.*"]\nlimits:', ["free", "leg9.*"]),
    "free is a word": ("limits:", "free: offsets\nlimits:", ["free"]),
    "two points coincide": ("[1000, 0]", "[500, 260]", ["m.yaml"]),
    "extends nothing": ("name: bench", "extends: absent.yaml", ["absent.yaml"]),
    "extends itself": ("name: bench", "extends: m.yaml", ["extends", "m.yaml"]),
    "extends a file of another drive": ("name: bench", "extends: C:x.yaml", ["leads out"]),
    "extends by backslashes": ("name: bench", "extends: sub\\..\\..\\x.yaml", ["leads out"]),
    "extends a share": ("name: bench", "extends: \\\\host\\x.yaml", ["leads out"]),
    "extends a number": ("name: bench", "extends: 3", ["extends"]),
    "other format": ("mechanism/1", "mechanism/7", ["format", "ppmcal/mechanism/1"]),
    "a dataset's format": ("mechanism/1", "dataset/1", ["format", "ppmcal/mechanism/1"]),
    "motion": ("motion: planar", "motion: plannar", ["motion", "planar"]),
    "motion and points": ("motion: planar", "motion: spatial", ["m.yaml"]),
    "gravity zero": ("limits:", "gravity: [0, 0, 0]\nlimits:", ["gravity"]),
    "ratio zero": ("name: leg1\n", "name: leg1\n    ratio: 0\n", ["leg1", "ratio"]),
    "branch": ("name: leg1\n", "name: leg1\n    branch: 3\n", ["leg1", "branch"]),
    "shared actuator too many": ("name: leg1\n", "name: leg1\n    actuator: leg2\n", ["m.yaml"]),
    "alias bomb": ("name: bench", "name: [&a [x, x], *a, *a]", ["name"]),
}


@pytest.mark.parametrize("what", MECHANISMS)
def test_mechanism(files, what):
    old, new, said = MECHANISMS[what]
    if what == "two points coincide":  # leg2's joints coincide at home: length 0 is singular
        replace(files / "m.yaml", "platform: {point: [120, -69.282]}", "platform: {point: [0, 0]}")
        replace(files / "m.yaml", old, new)
        run = ppmcal(*CHECK, cwd=files)
        assert run.code in (1, 2)
        assert "fault of ppmcal" not in run.err
        return
    if what == "shared actuator too many":  # three conditions, two actuators: is it a machine?
        replace(files / "m.yaml", old, new)
        run = ppmcal(*CHECK, cwd=files)
        assert run.code in (0, 1, 2)
        assert "fault of ppmcal" not in run.err
        return
    replace(files / "m.yaml", old, new)
    refuse(files, CHECK, "m.yaml", *said)


def test_extends_cycle(files):
    (files / "a.yaml").write_text("extends: b.yaml\n")
    (files / "b.yaml").write_text("extends: a.yaml\n")
    refuse(files, ["check", "a.yaml"], "a.yaml", "extends")


def test_share_contradiction_names_both_values(files):
    for leg, value in (("leg1", 1), ("leg2", 2)):
        replace(files / "m.yaml", f"name: {leg}\n",
                f"name: {leg}\n    offset: {{value: {value}, share: s}}\n")
    refuse(files, CHECK, "m.yaml", "offset", "1", "2")


CONTENTS = {
    "empty": b"", "blank": b"  \n\n", "binary": bytes(range(256)) * 8, "nul": b"\x00" * 100,
    "latin": "x,y,rz\nGr\xf6\xdfe,2,3\n".encode("latin-1"), "utf16": "x,y".encode("utf-16"),
    "list": b"- 1\n- 2\n", "number": b"3\n", "html": b"<html><body>404</body></html>",
}


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("name", ["m.yaml", "d.csv", "d.yaml", "t.csv", "s.yaml",
                                  "i/identification.json"])
def test_files_of_another_kind(files, name, content):
    (files / name).write_bytes(CONTENTS[content])
    line = {"m": CHECK, "d": DATA, "t": TARGET, "s": SIMULATE, "i": TARGET}[name[0]]
    refuse(files, line, name)


@pytest.mark.parametrize("name", ["m.yaml", "d.csv", "d.yaml", "t.csv", "s.yaml",
                                  "i/identified.yaml"])
@pytest.mark.parametrize("state", ["absent", "folder", "unreadable", "dangling"])
def test_files_that_are_none(files, name, state):
    path = files / name
    path.unlink()
    if state == "folder":
        path.mkdir()
    elif state == "dangling":
        path.symlink_to("nowhere")
    elif state == "unreadable":
        path.write_text("x")
        path.chmod(0)
        if os.access(path, os.R_OK):
            pytest.skip("this user may read everything")
    line = {"m": CHECK, "d": DATA, "t": TARGET, "s": SIMULATE, "i": TARGET}[name[0]]
    before = set(files.rglob("*"))
    run = ppmcal(*line, cwd=files, expect=2)
    assert name in run.err
    assert "Traceback" not in run.err
    assert "fault of ppmcal" not in run.err
    assert set(files.rglob("*")) == before
    if state == "unreadable":
        path.chmod(0o600)


# ---------------------------------------------------------------- measurements


def edit(path, change):
    """Change every row of a CSV file with a function of number and row; None drops the row."""
    changed = [change(k, dict(row)) for k, row in enumerate(rows(path))]
    write_csv(path, [row for row in changed if row is not None])


def with_cell(row_number, column, value):
    """Return a change that sets one cell (rows count from 1)."""
    def change(k, row):
        return row | {column: value} if k == row_number - 1 else row
    return change


def renamed(old, new):
    """Return a change that renames one column."""
    return lambda k, row: {new if name == old else name: v for name, v in row.items()}


TABLES = {
    "nan column": (lambda k, r: r | {"q_leg2": "nan"}, ["q_leg2"]),
    "text": (with_cell(3, "x", "abc"), ["x", "abc", "row 3"]),
    "decimal comma": (with_cell(3, "x", '"1,5"'), ["x", "1,5", "row 3"]),
    "inf": (with_cell(3, "x", "inf"), ["x", "row 3"]),
    "overflow": (with_cell(3, "x", "1e999"), ["x", "row 3"]),
    "joint absent": (renamed("q_leg3", "q_leg4"), ["q_leg4", "q_leg3"]),
    "unknown joint": (lambda k, r: r | {"q_legg": "1"}, ["q_legg"]),
    "near column": (renamed("rz", "rzz"), ["rzz", "rz"]),
    "no pose": (lambda k, r: {n: v for n, v in r.items() if n not in ("x", "y", "rz")}, ["x"]),
    "no joints": (lambda k, r: {n: v for n, v in r.items() if n[0] != "q"}, ["q_leg1"]),
    "one row": (lambda k, r: r if k == 0 else None, ["row"]),
    "direction 2": (with_cell(2, "dir_leg1", "2"), ["dir_leg1", "row 2"]),
    "sigma zero": (lambda k, r: r | {"sigma_x": "0"}, ["sigma_x"]),
    "sigma negative": (lambda k, r: r | {"sigma_x": "-1"}, ["sigma_x"]),
    "huge": (lambda k, r: r | {"x": "1e300"}, ["x"]),
}


@pytest.mark.slow
def test_every_length_in_another_unit(files):
    """What another reading explains is no result, exit code 3; the mend is told."""
    lengths = ("x", "y", "q_leg1", "q_leg2", "q_leg3")
    edit(files / "d.csv", lambda k, r: r | {n: float(r[n]) / 1000 for n in lengths})
    run = ppmcal(*DATA, cwd=files)
    assert run.code == 3
    assert all(f"{n}: m" in run.err for n in lengths) and "`read: {units: {" in run.err


@pytest.mark.slow
def test_a_joint_column_and_a_rotation_exchanged(files):
    edit(files / "d.csv", lambda k, r: r | {"q_leg1": r["rz"], "rz": r["q_leg1"]})
    run = ppmcal(*DATA, cwd=files)
    assert run.code == 3 and "q_leg1" in run.err


@pytest.mark.parametrize("what", TABLES)
@pytest.mark.slow_cases("one row")
def test_table(files, what):
    change, said = TABLES[what]
    edit(files / "d.csv", change)
    refuse(files, DATA, "d.csv", *said)


@pytest.mark.parametrize("extra", [{"rx": 1}, {"cmd_x": 1, "cmd_y": 2, "cmd_rz": 3}])
@pytest.mark.slow_cases("extra0")
def test_columns_that_are_not_used_are_named(files, extra):
    edit(files / "d.csv", lambda k, row: row | extra)
    run = ppmcal(*DATA, cwd=files)
    assert run.code in (1, 2), run.out
    assert next(iter(extra)) in run.out + run.err


def test_only_a_header(files):
    path = files / "d.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    refuse(files, DATA, "d.csv", "row")


def test_duplicate_column(files):
    replace(files / "d.csv", "q_leg2", "q_leg1")
    refuse(files, DATA, "d.csv", "q_leg1", "two columns")


@pytest.mark.parametrize("tail", [",1", ",1,2,3"])
def test_ragged_row(files, tail):
    lines = (files / "d.csv").read_text().splitlines()
    lines[3] += tail
    (files / "d.csv").write_text("\n".join(lines) + "\n")
    refuse(files, DATA, "d.csv", "row 3")


def test_semicolons(files):
    path = files / "d.csv"
    header, rest = path.read_text().split("\n", 1)
    path.write_text(header.replace(",", ";") + "\n" + rest)
    refuse(files, DATA, "d.csv", "semicolon")


SIDECARS = {
    "no format": ("format: ppmcal/dataset/1\n", "", ["format", "ppmcal/dataset/1"]),
    "unknown unit": ("length: mm", "length: inch", ["units.length", "in"]),
    "no unit": ("units:\n  length: mm\n  angle: deg\n", "", ["units"]),
    "unknown instrument": ("kind: pose", "kind: laser", ["instrument.kind", "pose"]),
    "sigma zero": ("position: 0.01", "position: 0", ["sigma.position"]),
    "sigma negative": ("position: 0.01", "position: -0.01", ["sigma.position"]),
    "sigma nan": ("position: 0.01", "position: .nan", ["sigma.position"]),
    "sigma text": ("position: 0.01", "position: ten", ["sigma.position", "ten"]),
    "sigma missing": ("    rotation: 0.002\n", "", ["sigma", "rotation"]),
    "sigma unknown": ("rotation: 0.002", "rotations: 0.002", ["sigma", "rotations", "rotation"]),
    "frame nonsense": ("frame: unknown", "frame: somewhere", ["frame", "unknown", "known"]),
    "frame with unknown coordinate": ("frame: unknown", "frame: {x: 1, q: 2}", ["frame", "q"]),
    "frame of no file": ("frame: unknown", "frame: {same_as: other}", ["frame", "other"]),
    "frame missing": ("frame: unknown\n", "", ["frame"]),
    "target missing": ("target: known\n", "", ["target"]),
    "target of three": ("target: known", "target: [1, 2, 3, 4]", ["target"]),
    "target nonsense": ("target: known", "target: there", ["target", "there"]),
    "approach": ("approach: columns", "approach: colums", ["approach", "columns"]),
    "unknown key": ("approach: columns", "aproach: columns", ["aproach", "approach"]),
    "syntax": ("frame: unknown", "frame: {x: 1", ["yaml:"]),
}


@pytest.mark.parametrize("what", SIDECARS)
def test_sidecar(files, what):
    old, new, said = SIDECARS[what]
    if what == "sigma missing":
        assert old in (files / "d.yaml").read_text()
    replace(files / "d.yaml", old, new)
    refuse(files, DATA, "d.", *said)


def test_missing_sidecar_names_what_it_should_hold(files):
    (files / "d.yaml").unlink()
    refuse(files, DATA, "d.yaml", "units", "instrument", "frame", "target")


def test_same_data_twice(files):
    refuse(files, ["identify", "m.yaml", "d.csv", "d.csv", "--out", "o"], "d")


def test_mechanism_as_data_and_data_as_mechanism(files):
    refuse(files, ["identify", "m.yaml", "m.yaml", "--out", "o"], "m.")
    refuse(files, ["check", "d.csv"], "d.csv")
    refuse(files, ["check", "d.yaml"], "d.yaml", "ppmcal/mechanism/1")


QUATERNIONS = ("quat_x", "quat_y", "quat_z", "quat_w")


@pytest.mark.slow_cases("quaternion2-None")
@pytest.mark.parametrize(("quaternion", "said"), [
    ((0.1, 0.2, 0.3, 5.0), "quat"), ((0, 0, 0, 0), "quat"), (("nan", 0, 0, 1), None)])
def test_quaternions(tmp_path, quaternion, said):
    ppmcal("init", "6-UPS", "--out", "m.yaml", cwd=tmp_path, expect=0)
    ppmcal("simulate", "m.yaml", "m.scenario.yaml", "--out", "r", cwd=tmp_path, expect=0)
    good = 0.0, 0.0, 0.0, 1.0

    def change(k, row):
        row = {n: v for n, v in row.items() if n not in ("rx", "ry", "rz")}
        return row | dict(zip(QUATERNIONS, quaternion if k == 4 else good, strict=True))

    edit(tmp_path / "r" / "measurements.csv", change)
    line = ["check", "m.yaml", "r/measurements.csv"]
    if said:
        refuse(tmp_path, line, "measurements.csv", said, "row 5")
    else:
        run = ppmcal(*line, cwd=tmp_path)
        assert run.code in (0, 1, 2)
        assert "fault of ppmcal" not in run.err


# ---------------------------------------------------------------- scenarios, targets, models

SCENARIOS = {
    "no units": ("units: {length: mm, angle: deg}\n", "", ["units"]),
    "unknown parameter": ("{random: {scale: 1.0}}", "{leg1.ofset: 1}",
                          ["errors", "leg1.ofset", "leg1.offset"]),
    "no poses": (SCENARIO.splitlines()[2] + "\n", "", ["poses"]),
    "unknown plan": ("poses: {random", "poses: {randm", ["poses", "randm", "random"]),
    "count zero": ("count: 12", "count: 0", ["poses", "count"]),
    "count negative": ("count: 12", "count: -4", ["poses", "count"]),
    "count fraction": ("count: 12", "count: 2.5", ["poses", "count"]),
    "count enormous": ("count: 12", "count: 100000000000", ["poses", "count"]),
    "coordinate": ("half_range: {x: 60", "half_range: {z: 60", ["half_range", "z"]),
    "sigma negative": ("position: 0.01", "position: -1", ["sigma.position"]),
    "unreachable": (SCENARIO.splitlines()[2],
                    "poses: {grid: {center: {x: 9.0e+6, y: 0, rz: 0}, half_range: {x: 1}, "
                    "counts: {x: 3}}}", ["poses"]),
    "outliers 3": ("seed: 7", "noise: {outliers: 3}", ["noise.outliers"]),
    "ar 1.5": ("seed: 7", "noise: {ar: 1.5}", ["noise.ar"]),
    "tails": ("seed: 7", "noise: {tails: fat}", ["noise.tails", "normal"]),
    "repeats zero": ("seed: 7", "repeats: 0", ["repeats"]),
    "seed text": ("seed: 7", "seed: lucky", ["seed"]),
    "seed negative": ("seed: 7", "seed: -1", ["seed"]),
    "unknown key": ("seed: 7", "sed: 7", ["sed", "seed"]),
    "pose file absent": (SCENARIO.splitlines()[2], "poses: {file: absent.csv}", ["absent.csv"]),
    "effect unknown": ("seed: 7", "effects: [{kind: backlsh}]", ["effects"]),
    "frame": ("frame: {x: 5,", "frame: {w: 5,", ["frame", "w"]),
    "scale text": ("scale: 1.0", "scale: big", ["scale", "big"]),
}


@pytest.mark.parametrize("what", SCENARIOS)
def test_scenario(files, what):
    old, new, said = SCENARIOS[what]
    replace(files / "s.yaml", old, new)
    refuse(files, SIMULATE, *([] if "absent" in what else ["s.yaml"]), *said)


TARGET_FILES = {
    "only a header": ("x,y,rz\n", ["row"]),
    "text": ("x,y,rz\n500,280,20\n500,abc,20\n", ["y", "abc", "row 2"]),
    "inf": ("x,y,rz\n500,inf,20\n", ["y", "row 1"]),
    "header twice": ("x,x,y,rz\n1,1,2,3\n", ["x", "two columns"]),
    "ragged": ("x,y,rz\n500,280,20,4\n", ["row 1"]),
    "no header": ("500,280,20\n510,270,22\n", ["header"]),
    "semicolons": ("x;y;rz\n500,280,20\n", ["semicolon"]),
}


@pytest.mark.parametrize("what", TARGET_FILES)
@pytest.mark.parametrize("line", [TARGET, INVERSE], ids=["compensate", "inverse"])
def test_targets(files, what, line):
    text, said = TARGET_FILES[what]
    (files / "t.csv").write_text(text)
    refuse(files, line, "t.csv", *said)


@pytest.mark.parametrize("line", [TARGET, INVERSE], ids=["compensate", "inverse"])
@pytest.mark.parametrize("header", ["x,y", "x,y,rzz", "x,y,rz,quat_x"])
def test_target_columns(files, line, header):
    """A column that is missing or misspelt is named; rows may be refused one by one for it."""
    (files / "t.csv").write_text(f"{header}\n{'500,280,20,0'[:3 * len(header.split(',')) + 1]}\n"
                                 .replace(",\n", "\n"))
    run = ppmcal(*line, cwd=files)
    assert run.code in (1, 2), run.out + run.err
    assert ("quat_x" if "quat" in header else "rz") in run.out + run.err


@pytest.mark.parametrize(("text", "said"), [
    ("q_leg1,q_leg2\n400,400\n", "q_leg3"), ("q_leg1,q_leg2,q_leg9\n400,400,1\n", "q_leg3"),
    ("x,y,rz\n1,2,3\n", "q_leg1")])
def test_joint_tables(files, text, said):
    (files / "t.csv").write_text(text)
    refuse(files, FORWARD, "t.csv", said)


def test_velocity_without_velocities(files):
    refuse(files, ["kinematics", "velocity", "m.yaml", "t.csv", "--out", "o"], "t.csv", "vx")


@pytest.mark.parametrize("values", ["1e300,280,20", "1e12,-1e12,20", "500,280,1e18"])
def test_enormous_targets_are_refused_row_by_row(files, values):
    (files / "t.csv").write_text(f"x,y,rz\n{values}\n500,280,20\n")
    for line in (TARGET, INVERSE):
        run = ppmcal(*line, cwd=files)
        assert run.code in (0, 1, 2), run.err
        assert "fault of ppmcal" not in run.err


def test_knowledge_of_another_model(files):
    path = files / "i" / "identification.json"
    path.write_text(path.read_text().replace("leg1.offset", "leg7.offset"))
    refuse(files, TARGET, "identification.json")


def test_model_of_another_machine(files):
    ppmcal("init", "6-UPS", "--out", "h.yaml", cwd=files, expect=0)
    refuse(files, ["identify", "h.yaml", "d.csv", "--out", "o"], "d.csv")


# ---------------------------------------------------------------- where results go


@pytest.mark.parametrize("line", [DATA, SIMULATE, TARGET, INVERSE],
                         ids=["identify", "simulate", "compensate", "kinematics"])
@pytest.mark.parametrize("out", ["blocked", "blocked/sub", "blocked_file_inside"])
def test_output_folder_is_a_file(files, line, out):
    if out == "blocked_file_inside":  # a folder lies where a result is to be written
        first = {"identify": "parameters.csv", "simulate": "truth.json",
                 "compensate": "commands.csv", "kinematics": "kinematics.csv"}[line[0]]
        (files / out / first).mkdir(parents=True)
        (files / out / first / "precious.txt").write_text("a year of work")
    else:
        (files / "blocked").write_text("a file")
    refuse(files, [*line[:-1], out], out)
    leftover = [p.name for p in files.iterdir() if p.name.startswith((".", "tmp"))]
    assert leftover == []


def test_init_into_a_folder_that_is_absent_or_a_folder(files):
    (files / "folder").mkdir()
    refuse(files, ["init", "3-RPR", "--out", "folder"], "folder")


# ---------------------------------------------------------------- mutations

WORDS = ["nan", "-1", "0", "1e308", "null", "[", "}", ": ", "\t", "\x00", "é", "'", '"', "{}", "&a",
         "*a", "!!python/object:os.system", "- ", "#", "%", "..", "inf", "true", "~", ",", ";", "|"]
MUTATED = ["m.yaml", "d.csv", "d.yaml", "s.yaml", "t.csv", "i/identified.yaml",
           "i/identification.json"]


def mutate(data, chance):
    """Change some bytes, words or lines of a file."""
    for _ in range(chance.choice([1, 1, 1, 2, 4])):
        lines = data.split(b"\n")
        k = chance.randrange(len(lines))
        how = chance.randrange(8)
        if how == 0:
            del lines[k]
        elif how == 1:
            lines.insert(k, lines[chance.randrange(len(lines))])
        elif how == 2:
            other = chance.randrange(len(lines))
            lines[k], lines[other] = lines[other], lines[k]
        elif how == 3:
            lines = [*lines[:k], lines[k][:chance.randrange(len(lines[k]) + 1)]]
        elif how == 4:
            lines[k] = b" " * chance.randrange(4) + lines[k]
        else:
            line = bytearray(lines[k])
            at = chance.randrange(len(line) + 1)
            if how == 5 and line:
                line[min(at, len(line) - 1)] = chance.randrange(256)
            elif how == 6:
                line[at:at + chance.randrange(6)] = chance.choice(WORDS).encode()
            else:
                line[at:at] = str(chance.choice([-1, 0, 7, 9e9, 1e-9])).encode()
            lines[k] = bytes(line)
        data = b"\n".join(lines)
    return data


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))    # `make fuzz` goes on
def test_mutated_files_never_crash_a_command(good, tmp_path, seed):
    chance = random.Random(seed)
    name = MUTATED[seed % len(MUTATED)]
    folder = shutil.copytree(good, tmp_path / "c")
    path = Path(folder) / name
    path.write_bytes(mutate(path.read_bytes(), chance))
    line = {"m": [CHECK, INVERSE], "d": [["check", "m.yaml", "d.csv"]], "s": [SIMULATE],
            "t": [TARGET, INVERSE], "i": [TARGET]}[name[0]]
    before = tree(folder)
    run = ppmcal(*chance.choice(line), cwd=folder)
    text = run.out + run.err
    assert run.code in (0, 1, 2, 3), text
    assert "fault of ppmcal" not in text, text
    assert "Traceback" not in text
    assert run.err.count("Error:") <= 1
    if run.code == 2:
        assert run.err.count("Error:") == 1
        assert tree(folder) == before


# ---------------------------------------------------------------- earlier results, edited

DEEP = "[" * 100_000
COMPENSATE = [*TARGET, "--frame", "base"]
COMPARE = ["compare", "i", "j", "--out", "o"]
KEEP = ["identify", "m.yaml", "e.csv", "--start", "i", "--keep", "--out", "o"]
# (place, JSON text, command)
EDITED = [
    ("", DEEP, COMPENSATE), ("", "[]", COMPENSATE), ("", "{}", KEEP),
    ("measured_volume.x.0", "1" + "0" * 400, COMPENSATE),
    ("measured_volume.x.0", "NaN", COMPARE), ("measured_volume.x", "[9, 3]", COMPARE),
    ("measured_volume.x", "[1, 2, 3]", COMPENSATE), ("measured_volume", "[]", COMPENSATE),
    ("covariance.data.matrix", "1" + "0" * 400, COMPARE),
    ("covariance.data.matrix.0.0", "1e308", COMPARE),
    ("covariance.data.matrix.0.0", "null", KEEP), ("covariance.data.right", '["a"]', KEEP),
    ("covariance.data.unit_of_parameters.0", "0", KEEP), ("covariance.inflation", "null", KEEP),
    ("covariance.session.matrix.0.0", "null", COMPARE), ("covariance.session.noise", "-1", COMPARE),
    ("covariance.session.names.0", '"homing.leg9 of session"', COMPARE),
    ("covariance.session.rows.0.rest.0", "[1]", COMPARE),
    ("covariance.session.unit_of_columns.0", "0", COMPARE),
    ("covariance.prior.0", "-1", KEEP), ("covariance.names.0", "3", COMPENSATE),
    ("covariance.names.0", '"leg9.offset"', COMPARE), ("covariance.matrix", "[[]]", COMPENSATE),
    ("covariance.frames_turn_about", "null", COMPENSATE), ("units.length", '"ell"', COMPENSATE),
    ("datasets.0.registration_before.target.0", "1" + "0" * 400, COMPENSATE),
    ("datasets", "null", COMPENSATE), ("parameters.0.value", "1e29", COMPARE),
    ("parameters.0.value", "true", KEEP), ("provenance.inputs", "[]", KEEP),
    ("format", '"ppmcal/identification/9"', COMPARE)]


@pytest.mark.slow
@pytest.mark.parametrize(("place", "text", "args"), EDITED,
                         ids=[f"{p or 'all'} {t[:9]} {a[0]}" for p, t, a in EDITED])
def test_an_edited_identification_is_refused(files, place, text, args):
    """No number in it is so odd that a command would fail on it, or take it."""
    path = files / "i" / "identification.json"
    shutil.copytree(files / "i", files / "j")
    if args is KEEP:
        ppmcal("simulate", "m.yaml", "s.yaml", "--seed", 8, "--out", "r", cwd=files, expect=0)
        for end in ("csv", "yaml"):
            shutil.copy(files / "r" / f"measurements.{end}", files / f"e.{end}")
    if place:
        tree_ = part = json.loads(path.read_text())
        *way, last = [int(k) if k.isdigit() else k for k in place.split(".")]
        for key in way:
            part = part[key]
        part[last] = "HERE"
        text = json.dumps(tree_).replace('"HERE"', text)
    path.write_text(text)
    refuse(files, args, "identification.json")


@pytest.mark.parametrize("value", ["nan", "inf", "-1"])
def test_an_odd_damping_is_refused(files, value):
    refuse(files, [*DATA, "--method", "damped", "--damping", value], "--damping")


@pytest.mark.parametrize("args", [
    ("plan", "m.yaml", "--count", "1e9"), ("plan", "m.yaml", "--count", "1000000000"),
    ("sensitivity", "m.yaml", "--grid", "x=400:600:1000000000,y"),
    ("workspace", "m.yaml", "--grid", "x=400:600:1e9"),
    ("tolerances", "m.yaml", "--accuracy", "1", "--machines", "1000000000")])
def test_an_absurd_count_is_refused_before_any_work(files, args):
    refuse(files, [*args, "--out", "o"], args[-2])


@pytest.mark.parametrize(("kind", "hint"), [
    ("laser", "Allowed: pose, position"), ("encoder", "Write 'joint' for it")])
def test_an_unknown_kind_of_instrument_is_refused_before_what_kinds_need(kind, hint):
    """A frame and a target are asked for by those that have them."""
    content = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
               "instrument": {"kind": kind, "sigma": {"actuator": 0.5}}}
    with pytest.raises(BadInput, match=f"unknown instrument kind '{kind}'") as found:
        check(SidecarFile, content, "a.yaml")
    assert found.value.where == "a.yaml: instrument.kind" and hint in found.value.hint
