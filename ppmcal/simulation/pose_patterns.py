"""The poses of a scenario: circles, grids, helices, random poses, lists, as joint values."""

from __future__ import annotations

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Circle, GridPattern, Helix, Listed, Random, Scenario
from ppmcal.wording.progress import stage

MOST_TRIALS = 200
HOPELESS_TRIALS = 10
SAMPLE = 5000
"""Poses tried before drawing more."""


@stage("choosing poses")
def commands(mechanism: Mechanism, scenario: Scenario, rng: np.random.Generator
             ) -> tuple[Array, list[str], Listed | None]:
    """Return the joint values (N, k) of the wanted poses, and why others were left out.

    For a file also its measurable rows, with their settings.

    Random poses are drawn until enough are measurable; in other patterns, poses outside limits or
    near singularities are left out.
    """
    shape = scenario.poses
    model = Model(mechanism)
    if isinstance(shape, Random):
        return _random_commands(model, shape, scenario, rng), [], None
    wanted = pose_list(shape)
    table = inverse_table(model, wanted)
    good = np.array([s == "ok" for s in table.status])
    if not good.any():
        raise BadInput(f"none of the {len(wanted)} poses can be measured: {table.reason[0]}",
                       f"{scenario.source}: poses", "Move the center or make the range smaller")
    left_out = [f"pose {n}: {table.reason[n]}" for n in np.flatnonzero(~good)]
    return table.q[good], left_out, shape.take(good) if isinstance(shape, Listed) else None


def _random_commands(model: Model, shape: Random, scenario: Scenario, rng: np.random.Generator
                     ) -> Array:
    _refuse_hopeless(model, shape, scenario)
    found: list[Array] = []
    count = 0
    for trial in range(1, MOST_TRIALS + 1):
        wanted = shape.center + rng.uniform(-1.0, 1.0, (shape.count, 6)) * shape.half_range
        table = inverse_table(model, wanted)
        good = table.q[np.array([s == "ok" for s in table.status])]
        found.append(good)
        count += len(good)
        if count >= shape.count:
            return np.concatenate(found)[:shape.count]
        if count == 0 and trial >= HOPELESS_TRIALS:
            break
    raise BadInput(f"only {count} of {trial * shape.count} random poses can be measured "
                   f"(last: {next((r for r in table.reason if r), '')})",
                   f"{scenario.source}: poses.random", "Move the center or make half_range smaller")


def _refuse_hopeless(model: Model, shape: Random, scenario: Scenario) -> None:
    """Reject a box if no pose of a sample is measurable, before drawing millions from it."""
    if shape.count <= SAMPLE:
        return
    draw = np.random.default_rng(0).uniform(-1.0, 1.0, (SAMPLE, 6))
    table = inverse_table(model, shape.center + draw * shape.half_range)
    if "ok" not in table.status:
        raise BadInput(f"none of {SAMPLE} random poses can be measured (first: {table.reason[0]})",
                       f"{scenario.source}: poses.random",
                       "Move the center or make half_range smaller")


def pose_list(shape: Circle | GridPattern | Helix | Listed) -> Array:
    """Return the poses (N, 6) of a pattern, nan where left open."""
    if isinstance(shape, Listed):
        return shape.poses
    if isinstance(shape, GridPattern):
        axes = [np.linspace(-1.0, 1.0, int(c)) if c > 1 else np.zeros(1) for c in shape.counts]
        mesh = np.stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")], axis=-1)
        return np.asarray(shape.center + mesh * shape.half_range, dtype=float)
    phase = np.arange(shape.count) / max(shape.count, 1)
    if isinstance(shape, Circle):
        angle = 2.0 * np.pi * phase
        # the other coordinates go through one period, out of phase with each other
        lag = np.arange(6) * np.pi / 3.0
        poses = shape.center + shape.swing * np.sin(angle[:, None] + lag)
        poses[:, 0] += shape.radius * np.cos(angle)
        poses[:, 1] += shape.radius * np.sin(angle)
        return poses
    angle = 2.0 * np.pi * shape.turns * np.linspace(0.0, 1.0, shape.count)
    poses = np.tile(shape.center, (shape.count, 1))
    poses[:, 0] += 0.5 * shape.diameter * np.cos(angle)
    poses[:, 1] += 0.5 * shape.diameter * np.sin(angle)
    poses[:, 2] += shape.pitch * angle / (2.0 * np.pi)
    return poses
