"""Joints' zeros that moved between sessions: an endstop that slipped, a drive homed anew.

One shift per session and joint, tested as added variables of the whole fit; rows that were left
out of a session as outliers, most of them, are taken back for the test.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from ppmcal import linalg
from ppmcal.calibration.fit.coverage import coverage_of, variances
from ppmcal.calibration.fit.fit_result import Fit, values_fitted
from ppmcal.calibration.fit.linearisation import to_prior
from ppmcal.calibration.fit.problem import Problem
from ppmcal.linalg import Array, Bools, Ints, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.sessions import session_masks

SHIFTED = 1e-3
"""A zero has moved where chance would show such a shift this rarely in any session."""
MANY_OUT = 0.3
"""Rows left out count again where more than this part of their session was."""
SEEN = 1e-15
"""Directions of less than this part of the strongest are round-off of the normal equations."""
MOST = 20000
"""Shifts of zeros are looked for in at most so many rows, evenly spread."""


@dataclass(frozen=True)
class HomingShift:
    """A joint's zero in one session against the others: ``value`` +- ``sigma``, SI.

    ``half``: of the 95 % interval, the size of the noise not being known exactly.
    """

    session: str
    actuator: str
    value: float
    sigma: float
    half: float
    p_value: float


def homing_shifts(fit: Fit) -> Iterator[HomingShift]:
    """Yield the joints' zeros that moved in one session against the others.

    The session that stands out most is named and taken out, then the others are tested again;
    of the last two it is the smaller one.
    """
    sessions = _sessions(fit.problem)
    if len(sessions) < 2:
        return
    keep = _taken_back(fit, sessions)
    while len(sessions) > 1:
        trials = list[tuple[float, int, Array, Array, float]]()
        for n, (_, rows) in enumerate(sessions):
            estimate, information, times = _shift(fit, keep, rows)
            if estimate is not None:
                square = float(estimate @ information @ estimate)
                trials.append((square, n, estimate, information, times))
        if not trials:
            return
        most = max(t[0] for t in trials)
        alike = [t for t in trials if t[0] > 0.99 * most]
        square, n, estimate, information, times = min(
            alike, key=lambda t: sessions[t[1]][1].size - t[1])
        if float(chdtrc(estimate.size, square)) * len(sessions) > SHIFTED:
            return
        label, rows = sessions.pop(n)
        yield from _which(label, fit.problem.mechanism.actuators, estimate, information, times)
        keep = _apart(keep, rows)


def _apart(keep: Sequence[Bools], rows: Ints) -> list[Bools]:
    """Return the masks without some rows, numbered through all data sets."""
    whole = np.concatenate(list(keep))
    whole[rows] = False
    return _by_dataset(whole, keep)


def _sessions(problem: Problem) -> list[tuple[str, Ints]]:
    """Return label and rows, numbered through all data sets, where zeros are taken as shared."""
    shared = np.concatenate([np.full(len(d), d.homing != "per-file") for d in problem.datasets])
    found = ((label, np.flatnonzero(np.concatenate(mask) & shared))
             for label, mask in session_masks(problem.datasets))
    return [(label, rows) for label, rows in found if rows.size]


def _taken_back(fit: Fit, sessions: Sequence[tuple[str, Ints]]) -> list[Bools]:
    """Return the rows for the test: those used, and all of a session that was mostly left out."""
    whole = np.concatenate(list(fit.keep))
    out = np.concatenate(fit.outliers)
    for _, rows in sessions:
        if out[rows].mean() > MANY_OUT:
            whole[rows] |= out[rows]
    return subsample(_by_dataset(whole, fit.keep), MOST)


def _by_dataset(whole: Bools, keep: Sequence[Bools]) -> list[Bools]:
    """Return a mask of all rows as one by data set, as long as those of ``keep``."""
    return np.split(whole, np.cumsum([len(k) for k in keep])[:-1])


def _shift(fit: Fit, keep: Sequence[Bools], rows: Ints) -> tuple[Array | None, Array, float]:
    """Return the shifts of the joints in some rows (k,) and their information (k, k).

    The normal equations of all columns with the shifts as added ones; the noise is taken as
    the residuals show it, and last comes half of a 95 % interval over the sigma it makes.
    """
    size = len(fit.problem.columns)
    k = len(fit.problem.mechanism.actuators)
    prior, free = fit.prior, list(fit.problem.free)
    held, pull = np.diag(prior**2), prior**2 * to_prior(fit.problem, fit.state)
    seen, moved = np.zeros((size, size)), np.zeros(size)
    cross, own, other = np.zeros((size, k)), np.zeros((k, k)), np.zeros(k)
    square, count = 0.0, 0
    if fit.problem.earlier is not None:
        missed, slope = fit.problem.earlier.rows(fit.problem.mechanism, free, fit.state.g)
        held[:len(free), :len(free)] += slope.T @ slope
        pull[:len(free)] += slope.T @ missed
    for jacobian, joints, residual in _blocks(fit, keep, rows):
        seen += jacobian.T @ jacobian
        moved += jacobian.T @ residual
        cross += jacobian.T @ joints
        own += joints.T @ joints
        other += joints.T @ residual
        square += float(residual @ residual)
        count += residual.size
    scale, normal, right = fit.scale, seen + held, moved + pull
    w, v = linalg.eigh(normal * np.outer(scale, scale))
    use = w > SEEN * max(float(w[-1]), 1e-300)
    inverse = ((v[:, use] / w[use]) @ v[:, use].T) * np.outer(scale, scale)
    information = own - cross.T @ inverse @ cross
    if not np.all(linalg.eigvalsh(information) > 1e-9 * max(np.trace(own), 1e-300)):
        return None, information, np.inf
    estimate = linalg.solve(information, other - cross.T @ inverse @ right)
    # what the rows then miss; tolerances give way too, which is no noise
    step = inverse @ (right - cross @ estimate)
    left = max(0.0, float(square - 2.0 * (step @ moved + estimate @ other) + step @ seen @ step
                          + 2.0 * step @ cross @ estimate + estimate @ own @ estimate))
    fitted = values_fitted(int(use.sum()), np.diagonal(inverse), prior) + k
    degrees = max(count - fitted, 1.0)
    noise = max(1.0, left / degrees)
    times = coverage_of(variances(left / noise, degrees))
    return np.asarray(estimate), np.asarray(information / noise), times


def _blocks(fit: Fit, keep: Sequence[Bools], rows: Ints) -> Iterator[tuple[Array, Array, Array]]:
    """Yield Jacobian (n, C), columns of shifts in ``rows`` (n, k) and residual (n,), white."""
    begin = 0
    for i, data in enumerate(fit.problem.datasets):
        mine = rows[(rows >= begin) & (rows < begin + len(data))] - begin
        begin += len(data)
        inside = np.zeros(len(data), dtype=bool)
        inside[mine] = True
        for shifted, part in ((True, keep[i] & inside), (False, keep[i] & ~inside)):
            if not part.any():
                continue
            only = [part if j == i else np.zeros_like(k) for j, k in enumerate(keep)]
            yield from _block(fit, i, only, shifted)


def _block(fit: Fit, i: int, keep: Sequence[Bools], shifted: bool
           ) -> Iterator[tuple[Array, Array, Array]]:
    k = len(fit.problem.mechanism.actuators)
    size = len(fit.problem.columns)
    homed = _homed(fit.problem, i) if shifted else None
    moves = homed.rows(fit.state, True, keep) if homed else None
    for found in fit.problem.rows(fit.state, True, keep):
        jacobian = found.jacobian.reshape(-1, size)
        joints = np.zeros((len(jacobian), k))
        if homed is not None and moves is not None:
            joints = next(moves).jacobian[..., homed.opens[i].homing].reshape(-1, k)
        yield jacobian, joints, found.residual.reshape(-1)


def _homed(problem: Problem, i: int) -> Problem:
    """Return the problem with columns for shifts of the zeros of data set ``i``."""
    datasets: list[Dataset] = list(problem.datasets)
    datasets[i] = replace(datasets[i], homing="alone")
    return replace(problem, datasets=tuple(datasets), pivots=tuple(
        o.about for o in problem.opens))


def _which(label: str, names: Sequence[str], estimate: Array, information: Array, times: float
           ) -> Iterator[HomingShift]:
    """Yield the fewest joints whose shifts explain a session, the largest first."""
    chosen: list[int] = []
    target = information @ estimate
    while len(chosen) < len(names):
        rest = [c for c in range(len(names)) if c not in chosen]
        part, left = information, target
        if chosen:
            inner = linalg.inv(information[np.ix_(chosen, chosen)])
            across = information[:, chosen] @ inner
            part = information - across @ information[chosen]
            left = target - across @ target[chosen]
        gain = np.array([left[c] ** 2 / part[c, c] if part[c, c] > 0 else 0.0 for c in rest])
        if float(chdtrc(1, gain.max())) * len(names) > SHIFTED:
            break
        chosen.append(rest[int(np.argmax(gain))])
    if not chosen:
        return
    inner = linalg.inv(information[np.ix_(chosen, chosen)])
    value = inner @ target[chosen]
    for c, v, variance in zip(chosen, value, np.diagonal(inner), strict=True):
        sigma = float(np.sqrt(variance))
        yield HomingShift(label, names[c], float(v), sigma, times * sigma,
                          float(chdtrc(1, v * v / variance)))
