"""Points of several targets on the platform: their names, and the clock that all of them tell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.mistakes import SAMPLE
from scipy.spatial.transform import Rotation

import ppmcal
from ppmcal import algebra as cga
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.io.column_names import own_name
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses

MACHINE = ppmcal.load(SAMPLE / "hexapod.yaml")
LEGS = [f"leg{i}" for i in range(1, 7)]
PLACES = {"T1": [80.0, 0.0, 10.0], "T2": [-40.0, 70.0, 15.0], "T3": [-40.0, -70.0, 5.0]}
"""Where the targets are on the platform, mm."""
POSES = 12
Q = np.array([[float(c) for c in row.split(",")[1:7]] for row in
              (SAMPLE / "measurements.csv").read_text().splitlines()[1:4 * POSES:4]])
TURN, SHIFT = Rotation.from_rotvec([0.3, -0.2, 1.0]), np.array([500.0, 20.0, -9.0])


def seen(q: np.ndarray, place: Sequence[float]) -> np.ndarray:
    """Return a target (N, 3), mm, as the tracker sees it."""
    pose = reached_poses(Model(MACHINE), q * 1e-3).pose
    turned = cga.rotation_matrix(pose) @ np.array(place)
    return np.asarray(TURN.apply(1e3 * cga.translation(pose) + turned) + SHIFT)


def log(folder: Path, times: np.ndarray, q: np.ndarray, names: bool = False) -> Path:
    lines = [",".join([*(["pose"] * names), "time", *(f"q_{n}" for n in LEGS)])]
    lines += [",".join([*([f"P{i}"] * names), f"{t:.1f}", *map(repr, row.tolist())])
              for i, (t, row) in enumerate(zip(times, q, strict=True))]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


FORMS = {
    "SpatialAnalyzer": ("Collection::Group::Target,X,Y,Z", "A::P{i}::{t},{x},{y},{z}"),
    "with spaces": ("Collection::Group::Target X Y Z", "A::P{i}::{t} {x} {y} {z}"),
    "commented": ("//Collection::Group::Target, X, Y, Z", "A::P{i}::{t}, {x}, {y}, {z}"),
    "three columns": ("Collection,Group,Target,X,Y,Z", "A,P{i},{t},{x},{y},{z}"),
    "group and point": ("Group::Point Name;X [mm];Y [mm];Z [mm]", "P{i}::{t};{x};{y};{z}"),
    "no heading": ("", "A::P{i}::{t} {x} {y} {z}"),
    "pose and target": ("Pose,Target,X,Y,Z", "P{i},{t},{x},{y},{z}"),
    "target and point": ("Target Name,Point,X,Y,Z", "{t},P{i},{x},{y},{z}")}


def point_list(folder: Path, form: str) -> Path:
    head, line = FORMS[form]
    lines = [head] * bool(head)
    for i, q in enumerate(Q):
        for t, place in PLACES.items():
            x, y, z = map(repr, seen(q[None], place)[0].tolist())
            lines.append(line.format(i=i, t=t, x=x, y=y, z=z))
    (folder / "p.txt").write_text("\n".join(lines) + "\n")
    return folder / "p.txt"


@pytest.mark.parametrize("form", FORMS)
def test_a_group_is_a_pose_and_its_points_are_targets(tmp_path: Path, form: str) -> None:
    files = [log(tmp_path, 10.0 * np.arange(POSES), Q, names=True), point_list(tmp_path, form)]
    result = ppmcal.read(files, MACHINE)
    assert [run.name for run in result.runs] == ["run-T1", "run-T2", "run-T3"]
    assert "3 targets (T1, T2, T3)" in " ".join(result.sentences)
    assert not any("Ignored" in s for s in result.sentences)
    for run, place in zip(result.runs, PLACES.values(), strict=True):
        assert list(run.table.text["pose"]) == [f"P{i}" for i in range(POSES)]
        np.testing.assert_allclose(run.data.position * 1e3, seen(Q, place), atol=1e-9)


def test_points_that_the_log_names_are_one_target(tmp_path: Path) -> None:
    """Then the group says who measured, as it always did."""
    one = log(tmp_path, 10.0 * np.arange(POSES), Q, names=True)
    lines = ["Collection::Group::Target,X,Y,Z", *(f"A::Tracker::P{i},{x},{y},{z}" for i, (x, y, z)
                                                  in enumerate(seen(Q, PLACES["T1"]).tolist()))]
    (tmp_path / "p.txt").write_text("\n".join(lines) + "\n")
    result = ppmcal.read([one, tmp_path / "p.txt"], MACHINE)
    assert len(result.runs) == 1 and len(result.table) == POSES


def test_groups_of_more_points_than_there_are_groups_are_asked_about(tmp_path: Path) -> None:
    """Three reflectors with a point for each pose, or three days of one: times tell neither."""
    one = log(tmp_path, 10.0 * np.arange(POSES), Q)
    lines = ["Group::Target,X,Y,Z,Time"]
    for k, place in enumerate(PLACES.values()):
        lines += [f"G{k}::P{i},{x},{y},{z},{10 * i + 0.1 * k}"
                  for i, (x, y, z) in enumerate(seen(Q, place).tolist())]
    (tmp_path / "p.txt").write_text("\n".join(lines) + "\n")
    files = [one, tmp_path / "p.txt"]
    with pytest.raises(BadInput, match=r"several groups \(G0, G1, G2\).*\{target\}::\{pose\}"):
        ppmcal.read(files, MACHINE)
    assert len(ppmcal.read(files, MACHINE, names="{target}::{pose}").runs) == 3
    days = [lines[0], *lines[1:POSES + 1], *(
        f"G3{line[2:].rpartition(',')[0]},{10 * i + 0.2}"
        for i, line in enumerate(lines[1:POSES + 1]))]
    (tmp_path / "p.txt").write_text("\n".join(days) + "\n")
    (run,) = ppmcal.read(files, MACHINE, names="{pose}", partial=True, interpolate=True,
                         tolerance=20.0).runs
    assert run.name == "run"


def test_only_headings_of_parts_of_a_name_are_one() -> None:
    assert own_name("Collection::Object::Target", ["pose"]) == (None, "")
    assert own_name("Group:: Point_Name", ["pose"])[0] == "pose"


def test_one_name_in_all_rows_is_no_target(tmp_path: Path) -> None:
    """A reflector's name beside each point's makes no file of its own."""
    one = log(tmp_path, 10.0 * np.arange(POSES), Q, names=True)
    lines = ["Name,Target,X,Y,Z", *(f"P{i},SMR,{x},{y},{z}" for i, (x, y, z)
                                    in enumerate(seen(Q, PLACES["T1"]).tolist()))]
    (tmp_path / "p.txt").write_text("\n".join(lines) + "\n")
    result = ppmcal.read([one, tmp_path / "p.txt"], MACHINE)
    assert [run.name for run in result.runs] == ["run"]


AHEAD = 7.3


def moving(folder: Path, form: str, count: int = 90) -> list[Path]:
    """Write a log at 5 Hz of a machine that goes from pose to pose, and targets seen in turn."""
    times = np.arange(0.0, 240.0, 0.2)
    q = np.stack([np.interp(times, np.arange(POSES) * 20.0, c) for c in Q.T], axis=1)
    seen_at = np.sort(np.random.default_rng(3).uniform(5.0, 215.0, count))
    at = np.stack([np.interp(seen_at, times, c) for c in q.T], axis=1)
    files = {name: ["time,name,x,y,z"] for name in ("p", *PLACES)}
    files["p"] = [{"target": "time,Target,x,y,z", "name": "time,name,x,y,z",
                   "group": "time,Collection::Group::Target,x,y,z"}.get(form, "time,name,x,y,z")]
    for i, (t, row) in enumerate(zip(seen_at, at, strict=True)):
        name = list(PLACES)[i % 3]
        called = {"group": f"A::M{i // 3}::{name}", "file": f"M{i}"}.get(form, name)
        place = seen(row[None], PLACES[name])[0]
        cells = [repr(float(t + AHEAD)), called, *map(repr, place.tolist())]
        files[name if form == "file" else "p"].append(",".join(cells))
    made = [log(folder, times, q)]
    for name, lines in files.items():
        if len(lines) > 1:
            (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
            made.append(folder / f"{name}.csv")
    return made


@pytest.mark.long
@pytest.mark.parametrize("form", ["name", "file"])    # the others are read above
def test_three_targets_tell_the_offset_of_the_clocks(tmp_path: Path, form: str) -> None:
    result = ppmcal.read(moving(tmp_path, form), MACHINE, interpolate=True, clock_offset="find")
    (found,) = [s for s in result.sentences if "found from the motion" in s]
    assert float(found.split(" s ")[0].split()[-1]) == pytest.approx(AHEAD, abs=0.2)
    assert [run.name for run in result.runs] == ["run-T1", "run-T2", "run-T3"]
    assert sum(len(run.table) for run in result.runs) == 90
    assert all(run.data.frame.same_as == "run T1" for run in result.runs[1:])


@pytest.mark.slow
def test_few_points_tell_it_where_the_targets_places_are_known(tmp_path: Path) -> None:
    """Else it is said how many more there must be."""
    files = moving(tmp_path, "target", 24)
    with pytest.raises(PpmcalError, match=r"24 points do not tell .* measure 53 or more.*read\.t"):
        ppmcal.read(files, MACHINE, interpolate=True, clock_offset="find")
    side = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "position", "sigma": {"position": 0.01}}, "frame": "unknown",
            "target": "unknown", "read": {"targets": PLACES}}
    (tmp_path / "side.yaml").write_text(yaml.safe_dump(side))
    result = ppmcal.read(files, MACHINE, interpolate=True, clock_offset="find",
                         sidecar=tmp_path / "side.yaml")
    assert f"is {AHEAD:.1f}" in " ".join(result.sentences)


@pytest.mark.slow
def test_names_may_tell_the_target_alone(tmp_path: Path) -> None:
    files = moving(tmp_path, "name")
    result = ppmcal.read(files, MACHINE, interpolate=True, clock_offset=AHEAD, names="{target}")
    assert [len(run.table) for run in result.runs] == [30, 30, 30]
    with pytest.raises(PpmcalError, match="where pose and target stand"):
        ppmcal.read(files, MACHINE, names="T{i}")


@pytest.mark.slow
def test_points_that_do_not_follow_are_not_blamed_alone(tmp_path: Path) -> None:
    """What else may be the matter is said: other targets, an offset that is given."""
    files = moving(tmp_path, "name")
    lines = files[1].read_text().splitlines()
    plain = [",".join([*row.split(",")[:1], *row.split(",")[2:]]) for row in lines]
    files[1].write_text("\n".join(plain) + "\n")
    with pytest.raises(BadInput, match=r"one target on the platform .*--names.*--clock-offset S"):
        ppmcal.read(files, MACHINE, interpolate=True, clock_offset="find")
