"""Wanted poses, the command that brings the machine to each, and a controller that uses them.

The controller believes the drawing: it turns a commanded pose into joint values with the nominal
geometry. Commands are corrected so that the identified machine ends at what was wanted
(:mod:`ppmcal.compensate`). Between the poses of a regular grid a controller interpolates the
difference command - wanted linearly in every coordinate; how far the machine then is from what
was wanted is measured at poses in between. Effects are taken at rest: no direction of approach,
no speed, no load, 20 degrees Celsius, time 0. Full poses are (N, 6) x, y, z and rotation vector
in the base frame; all SI.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from ppmcal.arrays import known
from ppmcal.closure import Model
from ppmcal.compensate import compensate, named_only
from ppmcal.conditions import REFERENCE_TEMPERATURE, Conditions, conditions
from ppmcal.controllers.misses import Misses, misses
from ppmcal.equilibrium import reach
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics import inverse_table
from ppmcal.mechanism import Mechanism
from ppmcal.targets import base_station, inverse_partial, pose_motor, wanted_poses

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

PLACES = {1: 101, 2: 31, 3: 11, 4: 7, 5: 5, 6: 5}
TURNS = {1: 101, 2: 31, 3: 9, 4: 5, 5: 3, 6: 3}
"""Levels of each position and of each rotation, by how many coordinates the grid has."""
LARGEST_TURN = {"planar": np.radians(45.0), "translational": 0.0, "spatial": np.radians(15.0)}
"""The grid turns the platform from home by no more."""
STEPS = 64
"""Steps on the way from home along one coordinate, at which limits are looked up."""
MARGIN = 0.98
SMALLEST = 0.02
BETWEEN = 500
"""Poses in between at which the interpolation is tried."""
ENOUGH = 20


@dataclass(frozen=True, eq=False)
class Grid:
    """A regular grid: pose coordinates (indices into the full pose), and levels of each."""

    coordinates: tuple[int, ...]
    levels: tuple[Array, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of levels of each coordinate."""
        return tuple(len(level) for level in self.levels)

    def poses(self, mechanism: Mechanism) -> Array:
        """Return the grid as wanted poses (N, 6), last coordinate fastest, nan where open."""
        across = np.meshgrid(*self.levels, indexing="ij")
        return placed(mechanism, self.coordinates, np.stack([a.ravel() for a in across], axis=-1))

    def inside(self, count: int, rng: np.random.Generator) -> Array:
        """Return points (count, c) drawn evenly from the grid's box."""
        low, high = (np.array([level[i] for level in self.levels]) for i in (0, -1))
        out: Array = rng.uniform(low, high, (count, len(self.levels)))
        return out


@dataclass(frozen=True, eq=False)
class Corrected:
    """Corrected commands of N wanted poses, SI; nan rows where there is none.

    Attributes:
        wanted: full poses (N, 6), open coordinates solved for.
        command: the pose to ask of a controller with the nominal geometry (N, 6).
        q: joint values (N, k). good: rows that have them (N,).
        left_out: reason -> how many rows have none for it.
    """

    wanted: Array
    command: Array
    q: Array
    good: Bools
    left_out: Mapping[str, int]


def rest_columns(mechanism: Mechanism, rows: int) -> dict[str, Array]:
    """Return the columns of rows at rest: everything that effects depend on is 0, 20 C."""
    none = np.zeros(rows)
    joints = {f"{what}_{a}": none for what in ("dir", "vel") for a in mechanism.actuators}
    return {**joints, "temperature": np.full(rows, REFERENCE_TEMPERATURE), "payload": none,
            "time": none}


def at_rest(mechanism: Mechanism, rows: int) -> Conditions:
    """Return the conditions of rows at rest."""
    return conditions(rest_columns(mechanism, rows), mechanism.actuators, mechanism.gravity,
                      np.zeros((rows, len(mechanism.actuators))))


def named(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the pose coordinates that a command names; closure decides the others."""
    drawn = mechanism.nominal()
    if drawn.conditions <= len(drawn.actuators):
        return drawn.dof
    kept = np.isfinite(named_only(drawn, drawn.home_pose[None])[0])
    return tuple(c for c in drawn.dof if kept[c])


def placed(mechanism: Mechanism, coordinates: tuple[int, ...], values: Array) -> Array:
    """Return wanted poses (N, 6) with some coordinates (N, c), others open or as at home."""
    out = np.tile(mechanism.home_pose, (len(values), 1))
    out[:, mechanism.dof] = np.nan
    out[:, coordinates] = values
    return out


def default_grid(mechanism: Mechanism) -> Grid:
    """Return the largest box about home, of the proportions of what home can reach, in limits.

    Along each coordinate alone the drawing is followed from home to the first pose outside
    limits, reach or the home side of singularities; then all of these ways are shortened by
    one factor until every pose of the box is inside.

    Raises:
        BadInput: an actuator has no limits. NoResult: next to nothing is inside them.
    """
    refuse_open(mechanism, "the grid", ", or give the poses with --poses")
    chosen = named(mechanism)
    model = Model(mechanism.nominal())
    low, high = _extent(model, chosen)
    coarse = 5 if len(chosen) <= 3 else 3

    def box(part: float, counts: list[int]) -> Grid:
        home = mechanism.home_pose[list(chosen)]
        return Grid(chosen, tuple(np.linspace(h - part * a, h + part * b, n) for h, a, b, n in
                                  zip(home, low, high, counts, strict=True)))

    def fits(part: float) -> bool:
        poses = box(part, [coarse] * len(chosen)).poses(mechanism)
        return bool(np.all(_within(model, poses)))

    inside, outside = 0.0, 1.0
    if fits(1.0):
        inside = 1.0
    while outside - inside > 0.01 and inside < 1.0:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if fits(middle) else (inside, middle)
    if inside < SMALLEST or np.any(low + high <= 0.0):
        raise NoResult("next to nothing around home is inside the limits",
                       f"{mechanism.source}: limits",
                       "Check `home` and `limits`")
    n = len(chosen)
    return box(MARGIN * inside, [PLACES[n] if c < 3 else TURNS[n] for c in chosen])


def refuse_open(mechanism: Mechanism, what: str, mend: str = "") -> None:
    """Refuse a machine of which an actuator has no limits: ``what`` then has no end."""
    open_ = [a for a, pair in zip(mechanism.actuators, mechanism.limits, strict=True)
             if not np.isfinite(pair).all()]
    if open_:
        have = "has" if len(open_) == 1 else "have"
        raise BadInput(f"{', '.join(open_)} {have} no limits, so {what} has no end",
                       f"{mechanism.source}: limits",
                       f"Add `limits: {{{open_[0]}: [low, high]}}`{mend}")


def _extent(model: Model, chosen: tuple[int, ...]) -> tuple[Array, Array]:
    """Return how far home can go down and up along each coordinate alone, (c,) each."""
    mechanism = model.mechanism
    ends = np.array([mechanism.reach if c < 3 else LARGEST_TURN[mechanism.motion] for c in chosen])
    way = np.linspace(0.0, 1.0, STEPS + 1)[1:]
    out = []
    for side in (-1.0, 1.0):
        steps = side * ends[:, None, None] * way[None, :, None] * np.eye(len(chosen))[:, None, :]
        home = mechanism.home_pose[list(chosen)]
        poses = placed(mechanism, chosen, home + steps.reshape(-1, len(chosen)))
        good = _within(model, poses).reshape(len(chosen), STEPS)
        free = np.cumprod(good, axis=1).sum(axis=1)
        out.append(ends * free / STEPS)
    return out[0], out[1]


def _within(model: Model, poses: Array) -> Bools:
    """Return which poses (N, 6) the drawing takes without complaint (N,)."""
    return np.array([s == "ok" for s in inverse_table(model, poses).status], dtype=np.bool_)


def corrected(mechanism: Mechanism, wanted: Array) -> Corrected:
    """Return the corrected commands of wanted platform poses (N, 6), nan where open."""
    found = compensate(mechanism, wanted, None, columns=rest_columns(mechanism, len(wanted)))
    reason = list(found.reason)
    command = nearest(found.command, found.seen)
    for n in np.flatnonzero(known(found.q) & ~known(command)):
        reason[n] = "the drawing has no pose at these joint values"
    good = np.array([not r for r in reason], dtype=np.bool_)
    return Corrected(found.seen, np.where(good[:, None], command, np.nan),
                     np.where(good[:, None], found.q, np.nan), good,
                     dict(Counter(r.partition(":")[0] for r in reason if r)))


def nearest(vector: Array, to: Array) -> Array:
    """Return poses (N, 6) with the rotation vector of the same turn that is nearer to ``to``."""
    out = vector.copy()
    angle = np.linalg.norm(out[:, 3:], axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        other = np.where(angle > 0.0, out[:, 3:] * (1.0 - 2.0 * np.pi / angle), out[:, 3:])
    closer = (np.linalg.norm(other - to[:, 3:], axis=1)
              < np.linalg.norm(out[:, 3:] - to[:, 3:], axis=1))
    out[:, 3:] = np.where(closer[:, None], other, out[:, 3:])
    return out


def interpolated(grid: Grid, found: Corrected, values: Array) -> Array:
    """Return command - wanted (N, 6) at ``values`` (N, c) of the grid's coordinates.

    Linear in every coordinate between the two levels around it; nan where a corner of the
    cell has no command.
    """
    table = (found.command - found.wanted).reshape(*grid.shape, 6)
    out: Array = np.asarray(RegularGridInterpolator(grid.levels, table)(values), dtype=float)
    return out


def driven(mechanism: Mechanism, commands: Array, rows: Conditions) -> Array:
    """Return where commanded poses (N, 6) bring the machine, motors (N, 8).

    The commands go through the drawing's inverse kinematics; nan where they do not.
    """
    asked = commands.copy()
    asked[:, [c for c in mechanism.dof if c not in named(mechanism)]] = np.nan
    q = inverse_partial(Model(mechanism.nominal()), asked).q
    return reach(Model(mechanism), q, rows).pose


def targets(mechanism: Mechanism, wanted: Array) -> Array:
    """Return wanted poses (N, 6) with their open coordinates solved for; nan where none is."""
    station = base_station(len(mechanism.actuators))
    return wanted_poses(Model(mechanism), station, wanted)[0]


def tried_between(mechanism: Mechanism, grid: Grid, found: Corrected, seed: int
                  ) -> tuple[Misses, Misses]:
    """Return errors at poses in between without and with the interpolated correction.

    Raises:
        NoResult: hardly any cell of the grid has commands at all its corners.
    """
    values = grid.inside(BETWEEN, np.random.default_rng(seed))
    wanted = placed(mechanism, grid.coordinates, values)
    correction = interpolated(grid, found, values)[:, list(grid.coordinates)]
    full = targets(mechanism, wanted)
    rest = at_rest(mechanism, len(wanted))
    asked = placed(mechanism, grid.coordinates, values + correction)
    after = driven(mechanism, np.where(known(correction)[:, None], asked, np.nan), rest)
    before = driven(mechanism, wanted, rest)
    both = known(after) & known(before) & known(full)
    if both.sum() < ENOUGH:
        raise NoResult("hardly any cell of the grid has commands at all its corners",
                       mechanism.source, "Check `limits`, or give the poses with --poses")
    return (misses(mechanism, before[both], pose_motor(full[both])),
            misses(mechanism, after[both], pose_motor(full[both])))


def tried_at(mechanism: Mechanism, found: Corrected) -> tuple[Misses, Misses]:
    """Return errors at the poses themselves without and with their commands."""
    full = found.wanted[found.good]
    rest = at_rest(mechanism, len(full))
    before = driven(mechanism, full, rest)
    after = driven(mechanism, found.command[found.good], rest)
    both = known(before) & known(after)
    return (misses(mechanism, before[both], pose_motor(full[both])),
            misses(mechanism, after[both], pose_motor(full[both])))
