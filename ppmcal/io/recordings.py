"""Recordings of controllers: messages of ROS as tables and in bags, logs of Klipper.

Of ROS: JointState, and poses with or without a stamp. Lengths are in m and angles in rad (REP 103),
quaternions x, y, z, w. What exporters call the fields differs (``pose.position.x``,
``/pose/position/x``, ``field.pose.position.x``, ``position_x``); the ends of the names are alike.
Bags of ROS 1 and 2 (.bag, .mcap, .db3) are read through the package rosbags, where it is installed.

In logs of Klipper the lines ``stepper: stepper_a:297.5 stepper_b:...`` of GET_POSITION hold each
carriage's place in mm. Lines ``probe at x,y is z=...`` hold no joint values: ``ppmcal import
klipper --mesh`` reads them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.csv import Table, cleaned, refuse_double
from ppmcal.io.csv_dialect import is_float
from ppmcal.limits import BAG_BYTES, TABLE_ROWS, UNPACKED_BYTES
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

FORM = "ROS messages (m, rad)"
_INT = re.compile(r"\d+", re.ASCII)
_AXIS = re.compile(r".*(?:position|translation)[./_]([xyz])", re.I)
_TURN = re.compile(r".*(?:orientation|rotation)[./_]([xyzw])", re.I)
_SEC = re.compile(r".*stamp[./_]secs?", re.I)
_NANO = re.compile(r".*stamp[./_](?:nsecs?|nanosecs?)", re.I)
_NAME = re.compile(r"(.*?)name[._\[]?(\d+)\]?", re.I)
_JOINT = re.compile(r"(.*?)position[._\[]?(\d+)\]?", re.I)
_WHEN = ("%time", "__time", "field.header.stamp", "rosbagtimestamp")
POSE_COLUMNS = ("x [m]", "y [m]", "z [m]", "quat_x", "quat_y", "quat_z", "quat_w")
MAGIC = (b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
BAG_INFO = "metadata.yaml"
"""What every folder of a bag of ROS 2 holds."""
JOINTS = "sensor_msgs/msg/JointState"
POINTS = {"geometry_msgs/msg/PoseStamped": "pose", "geometry_msgs/msg/PointStamped": "point",
          "geometry_msgs/msg/TransformStamped": "transform",
          "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
          "nav_msgs/msg/Odometry": "pose.pose"}
"""Type of a message, and where in it the pose stands."""
_ROW = re.compile(r"^(?:[^\w\n]*Recv: )?[^\w\n]*stepper:"
                  r"((?:[^\S\n]+\w+:[-+]?\d+(?:\.\d*)?)+)[^\S\n]*$", re.MULTILINE | re.ASCII)
_VALUE = re.compile(r"(?:stepper_)?(\w+):([-+]?\d+(?:\.\d*)?)", re.ASCII)
_PROBE = re.compile(r"probe at [-+.\d]+\s*,\s*[-+.\d]+ is z=", re.ASCII)


@dataclass(frozen=True)
class Recording:
    """A table as a recorder wrote it.

    Attributes:
        table: its columns, perhaps already under our own names, with units in brackets.
        form: what kind of file it is, empty for a plain table.
        remarks: lines above the table.
        findings: what the user must know.
        origin: header -> from where it is known what the column is.
        headers: header -> what the file itself calls it, where that differs.
    """

    table: Table
    form: str = ""
    remarks: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    origin: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)


def joint_header(name: str, mechanism: Mechanism) -> str:
    """Return the header of a joint: ours where the machine has that actuator."""
    name = name.strip()
    if name not in mechanism.actuators:
        return name
    i = mechanism.actuators.index(name)
    length = mechanism.actuator_quantity[i] == "length" and not mechanism.actuator_has_ratio[i]
    return f"q_{name} [{'m' if length else 'rad'}]"


def recording(source: str, columns: Mapping[str, Array | tuple[str, ...]], size: int,
              theirs: Mapping[str, str]) -> Recording:
    """Return columns of messages under our own names as a recording; ``theirs``: their fields."""
    numbers = {h: v for h, v in columns.items() if not isinstance(v, tuple)}
    text = {h: v for h, v in columns.items() if isinstance(v, tuple)}
    table = Table(source, tuple(columns), numbers, text, size)
    return Recording(table, FORM, (), (), dict.fromkeys(columns, "ROS message"), dict(theirs))


def seconds(sec: Sequence[int], nano: Sequence[int]) -> Array:
    """Return stamps (N,) as s since 1970, or since the start of a simulation."""
    return np.array([s + 1e-9 * n for s, n in zip(sec, nano, strict=True)], dtype=float)


def ros_csv(data: bytes, source: str, mechanism: Mechanism) -> Recording | None:
    """Return what ``ros2 topic echo --csv`` wrote, which has no header; None for other files.

    Raises:
        BadInput: rows of another length than the first, or a cell that is not a number.
    """
    first = data[:4096].removeprefix(b"\xef\xbb\xbf").split(b"\n", 1)[0].decode("utf-8", "replace")
    shape = _shape(first.strip().split(","))
    if shape is None:
        return None
    names, start = shape
    rows = [line.strip().split(",") for line in cleaned(data, source).decode().split("\n")
            if line.strip() and line.strip() != "---"]
    width = len(rows[0])
    for i, row in enumerate(rows):
        if len(row) != width or row[3:start] != rows[0][3:start]:
            raise BadInput(f"the row has {len(row)} cells or other joints, the first {width}",
                           f"{source}: row {i + 1}", "Record one topic, whose messages are alike")
    fields = ([joint_header(n, mechanism) for n in names] if names else list(POSE_COLUMNS))
    refuse_double(fields, f"{source}: row 1", "Rename one", "joints")
    try:
        columns: dict[str, Array | tuple[str, ...]] = {
            "time": seconds([int(r[0]) for r in rows], [int(r[1]) for r in rows])}
        block = np.array([[float(c) for c in r[start:start + len(fields)]] for r in rows])
    except (ValueError, OverflowError) as error:
        raise BadInput(f"a cell is not a number ({error})", source,
                       "Record it again, or name the columns in a header line") from None
    columns |= dict(zip(fields, block.T, strict=True))
    return recording(source, columns, len(rows), {"time": "stamp", **dict(
        zip(fields, names or [*(f"position.{c}" for c in "xyz"),
                              *(f"orientation.{c}" for c in "xyzw")], strict=True))})


def _shape(cells: Sequence[str]) -> tuple[list[str], int] | None:
    """Return the joints' names and where the numbers begin, of a stamped message; None of none."""
    cells = [c.strip() for c in cells]
    if len(cells) < 5 or not _INT.fullmatch(cells[0]) or not _INT.fullmatch(cells[1]):
        return None
    if is_float(cells[2]) or int(cells[1]) >= 10 ** 9:
        return None
    words = next((i for i, c in enumerate(cells[3:]) if is_float(c)), len(cells) - 3)
    rest = cells[3 + words:]
    if not all(map(is_float, rest)):
        return None
    if words == 0:
        turn = sum(float(c) ** 2 for c in rest[3:7])
        return ([], 3) if len(rest) == 7 and abs(turn - 1.0) < 1e-2 else None
    return (cells[3:3 + words], 3 + words) if len(rest) in (words, 2 * words, 3 * words) else None


def ros_headers(table: Table, mechanism: Mechanism) -> Recording:
    """Return a table whose headers are fields of messages under our own names.

    Any other table stays as it is.
    """
    names, header = dict[str, str](), table.header
    poses = {m[1].lower(): h for h in header if (m := _AXIS.fullmatch(h))}
    turns = {m[1].lower(): h for h in header if (m := _TURN.fullmatch(h))}
    foreign = any("." in h or "/" in h for h in (*poses.values(), *turns.values()))
    if foreign and set("xyz") <= set(poses):
        names |= {h: f"{a} [m]" for a, h in poses.items()}
        if set("xyzw") <= set(turns):
            names |= {h: f"quat_{a}" for a, h in turns.items()}
    joints, gone = _joint_fields(table, mechanism)
    names |= joints
    if not names:
        return Recording(table)
    sec, nano = (next((h for h in header if p.fullmatch(h)), None) for p in (_SEC, _NANO))
    numbers = dict(table.numbers)
    if sec and nano and sec in numbers and nano in numbers:
        numbers[sec] = numbers[sec] + 1e-9 * numbers[nano]
        names[sec], gone = "time", {*gone, nano}
    elif "time" not in {h.lower() for h in header}:
        when = next((h for w in _WHEN for h in header if h.lower() == w), None)
        names |= {when: "time"} if when else {}
    fresh = {h: names.get(h, h) for h in header if h not in gone}
    if len({*fresh.values()}) < len(fresh):
        return Recording(table)
    theirs = {own: h for h, own in fresh.items() if h in names}
    made = replace(table, numbers=numbers).named(fresh)
    return Recording(made, FORM, (), (), dict.fromkeys(theirs, "ROS message"), theirs)


def _joint_fields(table: Table, mechanism: Mechanism) -> tuple[dict[str, str], set[str]]:
    """Return header -> our own of joint positions, and the headers of columns of names."""
    named = {(m[1], m[2]): h for h in table.text if (m := _NAME.fullmatch(h))}
    out, gone = dict[str, str](), set[str]()
    for h in table.header:
        m = _JOINT.fullmatch(h)
        if m and (column := named.get((m[1], m[2]))):
            called = set(table.text[column])
            if len(called) == 1:
                out[h] = joint_header(called.pop(), mechanism)
                gone.add(column)
        parts = ["", *re.split(r"[./]", h)]
        if parts[-1] == "position" and parts[-2] in mechanism.actuators:
            out[h] = joint_header(parts[-2], mechanism)
    return out, gone


# ---- bags


def is_bag(data: bytes) -> bool:
    """Return whether a file is a bag."""
    return data.startswith(MAGIC)


def bag_tables(path: Path, mechanism: Mechanism, topics: Sequence[str] = ()) -> list[Recording]:
    """Return joint states and poses of a bag, one recording each.

    ``path``: ``.bag``, ``.mcap``, ``.db3``, or the folder of a bag of ROS 2; ``topics``: to read
    [default: the only ones of their types].

    Raises:
        BadInput: rosbags is not there, the file is damaged, there is no such topic, or several
            among which one must be chosen.
    """
    source = str(path)
    if path.is_dir() and not (path / BAG_INFO).is_file():
        raise BadInput("is a folder, and no bag of ROS 2", source, "Give files")
    if path.is_file():
        BAG_BYTES.refuse(path.stat().st_size, source)
    try:
        from rosbags.highlevel import AnyReader  # 20 MB with what it needs, for those with bags
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise BadInput("is a bag, which only rosbags can read", source, "Install it (pip install "
                       "'ppmcal[ros]'), or export its topics as CSV") from None
    try:
        # a bag of ROS 2 may lack the definitions of standard messages, which have not changed
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            wanted = _chosen(reader.connections, topics, source)
            held: dict[str, list[Any]] = {c.topic: [] for c in wanted}
            TABLE_ROWS.refuse(sum(c.msgcount for c in wanted), source)
            size = 0
            for connection, _, data in reader.messages(connections=wanted):
                size += len(data)
                UNPACKED_BYTES.refuse(size, source)
                held[connection.topic].append(reader.deserialize(data, connection.msgtype))
            types = {c.topic: c.msgtype for c in wanted}
    except BadInput:
        raise
    except Exception as error:    # a damaged bag raises anything
        raise BadInput(f"cannot be read as a bag ({type(error).__name__})", source,
                       "Check it with `ros2 bag info`, or export its topics as CSV") from None
    out = []
    for topic, messages in held.items():
        if not messages:
            raise BadInput(f"the topic {topic} holds no messages", source, "Record it again")
        make = _joint_states if types[topic] == JOINTS else _points
        out.append(make(f"{source} {topic}", messages, types[topic], mechanism))
    return out


def _chosen(connections: Sequence[Any], topics: Sequence[str], source: str) -> list[Any]:
    """Return the connections to read: one of joints, one of poses, or those that are named."""
    useful = {c.topic: c for c in connections if c.msgtype == JOINTS or c.msgtype in POINTS}
    refuse_unknown("topic", topics, useful, f"{source}: read.topics")
    chosen = [c for t, c in useful.items() if not topics or t in topics]
    if not chosen:
        raise BadInput(f"no topic holds joints or poses ({len(connections)} topics)", source,
                       f"Record {JOINTS} and {', '.join(POINTS)}")
    for kind in (True, False):
        same = [c.topic for c in chosen if (c.msgtype == JOINTS) == kind]
        if len(same) > 1:
            raise BadInput(f"several topics hold {'joints' if kind else 'poses'}: "
                           f"{', '.join(same)}", source, "Name those that count in the sidecar: "
                           f"`read: {{topics: [{same[0]}]}}`")
    return chosen


def _times(messages: Sequence[Any]) -> np.ndarray:
    stamps = [m.header.stamp for m in messages]
    return seconds([s.sec for s in stamps], [s.nanosec for s in stamps])


def _joint_states(source: str, messages: Sequence[Any], _: str, mechanism: Mechanism) -> Recording:
    """Return joint states; joints that a message does not name are empty there."""
    names = list(dict.fromkeys(n for m in messages for n in m.name))
    block = np.full((len(messages), len(names)), np.nan)
    for i, message in enumerate(messages):
        for name, value in zip(message.name, message.position, strict=False):
            block[i, names.index(name)] = value
    fields = {joint_header(n, mechanism): n for n in names}
    columns = {"time": _times(messages), **dict(zip(fields, block.T, strict=True))}
    return recording(source, columns, len(messages), {"time": "header.stamp", **fields})


def _points(source: str, messages: Sequence[Any], kind: str, _: Mechanism) -> Recording:
    """Return poses, or points."""
    rows = []
    for message in messages:
        held = message
        for part in POINTS[kind].split("."):
            held = getattr(held, part)
        place = getattr(held, "position", None) or getattr(held, "translation", None) or held
        turn = getattr(held, "orientation", None) or getattr(held, "rotation", None)
        rows.append([place.x, place.y, place.z,
                     *([turn.x, turn.y, turn.z, turn.w] if turn is not None else [])])
    block = np.array(rows, dtype=float)
    columns = {"time": _times(messages),
               **dict(zip(POSE_COLUMNS[:block.shape[1]], block.T, strict=True))}
    where = POINTS[kind]
    return recording(source, columns, len(messages),
                     {"time": "header.stamp", **{h: where for h in columns if h != "time"}})


# ---- Klipper


def klipper_log(data: bytes, source: str, mechanism: Mechanism) -> Recording | None:
    """Return the joint values of a log, None for any other file.

    The rows are called 1, 2, ... in the order of the log.

    Raises:
        BadInput: probed points only, drives that the machine does not have, or joint values of
            the machine that are not lengths.
    """
    if b"stepper:" not in data and b"probe at " not in data:
        return None
    text = cleaned(data, source).decode("utf-8")
    found, probed = _ROW.findall(text), len(_PROBE.findall(text))
    if not found:
        if not probed:
            return None
        raise BadInput(f"has {probed} lines `probe at x,y is z=...`, which hold no joint values",
                       source, "Read them with ppmcal import klipper printer.cfg --mesh THIS, or "
                       "have GET_POSITION say after each touch where the carriages are")
    rows = [dict(_VALUE.findall(line)) for line in found]
    for i, row in enumerate(rows):
        missing = [a for a in mechanism.actuators if a not in row]
        if missing:
            raise BadInput(f"line {i + 1} with `stepper:` has no stepper_{missing[0]}", source,
                           f"Its drives are {', '.join(row)}; those of the machine "
                           f"{', '.join(mechanism.actuators)}: name them alike")
    for a, quantity, bare in zip(mechanism.actuators, mechanism.actuator_quantity,
                                 mechanism.actuator_has_ratio, strict=True):
        if bare or quantity != "length":
            raise BadInput(f"Klipper says where the carriages are in mm, and q_{a} of this machine "
                           "is not a length", source, "Give a mechanism file without `ratio`, "
                           "whose joint value is the carriage's height in mm")
    header = ("pose", *(f"q_{a} [mm]" for a in mechanism.actuators))
    numbers = {f"q_{a} [mm]": np.array([float(r[a]) for r in rows]) for a in mechanism.actuators}
    table = Table(source, header, {"pose": np.arange(1.0, len(rows) + 1.0), **numbers}, {},
                  len(rows))
    origin = dict.fromkeys(header[1:], "`stepper:` lines of GET_POSITION")
    shown = {f"q_{a} [mm]": f"stepper_{a}" for a in mechanism.actuators}
    findings = (Note(f"{source}: {probed} lines `probe at` are not used: ppmcal import klipper "
                     "--mesh reads them."),) if probed else ()
    return Recording(table, "log of Klipper", (), findings,
                     {**origin, "pose": "count of the lines"}, {**shown, "pose": "(none)"})
