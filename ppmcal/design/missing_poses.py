"""How many poses a campaign lacks, and which: what it leaves unknown decides.

A parameter is unknown where its variance exceeds what many more poses of the same instrument would
leave by more than half its tolerance, squared. Chosen one by one: the candidate that lowers the
summed variance of the unknown parameters most, in units of their tolerances, given all that the
campaign knows already. The new rows are a session of their own: frame and target are open again
wherever they were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import (
    HALF,
    Fit,
    MissingPoses,
    Problem,
    State,
    WeakCampaign,
    column_scale,
    geometry,
    grouped,
    poses_in_use,
    prior_weights,
    qr_factor,
    room,
    weak_shapes,
)
from ppmcal.design.plan.candidate_poses import Candidates, draw, listed, region_of
from ppmcal.design.virtual_instrument import Instrument
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import Unknown
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.wording.progress import stage

CANDIDATES = 200
FEWEST, MOST = 4, 60
"""Fewer would not settle a frame of their own; more are another campaign; what so many, spread over
the machine's region, do not tell is not said to be missing."""
LOOSE = 1e-3
"""Weight, per natural unit, of what nothing knows yet."""
BEYOND = 0.1
"""Poses go beyond a campaign where they leave its range by this part of the machine's."""
NAME = "further poses"


@stage("judging the poses")
def weak_campaign(fit: Fit, seed: int) -> WeakCampaign | None:
    """Return what is weak about the poses of a fit, and the poses that it lacks.

    None where other poses of the same instrument would tell no more: it is not they that are weak.

    Args:
        fit: its noise as the residuals show it.
        seed: of the candidates.
    """
    shapes = weak_shapes(fit)
    i = _like(fit)
    if not shapes or i is None:
        return None
    try:
        pool, instrument = _pool(fit, i, seed), _instrument(fit, i)
        machine = replace(fit.problem.mechanism.nominal(), free=geometry(fit))
        jacobian, names = _white(machine, instrument, pool)
    except PpmcalError:
        return None    # nothing can be planned for this machine; why is `plan`'s to say
    count = len(machine.free)
    start = np.diag(np.full(len(names), LOOSE**2))
    start[:count, :count] += _known(fit)
    each = np.einsum("rmi,rmj->ij", jacobian, jacobian) / len(pool)
    least = _variances(start + MOST * each)
    wanted = (_variances(start) - least > HALF**2) & (np.arange(len(names)) < count)
    if not wanted.any():
        return None
    chosen = pool.take(_chosen(start, jacobian, wanted, least))
    unknown = tuple(n for n, w in zip(names, wanted, strict=True) if w)
    return WeakCampaign(shapes, unknown, grouped(machine, unknown, names[:count]),
                    fit.problem.datasets[i].kind.touches,
                    MissingPoses(chosen.q, chosen.pose, _where(fit, chosen.pose)))


def poses_to_tell(fit: Fit, slots: Sequence[str], seed: int) -> int | None:
    """Return how many poses more would tell closed slots, were they free too.

    None where no more than :data:`MOST` would, or nothing can be planned.
    """
    mechanism = fit.problem.mechanism
    free = tuple(sorted({*fit.problem.free, *(mechanism.names.index(s) for s in slots)}))
    problem = fit.problem.changed(free=free)
    wider = replace(fit, problem=problem, information=qr_factor(problem, fit.state, fit.keep),
                    prior=prior_weights(problem, "prior"), scale=column_scale(problem))
    i = _like(fit)
    if i is None or not slots:
        return None
    try:
        pool, instrument = _pool(fit, i, seed), _instrument(fit, i)
        machine = replace(mechanism.nominal(), free=geometry(wider))
        jacobian, names = _white(machine, instrument, pool)
    except PpmcalError:
        return None
    count = len(machine.free)
    start = np.diag(np.full(len(names), LOOSE**2))
    start[:count, :count] += _known(wider)
    each = np.einsum("rmi,rmj->ij", jacobian, jacobian) / len(pool)
    least = _variances(start + MOST * each)
    wanted = np.isin(names, slots) & (_variances(start) - least > HALF**2)
    rows = _chosen(start, jacobian, wanted, least) if wanted.any() else np.zeros(0)
    return len(rows) if 0 < len(rows) < MOST else None


def _known(fit: Fit) -> Array:
    """Return the information on the geometry (F, F) of data and tolerances, per tolerance."""
    half = np.concatenate([fit.information.root * fit.scale, np.diag(fit.prior * fit.scale)])
    whole = half.T @ half
    own = np.isin(fit.problem.free, geometry(fit))
    here = np.concatenate([own, np.zeros(len(whole) - own.size, dtype=bool)])
    rest = whole[np.ix_(~here, ~here)] + LOOSE**2 * np.eye(int((~here).sum()))
    across = whole[np.ix_(here, ~here)]
    return np.asarray(whole[np.ix_(here, here)] - across @ linalg.solve(rest, across.T))


def _like(fit: Fit) -> int | None:
    """Return the data set that new rows are like: the most numbers a row; None: none can be."""
    motion = fit.problem.mechanism.motion
    found = [(-len(d.kind.coordinates(motion)), not d.kind.sees_rotation, d.kind.along_line, i)
             for i, d in enumerate(fit.problem.datasets)
             if d.to_q is None and fit.keep[i].any()]
    return min(found)[-1] if found else None


def _instrument(fit: Fit, i: int) -> Instrument:
    """Return the instrument of a data set, where the fit has it, noise as in the fit."""
    data, at = fit.problem.datasets[i], fit.state.registrations[i]

    def middle(values: Array) -> float:
        seen = values[np.isfinite(values)]
        return float(np.median(seen)) if seen.size else np.nan

    return Instrument(
        data.kind, middle(data.sigma_position), middle(data.sigma_rotation),
        middle(data.sigma_value), data.sigma_actuator,
        Unknown(data.frame.fitted, at.frame_pose), Unknown(data.target.fitted, at.target),
        Unknown(data.target_rotation.fitted, at.target_rotation), name=NAME,
        scale=replace(data.scale, value=np.array([at.scale])),
        offset=replace(data.offset, value=np.array([at.offset])))


def _pool(fit: Fit, i: int, seed: int) -> Candidates:
    """Return poses to choose from: of the machine's region; of touches those at the flat."""
    nominal = fit.problem.mechanism.nominal()
    inside = fit.problem.datasets[i].kind.inside
    pool = draw(nominal, region_of(nominal, inside), CANDIDATES, seed)
    if not fit.problem.datasets[i].kind.touches:
        return pool
    seen = poses_in_use(fit)
    flat = linalg.lstsq(np.c_[np.ones(len(seen)), seen[:, :2]], seen[:, 2], rcond=None)[0]
    poses = pool.pose.copy()
    poses[:, 2] = flat[0] + poses[:, :2] @ flat[1:]
    return listed(nominal, poses, NAME)


def _white(mechanism: Mechanism, instrument: Instrument, pool: Candidates
           ) -> tuple[Array, tuple[str, ...]]:
    """Return white rows (R, m, C) in natural units, and the names of their columns."""
    data = instrument.dataset(pool.q, pool.pose, {}, mechanism)
    problem = Problem(mechanism, (data,), mechanism.free)
    state = problem.solve(State(mechanism.values, (instrument.registration,),
                                (pose_motor(pool.pose),)))
    parts = list(problem.rows(state, True, [finite_rows(state.poses[0])]))
    jacobian = np.zeros((len(pool), *parts[0].jacobian.shape[1:]))
    for rows in parts:
        jacobian[rows.index] = rows.jacobian
    return jacobian * column_scale(problem), problem.columns


def _chosen(start: Array, jacobian: Array, wanted: Bools, least: Array) -> Ints:
    """Return rows, in the order of choice, after which what is wanted is known well enough.

    ``least``: the variances (C,) that no rows can lower.
    """
    information, rows = start.copy(), list[int]()
    while len(rows) < MOST:
        inverse = _inverse(information)
        if len(rows) >= FEWEST and np.all((np.diagonal(inverse) - least)[wanted] <= HALF**2):
            break
        gain = inverse @ np.swapaxes(jacobian, -1, -2)
        core = linalg.inv(np.eye(jacobian.shape[1]) + jacobian @ gain)
        own = gain[:, wanted]
        fall = np.einsum("rij,rci,rcj->r", core, own, own)
        fall[rows] = 0.0    # the same pose again tells its own noise, not the machine
        best = int(np.argmax(fall))
        if fall[best] <= 0.0:
            break
        rows.append(best)
        information += jacobian[best].T @ jacobian[best]
    return np.array(rows, dtype=np.int64)


def _variances(information: Array) -> Array:
    return np.asarray(np.diagonal(_inverse(information)))


def _inverse(information: Array) -> Array:
    """Return the covariance (C, C) of an information matrix whose columns differ much in scale."""
    d = 1.0 / np.sqrt(np.diagonal(information))
    values, vectors = linalg.eigh(information * np.outer(d, d))
    half = vectors / np.sqrt(np.maximum(values, 1e-15)) * d[:, None]
    return np.asarray(half @ half.T)


def _where(fit: Fit, poses: Array) -> tuple[tuple[str, float, float], ...]:
    """Return the coordinates in which poses leave the campaign's range: name, both ends, SI."""
    chosen, size = room(fit.problem.mechanism)
    seen, out = poses_in_use(fit), []
    for c, whole in zip(chosen, size.tolist(), strict=True):
        low, high = float(poses[:, c].min()), float(poses[:, c].max())
        past = max(float(seen[:, c].min()) - low, high - float(seen[:, c].max())) / whole
        if past > BEYOND:
            out.append((past, (POSE_COORDINATES[c], low, high)))
    return tuple(w for _, w in sorted(out, key=lambda o: -o[0]))
