"""A reading in words: which mistakes a file holds, and the line that mends each.

The mend is the block ``read`` of the sidecar as a whole: what it already says, and what was found.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppmcal.kinematics.pose_readings import (
    AXES,
    QUATERNIONS,
    TURNS,
    FileReading,
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


@dataclass(frozen=True)
class _Sort:
    """Columns of one sort, and how a reading has them: those of joints, places or rotations.

    ``own``: which of them such a machine's files have; the rest as in
    :class:`ppmcal.kinematics.pose_readings.JointReading`, with the ``declared`` units.
    """

    names: tuple[str, ...]
    own: tuple[int, ...]
    order: tuple[int, ...]
    signs: tuple[int, ...]
    units: tuple[str, ...]
    declared: tuple[str, ...]

    @property
    def moved(self) -> tuple[int, ...]:
        """Those that stand in another one's place."""
        return tuple(i for i in self.own if self.order[i] != i)

    @property
    def turned(self) -> tuple[str, ...]:
        """Names of those with the other sign."""
        return tuple(n for n, s in zip(self.names, self.signs, strict=True) if s < 0)

    def in_other_units(self) -> Iterator[Mistake]:
        """Yield one mistake for each unit that is not the declared one."""
        for unit in dict.fromkeys(self.units[i] for i in self.own if self.units[i]):
            own = [i for i in self.own if self.units[i] == unit]
            names = [self.names[i] for i in own]
            yield Mistake("unit", tuple(names), f"{_of(names, 'is', 'are')} in {unit}, "
                          f"not {self.declared[own[0]]}")


def _sorts(reading: FileReading, mechanism: Mechanism, data: Dataset
           ) -> tuple[_Sort, _Sort, _Sort]:
    """Return how a reading has the columns of joints, places and rotations."""
    pose, joints, k = reading.pose, reading.joints, len(mechanism.actuators)
    planar, units = mechanism.motion == "planar", data.units
    turns = QUATERNION[:3] if data.convention in QUATERNIONS else TURNS
    return (_Sort(tuple(f"q_{a}" for a in mechanism.actuators), tuple(range(k)), joints.order,
                     joints.signs, joints.units,
                     tuple(units.name(q) for q in mechanism.actuator_quantity)),
            _Sort(AXES, (0, 1) if planar else (0, 1, 2), pose.order, pose.signs, pose.units,
                     (units.length,) * 3),
            _Sort(turns, (2,) if planar else (0, 1, 2), pose.turn_order, pose.turn_signs,
                     (pose.turn_unit,) * 3, (units.angle,) * 3))


def mistakes(reading: FileReading, mechanism: Mechanism, data: Dataset) -> tuple[Mistake, ...]:
    """Return what a reading says is wrong in a file."""
    joints, places, turns = _sorts(reading, mechanism, data)
    measured = (*AXES, *TURNS) if data.kind == "pose" else AXES
    out = [*_of_joints(joints), *_of_places(places)]
    if reading.pose.mirror:
        out.append(Mistake("mirrored", measured, "the poses are left-handed: the instrument's "
                           f"{reading.pose.mirror} axis points the other way, or the "
                           "mechanism file has the mirror image of the machine (home on the "
                           "other side of the base, or legs numbered the other way round)"))
    out += [*places.in_other_units(), *_of_turns(turns, reading.pose.rotation, data.convention)]
    if reading.pose.inverse:
        out.append(Mistake("inverse", measured, "the poses are inverse: the measuring "
                           "frame seen from the platform"))
    if reading.shift:
        late = "behind" if reading.shift > 0 else "ahead of"
        out.append(Mistake("shifted", measured, "the measured columns are "
                           f"{counted(abs(reading.shift), 'row')} {late} the joint columns"))
    return tuple(out)


def _of_joints(sort: _Sort) -> Iterator[Mistake]:
    names = sort.names
    if sort.moved:
        each = ", ".join(f"{names[i]} is in the column {names[sort.order[i]]}" for i in sort.moved)
        yield Mistake("permuted", tuple(names[i] for i in sort.moved),
                      " and ".join(names[i] for i in sort.moved) + " are exchanged"
                      if len(sort.moved) == 2 else f"the joint columns are permuted: {each}")
    yield from _with_other_sign(sort)
    yield from sort.in_other_units()


def _of_places(sort: _Sort) -> Iterator[Mistake]:
    yield from _exchanged(sort)
    if len(sort.turned) == 1:
        yield Mistake("mirrored", sort.turned, f"{sort.turned[0]} has the other sign: that axis "
                      "of the instrument points the other way")
    else:
        yield from _with_other_sign(sort)


def _of_turns(sort: _Sort, rotation: str, convention: str) -> Iterator[Mistake]:
    columns = QUATERNION if convention in QUATERNIONS else TURNS
    yield from _exchanged(sort)
    if rotation:
        yield Mistake("rotation", columns, f"{', '.join(columns)} hold "
                      f"{convention_words(rotation)}, not {convention_words(convention)}")
    if len(sort.turned) == 3:
        yield Mistake("rotation", columns, "the rotations are inverse (transposed): the "
                      "measuring frame's turn seen from the platform")
    else:
        yield from _with_other_sign(sort)
    yield from sort.in_other_units()


def _exchanged(sort: _Sort) -> Iterator[Mistake]:
    if sort.moved:
        yield Mistake("exchanged", tuple(sort.names[i] for i in sort.moved), "; ".join(
            f"{sort.names[i]} is in the column {sort.names[sort.order[i]]}" for i in sort.moved))


def _with_other_sign(sort: _Sort) -> Iterator[Mistake]:
    if sort.turned:
        yield Mistake("sign", sort.turned, f"{_of(sort.turned, 'has', 'have')} the other sign")


def _of(names: Sequence[str], one: str, several: str) -> str:
    """Return names and their verb."""
    return (f"{names[0]} {one}" if len(names) == 1 else
            f"{', '.join(names[:-1])} and {names[-1]} {several}")


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
    old, pose = dict(data.read), reading.pose
    headers, signs, units = dict(data.headers), dict(old.get("signs", {})), dict(
        old.get("units", {}))
    for sort in _sorts(reading, mechanism, data):
        for i in sort.own:
            name, source = sort.names[i], sort.names[sort.order[i]]
            if source != name or name in data.headers:
                headers[name] = data.headers.get(source, source)
            signs[name] = sort.signs[i] * signs.get(name, 1)
            units |= {name: sort.units[i]} if sort.units[i] else {}
    rotation = pose.rotation or old.get("rotation", "")
    inverse = pose.inverse != (old.get("pose") == "inverse")
    mirror = "" if pose.mirror == old.get("mirror", "") else pose.mirror or old["mirror"]
    if (inverse or mirror) and data.convention in QUATERNIONS:
        rotation = rotation or data.convention
    out = {"columns": {own: header for own, header in headers.items() if own != header},
           "ignore": old.get("ignore"), "units": units,
           "counts_per_turn": old.get("counts_per_turn"),
           "signs": {n: s for n, s in signs.items() if s != 1}, "rotation": rotation,
           "pose": "inverse" if inverse else "", "mirror": mirror,
           "shift": reading.shift + int(old.get("shift", 0))}
    return {key: value for key, value in out.items() if value}


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
