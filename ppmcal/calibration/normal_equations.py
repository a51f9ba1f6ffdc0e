"""The rows of a fit as normal equations: J^T J, J^T r and r^T r, without J where rows are many.

Squaring costs half of the digits: what is summed here finds the way, not the end. A fit takes its
steps from these sums while their condition allows (:mod:`least_squares`), and its last one, its
ranks and its intervals from the triangle that QR makes of the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.instrument_tables import SCALE, TARGET, TURN, InstrumentTables
from ppmcal.calibration.observation import coordinates
from ppmcal.calibration.problem import Problem, State
from ppmcal.kinematics import compiled_limbs
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.limbs.chain import left_jacobian


@dataclass(frozen=True)
class NormalSums:
    """All rows: ``matrix`` J^T J (C, C), ``gradient`` J^T r (C,), r^T r, and how many values."""

    matrix: Array
    gradient: Array
    square: float
    count: int


def normal_sums(problem: Problem, state: State, keep: Sequence[Bools],
                weights: Sequence[Array] | None = None) -> NormalSums:
    """Return the normal equations of all rows; arguments as :func:`least_squares.qr_factor`."""
    size = len(problem.columns) + 1
    total, count = np.zeros((size, size)), 0
    for i in range(len(problem.datasets)):
        own = _compiled_sums(problem, state, i, keep[i], None if weights is None else weights[i])
        if own is not None:
            total += own[0]
            count += own[1]
            continue
        for rows in problem.rows_of(i, state, True, keep[i]):
            block = np.concatenate([rows.jacobian, rows.residual[..., None]], axis=-1)
            if weights is not None:
                block *= weights[i][rows.index][:, None, None]
            block = block.reshape(-1, size)
            total += block.T @ block
            count += int(rows.observed.sum())
    if problem.earlier is not None:
        residual, jacobian = problem.earlier.rows(problem.mechanism, problem.free, state.g)
        block = np.zeros((residual.size, size))
        block[:, :len(problem.free)], block[:, -1] = jacobian, residual
        total += block.T @ block
        count += residual.size
    return NormalSums(total[:-1, :-1], total[:-1, -1], float(total[-1, -1]), count)


def row_squares(problem: Problem, state: State, index: int, rows: Bools) -> Array | None:
    """Return the white squares (n,) of some rows (N,) of a data set, which all have poses.

    None where the noise of joints, effects or distances take more than the residual itself.
    """
    at = np.flatnonzero(rows)
    if not _has_sight(problem, state, index):
        return None
    if at.size < compiled_limbs.MANY:
        return _few_squares(problem, state, index, at)
    from ppmcal.calibration.compiled_rows import row_squares as squares

    seen, white, _ = problem.measured[index]
    return squares(_sight(problem, state, index), *_taken(at, state.poses[index], seen, white))


def _few_squares(problem: Problem, state: State, index: int, rows: Ints) -> Array | None:
    """Return the same for few rows, by NumPy; None in the plane."""
    data, registration = problem.datasets[index], state.registrations[index]
    if problem.mechanism.motion == "planar":
        return None
    seen, white, _ = problem.measured[index]
    pose, seen, white = _taken(rows, state.poses[index], seen, white)
    placed = cga.compose(registration.frame, pose)
    scale = 1.0 if data.kind == "plane" else registration.scale
    left = seen - np.pad(scale * cga.move_point(placed, registration.target), ((0, 0), (0, 3)))
    parts = list(coordinates(data, problem.mechanism.motion))
    if parts[-1] > 2:
        still = np.zeros(3)
        body = cga.motor_from_rotation_vector(registration.target_rotation, still)
        shown = cga.motor_from_rotation_vector(seen[:, 3:], still)
        left[:, 3:] = cga.rotation_vector(cga.compose(
            shown, cga.reverse(cga.compose(placed, body))))
    return np.asarray(np.sum((white * left[:, parts]) ** 2, axis=1))


def _compiled_sums(problem: Problem, state: State, index: int, keep: Bools,
                   weights: Array | None) -> tuple[Array, int] | None:
    """Return the sums (C + 1, C + 1) of a data set, None where it has no compiled form."""
    at = np.flatnonzero(keep & finite_rows(state.poses[index]))
    if at.size < compiled_limbs.MANY or not _has_sight(problem, state, index):
        return None
    q, pose = _taken(at, problem.joints(index, state), state.poses[index])
    closure = Model(problem.mechanism, state.g).closure(q, problem.free)
    tables = compiled_limbs.compiled_limbs(closure, at.size)
    if tables is None:
        return None
    columns = problem.opens[index]
    homing = columns.homing.start if columns.homing.stop > columns.homing.start else None
    entries = tables.entries({p: c for c, p in enumerate(problem.free)}, homing)
    if entries is None:
        return None
    from ppmcal.calibration.compiled_rows import normal_sums as sums

    sight = _sight(problem, state, index)
    seen, white, number = problem.measured[index]
    seen, white = _taken(at, seen, white)
    count = int(number[at].sum())
    if weights is not None:
        white = white * weights[at][:, None]
    upper = sums(tables.limbs, entries, sight, *_each(tables, at.size), pose, seen, white)
    whole = np.triu(upper) + np.triu(upper, 1).T
    place = np.concatenate([entries.column, _open_columns(problem, index)[1],
                            [len(problem.columns)]])
    # entries of one column add up; those of different columns are where they belong
    by_row = np.zeros((len(problem.columns) + 1, whole.shape[1]))
    np.add.at(by_row, place, whole)
    total = np.zeros((len(by_row), len(by_row)))
    np.add.at(total.T, place, by_row.T)
    return np.triu(total) + np.triu(total, 1).T, count


def _each(tables: compiled_limbs.CompiledLimbs, count: int) -> tuple[Array, Array]:
    return (np.ascontiguousarray(np.broadcast_to(tables.u, (count, tables.u.shape[1]))),
            np.ascontiguousarray(tables.closure.q))


def _taken(rows: Ints, *arrays: Array) -> list[Array]:
    """Return some rows of arrays, themselves where that is all of them."""
    return [np.ascontiguousarray(a) if rows.size == len(a) else a[rows] for a in arrays]


def _has_sight(problem: Problem, state: State, index: int) -> bool:
    """Whether what a data set shows is its poses' own: no effects, no distances, sound joints."""
    data = problem.datasets[index]
    own_scale = data.scale.fitted or state.registrations[index].scale != 1.0
    return (not problem.mechanism.effects
            and data.kind != "distance" and not (data.kind == "plane" and own_scale)
            and not np.any(data.sigma_actuator > 0.0))


def _open_columns(problem: Problem, index: int) -> tuple[list[int], list[int]]:
    """Return the open parts of a registration, numbered, and their columns."""
    columns = problem.opens[index]
    parts: list[int] = []
    where: list[int] = []
    for own, names, first in ((columns.frame, columns.frame_parts, 0),
                              (columns.target, columns.target_parts, TARGET),
                              (columns.target_rotation, columns.turn_parts, TURN),
                              (columns.scale, (0,), SCALE)):
        if own.stop > own.start:
            parts += [first + part for part in names]
            where += range(own.start, own.stop)
    return parts, where


def _sight(problem: Problem, state: State, index: int) -> InstrumentTables:
    """Return what a data set's instrument sees from where it stands."""
    data, registration = problem.datasets[index], state.registrations[index]
    motion = problem.mechanism.motion
    about = problem.opens[index].about
    body = cga.motor_from_rotation_vector(registration.target_rotation, np.zeros(3))
    frame = registration.frame
    return InstrumentTables(
        np.concatenate([cga.rotation_matrix(frame).ravel(), cga.translation(frame)]),
        np.array(frame[:4]), np.array(body[:4]), np.asarray(registration.target, dtype=float),
        left_jacobian(registration.target_rotation).ravel(), np.asarray(about, dtype=float),
        1.0 if data.kind == "plane" else float(registration.scale), motion == "planar",
        np.array(coordinates(data, motion)), np.array(_open_columns(problem, index)[0],
                                                      dtype=np.int64))
