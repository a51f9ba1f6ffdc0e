"""A reading in words: which mistakes a file holds, and the line that mends each.

The mend is the block ``read`` of the sidecar as a whole: what it already says, and what was found.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppmcal.kinematics.pose_readings import (
    AXES,
    IDENTITY,
    PLUS,
    QUATERNIONS,
    TURNS,
    FileReading,
    JointReading,
    PoseReading,
    unit_factor,
)
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted

QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")


@dataclass(frozen=True)
class Mistake:
    """One way in which a file is not what it was read as.

    ``kind``: permuted, sign, unit, rotation, inverse, mirrored, exchanged, shifted, stale,
    outside-limits or radius; ``columns`` that it concerns; ``text``: in words; ``rows``: where
    not all of them, by number in the CSV.
    """

    kind: str
    columns: tuple[str, ...]
    text: str
    rows: tuple[int, ...] = ()


def mistakes(reading: FileReading, mechanism: Mechanism, data: Dataset) -> tuple[Mistake, ...]:
    """Return what a reading says is wrong in a file."""
    out = [*_of_joints(reading.joints, mechanism, data),
           *_of_positions(reading.pose, mechanism, data),
           *_of_rotations(reading.pose, mechanism, data)]
    if reading.pose.inverse:
        out.append(Mistake("inverse", _measured(data), "the poses are inverse: the measuring "
                           "frame seen from the platform"))
    if reading.shift:
        late = "behind" if reading.shift > 0 else "ahead of"
        out.append(Mistake("shifted", _measured(data), "the measured columns are "
                           f"{counted(abs(reading.shift), 'row')} {late} the joint columns"))
    return tuple(out)


def _measured(data: Dataset) -> tuple[str, ...]:
    return (*AXES, *TURNS) if data.kind == "pose" else AXES


def _of_joints(joints: JointReading, mechanism: Mechanism, data: Dataset) -> list[Mistake]:
    names = [f"q_{a}" for a in mechanism.actuators]
    out = []
    wrong = [i for i, o in enumerate(joints.order) if o != i]
    if wrong:
        each = ", ".join(f"{names[i]} is in the column {names[joints.order[i]]}" for i in wrong)
        text = (f"{names[wrong[0]]} and {names[wrong[1]]} are exchanged" if len(wrong) == 2
                else f"the joint columns are permuted: {each}")
        out.append(Mistake("permuted", tuple(names[i] for i in wrong), text))
    minus = [n for n, s in zip(names, joints.signs, strict=True) if s < 0]
    if minus:
        out.append(Mistake("sign", tuple(minus), f"{_list(minus)} "
                           f"{'has' if len(minus) == 1 else 'have'} the other sign"))
    for unit in dict.fromkeys(u for u in joints.units if u):
        own = [i for i, u in enumerate(joints.units) if u == unit]
        declared = data.units.name(mechanism.actuator_quantity[own[0]])
        out.append(_unit([names[i] for i in own], unit, declared))
    return out


def _axes(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the columns of a place that such a machine's files have."""
    return AXES[:2] if mechanism.motion == "planar" else AXES


def _turns(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the columns of a rotation that such a machine's files have."""
    return TURNS[2:] if mechanism.motion == "planar" else TURNS


def _unit(names: Sequence[str], unit: str, declared: str) -> Mistake:
    return Mistake("unit", tuple(names), f"{_list(names)} "
                   f"{'is' if len(names) == 1 else 'are'} in {unit}, not {declared}")


def _list(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _of_positions(pose: PoseReading, mechanism: Mechanism, data: Dataset) -> list[Mistake]:
    out = []
    if pose.order != IDENTITY:
        wrong = [i for i, o in enumerate(pose.order) if o != i]
        out.append(Mistake("exchanged", tuple(AXES[i] for i in wrong),
                           "; ".join(f"{AXES[i]} is in the column {AXES[pose.order[i]]}"
                                     for i in wrong)))
    minus = [a for a, s in zip(AXES, pose.signs, strict=True) if s < 0]
    if len(minus) == 1:
        out.append(Mistake("mirrored", tuple(minus), f"{minus[0]} has the other sign: that axis "
                           "of the instrument points the other way"))
    elif minus:
        out.append(Mistake("sign", tuple(minus), f"{_list(minus)} have the other sign"))
    if pose.mirror:
        out.append(Mistake("mirrored", _measured(data), "the poses are left-handed: the "
                           f"instrument's {pose.mirror} axis points the other way, or the "
                           "mechanism file has the mirror image of the machine (home on the "
                           "other side of the base, or legs numbered the other way round)"))
    for unit in dict.fromkeys(u for u in pose.units if u):
        own = [a for a, u in zip(_axes(mechanism), pose.units, strict=False) if u == unit]
        out.append(_unit(own, unit, data.units.length))
    return out


def _of_rotations(pose: PoseReading, mechanism: Mechanism, data: Dataset) -> list[Mistake]:
    out, columns = [], QUATERNION if data.convention.startswith("quat") else TURNS
    if pose.turn_order != IDENTITY:
        wrong = [i for i, o in enumerate(pose.turn_order) if o != i]
        out.append(Mistake("exchanged", tuple(TURNS[i] for i in wrong),
                           "; ".join(f"{TURNS[i]} is in the column {TURNS[pose.turn_order[i]]}"
                                     for i in wrong)))
    if pose.rotation:
        out.append(Mistake("rotation", columns, f"{', '.join(columns)} hold "
                           f"{convention_words(pose.rotation)}, not "
                           f"{convention_words(data.convention)}"))
    if pose.turn_signs == (-1, -1, -1):
        out.append(Mistake("rotation", columns, "the rotations are inverse (transposed): the "
                           "measuring frame's turn seen from the platform"))
    elif pose.turn_signs != PLUS:
        minus = [c for c, s in zip(TURNS, pose.turn_signs, strict=True) if s < 0]
        out.append(Mistake("sign", tuple(minus), f"{_list(minus)} "
                           f"{'has' if len(minus) == 1 else 'have'} the other sign"))
    if pose.turn_unit:
        out.append(_unit(_turns(mechanism), pose.turn_unit, data.units.angle))
    return out


def convention_words(convention: str) -> str:
    """Return what rotation columns hold, in words."""
    if convention.startswith("euler-"):
        order = convention.removeprefix("euler-")
        axes = "fixed" if order.islower() else "moving"
        return f"{order.upper()} Euler angles about {axes} axes ({convention})"
    return {"rotvec": "a rotation vector", "quat-xyzw": "a quaternion x, y, z, w",
            "quat-wxyz": "a quaternion w, x, y, z", "matrix": "a matrix"}[convention]


def with_line(data: Dataset, key: str, lines: Mapping[str, object]) -> dict[str, object]:
    """Return the sidecar's block ``read`` with more of one key, such as units: {payload: g}."""
    return {**data.read, key: {**data.read.get(key, {}), **lines}}


def block_text(block: Mapping[str, object]) -> str:
    """Return the sidecar's block ``read`` in one line of YAML."""
    return json.dumps(block).replace('"', "")


def read_block(reading: FileReading, mechanism: Mechanism, data: Dataset) -> dict[str, Any]:
    """Return the sidecar's block ``read`` with which the file is read in this way.

    What the sidecar says already stays, and is put together with what was found.
    """
    old = dict(data.read)
    pose, joints = reading.pose, reading.joints
    columns = _columns(reading, mechanism, data)
    signs = dict(old.get("signs", {}))
    for name, sign in _signs(joints, pose, mechanism, data):
        signs[name] = sign * signs.get(name, 1)
    units = dict(old.get("units", {})) | _units(joints, pose, mechanism)
    rotation = pose.rotation or old.get("rotation", "")
    inverse = pose.inverse != (old.get("pose") == "inverse")
    mirror = "" if pose.mirror == old.get("mirror", "") else pose.mirror or old["mirror"]
    if (inverse or mirror) and data.convention in QUATERNIONS:
        rotation = rotation or data.convention
    shift = reading.shift + int(old.get("shift", 0))
    out = {"columns": columns, "ignore": old.get("ignore"), "units": units,
           "counts_per_turn": old.get("counts_per_turn"),
           "signs": {n: s for n, s in signs.items() if s != 1}, "rotation": rotation,
           "pose": "inverse" if inverse else "", "mirror": mirror, "shift": shift}
    return {key: value for key, value in out.items() if value}


def _columns(reading: FileReading, mechanism: Mechanism, data: Dataset) -> dict[str, str]:
    """Return our column -> the file's header, wherever they differ."""
    headers = dict(data.headers)
    names = [f"q_{a}" for a in mechanism.actuators]
    for own, order in ((names, reading.joints.order), (AXES, reading.pose.order),
                       (TURNS, reading.pose.turn_order)):
        headers |= {own[i]: data.headers.get(own[o], own[o]) for i, o in enumerate(order)
                    if o != i or own[i] in headers}
    return {own: header for own, header in headers.items() if own != header}


def _signs(joints: JointReading, pose: PoseReading, mechanism: Mechanism, data: Dataset
           ) -> list[tuple[str, int]]:
    turns = QUATERNION[:3] if data.convention in QUATERNIONS else TURNS
    return [*zip([f"q_{a}" for a in mechanism.actuators], joints.signs, strict=True),
            *zip(AXES, pose.signs, strict=True), *zip(turns, pose.turn_signs, strict=True)]


def _units(joints: JointReading, pose: PoseReading, mechanism: Mechanism) -> dict[str, str]:
    named = [*zip([f"q_{a}" for a in mechanism.actuators], joints.units, strict=True)]
    named += [*zip(_axes(mechanism), pose.units, strict=False),
              *((t, pose.turn_unit) for t in _turns(mechanism))]
    return {name: unit for name, unit in named if unit}


def other_sigma(reading: FileReading, data: Dataset, left: tuple[float, float]
                ) -> dict[str, float]:
    """Return the sigma that a sidecar is to state where columns are in another unit than it.

    It goes with the columns where what is left agrees better with the noise then: nobody writes
    values in one unit and their sigma in another, but instruments' makers state theirs in mm.

    Args:
        reading: how the file is to be read.
        data: as it is read now.
        left: median misses of positions and rotations that a fit of it read rightly leaves, m, rad.

    Returns:
        Entries of ``instrument.sigma``, in the sidecar's units; empty where they stay.
    """
    units, pose, out = data.units, reading.pose, dict[str, float]()
    for key, unit, miss, sigma, declared in (
            ("position", pose.units[0], left[0], data.sigma_position, units.factor("length")),
            ("rotation", pose.turn_unit, left[1], data.sigma_rotation, units.factor("angle"))):
        known = sigma[np.isfinite(sigma) & (sigma > 0.0)]
        alike = known.size > 0 and np.ptp(known) <= 1e-9 * known[0]
        if not unit or not alike or (key == "position" and len(set(pose.units)) > 1):
            continue
        factor, times = unit_factor(unit, declared), miss / known[0]
        if times > 0.0 and abs(np.log(times / factor)) < abs(np.log(times)):
            out[key] = float(f"{factor * known[0] / declared:.6g}")
    return out
