"""What errors of the geometry do to the tool: J_g and what follows from it.

One line per leg gives every error's effect ([LIN] section 2.5): J_g = -A^-1 Bg, an outer
product per leg. Carried to the tool point, whose position and rotation are looked at
apart. Shapes: N poses, S errors; the six rows of J_g are displacement and rotation in base
axes, m and rad per m or rad of the error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.compiled_limbs import compiled_limbs
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.least_squares_closure import closed_by
from ppmcal.linalg import Array, determinant, finite_rows
from ppmcal.model.limbs.chain import cross_matrix

CHUNK = 8192
ROUNDS, STARTS = 30, 150


@dataclass(frozen=True, eq=False)
class Poses:
    """Closed poses: joint values (N, k), motors (N, 8), and the tool point in platform axes."""

    q: Array
    motor: Array
    tool: Array

    def chunks(self) -> Iterator[tuple[slice, Array, Array]]:
        """Yield rows, joint values and motors, some at a time."""
        for begin in range(0, len(self.q), CHUNK):
            rows = slice(begin, begin + CHUNK)
            yield rows, self.q[rows], self.motor[rows]


def tool_matrix(closure: Closure, pose: Array, lines: Array, tool: Array) -> Array:
    """Return -d(tool)/d(closure equation) = T A^-1 (N, 6, m): how far the tool goes per unit of c.

    T carries displacements of the platform origin to the tool point (3,), platform axes. A
    singular pose gives nan.
    """
    a = closure.pose_matrix(pose, lines)
    every = np.broadcast_to(np.eye(a.shape[-2]), (len(a), *2 * a.shape[-2:-1]))
    return to_tool(pose, tool)[..., closure.model.mechanism.dof] @ closed_by(
        closure, pose, a, every, lines)


def to_tool(pose: Array, tool: Array) -> Array:
    """Return T (N, 6, 6): motions of the platform's origin to those of the tool point (3,)."""
    carry = np.tile(np.eye(6), (len(pose), 1, 1))
    if tool.any():
        carry[:, :3, 3:] = -cross_matrix(cga.rotation_matrix(pose) @ tool)
    return carry


def error_jacobian(model: Model, at: Poses, wanted: Sequence[int]) -> Array:
    """Return J_g (N, 6, S) of the parameters ``wanted``, dense."""
    out = np.zeros((len(at.q), 6, len(wanted)))
    place = {p: i for i, p in enumerate(wanted)}
    tables = compiled_limbs(model.closure(at.q, wanted), len(at.q))
    if tables is not None:
        carry = to_tool(at.motor, at.tool) if at.tool.any() else np.eye(6)[None]
        if tables.error_columns(at.motor, carry, place, out):
            return out
    for rows, q, pose in at.chunks():
        closure = model.closure(q, wanted)
        lines = closure.lines(pose)
        carry = tool_matrix(closure, pose, lines, at.tool)
        for equations, parameters, block in closure.error_blocks(pose, lines):
            out[rows][..., [place[p] for p in parameters]] -= carry[..., equations] @ block
    return out


def covariance(model: Model, at: Poses, wanted: Sequence[int], sigma: Array) -> Array:
    """Return the tool's covariance (N, 6, 6) for independent errors of deviations sigma (S,).

    J_g S J_g^T without forming J_g: legs that share no parameter add up one by one, each a
    small matrix between two columns of A^-1. With sigma 1 its trace is the square of [LIN]'s
    error amplification index (eq. 16).
    """
    out = np.empty((len(at.q), 6, 6))
    variance = np.zeros(max(wanted, default=0) + 1)
    variance[list(wanted)] = sigma**2
    for rows, q, pose in at.chunks():
        closure = model.closure(q, wanted)
        lines = closure.lines(pose)
        carry = tool_matrix(closure, pose, lines, at.tool)
        d = carry.shape[-1]
        gaps = np.zeros((len(pose), d, d))
        blocks = closure.error_blocks(pose, lines)
        for i, (one, columns, b) in enumerate(blocks):
            weighted = b * variance[list(columns)]
            gaps[:, one, one] += weighted @ np.swapaxes(b, -1, -2)
            for other, theirs, c in blocks[i + 1:]:
                shared = [p for p in columns if p in theirs]
                if shared:
                    cross = weighted[..., [columns.index(p) for p in shared]] @ np.swapaxes(
                        c[..., [theirs.index(p) for p in shared]], -1, -2)
                    gaps[:, one, other] += cross
                    gaps[:, other, one] += np.swapaxes(cross, -1, -2)
        out[rows] = carry @ gaps @ np.swapaxes(carry, -1, -2)
    return out


@dataclass(frozen=True, eq=False)
class Survey:
    """What errors do over N poses, SI.

    Attributes:
        position, rotation: root-sum-square of the tool's error for errors of one standard
            deviation each (N,).
        worst_position, worst_rotation: every error at its limit (N,).
        by_position, by_rotation: what one unit of each error does, rms over the poses (S,).
    """

    position: Array
    rotation: Array
    worst_position: Array
    worst_rotation: Array
    by_position: Array
    by_rotation: Array


def survey(model: Model, at: Poses, wanted: Sequence[int], sigma: Array, limits: Array) -> Survey:
    """Return root-sum-square, worst case and each error's part over all poses.

    ``sigma`` and ``limits``: standard deviation and largest size of each error (S,), SI.
    """
    n = len(at.q)
    figures, squares = np.empty((4, n)), np.zeros((2, len(wanted)))
    for rows, q, pose in at.chunks():
        jacobian = error_jacobian(model, Poses(q, pose, at.tool), wanted)
        steps = (jacobian * sigma) ** 2
        figures[0, rows] = np.sqrt(steps[:, :3].sum(axis=(1, 2)))
        figures[1, rows] = np.sqrt(steps[:, 3:].sum(axis=(1, 2)))
        figures[2:, rows] = worst_case(jacobian, limits)
        squares += np.stack([(jacobian[:, :3] ** 2).sum(axis=(0, 1)),
                             (jacobian[:, 3:] ** 2).sum(axis=(0, 1))])
    by = np.sqrt(squares / max(n, 1))
    return Survey(figures[0], figures[1], figures[2], figures[3], by[0], by[1])


def root_sum_square(covariances: Array) -> tuple[Array, Array]:
    """Return position (N,) and rotation (N,): roots of the traces of covariances (N, 6, 6)."""
    both = np.diagonal(covariances, axis1=1, axis2=2)
    # variances of directions that nothing moves may come out as -1e-40
    return (np.sqrt(np.maximum(both[:, :3].sum(axis=1), 0.0)),
            np.sqrt(np.maximum(both[:, 3:].sum(axis=1), 0.0)))


def worst_case(jacobian: Array, limits: Array) -> tuple[Array, Array]:
    """Return the largest position (N,) and rotation (N,) error with every error at its limit.

    Args:
        jacobian: J_g (N, 6, S).
        limits: largest size of each error (S,).

    The longest vector of the zonotope sum(+-J_i limit_i): from :data:`STARTS` directions over
    the half sphere each sign is set to help, then the direction to the sum, until nothing
    changes. A corner that no start leads to would be missed.
    """
    steps = jacobian * limits
    return _longest(steps[:, :3])[0], _longest(steps[:, 3:])[0]


def worst_signs(steps: Array) -> Array:
    """Return the signs (S,) with which steps (3, S) add up to the longest vector."""
    way = _longest(steps[None])[1][0]
    return np.where(way @ steps < 0.0, -1.0, 1.0)


def _directions(flat: bool) -> Array:
    """Return unit vectors evenly over half the circle, or the half sphere (golden spiral)."""
    k = (np.arange(STARTS) + 0.5) / STARTS
    if flat:
        return np.stack([np.cos(np.pi * k), np.sin(np.pi * k), np.zeros(STARTS)], axis=-1)
    turn, r = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(STARTS), np.sqrt(1.0 - k**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), k], axis=-1)


def _longest(steps: Array) -> tuple[Array, Array]:
    """Return the longest sum(+-step) of steps (N, 3, S): its length (N,) and direction (N, 3)."""
    flat = not steps[:, 2].any()
    starts = _directions(flat)
    out, ways = np.empty(len(steps)), np.empty((len(steps), 3))
    for begin in range(0, len(steps), CHUNK // 64):
        part = steps[begin:begin + CHUNK // 64]
        way = np.broadcast_to(starts, (len(part), *starts.shape))
        length = np.zeros(way.shape[:2])
        for _ in range(ROUNDS):
            signs = np.where(way @ part < 0.0, -1.0, 1.0)
            whole = signs @ np.swapaxes(part, -1, -2)
            before, length = length, np.linalg.norm(whole, axis=-1)
            way = whole / np.where(length > 0.0, length, 1.0)[..., None]
            if np.array_equal(before, length, equal_nan=True):
                break
        best = np.argmax(length, axis=1)
        mine = np.arange(len(part))
        out[begin:begin + CHUNK // 64] = length[mine, best]
        ways[begin:begin + CHUNK // 64] = way[mine, best]
    return out, ways


def displacement(model: Model, at: Poses, g: Array) -> Array:
    """Return what the tool really does (N, 6), each row with parameters of its own g (N, P).

    The full nonlinear forward kinematics at unchanged joint values, from the poses ``at`` on;
    displacement in m and rotation vector in rad, base axes; nan where a machine with these
    errors cannot go there.
    """
    theirs = Model(model.mechanism, g)
    out = np.full((len(at.q), 6), np.nan)
    for rows, q, pose in at.chunks():
        part = theirs.take(np.arange(len(g))[rows])
        found, converged, _ = newton(part.closure(q), pose)
        turn = cga.compose(found, cga.reverse(pose))
        moved = np.concatenate([cga.move_point(found, at.tool) - cga.move_point(pose, at.tool),
                                cga.rotation_vector(turn)], axis=-1)
        out[rows] = np.where(converged[:, None], moved, np.nan)
    return out


@dataclass(frozen=True, eq=False)
class Linearity:
    """Linear against nonlinear model along one combination of errors ([LIN] Fig. 9).

    ``scale`` (L,): multiples of the combination; ``linear`` and ``exact`` (L, 2): the tool's
    displacement, m, and rotation, rad; ``apart`` (L, 2): lengths of their difference, nan
    where the machine cannot go there; ``metric``: rotations count times this length, m.
    """

    scale: Array
    linear: Array
    exact: Array
    apart: Array
    metric: float

    @property
    def relative(self) -> Array:
        """Difference over the linear motion (L,), rotations weighed by the metric length."""
        weight = np.array([1.0, self.metric])
        whole = np.linalg.norm(self.linear * weight, axis=1)
        return np.asarray(np.linalg.norm(self.apart * weight, axis=1)
                          / np.where(whole > 0.0, whole, 1.0))

    def holds_to(self, part: float) -> float:
        """Return the largest multiple up to which the difference stays below ``part``.

        0 where not even the smallest does; inf where all do.
        """
        wrong = np.flatnonzero(~(self.relative < part))
        if not wrong.size:
            return float("inf")
        return float(self.scale[wrong[0] - 1]) if wrong[0] else 0.0


def linearity(model: Model, at: Poses, wanted: Sequence[int], step: Array, scale: Array,
              metric: float) -> Linearity:
    """Return how the tool moves at one pose (the first of ``at``) along multiples of ``step``.

    Args:
        model: the machine.
        at: the pose.
        wanted: parameters (S,).
        step: one multiple's errors (S,), SI.
        scale: multiples (L,), ascending.
        metric: length that rotations count times, m.
    """
    here = Poses(np.tile(at.q[:1], (len(scale), 1)), np.tile(at.motor[:1], (len(scale), 1)),
                 at.tool)
    once = error_jacobian(model, Poses(at.q[:1], at.motor[:1], at.tool), wanted)[0] @ step
    g = np.tile(model.parameters, (len(scale), 1))
    g[:, list(wanted)] += scale[:, None] * step
    real, straight = displacement(model, here, g), scale[:, None] * once

    def both(steps: Array) -> Array:
        return np.stack([np.linalg.norm(steps[:, :3], axis=1),
                         np.linalg.norm(steps[:, 3:], axis=1)], axis=-1)

    return Linearity(scale, both(straight), both(real), both(real - straight), metric)


def determinants(model: Model, q: Array, pose: Array) -> Array:
    """Return det A over home's (N,), nan where a row has no pose: 0 is a singularity.

    Positive on home's side, negative beyond; pure numbers.
    """
    home = home_state(model.mechanism).q[None]
    first = float(determinant(model.closure(home).pose_matrix(model.mechanism.home[None]))[0])
    out = np.full(len(q), np.nan)
    rows = np.flatnonzero(finite_rows(q) & finite_rows(pose))
    if rows.size:
        out[rows] = determinant(model.closure(q[rows]).pose_matrix(pose[rows])) / first
    return out
