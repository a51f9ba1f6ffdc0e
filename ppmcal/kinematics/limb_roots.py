"""Both roots of one limb's inverse kinematics, in closed form for every kind.

With the pose fixed, a limb's closure equation is a polynomial of degree two in a prismatic joint
(theory: distance^2 = -2 A.B, [IK] eq. 28 and 42), or a + b cos u + c sin u in a revolute
one. Three evaluations of the KGB give its coefficients exactly, for every kind, so that
limbs need no inverse of their own; one Newton step removes the interpolation's round-off.
A universal joint whose axes do not meet rotates with u: it is held, solved and updated again.

If there are few poses, all limbs of a kind are solved at once, as if they were more poses of one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array, Ints, finite_rows
from ppmcal.model.limbs.chain import U
from ppmcal.model.limbs.kind import LimbKind

FEW = 2000
"""Up to this many poses, several trial joint coordinates are evaluated at once."""
MOST_TURNS = 60
"""Maximum iterations for the rotation of an offset universal joint; mostly four or five."""
TURNED = 1e-11
"""It has converged when the joint moves by no more than this part of the reach, or rad."""


@dataclass(frozen=True, eq=False)
class _OneLimb:
    """One limb of a kind at each of N poses, possibly a different limb at each.

    ``values``: its slots, a number or (N,), and ``directions`` (3,) or (N, 3), SI; ``pose``: motors
    (N, 8); ``reach``: of the machine, m.
    """

    kind: LimbKind
    values: Mapping[str, Any]
    directions: frozenset[str]
    pose: Array
    reach: float

    @classmethod
    def of(cls, model: Model, limbs: Sequence[int], pose: Array) -> _OneLimb:
        """Return limbs of one kind at poses (N, 8): all poses of the first, then of the next."""
        first, every = model.mechanism.limbs[limbs[0]], [model.limb_values[i] for i in limbs]
        directions, values = frozenset(first.constants), dict(every[0])
        if len(limbs) > 1:
            for name in values:
                each = (np.asarray(v[name], dtype=float) for v in every)
                own = (3,) if name in directions else ()
                values[name] = np.concatenate([np.broadcast_to(v, (len(pose), *own)) for v in each])
            pose = np.tile(pose, (len(limbs), 1))
        return cls(first.kind, values, directions, pose, model.mechanism.reach)

    @property
    def slides(self) -> bool:
        return self.kind.actuator == "length"

    @property
    def turned(self) -> bool:
        return self.kind.is_turned(self.values)

    def taken(self, rows: Ints) -> _OneLimb:
        """Return some of the rows, possibly repeated."""
        return replace(self, pose=self.pose[rows], values={
            name: value if np.ndim(value) == (name in self.directions) else value[rows]
            for name, value in self.values.items()})


def limb_roots(model: Model, index: int, pose: Array) -> tuple[Array, Array]:
    """Return both joint coordinates u of one driven limb, (N, 2), and by how much it misses (N,).

    Column 0 is the smaller, column 1 the larger root of the pair; equal if the joint
    enters linearly. nan if the limb cannot reach; then the second result is positive:
    the missing length (sphere or plane distance at the closest joint value), m.
    """
    return _solved(_OneLimb.of(model, (index,), pose))


def all_roots(model: Model, pose: Array) -> dict[int, tuple[Array, Array]]:
    """Return the roots of every driven limb, as :func:`limb_roots` for one."""
    together: dict[Any, list[int]] = {}
    for i in model.mechanism.driven:
        kind, values = model.mechanism.limbs[i].kind, model.limb_values[i]
        alone = len(pose) > FEW or kind.is_turned(values)
        together.setdefault(i if alone else (kind.name, tuple(sorted(values))), []).append(i)
    out = {}
    for limbs in together.values():
        roots, missing = _solved(_OneLimb.of(model, limbs, pose))
        for i, r, m in zip(limbs, np.split(roots, len(limbs)), np.split(missing, len(limbs)),
                           strict=True):
            out[i] = r, m
    return dict(sorted(out.items()))


def _solved(limb: _OneLimb) -> tuple[Array, Array]:
    """Return both roots (N, 2), and by how much the limb misses (N,)."""
    roots, nearest = _root_pair(limb)
    if limb.turned:
        starts = np.where(np.isfinite(roots), roots, nearest[:, None])
        for j in range(2):
            roots[:, j], nearest = _turned_root(limb, starts[:, j], j)
    reached = finite_rows(roots)
    missing = np.zeros(len(reached)) if reached.all() else np.where(
        reached, 0.0, _distance(limb, nearest))
    with np.errstate(invalid="ignore", divide="ignore"):
        return _polished(limb, roots), missing


def nearest_joint(model: Model, index: int, pose: Array) -> Array:
    """Return the joint coordinate u at which one limb comes closest to closing (N,).

    For a limb without root: as far as it reaches.
    """
    limb = _OneLimb.of(model, (index,), pose)
    nearest = _root_pair(limb)[1]
    if limb.turned:
        nearest = _turned_root(limb, nearest, 0)[1]
    return np.where(np.isfinite(nearest), nearest, 0.0)


def _root_pair(limb: _OneLimb, held: Mapping[str, Array] | None = None) -> tuple[Array, Array]:
    """Return both roots u (N, 2) with a universal joint held at its angle, and the nearest u (N,).

    ``held``: its rotation, see :meth:`LimbKind.turn`; nothing if its axes meet.
    """
    step = limb.reach if limb.slides else 1.0
    samples = step * np.array([1.0, 2.0, 3.0]) if limb.slides else np.array([0.0, 1.0, -1.0]) * 2.0
    f = _inner_products(limb, np.broadcast_to(samples, (len(limb.pose), 3)), held or {})
    if limb.slides:
        return _polynomial_roots(f, step, limb.kind.branch is None)
    return _trigonometric_roots(f)


def _turned_root(limb: _OneLimb, u: Array, which: int) -> tuple[Array, Array]:
    """Return one root (N,) of a limb with an offset universal joint, and the nearest u (N,).

    The joint is held as solved at u and the limb solved in closed form, repeatedly: the
    rotation is stationary, so that each step squares the error. While there is no root the joint
    follows the nearest u, which ends at the end of the limb's reach.
    """
    near, root = u, np.full_like(u, np.nan)
    scale = limb.reach if limb.slides else 1.0
    for _ in range(MOST_TURNS):
        turn = limb.kind.turn({**limb.values, U: near}, limb.pose)
        pair, middle = _root_pair(limb, turn)
        root = pair[:, which]
        before, near = near, np.where(np.isfinite(root), root, middle)
        if not np.any(np.abs(near - before) > TURNED * scale):
            break
    return root, near


def _inner_product(limb: _OneLimb, u: Array, held: Mapping[str, Array] | None = None) -> Array:
    """Return the raw inner product of the limb's first closure equation (N,), m^2 or m.

    ``held``: the rotation of an offset universal joint, if not that at the pose.
    """
    values = {**limb.values, U: u, **(held or {})}
    body = limb.kind.evaluate(values, (), limb.pose if held is None else None)
    carried = cga.move_vector(limb.pose, body.moving[:, 0])
    return np.asarray(cga.inner(body.fixed[:, 0], carried), dtype=float)


def _inner_products(limb: _OneLimb, u: Array, held: Mapping[str, Array] | None = None) -> Array:
    """Return the same at several joint coordinates (N, s) of each pose (N, s).

    All at once if there are so few poses that calls dominate the time.
    """
    count, several = u.shape
    if count > FEW:
        return np.stack([_inner_product(limb, u[:, j], held) for j in range(several)], axis=-1)
    rows = np.repeat(np.arange(count), several)    # effects give each row slots of its own
    again = None if held is None else {
        name: value[rows] if len(value) == count else value for name, value in held.items()}
    return _inner_product(limb.taken(rows), u.ravel(), again).reshape(count, several)


def _distance(limb: _OneLimb, u: Array) -> Array:
    """Return how far the limb ends from closing at joint coordinates ``u`` (N,), m."""
    body = limb.kind.evaluate({**limb.values, U: np.where(np.isfinite(u), u, 0.0)}, (), limb.pose)
    c = cga.inner(body.fixed[:, 0], cga.move_vector(limb.pose, body.moving[:, 0]))
    radius = body.radius[:, 0]
    apart = np.abs(np.sqrt(np.maximum(radius**2 - 2.0 * c, 0.0)) - radius)
    return np.asarray(np.where(radius > 0.0, apart, np.abs(c)), dtype=float)


def _polynomial_roots(f: Array, h: float, linear: bool) -> tuple[Array, Array]:
    """Roots of the parabola through f(h), f(2h), f(3h), and where it is closest to 0."""
    f1, f2, f3 = f[:, 0], f[:, 1], f[:, 2]
    c2 = (f1 - 2.0 * f2 + f3) / (2.0 * h * h)
    if linear:
        slope = (f3 - f1) / (2.0 * h)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = 2.0 * h - f2 / slope
        root = np.where(slope == 0.0, np.nan, root)
        return np.stack([root, root], axis=-1), np.zeros_like(root)
    c1 = (f3 - f1) / (2.0 * h) - 4.0 * h * c2
    c0 = f2 - 2.0 * h * c1 - 4.0 * h * h * c2
    disc = c1 * c1 - 4.0 * c2 * c0
    # exactly at the end of reach, round-off may make the discriminant negative
    disc = np.where((disc < 0.0) & (disc > -1e-14 * (c1 * c1 + np.abs(4 * c2 * c0))), 0.0, disc)
    # so far away that its distance swamps the step, the parabola has no curvature: no root
    with np.errstate(invalid="ignore", divide="ignore"):
        half = np.sqrt(disc) / (2.0 * np.abs(c2))
        middle = np.where(c2 == 0.0, np.nan, -c1 / (2.0 * c2))
    return np.stack([middle - half, middle + half], axis=-1), middle


def _trigonometric_roots(f: Array) -> tuple[Array, Array]:
    """Roots of k + a cos u + b sin u through u = 0, 2 and -2 rad, and where it is closest to 0."""
    even, odd = (f[:, 1] + f[:, 2]) / 2.0, (f[:, 1] - f[:, 2]) / 2.0
    a = (f[:, 0] - even) / (1.0 - np.cos(2.0))
    b = odd / np.sin(2.0)
    k = f[:, 0] - a
    amplitude = np.hypot(a, b)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = -k / amplitude
        ratio = np.where((np.abs(ratio) > 1.0) & (np.abs(ratio) < 1.0 + 1e-14),
                         np.sign(ratio), ratio)
        delta = np.arccos(ratio)
    middle = np.arctan2(b, a)
    return (np.stack([middle - delta, middle + delta], axis=-1),
            np.where(k > 0.0, middle + np.pi, middle))


def _polished(limb: _OneLimb, u: Array) -> Array:
    """Return roots (N, 2) after one Newton step on the closure equation itself.

    The step is used only if it is small and finite.
    """
    safe = np.where(np.isfinite(u), u, 1.0)
    h = 1e-6 * (limb.reach if limb.slides else 1.0)
    f = _inner_products(limb, np.concatenate([safe, safe + h, safe - h], axis=1))
    step = -f[:, :2] / ((f[:, 2:4] - f[:, 4:]) / (2.0 * h))
    use = np.isfinite(step) & (np.abs(step) < 1e-3 * h / 1e-6)
    return np.where(np.isfinite(u), safe + np.where(use, step, 0.0), u)
