"""Inverse kinematics: joint values of a pose, the limbs' roots that give them, and refusals.

The roots themselves, in closed form for every limb kind, are in :mod:`limb_roots`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.limb_roots import all_roots, limb_roots, nearest_joint
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Limb, Mechanism
from ppmcal.model.scaled_points import other_radii

SURFACE_TOLERANCE = 1e-6
"""A full pose may be off the machine's surface by this part of its reach."""


@dataclass(frozen=True)
class HomeState:
    """Selection by home: joint values (k,) and, per limb, one of two roots (L,), +-1.

    1 for a passive limb.
    """

    q: Array
    roots: tuple[int, ...]


@dataclass(frozen=True)
class Inverse:
    """Joint values for N poses.

    Attributes:
        q: (N, k), nan where there are none.
        pose: the full platform motors (N, 8), open coordinates solved for.
        reason: why a row has no values, empty if it has.
    """

    q: Array
    pose: Array
    reason: tuple[str, ...]

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Rows that have joint values (N,)."""
        return np.array([not r for r in self.reason], dtype=bool)


@dataclass(frozen=True)
class HomeAttempt:
    """Selection by home, as far as each limb reaches.

    ``q`` (k,) and ``roots`` (L,) as in :class:`HomeState`; ``missing`` (L,): the length by which a
    limb falls short, m, 0 if it closes, nan if its joint has no solution.
    """

    q: Array
    roots: tuple[int, ...]
    missing: Array

    @property
    def lost(self) -> tuple[int, ...]:
        """Indices of the limbs that cannot reach."""
        return tuple(np.flatnonzero(self.missing != 0.0).tolist())


@lru_cache(maxsize=256)
def home_attempt(mechanism: Mechanism) -> HomeAttempt:
    """Return the joint values at home and each limb's root, the closest value where it has none."""
    model = Model(mechanism)
    pose = mechanism.home[None]
    q = np.full(len(mechanism.actuators), np.nan)
    found = all_roots(model, pose)
    chosen, lacking = [], []
    for i, limb in enumerate(mechanism.limbs):
        if not limb.driven:
            chosen.append(1)
            lacking.append(0.0)
            continue
        roots, missing = found[i]
        reached = bool(np.all(np.isfinite(roots)))
        if not reached:
            roots = np.repeat(nearest_joint(model, i, pose)[:, None], 2, axis=1)
        candidates = np.array([to_joint(model, i, roots[:, j])[0] for j in range(2)])
        side = _choose(mechanism, i, candidates)
        candidates = wrapped(mechanism, limb.actuator, candidates, mechanism.home_q[limb.actuator])
        chosen.append(1 if side else -1)
        lacking.append(0.0 if reached else float(missing[0]))
        if np.isnan(q[limb.actuator]):
            q[limb.actuator] = candidates[side]
    return HomeAttempt(q, tuple(chosen), np.array(lacking))


@lru_cache(maxsize=256)
def home_state(mechanism: Mechanism) -> HomeState:
    """Return the joint values at home and the root that each limb keeps from there on.

    Raises:
        BadInput: a limb cannot reach the home pose; names it and the missing length.
    """
    found = home_attempt(mechanism)
    for i in found.lost:
        limb = mechanism.limbs[i]
        raise BadInput(
            f"the home pose cannot be reached by limb '{limb.name}' ({limb.kind.name}): "
            f"it {_how_far(mechanism, limb, float(found.missing[i]), 'about ')}",
            f"{mechanism.source}: home", "Check the limb's points and lengths, the home "
            f"pose and the units.{_radius_hint(mechanism)}")
    return HomeState(found.q, found.roots)


def _how_far(mechanism: Mechanism, limb: Limb, missing: float, about: str = "") -> str:
    """Return by how much a limb misses; ``missing``, m, is nan if its joint has no solution."""
    if np.isnan(missing):
        return limb.kind.cannot_turn
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    return f"misses by {about}{missing / factor:.4g} {unit}"


def _radius_hint(mechanism: Mechanism) -> str:
    """Return the hint that a diameter was given for a radius, if home could then be reached."""
    for machine, _, words in other_radii(mechanism):
        model = Model(machine)
        if all(np.isfinite(limb_roots(model, i, machine.home[None])[0]).all()
               for i in machine.driven):
            said = words.format(reason="this home pose allows")
            return f" {said[0].upper()}{said[1:]}"
    return ""


def _choose(mechanism: Mechanism, index: int, candidates: Array) -> int:
    """Return 0 or 1: closest to home.q if given, else the branch setting, else the larger u."""
    limb = mechanism.limbs[index]
    given = mechanism.home_q[limb.actuator]
    ratio = limb.slots.values(mechanism.values).get("ratio", 1.0)
    if limb.branch is None and np.isfinite(given) and not limb.kind.strut:
        near = wrapped(mechanism, limb.actuator, candidates, given)
        return int(np.argmin(np.abs(near - given)))
    branch = (1 if limb.branch is None else limb.branch) * limb.kind.branch_sign
    if limb.kind.branch == "elbow":
        return int(branch > 0)
    larger = int(np.argmax(wrapped(mechanism, limb.actuator, candidates, 0.0) * np.sign(ratio)))
    return larger if branch > 0 else 1 - larger


def to_joint(model: Model, index: int, u: Array) -> Array:
    """Return q = (u - offset)/ratio of one limb."""
    v = model.limb_values[index]
    return np.asarray((u - v.get("offset", 0.0)) / v.get("ratio", 1.0), dtype=float)


def wrapped(mechanism: Mechanism, actuator: int, q: Array, near: float) -> Array:
    """Move revolute joint values by whole turns close to ``near`` (0 if unknown)."""
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
    are refused if off by more than :data:`SURFACE_TOLERANCE` of the reach.
    """
    mechanism = model.mechanism
    pose = np.atleast_2d(pose)
    q = np.full((pose.shape[0], len(mechanism.actuators)), np.nan)
    state = home_state(mechanism)
    reasons = [""] * pose.shape[0]
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    for i, (roots, missing) in all_roots(model, pose).items():
        limb = mechanism.limbs[i]
        own = wrapped(mechanism, limb.actuator,
                    to_joint(model, i, roots[:, 1 if state.roots[i] > 0 else 0]),
                    state.q[limb.actuator])
        for n in np.flatnonzero(~np.isfinite(own)):
            reasons[n] = reasons[n] or (f"limb '{limb.name}' cannot reach: "
                                        f"{_how_far(mechanism, limb, float(missing[n]))}")
        empty = np.isnan(q[:, limb.actuator])
        q[empty, limb.actuator] = own[empty]
    bad = np.array([bool(r) for r in reasons])
    if mechanism.dependent and not bad.all():
        off = np.full(pose.shape[0], 0.0)
        off[~bad] = np.max(np.abs(model.closure(q[~bad]).lengths(pose[~bad])), axis=1)
        for n in np.flatnonzero(off > SURFACE_TOLERANCE * mechanism.reach):
            reasons[n] = (f"the pose is off the machine's surface by {off[n] / factor:.4g} {unit}: "
                          f"leave {mechanism.dependent} "
                          "coordinates empty to have them solved for")
    q[[bool(r) for r in reasons]] = np.nan
    return Inverse(q, pose, tuple(reasons))
