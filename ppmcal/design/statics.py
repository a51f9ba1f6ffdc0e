"""What surplus limbs hold of a load and among themselves, by their springs; ropes only pull.

With the equations c, as many as m, the springs' own compliance S (m, m) and a wrench w the platform
moves by x to where the energy is least,

    S f = c + A x,    A' f = w,    f >= 0 of ropes,

f the force in each equation, positive where the limb pulls. What limbs gap where nothing has given
way yet, c, is held among them without any load: by commands of a geometry that is not the
machine's, or because ropes were pulled tight. A rope without tension has no row: its gap stays
open.

Ropes that are pulled tight turn with the platform, and so do their tensions t: it adds

    G = sum over limbs of t d2L,    of a rope of length L along n: t (I - n n')/L and its arm's,

to the stiffness, so that A' f + G x = w (Behzadipour and Khajepour 2006, Stiffness of cable-based
parallel manipulators with application to stability analysis).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from ppmcal import linalg
from ppmcal.design.error_jacobian import to_tool
from ppmcal.design.spring_model import Spring, spring_columns
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.least_squares_closure import EXACT, curvature, symmetric_system
from ppmcal.kinematics.loads import even_tension, only_pull
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.dataset import WRENCH
from ppmcal.model.mechanism import Mechanism

FREE = 1e-9
"""Stiffness of a direction that nothing holds, in parts of the springs': it only bounds x."""
HELD = 1e-6
"""Forces that miss the load by less than this part of it hold it."""
AT_ONCE, ONE_BY_ONE = 30, 500
"""Rounds in which all ropes that are taken wrongly change, and then the first of them alone."""
ROUND_OFF = 1e-12
"""Tensions and gaps below this part of the largest are none."""
E0 = 4
"""Place of e0 among the blades of a point, sphere or plane, which has none."""


@dataclass(frozen=True)
class AppliedLoad:
    """The load at the tool point in base axes, N and N m, and in words."""

    words: str = ""
    fx: float | None = None
    fy: float | None = None
    fz: float | None = None
    mx: float | None = None
    my: float | None = None
    mz: float | None = None

    @classmethod
    def of(cls, wrench: Array, words: str) -> Self:
        """Return the load of a wrench (6,)."""
        return cls(words=words, **dict(zip(WRENCH, wrench.tolist(), strict=True)))

    @property
    def wrench(self) -> Array:
        """Force and moment (6,)."""
        return np.array([getattr(self, c) for c in WRENCH], dtype=float)


@dataclass(frozen=True, eq=False)
class Balance:
    """Forces and motion of N poses: ``force`` (N, m), nan where limbs do not hold the load.

    ``twist`` (N, d) of the platform's origin; ``slack`` (N, m): which ropes have no tension.
    """

    force: Array
    twist: Array
    slack: Bools


def balance(a: Array, give: Array, wrench: Array, gaps: Array, ropes: Bools, size: Array,
            geometric: Array | None = None) -> Balance:
    """Return the equilibrium of the head of this module.

    The slack ropes are those of a linear complementarity problem: all that are wrong change at
    once, and where that goes round in circles one by one, which ends (Murty 1974).

    Args:
        a: pose matrix (N, m, d).
        give: what the equations move by per root of compliance of each spring (N, m, s).
        wrench: on the platform at its origin (N, d).
        gaps: of the equations where nothing has given way (N, m), positive where limbs are short.
        ropes: which equations only pull (m,).
        size: of each coordinate (d,), which makes rotations lengths.
        geometric: stiffness of the preload (N, d, d), at the platform's origin; None without one.
    """
    m, d = a.shape[-2:]
    system, total = symmetric_system(give, a / size, EXACT)
    system[:, m:, m:] = -FREE * np.eye(d)
    unit = total[..., 0]
    if geometric is not None:
        system[:, m:, m:] -= geometric * total / (size[:, None] * size)
    with np.errstate(invalid="ignore", divide="ignore"):
        right = np.concatenate([gaps / unit, wrench / size], axis=-1)
    taut = np.ones((len(a), m), dtype=np.bool_)
    out = np.zeros((len(a), m + d))
    busy = np.arange(len(a))
    for n in range(AT_ONCE + ONE_BY_ONE):
        out[busy] = _of_taut(system[busy], right[busy], taut[busy])
        left = right[busy, :m] - (system[busy, :m] @ out[busy][..., None])[..., 0]
        bound = ROUND_OFF * np.maximum(np.abs(out[busy, :m]), np.abs(right[busy, :m])).max(
            axis=1, keepdims=True)
        wrong = np.where(taut[busy], out[busy, :m] < -bound, left > bound) & ropes
        if n >= AT_ONCE:    # the first of them alone
            wrong &= np.cumsum(wrong, axis=1) == 1
        taut[busy] ^= wrong
        busy = busy[wrong.any(axis=1)]
        if not busy.size:
            break
    force, twist = out[:, :m], -out[:, m:] * unit / size
    load = wrench / size
    off = (np.swapaxes(a / size, -1, -2) @ force[..., None])[..., 0] - load
    if geometric is not None:
        off += (geometric @ twist[..., None])[..., 0] / size
    largest = np.maximum(np.linalg.norm(load, axis=1), np.abs(force).max(axis=1, initial=0.0))
    lost = ~(np.linalg.norm(off, axis=1) <= HELD * largest)
    lost[busy] = True
    blank = np.where(lost, np.nan, 1.0)[:, None]
    return Balance(force * blank, twist * blank, ~taut)


def _of_taut(system: Array, right: Array, taut: Bools) -> Array:
    """Return forces and motion (n, m + d) where ropes that are not taut (n, m) have no row."""
    there = np.concatenate([taut, np.ones((len(taut), system.shape[-1] - taut.shape[1]),
                                          dtype=np.bool_)], axis=1)
    own = np.where(there[:, :, None] & there[:, None, :], system, np.eye(system.shape[-1]))
    return linalg.solve_rows(own, np.where(there, right, 0.0))


@dataclass(frozen=True, eq=False)
class LimbForces:
    """What limbs hold at N poses, equation by equation; positive where they pull, N or N m.

    ``idle`` (N, m): among themselves, without a load, None where the file's geometry is nominal and
    nothing is pulled tight; ``loaded`` (N, m) under a load, ``deflection`` (N, 6) of the tool by
    it, None without one; ``slack`` (N, m): ropes that have no tension then. nan where limbs do not
    hold the platform. ``geometric`` (N, d, d): stiffness that the tension of tight ropes adds at
    the platform's origin, 0 where they cannot be tight; None without a tension.
    """

    idle: Array | None
    loaded: Array | None
    deflection: Array | None
    slack: Bools
    geometric: Array | None = None

    @property
    def forces(self) -> Array | None:
        """Under the load, without one those held among themselves (N, m); None without either."""
        return self.idle if self.loaded is None else self.loaded

    def at(self, rows: Ints, count: int, told: Bools) -> LimbForces:
        """Return the forces of ``count`` poses, these being ``rows`` of them.

        nan at the others, and where they are not ``told`` (N,).
        """
        def spread(values: Array | None) -> Array | None:
            if values is None:
                return None
            out = np.full((count, values.shape[1]), np.nan)
            out[rows[told]] = values[told]
            return out

        slack = np.zeros((count, self.slack.shape[1]), dtype=np.bool_)
        slack[rows[told]] = self.slack[told]
        return LimbForces(spread(self.idle), spread(self.loaded), spread(self.deflection), slack)


def limb_forces(mechanism: Mechanism, springs: tuple[Spring, ...], q: Array, pose: Array,
                tool: Array, wrench: Array | None, tension: float = 0.0) -> LimbForces | None:
    """Return what surplus limbs hold at closed poses; None of other machines.

    Where the file's values are not the nominal ones the controller commands the nominal machine,
    and limbs hold against each other what it is wrong by.

    Args:
        mechanism: without effects.
        springs: of the machine.
        q: joint values (N, k).
        pose: platform motors (N, 8).
        tool: tool point in platform axes (3,), m.
        wrench: load at the tool point, base axes (6,), or None.
        tension: of ropes without a load, their mean, N.
    """
    if not mechanism.surplus:
        return None
    model, dof = Model(mechanism), list(mechanism.dof)
    closure = model.closure(q)
    lines = closure.lines(pose)
    a = closure.pose_matrix(pose, lines)
    give = spring_columns(closure, pose, lines, springs) * np.sqrt([s.compliance for s in springs])
    ropes = only_pull(mechanism)
    size = np.array([1.0 if c < 3 else mechanism.length_scale for c in dof])
    gaps, still = _gaps(mechanism, pose), np.zeros((len(pose), len(dof)))
    bounded = np.all(np.abs(give).max(axis=-1) > 0.0)
    if not bounded:     # what rigid limbs hold among themselves has no bound
        gaps = np.zeros_like(gaps)
    if tension:
        pulled = even_tension(mechanism, a, ropes, tension)
        gaps = gaps + (give @ (np.swapaxes(give, -1, -2) @ pulled[..., None]))[..., 0]
    begin, geometric = balance(a, give, still, gaps, ropes, size), None
    if tension:
        geometric = geometric_stiffness(closure, pose, a, np.nan_to_num(begin.force))
        begin = balance(a, give, still, gaps, ropes, size, geometric)
    idle = begin.force if np.any(gaps) else None
    if wrench is None:
        return LimbForces(idle, None, None, begin.slack & (idle is not None), geometric)
    carry = to_tool(pose, tool)[:, dof][:, :, dof]
    load = (np.swapaxes(carry, -1, -2) @ wrench[dof])
    under = balance(a, give, load, gaps, ropes, size, geometric)
    moved = np.where(np.isfinite(under.twist).all(axis=1), 0.0, np.nan)[:, None] * np.ones(6)
    moved[:, dof] = (carry @ (under.twist - begin.twist)[..., None])[..., 0]
    return LimbForces(idle, under.force, moved, under.slack, geometric)


def geometric_stiffness(closure: Closure, pose: Array, a: Array, force: Array) -> Array:
    """Return the stiffness that forces held in the limbs add (N, d, d), at the platform's origin.

    The second derivative of the limbs' true lengths by the pose, which of spheres is that of c
    without its part along the rope (Behzadipour and Khajepour 2006). Symmetric where the forces
    balance each other; of ropes over pulleys at the tangent where they leave.

    Args:
        closure: of N rows.
        pose: closed motors (N, 8).
        a: pose matrix (N, m, d).
        force: in the equations (N, m), positive where they pull, N.
    """
    here = closure.at(pose)
    # c of a point on a sphere goes with the squared distance, of a plane with the distance itself
    squares = here.fixed[..., E0] * here.carried(pose)[..., E0]
    along = -force * here.scale * squares
    return curvature(closure, pose, force) - np.swapaxes(a, -1, -2) @ (along[..., None] * a)


def _gaps(mechanism: Mechanism, pose: Array) -> Array:
    """Return what limbs gap at poses (N, 8) with the joints of the nominal machine (N, m)."""
    nominal = mechanism.nominal()
    if np.array_equal(nominal.values, mechanism.values):
        return np.zeros((len(pose), mechanism.equations))
    there = inverse(Model(nominal), pose).q
    return Model(mechanism).closure(there).lengths(pose)
