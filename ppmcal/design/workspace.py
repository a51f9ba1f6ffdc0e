"""Where a machine can go: reach, limits, singularities and dexterity over a grid of poses.

Geometry only: the effects of a mechanism file (backlash, compliance, ...) are left out, the
identified slots are used.

det A, with A the pose Jacobian of the closure, vanishes where the locked legs no longer hold the
platform (singularities of the second type: Gosselin, Angeles, "Singularity analysis of closed-loop
kinematic chains", IEEE Trans. Robotics and Automation 6(3), 1990). It is computed wherever inverse
kinematics has a solution, in or out of limits, on home's side or beyond, so that the curve on which
it changes sign can be found. Singularities at which det A touches 0 without a change of sign are
not seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ppmcal.design.dexterity import CHUNK, Quality, measured
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import inverse_partial, pose_vector
from ppmcal.kinematics.region import Grid
from ppmcal.kinematics.tables import (
    KinematicsTable,
    inverse_table,
    limit_reason,
    refuse_singular_home,
)
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import ByCoordinate, Key, OfUnit
from ppmcal.wording.progress import stage

ON_CURVE = 1e-5
"""A pose is on the singular curve where A's smallest singular value is below this part of home's:
a jump of det A, as where an elbow turns over, is none."""
STEPS = 40
ZERO = 1e-12
"""Secant steps end where det A is below this part of home's."""
MOST_COORDINATES = 3
"""The singular set is looked for on grids of so many coordinates."""
CLOSER = {2: 33, 3: 13}
"""Levels per coordinate of the small grid in which the singular pose next to home is sharpened."""


@dataclass(frozen=True)
class Nearest:
    """The singular pose nearest to home on the grid.

    ``distance``: of the quantity ``unit``, an angle where all coordinates are rotations; ``pose``:
    by the machine's coordinates; ``edge``: how far home is from the end of the grid, beyond which
    nothing is known.
    """

    distance: OfUnit[float]
    unit: str
    pose: ByCoordinate[Mapping[str, float]]
    edge: Annotated[OfUnit[float], Key("grid_ends_at")]


@dataclass(frozen=True, eq=False)
class Workspace:
    """What was found over a grid of N poses, SI.

    Attributes:
        mechanism: without effects; grid: as asked for.
        table: joints, full poses, status and reason of each pose.
        quality: of each pose; ``home``: of home, (1,) each.
        distance: to the nearest singular pose of the grid (N,), m or rad as :class:`Nearest`;
            nan where a pose has no joint values, or where the grid has no singular pose.
        edge: distance to the end of the grid (N,): where ``distance`` is larger, a nearer
            singularity may lie beyond it.
        singular: poses on the singular set (S, 6), x, y, z, rotation vector.
        nearest: to home, None where the grid has none; ``searched``: whether it was looked for.
        share: part of the grid that can be reached within limits, on home's side.
        size: that part of the grid's extent; product of m and rad, as the coordinates are.
        index, index_legs: global conditioning index: mean of dexterity, and of legs, over
            the poses reached; nan where there are none.
        home_limits: which joint is outside its limits at home, empty if none.
    """

    mechanism: Mechanism
    grid: Grid
    table: KinematicsTable
    quality: Quality
    home: Quality
    distance: Array
    edge: Array
    singular: Array
    nearest: Nearest | None
    searched: bool
    share: float
    size: float
    index: float
    index_legs: float
    home_limits: str

    @property
    def reached(self) -> Bools:
        """Poses within limits, on home's side of singularities (N,)."""
        return np.array([s == "ok" for s in self.table.status], dtype=np.bool_)

    @property
    def sure(self) -> Bools:
        """Poses whose distance no singularity beyond the grid can undercut (N,)."""
        return np.asarray(self.distance <= self.edge, dtype=np.bool_)

    @property
    def distance_quantity(self) -> str:
        """Whether distances are a ``length`` or an ``angle``."""
        return _distance_quantity(self.grid)


def _distance_quantity(grid: Grid) -> str:
    return "angle" if all(c >= 3 for c in grid.coordinates) else "length"


@stage("mapping the workspace")
def workspace(mechanism: Mechanism, grid: Grid) -> Workspace:
    """Return reach, singularities and dexterity over a grid.

    Distances to singularities are between poses' coordinates in the grid: Euclidean where all are
    lengths or all are angles, else with angles times the machine's length scale. They are to
    the nearest *found* pose of the singular set, one for each pair of neighbours (diagonals
    included) between which det A changes sign: too large by at most the diagonal of a cell, where
    the set is smooth at the grid's scale.

    Raises:
        NoResult: home is singular; then no side of a singularity is home's.
    """
    mechanism = replace(mechanism, effects=())
    model = Model(mechanism)
    refuse_singular_home(mechanism)
    table = _table(model, grid.poses(mechanism))
    reached = np.array([s == "ok" for s in table.status])
    quality = measured(model, table.q, table.pose)
    home = measured(model, home_state(mechanism).q[None], mechanism.home_pose[None])
    searched = len(grid.coordinates) <= MOST_COORDINATES
    points = np.zeros((0, len(grid.coordinates)))
    space = _GridSpace(model, grid.coordinates, grid.poses(mechanism)[0], home)
    if searched:
        points = _singular_points(space, grid, quality.determinant)
    weights = _weights(mechanism, grid)
    distance = np.full(len(reached), np.nan)
    rows = finite_rows(table.q)
    if len(points) and rows.any():
        nodes = grid.points[rows]
        distance[rows] = cKDTree(points * weights).query(nodes * weights)[0]
    spans = [float(level[-1] - level[0]) for level in grid.levels]
    share = float(np.mean(reached))
    return Workspace(
        mechanism, grid, table, quality, home, distance,
        _to_the_end(grid, grid.points, weights), space.poses(points)[1],
        _nearest(space, grid, points), searched, share, share * float(np.prod(spans)),
        _mean(quality.dexterity[reached]), _mean(quality.legs[reached]),
        limit_reason(mechanism, home_state(mechanism).q))


def _mean(values: Array) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _table(model: Model, poses: Array) -> KinematicsTable:
    """Return the inverse kinematics of poses (N, 6), chunk by chunk."""
    parts = [inverse_table(model, poses[i:i + CHUNK]) for i in range(0, len(poses), CHUNK)]
    return KinematicsTable(
        np.concatenate([p.q for p in parts]),
        np.concatenate([p.pose for p in parts]),
        np.concatenate([p.rate for p in parts]),
        np.concatenate([p.singular_value for p in parts]),
        tuple(s for p in parts for s in p.status),
        tuple(r for p in parts for r in p.reason),
    )


@dataclass(frozen=True, eq=False)
class _GridSpace:
    """The poses that a grid is a part of: a wanted pose (6,) in which its coordinates vary.

    ``home``: home's measures, which say what is small.
    """

    model: Model
    coordinates: tuple[int, ...]
    pose: Array
    home: Quality

    def poses(self, points: Array) -> tuple[Array, Array]:
        """Return joint values (M, k) and full poses (M, 6) at points (M, c), nan where none."""
        wanted = np.tile(self.pose, (len(points), 1))
        wanted[:, self.coordinates] = points
        found = inverse_partial(self.model, wanted)
        return found.q, pose_vector(found.pose)

    def at(self, points: Array) -> Quality:
        """Return the measures at points (M, c)."""
        return measured(self.model, *self.poses(points))


@stage("following singularities")
def _singular_points(space: _GridSpace, grid: Grid, determinant: Array) -> Array:
    """Return points of the singular set (S, c) in the grid's coordinates.

    Along every edge of the grid, diagonals included, on which det A (N,) changes sign the zero
    is found by secant steps (regula falsi, Illinois). Edges with an end out of reach are left out.
    """
    nodes = grid.points
    first, second = grid.edges()
    side = np.where(np.isfinite(determinant), determinant > 0.0, np.nan)
    cross = np.flatnonzero(np.abs(side[first] - side[second]) == 1.0)
    if not cross.size:
        return np.zeros((0, nodes.shape[1]))
    first, second = first[cross], second[cross]
    start, way = nodes[first], nodes[second] - nodes[first]
    part = _zeros(space, start, way, determinant[first], determinant[second])
    points = (start + part[:, None] * way)[np.isfinite(part)]
    good = space.at(points).singular_value < ON_CURVE * space.home.singular_value[0]
    points = points[good]
    steps = np.array([level[1] - level[0] for level in grid.levels])
    once = np.unique(np.round(points / (1e-7 * steps)), axis=0, return_index=True)[1]
    return np.asarray(points[np.sort(once)], dtype=float)


def _zeros(space: _GridSpace, start: Array, way: Array, f0: Array, f1: Array) -> Array:
    """Return where on [0, 1] det A is 0 along each edge (M,); nan where it gets out of reach."""
    small = ZERO * abs(float(space.home.determinant[0]))
    low, high = np.zeros(len(start)), np.ones(len(start))
    last, out = np.zeros(len(start)), np.full(len(start), np.nan)
    active = np.arange(len(start))
    for _ in range(STEPS):
        a, b, fa, fb = low[active], high[active], f0[active], f1[active]
        at = np.where(fa == fb, 0.5 * (a + b), b - fb * (b - a) / np.where(fa == fb, 1.0, fb - fa))
        f = space.at(start[active] + at[:, None] * way[active]).determinant
        still = np.abs(at - out[active]) < 1e-13
        out[active] = np.where(np.isfinite(f), at, np.nan)
        upper = (f > 0.0) == (fb > 0.0)
        # Illinois: an end that stays twice gets half its weight
        f0[active] = np.where(upper, np.where(last[active] > 0, 0.5 * fa, fa), f)
        f1[active] = np.where(upper, f, np.where(last[active] < 0, 0.5 * fb, fb))
        low[active], high[active] = np.where(upper, a, at), np.where(upper, at, b)
        last[active] = np.where(upper, 1.0, -1.0)
        active = active[(np.abs(f) > small) & ~still]
        if not active.size:
            break
    return out


def _to_the_end(grid: Grid, points: Array, weights: Array) -> Array:
    """Return how far points (M, c) are from the end of the grid (M,)."""
    ends = [(level[0], level[-1]) for level in grid.levels]
    room = [np.minimum(points[:, i] - low, high - points[:, i]) * weights[i]
            for i, (low, high) in enumerate(ends)]
    return np.asarray(np.min(room, axis=0), dtype=float)


def _weights(mechanism: Mechanism, grid: Grid) -> Array:
    """Return what one unit of each of the grid's coordinates counts in a distance (c,)."""
    if _distance_quantity(grid) == "angle":
        return np.ones(len(grid.coordinates))
    return np.array([1.0 if c < 3 else mechanism.length_scale for c in grid.coordinates])


def _nearest(space: _GridSpace, grid: Grid, points: Array) -> Nearest | None:
    """Return the singular pose nearest to home, sharpened on a small grid about it."""
    if not len(points):
        return None
    mechanism = space.model.mechanism
    weights = _weights(mechanism, grid)
    home = mechanism.home_pose[list(grid.coordinates)]
    edge = float(_to_the_end(grid, home[None], weights)[0])

    def closest(points: Array) -> Array:
        away = np.linalg.norm((points - home) * weights, axis=1)
        return np.asarray(points[np.argmin(away)], dtype=float)

    best = closest(points)
    count = CLOSER.get(len(grid.coordinates))
    if count is not None:  # along one coordinate the zero itself was found
        steps = [level[1] - level[0] for level in grid.levels]
        small = Grid(grid.coordinates, tuple(
            np.linspace(max(b - 1.01 * s, level[0]), min(b + 1.01 * s, level[-1]), count)
            for b, s, level in zip(best, steps, grid.levels, strict=True)))
        more = _singular_points(space, small, space.at(small.points).determinant)
        best = closest(np.concatenate([best[None], more]))
    pose = space.poses(best[None])[1][0]
    return Nearest(float(np.linalg.norm((best - home) * weights)), _distance_quantity(grid),
                   dict(zip(mechanism.coordinates, pose[list(mechanism.dof)].tolist(),
                            strict=True)), max(edge, 0.0))


__all__ = ["Nearest", "Quality", "Workspace", "workspace"]
