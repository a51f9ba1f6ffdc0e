"""A short way through the poses: joints move together, so the longest travel counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal.design.plan.candidate_poses import same_pose
from ppmcal.design.plan.clearance import too_close
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, smallest_singular_value
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import SINGULAR, home_singular_value
from ppmcal.kinematics.ways import between
from ppmcal.linalg import Array, Ints, finite_rows
from ppmcal.model.mechanism import Mechanism

STOPS = 8
"""Places along each move at which it is looked at."""
SWEEPS = 200
SINGULAR_PATH = "the path meets a singularity"


@dataclass(frozen=True, eq=False)
class Route:
    """An order of rows.

    ``order`` (n,); ``travel`` (n,): of the move to each, in parts of the joints' ranges;
    ``before``, ``after``: length in all, in the order of selection and in this one; ``via``
    (n,): how to get to a row from the one before, see :func:`by_way_of_home`.
    """

    order: Ints
    travel: Array
    before: float
    after: float
    via: tuple[str, ...]


def route(nominal: Mechanism, q: Array, span: Array, blocks: Ints) -> Route:
    """Return a short order of joint values (n, k), block by block, starting next to home.

    Args:
        nominal: the machine.
        q: joint values of the rows in the order of selection.
        span: range of each joint over the region (k,).
        blocks: label of each row (n,), in the order in which blocks are to be measured:
            settings that take long to change.
    """
    home = home_state(nominal).q
    unit = np.where(span > 0.0, span, 1.0)
    at, order = home, list[int]()
    for label in np.unique(blocks):
        rows = np.flatnonzero(blocks == label)
        path = rows[two_opt(lengths(q[rows], q[rows], unit), lengths(at[None], q[rows], unit)[0])]
        order += path.tolist()
        at = q[path[-1]]
    best, plain = np.array(order, dtype=np.int64), np.argsort(blocks, kind="stable")
    if _steps(home, q[plain], unit).sum() < _steps(home, q[best], unit).sum():
        best = plain
    travel = _steps(home, q[best], unit)
    return Route(best, travel, float(np.sum(_steps(home, q, unit))), float(travel.sum()),
                 by_way_of_home(nominal, q[best]))


def lengths(a: Array, b: Array, unit: Array) -> Array:
    """Return the largest joint travel between rows (n, k) and (m, k), (n, m)."""
    return np.asarray(np.max(np.abs(a[:, None] - b[None]) / unit, axis=-1))


def _steps(home: Array, q: Array, unit: Array) -> Array:
    return np.asarray(np.max(np.abs(np.diff(q, axis=0, prepend=home[None])) / unit, axis=1))


def two_opt(apart: Array, start: Array) -> Ints:
    """Return a short open path through n rows by nearest neighbours, then 2-opt.

    Args:
        apart: distances (n, n).
        start: distances from where the path begins (n,).

    A sweep looks at all reversals at once and takes the best (Croes 1958).
    """
    n = len(start)
    path = [int(np.argmin(start))]
    left = np.ones(n, dtype=np.bool_)
    left[path[0]] = False
    while left.any():
        path.append(int(np.argmin(np.where(left, apart[path[-1]], np.inf))))
        left[path[-1]] = False
    # node 0 is the start, node n + 1 the open end, which costs nothing
    full = np.zeros((n + 2, n + 2))
    full[1:-1, 1:-1], full[0, 1:-1], full[1:-1, 0] = apart, start, start
    way = np.array([0, *(p + 1 for p in path), n + 1])
    first, last = np.triu_indices(n, 1)
    for _ in range(SWEEPS):
        a, b, c, d = way[first], way[first + 1], way[last + 1], way[last + 2]
        saved = full[a, b] + full[c, d] - full[a, c] - full[b, d]
        if not saved.size or saved.max() <= 1e-12:
            break
        i, j = int(first[np.argmax(saved)]), int(last[np.argmax(saved)])
        way[i + 1:j + 2] = way[i + 1:j + 2][::-1]
    return np.asarray(way[1:-1] - 1, dtype=np.int64)


def moves(nominal: Mechanism, start: Array, end: Array) -> tuple[str, ...]:
    """Return what straight moves from ``start`` to ``end`` (n, k) would meet, (n,) words.

    Joints move straight, and the pose at the end must follow from that at the start as it does
    from home. Surplus limbs have to agree at any time: there the platform moves straight. On the
    way it must stay clear of singularities and its legs of each other.
    """
    model = Model(nominal)
    here, there = forward(model, start), forward(model, end)
    out = np.full(len(end), "", dtype=object)
    part = np.linspace(0.0, 1.0, STOPS + 2)[1:-1]
    if nominal.surplus:
        pose = between(np.repeat(here.pose, STOPS, axis=0), np.repeat(there.pose, STOPS, axis=0),
                       np.tile(part, len(end)))
        q = inverse(model, pose).q
    else:
        onward = forward(model, end, start=here.pose, start_q=start)
        out[~same_pose(onward.pose, there.pose, nominal)] = (
            "the path leads to another assembly mode")
        out[~onward.converged | ~there.converged] = SINGULAR_PATH
        q = (start[:, None] + part[:, None] * (end - start)[:, None]).reshape(-1, end.shape[1])
        pose = forward(model, q).pose
    good = np.flatnonzero(finite_rows(pose) & finite_rows(q))
    bad = np.full(len(q), SINGULAR_PATH, dtype=object)
    if good.size:
        value, sign = smallest_singular_value(model.closure(q[good]), pose[good])
        home, side = home_singular_value(nominal)
        close = too_close(model, q[good], pose_vector(pose[good]))
        bad[good] = np.where((value < SINGULAR * home) | (sign != side), SINGULAR_PATH,
                             np.where(close, "the legs come too close on the path", ""))
    first = [next((str(w) for w in row if w), "") for row in bad.reshape(-1, STOPS)]
    return tuple(str(a) or b for a, b in zip(out, first, strict=True))


def by_way_of_home(nominal: Mechanism, q: Array) -> tuple[str, ...]:
    """Return how to get to each of the rows (n, k) from the one before, the first from home.

    Empty: straight; ``home``: straight to home and from there; else in words why there is no
    such way.
    """
    home = home_state(nominal).q
    before = np.concatenate([home[None], q[:-1]])
    out = list(moves(nominal, before, q))
    rows = np.flatnonzero([bool(w) for w in out])
    if rows.size:
        at = np.broadcast_to(home, (rows.size, q.shape[1]))
        there, on = moves(nominal, before[rows], at), moves(nominal, at, q[rows])
        for n, a, b in zip(rows, there, on, strict=True):
            out[n] = a or b or "home"
    return tuple(out)
