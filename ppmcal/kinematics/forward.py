"""Forward kinematics: Newton on the stacked closure, in the assembly mode of home.

The stacked closure equations c(M, q) = 0 are solved for the platform motor M by Newton steps on
the pose matrix A. A direct solution from the start is trusted where Newton contracts
from its first step on; elsewhere the joints are led from the start to their values in
smaller steps, so that the assembly mode reached is the one that the machine would reach.
A row that meets a singularity on the way is reported, never returned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.compiled_limbs import compiled_limbs
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.least_squares_closure import newton_step
from ppmcal.linalg import Array, Bools, finite_rows

CONTRACTION = 0.25
"""A second Newton step above this part of the first means: lead the joints in smaller steps."""
SMALLEST_STEP = 1.0 / 512.0
NEWTON_STEPS = 25
STEP = 1e-11
"""Converged: the last step, translations in parts of the length scale, is below this."""
CLOSED = 1e-12
"""Closed: every misclosure below this part of the reach."""


@dataclass(frozen=True)
class Forward:
    """Poses for N rows of joint values.

    Attributes:
        pose: motors (N, 8), nan where there is none.
        converged: (N,).
        progress: how far of the way from the start each row got, 1 where converged (N,).
        reason: why a row has no pose, where more is known than that; (N,) or empty.
    """

    pose: Array
    converged: Bools
    progress: Array
    reason: tuple[str, ...] = ()


def forward(model: Model, q: Array, start: Array | None = None, start_q: Array | None = None
            ) -> Forward:
    """Return the poses at joint values ``q`` (N, k).

    Args:
        model: the machine at its parameters.
        q: joint values, SI.
        start: motors (N, 8) or (8,) to start from, default home.
        start_q: joint values at ``start``, default home's; needed for leading the joints.
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    home = home_state(model.mechanism)
    pose = np.array(np.broadcast_to(model.mechanism.home if start is None else start,
                                    (q.shape[0], 8)))
    origin = np.array(np.broadcast_to(home.q if start_q is None else start_q, q.shape))
    usable = finite_rows(q) & finite_rows(pose)
    if model.mechanism.surplus and usable.any():
        # surplus limbs contradict each other at the start: the way begins where they do least
        some = np.flatnonzero(usable)
        closest, found, _ = newton(model.take(some).closure(origin[some]), pose[some])
        pose[some[found]] = closest[found]
    progress = np.zeros(q.shape[0])
    result = np.full_like(pose, np.nan)
    rows = np.flatnonzero(usable)
    if rows.size:
        solved, good = _attempt(model.take(rows), q[rows], pose[rows])
        result[rows[good]] = solved[good]
        progress[rows[good]] = 1.0
        rest = rows[~good]
        if rest.size:
            result[rest], progress[rest] = _lead(model.take(rest), origin[rest], q[rest],
                                                 pose[rest])
    return Forward(result, progress >= 1.0, progress)


def _attempt(model: Model, q: Array, pose: Array) -> tuple[Array, Bools]:
    """Newton at ``q`` from ``pose``; good rows converged, contracting, on the same side."""
    closure = model.closure(q)
    tables = compiled_limbs(closure, pose.shape[0])
    if tables is not None:
        solved, converged, sizes, signs = tables.newton(pose, NEWTON_STEPS, STEP, CLOSED)
        same = signs[:, 0] == signs[:, 1]
        return solved, converged & same & (_contraction(sizes) <= CONTRACTION)
    with np.errstate(invalid="ignore"):  # nan where an offset universal joint cannot stand
        c, lines = closure.misclosure_and_lines(pose)
        matrix = closure.pose_matrix(pose, lines)
        side = np.sign(linalg.determinant(matrix))
    solved, converged, contraction = newton(closure, pose, most=CONTRACTION, begin=(c, matrix))
    same = np.zeros(q.shape[0], dtype=bool)
    if converged.any():
        same[converged] = side[converged] == np.sign(linalg.determinant(
            closure.pose_matrix(solved))[converged])
    return solved, converged & same & (contraction <= CONTRACTION)


def _lead(model: Model, origin: Array, q: Array, pose: Array) -> tuple[Array, Array]:
    """Lead the joints from ``origin`` to ``q`` in steps that Newton follows safely."""
    n = q.shape[0]
    at, step = np.zeros(n), np.full(n, 0.5)
    pose = pose.copy()
    active = np.ones(n, dtype=bool)
    while active.any():
        rows = np.flatnonzero(active)
        to = np.minimum(at[rows] + step[rows], 1.0)
        goal = origin[rows] + to[:, None] * (q[rows] - origin[rows])
        solved, good = _attempt(model.take(rows), goal, pose[rows])
        pose[rows[good]], at[rows[good]] = solved[good], to[good]
        step[rows] = np.where(good, step[rows] * 1.5, step[rows] / 2.0)
        active[rows] = (at[rows] < 1.0) & (step[rows] >= SMALLEST_STEP)
    pose[at < 1.0] = np.nan
    return pose, at


def newton(closure: Closure, pose: Array, iterations: int = NEWTON_STEPS, most: float = np.inf,
           begin: tuple[Array, Array] | None = None) -> tuple[Array, Bools, Array]:
    """Solve the closure for the motors, batched.

    Rows that contract by less than ``most`` in their second step are given up then. ``begin``:
    misclosure and pose matrix at ``pose``, where they are known.

    Returns:
        motors (N, 8), converged (N,), and the ratio of the second step's length to the
        first's (N,), a measure of how safe the start was.
    """
    mechanism = closure.model.mechanism
    scale, reach = mechanism.length_scale, mechanism.reach
    tables = compiled_limbs(closure, pose.shape[0])
    if tables is not None:
        pose, converged, two, _ = tables.newton(pose, iterations, STEP, CLOSED)
        return pose, converged, _contraction(two)
    pose, slow = np.array(pose), np.zeros(pose.shape[0], dtype=bool)
    sizes: list[Array] = []
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(iterations):
            if sizes or begin is None:
                c, lines = closure.misclosure_and_lines(pose)
                matrix = closure.pose_matrix(pose, lines)
            else:
                c, matrix = begin
            step = np.zeros((pose.shape[0], 6))
            step[:, mechanism.dof] = newton_step(closure, pose, c, matrix)
            size = np.hypot(np.linalg.norm(step[:, :3], axis=1) / scale,
                            np.linalg.norm(step[:, 3:], axis=1))
            sizes.append(size)
            if len(sizes) == 2 and most < np.inf:
                slow = _contraction(np.stack(sizes, axis=-1)) > most
            finite = np.isfinite(size) & (size < 10.0 * reach / scale) & ~slow
            step[~finite] = 0.0
            pose = moved(pose, step)
            # what surplus equations leave is least there, not 0
            closed = (np.max(np.abs(c), axis=1) < CLOSED * reach) | (mechanism.surplus > 0)
            converged = finite & (size < STEP) & closed
            if (converged | ~finite).all():
                break
    second = sizes[1] if len(sizes) > 1 else np.zeros_like(sizes[0])
    return pose, converged, _contraction(np.stack([sizes[0], second], axis=-1))


def _contraction(sizes: Array) -> Array:
    """Return the second step's length over the first's (N,), of both (N, 2)."""
    first, second = sizes.T
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(first > 1e-6, second / first, 0.0)
    return np.where(np.isfinite(ratio), ratio, np.inf)


def moved(pose: Array, step: Array) -> Array:
    """Return motors (N, 8) moved by (origin displacement, rotation) steps (N, 6)."""
    rotor = cga.rotated(pose, step[:, 3:])
    return cga.compose(cga.translator(cga.translation(pose) + step[:, :3]), rotor)


def smallest_singular_value(closure: Closure, pose: Array) -> tuple[Array, Array]:
    """Return the smallest singular value of A (N,) and the sign of its determinant (N,).

    Rotation columns are divided by the machine's length scale
    (:attr:`Mechanism.length_scale`), so the value is a pure number: how far the stiffest
    leg line moves for the softest unit motion. 0 means singular.
    """
    matrix = closure.pose_matrix(pose).copy()
    rotation = [i for i, c in enumerate(closure.model.mechanism.dof) if c >= 3]
    matrix[..., rotation] /= closure.model.mechanism.length_scale
    value = np.full(matrix.shape[0], np.nan)
    sign = np.full(matrix.shape[0], np.nan)
    finite = np.isfinite(matrix).all(axis=(1, 2))
    if finite.any():
        value[finite] = linalg.singular_values(matrix[finite])[:, -1]
        sign[finite] = np.sign(linalg.determinant(matrix[finite]))
    return value, sign
