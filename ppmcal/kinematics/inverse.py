"""Inverse kinematics: joint values of a pose, in closed form for every limb kind.

With the pose fixed, a limb's closure equation is a polynomial of degree two in a prismatic joint
(theory: distance^2 = -2 A.B, [IK] eq. 28 and 42), or a + b cos u + c sin u in a revolute
one. Three evaluations of the KGB give its coefficients exactly, whatever the kind, so the
limbs need no inverse of their own; one Newton step removes the interpolation's round-off.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.limbs.chain import U
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.scaled_points import other_radii

SURFACE_TOLERANCE = 1e-6
"""A full pose may miss the machine's surface by this part of its reach."""


@dataclass(frozen=True)
class HomeState:
    """What home selects: joint values (k,) and, per limb, which of two roots (L,), +-1."""

    q: Array
    roots: tuple[int, ...]


@dataclass(frozen=True)
class Inverse:
    """Joint values for N poses.

    Attributes:
        q: (N, k), nan where there is none.
        pose: the full platform motors (N, 8), open coordinates solved for.
        reason: why a row has no values, empty where it has.
    """

    q: Array
    pose: Array
    reason: tuple[str, ...]

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Rows that have joint values (N,)."""
        return np.array([not r for r in self.reason], dtype=bool)


def limb_roots(model: Model, index: int, pose: Array) -> tuple[Array, Array]:
    """Return both joint coordinates u of one limb, (N, 2), and by how much it misses (N,).

    Column 0 is the smaller, column 1 the larger root of the pair; equal where the joint
    enters linearly. nan where the limb cannot reach; the second result is then positive:
    the missing length (sphere or plane distance at the closest joint value), m.
    """
    limb = model.mechanism.limbs[index]
    prismatic = limb.kind.actuator == "length"
    step = 1.0
    if prismatic:
        step = model.mechanism.reach
    samples = step * np.array([1.0, 2.0, 3.0]) if prismatic else np.array([0.0, 1.0, -1.0]) * 2.0
    f = np.stack([_inner_product(model, index, pose, u) for u in samples], axis=-1)
    if prismatic:
        roots, nearest = _polynomial_roots(f, step, limb.kind.branch is None)
    else:
        roots, nearest = _trigonometric_roots(f)
    missing = np.where(finite_rows(roots), 0.0, _distance(model, index, pose, nearest))
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(2):
            roots[:, j] = _polish(model, index, pose, roots[:, j])
    return roots, missing


def _inner_product(model: Model, index: int, pose: Array, u: Array | float) -> Array:
    """Return the raw inner product of the limb's first closure equation (N,), m^2 or m."""
    kind = model.mechanism.limbs[index].kind
    body = kind.evaluate({**model.limb_values[index], U: np.asarray(u, dtype=float)})
    carried = cga.move_vector(pose, body.moving[:, 0])
    return np.asarray(cga.inner(body.fixed[:, 0], carried), dtype=float)


def _distance(model: Model, index: int, pose: Array, u: Array) -> Array:
    """Return how far the limb ends from closing at joint coordinates ``u`` (N,), m."""
    kind = model.mechanism.limbs[index].kind
    body = kind.evaluate({**model.limb_values[index], U: np.where(np.isfinite(u), u, 0.0)})
    c = cga.inner(body.fixed[:, 0], cga.move_vector(pose, body.moving[:, 0]))
    radius = body.radius[:, 0]
    apart = np.abs(np.sqrt(np.maximum(radius**2 - 2.0 * c, 0.0)) - radius)
    return np.asarray(np.where(radius > 0.0, apart, np.abs(c)), dtype=float)


def _polynomial_roots(f: Array, h: float, linear: bool) -> tuple[Array, Array]:
    """Roots of the parabola through f(h), f(2h), f(3h), and where it comes nearest to 0."""
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
    # exactly at the end of reach round-off may turn the discriminant negative
    disc = np.where((disc < 0.0) & (disc > -1e-14 * (c1 * c1 + np.abs(4 * c2 * c0))), 0.0, disc)
    with np.errstate(invalid="ignore"):
        half = np.sqrt(disc) / (2.0 * np.abs(c2))
    middle = -c1 / (2.0 * c2)
    return np.stack([middle - half, middle + half], axis=-1), middle


def _trigonometric_roots(f: Array) -> tuple[Array, Array]:
    """Roots of k + a cos u + b sin u through u = 0, 2 and -2 rad, and where it is nearest to 0."""
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


def _polish(model: Model, index: int, pose: Array, u: Array) -> Array:
    """One Newton step on the closure equation itself; kept only where it is small and finite."""
    kind = model.mechanism.limbs[index].kind
    safe = np.where(np.isfinite(u), u, 1.0)
    h = 1e-6 * (model.mechanism.reach if kind.actuator == "length" else 1.0)
    f0 = _inner_product(model, index, pose, safe)
    slope = (_inner_product(model, index, pose, safe + h)
             - _inner_product(model, index, pose, safe - h)) / (2.0 * h)
    step = -f0 / slope
    use = np.isfinite(step) & (np.abs(step) < 1e-3 * h / 1e-6)
    return np.where(np.isfinite(u), safe + np.where(use, step, 0.0), u)


@lru_cache(maxsize=256)
def home_state(mechanism: Mechanism) -> HomeState:
    """Return the joint values at home and the root that each limb uses from there on.

    Raises:
        BadInput: a limb cannot reach the home pose; names it and the missing length.
    """
    model = Model(mechanism)
    pose = mechanism.home[None]
    q = np.full(len(mechanism.actuators), np.nan)
    chosen = []
    for i, limb in enumerate(mechanism.limbs):
        roots, missing = limb_roots(model, i, pose)
        if not np.all(np.isfinite(roots)):
            factor = mechanism.units.factor("length")
            raise BadInput(
                f"the home pose cannot be reached by limb '{limb.name}' ({limb.kind.name}): "
                f"it misses by about {missing[0] / factor:.4g} {mechanism.units.length}",
                f"{mechanism.source}: home", "Check the limb's points and lengths, the home "
                f"pose and the units.{_radius_hint(mechanism)}")
        candidates = np.array([to_joint(model, i, roots[:, j])[0] for j in range(2)])
        side = _choose(mechanism, i, candidates)
        candidates = _wrap(mechanism, limb.actuator, candidates, mechanism.home_q[limb.actuator])
        chosen.append(1 if side else -1)
        if np.isnan(q[limb.actuator]):
            q[limb.actuator] = candidates[side]
    return HomeState(q, tuple(chosen))


def _radius_hint(mechanism: Mechanism) -> str:
    """Return that a diameter stands for a radius, where home could be reached otherwise."""
    for machine, _, words in other_radii(mechanism):
        model = Model(machine)
        if all(np.isfinite(limb_roots(model, i, machine.home[None])[0]).all()
               for i in range(len(machine.limbs))):
            said = words.format(reason="this home pose allows")
            return f" {said[0].upper()}{said[1:]}"
    return ""


def _choose(mechanism: Mechanism, index: int, candidates: Array) -> int:
    """Return 0 or 1: nearest to home.q if given, else the branch setting, else the larger u."""
    limb = mechanism.limbs[index]
    given = mechanism.home_q[limb.actuator]
    ratio = limb.slots.values(mechanism.values).get("ratio", 1.0)
    if limb.branch is None and np.isfinite(given):
        near = _wrap(mechanism, limb.actuator, candidates, given)
        return int(np.argmin(np.abs(near - given)))
    branch = (1 if limb.branch is None else limb.branch) * limb.kind.branch_sign
    if limb.kind.branch == "elbow":
        return int(branch > 0)
    larger = int(np.argmax(_wrap(mechanism, limb.actuator, candidates, 0.0) * np.sign(ratio)))
    return larger if branch > 0 else 1 - larger


def to_joint(model: Model, index: int, u: Array) -> Array:
    """Return q = (u - offset)/ratio of one limb."""
    v = model.limb_values[index]
    return np.asarray((u - v.get("offset", 0.0)) / v.get("ratio", 1.0), dtype=float)


def _wrap(mechanism: Mechanism, actuator: int, q: Array, near: float) -> Array:
    """Move revolute joint values by whole turns next to ``near`` (0 if unknown)."""
    if mechanism.actuator_quantity[actuator] != "angle":
        return q
    turn = 2.0 * np.pi / abs(_ratio(mechanism, actuator))
    near = 0.0 if np.isnan(near) else near
    return np.asarray(q - turn * np.round((q - near) / turn), dtype=float)


def _ratio(mechanism: Mechanism, actuator: int) -> float:
    limb = next(limb for limb in mechanism.limbs if limb.actuator == actuator)
    return limb.slots.values(mechanism.values).get("ratio", 1.0)


def inverse(model: Model, pose: Array) -> Inverse:
    """Return joint values of full poses.

    Args:
        model: the machine at its parameters.
        pose: platform-to-base motors (N, 8).

    A machine with fewer actuators than pose coordinates has poses off its surface: they
    are refused where they miss it by more than :data:`SURFACE_TOLERANCE` of the reach.
    """
    mechanism = model.mechanism
    pose = np.atleast_2d(pose)
    q = np.full((pose.shape[0], len(mechanism.actuators)), np.nan)
    state = home_state(mechanism)
    reasons = [""] * pose.shape[0]
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    for i, limb in enumerate(mechanism.limbs):
        roots, missing = limb_roots(model, i, pose)
        own = _wrap(mechanism, limb.actuator,
                    to_joint(model, i, roots[:, 1 if state.roots[i] > 0 else 0]),
                    state.q[limb.actuator])
        for n in np.flatnonzero(~np.isfinite(own)):
            reasons[n] = reasons[n] or (f"limb '{limb.name}' cannot reach: "
                                        f"misses by {missing[n] / factor:.4g} {unit}")
        empty = np.isnan(q[:, limb.actuator])
        q[empty, limb.actuator] = own[empty]
    bad = np.array([bool(r) for r in reasons])
    if len(mechanism.actuators) < mechanism.equations and not bad.all():
        off = np.full(pose.shape[0], 0.0)
        off[~bad] = np.max(np.abs(model.closure(q[~bad]).lengths(pose[~bad])), axis=1)
        for n in np.flatnonzero(off > SURFACE_TOLERANCE * mechanism.reach):
            reasons[n] = (f"the pose is off the machine's surface by {off[n] / factor:.4g} {unit}: "
                          f"leave {mechanism.equations - len(mechanism.actuators)} "
                          "coordinates empty to have them solved for")
    q[[bool(r) for r in reasons]] = np.nan
    return Inverse(q, pose, tuple(reasons))


def solve_rows(matrix: Array, right: Array) -> Array:
    """Solve (N, d, d) x = (N, d) row by row; a singular row gives nan instead of an error."""
    return solve_blocks(matrix, right[..., None])[..., 0]


def solve_blocks(matrix: Array, right: Array) -> Array:
    """Solve (N, d, d) x = (N or 1, d, m) row by row; a singular row gives nan, not an error."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        bad = ~(np.abs(np.linalg.det(matrix)) > 0.0)
        safe = np.where(bad[:, None, None], np.eye(matrix.shape[-1]), matrix)
        out = np.linalg.solve(safe, right)
        out[bad] = np.nan
        return np.asarray(out, dtype=float)
