"""A reading of a measurement file: the data that it gives, the mistakes it implies, the correction.

A measurement file is numbers under names. The same numbers under another reading are another
campaign. Order of reading: columns, signs, units, convention of rotations, mirrored axis, inverse
pose, shift of rows (contract, section 6). The correction is the whole block ``read`` of the
sidecar: its present entries together with those found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, TypeVar

import numpy as np

from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    unit_words,
    with_unit,
)
from ppmcal.kinematics.pose_readings import (
    AXES,
    QUATERNIONS,
    TURNS,
    inverse_pose,
    mirrored,
    shifted_rows,
    understood,
    written,
)
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import ANGLES, LENGTHS, TURN
from ppmcal.wording import pluralize

QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")
UNITS = {**LENGTHS, **ANGLES, "turn": TURN}
T = TypeVar("T")


@dataclass(frozen=True)
class ReadColumns:
    """Columns of one sort (joints, positions or rotations) and how they are read.

    Attributes:
        names: of the k columns; ``own``: which of them such a machine's files have.
        declared, factors: their units in the file, and the SI values of these; 1 for bare numbers.
        order: column i stands under the name of ``order[i]``.
        signs: +1 or -1 on it; ``units``: its unit, empty if the declared one.
    """

    names: tuple[str, ...]
    own: tuple[int, ...]
    declared: tuple[str, ...]
    factors: tuple[float, ...]
    order: tuple[int, ...]
    signs: tuple[int, ...]
    units: tuple[str, ...]

    @classmethod
    def as_declared(cls, names: Sequence[str], own: Sequence[int], declared: Sequence[str],
                    factors: Sequence[float]) -> ReadColumns:
        """Return columns read as the file says."""
        k = len(names)
        return cls(tuple(names), tuple(own), tuple(declared), tuple(factors), tuple(range(k)),
                   (1,) * k, ("",) * k)

    def of(self, values: Array) -> Array:
        """Return the values (N, k), read in this way, of a file that was read as ``values``."""
        si, order = np.array(self.factors), list(self.order)
        unit = [UNITS[u] / d if u else 1.0 for u, d in zip(self.units, self.factors, strict=True)]
        # a column's raw number, times the unit of the name to which it is assigned
        return np.asarray(values[:, order] * (si / si[order] * self.signs * unit))

    @property
    def moved(self) -> tuple[int, ...]:
        """Columns that stand in the place of another."""
        return tuple(i for i in self.own if self.order[i] != i)

    @property
    def turned(self) -> tuple[str, ...]:
        """Names of columns with the other sign."""
        return tuple(n for n, s in zip(self.names, self.signs, strict=True) if s < 0)

    @property
    def parts(self) -> float:
        """Number of changes; an order is one, plus a little per column."""
        moved = len(self.moved)
        return (moved > 0) + 0.1 * moved + _minority(self.signs, 1) + _minority(self.units, "")

    def mistakes(self, permuted: str, sign: FileFault | None = None) -> Iterator[FileFault]:
        """Yield the mistakes: places, signs, and each unit other than the declared one.

        Args:
            permuted: kind of mistake for columns in other places.
            sign: what other signs mean, if more than that.
        """
        if self.moved:
            names = [self.names[i] for i in self.moved]
            yield FileFault(permuted, tuple(names), f"{with_verb(names, '', 'are')} exchanged"
                            if len(names) == 2 else "the columns are permuted: " + ", ".join(
                              f"{self.names[i]} is in the column {self.names[self.order[i]]}"
                              for i in self.moved))
        if self.turned:
            yield sign or FileFault("sign", self.turned, with_verb(self.turned, "has", "have")
                                    + " the other sign")
        for unit in dict.fromkeys(self.units[i] for i in self.own if self.units[i]):
            own = [i for i in self.own if self.units[i] == unit]
            names = [self.names[i] for i in own]
            yield FileFault("unit", tuple(names), f"{with_verb(names, 'is', 'are')} in "
                            f"{unit_words(unit)}, not {unit_words(self.declared[own[0]])}")


def _said(block: Mapping[str, T], name: str, usual: T) -> T:
    """Return the entry of a block for a column, by its name or a pattern."""
    return next((v for pattern, v in block.items() if fnmatchcase(name, pattern)), usual)


def _as_stated(data: Dataset, names: Sequence[str], own: Sequence[int], usual: Sequence[str],
               factors: Sequence[float]) -> ReadColumns:
    """Return columns read as the file says, in the units of header or sidecar.

    ``usual``, ``factors``: the units of the file, and their SI values.
    """
    said = [data.headed[n][1] if n in data.headed else _said(
        data.read.get("units", {}), data.own_column(n), "") for n in names]
    known = [(u, UNITS[u]) if u in UNITS and d else (d, f)
             for u, d, f in zip(said, usual, factors, strict=True)]
    return ReadColumns.as_declared(names, own, [u for u, _ in known], [f for _, f in known])


def _stated(old: Mapping[str, Any], changes: Mapping[str, Any], names: Sequence[str]
            ) -> dict[str, Any]:
    """Return a block's entries for columns, with some changed.

    A pattern that matches changed columns is changed if all its columns are, else they are named.
    """
    out, hit = dict[str, Any](), set[str]()
    for pattern, value in old.items():
        own = [n for n in names if fnmatchcase(n, pattern)]
        hit |= set(own)
        new = [changes.get(n, value) for n in own]
        same = len(set(new)) <= 1
        out |= {pattern: new[0] if new else value} if same else dict(zip(own, new, strict=True))
    return {**out, **{n: v for n, v in changes.items() if n not in hit}}


def _minority(values: Sequence[object], usual: object) -> int:
    """Return how many values differ from the usual; all of them alike count as one mistake."""
    other = [v for v in values if v != usual]
    return 1 if len(other) == len(values) > 1 and len(set(other)) == 1 else len(other)


def with_verb(names: Sequence[str], one: str, several: str) -> str:
    """Return names and their verb."""
    return (f"{names[0]} {one}" if len(names) == 1 else
            f"{', '.join(names[:-1])} and {names[-1]} {several}")


def readable(data: Dataset) -> bool:
    """Whether a data set has other readings: poses or positions at given joint values."""
    return not data.kind.scalar and data.kind.of_poses and data.commanded is None


def of_a_joint(data: Dataset) -> bool:
    """Whether a data set was read by an encoder at a joint, at given joint values."""
    return data.kind.placed is not None and data.commanded is None


def at_joint(data: Dataset, kind: InstrumentKind) -> Dataset:
    """Return a data set as read if its encoder is at another joint, ``kind``.

    The meaning of the numbers depends on the joint: angles of a revolute, lengths of a prismatic.
    """
    factor = data.units.factor(kind.quantity) / data.units.factor(data.kind.quantity)
    return replace(data, kind=kind, value=data.value * factor,
                   sigma_value=data.sigma_value * factor,
                   sigma_position=data.sigma_position * factor)


@dataclass(frozen=True)
class ColumnInterpretation:
    """A reading of one file of poses, of positions, or of an encoder at a joint.

    Attributes:
        joints, places, turns, numbers: how its columns are read, single-value ones last.
        convention: in which its rotations were read so far; ``rotation``: the right one, if other.
        mirror: an axis of the instrument that points the other way.
        inverse: whether the poses are those of the measuring frame, seen from the platform.
        shift: by how many rows the measured columns are late.
        kind: the instrument, if at another joint than the sidecar says.
    """

    joints: ReadColumns
    places: ReadColumns
    turns: ReadColumns
    numbers: ReadColumns
    convention: str
    rotation: str = ""
    mirror: str = ""
    inverse: bool = False
    shift: int = 0
    kind: InstrumentKind | None = None

    @classmethod
    def as_declared(cls, mechanism: Mechanism, data: Dataset) -> ColumnInterpretation:
        """Return the reading of a file as its sidecar says."""
        planar, units = mechanism.motion.planar, data.units
        turns = QUATERNION[:3] if data.convention in QUATERNIONS else TURNS
        number = [data.kind.number] if data.kind.scalar else []
        return cls(
            _as_stated(data, [f"q_{a}" for a in mechanism.actuators],
                       range(len(mechanism.actuators)),
                       ["" if bare else units.name(q) for q, bare in zip(
                           mechanism.actuator_quantity, mechanism.actuator_has_ratio, strict=True)],
                       mechanism.joint_factors(units).tolist()),
            _as_stated(data, AXES, range(2 if planar else 3), (units.length,) * 3,
                       (LENGTHS[units.length],) * 3),
            _as_stated(data, turns, (2,) if planar else range(3), (units.angle,) * 3,
                       (ANGLES[units.angle],) * 3),
            _as_stated(data, number, range(len(number)),
                       [units.name(data.kind.quantity) for _ in number],
                       [units.factor(data.kind.quantity) for _ in number]), data.convention)

    @property
    def sorts(self) -> tuple[ReadColumns, ...]:
        """All its columns, sort by sort."""
        return self.joints, self.places, self.turns, self.numbers

    @property
    def at(self) -> str:
        """The joint of the instrument, if another than declared; else empty."""
        return "" if self.kind is None else self.kind.at

    @property
    def parts(self) -> float:
        """Number of changes; a mirrored axis is preferred to exchanged ones."""
        return (sum(sort.parts for sort in self.sorts) + bool(self.rotation)
                + bool(self.mirror) + self.inverse + (self.shift != 0) + (self.kind is not None))

    def of(self, data: Dataset) -> Dataset:
        """Return the data set read in this way."""
        data = data if self.kind is None else at_joint(data, self.kind)
        position, rotation = self.measured(data)
        value = self.numbers.of(data.value[:, None])[:, 0] if self.numbers.own else data.value
        return shifted_rows(replace(data, q=self.joints.of(data.q), position=position,
                                    rotation=rotation, value=value, whole=None, place=None),
                            self.shift)

    def measured(self, data: Dataset) -> tuple[Array, Array]:
        """Return positions and rotation vectors (N, 3) of a data set read in this way."""
        position, rotation = self.places.of(data.position), data.rotation
        if self.rotation or self.turns.parts:
            raw = np.array(written(rotation, self.convention))
            raw[:, :3] = self.turns.of(raw[:, :3])
            rotation = understood(raw, self.rotation or self.convention)
        if self.mirror:
            position, rotation = mirrored(position, rotation, self.mirror)
        return (inverse_pose(position, rotation, len(self.places.own) == 2) if self.inverse
                else (position, rotation))

    def mistakes(self, data: Dataset) -> tuple[FileFault, ...]:
        """Return the mistakes of a file that this reading implies."""
        measured = (*AXES, *TURNS) if data.kind.sees_rotation else AXES
        written_in = QUATERNION if self.convention in QUATERNIONS else TURNS
        left, back, late = self.places.turned, self.turns.turned, self.shift > 0
        out = [*self.joints.mistakes("permuted"), *self.places.mistakes("exchanged", FileFault(
            "mirrored", left, f"{left[0]} has the other sign: that axis of the instrument points "
            "the other way") if len(left) == 1 else None)]
        if self.mirror:
            out.append(FileFault("mirrored", measured,
                                 "the poses are left-handed: the instrument's "
                                 f"{self.mirror} axis points the other way, or the mechanism file "
                                 "has the mirror image of the machine (home on the other side of "
                                 "the base, or legs numbered the other way round)"))
        if self.rotation:
            out.append(FileFault("rotation", written_in, f"{', '.join(written_in)} hold "
                                 f"{_in_words(self.rotation)}, not {_in_words(self.convention)}"))
        out += self.turns.mistakes("exchanged", FileFault(
            "rotation", written_in, "the rotations are inverse (transposed): the rotation of the "
            "measuring frame seen from the platform") if len(back) == 3 else None)
        if self.inverse:
            out.append(FileFault("inverse", measured, "the poses are inverse: the measuring frame "
                                 "seen from the platform"))
        if self.shift:
            out.append(FileFault("shifted", measured, "the measured columns are "
                                 f"{pluralize(abs(self.shift), 'row')} "
                                 f"{'behind' if late else 'ahead of'} the joint columns"))
        out += self.numbers.mistakes("exchanged")
        if self.kind is not None:
            out.append(FileFault("joint", self.numbers.names,
                                 f"the encoder is at {self.kind.at}, not at {data.kind.at}"))
        return tuple(out)

    def block(self, data: Dataset) -> dict[str, Any]:
        """Return the sidecar's block ``read`` for this reading.

        Present entries of the sidecar stay and are merged with those found; empty if only
        :meth:`headers` have to be changed.
        """
        out = self._block(data)
        joints, places, turns, numbers = (
            ReadColumns.as_declared(s.names, s.own, s.declared, s.factors) for s in self.sorts)
        as_is = ColumnInterpretation(joints, places, turns, numbers, data.convention)._block(data)
        return {} if (self.headers(data) or self.kind) and out == as_is else out

    def headers(self, data: Dataset) -> dict[str, str]:
        """Return the file's headers that contain a wrong unit, and their replacements.

        Header and sidecar must not name different units.
        """
        return {header: with_unit(header, unit) for sort in self.sorts
                for i in sort.own for unit in [sort.units[i]]
                for header, _ in [data.headed.get(sort.names[sort.order[i]], ("", ""))]
                if unit and header}

    def _block(self, data: Dataset) -> dict[str, Any]:
        old, headers, other = dict(data.read), dict(data.headers), self.headers(data)
        names = dict(old.get("columns", {}) if data.wide else headers)
        signs, units, every = dict[str, int](), dict[str, str](), list[str]()
        turned = self.mirror if data.wide and not data.kind.sees_rotation else ""
        for sort in self.sorts:
            for i in sort.own:
                plain, source = sort.names[i], sort.names[sort.order[i]]
                name = data.own_column(plain)
                every.append(name)
                if source != plain:
                    names[name] = headers.get(source, source)
                sign = sort.signs[i] * (-1 if plain == turned else 1)
                signs[name] = sign * _said(old.get("signs", {}), name, 1)
                if sort.units[i] and source not in data.headed:
                    units[name] = sort.units[i]
        rotation = self.rotation or old.get("rotation", "")
        inverse = self.inverse != (old.get("pose") == "inverse")
        here = "" if turned else self.mirror
        mirror = "" if here == old.get("mirror", "") else here or old["mirror"]
        if (inverse or mirror) and self.convention in QUATERNIONS:
            rotation = rotation or self.convention
        out = {"columns": {own: other.get(header, header) for own, header in names.items()
                           if own != header},
               "ignore": old.get("ignore"), "units": _stated(old.get("units", {}), units, every),
               "counts_per_turn": old.get("counts_per_turn"),
               "signs": {n: s for n, s in _stated(old.get("signs", {}), signs, every).items()
                         if s != 1}, "rotation": rotation,
               "pose": "inverse" if inverse else "", "mirror": mirror,
               "shift": self.shift + int(old.get("shift", 0))}
        return {key: value for key, value in out.items() if value}

    def sigma(self, data: Dataset, left: tuple[float, float]) -> dict[str, float]:
        """Return the sigma for a sidecar whose columns are in another unit than declared.

        Its unit follows the columns if the residuals then agree better with the noise: nobody
        writes values in one unit and their sigma in another, but makers of instruments state
        sigma in mm.

        Args:
            data: as it is read now.
            left: median errors of positions and rotations after a fit with this reading, m, rad.

        Returns:
            Entries of ``instrument.sigma``, in the sidecar's units; empty if unchanged.
        """
        out: dict[str, float] = {}
        turned = bool(self.numbers.own) and data.kind.quantity == "angle"
        for key, sort, miss, sigma in (
                ("position", self.places, left[0], data.sigma_position),
                ("rotation", self.turns, left[1], data.sigma_rotation),
                (data.kind.sigma, self.numbers, left[turned], data.sigma_value)):
            known = sigma[np.isfinite(sigma) & (sigma > 0.0)]
            unit = sort.units[-1] if sort.own else ""
            alike = known.size > 0 and np.ptp(known) <= 1e-9 * known[0]
            if not unit or not alike or len(set(sort.units)) > 1:
                continue
            factor, times = UNITS[unit] / sort.factors[0], miss / known[0]
            if times > 0.0 and abs(np.log(times / factor)) < abs(np.log(times)):
                out[key] = float(f"{factor * known[0] / sort.factors[0]:.6g}")
        return out


def _in_words(convention: str) -> str:
    """Return the contents of rotation columns, in words."""
    if convention.startswith("euler-"):
        order = convention.removeprefix("euler-")
        axes = "fixed" if order.islower() else "moving"
        return f"{order.upper()} Euler angles about {axes} axes ({convention})"
    return {"rotvec": "a rotation vector", "quat-xyzw": "a quaternion x, y, z, w",
            "quat-wxyz": "a quaternion w, x, y, z", "matrix": "a matrix"}[convention]
