"""Every broken measurement, sidecar, pose and scenario file is refused; one edit each."""


import pytest
from helpers.broken import GOOD, edited

from ppmcal.errors import BadInput
from ppmcal.io import (
    read_campaign,
    read_dataset,
    read_joints,
    read_mechanism,
    read_poses,
    read_scenario,
)

BENCH = read_mechanism(GOOD / "good_bench.yaml")
CSV, SIDE = "good_run.csv", "good_run.yaml"
HEADER = "pose,q_leg1,q_leg2,q_leg3,x,y,rz,dir_leg1,dir_leg2,dir_leg3,temperature,time,session"

# (name, file to edit, text to replace, its replacement, place, what the message must say)
BROKEN = [
    ("not a number", CSV, "450.1,460.2,470.3,500.1", "450.1,460.2,470.3,abc",
     "run.csv: row 1, column x", "'abc' is not a number"),
    ("decimal comma", CSV, "1,450.1,460.2,470.3,500.1", '1,450.1,460.2,470.3,"500,1"',
     "row 1, column x", "decimal point"),
    ("decimal commas all over", CSV, "3,440,441,442,480,250,",
     "3,440,0,441,0,442,0,480,0,250,0", "row 4", "decimal commas"),
    ("underscore", CSV, "455.5", "4_55.5", "row 3, column q_leg1", "not a number"),
    ("infinite", CSV, "510.5", "inf", "row 3, column x", "infinite"),
    ("ragged", CSV, "3,440,441,442", "3,440,441", "row 4", "12 cells"),
    ("unknown column", CSV, "temperature", "temprature", "header", "'temperature'"),
    ("unknown actuator", CSV, "dir_leg3", "dir_leg7", "header", "leg1"),
    ("column twice", CSV, "temperature", "time", "header", "'time'"),
    ("column without name", CSV, "temperature", "", "header", "column 11"),
    ("no joint column", CSV, "q_leg2", "temperature_b", "header", "q_leg2"),
    ("no x", CSV, ",x,", ",temperature_b,", "header", "there is no column x"),
    ("no rotation", CSV, ",rz,", ",temperature_b,", "header", "kind: position"),
    ("odd direction", CSV, "25.3,1,1,-1", "25.3,1,1,-2", "row 1, column dir_leg3", "1, -1"),
    ("header twice", CSV, HEADER, HEADER + "\n" + HEADER, "row 1, column q_leg1",
     "not a number"),
    ("no header", CSV, HEADER + "\n", "", "header", "header line"),
    ("semicolons", CSV, HEADER, HEADER.replace(",", ";"), "header", "commas between columns"),
    ("tabs", CSV, HEADER, HEADER.replace(",", "\t"), "header", "tabs"),
    ("open quote", CSV, "monday\n2", '"monday\n2', "run.csv: row 2", "quotes"),
    ("no format", SIDE, "format: ppmcal/dataset/1\n", "", "run.yaml", "format: ppmcal/dataset/1"),
    ("no units", SIDE, "units: {length: mm, angle: deg}\n", "", "run.yaml", "units"),
    ("no instrument", SIDE, "instrument:", "name2:", "run.yaml", "name2"),
    ("no frame", SIDE, "frame: unknown\n", "", "run.yaml", "frame: unknown"),
    ("no target", SIDE, "target: unknown\n", "", "run.yaml", "target: unknown"),
    ("odd instrument", SIDE, "kind: pose", "kind: poses", "instrument.kind", "'pose'"),
    ("no sigma", SIDE, "position: 0.01, ", "", "instrument.sigma", "position: 0.01"),
    ("no rotation sigma", SIDE, "rotation: 0.002, ", "", "instrument.sigma", "rotation"),
    ("sigma 0", SIDE, "position: 0.01", "position: 0", "instrument.sigma.position",
     "greater than 0"),
    ("negative drives", SIDE, "actuator: 0.003", "actuator: -1", "instrument.sigma.actuator",
     "0 or more"),
    ("drive of nobody", SIDE, "actuator: 0.003", "actuator: {leg8: 1}",
     "instrument.sigma.actuator", "leg1"),
    ("odd frame word", SIDE, "frame: unknown", "frame: unknwon", "frame", "'unknown'"),
    ("frame incomplete", SIDE, "frame: unknown", "frame: {x: 1, y: 2}", "frame", "'rz'"),
    ("odd same_as", SIDE, "frame: unknown", "frame: {same_as: [a]}", "frame", "same_as"),
    ("target of 4", SIDE, "target: unknown\n", "target: [1, 2, 3, 4]\n", "target",
     "2 or 3 numbers"),
    ("target rotation", SIDE, "target_rotation: known", "target_rotation: [1, 2]",
     "target_rotation", "[rx, ry, rz]"),
    ("target with a huge whole number", SIDE, "target: unknown\n",
     "target: [100000000000000000000, 0]\n", "target", "2 or 3 numbers"),
    ("target rotation beyond reason", SIDE, "target_rotation: known",
     "target_rotation: [0, 0, 1e300]", "target_rotation", "[rx, ry, rz]"),
    ("drives beyond reason", SIDE, "actuator: 0.003", "actuator: 1e300",
     "instrument.sigma.actuator", "0 or more"),
    ("odd approach", SIDE, "approach: columns", "approach: column", "approach", "'columns'"),
    ("unknown key", SIDE, "approach: columns", "aproach: columns", "run.yaml", "'approach'"),
    ("plane without height", SIDE, "kind: pose", "kind: plane", "header", "height"),
    ("distance without", SIDE, "kind: pose", "kind: distance", "header", "distance"),
    ("key twice", SIDE, "target: unknown\n", "target: unknown\ntarget: known\n", "run.yaml:7",
     "twice"),
]


def build(folder, file, old, new):
    for name in (CSV, SIDE):
        edited(folder, name, *([(old, new)] if name == file else []))
    return folder / "run.csv"


@pytest.mark.parametrize(("file", "old", "new", "place", "says"),
                         [pytest.param(*case[1:], id=case[0]) for case in BROKEN])
def test_refused(tmp_path, file, old, new, place, says):
    with pytest.raises(BadInput) as caught:
        read_dataset(build(tmp_path, file, old, new), BENCH)
    message = str(caught.value)
    assert "run.csv" in message or "run.yaml" in message
    assert place in message
    assert says in message
    assert caught.value.hint


@pytest.mark.parametrize(("content", "says"), [
    (b"", "empty"), (b"\n\n\n", "empty"), (b"\xef\xbb\xbf", "empty"),
    (b"PK\x03\x04\x00\x00", "cannot be read as a spreadsheet"), (HEADER.encode(), "no rows"),
    (HEADER.encode() + b"\r\n\r\n", "no rows"), (HEADER.encode() + b"\n  \n", "no rows"),
    (HEADER.encode("utf-16"), "UTF-16"), (b"a,b\n\xe4,\xf6\n", "UTF-8"),
    (b"x,y\n1,2\n1,2,3\n4\n", "3 cells"), (b"x\ny\nz", "'y' is not a number")])
def test_not_a_table_at_all(tmp_path, content, says):
    path = build(tmp_path, "", "", "")
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"run\.csv") as caught:
        read_dataset(path, BENCH)
    assert says in str(caught.value)
    assert caught.value.hint


def test_missing_sidecar_shows_one(tmp_path):
    path = build(tmp_path, "", "", "")
    (tmp_path / "run.yaml").unlink()
    with pytest.raises(BadInput, match=r"(?s)run\.yaml.*format: ppmcal/dataset/1"):
        read_dataset(path, BENCH)


@pytest.mark.parametrize("suffix", [".yaml", ".yml"])
def test_same_as_names_the_file_that_says_it(tmp_path, suffix):
    for name, frame in (("a", "{same_as: b}"), ("b", "{same_as: nobody}")):
        (tmp_path / f"{name}.csv").write_text((GOOD / CSV).read_text())
        (tmp_path / f"{name}{suffix}").write_text((GOOD / SIDE).read_text().replace(
            "run 3", name).replace("frame: unknown", f"frame: {frame}"))
    with pytest.raises(BadInput, match=rf"b\{suffix}: frame.same_as: unknown data set 'nobody'"):
        read_campaign([tmp_path / "a.csv", tmp_path / "b.csv"], BENCH)


@pytest.mark.parametrize("column", ["q_leg2", "x", "rz"])
def test_an_empty_column_is_refused(tmp_path, column):
    lines = [line.split(",") for line in (GOOD / CSV).read_text().splitlines()]
    for line in lines[1:]:
        line[lines[0].index(column)] = ""
    path = build(tmp_path, "", "", "")
    path.write_text("\n".join(",".join(line) for line in lines))
    with pytest.raises(BadInput, match=rf"column {column}: all values .* missing"):
        read_dataset(path, BENCH)


def campaign(tmp_path, *frames):
    paths = []
    for i, frame in enumerate(frames):
        folder = tmp_path / str(i)
        folder.mkdir()
        path = build(folder, SIDE, "frame: unknown", f"frame: {frame}")
        side = path.with_suffix(".yaml")
        side.write_text(side.read_text().replace("run 3", f"run{i}"))
        paths.append(path)
    return paths


def test_campaign_refusals(tmp_path):
    path = build(tmp_path, "", "", "")
    with pytest.raises(BadInput, match="called 'run 3'"):
        read_campaign([path, path], BENCH)
    with pytest.raises(BadInput, match=r"same_as.*run1"):
        read_campaign(campaign(tmp_path, "{same_as: run7}", "unknown"), BENCH)
    (tmp_path / "b").mkdir()
    with pytest.raises(BadInput, match="circle"):
        read_campaign(campaign(tmp_path / "b", "{same_as: run1}", "{same_as: run0}"), BENCH)


SCENARIOS = [
    ("no poses", "poses: {circle", "pose: {circle", "scenario.yaml", "'poses'"),
    ("odd shape", "{circle:", "{circel:", "poses", "'circle'"),
    ("two shapes", "swing: {rz: 5}}}", "swing: {rz: 5}}, file: a.csv}", "poses", "exactly one"),
    ("no count", ", count: 30", "", "poses.circle", "count: 30"),
    ("count 0", "count: 30", "count: 0", "poses.circle.count", "from 1 to 10 million"),
    ("radius", "radius: 80", "radius: -80", "poses.circle.radius", "greater than 0"),
    ("center", "y: 290, ", "", "poses.circle.center", "3 freedoms"),
    ("center z", "y: 290, ", "y: 290, z: 3, ", "poses.circle.center", "'z'"),
    ("parameter", "leg2.offset", "leg2.ofset", "errors", "'leg2.offset'"),
    ("error value", "leg2.offset: -0.3", "leg2.offset: much", "errors.leg2.offset", "number"),
    ("random", "{leg1.base.point.x: 0.5, leg2.offset: -0.3}", "{random: 1}", "errors.random",
     "scale"),
    ("effects", "effects: []", "effects: [{kind: lagg}]", "effects[1].kind", "mean 'lag'"),
    ("frame", "frame: {x: 5, y: -3, rz: 1}", "frame: unknown", "frame", "true value"),
    ("tails", "tails: normal", "tails: heavy", "noise.tails", "t4"),
    ("ar", "ar: 0.0", "ar: 1.0", "noise.ar", "between"),
    ("outliers", "outliers: 0.0", "outliers: 5", "noise.outliers", "fraction"),
    ("repeats", "repeats: 1", "repeats: none", "repeats", "whole number"),
    ("approach", "approach: both", "approach: columns", "approach", "sequence"),
    ("payload", "[0, 20]", "[0, -20]", "conditions.payload", "kg"),
    ("temperature", "mean: 20", "mid: 20", "conditions.temperature", "mean, swing"),
    ("seed", "seed: 7", "seed: -7", "seed",
     "-7 is not a seed. Write a whole number from 0 to 9007199254740992."),
    ("file", "{circle: {center: {x: 500, y: 290, rz: 10}, radius: 80, count: 30, "
     "swing: {rz: 5}}}", "{file: no.csv}", "no.csv", "no such file"),
    ("helix", "{circle: {center: {x: 500, y: 290, rz: 10}, radius: 80, count: 30, "
     "swing: {rz: 5}}}", "{helix: {center: {x: 500, y: 290, rz: 10}, diameter: 8, pitch: 1, "
     "turns: 2, count: 30}}", "poses.helix", "circle"),
]


@pytest.mark.parametrize(("old", "new", "place", "says"),
                         [pytest.param(*case[1:], id=case[0]) for case in SCENARIOS])
def test_scenario_refused(tmp_path, old, new, place, says):
    path = edited(tmp_path, "good_scenario.yaml", (old, new), once=True)
    with pytest.raises(BadInput) as caught:
        read_scenario(path, BENCH)
    assert place in str(caught.value)
    assert says in str(caught.value)
    assert caught.value.hint


@pytest.mark.parametrize(("text", "says"), [
    ("a,b\n1,2\n", "there is no pose column"), ("x,y,z\n1,2,3\n", "no coordinate z"),
    ("x,y,rz\n1,2,abc\n", "row 1, column rz"), ("x,y,rz\n1,2\n", "row 1"),
    ("x;y\n1;2\n", "rz"),
    ("x;y;rz\n1,5;2.5;3\n", "decimal points")])
def test_poses_refused(tmp_path, text, says):
    path = tmp_path / "p.csv"
    path.write_text(text)
    with pytest.raises(BadInput, match=r"p\.csv") as caught:
        read_poses(path, BENCH)
    assert says in str(caught.value)


def test_joints_refused(tmp_path):
    path = tmp_path / "j.csv"
    path.write_text("q_leg1,q_leg2,q_lge3\n1,2,3\n")
    with pytest.raises(BadInput, match=r"q_leg3.*Did you mean 'q_lge3'"):
        read_joints(path, BENCH)
