"""Recordings of ROS as tables: JointState, and poses with or without a stamp.

Lengths are in m and angles in rad (REP 103), quaternions x, y, z, w. What exporters call the
fields differs (``pose.position.x``, ``/pose/position/x``, ``field.pose.position.x``,
``position_x``); the ends of the names are the same.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table, cleaned
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

FORM = "ROS messages (m, rad)"
_INT = re.compile(r"\d+", re.ASCII)
_AXIS = re.compile(r".*(?:position|translation)[./_]([xyz])", re.I)
_TURN = re.compile(r".*(?:orientation|rotation)[./_]([xyzw])", re.I)
_SEC = re.compile(r".*stamp[./_]secs?", re.I)
_NANO = re.compile(r".*stamp[./_](?:nsecs?|nanosecs?)", re.I)
_NAME = re.compile(r"(.*?)name[._\[]?(\d+)\]?", re.I)
_JOINT = re.compile(r"(.*?)position[._\[]?(\d+)\]?", re.I)
_WHEN = ("%time", "__time", "field.header.stamp", "rosbagtimestamp")


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


POSE_COLUMNS = ("x [m]", "y [m]", "z [m]", "quat_x", "quat_y", "quat_z", "quat_w")


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
    double = next((n for i, n in enumerate(fields) if n in fields[:i]), None)
    if double:
        raise BadInput(f"two joints are called '{double}'", f"{source}: row 1", "Rename one")
    try:
        columns: dict[str, Array | tuple[str, ...]] = {
            "time": seconds([int(r[0]) for r in rows], [int(r[1]) for r in rows])}
        block = np.array([[float(c) for c in r[start:start + len(fields)]] for r in rows])
    except (ValueError, OverflowError) as error:
        raise BadInput(f"a cell is not a number ({error})", source,
                       "Record it again, or name the columns in a header line") from None
    columns |= dict(zip(fields, block.T, strict=True))
    return recording(source, columns, len(rows), {"time": "stamp", **dict(
        zip(fields, names or ("position.x", "position.y", "position.z", "orientation.x",
                              "orientation.y", "orientation.z", "orientation.w"), strict=True))})


def _shape(cells: Sequence[str]) -> tuple[list[str], int] | None:
    """Return the joints' names and where the numbers begin, of a stamped message; None of none."""
    cells = [c.strip() for c in cells]
    if len(cells) < 5 or not _INT.fullmatch(cells[0]) or not _INT.fullmatch(cells[1]):
        return None
    if _number(cells[2]) or int(cells[1]) >= 10 ** 9:
        return None
    words = next((i for i, c in enumerate(cells[3:]) if _number(c)), len(cells) - 3)
    rest = cells[3 + words:]
    if not all(map(_number, rest)):
        return None
    if words == 0:
        turn = sum(float(c) ** 2 for c in rest[3:7])
        return ([], 3) if len(rest) == 7 and abs(turn - 1.0) < 1e-2 else None
    return (cells[3:3 + words], 3 + words) if len(rest) in (words, 2 * words, 3 * words) else None


def _number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


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
    joints, gone = _joints(table, mechanism)
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


def _joints(table: Table, mechanism: Mechanism) -> tuple[dict[str, str], set[str]]:
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
