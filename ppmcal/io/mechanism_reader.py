"""Reading a mechanism file: from YAML to :class:`ppmcal.model.mechanism.Mechanism`, SI."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.io import parameter_reader as assemble
from ppmcal.io.directions import rotation, square, unit
from ppmcal.io.effects import with_effects, with_limb_entries
from ppmcal.io.limb_reader import LimbReader, limb_kind
from ppmcal.io.mechanism_blocks import (
    read_gaps,
    read_measured,
    read_registrations,
    read_stiffness,
)
from ppmcal.io.mechanism_schema import MechanismFile, TolerancesFile, word
from ppmcal.io.noise_limits import refuse_tolerances
from ppmcal.io.parameter_reader import Draft
from ppmcal.io.pose_fields import COORDINATES, pose_from_map
from ppmcal.io.schema import check, dotted
from ppmcal.io.yaml import IN_MEMORY, decimals, read_merged
from ppmcal.kinematics.closed_at_home import held_twice
from ppmcal.linalg import Array
from ppmcal.model.mechanism import PASSIVE, Limb, Mechanism
from ppmcal.model.motions import Motion
from ppmcal.model.parameters import NO_TOLERANCE, Parameter, free_indices, unmatched
from ppmcal.notes import NOTE, Note
from ppmcal.units import Units, coordinate_quantity, to_file
from ppmcal.wording import pluralize

log = logging.getLogger(__package__)


def read_mechanism(path: str | os.PathLike[str] | Mapping[str, Any]) -> Mechanism:
    """Return the mechanism of a file (contract section 1), everything in SI.

    Args:
        path: the YAML file; ``extends`` is followed relative to it. Or what such a file holds,
            as a mapping.

    Raises:
        BadInput: anything wrong in the file, with file, place and hint.
    """
    source = IN_MEMORY if isinstance(path, Mapping) else str(path)
    tree, inputs = read_merged(path)
    _right_format(tree, source)
    file = check(MechanismFile, tree, source, lambda loc: _place(loc, tree))
    units = file.units.units()
    drafts = _limbs(file, units, source)
    _agree_on_actuators(drafts, source)
    actuators = tuple(dict.fromkeys(d.actuator for d in drafts if d.actuator is not None))
    home_pose = pose_from_map(file.home.pose, file.motion.coordinates, units, source, "home.pose")
    made, tolerances, findings = _parameters(file, drafts, units, home_pose, source)
    patterns = None if file.free is None else tuple(file.free)
    optional = tuple(tuple(level) for level in file.optional or ())
    for missed in unmatched(made, [pattern for level in optional for pattern in level]):
        raise unknown("parameter", missed, [p.name for p in made], f"{source}: optional")
    factors = _joint_factors(drafts, actuators, units)
    index = {p.name: i for i, p in enumerate(made)}
    limbs = tuple(Limb(d.name, d.kind,
                       PASSIVE if d.actuator is None else actuators.index(d.actuator),
                       assemble.slot_map(d, index), d.constants, d.branch) for d in drafts)
    mechanism = Mechanism(
        name=file.name or Path(source).stem, motion=file.motion, limbs=limbs, actuators=actuators,
        parameters=made, free=tuple(free_indices(made, patterns)), home_pose=home_pose,
        home_q=_by_actuator(file.home.q, np.full(len(actuators), np.nan), actuators, factors,
                            f"{source}: home.q"),
        limits=_by_actuator(file.limits, np.tile([-np.inf, np.inf], (len(actuators), 1)),
                            actuators, factors, f"{source}: limits"),
        gravity=_gravity(file, source), units=units, free_patterns=patterns, optional=optional,
        gauge=file.gauge,
        registrations=read_registrations(file, units, source),
        measured=read_measured(file.measurement, units, actuators, factors, source),
        digits=_digits(file, drafts, units), findings=tuple(findings), source=source,
        inputs=inputs, stiffness=read_stiffness(file.stiffness, file.limbs, limbs, units, source),
        tolerances=tolerances, cost=_cost(file, source))
    _hold_once(mechanism)
    mechanism = replace(mechanism, gaps=read_gaps(file.closure, mechanism))
    machine = with_effects(with_limb_entries(mechanism, file.limbs, units, source), file.effects,
                           units, source)
    if patterns is not None:    # they may name parameters of effects, too
        machine = replace(machine, findings=(*machine.findings, *assemble.check_patterns(
            machine.parameters, drafts, patterns, source)))
    refuse_tolerances(machine)
    _remark(machine)
    return machine


def _right_format(tree: Mapping[str, Any], source: str) -> None:
    """Say what a file is before complaining of its keys."""
    kind = tree.get("format")
    if isinstance(kind, str) and kind.startswith(("ppmcal/dataset", "ppmcal/scenario")):
        raise BadInput(f"is a {kind} file, not a mechanism file", f"{source}: format",
                       "Give the mechanism file (format: ppmcal/mechanism/1) first")


def _place(location: Sequence[int | str], tree: Mapping[str, Any]) -> str:
    """Name limbs instead of counting them."""
    if len(location) > 1 and location[0] == "limbs" and isinstance(location[1], int):
        try:
            name = tree["limbs"][location[1]]["name"]
        except (KeyError, IndexError, TypeError):
            name = f"[{location[1] + 1}]"
        return dotted(("limbs", str(name), *location[2:]))
    return dotted(location)


def _limbs(file: MechanismFile, units: Units, source: str) -> list[Draft]:
    """Return the limbs as drafts; refuse duplicate names and a wrong number of conditions."""
    if not file.limbs:
        raise BadInput("there are no limbs", f"{source}: limbs", "Add at least one limb")
    drafts: list[Draft] = []
    for i, raw in enumerate(file.limbs):
        if "name" not in raw:
            raise BadInput("the key 'name' is missing", f"{source}: limbs[{i + 1}]",
                           f"Add a line such as `name: leg{i + 1}`")
        name = word(raw["name"], f"{source}: limbs[{i + 1}].name")
        if any(d.name == name for d in drafts):
            raise BadInput(f"two limbs are called '{name}'", f"{source}: limbs[{i + 1}].name",
                           "Give every limb its own name")
        kind = limb_kind(raw, file.motion, f"{source}: limbs.{name}")
        drafts.append(LimbReader(raw, name, kind, units, source, file.free or ()).read())
    _share_directions(drafts, source)
    equations = sum(d.kind.surface.equations for d in drafts)
    needed = len(file.motion.dof)
    if equations < needed:
        raise BadInput(
            f"the limbs put {equations} conditions on the platform, but a pose in {file.motion} "
            f"motion has {needed} coordinates", f"{source}: limbs",
            f"Give limbs with {needed} conditions or more, or change `motion`")
    _something_to_drive(drafts, equations, needed, file.motion, source)
    return drafts


def _something_to_drive(drafts: Sequence[Draft], equations: int, needed: int, motion: Motion,
                        source: str) -> None:
    """Refuse a machine without drives, or whose conditions without a drive hold the platform."""
    drives = len({d.actuator for d in drafts if d.actuator is not None})
    if not drives:
        raise BadInput("no limb has a drive", f"{source}: limbs",
                       "Add a limb with a driven joint, such as U(P)S")
    if equations - drives >= needed and any(d.kind.surface.angles for d in drafts):
        raise BadInput(
            f"the limbs put {equations} conditions on the platform and have {drives} drives: the "
            f"{equations - drives} that no drive changes hold all {needed} coordinates of a pose "
            f"in {motion} motion, or some of them twice", f"{source}: limbs",
            "Leave out limbs, or choose kinds that hold less, so that each thing is held once")


def _hold_once(mechanism: Mechanism) -> None:
    """Refuse limbs that hold rotations and together hold one of them twice."""
    if not mechanism.surplus or not any(limb.kind.surface.angles for limb in mechanism.limbs):
        return
    twice = held_twice(mechanism)
    if twice:
        raise BadInput(
            f"the limbs hold the platform twice: {twice} of the {mechanism.dependent} conditions "
            "that no drive changes say the same as others at home", f"{mechanism.source}: limbs",
            "Leave out limbs, or choose kinds that hold less, so that each thing is held once")


def _share_directions(drafts: Sequence[Draft], source: str) -> None:
    """Give limbs that share a direction by name its value."""
    values = {share: d.constants[group] for d in drafts
              for group, share in d.shared_directions.items() if group in d.constants}
    for d in drafts:
        for group, share in d.shared_directions.items():
            place = f"{source}: limbs.{d.name}.{group}"
            if share not in values:
                raise BadInput(f"the shared direction '{share}' has no value", place,
                               "Add `value: [0, 0, 1]` at one of its limbs")
            if not np.allclose(d.constants.get(group, values[share]), values[share], 0.0, 1e-12):
                raise BadInput(f"the shared direction '{share}' has two different values", place,
                               "Give it once, or the same everywhere")
            late = group not in d.constants
            d.constants[group] = values[share]
            zero = d.kind.zeros.get(group, "")
            if late and zero in d.constants:
                place = f"{source}: limbs.{d.name}.{zero}"
                d.constants[zero] = square(d.constants[zero], values[share], place, zero, group)
            names = (*d.kind.directions, *d.kind.axes)
            d.constants = {n: d.constants[n] for n in names if n in d.constants}


def _agree_on_actuators(drafts: Sequence[Draft], source: str) -> None:
    """Refuse limbs that share an actuator and disagree on what it measures."""
    first: dict[str, Draft] = {}
    names = {d.actuator for d in drafts}
    for d in drafts:
        if d.actuator is None:
            continue
        if d.actuator.endswith("_nominal") and d.actuator.removesuffix("_nominal") in names:
            raise BadInput(f"the joint '{d.actuator}' would have the column in which commands.csv "
                           f"has the uncorrected '{d.actuator.removesuffix('_nominal')}'",
                           f"{source}: limbs.{d.name}", "Rename it")
        other = first.setdefault(d.actuator, d)
        place = f"{source}: limbs.{d.name}.actuator"
        if other.kind.actuator != d.kind.actuator:
            raise BadInput(f"'{d.actuator}' is {_a(d.kind.actuator)} here but "
                           f"{_a(other.kind.actuator)} in {other.name}", place,
                           "Limbs that share an actuator must have the same actuated joint")
        if other.has_ratio != d.has_ratio:
            have, lack = (d, other) if d.has_ratio else (other, d)
            raise BadInput(f"{have.name} has a ratio and {lack.name} has none, but both name the "
                           f"actuator '{d.actuator}'", place, "Give both a ratio, or neither")


def _a(what: str) -> str:
    return f"an {what}" if what == "angle" else f"a {what}"


def _parameters(file: MechanismFile, drafts: Sequence[Draft], units: Units, home_pose: Array,
                source: str) -> tuple[tuple[Parameter, ...], dict[str, float], list[Note]]:
    """Return all parameters, the class tolerances, file units, and a warning for each default."""
    given = {} if file.tolerances is None else file.tolerances.model_dump(exclude_none=True)
    made, waiting = assemble.parameters(drafts, given, units)
    if not waiting:
        return made, given, []
    default = {"length": 1e-3 * _reach(drafts, made, home_pose), "angle": 1e-3}
    made = tuple(replace(p, tolerance=default[p.quantity]) if p.name in waiting else p
                 for p in made)
    findings, said = list[Note](), set()
    for p in made:
        if p.name not in waiting:
            continue
        number = to_file(p.tolerance or 0.0, units.factor(p.quantity))
        given.setdefault(p.tolerance_class, number)
        if not p.fixed and (p.tolerance_class, p.quantity) not in said:
            said.add((p.tolerance_class, p.quantity))
            why = "1/1000 of the reach" if p.quantity == "length" else "1e-3 rad"
            findings.append(Note(
                f"{source}: tolerances: no tolerance is given for '{p.tolerance_class}'; "
                f"{number:.6g} {units.name(p.quantity)} ({why}) is used. Add it to `tolerances`.",
                NOTE, NO_TOLERANCE))
    return made, {c: given[c] for c in TolerancesFile.model_fields if c in given}, findings


def _reach(drafts: Sequence[Draft], made: Sequence[Parameter], home_pose: Array) -> float:
    """Return the largest distance between joints at home, m."""
    index = {p.name: i for i, p in enumerate(made)}
    g = np.array([p.value for p in made])
    turn, points = rotation(home_pose[3:]), []
    for d in drafts:
        v = assemble.slot_map(d, index).values(g)
        points.append(np.array([v.get(f"{d.kind.point('base')}.{a}", 0.0) for a in "xyz"]))
        own = np.array([v.get(f"{d.kind.point('platform')}.{a}", 0.0) for a in "xyz"])
        points.append(turn @ own + home_pose[:3])
    all_ = np.array(points)
    return float(np.max(np.linalg.norm(all_[:, None] - all_[None], axis=-1))) or 1.0


def _joint_factors(drafts: Sequence[Draft], actuators: Sequence[str], units: Units) -> Array:
    """Return the SI value of one file unit of each joint variable (k,); 1 with a ratio."""
    first = {d.actuator: d for d in reversed(drafts) if d.actuator is not None}
    return np.array([1.0 if first[a].has_ratio else units.factor(first[a].kind.actuator)
                     for a in actuators])


def _by_actuator(given: Mapping[str, Any] | None, out: Array, actuators: Sequence[str],
                 factors: Array, place: str) -> Array:
    """Return ``out`` with what is given for actuators, SI, in the rows of these."""
    refuse_unknown("actuator", given or {}, actuators, place)
    for name, value in (given or {}).items():
        i = actuators.index(name)
        out[i] = np.array(value) * factors[i]
    return out


def _gravity(file: MechanismFile, source: str) -> Array:
    if file.gravity is None:
        return file.motion.gravity
    if len(file.gravity) == 2 and file.motion.axes == 3:
        raise BadInput("two numbers cannot be a direction in space", f"{source}: gravity",
                       "Write three, such as [0, 0, -1]")
    return unit([*file.gravity, 0.0][:3], f"{source}: gravity")


def _cost(file: MechanismFile, source: str) -> dict[str, tuple[float, float]]:
    refuse_unknown("class of slots", file.cost or {}, TolerancesFile.model_fields,
                   f"{source}: cost")
    return {name: (c.weight, c.exponent) for name, c in (file.cost or {}).items()}


def _digits(file: MechanismFile, drafts: Sequence[Draft], units: Units) -> dict[str, float]:
    """Return half of the last printed digit of lengths and angles, SI; 0 where none stands."""
    printed = [n for d in drafts for n in d.numbers]
    pose = file.home.pose if isinstance(file.home.pose, dict) else {}
    printed += [(coordinate_quantity(c), float(pose[c])) for c in COORDINATES
                if pose.get(c) is not None]
    first = {d.actuator: d for d in reversed(drafts) if d.actuator is not None}
    printed += [(first[a].kind.actuator, v) for a, v in (file.home.q or {}).items()
                if not first[a].has_ratio]
    out = {}
    for q in ("length", "angle"):
        places = [decimals(v) for kind, v in printed if kind == q]
        out[q] = 0.5 * 10.0 ** -max(places) * units.factor(q) if places else 0.0
    return out


def _remark(machine: Mechanism) -> None:
    """Log what a mechanism file says."""
    if not log.isEnabledFor(logging.INFO):
        return
    kinds = ", ".join(dict.fromkeys(limb.kind.name for limb in machine.limbs))
    default = "" if machine.free_patterns is not None else " (those with a tolerance, by default)"
    effects = ", ".join(e.kind.name for e in machine.effects) or "none"
    log.info("%s: %s, %s %s, units %s and %s; %d of %d parameters free%s; effects: %s",
             machine.source, machine.motion, pluralize(len(machine.limbs), "limb"), kinds,
             machine.units.length, machine.units.angle, len(machine.free),
             len(machine.parameters), default, effects)
