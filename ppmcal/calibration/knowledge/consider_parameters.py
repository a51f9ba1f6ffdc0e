"""Parameters that a fit held although they may be off: considered, not estimated.

Held at its nominal value, a parameter errs by its tolerance at every pose, and so do the fitted
ones, which absorbed the part of its effect on the rows that they could. With H the rows of data and
prior and J those of the held parameters, an error d of these makes the estimates err by H^+ J d
(Schmidt 1966; Bierman 1977, chapter VIII). Where rows were measured the two errors cancel as far as
they are alike; elsewhere they need not.

With joint values alone, some are held to define the frames of base and platform
(:mod:`ppmcal.calibration.fit.gauge`). These are exact: their error d moves the frame, in which the
others are then off by N d more, and H^+ J = -N wherever the data determine. The remainder,
(H^+ J + N) d, is what the others' tolerances overstate, because they do not refer to that frame.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    Response,
    by_defining,
    column_scale,
    directions,
    qr_factor,
)
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism


def as_pose(response: Response) -> Response:
    """Return the response of the same n rows if the whole platform pose were measured (n, 6)."""
    count = len(response.pose)
    return replace(response, end=0, seen=replace(
        response.seen, residual=np.zeros((count, 6)), observed=np.ones((count, 6), dtype=np.bool_),
        by_poses=(np.tile(np.eye(6), (count, 1, 1)),)))


def by_tolerances(response: Response, mechanism: Mechanism) -> Array:
    """Return how n predictions move by one tolerance of each parameter (n, m, F), m and rad.

    For all parameters that may be off, free in a fit or not. Infinite where a tolerance is;
    predictions that a parameter does not move stay at 0.
    """
    free, tolerance = uncertain(mechanism)
    here = response.closure
    whole = replace(response, closed=replace(
        response.closed, closure=here.model.closure(here.q, free)))
    out = np.zeros((*response.seen.residual.shape, len(free)))
    whole.geometry_columns(out, free, slice(len(free), len(free)))
    with np.errstate(invalid="ignore"):
        return np.where(out == 0.0, 0.0, out * tolerance)


def uncertain(mechanism: Mechanism) -> tuple[tuple[int, ...], Array]:
    """Return the parameters that may be off, and their tolerances (F,), SI.

    Infinite for a free parameter without tolerance.
    """
    known = mechanism.parameters
    free = tuple(i for i, p in enumerate(known)
                 if i in mechanism.free or (p.tolerance and not p.fixed))
    return free, np.array([np.inf if known[i].tolerance is None else known[i].tolerance
                           for i in free], dtype=float)


@dataclass(frozen=True, eq=False)
class Considered:
    """Held parameters, SI.

    ``names`` (H,); ``sigma`` (H,) standard uncertainty of each; ``gain`` (C, H): error of each
    fitted column per error of each of them. ``frame`` (C, G) and ``pull`` (C, G): errors of fitted
    columns in the frames that some parameters define, and deviations from nominal, as far as
    tolerances leave these open, one standard deviation.
    """

    names: tuple[str, ...]
    sigma: Array
    gain: Array
    frame: Array | None = None
    pull: Array | None = None

    def more(self, names: Collection[str] | None = None) -> Array:
        """Return the part of the columns' covariance (C, C) due to them, or to ``names`` only."""
        there = [i for i, n in enumerate(self.names) if names is None or n in names]
        own = self.gain[:, there] * self.sigma[there]
        return np.asarray(own @ own.T)

    def in_frames(self, covariance: Array) -> Array:
        """Return a covariance of columns (C, C) plus what tolerances leave open in the frames."""
        return covariance if self.frame is None else covariance + self.frame @ self.frame.T

    def beside(self, covariance: Array) -> Array:
        """Return the covariance of the errors of fitted and held columns (C + H, C + H).

        Args:
            covariance: of the fitted ones by data and prior, if the held ones were exact (C, C).
        """
        across = -self.gain * self.sigma**2
        return np.block([[covariance + self.more(), across], [across.T, np.diag(self.sigma**2)]])


def held(mechanism: Mechanism, free: Sequence[int]) -> tuple[int, ...]:
    """Return the parameters that may be off, by a finite tolerance, and are not fitted.

    Parameters that define the frames of base and platform are exact in these frames.
    """
    return tuple(i for i, tolerance in zip(*uncertain(mechanism), strict=True)
                 if i not in (*free, *mechanism.defining)
                 and np.isfinite(tolerance) and tolerance > 0.0)


def none_considered(fit: Fit) -> Considered:
    """Return the value for a fit that held no parameters that may be off."""
    return Considered((), np.zeros(0), np.zeros((len(fit.problem.columns), 0)))


def considered(fit: Fit) -> Considered:
    """Return the parameters that a fit held, and the errors of its columns due to them.

    Args:
        fit: with its noise.
    """
    mechanism = fit.problem.mechanism
    own, frame = held(mechanism, fit.problem.free), mechanism.defining
    if not own and not frame:
        return none_considered(fit)
    gain, count = _gain(fit, (*own, *frame)), len(own)
    found = Considered(tuple(mechanism.names[p] for p in own), _sigma(mechanism, own),
                       gain[:, :count])
    if not frame:
        return found
    moved = np.zeros((len(gain), len(frame)))
    moved[:len(fit.problem.free)] = by_defining(
        mechanism.with_values(fit.state.g), fit.problem.datasets, fit.problem.free)
    sigma = _sigma(mechanism, frame)
    return replace(found, frame=(gain[:, count:] + moved) * sigma, pull=gain[:, count:] * sigma)


def _sigma(mechanism: Mechanism, own: Sequence[int]) -> Array:
    """Return the standard uncertainty of parameters (H,), 0 without a tolerance."""
    known = [mechanism.parameters[p] for p in own]
    return np.array([p.sigma or p.prior_sigma or 0.0 for p in known], dtype=float)


def _gain(fit: Fit, own: Sequence[int]) -> Array:
    """Return the error of fitted columns per error of held parameters ``own``, SI (C, H)."""
    problem = fit.problem
    wide = problem.changed(free=(*problem.free, *own))
    rows = qr_factor(wide, fit.state, fit.keep).root / fit.noise
    extra = np.arange(len(problem.free), len(wide.free))
    s, vt, seen = directions(fit)
    half = vt[seen].T / s[seen]
    # (H^T H)^-1 H^T J: the prior's rows of H are 0 in the held columns
    fitted = np.delete(rows, extra, axis=1) * fit.scale
    moved = rows[:, extra] * column_scale(wide)[extra]
    gain = half @ (half.T @ (fitted.T @ moved))
    return np.asarray(gain * fit.scale[:, None] / column_scale(wide)[extra])
