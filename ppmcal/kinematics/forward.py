"""Forward kinematics: Newton on the stacked closure, in the assembly mode of home.

The stacked closure equations c(M, q) = 0 are solved for the platform motor M by Newton steps on
the pose matrix A. A direct solution from the start is trusted if Newton contracts
from its first step on; otherwise the joints are led from the start to their values in
smaller steps, so that the assembly mode reached is the one that the machine would reach.
A row that meets a singularity on the way is reported, never returned.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.compiled_limbs import CompiledLimbs, compiled_limbs, worth
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.least_squares_closure import newton_step
from ppmcal.kinematics.limb_sets import exact_sets, with_limbs
from ppmcal.linalg import Array, Bools, Ints, finite_rows

CONTRACTION = 0.25
"""If the second Newton step exceeds this part of the first, the joints are led in smaller steps."""
SMALLEST_STEP = 1.0 / 512.0
NEWTON_STEPS = 25
STEP = 1e-11
"""Converged: the last step, translations relative to the length scale, is below this."""
FARTHEST = 10.0
"""A step of this many reaches or more has diverged."""
ON_THE_WAY = 1e-6
"""The same on the way to a row of a machine with surplus limbs. Joints that move in proportion make
limbs contradict each other there, and steps shrink by a constant factor."""
CLOSED = 1e-12
"""Closed: every misclosure is below this part of the reach."""
STANDS_OUT, STANDS_OUT_ANEW = 3.3e-2, 1e-4
"""Rows of surplus limbs with squared gaps that noise exceeds this rarely are solved again: on the
way from home, and when a fit continues from poses that were."""
SAME = 6
"""Minima that agree to this many digits are the same."""
ROUND_OFF = 1e-10


@dataclass(frozen=True)
class Forward:
    """Poses for N rows of joint values.

    Attributes:
        pose: motors (N, 8), nan without one.
        converged: (N,).
        progress: part of the way from the start that each row got, 1 if converged (N,).
        reason: why a row has no pose, if more is known than that; (N,) or empty.
    """

    pose: Array
    converged: Bools
    progress: Array
    reason: tuple[str, ...] = ()


def forward(model: Model, q: Array, start: Array | None = None, start_q: Array | None = None,
            of: int = 0) -> Forward:
    """Return the poses at joint values ``q`` (N, k).

    Args:
        model: the machine at its parameters.
        q: joint values, SI.
        start: motors (N, 8) or (8,) to start from, default home.
        start_q: joint values at ``start``, default home's; needed for leading the joints.
        of: for a machine with surplus limbs, or a part of it: total number of rows, which
            decides whether it is compiled.
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    of = max(of, len(q)) if of or model.mechanism.surplus else 0
    home = home_state(model.mechanism)
    pose = np.array(np.broadcast_to(model.mechanism.home if start is None else start,
                                    (q.shape[0], 8)))
    origin = np.array(np.broadcast_to(home.q if start_q is None else start_q, q.shape))
    usable = finite_rows(q) & finite_rows(pose)
    if model.mechanism.surplus and usable.any():
        # surplus limbs contradict each other at the start: the way begins at their best pose
        some = np.flatnonzero(usable)
        # from home, without a shift, it is the same for all rows
        alike = start is None and start_q is None and model.take(some[:1]) is model
        one = some[:1] if alike else some
        closest, found, _ = newton(model.take(one).closure(origin[one]), pose[one], of=of)
        pose[some] = np.where(found[:, None], closest, pose[some])
    progress = np.zeros(q.shape[0])
    result = np.full_like(pose, np.nan)
    parts = _Parts(model, q, of)
    rows = np.flatnonzero(usable)
    if rows.size:
        solved, good = _attempt(model.take(rows), q[rows], pose[rows], of)
        result[rows[good]] = solved[good]
        progress[rows[good]] = 1.0
        rest = rows[~good]
        if rest.size and model.mechanism.surplus and start is None:
            result[rest] = _led_by_parts(parts, rest)
            progress[rest] = finite_rows(result[rest])
            rest = rest[progress[rest] < 1.0]
        if rest.size:
            result[rest], progress[rest] = _lead(model.take(rest), origin[rest], q[rest],
                                                 pose[rest], of)
    if model.mechanism.surplus and start is None:
        result = _least_of_minima(parts, result, STANDS_OUT)
        progress[finite_rows(result)] = 1.0
    return Forward(result, progress >= 1.0, progress)


@dataclass(frozen=True, eq=False)
class Minima:
    """Poses (m, 8) to which rows that stood out were led, by their joint values.

    A fit that continues finds them nearby, at a hundredth of the cost of leading them from home.
    """

    known: dict[bytes, Array] = field(default_factory=dict)

    def of(self, q: Array) -> Array | None:
        """Return the known poses of a row of joint values (k,), None if it was not led yet."""
        return self.known.get(q.tobytes())

    def add(self, q: Array, rows: Ints, poses: Array) -> None:
        """Add poses (s, n, 8) of rows, each once, without nan."""
        for n, own in zip(rows, np.swapaxes(poses, 0, 1), strict=True):
            _, first = np.unique(np.round(own, SAME), axis=0, return_index=True)
            self.known[q[n].tobytes()] = own[first[finite_rows(own[first])]]


def least_of_minima(model: Model, q: Array, pose: Array, rare: float = STANDS_OUT_ANEW,
                    start: Array | None = None, start_q: Array | None = None,
                    unreached: Bools | None = None, minima: Minima | None = None) -> Array:
    """Return poses (N, 8), with far-off rows at the pose of least contradiction of their limbs.

    Least squares have other minima, in which limbs that agree elsewhere are kept apart. A set of
    limbs that closes the machine exactly leads from home to the right one, unless it meets a
    singularity on the way: several such sets are tried, for rows that stand out: those with
    gaps that noise exceeds as rarely as ``rare``, and those without a pose. ``start`` (N, 8) and
    ``start_q`` (N, k): the beginning of the way, default home. ``unreached`` (N,): rows to which
    :func:`forward` found no way, by the same sets from the same home. ``minima``: those known
    during a fit, to which new ones are added.
    """
    return _least_of_minima(_Parts(model, q, len(q), start, start_q), pose, rare, unreached, minima)


def _least_of_minima(parts: _Parts, pose: Array, rare: float, unreached: Bools | None = None,
                     minima: Minima | None = None) -> Array:
    model, q, of = parts.model, parts.q, parts.of
    least = _gap_square(model, q, pose, of)
    known = least[np.isfinite(least)]
    most = _times_the_median(model.mechanism.surplus, rare)
    usual = np.median(known) if known.size else 0.0
    far = finite_rows(q) & ~(least <= most * usual + (ROUND_OFF * model.mechanism.reach) ** 2)
    rows = np.flatnonzero(far if unreached is None else far & ~unreached)
    if not rows.size:
        return pose
    pose = pose.copy()
    for some, found, converged in _tried(parts, rows, minima):
        value = np.where(converged, _gap_square(model.take(some), q[some], found, of), np.inf)
        better = value < np.where(np.isfinite(least[some]), 0.99 * least[some], np.inf)
        pose[some[better]], least[some[better]] = found[better], value[better]
    return pose


def _tried(parts: _Parts, rows: Ints, minima: Minima | None) -> Iterator[tuple[Ints, Array, Bools]]:
    """Yield some of the rows, poses (n, 8) that are minima of theirs, and whether they are (n,).

    From known minima nearby, or else from home, which are then added to the known ones.
    """
    if minima is not None:
        known = {n: there for n in rows.tolist() if (there := minima.of(parts.q[n])) is not None}
        for k in range(max(map(len, known.values()), default=0)):
            some = np.array([n for n, there in known.items() if len(there) > k])
            begin = np.array([known[n][k] for n in some.tolist()])
            yield some, *newton(parts.model.take(some).closure(parts.q[some]), begin,
                                of=parts.of)[:2]
        rows = rows[[n not in known for n in rows.tolist()]]
    if not rows.size:
        return
    led = []
    for limbs in exact_sets(parts.model.mechanism):
        found, converged, _ = parts.led(limbs, rows)
        yield rows, found, converged
        led.append(np.where(converged[:, None], found, np.nan))
    if minima is not None:
        minima.add(parts.q, rows, np.array(led))


def _led_by_parts(parts: _Parts, rows: Ints) -> Array:
    """Return poses (n, 8) of some rows of a machine with surplus limbs, nan if none is found.

    On a straight way all its joints contradict each other between the ends, more than at either;
    those of a set that closes the machine exactly do not. Its end is near, for some set.
    """
    out = np.full((len(rows), 8), np.nan)
    left = np.arange(len(rows))
    for some in exact_sets(parts.model.mechanism):
        found, converged, contraction = parts.led(some, rows[left])
        good = converged & (contraction <= CONTRACTION)
        out[left[good]] = found[good]
        left = left[~good]
        if not left.size:
            break
    return out


@dataclass(frozen=True, eq=False)
class _Parts:
    """Rows of a surplus machine, to which sets of its limbs lead that close it exactly.

    Attributes:
        model, q: the machine and joint values (N, k).
        of: see :func:`forward`.
        start, start_q: beginning of the way, default home.
        known: by set of limbs, results of :func:`newton` for rows requested so far (N,).
    """

    model: Model
    q: Array
    of: int
    start: Array | None = None
    start_q: Array | None = None
    known: dict[tuple[int, ...], tuple[Array, Bools, Array, Bools]] = field(default_factory=dict)

    def led(self, some: tuple[int, ...], rows: Ints) -> tuple[Array, Bools, Array]:
        """Return motors (n, 8), converged (n,) and contraction (n,) of rows, each led once."""
        n = len(self.q)
        pose, converged, contraction, there = self.known.setdefault(some, (
            np.full((n, 8), np.nan), np.zeros(n, dtype=bool), np.full(n, np.inf),
            np.zeros(n, dtype=bool)))
        new = rows[~there[rows]]
        if new.size:
            pose[new], converged[new], contraction[new] = _by_part(
                self.model.take(new), some, self.q[new], self.of,
                *(None if v is None else v[new] for v in (self.start, self.start_q)))
            there[new] = True
        return pose[rows], converged[rows], contraction[rows]


def _by_part(model: Model, some: tuple[int, ...], q: Array, of: int, start: Array | None = None,
             start_q: Array | None = None) -> tuple[Array, Bools, Array]:
    """Return the result of :func:`newton` from where a set of limbs leads that closes exactly."""
    part, driven = with_limbs(model, some)
    led = forward(part, q[:, driven], start, None if start_q is None else start_q[:, driven],
                  worth(model.mechanism, of)).pose
    found, converged, contraction = newton(model.closure(q), led, of=of)
    # a way with a full turn returns the same motor with the other sign
    near = model.mechanism.home if start is None else start
    found *= np.where(np.sum(found[:, :4] * near[..., :4], axis=1) < 0.0, -1.0, 1.0)[:, None]
    return found, converged, contraction


@lru_cache(maxsize=64)
def _times_the_median(surplus: int, rare: float) -> float:
    """Return the ratio of chi-squared exceeded as rarely as ``rare`` to its median."""
    from scipy.special import chdtri

    return float(chdtri(surplus, rare) / chdtri(surplus, 0.5))


def _gap_square(model: Model, q: Array, pose: Array, of: int) -> Array:
    """Return the sum of squared gaps (N,), nan without a pose."""
    closure = model.closure(q)
    tables = compiled_limbs(closure, of)
    if tables is not None:
        return tables.gap_squares(pose)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sum(closure.lengths(pose) ** 2, axis=1))


def _attempt(model: Model, q: Array, pose: Array, of: int, smallest: float = STEP
             ) -> tuple[Array, Bools]:
    """Newton at ``q`` from ``pose``; good rows have converged, contracted, and kept their side."""
    closure = model.closure(q)
    tables = compiled_limbs(closure, max(of, len(pose)))
    if tables is not None:
        return _compiled_attempt(tables, pose, smallest)
    with np.errstate(invalid="ignore"):  # nan where an offset universal joint cannot stand
        c, lines = closure.misclosure_and_lines(pose)
        matrix = closure.pose_matrix(pose, lines)
        side = np.sign(linalg.determinant(matrix))
    solved, converged, contraction = newton(closure, pose, most=CONTRACTION,
                                            begin=(c, lines, matrix), smallest=smallest)
    same = np.zeros(q.shape[0], dtype=bool)
    if converged.any():
        same[converged] = side[converged] == np.sign(linalg.determinant(
            closure.pose_matrix(solved))[converged])
    return solved, converged & same & (contraction <= CONTRACTION)


def _compiled_attempt(tables: CompiledLimbs, pose: Array, smallest: float
                      ) -> tuple[Array, Bools]:
    solved, converged, sizes, signs = tables.newton(pose, NEWTON_STEPS, smallest, CLOSED,
                                                    CONTRACTION)
    same = signs[:, 0] == signs[:, 1]
    return solved, converged & same & (_contraction(sizes) <= CONTRACTION)


def _lead(model: Model, origin: Array, q: Array, pose: Array, of: int) -> tuple[Array, Array]:
    """Lead the joints from ``origin`` to ``q`` in steps that Newton follows safely."""
    n = q.shape[0]
    surplus = model.mechanism.surplus > 0
    smallest = ON_THE_WAY if surplus else STEP
    at, step = np.zeros(n), np.full(n, 0.5)
    pose = pose.copy()
    active = np.ones(n, dtype=bool)
    # tables of both ends: between them joint coordinates move like the joints
    ends = [compiled_limbs(model.closure(own), max(of, n)) for own in (origin, q)] if of else []
    whole = [t for t in ends if t is not None]
    first, way = (_each(whole[0].u, n), _each(whole[1].u, n) - _each(whole[0].u, n)) if whole else (
        origin, q - origin)
    while active.any():
        rows = np.flatnonzero(active)
        to = np.minimum(at[rows] + step[rows], 1.0)
        goal = first[rows] + to[:, None] * way[rows]
        solved, good = (_compiled_attempt(replace(whole[0], u=goal), pose[rows], smallest)
                        if whole else _attempt(model.take(rows), goal, pose[rows], of, smallest))
        pose[rows[good]], at[rows[good]] = solved[good], to[good]
        step[rows] = np.where(good, step[rows] * 1.5, step[rows] / 2.0)
        active[rows] = (at[rows] < 1.0) & (step[rows] >= SMALLEST_STEP)
    there = np.flatnonzero(at >= 1.0)
    if surplus and there.size:
        pose[there], converged, _ = newton(model.take(there).closure(q[there]), pose[there], of=of)
        at[there[~converged]] = np.nextafter(1.0, 0.0)
    pose[at < 1.0] = np.nan
    return pose, at


def _each(values: Array, count: int) -> Array:
    return np.broadcast_to(values, (count, values.shape[1]))


def newton(closure: Closure, pose: Array, iterations: int = NEWTON_STEPS, most: float = np.inf,
           begin: tuple[Array, Array, Array] | None = None, of: int = 0,
           smallest: float = STEP) -> tuple[Array, Bools, Array]:
    """Solve the closure for the motors, batched.

    Rows whose second step is above ``most`` of the first are abandoned. ``begin``:
    misclosure, lines and pose matrix at ``pose``, if known. ``of``: see :func:`forward`.
    ``smallest``: converged if the step is below this.

    Returns:
        motors (N, 8), converged (N,), and the ratio of the second step's length to the
        first's (N,), a measure of how safe the start was.
    """
    mechanism = closure.model.mechanism
    scale, reach = mechanism.length_scale, mechanism.reach
    tables = compiled_limbs(closure, max(of, len(pose)))
    if tables is not None:
        pose, converged, two, _ = tables.newton(pose, iterations, smallest, CLOSED, most)
        return pose, converged, _contraction(two)
    pose, slow = np.array(pose), np.zeros(pose.shape[0], dtype=bool)
    sizes: list[Array] = []
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(iterations):
            if sizes or begin is None:
                c, lines = closure.misclosure_and_lines(pose)
                matrix = closure.pose_matrix(pose, lines)
            else:
                c, lines, matrix = begin
            step = np.zeros((pose.shape[0], 6))
            step[:, mechanism.dof] = newton_step(closure, pose, c, matrix, lines)
            size = np.hypot(np.linalg.norm(step[:, :3], axis=1) / scale,
                            np.linalg.norm(step[:, 3:], axis=1))
            sizes.append(size)
            if len(sizes) == 2 and most < np.inf:
                slow = _contraction(np.stack(sizes, axis=-1)) > most
            finite = np.isfinite(size) & (size < FARTHEST * reach / scale) & ~slow
            step[~finite] = 0.0
            pose = moved(pose, step)
            # with surplus equations the closure error is least there, not 0
            closed = (np.max(np.abs(c), axis=1) < CLOSED * reach) | (mechanism.surplus > 0)
            converged = finite & (size < smallest) & closed
            if (converged | ~finite).all():
                break
    second = sizes[1] if len(sizes) > 1 else np.zeros_like(sizes[0])
    return pose, converged, _contraction(np.stack([sizes[0], second], axis=-1))


def _contraction(sizes: Array) -> Array:
    """Return the second step's length over the first's (N,), from both (N, 2)."""
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
    (:attr:`Mechanism.length_scale`), so the value is dimensionless: how far the stiffest
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
