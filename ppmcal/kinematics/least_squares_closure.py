"""Closure by least squares: more closure equations than the platform has freedoms.

Joints read q with errors e, so that c(M, q + e, g) = 0: the pose of a row minimises c' S^-1 c, with

    S = Ju Su Ju' + Sc,

up to a factor that does not affect the pose: Su is the joints' noise, equal for all, and Sc that of
closure gaps (``closure`` of the file), 0 if not given. One symmetric system
contains everything that follows,

    | S  A | | f |   | c |
    | A' 0 | | x | = | w |,

for gaps c the twist x that closes them best, for a wrench w the forces f in the limbs. An equation
without a drive has a 0 in S and holds exactly. With as many equations as freedoms, f is A'^-1 w and
x is A^-1 c for any S, and they are then computed that way.

The information in the surplus equations is what no pose explains: N' c, with N an orthonormal basis
of the forces that the limbs hold among themselves (A' N = 0). It is independent of the pose error.
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
"""Relative variance of an equation that holds exactly, since two such may be redundant."""
SMALL = 1e-2
"""If limbs gap, steps below this part of the length scale use the closure's curvature, if that
leads down."""
ALIGNED = 1e-3
"""Forces at more than arccos of this from those at home get a basis of their own."""


def closed_by(closure: Closure, pose: Array, a: Array, gaps: Array, lines: Array | None = None,
              give: Array | None = None) -> Array:
    """Return the twists that close gaps best, A^-1 gaps with as many equations as freedoms.

    Args:
        closure: of N rows.
        pose: motors (N, 8).
        a: pose matrix (N, m, d).
        gaps: changes of the closure equations (N, m, r).
        lines: of the legs (N, m, 6), if already known.
        give: motion of the equations per unit of what gives way, springs or unit noise
            (N, m, s); default the drives and the gaps.

    Returns:
        (N, d, r), nan in rows where A does not have full rank.
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
    """Return the motion of equations by the joints' noise (n, m, k), and by limbs' gaps (m,)."""
    if not gaps.any():
        return by_joint
    own = np.broadcast_to(np.diag(gaps)[:, gaps > 0.0], (len(by_joint), len(gaps),
                                                         int(np.sum(gaps > 0.0))))
    return np.concatenate([by_joint, own], axis=-1)


def symmetric_system(give: Array, a: Array, exact: float = 0.0) -> tuple[Array, Array]:
    """Return the matrices (N, m + d, m + d) from the module's head, and the size of S (N, 1, 1).

    S is relative to that size, which does not affect the pose, to keep systems well scaled.

    Args:
        give: motion of the equations (N, m, s), as in :func:`closed_by`.
        a: pose matrix (N, m, d).
        exact: added to the variance of each equation, relative to the size.
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

    With as many equations as freedoms -A^-1 c. Otherwise with the curvature of the closure: gaps
    that are not small against the machine, as before any calibration, bend the way there.

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
    # far off, the curvature may lead uphill: then take the step without it
    gradient = (np.swapaxes(a, -1, -2) @ forces[..., None])[..., 0]
    with np.errstate(invalid="ignore"):
        down = np.sum(bent * gradient, axis=1) <= 0.0
        near = np.linalg.norm(bent - step, axis=1) <= np.linalg.norm(step, axis=1)
        if mechanism.gap_sigma.any():
            # unequal weights may leave a direction that hardly anything but the curvature holds
            size = [1.0 if i < 3 else mechanism.length_scale for i in mechanism.dof]
            near |= np.linalg.norm(bent * size, axis=1) < SMALL * mechanism.length_scale
    return np.where((down & near)[:, None], bent, step)


def curvature(closure: Closure, pose: Array, forces: Array) -> Array:
    """Return the second derivative of c by the pose, summed over forces (N, m) (N, d, d).

    c = s F . X, and a twist moves X by B x X: by twists a and b twice -s (a x F) . (b x X), about
    the platform's origin, symmetrised.
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
    """Return N (n, m, m - d) of pose matrices (n, m, d): no pose explains N' c.

    It turns as little as possible from the one at home, so that it is the same combination of
    limbs from row to row.
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


def unexplained(closure: Closure, pose: Array) -> Array:
    """Return N' c (n, m - d) at platform motors (n, 8), m, which no pose explains."""
    c, lines = closure.misclosure_and_lines(pose)
    own = surplus(closure.model.mechanism, closure.pose_matrix(pose, lines))
    return np.asarray((np.swapaxes(own, -1, -2) @ c[..., None])[..., 0])


@lru_cache(maxsize=64)
def _surplus_at_home(mechanism: Mechanism) -> Array:
    """Return N (m, m - d) at home: the parts of the first equations that no pose explains."""
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
