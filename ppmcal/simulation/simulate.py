"""Simulated measurements of a machine whose true geometry is not the nominal one.

The controller converts wanted poses to joint values with the nominal machine; the true machine
goes where its own closure puts it; the instrument measures that pose from its frame, at its
target, with noise. The true values are kept separately, in truth.json.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.calibration.fit import stretched
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import with_strokes
from ppmcal.kinematics.equilibrium import consistent_joints, gaping, reached_poses
from ppmcal.kinematics.instrument_readings import sensor_turn
from ppmcal.kinematics.joint_readings import JointReading
from ppmcal.kinematics.loads import loads, pretensions
from ppmcal.kinematics.needed_columns import ORDER, missing_columns, remembers
from ppmcal.kinematics.registration import displaced, predict
from ppmcal.linalg import Array, Ints, finite_rows
from ppmcal.model.dataset import Environment, environment, tracker_noise
from ppmcal.model.effects import Shift
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.simulation.pose_patterns import commands
from ppmcal.simulation.scenario import Scenario
from ppmcal.wording.progress import stage

SECONDS_PER_ROW = 60.0
OUTLIER_SIGMAS = 20.0


@dataclass(frozen=True)
class Campaign:
    """A simulated campaign of N rows, SI.

    ``pose`` labels (N,); ``q`` according to the controller (N, k); ``position`` (N, 3) and
    ``rotation`` vector (N, 3) as measured, or angles, each in the component of its coordinate;
    ``targets``: the same by name, if several are on the platform: ``position`` and ``rotation``
    are those of the first;
    ``value`` a height, distance or joint reading (N,), otherwise nan;
    ``to_q`` (N, k) joint values at the other end of a distance between two positions;
    ``direction`` of approach by joint (N, k);
    ``velocity`` of the joints at the trigger (N, k); ``tension`` of ropes (N, k), N, nan for other
    joints, or None; ``payload`` kg, ``temperature`` K,
    ``time`` s (N,); ``outlier`` rows; ``with_effects`` the machine with its effects and ``g`` its
    true parameters (P,); ``left_out`` reasons for poses that could not be measured.
    """

    pose: Ints
    q: Array
    position: Array
    rotation: Array
    value: Array
    direction: Array
    velocity: Array | None
    payload: Array | None
    temperature: Array | None
    time: Array
    outlier: NDArray[np.bool_]
    with_effects: Mechanism
    g: Array
    left_out: tuple[str, ...]
    to_q: Array | None = None
    tension: Array | None = None
    targets: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)


@stage("simulating")
def simulate(mechanism: Mechanism, scenario: Scenario, seed: int | None = None) -> Campaign:
    """Return a simulated campaign.

    Args:
        mechanism: the machine as the controller knows it (its nominals).
        scenario: what to measure and with which instrument.
        seed: in place of the scenario's.

    Raises:
        BadInput: an instrument that is not simulated, or no pose inside the workspace.
        NoResult: the true machine cannot reach any pose.
    """
    scenario.kind.refuse(mechanism.motion, mechanism.surplus, scenario.source, mechanism.gravity)
    rng = np.random.default_rng(scenario.seed if seed is None else seed)
    q, left_out, listed = commands(mechanism.nominal(), scenario, rng)
    own = listed.columns if listed else {}
    _once(scenario, own)
    if scenario.pairs and len(q) < 2:
        raise BadInput("one pose has no distance to another", f"{scenario.source}: poses",
                       "Ask for more poses")
    g = true_parameters(mechanism, scenario, rng)
    order, direction, payload, pull = _visits(q, scenario, rng)
    direction = _own(own, "dir", mechanism, direction, order)
    payload = own["payload"][order] if "payload" in own else payload
    n = order.size
    time = SECONDS_PER_ROW * np.arange(1, n + 1, dtype=np.float64)
    temperature = own["temperature"][order] if "temperature" in own else _temperature(
        scenario, time)
    velocity = _own(own, "vel", mechanism,
                    direction * scenario.velocity * _speeds(scenario, direction.shape, rng), order)
    # for two positions in one row, the order is unknown
    visited = np.full_like(direction, np.nan) if scenario.pairs else q[order]
    rows = replace(
        _environment(mechanism, direction, velocity, payload, temperature, time, visited),
        touch=np.full(n, scenario.kind.touches))
    tension = _tensions(mechanism, q[order], rows, pull, {
        name: column[order] for name, column in own.items()})
    rows = replace(rows, tension=tension)
    with_effects = with_strokes(scenario.with_effects, q)
    model = Model(with_effects, g)
    _recorded(with_effects, rows, scenario)
    joints, actual, shift, inside = _visited(model, q[order], rows, scenario, rng)
    # a distance between two positions: from each to the one half a campaign away
    other = (order + len(q) // 2) % len(q)
    there, ends, moved, _ = _visited(model, q[other], rows, scenario, rng) if scenario.pairs else (
        joints, actual, shift, None)
    keep = finite_rows(actual) & finite_rows(ends)
    if not keep.all() and remembers(with_effects):
        raise BadInput(f"pose {order[~keep][0]} cannot be reached, and an effect depends on the "
                       "moves to and from it", f"{scenario.source}: poses",
                       "Choose poses further inside")
    if not keep.any():
        raise NoResult("the machine with these errors cannot reach any of the poses",
                       scenario.source, "Inject smaller errors or choose other poses")
    left_out += [f"pose {p}: the machine with its errors cannot go there"
                 for p in np.unique(order[~keep])]
    stretch = None if shift is None else shift.stretch
    shown = None if stretch is None else stretch[keep] if len(stretch) > 1 else stretch
    seen = {name: _measured(
        _displaced(actual, shift, name)[keep], _displaced(ends, moved, name)[keep], shown, at,
        mechanism, scenario, rng) for name, at in scenario.places.items()}
    position, rotation, value, _ = next(iter(seen.values()))
    outlier = np.any([own for *_, own in seen.values()], axis=0)
    if scenario.kind.placed is not None and inside is not None:
        value += scenario.offset + inside.value[keep]
    labels = order if listed is None or listed.labels is None else listed.labels[order]
    return Campaign(labels[keep], joints[keep], position, rotation, value, direction[keep],
                    velocity[keep] if np.any(velocity) else None,
                    payload[keep] if payload is not None else None,
                    temperature[keep] if temperature is not None else None, time[keep],
                    outlier, with_effects, g, tuple(left_out),
                    there[keep] if scenario.pairs else None,
                    None if tension is None else tension[keep],
                    {n: (at, turn) for n, (at, turn, *_) in seen.items()} if scenario.targets
                    else {})


def _own(own: Mapping[str, Array], what: str, mechanism: Mechanism, rest: Array, order: Ints
         ) -> Array:
    """Return directions or speeds (rows, k): those of the file of poses, otherwise ``rest``."""
    out = rest.copy()
    for a, name in enumerate(mechanism.actuators):
        if f"{what}_{name}" in own:
            out[:, a] = own[f"{what}_{name}"][order]
    return out


def _once(scenario: Scenario, own: Mapping[str, Array]) -> None:
    """Reject settings that are both in the scenario and in its file of poses."""
    twice = {"payload": ("conditions.payload", bool(scenario.payload)),
             "temperature": ("conditions.temperature", scenario.temperature is not None),
             "tension": ("conditions.tension", bool(scenario.tension)),
             "dir": ("approach", scenario.approach != "one"),
             "vel": ("conditions.velocity", bool(np.any(scenario.velocity)))}
    for name in own:
        place, given = twice[name.partition("_")[0]]
        if given:
            raise BadInput(f"the file of poses has its own column {name}",
                           f"{scenario.source}: {place}", "Take it out of the scenario, or the "
                           "column out of the file")


def _displaced(pose: Array, shift: Shift | None, target: str) -> Array:
    """Return poses (n, 8) as seen by the instrument, with the displacements of one target."""
    return displaced(pose, None if shift is None else shift.of(target))


def _measured(pose: Array, other: Array, stretch: Array | None, target: Array,
              mechanism: Mechanism, scenario: Scenario, rng: np.random.Generator
              ) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return the instrument's readings of a target (3,) at poses (n, 8), and which are outliers.

    Positions (n, 3), rotation vectors (n, 3), heights or distances (n,); distances between two
    positions are to the poses ``other``.
    """
    registration = Registration.of_pose(scenario.frame, target, scenario.target_rotation)
    position, turn = predict(registration, pose)
    position = stretched(position, stretch)
    far = stretched(predict(registration, other)[0], stretch) if scenario.pairs else scenario.point
    error, outlier = _errors(position, scenario, rng)
    value = np.full(len(position), np.nan) if not scenario.kind.scalar else error[:, 0]
    if scenario.kind.value is not None:
        value = scenario.kind.value(position, far) + error[:, 0]
    if scenario.kind.of_turn is not None:
        angles = error[:, 3:]
        places = [c - 3 for c in scenario.kind.coordinates(mechanism.motion)]
        angles[:, places] += scenario.kind.of_turn(
            sensor_turn(mechanism, registration, pose)[1], mechanism.motion)[0]
        return position + error[:, :3], angles, value, outlier
    return position + error[:, :3], _turned(turn, error[:, 3:], mechanism), value, outlier


@stage("moving the machine")
def _visited(model: Model, q: Array, rows: Environment, scenario: Scenario,
             rng: np.random.Generator
             ) -> tuple[Array, Array, Shift | None, JointReading | None]:
    """Return joint values as recorded, poses (N, 8) reached, and the shifts of effects there.

    Also the reading of a joint with an encoder, if there is one.

    ``q`` (N, k) are the commands. A redundant machine records where its limbs are, except for
    their gaps.
    """
    q, real = consistent_joints(model, q, rows)
    gaps = model.mechanism.gap_sigma
    if gaps.any():
        q, real = gaping(q, real, rng.normal(size=(len(q), len(gaps))) * gaps)
    actual, true, at = real.pose, q, real
    if np.any(scenario.sigma_actuator > 0.0):
        shaken = q + rng.normal(size=q.shape) * scenario.sigma_actuator
        if model.mechanism.surplus:
            q = shaken
        else:
            at = reached_poses(model, shaken, rows, start=real.closed, start_q=q)
            actual, true = at.pose, shaken
    inside = None if scenario.kind.placed is None else JointReading(
        at.model.closure(true), at.closed, scenario.kind.at)
    return q, actual, real.model.shift, inside


def _environment(mechanism: Mechanism, direction: Array, velocity: Array, payload: Array | None,
                 temperature: Array | None, time: Array, q: Array) -> Environment:
    columns = {"time": time}
    for a, name in enumerate(mechanism.actuators):
        columns[f"dir_{name}"], columns[f"vel_{name}"] = direction[:, a], velocity[:, a]
    if payload is not None:
        columns["payload"] = payload
    if temperature is not None:
        columns["temperature"] = temperature
    return replace(environment(columns, mechanism.actuators, mechanism.gravity, q),
                   row=np.arange(1.0, len(time) + 1.0))


def _recorded(with_effects: Mechanism, rows: Environment, scenario: Scenario) -> None:
    """Reject effects that depend on conditions that the scenario does not set."""
    tight = "conditions: {tension: [20, 80]}"
    hint = {f"tension_{a}": tight for a in with_effects.actuators} | {
            "payload": "conditions: {payload: [0, 20]}",
            "temperature": "conditions: {temperature: {mean: 20, swing: 4}}"}
    missing = missing_columns(with_effects, rows)
    if ORDER in missing:
        raise BadInput("an effect depends on the order of the rows, which the scenario does not "
                       "set", f"{scenario.source}: approach", f"Write `{ORDER}`")
    if missing:
        raise BadInput(f"an effect depends on {missing[0]}, which the scenario does not set",
                       f"{scenario.source}: conditions", f"Add `{hint[missing[0]]}`")


def _speeds(scenario: Scenario, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Return random joint speeds as fractions of the largest, from a fifth up; 0 if none is set."""
    if not np.any(scenario.velocity):
        return np.zeros(shape)
    return rng.uniform(0.2, 1.0, shape)


def true_parameters(mechanism: Mechanism, scenario: Scenario, rng: np.random.Generator) -> Array:
    """Return the true parameters (P,): nominal, named errors, errors drawn from tolerances.

    Effects have the values given in the files; they come last.
    """
    with_effects = scenario.with_effects
    g = with_effects.nominals.copy()
    count = len(mechanism.parameters)
    g[:count] += with_effects.values[:count] - mechanism.values
    for effect in with_effects.effects:
        for p in effect.parameters.values():
            g[p] = with_effects.values[p]
    if scenario.error_scale is not None:
        drawn = rng.normal(size=len(mechanism.parameters))
        for p in mechanism.free:
            tau = mechanism.parameters[p].tolerance
            if tau is not None and np.isfinite(tau):
                g[p] += scenario.error_scale * tau * drawn[p]
    place = {name: i for i, name in enumerate(mechanism.names)}
    for name, error in scenario.errors.items():
        g[place[name]] += error
    return g


def _visits(q: Array, scenario: Scenario, rng: np.random.Generator
            ) -> tuple[Ints, Array, Array | None, Array | None]:
    """Return pose label, direction of approach (rows, k), payload and tension of every row."""
    sides = (1.0, -1.0) if scenario.approach == "both" else (1.0,)
    pulls = scenario.tension or (0.0,)
    # each tension is applied under each payload
    loads = np.repeat(scenario.payload or (0.0,), len(pulls))
    n, k = q.shape
    order = np.repeat(np.arange(n), scenario.repeats * len(sides) * len(loads))
    first = rng.choice([-1.0, 1.0], size=(n, k)) if scenario.approach == "both" else np.ones((n, k))
    side = np.tile(np.repeat(sides, scenario.repeats), n * len(loads))
    direction = first[order] * side[:, None]
    if scenario.approach == "sequence":
        moves = np.sign(np.diff(q[order], axis=0, prepend=q[order][:1]))
        direction = np.ones_like(direction)
        for row in range(1, len(order)):
            direction[row] = np.where(moves[row] == 0.0, direction[row - 1], moves[row])
    every = scenario.repeats * len(sides)
    load = np.tile(np.repeat(loads, every), n)
    pull = np.tile(np.repeat(pulls, every), n * len(scenario.payload or (0.0,)))
    return (order, direction, load if scenario.payload else None,
            pull if scenario.tension else None)


def _tensions(mechanism: Mechanism, q: Array, rows: Environment, pull: Array | None,
              own: Mapping[str, Array]) -> Array | None:
    """Return readings of rope force sensors (N, k), N, nan for other joints; None without sensors.

    Ropes are tensioned evenly, by ``pull`` (N,) on average, and share the load; ``own``: columns of
    a file of poses, which take precedence.
    """
    if any(name.startswith("tension_") for name in own):
        blank = np.full(len(q), np.nan)
        return np.stack([own.get(f"tension_{a}", blank) for a in mechanism.actuators], axis=-1)
    if pull is None:
        return None
    model = Model(replace(mechanism.nominal(), effects=()))
    pose = reached_poses(model, q).pose
    load = loads(model, q, pose, rows.wrench) if np.isfinite(rows.wrench).any() else 0.0
    return np.asarray(pretensions(model, q, pose) * pull[:, None] + load)


def _errors(position: Array, scenario: Scenario, rng: np.random.Generator
            ) -> tuple[Array, NDArray[np.bool_]]:
    """Return the instrument's errors (n, 6) at positions (n, 3), and which rows are outliers."""
    n = len(position)
    sigma = np.concatenate([np.full(3, scenario.sigma_position),
                            np.full(3, scenario.sigma_rotation)])
    noise = _draw(rng, scenario.tails, (n, 6))
    for row in range(1, n if scenario.ar else 0):
        noise[row] = scenario.ar * noise[row - 1] + np.sqrt(1.0 - scenario.ar**2) * noise[row]
    outlier = np.asarray(rng.uniform(size=n) < scenario.outliers, dtype=np.bool_)
    way = rng.normal(size=(n, 6))
    if scenario.kind.scalar:
        sigma, way[:, 1:] = np.full(6, scenario.sigma_value), 0.0
    way *= np.sqrt(1.0 if scenario.kind.scalar else 6.0) / np.linalg.norm(
        way, axis=1, keepdims=True)
    noise += np.where(outlier[:, None], OUTLIER_SIGMAS * way, 0.0)
    if scenario.tracker is not None:
        root = tracker_noise(position, scenario.station, *scenario.tracker)
        noise[:, :3], sigma[:3] = (root @ noise[:, :3, None])[..., 0], 1.0
    return noise * sigma, outlier


def _turned(turn: Array, error: Array, mechanism: Mechanism) -> Array:
    """Return measured rotation vectors (n, 3) of true rotations (n, 3, 3) with errors (n, 3)."""
    n = len(turn)
    if mechanism.motion.planar:
        angle = np.arctan2(turn[:, 1, 0], turn[:, 0, 0]) + error[:, 2]
        return np.stack([np.zeros(n), np.zeros(n), angle], axis=1)
    own = cga.motor_from_matrix(turn, np.zeros(3))
    shake = cga.motor_from_rotation_vector(error, np.zeros(3))
    return cga.rotation_vector(cga.compose(shake, own))


def _draw(rng: np.random.Generator, tails: str, shape: tuple[int, int]) -> Array:
    """Return noise of unit variance; t4 has variance 2 before scaling."""
    if tails == "t4":
        return np.asarray(rng.standard_t(4, size=shape) / np.sqrt(2.0), dtype=np.float64)
    return rng.normal(size=shape)


def _temperature(scenario: Scenario, time: Array) -> Array | None:
    if scenario.temperature is None:
        return None
    mean, swing = scenario.temperature
    return np.asarray(mean + swing * np.sin(2.0 * np.pi * time / max(time[-1], 1.0)), dtype=float)



