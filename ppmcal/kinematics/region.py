"""Where a machine can go: the coordinates that a command names, boxes and slices about home.

A machine with fewer actuators than pose coordinates takes as many coordinates as it has
actuators; its closure determines the others, which stay open (nan). Poses are full poses (N, 6)
x, y, z and rotation vector in the base frame, SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Self

import numpy as np

from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import named_only
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.units import Units

STEPS = 64
"""Steps from home along one coordinate, at which limits are checked."""
SHORT, FINER = 8, 4
"""A way of fewer steps than this is repeated in finer ones, at most this many times."""
SMALLEST = 0.02
MARGIN = 0.15
"""A slice extends beyond what home can reach along its axes by this part, at both ends."""
OPEN_REACH = 0.25
"""Along coordinates that no limit bounds, a slice extends this part of the reach from home."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A regular grid: pose coordinates (indices into the full pose), and the levels of each."""

    coordinates: tuple[int, ...]
    levels: tuple[Array, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of levels of each coordinate."""
        return tuple(len(level) for level in self.levels)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates, ``x``, ``y``, ..."""
        return tuple(POSE_COORDINATES[c] for c in self.coordinates)

    @property
    def points(self) -> Array:
        """All combinations of levels (N, c), last coordinate fastest; m and rad."""
        across = np.meshgrid(*self.levels, indexing="ij")
        return np.stack([a.ravel() for a in across], axis=-1)

    def poses(self, mechanism: Mechanism) -> Array:
        """Return the grid as wanted poses (N, 6), last coordinate fastest, nan where open."""
        return placed(mechanism, self.coordinates, self.points)

    def edges(self) -> tuple[Ints, Ints]:
        """Return both ends of every edge and diagonal, as indices into the points (E,) each."""
        index = np.arange(int(np.prod(self.shape))).reshape(self.shape)
        ends: tuple[list[Ints], list[Ints]] = ([], [])
        for offset in product((-1, 0, 1), repeat=len(self.shape)):
            if next((o for o in offset if o), -1) < 0:
                continue  # no step, or the same edge from its other end
            for side, sign in zip(ends, (1, -1), strict=True):
                side.append(index[tuple(slice(max(0, -sign * o), n - max(0, sign * o))
                                        for o, n in zip(offset, self.shape, strict=True))].ravel())
        return np.concatenate(ends[0]), np.concatenate(ends[1])

    def inside(self, count: int, rng: np.random.Generator) -> Array:
        """Return points (count, c) drawn evenly from the grid's box."""
        low, high = (np.array([level[i] for level in self.levels]) for i in (0, -1))
        out: Array = rng.uniform(low, high, (count, len(self.levels)))
        return out


@lru_cache(maxsize=64)
def named(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the pose coordinates that a command names; closure determines the others."""
    nominal = mechanism.nominal()
    if not nominal.dependent:
        return nominal.dof
    kept = np.isfinite(named_only(nominal, nominal.home_pose[None])[0])
    return tuple(c for c in nominal.dof if kept[c])


@dataclass(frozen=True, eq=False)
class Map:
    """One quantity over a grid.

    Attributes:
        name: column of the table and stem of the picture: ``amplification_position``.
        title: in words; unit: of ``values``, empty if dimensionless.
        values: one value per pose, shape of the grid, file units, nan where there is none.
        log: whether colours are on a logarithmic scale.
    """

    name: str
    title: str
    unit: str
    values: Array
    log: bool = False

    @classmethod
    def of(cls, units: Units, name: str, title: str, quantity: str, values: Array) -> Self:
        """Return the map of SI values of a quantity such as ``angle/length``."""
        return cls(name, title, units.name(quantity), values / units.factor(quantity))


def placed(mechanism: Mechanism, coordinates: Sequence[int], values: Array) -> Array:
    """Return wanted poses (N, 6) with some coordinates (N, c) given, the others as at home.

    With fewer actuators than coordinates, those beyond the number of actuators stay open.
    """
    chosen = list(coordinates)
    chosen += [c for c in named(mechanism) if c not in chosen][:max(
        0, mechanism.freedoms - len(chosen))]
    out = np.tile(mechanism.home_pose, (len(values), 1))
    if mechanism.dependent:
        out[:, [c for c in mechanism.dof if c not in chosen]] = np.nan
    out[:, coordinates] = values
    return out


def largest_box(mechanism: Mechanism, chosen: Sequence[int], trials: int) -> tuple[Array, Array]:
    """Return the ends (c,) each of the largest box about home that is inside all limits.

    Along each coordinate alone the nominal machine is followed from home to the first pose outside
    limits, reach or the home side of singularities; then all of these ways are shortened by
    one factor until every pose of the box, ``trials`` along each coordinate, is inside.

    Raises:
        NoResult: hardly any pose is inside.
    """
    model = Model(mechanism.nominal())
    low, high = extent(model, chosen)
    home = mechanism.home_pose[list(chosen)]

    def fits(part: float) -> bool:
        levels = tuple(np.linspace(h - part * a, h + part * b, trials)
                       for h, a, b in zip(home, low, high, strict=True))
        return bool(np.all(within(model, Grid(tuple(chosen), levels).poses(mechanism))))

    inside, outside = 0.0, 1.0
    if fits(1.0):
        inside = 1.0
    while outside - inside > 0.01 and inside < 1.0:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if fits(middle) else (inside, middle)
    if inside < SMALLEST or np.any(low + high <= 0.0):
        raise NoResult("hardly any pose around home is inside the limits",
                       f"{mechanism.source}: limits", "Check `home` and `limits`")
    return home - inside * low, home + inside * high


def extent(model: Model, chosen: Sequence[int]) -> tuple[Array, Array]:
    """Return how far home can go down and up along each coordinate alone, (c,) each.

    At most the reach, or the motion's largest rotation; :data:`OPEN_REACH` of it if an actuator
    has no limits.
    """
    mechanism = model.mechanism
    far = mechanism.reach * (1.0 if np.isfinite(mechanism.limits).all() else OPEN_REACH)
    ends = np.array([far if c < 3 else mechanism.motion.largest_turn for c in chosen])
    return _free(model, chosen, -ends), _free(model, chosen, ends)


def _free(model: Model, chosen: Sequence[int], ends: Array) -> Array:
    """Return how far home can go towards ``ends`` (c,), in steps of 1/64; short ways finer."""
    way = np.linspace(0.0, 1.0, STEPS + 1)[1:]
    home = model.mechanism.home_pose[list(chosen)]
    free = np.zeros(len(chosen), dtype=np.int64)
    for finer in range(FINER):
        steps = ends[:, None, None] * way[None, :, None] * np.eye(len(chosen))[:, None, :]
        poses = placed(model.mechanism, chosen, home + steps.reshape(-1, len(chosen)))
        good = within(model, poses).reshape(len(chosen), STEPS)
        free = np.cumprod(good, axis=1).sum(axis=1)
        short = free < SHORT
        if not short.any() or finer == FINER - 1:
            break
        ends = np.where(short & (np.abs(ends) > 0.0), ends * SHORT / STEPS, ends)
    return np.abs(ends) * free / STEPS


def within(model: Model, poses: Array) -> Bools:
    """Return which poses (N, 6) the machine accepts (N,)."""
    return np.array([s == "ok" for s in inverse_table(model, poses).status], dtype=np.bool_)


def _room(mechanism: Mechanism, axes: Sequence[int]) -> tuple[Array, Array]:
    """Return :func:`extent`, without limits if home is outside them.

    Raises:
        BadInput: even then home cannot move along a coordinate.
    """
    nominal = mechanism.nominal()
    low, high = extent(Model(nominal), axes)
    if np.all(low + high > 0.0):
        return low, high
    low, high = extent(Model(replace(nominal, limits=np.tile(
        [-np.inf, np.inf], (len(nominal.actuators), 1)))), axes)
    stuck = [POSE_COORDINATES[c] for c, width in zip(axes, low + high, strict=True)
             if not width > 0.0]
    if stuck:
        raise BadInput(f"home cannot go anywhere along {', '.join(stuck)}",
                       f"{mechanism.source}: home",
                       f"Give a range, such as --grid {stuck[0]}=-1:1:41, or check home")
    return low, high


def slice_axes(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the default coordinates of a map: the first two that are named."""
    return named(mechanism)[:2]


def slice_grid(mechanism: Mechanism, axes: Sequence[int], counts: Sequence[int],
               ranges: Mapping[int, tuple[float, float]] | None = None) -> Grid:
    """Return a grid about home, with the other coordinates as at home.

    Args:
        mechanism: the machine.
        axes: pose coordinates, indices into the full pose.
        counts: levels of each.
        ranges: coordinate -> lowest and highest value, SI; the others extend a little beyond what
            home can reach along them, so that the edge of the workspace shows.

    Raises:
        BadInput: home cannot move along a coordinate without a range.
    """
    ends = dict(ranges or {})
    rest = [c for c in axes if c not in ends]
    if rest:
        low, high = _room(mechanism, rest)
        for c, a, b in zip(rest, low.tolist(), high.tolist(), strict=True):
            home, beyond = float(mechanism.home_pose[c]), MARGIN * (a + b)
            ends[c] = (home - a - beyond, home + b + beyond)
    return Grid(tuple(axes), tuple(np.linspace(*ends[c], count)
                                   for c, count in zip(axes, counts, strict=True)))
