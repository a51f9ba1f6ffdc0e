"""Bags of ROS 1 and 2 (.bag, .mcap, .db3) through the package rosbags, where it is installed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.ros_tables import POSE_COLUMNS, Recording, joint_header, recording, seconds
from ppmcal.limits import BAG_BYTES, TABLE_ROWS, UNPACKED_BYTES
from ppmcal.model.mechanism import Mechanism

MAGIC = (b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
BAG_INFO = "metadata.yaml"
"""What every folder of a bag of ROS 2 holds."""
JOINTS = "sensor_msgs/msg/JointState"
POINTS = {"geometry_msgs/msg/PoseStamped": "pose", "geometry_msgs/msg/PointStamped": "point",
          "geometry_msgs/msg/TransformStamped": "transform",
          "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
          "nav_msgs/msg/Odometry": "pose.pose"}
"""Type of a message, and where in it the pose stands."""


def is_bag(data: bytes) -> bool:
    """Return whether a file is a bag."""
    return data.startswith(MAGIC)


def bag_tables(path: Path, mechanism: Mechanism, topics: Sequence[str] = ()) -> list[Recording]:
    """Return joint states and poses of a bag, one recording each.

    Args:
        path: ``.bag``, ``.mcap``, ``.db3``, or the folder of a bag of ROS 2.
        mechanism: for the names of its actuators.
        topics: to read  [default: the only ones of their types].

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
        make = _joints if types[topic] == JOINTS else _points
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


def _joints(source: str, messages: Sequence[Any], _: str, mechanism: Mechanism) -> Recording:
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
