"""The rows of a fit as normal equations: J^T J, J^T r and r^T r, without J where rows are many.

Squaring loses half of the digits: these sums lead to the minimum but do not describe it. A fit
takes its steps from them while their condition allows (:mod:`gauss_newton`), and its last step, its
ranks and its intervals from the triangle of a QR of the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit.nuisance_columns import InstrumentTables
from ppmcal.calibration.fit.observation import coordinates
from ppmcal.calibration.fit.problem import PIECE, Problem, State
from ppmcal.kinematics import compiled_limbs
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.limb_tables import EntryTables, LimbTables
from ppmcal.linalg import Array, Bools, Ints, finite_rows

AT_ONCE = 256
"""Rows made at a time where they are then reduced: as many as fit a cache."""


@dataclass(frozen=True)
class NormalSums:
    """All rows: ``matrix`` J^T J (C, C), ``gradient`` J^T r (C,), r^T r, and number of values."""

    matrix: Array
    gradient: Array
    square: float
    count: float


def normal_sums(problem: Problem, state: State, keep: Sequence[Bools],
                weights: Sequence[Array] | None = None) -> NormalSums:
    """Return the normal equations of all rows; arguments as :func:`linearisation.qr_factor`."""
    size = len(problem.columns) + 1
    earlier = problem.earlier_rows(state, size)
    total, count = earlier.T @ earlier, float(len(earlier))
    given = problem.shared_stands(state, keep)
    for i in range(len(problem.datasets)):
        own = None if problem.companions[i] else _compiled_sums(
            problem, state, i, keep[i], None if weights is None else weights[i])
        if own is not None:
            total += own[0]
            count += own[1]
            continue
        for part in white_blocks(problem, state, i, keep[i],
                                 None if weights is None else weights[i], given):
            flat = part.rows.reshape(-1, size)
            total += flat.T @ flat
            count += problem.values(i, part.index, part.values)
    return NormalSums(total[:-1, :-1], total[:-1, -1], float(total[-1, -1]), count)


def row_squares(problem: Problem, state: State, index: int, rows: Bools,
                given: Sequence[Bools] | None = None) -> Array:
    """Return the white squares (n,) of some rows (N,) of a data set, all of which have poses.

    ``given``: as in :meth:`Problem.rows_of`.
    """
    at = np.flatnonzero(rows)
    own = None
    sighting = problem.sighting(index, state)
    if given is not None and problem.companions[index]:
        pass    # their noise is correlated with that of companions
    elif problem.mechanism.surplus:
        own = _likely_squares(problem, state, index, at)
    elif sighting.plain:
        if not compiled_limbs.pays(problem.mechanism, at.size):
            own = _few_squares(problem, state, index, at)
        else:
            from ppmcal.calibration.fit.compiled_rows import row_squares as squares

            sight = sighting.tables
            own = np.concatenate([squares(sight, _taken(some, state.poses[index]),
                                          *problem.measured(index, some)[:2])
                                  for some in _pieces(at)])
    # for joint noise, effects and distances the residual alone is not enough
    return own if own is not None else np.concatenate([np.zeros(0), *(
        np.sum(r.residual**2, axis=1) for r in problem.rows_of(
            index, state, False, rows, given))])


def _few_squares(problem: Problem, state: State, index: int, rows: Ints) -> Array | None:
    """Return the same for few rows, by NumPy; None for planar machines."""
    data, registration = problem.datasets[index], state.registrations[index]
    if problem.mechanism.motion.planar:
        return None
    pose, (seen, white, _) = state.poses[index][rows], problem.measured(index, rows)
    placed = cga.compose(registration.frame, pose)
    scale = 1.0 if data.kind.touches else registration.scale
    left = seen - np.pad(scale * cga.move_point(placed, registration.target), ((0, 0), (0, 3)))
    parts = list(coordinates(data, problem.mechanism.motion))
    if parts[-1] > 2:
        still = np.zeros(3)
        body = cga.motor_from_rotation_vector(registration.target_rotation, still)
        shown = cga.motor_from_rotation_vector(seen[:, 3:], still)
        left[:, 3:] = cga.rotation_vector(cga.compose(
            shown, cga.reverse(cga.compose(placed, body))))
    return np.asarray(np.sum((white * left[:, parts]) ** 2, axis=1))


def _likely_squares(problem: Problem, state: State, index: int, rows: Ints) -> Array | None:
    """Return the white squares (n,) of rows of surplus limbs, None without a compiled form."""
    out, sighting = [], problem.sighting(index, state)
    if not compiled_limbs.pays(problem.mechanism, rows.size) or not sighting.plain:
        return None
    weight, model = problem.datasets[index].weight, Model(problem.mechanism, state.g)
    for some in _pieces(rows):
        q = _taken(some, problem.datasets[index].q) + state.registrations[index].homing
        tables = compiled_limbs.compiled_limbs(model.closure(q), rows.size)
        if tables is None:
            return None
        squares = sighting.likely(some, state.poses[index][some], tables).squares
        out.append(squares if weight is None else weight[some] * squares)
    return np.concatenate(out)


@dataclass(frozen=True)
class _CompiledRows:
    """Rows ``index`` (N,) of a data set, compiled; ``values`` (N,): number of values in each.

    ``size``: number of white values per row, measured or not; ``noise`` (L,), ``gaps`` (m,) and
    ``weight`` (N,): for surplus limbs only.
    """

    index: Ints
    limbs: LimbTables
    entries: EntryTables
    sight: InstrumentTables
    columns: Ints
    arrays: tuple[Array, Array, Array, Array, Array]
    values: Ints
    size: int
    noise: Array | None = None
    gaps: Array | None = None
    weight: Array | None = None

    def made(self, some: slice, out: Array) -> Array:
        """Fill rows (n, size, C + 1), or return the sums if there are none to fill."""
        u, q, pose, seen, white = (a[some] for a in self.arrays)
        if self.noise is not None and self.gaps is not None and self.weight is not None:
            from ppmcal.calibration.fit.compiled_surplus_rows import white_rows as eliminated

            return eliminated(self.limbs, self.entries, self.sight, self.columns, self.noise,
                              self.gaps, u, q, pose, seen, white, self.weight[some], out)
        from ppmcal.calibration.fit.compiled_rows import white_rows

        return white_rows(self.limbs, self.entries, self.sight, self.columns, u, q, pose, seen,
                          white, out)


def _compiled_rows(problem: Problem, state: State, index: int, keep: Bools,
                   weights: Array | None) -> Iterator[_CompiledRows]:
    """Yield some rows (N,) of a data set in pieces, nothing if they have no compiled form."""
    at = np.flatnonzero(keep & finite_rows(state.poses[index]))
    sighting = problem.sighting(index, state)
    if not compiled_limbs.pays(problem.mechanism, at.size) or not sighting.plain:
        return
    data, model = problem.datasets[index], Model(problem.mechanism, state.g)
    opened = problem.opens[index]
    homing = opened.homing.start if opened.homing.stop > opened.homing.start else None
    place = {p: c for c, p in enumerate(problem.free)}
    columns = np.array([*sighting.open_columns[1], len(problem.columns)], dtype=np.int64)
    sight = sighting.tables
    for rows in _pieces(at):
        q = _taken(rows, data.q) + state.registrations[index].homing
        tables = compiled_limbs.compiled_limbs(model.closure(q, problem.free), at.size)
        entries = None if tables is None else tables.entries(place, homing)
        if tables is None or entries is None:
            return
        same, q = (tables.limbs, entries, sight, columns), np.ascontiguousarray(q)
        if problem.mechanism.surplus:
            own = sighting.likely(rows, state.poses[index][rows], tables)
            weight = np.ones(rows.size) if data.weight is None else np.sqrt(data.weight[rows])
            if weights is not None:
                weight = weight * weights[rows]
            yield _CompiledRows(
                rows, *same, (own.u, q, own.pose, own.seen, own.white), own.number,
                own.white.shape[1] + problem.mechanism.surplus, own.noise, own.gaps, weight)
            continue
        seen, white, number = problem.measured(index, rows)
        if weights is not None:
            white = white * weights[rows][:, None]
        u = np.ascontiguousarray(np.broadcast_to(tables.u, (rows.size, tables.u.shape[1])))
        yield _CompiledRows(rows, *same, (u, q, _taken(rows, state.poses[index]), seen, white),
                            number, white.shape[1])


def _pieces(rows: Ints) -> Iterator[Ints]:
    """Yield rows (n,) in pieces, to bound memory."""
    for begin in range(0, rows.size, PIECE):
        yield rows[begin:begin + PIECE]


def _compiled_sums(problem: Problem, state: State, index: int, keep: Bools,
                   weights: Array | None) -> tuple[Array, float] | None:
    """Return the sums (C + 1, C + 1) of a data set, None if it has no compiled form."""
    upper, count, rows = None, 0.0, None
    for rows in _compiled_rows(problem, state, index, keep, weights):
        own = rows.made(slice(None), np.zeros((0, 0, 0)))
        upper = own if upper is None else upper + own
        count += problem.values(index, rows.index, rows.values)
    if upper is None or rows is None:
        return None
    whole = np.triu(upper) + np.triu(upper, 1).T
    place = np.concatenate([rows.entries.column, rows.columns])
    # entries of one column add up; those of different columns are in place
    by_row = np.zeros((len(problem.columns) + 1, whole.shape[1]))
    np.add.at(by_row, place, whole)
    total = np.zeros((len(by_row), len(by_row)))
    np.add.at(total.T, place, by_row.T)
    return np.triu(total) + np.triu(total, 1).T, count


@dataclass(frozen=True, eq=False)
class WhiteBlock:
    """Some white rows of a data set, with the residual after their C columns.

    ``index`` (n,): which rows; ``rows`` (n, m, C + 1), 0 where nothing was measured; ``values``
    (n,): number of values among the m.
    """

    index: Ints
    rows: Array
    values: Ints


def white_blocks(problem: Problem, state: State, index: int, keep: Bools,
                 weights: Array | None = None, given: Sequence[Bools] | None = None
                 ) -> Iterator[WhiteBlock]:
    """Yield the rows of one data set that have a pose; arguments as for :func:`normal_sums`.

    ``given``: as in :meth:`Problem.rows_of`.
    """
    size, rows = len(problem.columns) + 1, None
    mixed = given is not None and bool(problem.companions[index])
    for rows in () if mixed else _compiled_rows(problem, state, index, keep, weights):
        for begin in range(0, len(rows.values), AT_ONCE):
            some = slice(begin, begin + AT_ONCE)
            out = np.zeros((len(rows.values[some]), rows.size, size))
            rows.made(some, out)
            yield WhiteBlock(rows.index[some], out, rows.values[some])
    if rows is not None:
        return
    for part in problem.rows_of(index, state, True, keep, given):
        block = np.concatenate([part.jacobian, part.residual[..., None]], axis=-1)
        if weights is not None:
            block *= weights[part.index][:, None, None]
        yield WhiteBlock(part.index, block, part.observed.sum(axis=1))


def _taken(rows: Ints, array: Array) -> Array:
    """Return some rows of an array, or the array if that is all of them."""
    return np.ascontiguousarray(array) if rows.size == len(array) else array[rows]
