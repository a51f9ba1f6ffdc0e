"""Closure by least squares: more closure equations than the platform has freedoms.

Joints say q with errors e, so that c(M, q + e, g) = 0: the pose of a row minimises c' S^-1 c, where

    S = Ju Su Ju' + Sc,

up to a factor that no pose depends on: Su of the joints' noise, alike for all, and Sc of what limbs
may gap (``closure`` of the file), 0 where it says nothing. One symmetric system
says all that follows from it,

    | S  A | | f |   | c |
    | A' 0 | | x | = | w |,

for gaps c the twist x that closes them best, for a wrench w the forces f in the limbs. An equation
without a drive has a 0 in S and holds exactly. With as many equations as freedoms f is A'^-1 w and
x is A^-1 c whatever S is: that is how they are then computed.

What the surplus equations tell is what no pose explains: N' c, with N an orthonormal basis of the
forces that the limbs hold among themselves (A' N = 0). It does not depend on the error of the pose.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array, solve_blocks, solve_rows
from ppmcal.model.mechanism import Mechanism

EXACT = 1e-10
"""Variance of an equation that holds exactly, in parts of the others': two may say the same."""
SMALL = 1e-2
"""Where limbs gap, steps below this part of the length scale take the closure's curvature, if that
leads down."""
ALIGNED = 1e-3
"""Forces that turn by more than arccos of this from those at home have a basis of their own."""


def closed_by(closure: Closure, pose: Array, a: Array, gaps: Array, lines: Array | None = None,
              give: Array | None = None) -> Array:
    """Return the twists that close gaps best, A^-1 gaps where equations are as many as freedoms.

    Args:
        closure: of N rows.
        pose: motors (N, 8).
        a: pose matrix (N, m, d).
        gaps: changes of the closure equations (N, m, r).
        lines: of the legs (N, m, 6), where they are known already.
        give: what the equations move by per unit of what gives way, springs or noise of size one
            (N, m, s); default the drives and the gaps.

    Returns:
        (N, d, r), nan in rows where A has not full rank.
    """
    if not closure.model.mechanism.surplus:
        return solve_blocks(a, gaps)
    m, d = a.shape[-2:]
    right = np.concatenate([gaps, np.zeros((*gaps.shape[:-2], d, gaps.shape[-1]))], axis=-2)
    return solve_blocks(_system(closure, pose, a, lines, give), right)[:, m:]


def held_by(closure: Closure, pose: Array, a: Array, wrenches: Array, lines: Array | None = None,
            give: Array | None = None) -> Array:
    """Return the forces with which the equations hold wrenches: the transpose of :func:`closed_by`.

    Arguments as there; ``wrenches`` (N, d, r), result (N, m, r).
    """
    if not closure.model.mechanism.surplus:
        return solve_blocks(np.swapaxes(a, -1, -2), wrenches)
    m = a.shape[-2]
    right = np.concatenate([np.zeros((*wrenches.shape[:-2], m, wrenches.shape[-1])), wrenches],
                           axis=-2)
    return solve_blocks(_system(closure, pose, a, lines, give), right)[:, :m]


def _system(closure: Closure, pose: Array, a: Array, lines: Array | None, give: Array | None
            ) -> Array:
    """Return the symmetric matrices (N, m + d, m + d)."""
    if give is None:
        give = closure.joint_matrix(pose, lines, drive=False)
        gaps = closure.model.mechanism.gap_sigma
        if gaps.any():
            give = with_gaps(give * closure.model.mechanism.usual_joint_noise, gaps)
    return symmetric_system(give, a, EXACT)[0]


def with_gaps(by_joint: Array, gaps: Array) -> Array:
    """Return what equations move by with the joints' noise (n, m, k), and by limbs' gaps (m,)."""
    if not gaps.any():
        return by_joint
    own = np.broadcast_to(np.diag(gaps)[:, gaps > 0.0], (len(by_joint), len(gaps),
                                                         int(np.sum(gaps > 0.0))))
    return np.concatenate([by_joint, own], axis=-1)


def symmetric_system(give: Array, a: Array, exact: float = 0.0) -> tuple[Array, Array]:
    """Return the matrices (N, m + d, m + d) of this module's head, and the size of S (N, 1, 1).

    S is in parts of that size: no pose depends on it, and systems of size one are well scaled.

    Args:
        give: what the equations move by (N, m, s), as in :func:`closed_by`.
        a: pose matrix (N, m, d).
        exact: added to the variance of each equation, in parts of the size.
    """
    m, d = a.shape[-2:]
    variance = give @ np.swapaxes(give, -1, -2)
    size = np.trace(variance, axis1=-2, axis2=-1)[:, None, None] / m
    out = np.zeros((len(a), m + d, m + d))
    with np.errstate(invalid="ignore", divide="ignore"):
        out[:, :m, :m] = variance / size + exact * np.eye(m)
    out[:, :m, m:], out[:, m:, :m] = a, np.swapaxes(a, -1, -2)
    return out, size


def newton_step(closure: Closure, pose: Array, c: Array, a: Array, lines: Array) -> Array:
    """Return the Newton step (N, d) from a pose to the one that closes best.

    With equations as many as freedoms -A^-1 c. Else with the curvature of the closure: a gap that
    is not small against the machine, as before any calibration, bends the way there.

    Args:
        closure: of N rows.
        pose: motors (N, 8).
        c: misclosure there (N, m).
        a: pose matrix there (N, m, d).
        lines: of the legs there (N, m, 6).
    """
    mechanism = closure.model.mechanism
    if not mechanism.surplus:
        return -solve_rows(a, c)
    m = a.shape[1]
    system = _system(closure, pose, a, lines, None)
    forces = solve_rows(system[:, :m, :m], c)
    right = np.pad(c, ((0, 0), (0, a.shape[2])))
    step = -solve_rows(system, right)[:, m:]
    system[:, m:, m:] -= curvature(closure, pose, forces)
    bent = -solve_rows(system, right)[:, m:]
    # far off the curvature may lead uphill: then the step without it
    gradient = (np.swapaxes(a, -1, -2) @ forces[..., None])[..., 0]
    with np.errstate(invalid="ignore"):
        down = np.sum(bent * gradient, axis=1) <= 0.0
        near = np.linalg.norm(bent - step, axis=1) <= np.linalg.norm(step, axis=1)
        if mechanism.gap_sigma.any():
            # unlike weights may leave a way that hardly anything holds but the curvature
            size = [1.0 if i < 3 else mechanism.length_scale for i in mechanism.dof]
            near |= np.linalg.norm(bent * size, axis=1) < SMALL * mechanism.length_scale
    return np.where((down & near)[:, None], bent, step)


def curvature(closure: Closure, pose: Array, forces: Array) -> Array:
    """Return what forces (N, m) make of the second derivative of c by the pose (N, d, d).

    c = s F . X, and a twist moves X by B x X: by twists a and b twice -s (a x F) . (b x X), about
    the platform's origin, with its like.
    """
    here = closure.at(pose)
    to_origin = cga.translator(-cga.translation(np.atleast_2d(pose)))[:, None]
    fixed, moved = (cga.move_vector(to_origin, part)[:, :, None]
                    for part in (here.fixed, here.carried(pose)))
    units = np.eye(6)[[(c + 3) % 6 for c in closure.model.mechanism.dof]]  # (rotation, motion)
    by_fixed, by_moved = cga.rate(units, fixed), cga.rate(units, moved)
    metric = np.zeros((5, 5))
    metric[:3, :3], metric[3, 4], metric[4, 3] = np.eye(3), -1.0, -1.0
    weight = (forces * here.scale)[..., None, None]
    half = -0.5 * np.sum(weight * (by_fixed @ metric @ np.swapaxes(by_moved, -1, -2)), axis=1)
    return np.asarray(half + np.swapaxes(half, -1, -2))


def surplus(mechanism: Mechanism, a: Array) -> Array:
    """Return N (n, m, m - d) of pose matrices (n, m, d): what no pose explains is N' c.

    It turns as little as may be from the one at home, so that it is the same combination of limbs
    from row to row.
    """
    a = np.where(np.isfinite(a), a, 0.0)
    q = linalg.column_basis(a)
    free = np.eye(a.shape[-2]) - q @ np.swapaxes(q, -1, -2)
    # polar part: the nearest orthonormal basis
    u, s, vt = linalg.svd(free @ _surplus_at_home(mechanism))
    out = u @ vt
    turned = s[:, -1] < ALIGNED
    if turned.any():
        out[turned] = linalg.svd(a[turned], full=True)[0][..., a.shape[-1]:]
    return np.asarray(out)


@lru_cache(maxsize=64)
def _surplus_at_home(mechanism: Mechanism) -> Array:
    """Return N (m, m - d) at home: the first equations' parts that no pose explains."""
    model = Model(mechanism.nominal())
    a = model.closure(home_state(model.mechanism).q).pose_matrix(mechanism.home[None])[0]
    q = linalg.column_basis(a)
    free = np.eye(len(a)) - q @ q.T
    out: list[Array] = []
    for column in free.T:
        rest = column - sum((own * (own @ column) for own in out), np.zeros(len(a)))
        if np.linalg.norm(rest) > 0.1 and len(out) < len(a) - a.shape[1]:
            out.append(rest / np.linalg.norm(rest))
    return np.stack(out, axis=1)
