"""Writing a mechanism as a file that reads back as the same machine."""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from ppmcal.io.directions import rotation
from ppmcal.io.effects import effects_tree
from ppmcal.io.limb_reader import NO_DRIVE
from ppmcal.io.mechanism_blocks import gaps_tree, measurement_tree, stiffness_trees
from ppmcal.io.mechanism_schema import FORMAT, SlotGroup, groups
from ppmcal.io.pose_fields import pose_to_map
from ppmcal.io.yaml import dump_yaml
from ppmcal.model.limbs.chain import SlotSpec
from ppmcal.model.mechanism import Limb, Mechanism
from ppmcal.model.parameters import Parameter, free_indices
from ppmcal.units import to_file


class SlotWriter:
    """Writes the limbs of one mechanism."""

    def __init__(self, mechanism: Mechanism) -> None:
        """Prepare; :meth:`limb` does the work."""
        self.mechanism = mechanism
        self.written: set[str] = set()
        self.slots = [dict(_slots(limb)) for limb in mechanism.limbs]

    def limb(self, index: int) -> dict[str, Any]:
        """Return one limb as plain data."""
        limb = self.mechanism.limbs[index]
        out: dict[str, Any] = {"name": limb.name, "kind": limb.kind.called}
        actuator = self.mechanism.actuators[limb.actuator] if limb.driven else NO_DRIVE
        if actuator != limb.name:
            out["actuator"] = actuator
        for group in groups(limb.kind):
            for path, value in self._group(index, limb, group):
                *above, last = path.split(".")
                part = out
                for key in above:
                    part = part.setdefault(key, {})
                part[last] = value
        if limb.kind.branch and limb.branch is not None:
            out[limb.kind.branch] = limb.branch
        return out

    def _group(self, index: int, limb: Limb, group: SlotGroup) -> Iterator[tuple[str, Any]]:
        """Yield (path, plain data) of one point, direction, joint frame or slot."""
        slots, path = self.slots[index], group.path
        if group.form == "direction" or (group.form == "first axis" and path in limb.constants):
            yield from self._directions(index, limb, group)
        elif group.form == "point":
            names = [s.name for s in group.slots]
            if f"{path}.radius" in slots:
                names = [*(s.name for s in group.polar.values()), *names[2:]]
            parts = {n.rpartition(".")[2]: self._slot(limb, n, slots[n]) for n in names}
            plain = "radius" not in parts and not any(isinstance(v, dict) for v in parts.values())
            yield path, list(parts.values()) if plain else parts
        elif group.form != "first axis":
            for spec in group.slots:
                if spec.name in slots and not self._silent(limb, spec, slots[spec.name]):
                    yield spec.name, self._slot(limb, spec.name, slots[spec.name])

    def _silent(self, limb: Limb, spec: SlotSpec, index: int) -> bool:
        """Whether a slot may be left out, because reading makes the same of nothing."""
        p = self.mechanism.parameters[index]
        if p.aliases or p.value != 0.0 or p.nominal != 0.0 or p.sigma is not None:
            return False
        if spec.default == 0.0 and spec.tolerance_class == "length":
            return p.fixed and p.tolerance is None
        plain = not isinstance(self._slot(limb, spec.name, index), dict)
        if spec.tolerance_class == "offset":
            return plain
        patterns = self.mechanism.free_patterns or ()
        return (spec.name.startswith("joint") and plain
                and any(fnmatchcase(p.name, pattern) for pattern in patterns))

    def _own(self, p: Parameter) -> dict[str, Any]:
        """Return the keys ``tolerance`` and ``fixed`` as far as the class does not say it."""
        out: dict[str, Any] = {}
        class_tolerance = self.mechanism.class_tolerance(p.tolerance_class, p.quantity)
        if p.tolerance is not None and (p.tolerance != class_tolerance or p.sigma is not None):
            out["tolerance"] = to_file(p.tolerance, self._factor(p))
        if p.fixed and p.tolerance != 0.0 and not (p.per_unit and p.tolerance is None):
            out["fixed"] = True
        return out

    def _factor(self, p: Parameter) -> float:
        return self.mechanism.units.factor(p.quantity)

    def _slot(self, limb: Limb, name: str, index: int) -> Any:
        """Return a number, or ``{value, nominal, sigma, tolerance, fixed, share}``."""
        p = self.mechanism.parameters[index]
        if p.aliases and p.name in self.written:
            return {"share": p.name}
        factor = self._factor(p)
        value, nominal = to_file(p.value, factor), to_file(p.nominal, factor)
        implied = 0.0 if name.startswith("joint") and not p.aliases else p.value
        out: dict[str, Any] = {"value": value}
        if p.nominal != implied or p.sigma is not None:
            out["nominal"] = nominal
        if p.sigma is not None:
            out["sigma"] = to_file(p.sigma, factor)
        out.update(self._own(p))
        if p.aliases:
            self.written.add(p.name)
            out["share"] = p.name
        return value if len(out) == 1 else out

    def _directions(self, index: int, limb: Limb, group: SlotGroup) -> Iterator[tuple[str, Any]]:
        """Yield the axis, and ``base.zero`` which turns with it."""
        path, first_axis = group.path, group.form == "first axis"
        if not group.slots:
            for name in (path, limb.kind.zeros[path]):
                yield name, [float(v) for v in limb.constants[name]]
            return
        if first_axis and group.slots[0].name not in self.slots[index]:
            yield path, [float(v) for v in limb.constants[path]]
            return
        parts = [self.mechanism.parameters[self.slots[index][s.name]] for s in group.slots]
        turn, nominal = (np.array([getattr(p, n) for p in parts]) for n in ("value", "nominal"))
        carries = any(s.startswith("joint") for s in self.slots[index]) or any(
            a in limb.constants for a in limb.kind.axes)
        zero = limb.kind.zeros.get(path)
        apart = first_axis or (zero is None and carries)
        for name in (path, zero) if zero else (path,):
            constant = limb.constants[name]
            now = constant if apart or not turn.any() else rotation(turn) @ constant
            out: dict[str, Any] = {"value": [float(v) for v in now]}
            if turn.any() or nominal.any():
                out["nominal"] = [float(v) for v in rotation(nominal) @ constant]
            if name == path:
                if apart and turn.any():
                    out["rotation"] = [to_file(float(v), self._factor(parts[0])) for v in turn]
                out = self._direction_keys(parts, out)
            yield name, out["value"] if list(out) == ["value"] else out

    def _direction_keys(self, parts: list[Parameter], out: dict[str, Any]) -> dict[str, Any]:
        """Return ``out`` with sigma, tolerance, fixed and share of a direction's error."""
        share = parts[0].name.removesuffix(".rx") if parts[0].aliases else None
        if share is not None and parts[0].name in self.written:
            return {"share": share}
        factor = self._factor(parts[0])
        if any(p.sigma is not None for p in parts):
            out["sigma"] = [to_file(p.sigma or 0.0, factor) for p in parts]
        own = [self._own(p) for p in parts]
        if any("tolerance" in o for o in own):
            tolerances = [to_file(p.tolerance or 0.0, factor) for p in parts]
            out["tolerance"] = tolerances[0] if len(set(tolerances)) == 1 else tolerances
        if all(p.fixed for p in parts) and any("fixed" in o for o in own):
            out["fixed"] = True
        if share is not None:
            self.written.add(parts[0].name)
            out["share"] = share
        return out


def _slots(limb: Limb) -> Iterator[tuple[str, int]]:
    """Yield (slot name, parameter index), radius and angle for polar points."""
    yield from limb.slots.direct
    for x, _, radius, angle in limb.slots.polar:
        group = x.rpartition(".")[0]
        yield f"{group}.radius", radius
        yield f"{group}.angle", angle


def write_mechanism(mechanism: Mechanism, comment: str = "") -> str:
    """Return the text of an equivalent mechanism file, in ``mechanism.units``.

    Numbers have as many digits (at most 17) as it takes to read back equal. A slot is a plain
    number where that loses nothing, else ``{value, nominal, sigma, tolerance, fixed, share}``.
    Directions are written as they stand now, with the nominal ones beside; see
    :mod:`ppmcal.io.directions`. ``comment``: lines to put at the top.
    """
    writer = SlotWriter(mechanism)
    stiffness, own = stiffness_trees(mechanism)
    tree: dict[str, Any] = {
        "format": FORMAT, "name": mechanism.name,
        "units": {"length": mechanism.units.length, "angle": mechanism.units.angle},
        "motion": mechanism.motion.name,
        "limbs": [{**writer.limb(i), **own[i]} for i in range(len(mechanism.limbs))],
        "home": _home(mechanism),
    }
    usual = np.array_equal(mechanism.gravity, mechanism.motion.gravity)
    free = _free(mechanism)
    further = {
        "tolerances": dict(mechanism.tolerances), "limits": _limits(mechanism),
        "gravity": [] if usual else [float(v) for v in mechanism.gravity],
        "effects": effects_tree(mechanism), "stiffness": stiffness,
        "cost": {name: {"weight": w, "exponent": e} for name, (w, e) in mechanism.cost.items()},
        "free": free, "gauge": "" if mechanism.gauge == "base" else mechanism.gauge,
        "closure": gaps_tree(mechanism),
        "optional": [list(level) for level in mechanism.optional],
        "measurement": measurement_tree(mechanism)}
    # no parameter free says something, whatever else is empty does not
    tree |= {key: value for key, value in further.items() if value or (key, value) == ("free", [])}
    return dump_yaml(tree, comment)


def _home(mechanism: Mechanism) -> dict[str, Any]:
    pose = pose_to_map(mechanism.home_pose, mechanism.coordinates, mechanism.units)
    q = {name: to_file(float(v), float(f)) for name, v, f in zip(
        mechanism.actuators, mechanism.home_q, mechanism.joint_factors(), strict=True)
        if np.isfinite(v)}
    return {"pose": pose, "q": q} if q else {"pose": pose}


def _limits(mechanism: Mechanism) -> dict[str, list[float]]:
    return {name: [to_file(float(v), float(f)) for v in pair] for name, pair, f in zip(
        mechanism.actuators, mechanism.limits, mechanism.joint_factors(), strict=True)
        if np.isfinite(pair).any()}


def _free(mechanism: Mechanism) -> list[str] | None:
    """Return the ``free`` list: the file's patterns, or names where the choice is another."""
    patterns = mechanism.free_patterns
    if tuple(free_indices(mechanism.parameters, patterns)) == tuple(mechanism.free):
        return None if patterns is None else list(patterns)
    return [mechanism.parameters[i].name for i in mechanism.free]
