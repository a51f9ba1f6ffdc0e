"""Files of trackers, ROS and Klipper: the numbers of the canonical file, or a refusal."""

from __future__ import annotations

import csv
import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.mistakes import SAMPLE
from helpers.paths import ROOT
from scipy.spatial.transform import Rotation

import ppmcal
from ppmcal.commands.read.run import ReadResult
from ppmcal.errors import PpmcalError
from ppmcal.model.instruments import POSE

MACHINE = ppmcal.load(SAMPLE / "hexapod.yaml")
LEGS = [f"leg{i}" for i in range(1, 7)]
Row = dict[str, str]
with (SAMPLE / "measurements.csv").open(newline="", encoding="utf-8") as _file:
    ROWS: list[Row] = list(csv.DictReader(_file))[::4][:12]
AXES = np.array([[float(r[a]) for a in "xyz"] for r in ROWS])
Q = np.array([[float(r[f"q_{n}"]) for n in LEGS] for r in ROWS])
START = 1772618400    # 2026-03-04 10:00:00 UTC


def log(path: Path, times: str = "{}") -> Path:
    """Write a joint log; ``times``: made of the row's number."""
    lines = [",".join(["pose", *(f"q_{n}" for n in LEGS), *(["time"] if times else [])])]
    lines += [",".join([f"P{i}", *(r[f"q_{n}"] for n in LEGS), *([times.format(i)] * bool(times))])
              for i, r in enumerate(ROWS)]
    path.write_text("\n".join(lines) + "\n")
    return path


TRACKERS: dict[str, tuple[str, str]] = {
    "SpatialAnalyzer": ("// SA export\n// Units: mm\n//Collection, Group, Point, X, Y, Z\n",
                        "A,Tracker,P{i},{x},{y},{z}"),
    "path of a point": ("// Point  X  Y  Z\n", "A::Tracker::P{i}  {x}  {y}  {z}"),
    "fixed widths": ("Name              X            Y          Z\n",
                     "P{i}      {x}    {y}     {z}"),
    "units beneath": ("Point ID;X;Y;Z;Time\n;[mm];[mm];[mm];\n", "P{i};{x};{y};{z};10:{i:02d}:00"),
    "two lines": (",Position,,\nPoint,X,Y,Z\n", "P{i},{x},{y},{z}"),
    "said by whom": ("Instrument: AT960\nJob,hexapod\n\nPoint Name,X (mm),Y (mm),Z (mm),Rms\n",
                     "P{i},{x},{y},{z},0.01"),
    "measured and nominal": ("Name,Nominal X,Nominal Y,Nominal Z,Actual X,Actual Y,Actual Z,Dev\n",
                             "P{i},0,0,0,{x},{y},{z},1"),
    "coordinates": ("Name\tX Coordinate\tY Coordinate\tZ Coordinate\n", "P{i}\t{x}\t{y}\t{z}"),
    "sigmas": ("Point,X,Y,Z,Std X,Std Y,Std Z\n", "P{i},{x},{y},{z},0.01,0.02,0.03"),
    "expanded": ("Point,X,Y,Z,Ux,Uy,Uz\n", "P{i},{x},{y},{z},0.01,0.02,0.03"),
    "remarks between": ("name,x,y,z\n", "# next\nP{i},{x},{y},{z}\n"),
    "half days, no header": ("", "P{i} {x} {y} {z} 2026-03-04 10:{i:02d}:00 AM"),
    "date and time": ("Name Date Time X Y Z\n", "P{i} 04.03.2026 10:{i:02d}:00 {x} {y} {z}")}


def points(path: Path, form: str) -> Path:
    head, line = TRACKERS[form]
    path.write_text(head + "\n".join(line.format(i=i, **{a: r[a] for a in "xyz"})
                                     for i, r in enumerate(ROWS)) + "\n")
    return path


@pytest.mark.parametrize("form", TRACKERS)
def test_lists_of_trackers(tmp_path: Path, form: str) -> None:
    result = ppmcal.read([log(tmp_path / "log.csv", ""), points(tmp_path / "p.txt", form)], MACHINE)
    for i, a in enumerate("xyz"):
        assert result.table.numbers[a].tobytes() == AXES[:, i].tobytes()
    said = "\n".join(result.sentences)
    assert all(len(line) <= 80 or str(tmp_path) in line for line in said.split("\n"))
    assert ("coverage" in said) == (form == "expanded")
    assert ("mm (a remark)" in said) == (form == "SpatialAnalyzer")
    if form == "sigmas":
        np.testing.assert_allclose(result.data.sigma_position[0], [1e-5, 2e-5, 3e-5])


@pytest.mark.parametrize(("mine", "theirs", "says"), [
    ("{}", "{}.2", "Times are at most 0.2 s apart"),
    (str(START) + ".{0:02d}", "2026-03-04T10:00:00.{:02d}Z", "since 2026-03-04 10:00:00.000 UTC"),
    ("2026-03-04 11:{:02d}:00+01:00", "2026-03-04T10:{:02d}:00Z", "dates and times"),
    ("10:{:02d}:00", "2026-03-04 10:{:02d}:00", "times of day"),
    ("10:{:02d}:00 PM", "2026-03-04 22:{:02d}:00", "since 22:00:00.000")])
def test_clocks_are_brought_together(tmp_path: Path, mine: str, theirs: str, says: str) -> None:
    log(tmp_path / "log.csv", mine)
    lines = [f"T{i},{r['x']},{r['y']},{r['z']},{theirs.format(i)}" for i, r in enumerate(ROWS)]
    (tmp_path / "p.csv").write_text("name,x,y,z,time\n" + "\n".join(reversed(lines)) + "\n")
    tolerance = 0.004 if "{0:02d}" in mine else 0.5
    result = ppmcal.read([tmp_path / "log.csv", tmp_path / "p.csv"], MACHINE, tolerance=tolerance)
    np.testing.assert_array_equal(result.table.numbers["x"], AXES[:, 0])
    assert says in " ".join("\n".join(result.sentences).split())
    assert result.table.numbers["time"][0] == 0.0


def moving(folder: Path, ahead: float, seed: int = 3) -> tuple[Path, Path, np.ndarray]:
    """Write a log at 5 Hz of a machine that goes from pose to pose, and points seen meanwhile."""
    from ppmcal import algebra as cga
    from ppmcal.kinematics.closure import Model
    from ppmcal.kinematics.equilibrium import reached_poses

    times = np.arange(0.0, 240.0, 0.2)
    q = np.stack([np.interp(times, np.arange(12) * 20.0, c) for c in Q.T], axis=1)
    seen_at = np.sort(np.random.default_rng(seed).uniform(5.0, 215.0, 40))
    at = np.stack([np.interp(seen_at, times, c) for c in q.T], axis=1)
    p = cga.translation(reached_poses(Model(MACHINE), at * 1e-3).pose)
    p = Rotation.from_rotvec([0.3, -0.2, 1.0]).apply(p) * 1e3 + [500.0, 20.0, -9.0]
    body = "\n".join(",".join([f"{t:.1f}", *map(repr, row.tolist())])
                     for t, row in zip(times, q, strict=True))
    (folder / "log.csv").write_text(",".join(["time", *(f"q_{n}" for n in LEGS)]) + "\n" + body)
    (folder / "p.csv").write_text("time,x,y,z\n" + "\n".join(
        ",".join(map(repr, [float(t + ahead), *row.tolist()]))
        for t, row in zip(seen_at, p, strict=True)))
    return folder / "log.csv", folder / "p.csv", at


def test_joints_are_interpolated_only_when_asked(tmp_path: Path) -> None:
    one, two, expected = moving(tmp_path, 0.0)
    result = ppmcal.read([one, two], MACHINE, interpolate=True, tolerance=0.2)
    np.testing.assert_allclose([result.table.numbers[f"q_{n}"] for n in LEGS], expected.T,
                               rtol=1e-10)
    assert "interpolated between rows at most 0.2 s apart" in " ".join(result.sentences)
    with pytest.raises(PpmcalError, match=r"on both sides within 0\.05 s"):
        ppmcal.read([one, two], MACHINE, interpolate=True, tolerance=0.05)


CRANKS = dataclasses.replace(ppmcal.load(ROOT / "configs/3-RRR-1.yaml"),
                             limits=np.array([[-np.inf, np.inf]] * 3))


def turning(folder: Path, unit: str, angles: np.ndarray) -> ReadResult:
    """Read a log at 10 Hz of a crank that turns on, and points between its rows."""
    names = CRANKS.actuators
    factor = {"deg": 1.0, "rad": np.pi / 180.0, "counts": 4096.0 / 360.0}[unit]
    times = 0.1 * np.arange(len(angles))
    lines = [",".join(["time", *(f"q_{n}" for n in names)])]
    lines += [",".join(map(repr, [float(t), float(v), 20.0 * factor, 30.0 * factor]))
              for t, v in zip(times, angles * factor, strict=True)]
    (folder / "log.csv").write_text("\n".join(lines))
    (folder / "p.csv").write_text("time,x,y\n" + "\n".join(
        f"{t + 0.05:.2f},{t:.1f},0.5" for t in times[:-1]))
    side = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "position", "sigma": {"position": 0.01}}, "frame": "unknown",
            "target": "unknown", "read": {"units": {"q_*": unit}} | (
                {"counts_per_turn": 4096} if unit == "counts" else {})}
    (folder / "p.yaml").write_text(yaml.safe_dump(side))
    return ppmcal.read([folder / "log.csv", folder / "p.csv"], CRANKS, interpolate=True,
                       tolerance=0.1)


@pytest.mark.parametrize("unit", ["deg", "rad", "counts"])
@pytest.mark.parametrize("from_zero", [False, True])
def test_a_joint_that_turns_over_is_interpolated_the_short_way(tmp_path: Path, unit: str,
                                                               from_zero: bool) -> None:
    true = np.linspace(150.0, 400.0, 26)
    low = 0.0 if from_zero else -180.0
    result = turning(tmp_path, unit, np.mod(true - low, 360.0) + low)
    got = result.table.numbers[f"q_{CRANKS.actuators[0]}"]
    wanted = 0.5 * (true[1:] + true[:-1])
    np.testing.assert_allclose(np.mod(got - wanted + 180.0, 360.0), 180.0, atol=1e-9)
    assert got.min() >= low and got.max() <= low + 360.0
    assert "move by up to" in " ".join(result.sentences)
    share = float(re.search(r"up to ([\d.]+) % of their range", result.sentences[-1])[1])
    assert share < 10.0    # 10 deg of 250


def test_a_joint_that_counts_turns_or_cannot_turn_over_is_left_alone(tmp_path: Path) -> None:
    true = np.linspace(-300.0, 300.0, 4)    # 200 deg a row, and more than a turn in all
    got = turning(tmp_path, "deg", true).table.numbers[f"q_{CRANKS.actuators[0]}"]
    np.testing.assert_allclose(got, 0.5 * (true[1:] + true[:-1]), atol=1e-9)


@pytest.mark.parametrize(("readings", "wanted"), [
    ([-10.0, 60.0, 190.0, 200.0], [25.0, 125.0, 195.0]),
    ([300.0, 390.0, 410.0, 500.0], [345.0, 400.0, 455.0]),
    ([-200.0, -190.0, -100.0, 20.0], [-195.0, -145.0, -40.0]),
    ([70.0, 89.0, -262.0, -269.0], [79.5, -266.5, -265.5])])
def test_joints_stay_in_the_turn_that_the_log_keeps_to(tmp_path: Path, readings: list[float],
                                                       wanted: list[float]) -> None:
    """It need not be that from -180 or from 0 deg on."""
    got = turning(tmp_path, "deg", np.array(readings)).table.numbers[f"q_{CRANKS.actuators[0]}"]
    np.testing.assert_allclose(got, wanted, atol=1e-9)


@pytest.mark.parametrize(("low", "high", "jumps"), [
    (-np.inf, np.inf, True), (-120.0, 120.0, False), (-200.0, -80.0, True), (-80.0, 40.0, True),
    (-200.0, 100.0, True), (170.0, 400.0, True), (190.0, 500.0, False), (-180.0, 180.0, True)])
def test_limits_tell_whether_readings_may_jump(low: float, high: float, jumps: bool) -> None:
    from ppmcal.commands.read.join import _may_jump

    assert _may_jump(np.radians(low), np.radians(high)) == jumps


@pytest.mark.parametrize("ahead", [0.0, 7.3, -1e6])
@pytest.mark.slow
def test_the_offset_of_two_clocks_is_found_with_how_surely(tmp_path: Path, ahead: float) -> None:
    one, two, expected = moving(tmp_path, ahead)
    result = ppmcal.read([one, two], MACHINE, interpolate=True, clock_offset="find")
    q = np.stack([result.table.numbers[f"q_{n}"] for n in LEGS], axis=1)
    assert np.abs(q - expected).max() < 0.05 * np.ptp(Q)
    assert "found from the motion" in result.sentences[-2]
    given = ppmcal.read([one, two], MACHINE, interpolate=True, clock_offset=ahead)
    np.testing.assert_allclose(given.table.numbers["q_leg1"], expected[:, 0], rtol=1e-6)


@pytest.mark.slow
def test_an_offset_that_is_not_told_is_refused(tmp_path: Path) -> None:
    one, two, _ = moving(tmp_path, 0.0)
    lines = two.read_text().split("\n")
    few = tmp_path / "few.csv"
    few.write_text("\n".join(lines[:6]))
    with pytest.raises(PpmcalError, match="too few"):
        ppmcal.read([one, few], MACHINE, clock_offset="find")
    rng = np.random.default_rng(0)
    few.write_text("\n".join([lines[0], *(f"{line.split(',')[0]},{','.join(map(str, v))}"
                                          for line, v in zip(lines[1:], rng.normal(size=(40, 3)),
                                                             strict=True))]))
    with pytest.raises(PpmcalError, match="no offset of the clocks"):
        ppmcal.read([one, few], MACHINE, clock_offset="find")
    with pytest.raises(PpmcalError, match="not a number of seconds"):
        ppmcal.read([one, two], MACHINE, clock_offset="soon")
    far = tmp_path / "far.csv"
    far.write_text(lines[0] + "\n" + "\n".join(f"{float(x.split(',')[0]) + 9e4},"
                                              f"{x.split(',', 1)[1]}" for x in lines[1:]))
    with pytest.raises(PpmcalError, match="--clock-offset find"):
        ppmcal.read([one, far], MACHINE)


def test_several_targets_make_a_file_each(tmp_path: Path) -> None:
    lines = ["name,x,y,z"] + [f"P{i}_{t},{float(r['x']) + n},{r['y']},{r['z']}"
                              for i, r in enumerate(ROWS) for n, t in enumerate(("north", "south"))]
    (tmp_path / "p.csv").write_text("\n".join(lines) + "\n")
    side = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "position", "sigma": {"position": 0.01}}, "frame": "unknown",
            "target": "unknown", "read": {"names": "{pose}_{target}",
                                          "targets": {"south": [1, 2, 3]}}}
    (tmp_path / "side.yaml").write_text(yaml.safe_dump(side))
    files = [log(tmp_path / "log.csv"), tmp_path / "p.csv"]
    result = ppmcal.read(files, MACHINE, sidecar=tmp_path / "side.yaml")
    result.save(tmp_path / "out")
    one, two = ppmcal.read_data(MACHINE, *sorted((tmp_path / "out").glob("run-*.csv")))
    assert len(one) == len(two) == 12 and two.frame.same_as == one.name
    assert one.target.fitted and not two.target.fitted
    np.testing.assert_allclose(two.target.value, [1e-3, 2e-3, 3e-3])
    with pytest.raises(PpmcalError, match=r"'P0_north' is not made like"):
        ppmcal.read(files, MACHINE, names="{target}/{pose}")
    groups = ["group,point,x,y,z", *(f"{n.split('_')[1].split(',')[0]},{n.split('_')[0]},1,2,3"
                                     for n in lines[1:])]
    (tmp_path / "p.csv").write_text("\n".join(groups) + "\n")
    with pytest.raises(PpmcalError, match=r"stands in several groups.*--names"):
        ppmcal.read(files, MACHINE)
    assert len(ppmcal.read(files, MACHINE, names="{target}::{pose}").runs) == 2


def joint_states(i: int) -> str:
    q = [repr(v / 1000.0) for v in Q[i].tolist()]
    return ",".join([str(START + i), "250000000", "", *LEGS, *q])


def stamped(i: int) -> str:
    turn = Rotation.from_rotvec([float(ROWS[i][a]) for a in ("rx", "ry", "rz")], degrees=True)
    return ",".join([str(START + i), "250000000", "world", *map(repr, (AXES[i] / 1e3).tolist()),
                     *map(repr, turn.as_quat().tolist())])


def ros_echo(folder: Path) -> list[Path]:
    for name, line in (("js.csv", joint_states), ("pose.csv", stamped)):
        (folder / name).write_text("\n".join(map(line, range(12))) + "\n")
    return [folder / "js.csv", folder / "pose.csv"]


def ros_exported(folder: Path, sep: str = ".", root: str = "") -> list[Path]:
    """Write messages as exporters of bags do: a header of fields."""
    path = root + sep.join(["header", "stamp", ""])
    names = [f"{root}name_{i}" for i in range(6)] + [f"{root}position_{i}" for i in range(6)]
    head = ",".join([f"{path}secs", f"{path}nsecs", f"{root}frame_id", *names])
    (folder / "js.csv").write_text(head + "\n" + "\n".join(map(joint_states, range(12))) + "\n")
    fields = [sep.join(["pose", "position", a]) for a in "xyz"] + [
        sep.join(["pose", "orientation", a]) for a in "xyzw"]
    head = ",".join([f"{path}sec", f"{path}nanosec", "frame", *(root + f for f in fields)])
    (folder / "pose.csv").write_text(head + "\n" + "\n".join(map(stamped, range(12))) + "\n")
    return [folder / "js.csv", folder / "pose.csv"]


def check_ros(files: list[Path]) -> None:
    result = ppmcal.read(files, MACHINE, join="time")
    np.testing.assert_allclose([result.table.numbers[f"q_{n}"] for n in LEGS], Q.T, rtol=1e-12)
    np.testing.assert_allclose(result.data.position, AXES / 1e3, rtol=1e-12)
    np.testing.assert_allclose(np.degrees(result.data.rotation), [
        [float(r[a]) for a in ("rx", "ry", "rz")] for r in ROWS], atol=1e-9)
    assert result.data.kind is POSE
    assert "m (ROS)" in result.sentences[0] and "zone" not in result.sentences[0]


@pytest.mark.parametrize("write", [ros_echo, ros_exported, lambda f: ros_exported(f, "/", "/js/"),
                                   lambda f: ros_exported(f, ".", "field.")],
                         ids=["echo", "fields", "paths", "rostopic"])
def test_messages_of_ros_as_csv(tmp_path: Path, write: Callable[[Path], list[Path]]) -> None:
    check_ros(write(tmp_path))


def bag(path: Path, joints: tuple[str, ...] = ("/joint_states",)) -> Path:
    """Write a bag of ROS 2 with joints and poses; return its folder."""
    pytest.importorskip("rosbags", reason="reads and writes bags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    header = kinds["std_msgs/msg/Header"]
    stamp = kinds["builtin_interfaces/msg/Time"]
    plugin = StoragePlugin.MCAP if path.name == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        def write(topic: str, kind: str, make: Callable[[int], tuple[object, ...]]) -> None:
            connection = writer.add_connection(topic, kind, typestore=store)
            for i in range(12):
                head = header(stamp=stamp(sec=START + i, nanosec=250000000), frame_id="world")
                message = kinds[kind](head, *make(i))
                writer.write(connection, i, store.serialize_cdr(message, kind))

        for topic in joints:
            write(topic, "sensor_msgs/msg/JointState",
                  lambda i: (LEGS, Q[i] / 1e3, np.zeros(0), np.zeros(0)))
        cells = [[float(c) for c in stamped(i).split(",")[3:]] for i in range(12)]
        pose, point, turn = (kinds[f"geometry_msgs/msg/{n}"] for n in ("Pose", "Point",
                                                                      "Quaternion"))
        write("/tracker", "geometry_msgs/msg/PoseStamped",
              lambda i: (pose(point(*cells[i][:3]), turn(*cells[i][3:])),))
    return path


@pytest.mark.parametrize("kind", ["mcap", "db3"])
@pytest.mark.parametrize("whole", [True, False], ids=["folder", "file"])
def test_bags_hold_log_and_poses(tmp_path: Path, kind: str, whole: bool) -> None:
    folder = bag(tmp_path / kind)
    check_ros([folder if whole else next(p for p in folder.iterdir() if p.suffix != ".yaml")])


def test_one_of_several_topics_is_named(tmp_path: Path) -> None:
    folder = bag(tmp_path / "mcap", ("/a", "/b"))
    with pytest.raises(PpmcalError, match=r"several topics hold joints: /a, /b.*topics: \[/a\]"):
        ppmcal.read(folder, MACHINE)


def test_without_rosbags_the_command_to_install_it_is_named(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(PpmcalError, match=r"pip install 'ppmcal\[ros\]'"):
        ppmcal.read(tmp_path / "a.mcap", MACHINE)


def klippy(folder: Path) -> Path:
    lines = ["Stats 12.3: gcodein=0"]
    for i in range(12):
        lines += [f"// probe at 1.0,2.0 is z={i}.5", "// mcu: stepper_leg1:123 stepper_leg2:99",
                  "// stepper: " + " ".join(f"stepper_{n}:{v:.6f}" for n, v in
                                            zip(LEGS, Q[i], strict=True)),
                  "// kinematic: X:0.0 Y:0.0 Z:0.0"]
    (folder / "klippy.log").write_text("\n".join(lines) + "\n")
    return folder / "klippy.log"


def test_where_klipper_says_its_carriages_are(tmp_path: Path) -> None:
    listed = tmp_path / "p.csv"
    listed.write_text("name,x,y,z\n" + "\n".join(f"{i + 1},{r['x']},{r['y']},{r['z']}"
                                                 for i, r in enumerate(ROWS)) + "\n")
    result = ppmcal.read([klippy(tmp_path), listed], MACHINE)
    np.testing.assert_allclose(result.table.numbers["q_leg2"], Q[:, 1], atol=1e-6)
    assert any("12 lines `probe at` are not used" in f for f in result.findings)
    (tmp_path / "klippy.log").write_text("// probe at 1.0,2.0 is z=0.5\n")
    with pytest.raises(PpmcalError, match=r"import klipper printer\.cfg --mesh"):
        ppmcal.read([tmp_path / "klippy.log", listed], MACHINE)


def mutated(data: bytes, seed: int) -> bytes:
    """Return a file with one thing broken: cut, doubled, exchanged, a byte of another kind."""
    rng = np.random.default_rng(seed)
    at, long = int(rng.integers(len(data))), int(rng.integers(1, 40))
    new = [b"", data[at:at + long] * 2, b"\x00", b"\xff", b",", b";", b'"', b"\n\n", b"nan", b"-",
           b"1e999", b"\t"][seed % 12]
    return data[:at] + new + data[at + (long if seed % 3 else 1):]


WRITERS: dict[str, Callable[[Path], list[Path]]] = {
    **{form: lambda f, form=form: [log(f / "log.csv", ""), points(f / "p.txt", form)]
       for form in TRACKERS},
    "clocks": lambda f: [log(f / "log.csv", "10:{:02d}:00"), points(f / "p.txt", "units beneath")],
    "echo": ros_echo, "fields": ros_exported,
    "mcap": lambda f: [next(bag(f / "mcap").glob("*.mcap"))],
    "db3": lambda f: [next(bag(f / "db3").glob("*.db3"))],
    "klipper": lambda f: [log(f / "log.csv", ""), klippy(f)]}


@pytest.mark.slow_cases("db3")
@pytest.mark.parametrize("form", WRITERS)
def test_a_broken_file_is_read_or_refused(tmp_path: Path, form: str) -> None:
    """36 mutations of each: no traceback."""
    files = WRITERS[form](tmp_path)
    whole = files[-1].read_bytes()
    for seed in range(36):
        files[-1].write_bytes(mutated(whole, seed))
        try:
            ppmcal.read(files, MACHINE, partial=bool(seed % 2))
        except PpmcalError as error:
            assert error.what and error.where, str(error)


def test_files_of_several_targets_are_not_overwritten(tmp_path: Path) -> None:
    from helpers.commands import ppmcal as run

    log(tmp_path / "log.csv", "")
    (tmp_path / "p.csv").write_text("name,x,y,z\n" + "\n".join(
        f"P{i}_{t},{r['x']},{r['y']},{r['z']}" for i, r in enumerate(ROWS) for t in "ab") + "\n")
    words = ("read", "log.csv", "p.csv", "--mechanism", SAMPLE / "hexapod.yaml", "--names",
             "{pose}_{target}")
    said = run(*words, cwd=tmp_path, expect=1).out
    assert "run-a.csv, run-a.yaml" in " ".join(said.split())
    assert all(len(line) <= 80 for line in said.split("\n"))
    before = (tmp_path / "run-b.csv").read_bytes()
    assert "exists already" in run(*words, cwd=tmp_path, expect=2).err
    assert (tmp_path / "run-b.csv").read_bytes() == before


@pytest.mark.parametrize(("suffix", "zone"), [("parquet", "UTC"), ("parquet", None),
                                              ("xlsx", None)])
def test_moments_of_spreadsheets_and_parquet(tmp_path: Path, suffix: str, zone: str | None) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("openpyxl" if suffix == "xlsx" else "pyarrow")
    log(tmp_path / "log.csv", "2026-03-04 10:{:02d}:00" + ("Z" if zone else ""))
    times = pandas.date_range("2026-03-04 10:00", periods=12, freq="min", tz=zone)
    frame = pandas.DataFrame({"Time": times, **dict(zip("xyz", AXES.T, strict=True))})
    path = tmp_path / f"p.{suffix}"
    if suffix == "xlsx":
        frame.to_excel(path, index=False)
    else:
        frame.to_parquet(path)
    result = ppmcal.read([tmp_path / "log.csv", path], MACHINE, join="time")
    np.testing.assert_allclose(result.table.numbers["x"], AXES[:, 0], rtol=1e-15)
