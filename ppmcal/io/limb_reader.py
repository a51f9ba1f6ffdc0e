"""One limb of a mechanism file, checked against the slots of its kind.

The result is a draft: entries in SI, one per slot, not yet tied into parameters, because a
shared one may have its value in another limb.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, TypeVar

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.io.directions import square, to_nominal, unit
from ppmcal.io.effects import limb_entries
from ppmcal.io.mechanism_schema import (
    DirectionFile,
    SlotFile,
    SlotGroup,
    absent_axes,
    groups,
    point_parts,
    word,
)
from ppmcal.io.parameter_reader import Draft, SlotEntry
from ppmcal.io.schema import check, show, times
from ppmcal.linalg import Array
from ppmcal.model.limbs import LimbKind, find_kind, kinds
from ppmcal.model.limbs.chain import SlotSpec
from ppmcal.model.motions import Motion, motion_names, motions
from ppmcal.units import Units

T = TypeVar("T", SlotFile, DirectionFile)
NO_DRIVE = "none"
"""What ``actuator`` says of a passive limb."""


def limb_kind(raw: Mapping[Any, Any], motion: Motion, place: str) -> LimbKind:
    """Return the kind of a limb; a leading ``3-`` or ``6-`` is not part of it."""
    text = raw.get("kind")
    if text is None:
        raise BadInput("the key 'kind' is missing", place, "Add a line such as `kind: R(P)R`")
    if not isinstance(text, str):
        raise BadInput(f"{show(text)} is not a limb kind", f"{place}.kind",
                       "Write a kind such as R(P)R")
    kind = find_kind(re.sub(r"^[36]-", "", text.strip()), f"{place}.kind")
    kind = _of_those_called_so(kind, raw, motion, place)
    if kind.planar != motion.planar:
        there = " or ".join(motion_names(kind.planar))
        raise BadInput(f"{kind.name} is a kind for {there} motion, but the motion is {motion}",
                       f"{place}.kind", f"Write `motion: {there}`, or choose another kind")
    if kind.surface.angles and not motion.turns_freely:
        free = " or ".join(m.name for m in motions().values() if m.turns_freely)
        raise BadInput(f"a {kind.name} keeps the platform from turning, but in {motion} motion it "
                       "does not turn freely anyhow", f"{place}.kind",
                       f"Write `motion: {free}`, or choose another kind")
    return kind


def _of_those_called_so(kind: LimbKind, raw: Mapping[Any, Any], motion: Motion, place: str
                        ) -> LimbKind:
    """Return which of the kinds that files call alike is meant, by the motion and the pulley."""
    alike = [k for k in kinds().values() if kind.written and k.written == kind.written]
    base = raw.get("base")
    over = {k.pulley.key for k in alike if k.pulley and isinstance(base, dict)
            and k.pulley.key in base}
    if len(over) > 1:
        raise BadInput(f"{' and '.join(sorted(over))} are given, but a rope leaves over one pulley",
                       f"{place}.base", "Leave out one of them")
    fits = {k.pulley.key if k.pulley else "": k for k in alike if k.planar == motion.planar}
    for key in sorted(over - set(fits)):
        others = " or ".join(f"base.{k}" for k in fits if k) or "base.point"
        raise BadInput(f"a {key} turns out of the plane, in which {motion} motion stays",
                       f"{place}.base.{key}", f"Give {others}")
    return fits.get("".join(over), kind)


class LimbReader:
    """Reads the slots of one limb; ``source`` and ``units`` are the file's."""

    def __init__(self, raw: Mapping[Any, Any], name: str, kind: LimbKind, units: Units,
                 source: str, patterns: Sequence[str]) -> None:
        """Prepare; :meth:`read` does the work."""
        self.raw, self.kind, self.units, self.source = raw, kind, units, source
        self.patterns = patterns
        self.place = f"limbs.{name}"
        self.draft = Draft(name, kind, name)

    def read(self) -> Draft:
        """Return the draft.

        Raises:
            BadInput: an unknown, missing or ill-formed slot.
        """
        given = self._flatten()
        self.draft.actuator = self._actuator()
        self._branch()
        absent = absent_axes(self.kind, given, self.at)
        for group in groups(self.kind):
            path, raw = group.path, given.get(group.path)
            if path in absent:
                self.draft.absent += [(s.name, absent[path]) for s in group.slots]
            elif group.form == "direction":
                self._direction(group, self.kind.zeros.get(path), given)
            elif group.form == "first axis":
                self._first_axis(group, given)
            elif group.form == "joint frame":
                self._joint(group, raw)
            elif group.form == "point":
                self._point(group, raw)
            else:
                self._scalar(group.slots[0], raw)
        return self.draft

    def at(self, path: str) -> str:
        """Return ``file: limbs.leg1.path``."""
        return f"{self.source}: {self.place}" + (f".{path}" if path else "")

    def _flatten(self) -> dict[str, Any]:
        """Return group path -> raw value; refuse keys that the kind does not have."""
        wanted = [g.path for g in groups(self.kind)] + list(self.kind.zeros.values())
        tree = list(dict.fromkeys(path.partition(".")[0] for path in wanted))
        settings = ["name", "kind", "actuator", "stiffness",
                    *([self.kind.branch] if self.kind.branch else []), *limb_entries(self.kind)]
        out: dict[str, Any] = {}
        for key, value in self.raw.items():
            if key in settings:
                continue
            if key not in tree:
                error = unknown("key", key, [*settings, *tree])
                raise BadInput(f"{error.what} for the kind {self.kind.name}", self.at(""),
                               error.hint)
            self._spread(key, value, wanted, out)
        return out

    def _spread(self, path: str, value: Any, wanted: Sequence[str], out: dict[str, Any]) -> None:
        """Put what stands at a path, or below it, under the paths of its groups."""
        if path in wanted:
            out[path] = value
            return
        keys = list(dict.fromkeys(one.removeprefix(f"{path}.").partition(".")[0]
                                  for one in wanted if one.startswith(f"{path}.")))
        if not isinstance(value, dict):
            raise BadInput(f"{show(value)} is not a mapping", self.at(path),
                           f"Write keys with values here: {', '.join(keys)}")
        refuse_unknown("key", value, keys, self.at(path))
        for key, below in value.items():
            self._spread(f"{path}.{key}", below, wanted, out)

    def _actuator(self) -> str | None:
        name = self.draft.name
        if "actuator" in self.raw:
            name = word(self.raw["actuator"], self.at("actuator"))
        elif not self.kind.driven:
            return None
        if self.kind.driven and self.raw.get("actuator") == NO_DRIVE:
            passive = " or ".join(k.name for k in kinds().values() if not k.driven)
            raise BadInput(f"a {self.kind.name} without its drive leaves open what the drive holds",
                           self.at("actuator"), f"Choose a kind without a drive: {passive}. A "
                           f"joint variable cannot be called '{NO_DRIVE}'")
        if not self.kind.driven and name != NO_DRIVE:
            raise BadInput(f"a {self.kind.name} has no drive, but an actuator '{name}' is given",
                           self.at("actuator"), f"Write `actuator: {NO_DRIVE}`, or leave it out")
        return name if self.kind.driven else None

    def _branch(self) -> None:
        name = self.kind.branch
        if name is None or self.raw.get(name) is None:
            return
        value = self.raw[name]
        if isinstance(value, bool) or value not in (1, -1):
            raise BadInput(f"{show(value)} is not a branch", self.at(name), "Write 1 or -1")
        if value < 0 and self.kind.strut:
            raise BadInput(f"a {self.kind.name} has no other branch: its joint value is a distance "
                           "and never negative", self.at(name),
                           "Remove the line; where counts fall as the strut grows, `ratio` has the "
                           "minus sign")
        self.draft.branch = int(value)

    def _given(self, model: type[T], raw: Any, path: str) -> T:
        """Return a slot or a direction as the file has it: its value alone, or a mapping."""
        if isinstance(raw, dict):
            return check(model, raw, self.source, prefix=f"{self.place}.{path}")
        return check(model, {"value": raw}, self.source, lambda _: "", f"{self.place}.{path}")

    def _add(self, spec: SlotSpec, slot: SlotFile, joint: bool = False) -> None:
        """Turn a slot to SI and append it."""
        default = spec.default if slot.share is None or joint else None
        self.draft.entries.append(SlotEntry(
            f"{self.draft.name}.{spec.name}", self.at(spec.name), spec,
            times(slot, self.units.factor(spec.quantity)), default))
        if spec.tolerance_class != "ratio":
            self.draft.numbers += [(spec.quantity, v) for v in (slot.value, slot.nominal)
                                   if v is not None]

    def _scalar(self, spec: SlotSpec, raw: Any) -> None:
        if raw is None:
            if spec.tolerance_class == "ratio":
                return
            if spec.default is None:
                raise BadInput(f"the slot '{spec.name}' is missing", self.at(""),
                               f"The kind {self.kind.name} closes when {self.kind.closes_when}; "
                               f"add a line such as `{spec.name.rpartition('.')[2]}: 120`")
            standing = spec.tolerance_class != "offset"
            self.draft.entries.append(SlotEntry(
                f"{self.draft.name}.{spec.name}", self.at(spec.name), spec, SlotFile(),
                spec.default, standing))
        else:
            slot = self._given(SlotFile, raw, spec.name)
            if (spec.is_bar or spec.wheel) and slot.value is not None and slot.value <= 0.0:
                part = "pulley of radius" if spec.wheel else "rod of length"
                raise BadInput(f"a {part} {slot.value:g} is not possible",
                               self.at(spec.name), "Write a length greater than 0")
            if spec.name == "ratio" and slot.value == 0.0:
                raise BadInput("a ratio of 0 moves nothing", self.at(spec.name),
                               "Write the travel per unit of the joint variable")
            self._add(spec, slot)
        self.draft.direct.append(spec.name)

    def _joint(self, group: SlotGroup, raw: Any) -> None:
        """Frame components exist where the file gives them or ``free`` may name them."""
        names = group.parts
        if raw is not None and not isinstance(raw, dict):
            raise BadInput(f"{show(raw)} is not a mapping", self.at(group.path),
                           f"Write keys with values here: {', '.join(names)}")
        given: dict[Any, Any] = raw or {}
        refuse_unknown("joint frame component", given, names, self.at(group.path))
        for key, spec in names.items():
            path = f"{self.draft.name}.{spec.name}"
            if key in given or any(fnmatchcase(path, p) for p in self.patterns):
                slot = self._given(SlotFile, given[key], spec.name) if key in given else SlotFile()
                if slot.nominal is None and slot.share is None:
                    slot = slot.model_copy(update={"nominal": 0.0})
                self._add(spec, slot, joint=True)
                self.draft.direct.append(spec.name)

    def _point(self, group: SlotGroup, raw: Any) -> None:
        """A point: ``[x, y]``, ``{x, y}``, ``{radius, angle, z}`` or ``{value: [x, y]}``."""
        path, own = group.path, self.draft.name
        specs = group.parts | group.polar
        parts = point_parts(raw, list(group.parts), self.at(path))
        for axis, slot in parts.items():
            self._add(specs[axis], self._given(SlotFile, slot, specs[axis].name))
            if axis in group.parts:
                self.draft.direct.append(specs[axis].name)
        if "radius" in parts:
            radius, angle = (f"{own}.{s.name}" for s in group.polar.values())
            self.draft.polar.append((f"{path}.x", f"{path}.y", radius, angle))

    def _first_axis(self, group: SlotGroup, given: Mapping[str, Any]) -> None:
        """The first axis of a universal joint: with errors only where they can matter.

        That is where its offset is not nominally 0, or where the file speaks of them.
        """
        path = group.path
        offset = next(s.name for s in self.kind.axis_offsets if s.needs == path)
        slot = self._given(SlotFile, 0.0 if given.get(offset) is None else given[offset], offset)
        nominal = slot.value if slot.nominal is None else slot.nominal
        asked = isinstance(given[path], dict) and set(given[path]) - {"value"}
        names = [f"{self.draft.name}.{s.name}" for s in group.slots]
        if nominal or slot.share or asked or any(
                fnmatchcase(n, p) for n in names for p in self.patterns):
            self._direction(group, None, given)
        else:
            axis = self._direction_file(path, given[path])
            self.draft.constants[path] = unit(axis.value or [0.0, 0.0, 0.0], self.at(path))

    def _direction(self, group: SlotGroup, zero_name: str | None, given: Mapping[str, Any]
                   ) -> None:
        """A direction, with ``base.zero`` that turns with it where the kind has one."""
        path = group.path
        axis = self._direction_file(path, given.get(path))
        zero = self._direction_file(zero_name, given.get(zero_name), path) if zero_name else None
        if axis.value is None and axis.share is not None:
            self._take_turns(group, axis, np.zeros(3))
            if zero_name and zero is not None and zero.value is not None:
                self.draft.constants[zero_name] = unit(zero.value, self.at(zero_name))
            return
        now, nominal = self._pair(path, axis, zero_name, zero)
        if not group.slots:
            self._check_upright(path, axis, now[0])
        self.draft.constants[path] = now[0]
        if zero_name and now[1] is not None:
            self.draft.constants[zero_name] = now[1]
        self._take_turns(group, axis, to_nominal(now, nominal))

    def _check_upright(self, path: str, axis: DirectionFile, now: Array) -> None:
        """Refuse an axis in the plane that is not square to it, or that is said to have errors."""
        if np.any(now[:2] != 0.0):
            raise BadInput(f"{path} is not square to the plane of motion", self.at(path),
                           "Write [0, 0, 1] for a rope that runs round counterclockwise, or "
                           "[0, 0, -1]")
        extra = sorted(axis.model_fields_set - {"value"})
        if extra:
            raise BadInput(f"{path} has no '{extra[0]}' in the plane", self.at(path),
                           "Give the direction alone")

    def _direction_file(self, name: str, raw: Any, axis: str = "") -> DirectionFile:
        """Return a direction as the file has it; ``axis``: with which one it turns."""
        if raw is None:
            raise BadInput(f"the direction '{name}' is missing", self.at(""),
                           f"Add `{name.rpartition('.')[2]}: [0, 0, 1]` under "
                           f"`{name.rpartition('.')[0]}`")
        out = self._given(DirectionFile, raw, name)
        if out.value is None and (out.share is None or axis):
            raise BadInput("the direction has no value", self.at(name),
                           "Add `value: [0, 0, 1]`")
        extra = sorted(set(out.model_fields_set) - {"value", "nominal"})
        if axis and extra:
            raise BadInput(f"{name} turns with {axis} and has no '{extra[0]}' of its own",
                           self.at(name), f"Move it to {axis}")
        return out

    def _pair(self, group: str, axis: DirectionFile, zero_name: str | None,
              zero: DirectionFile | None) -> tuple[tuple[Array, Array | None],
                                                   tuple[Array, Array | None]]:
        """Return (axis, zero) now and nominal, normalised and square."""
        a = unit(axis.value or [0.0, 0.0, 0.0], self.at(group))
        a0 = a if axis.nominal is None else unit(axis.nominal, self.at(f"{group}.nominal"))
        if zero_name is None or zero is None or zero.value is None:
            return (a, None), (a0, None)
        place = self.at(zero_name)
        z = square(unit(zero.value, place), a, place, zero_name, group)
        if zero.nominal is None:
            return (a, z if axis.nominal is None else None), (a0, None)
        return (a, z), (a0, square(unit(zero.nominal, place), a0, f"{place}.nominal", zero_name,
                                 group))

    def _take_turns(self, group: SlotGroup, axis: DirectionFile, nominal: Array) -> None:
        """Append the small rotation that is a direction's error."""
        factor = self.units.factor("angle")
        shared = axis.share is not None and axis.value is None
        for i, (turn, spec) in enumerate(group.parts.items()):
            value, tolerance, sigma = (None if v is None else v[i] * factor for v in (
                axis.rotation, axis.tolerance, axis.sigma))
            given = SlotFile.model_construct(
                value=value, nominal=None if shared else float(nominal[i]), tolerance=tolerance,
                sigma=sigma, fixed=axis.fixed,
                share=None if axis.share is None else f"{axis.share}.{turn}")
            self.draft.entries.append(SlotEntry(
                f"{self.draft.name}.{spec.name}", self.at(group.path), spec, given, 0.0))
            self.draft.direct.append(spec.name)
        if axis.share is not None:
            self.draft.shared_directions[group.path] = axis.share
