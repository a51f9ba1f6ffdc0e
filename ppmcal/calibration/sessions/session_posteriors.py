"""What a calibration's data say about quantities that it took as known: homing, frames, scales ...

Two sessions of one machine can differ in these although nothing in it has changed. At the end of
a fit its rows get a column for each of them beside those of the parameters, and are reduced to a
triangle again; what no column explains is noise, or the model's error, row by row.

Rows that the fit left out as outliers take part with weights that limit their pull to that of the
farthest row that may belong. Which rows of a badly modelled place are left out is a matter of
chance, and a session that happens to lose them knows no more about the machine.

Ropes that pull with another force stretch differently, without a change of the machine: joint
values alone, which do not see frames and targets, get a column for each set of ropes that may pull.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.fit import (
    DefiningParameters,
    Fit,
    PoseResiduals,
    Problem,
    Rows,
    SessionKnowledge,
    coordinates,
    distances,
    natural_units,
    of_data,
    rows_with_outliers,
    seen_from_frames,
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
from ppmcal.model.effects import effect_kinds
from ppmcal.model.mechanism import joint_groups, with_effect
from ppmcal.model.same_rows import ROUND_OFF

SHAPES = ("bowl", "saddle", "twist")
"""Curvatures of a flat: x^2 + y^2, x^2 - y^2, 2 x y, each over the machine's reach."""
SESSION = "session"
"""Homing is that of the whole session: ``homing.<joint> of session``."""
LEAST, NUMBERS = 5.0, 5000
"""Rows with fewer degrees of freedom, or with no more numbers, are kept as they are."""
LEVERAGE = 0.05
"""Minimum part of its own error that a row is assumed to keep in its residual."""
MOST = 600
"""At most this many rows are kept, evenly spread."""
PULLED, UNIT = 20_000, 100.0
"""Maximum rows for columns of pulling ropes; their natural unit in sizes of the effect."""


def session_knowledge(fit: Fit) -> SessionKnowledge:
    """Return the information of a fit's data beyond its parameters, white by the stated noise."""
    fit = _with_left_out(fit)
    problem, free = _with_pulls(_opened(fit.problem)), len(fit.problem.free)
    more = np.zeros(len(problem.free) - free)
    fit = replace(fit, state=replace(fit.state, g=np.append(fit.state.g, more)))
    columns = _columns(fit.problem, problem)
    found = _reduced(fit, problem, columns)
    scale, known = np.concatenate([fit.scale[:free], columns.scale]), free + len(columns.names)
    degrees = found.degrees
    few = fit.problem.earlier is None and (degrees < LEAST or found.count * known <= NUMBERS)
    if few:
        # few rows stay as measured: they can be compared with another session's rows
        block = np.concatenate([b[rows.observed] for rows, b in
                                _blocks(fit, problem, columns, fit.keep)])
        nuisance = range_basis(unit_columns(block[:, known:-1]), ROUND_OFF)
        block = without_range(np.delete(block, np.s_[known:-1], axis=1), nuisance)
        matrix, reduced = block[:, :-1], block[:, -1]
    else:
        matrix, reduced = of_data(found.triangle, found.right, known, scale)
        # the sign of a row is arbitrary, and would depend on the processor
        leading = np.take_along_axis(matrix, np.abs(matrix).argmax(axis=1)[:, None], axis=1)[:, 0]
        sign = np.where(leading < 0.0, -1.0, 1.0)
        matrix, reduced = matrix * sign[:, None], reduced * sign
    sights, spread = _sights(fit, problem, columns, found)
    return SessionKnowledge(columns.names, matrix, reduced, columns.scale, found.noise,
                            float(np.sqrt(spread)) if degrees > 0 else 1.0, degrees, few, sights)


def defining_parameters(fit: Fit) -> DefiningParameters | None:
    """Return what defined the frames of a fit to joint values alone, None if nothing did.

    A motion of one of them appears in its frame as a motion of all the others.
    """
    mechanism = fit.problem.mechanism
    held, seen = seen_from_frames(mechanism.with_values(fit.state.g), fit.problem.datasets,
                                  fit.problem.free)
    if not held:
        return None
    scale = natural_units(mechanism, held)
    return DefiningParameters(tuple(mechanism.names[p] for p in held), scale, (seen * scale).T)


def _with_left_out(fit: Fit) -> Fit:
    """Return a fit including rows left out as outliers, with weights that limit their pull."""
    if not any(o.any() for o in fit.outliers):
        return replace(fit, problem=fit.problem.weighted(None))
    # a fit moves the poses of its own rows, but not of those left out
    state = fit.problem.solve(fit.state)
    weights = distances(fit.problem, state).held_back(fit.keep, fit.noise_factor)
    return replace(fit, state=state, keep=tuple(rows_with_outliers(fit)),
                   problem=fit.problem.weighted(weights))


@dataclass(frozen=True)
class _Reduced:
    """All rows as |triangle s - right|^2 of all columns (C, C), (C,), and their minimum.

    Attributes:
        step: to the minimum (C,); ``basis`` (C, r): rows times it have an orthonormal basis.
        count, degrees: weighted number of values, and residual degrees of freedom.
        noise: over the stated noise.
    """

    triangle: Array
    right: Array
    step: Array
    basis: Array
    count: float
    degrees: float
    noise: float


def _reduced(fit: Fit, problem: Problem, columns: _Columns) -> _Reduced:
    size = len(fit.problem.free) + len(columns.names) + len(columns.gone) + 1
    stack = fit.problem.earlier_rows(fit.state, size)
    count = float(len(stack))
    for rows, block in _blocks(fit, problem, columns, fit.keep):
        count += rows.count
        stack = linalg.triangle(np.concatenate([stack, block.reshape(-1, size)]))
    triangle, right = stack[:, :-1], stack[:, -1]
    length = column_lengths(triangle)
    u, s, vt = svd(triangle / length)
    seen = s > ROUND_OFF * s.max(initial=1e-300)
    explained = u[:, seen].T @ right
    basis = vt[seen].T / s[seen] / length[:, None]
    degrees = count - float(seen.sum())
    left = max(float(right @ right) - float(explained @ explained), 0.0)
    return _Reduced(triangle, right, basis @ explained, basis, count, degrees,
                    float(np.sqrt(left / degrees)) if degrees > 0 else 1.0)


def _opened(problem: Problem) -> Problem:
    """Return the problem with frame, target, rotation, homing and scale of every data set open."""
    def opened(d: Dataset) -> Dataset:
        frame, target, turn = (u if u.fitted else replace(u, fitted=True)
                               for u in (d.frame, d.target, d.target_rotation))
        # heights are so small, or so alike, that their scale would only absorb noise
        return replace(d, frame=frame, target=target, target_rotation=turn, homing="alone",
                       scale=replace(d.scale, fitted=d.scale.fitted or d.kind.scales))

    return problem.changed(datasets=tuple(map(opened, problem.datasets)),
                           given=problem.environments if problem.mechanism.effects else None)


def _with_pulls(problem: Problem) -> Problem:
    """Return a problem of joint values alone with effects of pulling ropes, at 0, free last."""
    mechanism, free = problem.mechanism, problem.free
    if not problem.blind or sum(map(len, problem.datasets)) > PULLED:
        return problem
    for kind in effect_kinds().values():
        if kind.opposed and all(e.kind is not kind for e in problem.mechanism.effects):
            for on in joint_groups(problem.mechanism, kind):
                free = (*free, len(mechanism.parameters))
                mechanism = with_effect(mechanism, kind, on, {})
    return problem if free == problem.free else problem.changed(
        mechanism=mechanism, free=free, given=None)


@dataclass(frozen=True)
class _Columns:
    """Names and natural units of candidates (K,); columns ``gone`` that the fit had open.

    ``place``: name -> column of the opened problem, for those that it has.
    """

    names: tuple[str, ...]
    scale: Array
    gone: tuple[int, ...]
    place: dict[str, int]


def _columns(own: Problem, problem: Problem) -> _Columns:
    free, mechanism, last = len(own.free), own.mechanism, len(problem.free)
    fitted = set(own.columns[free:])
    natural = dict(zip(problem.columns[last:], problem.open_scale().tolist(), strict=True))
    pulls = {f"{problem.columns[c]} of {SESSION}": c for c in range(free, last)}
    natural |= {n: UNIT * (problem.mechanism.parameters[problem.free[c]].size or 1.0)
                for n, c in pulls.items()}
    place = pulls | {n: c for c, n in enumerate(problem.columns) if c >= last
             and n not in fitted and not n.startswith("homing.")}
    homing = [f"homing.{a} of {SESSION}" for a in mechanism.actuators]
    unit = max(v for n, v in natural.items() if n.startswith("homing."))
    names, scale = [*homing, *place], [unit] * len(homing) + [natural[n] for n in place]
    for d in own.datasets:
        if d.kind.touches:
            names += [f"shape.{s} of {d.name}" for s in SHAPES]
            scale += [1e-3 * mechanism.reach] * len(SHAPES)
    return _Columns(tuple(names), np.array(scale),
                    tuple(c for c, n in enumerate(problem.columns) if c >= free and n in fitted),
                    place)


def _blocks(fit: Fit, problem: Problem, columns: _Columns, keep: Sequence[Bools],
            apart: bool = False) -> Iterator[tuple[Rows, Array]]:
    """Yield rows with their block (n, m, F + K + E + 1): parameters, candidates, gone, residual.

    ``apart``: rows of targets at one stand are whitened separately, not together.
    """
    free = len(fit.problem.free)
    at = {n: free + i for i, n in enumerate(columns.names)}
    size = free + len(at) + len(columns.gone) + 1
    each = (r for i, k in enumerate(keep) for r in problem.rows_of(i, fit.state, True, k)
            ) if apart else problem.rows(fit.state, True, keep)
    for rows in each:
        data, jacobian = problem.datasets[rows.dataset], rows.jacobian
        block = np.zeros((*rows.residual.shape, size))
        block[..., :free] = jacobian[..., :free]
        homed = [problem.opens[i].homing for i in (rows.dataset, *(
            c.dataset for c in rows.companions))]
        for c, a in enumerate(problem.mechanism.actuators):
            block[..., at[f"homing.{a} of {SESSION}"]] = sum(
                jacobian[..., homing.start + c] for homing in homed)
        for name, c in columns.place.items():
            block[..., at[name]] = jacobian[..., c]
        if data.kind.touches:
            for name, shape in zip(SHAPES, _shapes(rows, problem.mechanism.reach), strict=True):
                block[..., at[f"shape.{name} of {data.name}"]] = _white(rows, shape)
        block[..., free + len(at):-1] = jacobian[..., list(columns.gone)]
        block[..., -1] = rows.residual
        yield rows, block


def _white(rows: Rows, column: Array) -> Array:
    return rows.whitened(np.pad(column, ((0, 0), (0, rows.surplus))))


def _shapes(rows: Rows, reach: float) -> list[Array]:
    """Return how heights (n, 1) change with a flat's curvatures."""
    assert rows.response is not None
    x, y, _ = cga.translation(rows.response.platform).T
    return [v[:, None] / reach for v in (x**2 + y**2, x**2 - y**2, 2.0 * x * y)]


def _sights(fit: Fit, problem: Problem, columns: _Columns, found: _Reduced
            ) -> tuple[tuple[PoseResiduals, ...], float]:
    """Return the residuals of some rows in base axes, and their spread in the columns' space.

    Errors of the model are alike in all coordinates of a pose, and in repeats, so that
    estimates scatter more than their size suggests: by the sum over poses of squared scores
    (sandwich), each as if the pose had been left out (jackknife; MacKinnon and White 1985).
    """
    left: list[list[tuple[Array, Array]]] = [[] for _ in problem.datasets]
    some = subsample(fit.keep, MOST)
    square = 0.0
    for rows, block in _blocks(fit, problem, columns, some):
        data = problem.datasets[rows.dataset]
        rest = np.where(rows.observed, block[..., -1] - block[..., :-1] @ found.step, 0.0)
        square += _scores(block[..., :-1] @ found.basis, rest, data.groups[rows.index])
        if not problem.companions[rows.dataset]:
            left[rows.dataset].append((data.q[rows.index], _raw(fit, rows, data, rest)))
    for rows, block in _blocks(fit, problem, columns, [
            k & bool(c) for k, c in zip(some, problem.companions, strict=True)], apart=True):
        data = problem.datasets[rows.dataset]
        rest = block[..., -1] - block[..., :-1] @ found.step
        left[rows.dataset].append((data.q[rows.index], _raw(fit, rows, data, rest)))
    share = sum(int(k.sum()) for k in some) / max(1, sum(int(k.sum()) for k in fit.keep))
    sights = []
    for data, parts in zip(problem.datasets, left, strict=True):
        if parts:
            turns = sum(c >= 3 for c in coordinates(data, problem.mechanism.motion))
            sights.append(PoseResiduals(
                data.name, data.kind.name, np.concatenate([q for q, _ in parts]),
                np.concatenate([r for _, r in parts]), turns))
    return tuple(sights), square / (share * max(1, found.basis.shape[1]))


def _scores(rows: Array, rest: Array, groups: Ints) -> float:
    """Return the sum of squared scores by pose, for rows (n, m, r) of an orthonormal basis."""
    size, turn = linalg.eigh(rows @ np.swapaxes(rows, -1, -2))
    part = np.maximum(1.0 - size, LEVERAGE)
    own = (turn @ ((np.swapaxes(turn, -1, -2) @ rest[..., None])[..., 0] / part)[..., None])
    score = (np.swapaxes(rows, -1, -2) @ own)[..., 0]
    _, label = np.unique(groups, return_inverse=True)
    total = np.zeros((label.max() + 1, score.shape[1]))
    np.add.at(total, label, score)
    return float(np.sum(total**2))


def _raw(fit: Fit, rows: Rows, data: Dataset, rest: Array) -> Array:
    """Return white residuals (n, m) in m and rad, base axes, weighted by row."""
    motion = fit.problem.mechanism.motion
    raw = np.where(rows.observed, linalg.solve(rows.whitener, rest[..., None])[..., 0], 0.0)
    if rows.weight is not None:
        raw = np.sqrt(rows.weight)[:, None] * raw
    raw = raw[:, :raw.shape[1] - rows.surplus]
    if data.kind.scalar or not data.kind.of_poses:
        return raw
    six = np.zeros((len(raw), 6))
    six[:, list(coordinates(data, motion))] = raw
    turn = cga.rotation_matrix(fit.state.registrations[rows.dataset].frame)
    return np.asarray((six.reshape(-1, 2, 3) @ turn).reshape(-1, 6)[:, list(
        coordinates(data, motion))])
