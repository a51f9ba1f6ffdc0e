"""What a calibration's data say of things that it took for known: homing, frames, targets, scales.

Two sessions of one machine can differ in these although nothing in it has changed. At the end of
a fit its rows get a column for each of them beside the parameters', and are reduced to a triangle
again; what no column explains is the noise, or what the model misses, row by row.

Rows that the fit left out as outliers take part (Huber's estimator): what they are off by beyond
the bound at which rows are left out is cut to it. Which rows of a place that the model misses are
left out is a matter of chance, and a session that happens to lose them knows no more of the
machine; but a mistake of hundreds of sigma pulls no more than the worst row that could be right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.fit import (
    Fit,
    Problem,
    Rows,
    SessionKnowledge,
    Sight,
    coordinates,
    of_data,
    rows_with_outliers,
)
from ppmcal.linalg import (
    Array,
    Bools,
    Ints,
    column_lengths,
    range_basis,
    subsample,
    svd,
    unit_columns,
    without_range,
)
from ppmcal.model.dataset import Dataset
from ppmcal.model.effects import Shift
from ppmcal.model.instruments import SCALARS
from ppmcal.model.same_rows import ROUND_OFF

SHAPES = ("bowl", "saddle", "twist")
"""Curvatures of a flat: x^2 + y^2, x^2 - y^2, 2 x y, each over the machine's reach."""
SESSION = "session"
"""Homing is the whole session's: ``homing.<joint> of session``."""
LEAST, NUMBERS = 5.0, 5000
"""Rows that leave fewer degrees of freedom, or are no more numbers, are kept as they are."""
REJECT = 0.05
"""Chance of noise beyond the bound at which rows are cut, over all of them."""
LEVERAGE = 0.05
"""A row counts as if the fit had left it this part of its own error at least."""
MOST = 600
"""Rows of which the rest is kept, evenly spread."""
ROUNDS, SETTLED = 30, 1e-6
"""Steps to the minimum of rows that are cut; the last one is of so little a chi-squared."""


def session_knowledge(fit: Fit) -> SessionKnowledge:
    """Return what the data of a fit say beyond its parameters, white by the stated noise."""
    problem, free = _opened(fit.problem), len(fit.problem.free)
    columns = _columns(fit.problem, problem)
    fit, cut, found = _with_left_out(fit, problem, columns)
    scale, known = np.concatenate([fit.scale[:free], columns.scale]), free + len(columns.names)
    degrees = found.degrees
    few = fit.problem.earlier is None and (degrees < LEAST or found.count * known <= NUMBERS)
    if few:
        # so few that they stay as measured: another session's rows can be laid beside them
        block = np.concatenate([b[rows.observed] for rows, b in
                                _blocks(fit, problem, columns, cut, fit.keep)])
        nuisance = range_basis(unit_columns(block[:, known:-1]), ROUND_OFF)
        block = without_range(np.delete(block, np.s_[known:-1], axis=1), nuisance)
        matrix, reduced = block[:, :-1], block[:, -1]
    else:
        matrix, reduced = of_data(found.triangle, found.right, known, scale)
        # a row has no sign of its own, and would have another one on another processor
        leading = np.take_along_axis(matrix, np.abs(matrix).argmax(axis=1)[:, None], axis=1)[:, 0]
        sign = np.where(leading < 0.0, -1.0, 1.0)
        matrix, reduced = matrix * sign[:, None], reduced * sign
    noise = found.noise if degrees > 0 else 1.0
    sights, spread = _sights(fit, problem, columns, cut, found.basis)
    spread /= found.whole**2
    return SessionKnowledge(columns.names, matrix, reduced, columns.scale, noise,
                            float(np.sqrt(spread)) if degrees > 0 else 1.0, degrees, sights, few)


@dataclass(frozen=True)
class _Cut:
    """What rows are off by, beyond ``step`` (C,) of all columns, cut to where rows are left out.

    ``factor``: of the noise over the stated one; ``total``: rows, 0 where none was left out: then
    nothing is cut.
    """

    step: Array
    factor: float
    total: int

    def residual(self, rows: Rows, block: Array) -> Array:
        """Return the residual (n, m) of rows with their columns in a block (n, m, C + 1)."""
        if not self.total:
            return rows.residual
        explained = block[..., :-1] @ self.step
        rest = np.where(rows.observed, rows.residual - explained, 0.0)
        values = np.maximum(rows.observed.sum(axis=1), 1.0)
        bound = self.factor * np.sqrt(chdtri(values, REJECT / self.total))
        times = (bound / np.maximum(np.linalg.norm(rest, axis=1), 1e-300))[:, None]
        return np.where(times < 1.0, explained + times * rest, rows.residual)


@dataclass(frozen=True)
class _Reduced:
    """All rows as |triangle s - right|^2 of all columns (C, C), (C,), and their minimum.

    Attributes:
        step: where it is (C,); ``basis`` (C, r): rows times it are of an orthonormal basis.
        count, degrees: of values, and of what is left of them.
        noise: over the stated one.
        whole: the part of the values that was not cut: a cut one does not follow the step.
    """

    triangle: Array
    right: Array
    step: Array
    basis: Array
    count: int
    degrees: float
    noise: float
    whole: float


def _with_left_out(fit: Fit, problem: Problem, columns: _Columns) -> tuple[Fit, _Cut, _Reduced]:
    """Return a fit with the rows that it left out as outliers, how they are cut, and all of them.

    What is off by more than the bound is off from the minimum of what is cut: that is iterated.
    """
    total = 0
    if any(o.any() for o in fit.outliers):
        # a fit moves the poses of its own rows, not of those left out
        fit = replace(fit, state=fit.problem.solve(fit.state), keep=tuple(rows_with_outliers(fit)))
        total = sum(int(k.sum()) for k in fit.keep)
    size = len(fit.problem.free) + len(columns.names) + len(columns.gone)
    cut = _Cut(np.zeros(size), float(fit.noise_factor.max()), total)
    for _ in range(ROUNDS):
        found = _reduced(fit, problem, columns, cut)
        moved = found.triangle @ (found.step - cut.step)
        cut = replace(cut, step=found.step)
        if found.whole == 1.0 or float(moved @ moved) < SETTLED * found.degrees:
            break
    return fit, cut, found


def _reduced(fit: Fit, problem: Problem, columns: _Columns, cut: _Cut) -> _Reduced:
    stack, count, less = np.zeros((0, cut.step.size + 1)), 0, 0
    for rows, block in _blocks(fit, problem, columns, cut, fit.keep):
        count += int(rows.observed.sum())
        less += int(rows.observed[(block[..., -1] != rows.residual).any(axis=1)].sum())
        stack = linalg.triangle(np.concatenate([stack, block.reshape(-1, stack.shape[1])]))
    if fit.problem.earlier is not None:
        missed, slope = fit.problem.earlier.rows(fit.problem.mechanism, fit.problem.free,
                                                 fit.state.g)
        block = np.zeros((missed.size, stack.shape[1]))
        block[:, :len(fit.problem.free)], block[:, -1] = slope, missed
        stack = linalg.triangle(np.concatenate([stack, block]))
        count += missed.size
    triangle, right = stack[:, :-1], stack[:, -1]
    length = column_lengths(triangle)
    u, s, vt = svd(triangle / length)
    seen = s > ROUND_OFF * s.max(initial=1e-300)
    explained = u[:, seen].T @ right
    basis = vt[seen].T / s[seen] / length[:, None]
    degrees = float(count - int(seen.sum()))
    left = max(float(right @ right) - float(explained @ explained), 0.0)
    whole = max(count - less, 1) / max(count, 1)
    noise = float(np.sqrt(left / degrees)) / whole if degrees > 0 else 1.0
    return _Reduced(triangle, right, basis @ explained, basis, count, degrees, noise, whole)


def _opened(problem: Problem) -> Problem:
    """Return the problem with frame, target, rotation and homing of every data set open."""
    def opened(d: Dataset) -> Dataset:
        frame, target, turn = (u if u.fitted else replace(u, fitted=True)
                               for u in (d.frame, d.target, d.target_rotation))
        return replace(d, frame=frame, target=target, target_rotation=turn, homing="alone")

    return replace(problem, datasets=tuple(map(opened, problem.datasets)),
                   pivots=tuple(o.about for o in problem.opens),
                   given=problem.environments if problem.mechanism.effects else None
                   ).weighted(None)


@dataclass(frozen=True)
class _Columns:
    """Names and natural units of candidates (K,); columns that the fit had open and are ``gone``.

    ``place``: name -> column of the opened problem, of those that are one of its.
    """

    names: tuple[str, ...]
    scale: Array
    gone: tuple[int, ...]
    place: dict[str, int]


def _columns(own: Problem, problem: Problem) -> _Columns:
    free, mechanism = len(own.free), own.mechanism
    fitted = set(own.columns[free:])
    natural = dict(zip(problem.columns[free:], problem.open_scale().tolist(), strict=True))
    place = {n: c for c, n in enumerate(problem.columns) if c >= free
             and n not in fitted and not n.startswith("homing.")}
    homing = [f"homing.{a} of {SESSION}" for a in mechanism.actuators]
    unit = max(v for n, v in natural.items() if n.startswith("homing."))
    names, scale = [*homing, *place], [unit] * len(homing) + [natural[n] for n in place]
    for d in own.datasets:
        # heights are so small, or so alike, that their scale is nothing but their noise
        if d.kind != "plane":
            names.append(f"scale of {d.name}")
            scale.append(1e-3)
        else:
            names += [f"shape.{s} of {d.name}" for s in SHAPES]
            scale += [1e-3 * mechanism.reach] * len(SHAPES)
    return _Columns(tuple(names), np.array(scale),
                    tuple(c for c, n in enumerate(problem.columns) if c >= free and n in fitted),
                    place)


def _blocks(fit: Fit, problem: Problem, columns: _Columns, cut: _Cut, keep: Sequence[Bools]
            ) -> Iterator[tuple[Rows, Array]]:
    """Yield rows with their block (n, m, F + K + E + 1): parameters, candidates, gone, residual."""
    free = len(fit.problem.free)
    at = {n: free + i for i, n in enumerate(columns.names)}
    size = free + len(at) + len(columns.gone) + 1
    for rows in problem.rows(fit.state, True, keep):
        data, jacobian = problem.datasets[rows.dataset], rows.jacobian
        block = np.zeros((*rows.residual.shape, size))
        block[..., :free] = jacobian[..., :free]
        homing = problem.opens[rows.dataset].homing
        for c, a in enumerate(problem.mechanism.actuators):
            block[..., at[f"homing.{a} of {SESSION}"]] = jacobian[..., homing.start + c]
        for name, c in columns.place.items():
            block[..., at[name]] = jacobian[..., c]
        if data.kind != "plane":
            block[..., at[f"scale of {data.name}"]] = _white(rows, _stretched(rows))
        else:
            for name, shape in zip(SHAPES, _shapes(rows, problem.mechanism.reach), strict=True):
                block[..., at[f"shape.{name} of {data.name}"]] = _white(rows, shape)
        block[..., free + len(at):-1] = jacobian[..., list(columns.gone)]
        block[..., -1] = cut.residual(rows, block)
        yield rows, block


def _white(rows: Rows, column: Array) -> Array:
    seen = np.where(rows.observed, column, 0.0)
    return np.asarray((rows.whitener @ seen[..., None])[..., 0])


def _stretched(rows: Rows) -> Array:
    """Return how predictions (n, m) grow with the instrument's scale."""
    shift = Shift(stretch=np.eye(3)[None])
    return np.asarray(np.sum([r.column(shift) for r in (rows.response, rows.second)
                              if r is not None], axis=0))


def _shapes(rows: Rows, reach: float) -> list[Array]:
    """Return how heights (n, 1) change with a flat's curvatures."""
    assert rows.response is not None
    x, y, _ = cga.translation(rows.response.platform).T
    return [v[:, None] / reach for v in (x**2 + y**2, x**2 - y**2, 2.0 * x * y)]


def _sights(fit: Fit, problem: Problem, columns: _Columns, cut: _Cut, basis: Array
            ) -> tuple[tuple[Sight, ...], float]:
    """Return what is left of some rows in base axes, and its spread in the columns' space.

    Args:
        fit: the fit.
        problem: with everything open.
        columns: of the blocks.
        cut: with the step by which all columns explain the residual best.
        basis: (C, r): white rows (n, C) times it are rows of an orthonormal basis.

    What the model misses is alike in all coordinates of a pose, and in poses measured again, so
    that estimates scatter more than its size says: by the sum over poses of their scores' squares
    (sandwich), each as if the pose had been left out (jackknife; MacKinnon and White 1985).
    """
    found: list[list[tuple[Array, Array]]] = [[] for _ in problem.datasets]
    some = subsample(fit.keep, MOST)
    square = 0.0
    for rows, block in _blocks(fit, problem, columns, cut, some):
        data = problem.datasets[rows.dataset]
        rest = np.where(rows.observed, block[..., -1] - block[..., :-1] @ cut.step, 0.0)
        square += _scores(block[..., :-1] @ basis, rest, data.groups[rows.index])
        found[rows.dataset].append((data.q[rows.index], _raw(fit, rows, data, rest)))
    share = sum(int(k.sum()) for k in some) / max(1, sum(int(k.sum()) for k in fit.keep))
    sights = []
    for data, parts in zip(problem.datasets, found, strict=True):
        if parts:
            turns = 0 if data.kind in SCALARS else sum(
                c >= 3 for c in coordinates(data, problem.mechanism.motion))
            sights.append(Sight(data.name, data.kind, np.concatenate([q for q, _ in parts]),
                                np.concatenate([r for _, r in parts]), turns))
    return tuple(sights), square / (share * max(1, basis.shape[1]))


def _scores(rows: Array, rest: Array, groups: Ints) -> float:
    """Return the sum of squares of scores by pose, of an orthonormal basis' rows (n, m, r)."""
    size, turn = linalg.eigh(rows @ np.swapaxes(rows, -1, -2))
    part = np.maximum(1.0 - size, LEVERAGE)
    own = (turn @ ((np.swapaxes(turn, -1, -2) @ rest[..., None])[..., 0] / part)[..., None])
    score = (np.swapaxes(rows, -1, -2) @ own)[..., 0]
    _, label = np.unique(groups, return_inverse=True)
    total = np.zeros((label.max() + 1, score.shape[1]))
    np.add.at(total, label, score)
    return float(np.sum(total**2))


def _raw(fit: Fit, rows: Rows, data: Dataset, rest: Array) -> Array:
    """Return white residuals (n, m) in m and rad, base axes."""
    motion = fit.problem.mechanism.motion
    raw = np.where(rows.observed, linalg.solve(rows.whitener, rest[..., None])[..., 0], 0.0)
    if data.kind in SCALARS:
        return raw
    six = np.zeros((len(raw), 6))
    six[:, list(coordinates(data, motion))] = raw
    turn = cga.rotation_matrix(fit.state.registrations[rows.dataset].frame)
    return np.asarray((six.reshape(-1, 2, 3) @ turn).reshape(-1, 6)[:, list(
        coordinates(data, motion))])
