"""`read`: foreign files become the canonical two; points find their rows, or are refused."""

from __future__ import annotations

import csv
import hashlib
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal as run
from helpers.commands import rows, tree
from helpers.mistakes import SAMPLE
from scipy.spatial.transform import Rotation

import ppmcal
from ppmcal.commands.read.words import understood
from ppmcal.io.csv import Table
from ppmcal.io.foreign import ForeignTable
from ppmcal.model.instruments import POSITION

MACHINE = SAMPLE / "hexapod.yaml"
LEGS = [f"q_leg{i}" for i in range(1, 7)]
COUNT = 12


@pytest.fixture(scope="module")
def measured() -> list[dict[str, str]]:
    with (SAMPLE / "measurements.csv").open(newline="", encoding="utf-8") as file:
        return [{**row, "pose": f"P{i}", "time": str(10.0 * i)}
                for i, row in enumerate(list(csv.DictReader(file))[::4][:COUNT])]


def log(folder: Path, measured: list[dict[str, str]], name: str = "log.csv") -> Path:
    """Write a joint log as a spreadsheet in Germany does, with a remark."""
    lines = ["Pose;" + ";".join(f"{q} [mm]" for q in LEGS) + ";Time (s);remark"]
    for row in measured:
        cells = [row["pose"], *(row[q] for q in LEGS), row["time"]]
        lines.append(";".join(c.replace(".", ",") for c in cells) + ";fine, so far")
    (folder / name).write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode() + b"\r\n")
    return folder / name


LISTS = {
    "tabs": ("", "{n}\t{x}\t{y}\t{z}", "."),
    "tabs, decimal commas": ("", "{n}\t{x}\t{y}\t{z}", ","),
    "commas": ("", "{n}, {x}, {y}, {z}", "."),
    "commas, one more": ("", "{n},{x},{y},{z},", "."),
    "semicolons": ("", "{n};{x};{y};{z};{t}", ","),
    "spaces": ("", "{n}   {x} {y}   {z}", "."),
    "spaces, decimal commas": ("", "{n} {x} {y} {z} {t}", ","),
    "groups": ("", "A,Tracker,{n},{x},{y},{z}", "."),
    "path of a point": ("", "A::Tracker::{n} {x} {y} {z}", "."),
    "a header": ("Point Name,X [mm],Y [mm],Z [mm],Rms", "{n},{x},{y},{z},0.01", "."),
    "a header, spaces": ("Name X Y Z", "{n} {x} {y} {z}", "."),
    "remarks": ("// exported\n# Units: mm\n\nname;x;y;z", "{n};{x};{y};{z}", ",")}


def points(folder: Path, measured: list[dict[str, str]], form: str = "tabs",
           shift: float = 0.0) -> Path:
    header, line, mark = LISTS[form]
    lines = [header] * bool(header)
    for row in reversed(measured):    # the order of a list tells nothing
        cells = {c: row[c].replace(".", mark) for c in "xyz"}
        time = str(float(row["time"]) + shift).replace(".", mark)
        lines.append(line.format(n=row["pose"], t=time, **cells))
    (folder / "points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "points.txt"


@pytest.mark.parametrize("form", LISTS)
def test_lists_of_points_join_a_log_by_name(tmp_path: Path, measured: list[dict[str, str]],
                                            form: str) -> None:
    """Whatever separates them, the numbers are those of the sample to the last bit."""
    log(tmp_path, measured)
    points(tmp_path, measured, form)
    done = run("read", "log.csv", "points.txt", "--mechanism", MACHINE, cwd=tmp_path, expect=1)
    said = " ".join(done.out.split())
    assert "separated by semicolons, decimal commas" in said
    assert "Ignored: remark" in said and "Joined by name: 12 rows" in said
    assert ("separated by spaces" in said) == ("spaces" in form or form == "path of a point")
    assert ("Units: mm" in said) == (form == "remarks")
    found = rows(tmp_path / "run.csv")
    assert [r["pose"] for r in found] == [r["pose"] for r in measured]
    for name in (*LEGS, "x", "y", "z"):
        assert [float(r[name]) for r in found] == [float(r[name]) for r in measured]
    (data,) = ppmcal.read_data(MACHINE, tmp_path / "run.csv")
    assert data.kind is POSITION and data.estimated and len(data) == COUNT


def test_points_are_joined_by_time(tmp_path: Path, measured: list[dict[str, str]]) -> None:
    named = [{**row, "pose": f"T{i}"} for i, row in enumerate(measured)]
    files = [log(tmp_path, measured), points(tmp_path, named, "semicolons", 0.2)]
    result = ppmcal.read(files, MACHINE)
    np.testing.assert_array_equal(result.table.numbers["x"], [float(r["x"]) for r in measured])
    np.testing.assert_array_equal(result.table.numbers["time"], 10.0 * np.arange(COUNT))
    with pytest.raises(ppmcal.BadInput, match=r"points\.txt: rows 1, 2, 3.*\+7 more.*0\.1 s"):
        ppmcal.read(files, MACHINE, tolerance=0.1)
    few = points(tmp_path, named[:5], "semicolons", 0.2)
    assert len(ppmcal.read([files[0], few], MACHINE).table) == 5


@pytest.mark.parametrize(("change", "words"), [
    (lambda m: m[:-1], r"log\.csv: row 12 \(P11\): nothing in .*points\.txt"),
    (lambda m: [*m, {**m[0], "pose": "P99"}], r"points\.txt: row 1 \(P99\): nothing in"),
    (lambda m: [{**r, "pose": "P"} for r in m], "matches"),
])
def test_what_matches_nothing_is_refused_with_its_rows(tmp_path: Path, change, words,
                                                       measured) -> None:
    files = [log(tmp_path, measured), points(tmp_path, change(measured))]
    with pytest.raises(ppmcal.BadInput, match=words):
        ppmcal.read(files, MACHINE, join="name")


def test_with_partial_it_is_left_out_and_named(tmp_path: Path, measured) -> None:
    changed = [{**measured[0], "pose": "P99"}, *measured[1:]]
    files = [log(tmp_path, measured), points(tmp_path, changed)]
    result = ppmcal.read(files, MACHINE, partial=True)
    assert len(result.table) == COUNT - 1
    assert any("P99" in f and "left out" in f for f in result.findings)
    assert any("row 1 (P0)" in f for f in result.findings)


def test_several_rows_for_a_point_are_ambiguous(tmp_path: Path, measured) -> None:
    double = [measured[0], *measured]
    files = [log(tmp_path, double), points(tmp_path, measured)]
    with pytest.raises(ppmcal.BadInput, match=r"'P0' belongs to several rows .*rows 1, 2"):
        ppmcal.read(files, MACHINE)
    with pytest.raises(ppmcal.BadInput, match="equally near"):
        ppmcal.read([files[0], points(tmp_path, measured, "semicolons")], MACHINE, join="time")
    twice = points(tmp_path, double)
    assert len(ppmcal.read([log(tmp_path, measured), twice], MACHINE).table) == COUNT + 1


@pytest.mark.parametrize(("text", "words"), [
    ("1.5 2.5 3.5\n", "no name and 3 numbers"), ("P1,1,5,2,5,3,5\n", "1 name and 6 numbers"),
    ("Point 1 1.5 2.5 3.5\nPoint 2 1.5 2.5 3.5\n", "spaces"),
    ("// nothing\n", "nothing but remarks"),
    ("name,x [yard],y,z\nP0,1,2,3\n", "unknown unit 'yard'"), ("P0\t1\t2\t3\nP1\t1\t2\n", "row 2"),
    ("P0\t1\t2\t3\nP1\t1\tabc\t3\n", "row 2, column y"), ("P0;1,5;2.5;3\n", "decimal"),
    ("name,a,b\nP0,1,2\n", "there is no column x|no row has both")])
def test_bad_lists_are_refused(tmp_path: Path, measured, text: str, words: str) -> None:
    (tmp_path / "points.txt").write_text(text)
    with pytest.raises(ppmcal.BadInput, match=words):
        ppmcal.read([log(tmp_path, measured), tmp_path / "points.txt"], MACHINE, partial=True)


@pytest.mark.parametrize("rotation", ["euler-ZYX", "matrix"])
def test_rotations_are_as_the_sidecar_declares(tmp_path: Path, measured, rotation: str) -> None:
    turns = Rotation.from_rotvec([[float(r[c]) for c in ("rx", "ry", "rz")] for r in measured],
                                 degrees=True)
    cells = (turns.as_euler("ZYX", degrees=True) if rotation != "matrix"
             else turns.as_matrix().reshape(-1, 9))
    names = (["A", "B", "C"] if rotation != "matrix"
             else [f"r{i}{j}" for i in "123" for j in "123"])
    lines = [";".join([*LEGS, "x", "y", "z", *names])]
    lines += [";".join([*(r[q] for q in LEGS), r["x"], r["y"], r["z"], *map(repr, c.tolist())])
              for r, c in zip(measured, cells, strict=True)]
    (tmp_path / "robot.csv").write_text("\n".join(lines).replace(".", ",") + "\n")
    columns = dict(zip(("rx", "ry", "rz"), names, strict=False)) if rotation != "matrix" else {}
    (tmp_path / "side.yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.002}},
        "frame": "unknown", "target": "unknown",
        "read": {"rotation": rotation, "columns": columns}}))
    run("read", "robot.csv", "--mechanism", MACHINE, "--sidecar", "side.yaml", "--out", "o/a.csv",
        cwd=tmp_path, expect=0)
    (data,) = ppmcal.read_data(MACHINE, tmp_path / "o" / "a.csv")
    np.testing.assert_allclose(data.rotation, turns.as_rotvec(), atol=1e-12)
    side = yaml.safe_load((tmp_path / "o" / "a.yaml").read_text())
    assert "read" not in side and side["instrument"]["sigma"]["rotation"] == 0.002


def test_units_of_points_without_a_header(tmp_path: Path, measured) -> None:
    metres = [{**r, **{c: repr(float(r[c]) / 1000.0) for c in "xyz"}} for r in measured]
    files = [log(tmp_path, measured), points(tmp_path, metres)]
    x = ppmcal.read(files, MACHINE, units="m").table.numbers["x"]
    np.testing.assert_allclose(x, [float(r["x"]) for r in measured], rtol=1e-12)


def test_a_unit_in_the_header_is_said_to_be_from_there(tmp_path: Path, measured) -> None:
    """--units is of the columns that have none."""
    listed = tmp_path / "points.csv"
    listed.write_text("\n".join(["pose,x (in),y,z", *(
        f"{r['pose']},{float(r['x']) / 25.4!r},{r['y']},{r['z']}" for r in measured)]))
    found = ppmcal.read([log(tmp_path, measured), listed], MACHINE, units="mm")
    np.testing.assert_allclose(found.table.numbers["x"], [float(r["x"]) for r in measured])
    said = found.sentences[1]
    assert "in (header)" in said and "mm (--units)" in said and "in (--units)" not in said


def test_nothing_is_overwritten(tmp_path: Path, measured) -> None:
    log(tmp_path, measured)
    points(tmp_path, measured)
    words = ("read", "log.csv", "points.txt", "--mechanism", MACHINE, "--quiet")
    (tmp_path / "run.yaml").write_text("mine")
    before = tree(tmp_path)
    assert "run.yaml: exists already" in run(*words, cwd=tmp_path, expect=2).err
    for force in ((), ("--force",)):
        refused = run(*words, "--out", "log.csv", *force, cwd=tmp_path, expect=2).err
        assert "is an input of this run" in refused
    assert tree(tmp_path) == before
    run(*words, "--force", cwd=tmp_path, expect=1)
    summary = run(*words[:-1], "--json", "--out", "b.csv", cwd=tmp_path, expect=1).json
    assert summary["rows"] == COUNT and summary["written"] == ["b.csv", "b.yaml"]


def test_the_sidecar_says_what_it_was_made_from(tmp_path: Path, measured) -> None:
    """A line break in a name does not end the comment."""
    name = "lo\ng: {.csv"
    source = log(tmp_path, measured, name)
    points = tmp_path / "points.txt"
    points.write_text("\n".join(f"{r['pose']} {r['x']} {r['y']} {r['z']}" for r in measured))
    found = ppmcal.read([source, points], MACHINE, units="mm", sidecar=None)
    text = str(found.files()["run.yaml"])
    assert f"sha256 {hashlib.sha256(source.read_bytes()).hexdigest()}" in text
    assert f"sha256 {hashlib.sha256(MACHINE.read_bytes()).hexdigest()}" in text
    assert ppmcal.__version__ in text.splitlines()[0]
    assert yaml.safe_load(text) == dict(found.sidecar)


def test_what_is_read_can_be_identified(tmp_path: Path, measured) -> None:
    log(tmp_path, measured)
    points(tmp_path, measured)
    run("read", "log.csv", "points.txt", "--mechanism", MACHINE, cwd=tmp_path, expect=1)
    assert run("check", MACHINE, "run.csv", cwd=tmp_path).code in (0, 1)


def test_a_file_without_joints_says_how_to_name_them(tmp_path: Path, measured) -> None:
    with pytest.raises(ppmcal.BadInput, match=r"no file holds joint .*q_leg1.*read\.columns"):
        ppmcal.read(points(tmp_path, measured), MACHINE)
    with pytest.raises(ppmcal.BadInput, match="several files hold joint values"):
        ppmcal.read([log(tmp_path, measured), log(tmp_path, measured, "b.csv")], MACHINE)


@pytest.mark.parametrize("mark", [";", "\t", ","])
def test_headers_with_numbers_in_them_are_no_rows(tmp_path: Path, measured, mark: str) -> None:
    """``Leg 1 [mm]``: at its spaces the header has as many numbers as legs."""
    comma = "." if mark == "," else ","
    header = mark.join(["Pose", *(f"Leg {i} [mm]" for i in range(1, 7)), "Point 1 X [mm]",
                        "Point 1 Y [mm]", "Point 1 Z [mm]"])
    lines = [mark.join(row[c].replace(".", comma) for c in ("pose", *LEGS, "x", "y", "z"))
             for row in measured]
    (tmp_path / "run.csv").write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    columns = {f"q_leg{i}": f"Leg {i} [mm]" for i in range(1, 7)}
    columns |= {c: f"Point 1 {c.upper()} [mm]" for c in "xyz"}
    side = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "position", "sigma": {"position": 0.01}}, "frame": "unknown",
            "target": "unknown", "read": {"columns": columns}}
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(side))
    done = run("read", "run.csv", "--mechanism", MACHINE, "--out", "out.csv", cwd=tmp_path,
               expect=0)
    assert f"{COUNT} rows" in done.out
    for got, row in zip(rows(tmp_path / "out.csv"), measured, strict=True):
        assert all(float(got[c]) == float(row[c]) for c in (*LEGS, "x", "y", "z"))


def test_why_an_uncertainty_is_ignored_is_told_whatever_unit_stands_behind_it() -> None:
    ignored = ("u(x) [mm]", "unc y (mm)", "U(z)", "note [a]")
    told = understood(ForeignTable(Table("p.csv", (), {}, {}, 0), {}, ignored, ()),
                      lambda found, name: ("", ""))
    lines = " ".join(told.split())
    assert "Ignored: u(x) [mm], unc y (mm), U(z), note [a]." in lines
    assert "u(x) [mm], unc y (mm), U(z): an uncertainty whose coverage" in lines
