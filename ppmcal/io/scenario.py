"""Reading a scenario file (contract section 3): what simulate is to measure, in SI."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.column_names import tension_columns
from ppmcal.io.effects import with_effects
from ppmcal.io.noise_limits import refuse_sigma
from ppmcal.io.pose_fields import COORDINATES, pose_from_map
from ppmcal.io.poses import read_poses
from ppmcal.io.scenario_schema import PosesFile, ScenarioFile
from ppmcal.io.schema import check, did_you_mean, is_number, show
from ppmcal.io.sidecar import of_sight, station_of, tracked
from ppmcal.io.sidecar_values import actuator_noise, frame_of, point_of, rotation_of
from ppmcal.io.yaml import IN_MEMORY, read_yaml
from ppmcal.limits import POSES, SIMULATED_ROWS
from ppmcal.linalg import Array
from ppmcal.model.dataset import ZERO_CELSIUS, Unknown
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Circle, GridPattern, Helix, Listed, Pattern, Random, Scenario
from ppmcal.units import Units


def read_scenario(path: str | os.PathLike[str] | Mapping[str, Any], mechanism: Mechanism
                  ) -> Scenario:
    """Return the scenario of a file, or of what such a file holds, everything in SI.

    Raises:
        BadInput: anything wrong in the file, with file, place and hint.
    """
    source, tree = (IN_MEMORY, dict(path)) if isinstance(path, Mapping) else (
        str(path), read_yaml(Path(path)))
    file = check(ScenarioFile, tree, source)
    units = file.units.units()
    machine = with_effects(mechanism, file.effects, units, source)
    length, angle = units.factor("length"), units.factor("angle")
    errors, scale = _errors(file.errors, mechanism, units, source)
    sigma = file.instrument.sigma
    kind = file.instrument.kind.located(file.instrument.at, mechanism, source)
    kind.refuse(mechanism.motion, mechanism.surplus, source, mechanism.gravity)
    if tracked(file.instrument, f"{source}: instrument.sigma"):
        of_sight(kind, f"{source}: instrument.sigma")
    own, of = kind.sigma_of(sigma), kind.quantity if kind.scalar else "length"
    for value, quantity in ((sigma.position, "length"), (own, of), (sigma.rotation, "angle")):
        # next to none is none; more than the machine could not be read again
        size = (value or 0.0) * units.factor(quantity)
        if size > (mechanism.reach if quantity == "length" else 1.0):
            refuse_sigma(np.array([size]), quantity, mechanism, units,
                         f"{source}: instrument.sigma")
    frame = _given(frame_of(file.frame, mechanism.motion, units, source), f"{source}: frame")
    target = _given(point_of(file.target, mechanism.motion, units, source), f"{source}: target")
    targets = _targets(file, kind, mechanism, units, source)
    _targets_moved(machine, targets, source)
    turn = _given(rotation_of(file.target_rotation, units, source), f"{source}: target_rotation")
    point = point_of(file.instrument.point or "known", mechanism.motion, units, source,
                     "instrument.point")
    joint = mechanism.joint_factors(units)
    poses = _poses(file.poses, mechanism, units, source, Path(source))
    _refuse_many(file, poses, source)
    warm = file.conditions.temperature
    return Scenario(
        source=source, units=units,
        poses=poses,
        errors=errors, error_scale=scale, kind=kind,
        sigma_position=(sigma.position or 0.0) * length,
        sigma_rotation=(sigma.rotation or 0.0) * angle,
        sigma_value=(own if own is not None else sigma.position or 0.0) * units.factor(of),
        sigma_actuator=actuator_noise(sigma.actuator, mechanism, joint, source),
        point=_given(point, f"{source}: instrument.point"),
        point_known=file.instrument.point in (None, "known"), frame=frame,
        frame_known=file.frame == "known", target=target, target_known=file.target == "known",
        target_rotation=turn, target_rotation_known=file.target_rotation == "known",
        ar=file.noise.ar, outliers=file.noise.outliers, tails=file.noise.tails,
        repeats=file.repeats, approach=file.approach, payload=tuple(file.conditions.payload),
        tension=_tensions(file.conditions.tension, mechanism, source),
        temperature=None if warm is None else (warm.mean + ZERO_CELSIUS, warm.swing),
        velocity=np.abs(actuator_noise(file.conditions.velocity, mechanism, joint, source)),
        with_effects=machine, seed=file.seed, pairs=_pairs(file, source),
        offset=_offset(file.instrument.offset, kind, units, f"{source}: instrument.offset"),
        tracker=None if sigma.range is None else (sigma.range * length,
                                                  (sigma.angle or 0.0) * angle),
        station=station_of(file.instrument, mechanism.motion, units, source), targets=targets)


def _targets(file: ScenarioFile, kind: InstrumentKind, mechanism: Mechanism, units: Units,
             source: str) -> dict[str, Array]:
    """Return the places of several targets on the platform (3,), by name; none of a single one."""
    place = f"{source}: targets"
    if file.targets is None:
        return {}
    if kind.scalar or not kind.of_poses:
        raise BadInput(f"the instrument '{kind}' is not simulated with several targets", place,
                       "Write one `target`, or `kind: position`")
    return {name: _given(point_of(raw, mechanism.motion, units, source, f"targets.{name}"),
                         f"{place}.{name}") for name, raw in file.targets.items()}


def _targets_moved(machine: Mechanism, targets: Collection[str], source: str) -> None:
    """Refuse an effect on a target that the scenario does not have."""
    for n, effect in enumerate(machine.effects, 1):
        place = f"{source}: effects[{n}].target"
        if effect.kind.target and not targets:
            raise BadInput("the scenario has one target only", place,
                           "Remove `target`, or write `targets: {T1: [0, 0, 0], T2: ...}`")
        refuse_unknown("target", [effect.kind.target] if effect.kind.target else [], targets,
                       place)


def _refuse_many(file: ScenarioFile, poses: Pattern, source: str) -> None:
    """Refuse more poses than are asked for in earnest, and more rows than a table may have."""
    POSES.refuse(poses.size, f"{source}: poses")
    rows = poses.size * file.repeats * (2 if file.approach == "both" else 1)
    settings = [len(v) for v in (file.conditions.payload, file.conditions.tension) if v]
    SIMULATED_ROWS.refuse(rows * math.prod(settings), f"{source}: repeats")


def _tensions(asked: list[float], mechanism: Mechanism, source: str) -> tuple[float, ...]:
    """Return the tensions to go through; refuse them where no ropes pull against each other."""
    if asked and not (mechanism.surplus and tension_columns(mechanism)):
        raise BadInput("no ropes of this machine pull against each other",
                       f"{source}: conditions.tension",
                       "Take it out; where ropes are not more than freedoms `payload` pulls them")
    return tuple(asked)


def _pairs(file: ScenarioFile, source: str) -> bool:
    """Whether distances are between two platform positions."""
    if file.instrument.between == "point":
        return False
    if not file.instrument.kind.along_line or file.instrument.point is not None:
        raise BadInput("only distances without a fixed point are between positions",
                       f"{source}: instrument.between", "Take out `between` or `point`")
    return True


def _offset(raw: object, kind: InstrumentKind, units: Units, place: str) -> float:
    """Return what an encoder at a joint reads more than is true, SI."""
    if raw == "known":
        return 0.0
    if kind.placed is None:
        raise BadInput(f"the instrument '{kind}' has no offset", place, "Take it out")
    return _number(raw, place, "12.5") * units.factor(kind.quantity)


def _given(value: Unknown, place: str) -> Array:
    """Return a value that a simulation needs; unknown and same_as make no sense there."""
    if value.fitted:
        raise BadInput("a simulation needs the true value, not an unknown one", place,
                       "Write known, or the value")
    return value.value


def _errors(raw: object, mechanism: Mechanism, units: Units, source: str
            ) -> tuple[dict[str, float], float | None]:
    """Return parameter errors by name in SI, and the scale of random ones."""
    place = f"{source}: errors"
    if raw is None:
        return {}, None
    if not isinstance(raw, dict):
        raise BadInput(f"{show(raw)} is not a mapping", place,
                       "Write {leg1.offset: 0.3} or {random: {scale: 1.0}}")
    scale: float | None = None
    by_name = {n: p for p in mechanism.parameters for n in (p.name, *p.aliases)}
    out: dict[str, float] = {}
    for name, value in raw.items():
        if name == "random":
            scale = _scale(value, place)
        elif name not in by_name:
            raise BadInput(f"unknown parameter '{name}'", place,
                           f"Parameters are called {', '.join(list(by_name)[:6])}, ...; joint "
                           "frame components exist where the limb gives them or `free` names "
                           f"them.{did_you_mean(name, by_name)}")
        else:
            p = by_name[name]
            out[p.name] = _number(value, f"{place}.{name}", "0.5") * units.factor(p.quantity)
    return out, scale


def _number(value: object, place: str, example: str) -> float:
    if not is_number(value):
        raise BadInput(f"{show(value)} is not a number", place, f"Write a number such as {example}")
    return float(value)


LARGEST_SCALE = 1e6


def _scale(value: object, place: str) -> float:
    scale = value.get("scale", 1.0) if isinstance(value, dict) and not (
        set(value) - {"scale"}) else None
    if not is_number(scale, LARGEST_SCALE) or scale < 0:
        raise BadInput(f"{show(value)} cannot be used here", f"{place}.random",
                       "Write {random: {scale: 1.0}}")
    return float(scale)


def _listed(path: Path, mechanism: Mechanism) -> Listed:
    """Return the poses of a CSV with the settings under which each is measured."""
    table = read_poses(path, mechanism)
    names = [*(f"{what}_{a}" for what in ("dir", "vel") for a in mechanism.actuators),
             *tension_columns(mechanism), "payload", "temperature"]
    columns = {n: table.environment[n] for n in names if n in table.environment}
    for name, values in columns.items():
        empty = np.flatnonzero(~np.isfinite(values))
        if empty.size:
            raise BadInput(f"'{name}' is empty", f"{path}: row {empty[0] + 1}",
                           "Fill it in, or leave the column out")
    labels = table.extra.get("pose")
    whole = labels is not None and not isinstance(labels, tuple) and bool(
        np.all(np.isfinite(labels)) and np.all(labels == np.round(labels)))
    return Listed(table.poses, str(path), columns,
                  np.asarray(labels, dtype=np.int64) if whole else None)


def _poses(file: PosesFile, mechanism: Mechanism, units: Units, source: str, path: Path
           ) -> Pattern:
    if file.file is not None:
        return _listed(path.parent / file.file, mechanism)

    def pose(raw: Any, where: str, rest: float) -> Array:
        """Return the pose (6,) of a mapping, ``rest`` where it says nothing."""
        out = pose_from_map(raw, mechanism.coordinates, units, source, where, needed=())
        return np.where(np.isnan(out), rest, out)

    def center(raw: Any, where: str) -> Array:
        out = pose(raw, where, np.nan)
        given = int(np.isfinite(out[list(mechanism.dof)]).sum())
        if given < mechanism.freedoms:
            raise BadInput(f"the center names {given} coordinates, but the machine has "
                           f"{mechanism.freedoms} freedoms", f"{source}: {where}",
                           f"Give {mechanism.freedoms} of "
                           f"{', '.join(mechanism.coordinates)}")
        return out

    length = units.factor("length")
    if file.circle is not None:
        c = file.circle
        return Circle(center(c.center, "poses.circle.center"), c.radius * length, c.count,
                      pose(c.swing or {}, "poses.circle.swing", 0.0))
    if file.grid is not None:
        g = file.grid
        counts = np.ones(6, dtype=np.int64)
        refuse_unknown("pose coordinate", g.counts, mechanism.coordinates,
                       f"{source}: poses.grid.counts")
        counts[[COORDINATES.index(name) for name in g.counts]] = [*g.counts.values()]
        return GridPattern(center(g.center, "poses.grid.center"),
                    pose(g.half_range, "poses.grid.half_range", 0.0), counts)
    if file.random is not None:
        r = file.random
        return Random(center(r.center, "poses.random.center"),
                      pose(r.half_range, "poses.random.half_range", 0.0), r.count)
    h = file.helix
    if h is None or mechanism.motion.planar:
        raise BadInput("a helix needs a machine that moves in z", f"{source}: poses.helix",
                       "Use circle, grid or random")
    return Helix(center(h.center, "poses.helix.center"), h.diameter * length, h.pitch * length,
                 h.turns, h.count)
