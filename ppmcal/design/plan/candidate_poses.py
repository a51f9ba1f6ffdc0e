"""Poses that could be measured: drawn evenly in the machine's region, and on its edge.

D-optimal poses lie on the edge of what is allowed (errors of the geometry show most there),
so that an even draw alone would leave most of the gain behind: faces and corners of the
region's box are pulled towards home until the machine takes them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal.design.plan.clearance import too_close
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.loads import tight_ropes
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.region import extent, named, placed
from ppmcal.kinematics.tables import (
    home_singular_value,
    inverse_table,
    limit_reason,
    refuse_singular_home,
)
from ppmcal.linalg import Array, Bools
from ppmcal.model.mechanism import Mechanism

NEAR_SINGULAR = 0.25
"""Left out: poses whose smallest singular value is below this part of home's. Errors grow
without bound towards a singularity, and so would the criterion, long after the linear model
that it rests on has failed."""
ON_EDGE = 0.4
"""Part of the candidates that lies on the edge of the region."""
SHORT_OF_EDGE = 0.99
"""Poses on the edge stop at this part of the way from home."""
BATCH, MOST_DRAWN, HALVINGS = 512, 8192, 7
WORDS = {"unreachable": "out of reach", "limits": "outside limits", "singular": "singular",
         "crossed": "beyond a singularity", "near": "near a singularity",
         "legs": "legs too close to each other", "slack": "with slack ropes",
         "mode": "in another assembly mode than home's"}


@dataclass(frozen=True, eq=False)
class Candidates:
    """K poses that can be measured, of the nominal machine, SI.

    ``q`` (K, k); ``pose`` (K, 6); ``singular_value`` (K,): smallest singular value as a part of
    home's; ``even`` (K,): drawn evenly, not placed on the edge; ``left_out``: reason in words ->
    number of poses; ``rows`` (K,): row numbers in the user's file, from 1, else empty.
    """

    q: Array
    pose: Array
    singular_value: Array
    even: Bools
    left_out: Mapping[str, int]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of poses K."""
        return len(self.q)

    def take(self, keep: NDArray[np.int64] | Bools) -> Candidates:
        """Return some of the poses."""
        return Candidates(self.q[keep], self.pose[keep], self.singular_value[keep], self.even[keep],
                          self.left_out, self.rows[keep] if self.rows.size else self.rows)

    def joined(self, other: Candidates) -> Candidates:
        """Return these poses and then others; what was left out is these ones'."""
        q, pose, singular_value, even = (np.concatenate([getattr(self, n), getattr(other, n)])
                                    for n in ("q", "pose", "singular_value", "even"))
        return Candidates(q, pose, singular_value, even, self.left_out, self.rows)


@dataclass(frozen=True, eq=False)
class _Judged:
    """Poses as the machine takes them, and for each a key of :data:`WORDS`, empty if good."""

    q: Array
    pose: Array
    singular_value: Array
    why: tuple[str, ...]

    @property
    def good(self) -> Bools:
        return np.array([not w for w in self.why], dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class Region:
    """A box about home: coordinates, and its ends (c,) each, SI.

    ``tight``: whether poses count only where ropes can pull against each other, all of them.
    """

    coordinates: tuple[int, ...]
    low: Array
    high: Array
    home: Array
    tight: bool = False


def region_of(nominal: Mechanism, tight: bool = False) -> Region:
    """Return the full box of extents about home, over the coordinates that a pose names.

    ``tight``: leave poses out where ropes are slack, unless they are at home, held by weight.

    Raises:
        BadInput: home is outside limits.
    """
    beyond = limit_reason(nominal, home_state(nominal).q)
    if beyond:
        raise BadInput(f"home is not within limits: {beyond}", f"{nominal.source}: home, limits",
                       "Choose a home inside them: the region is drawn about it")
    chosen = named(nominal)
    low, high = extent(Model(nominal), chosen)
    home = nominal.home_pose[list(chosen)]
    tight = tight and all(limb.kind.pulls_only for limb in nominal.limbs) and bool(
        tight_ropes(Model(nominal), home_state(nominal).q[None], nominal.home[None])[0])
    return Region(chosen, home - low, home + high, home, tight)


def draw(nominal: Mechanism, region: Region, count: int, seed: int) -> Candidates:
    """Return ``count`` poses of the region, :data:`ON_EDGE` of them on its edge.

    Raises:
        NoResult: no pose of the region can be measured.
    """
    edge = _on_edge(nominal, region, round(ON_EDGE * count), seed)
    inside, why = _evenly(nominal, region, count - len(edge.q), seed)
    if not inside.good.any():
        raise NoResult("no pose of the machine's region can be measured: "
                       + _counted(why), f"{nominal.source}: home, limits",
                       "Check `home` and `limits`, or give your own poses with --candidates")
    return Candidates(
        np.concatenate([inside.q, edge.q]), np.concatenate([inside.pose, edge.pose]),
        np.concatenate([inside.singular_value, edge.singular_value]),
        np.arange(len(inside.q) + len(edge.q)) < len(inside.q), why, np.zeros(0, dtype=np.int64))


def evenly(nominal: Mechanism, region: Region, count: int, seed: int) -> Candidates:
    """Return up to ``count`` poses drawn evenly from the region (scrambled Sobol points).

    Raises:
        NoResult: none of them can be measured.
    """
    found, why = _evenly(nominal, region, count, seed)
    if not len(found.q):
        raise NoResult("no pose of the machine's region can be measured: " + _counted(why),
                       f"{nominal.source}: home, limits", "Check `home` and `limits`")
    return Candidates(found.q, found.pose, found.singular_value,
                      np.ones(len(found.q), dtype=np.bool_), why, np.zeros(0, dtype=np.int64))


def listed(nominal: Mechanism, poses: Array, source: str) -> Candidates:
    """Return those of the user's poses (N, 6) that can be measured, nan where left open.

    Raises:
        BadInput: none of them can.
    """
    found = _judge(nominal, poses)
    why = _worded(Counter(w for w in found.why if w))
    good = np.flatnonzero(found.good)
    if not good.size:
        raise BadInput(f"none of the {len(poses)} poses can be used: {_counted(why)}", source,
                       "Give poses inside limits and reach, away from singularities")
    return Candidates(found.q[good], found.pose[good], found.singular_value[good],
                      np.ones(good.size, dtype=np.bool_), why, good + 1)


def nearby(nominal: Mechanism, region: Region, pose: Array, scale: float, count: int,
           rng: np.random.Generator) -> tuple[Candidates, NDArray[np.int64]]:
    """Return poses around each of some poses (N, 6), and of which each is a neighbour.

    ``count`` steps of about ``scale`` parts of the box in all directions, some outward, ended by
    the box's faces; what cannot be measured is left out. It is not looked at whether home's
    assembly mode is theirs: see :func:`same_mode`.
    """
    own = pose[:, region.coordinates]
    wide = np.where(region.high > region.low, region.high - region.low, 1.0)
    step = rng.normal(size=(len(pose), count, own.shape[1])) * scale
    outward = (own - region.home) / wide
    step[:, ::3] += rng.uniform(0.0, 4.0 * scale, (len(pose), step[:, ::3].shape[1], 1)) * (
        outward[:, None])
    unit = np.clip(((own - region.low) / wide)[:, None] + step, 0.0, 1.0)
    found = _judge(nominal, _poses(nominal, region, unit.reshape(-1, own.shape[1])), False,
                   region.tight)
    good = np.flatnonzero(found.good)
    return (Candidates(found.q[good], found.pose[good], found.singular_value[good],
                       np.zeros(good.size, dtype=np.bool_), {}, np.zeros(0, dtype=np.int64)),
            good // count)


def _evenly(nominal: Mechanism, region: Region, count: int, seed: int
            ) -> tuple[_Judged, dict[str, int]]:
    """Return good poses, and why others of the draw were left out."""
    # powers of two: the sequence is the same however it is cut
    size = min(BATCH, 1 << max(count, 1).bit_length())
    sobol = _points(len(region.coordinates), seed, size)
    parts: list[_Judged] = []
    why: Counter[str] = Counter()
    while sum(len(p.q) for p in parts) < count and len(parts) * size < MOST_DRAWN:
        found = _judge(nominal, _poses(nominal, region, next(sobol)), tight=region.tight)
        # only what came before the last pose that is needed counts as drawn
        wanted = count - sum(len(p.q) for p in parts)
        last = np.flatnonzero(found.good)[:wanted]
        end = int(last[-1]) + 1 if last.size == wanted else size
        why.update(w for w in found.why[:end] if w)
        parts.append(_part(found, last))
    q, pose, singular_value = (np.concatenate([getattr(p, n) for p in parts])
                          for n in ("q", "pose", "singular_value"))
    return _Judged(q, pose, singular_value, ("",) * len(q)), _worded(why)


def _on_edge(nominal: Mechanism, region: Region, count: int, seed: int) -> _Judged:
    """Return poses on the edge: corners and faces of the box, pulled towards home."""
    c = len(region.coordinates)
    rng = np.random.default_rng([seed, 1])
    corners = (np.arange(2**c)[:, None] >> np.arange(c)) % 2 * 1.0
    faces = next(_points(c, seed + 1))[:max(count - len(corners), count // 2)]
    snapped = np.argmax(np.abs(faces - 0.5), axis=1)
    rows = np.arange(len(faces))
    faces[rows, snapped] = np.round(faces[rows, snapped])
    box = np.concatenate([corners[rng.permutation(len(corners))][:count - len(faces)], faces])
    home = (region.home - region.low) / np.where(region.high > region.low,
                                                 region.high - region.low, 1.0)
    inside, outside = np.zeros(len(box)), np.full(len(box), 2.0)
    for _ in range(HALVINGS + 1):
        middle = 0.5 * (inside + outside)
        good = _judge(nominal, _poses(nominal, region, home + middle[:, None] * (box - home)),
                      False, region.tight).good
        inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
        outside = np.where(inside >= 1.0, 1.0, outside)
    part = SHORT_OF_EDGE * inside[:, None]
    found = _judge(nominal, _poses(nominal, region, home + part * (box - home)), tight=region.tight)
    return _part(found, np.flatnonzero(found.good & (inside > 0.0)))


def _points(size: int, seed: int, batch: int = BATCH) -> Iterator[Array]:
    """Yield batches of Sobol points of the unit cube (batch, size), shifted by the seed.

    A shift modulo 1 keeps them even (Cranley and Patterson 1976).
    """
    from scipy.stats import qmc  # a quarter of a second, and few commands plan

    sobol = qmc.Sobol(size, scramble=False)
    shift = np.random.default_rng([seed, 0]).uniform(size=size)
    while True:
        yield (sobol.random(batch) + shift) % 1.0


def _poses(nominal: Mechanism, region: Region, unit: Array) -> Array:
    """Return wanted poses (N, 6) at points (N, c) of the unit box."""
    return placed(nominal, region.coordinates, region.low + unit * (region.high - region.low))


def _judge(nominal: Mechanism, poses: Array, mode: bool = True, tight: bool = False) -> _Judged:
    """Return joint values of poses, and why some should not be measured.

    Without ``mode`` it is not looked at whether home's assembly mode is theirs; with ``tight``
    slack ropes count.

    Raises:
        NoResult: home is singular.
    """
    model = Model(nominal)
    refuse_singular_home(nominal)
    home = home_singular_value(nominal)[0]
    table = inverse_table(model, poses)
    why = ["" if s == "ok" else s for s in table.status]
    good = np.flatnonzero([not w for w in why])
    for n in good[table.singular_value[good] < NEAR_SINGULAR * home]:
        why[n] = "near"
    good = np.flatnonzero([not w for w in why])
    if good.size:
        for n in good[too_close(model, table.q[good], table.pose[good])]:
            why[n] = "legs"
        good = np.flatnonzero([not w for w in why])
    if good.size and tight:
        for n in good[~tight_ropes(model, table.q[good], pose_motor(table.pose[good]))]:
            why[n] = "slack"
        good = np.flatnonzero([not w for w in why])
    if good.size and mode:
        for n in good[~same_mode(nominal, table.q[good], table.pose[good])]:
            why[n] = "mode"
    return _Judged(table.q, table.pose, table.singular_value / home, tuple(why))


def same_mode(nominal: Mechanism, q: Array, pose: Array) -> Bools:
    """Return whether joints (N, k) lead from home to these poses (N, 6): the machine's own mode."""
    return same_pose(forward(Model(nominal), q).pose, pose_motor(pose), nominal)


def same_pose(one: Array, two: Array, nominal: Mechanism) -> Bools:
    """Return which motors (N, 8) are the same pose, within 1e-6 of the reach; nan is none."""
    side = np.where(np.sum(one[:, :4] * two[:, :4], axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.asarray(np.linalg.norm(one - side * two, axis=1) < 1e-6 * max(1.0, nominal.reach))


def _part(found: _Judged, rows: NDArray[np.int64]) -> _Judged:
    return _Judged(found.q[rows], found.pose[rows], found.singular_value[rows],
                   tuple(found.why[n] for n in rows))


def _worded(why: Mapping[str, int]) -> dict[str, int]:
    return {WORDS.get(w, w): n for w, n in sorted(why.items(), key=lambda one: -one[1])}


def _counted(why: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {w}" for w, n in why.items()) or "there is none"

