"""A fit: its options, its result, and the covariance that follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtrc

from ppmcal.calibration.fit.linearisation import (
    SquareRootInformation,
    column_scale,
    prior_weights,
    qr_factor,
    seen_directions,
    to_prior,
)
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.linalg import Array, Bools, Ints, finite_rows, svd
from ppmcal.notes import topic_of
from ppmcal.wording import pluralize

ITERATIONS = 60
OUTLIER = "outlier"
"""First word of the reason for which an outlier is left out."""
LIKE_NOISE = 0.05
"""Residuals count as noise if chance gives a larger chi-squared at least this often."""


@dataclass(frozen=True)
class FitOptions:
    """How to identify.

    ``method``: ``prior``, ``flat`` (no prior), ``gcv`` (prior scale by generalised
    cross-validation) or ``damped`` ([PPM] section 4.5, with ``damping`` its 0.9).
    ``iterations``: at most this many; default 60, for the damped scheme 6000.
    """

    method: str = "prior"
    damping: float = 0.9
    robust: bool = True
    iterations: int | None = None

    @property
    def most(self) -> int:
        """Maximum number of Gauss-Newton iterations."""
        return self.iterations or ITERATIONS


@dataclass(frozen=True)
class Fit:
    """A converged (or stopped) fit.

    Attributes:
        problem, state: what was fitted and where it ended.
        information: the reduced rows at the end.
        prior: weights 1/tau of the parameter columns, 0 without prior (C,).
        scale: one tolerance, or a unit of comparable effect, per column (C,).
        keep: rows used, by data set.
        iterations, converged: of the loop.
        times: residual over noise of each row that was left out, by data set.
        repeated: repeats of those left out because they disagree with their repeats; their
            ``times`` are relative to the scatter of repeats.
        contradicting: rows in use that were read at one place, one of which is wrong but
            cannot be told from the others: their indices, place by place, by data set.
        noise_factor: robust scale of the residuals over the stated noise, at least 1 (D,).
        prior_scale: factor on the tolerances chosen by generalised cross-validation.
        stopped: why a fit was ended on purpose before it converged, in words.
        noise: the rows at the end are whitened by this many times the stated noise.
        reasons: why rows were left out, by data set: row index -> reason.
        taken_back: number of rows without a pose at the start that are in use at the end.
        summed: number of iterations whose step came from normal equations.
    """

    problem: Problem
    state: State
    information: SquareRootInformation
    prior: Array
    scale: Array
    keep: tuple[Bools, ...]
    iterations: int
    converged: bool
    noise_factor: Array = field(default_factory=lambda: np.ones(1))
    times: tuple[dict[int, float], ...] = ()
    repeated: tuple[dict[int, Ints], ...] = ()
    contradicting: tuple[tuple[Ints, ...], ...] = ()
    prior_scale: float = 1.0
    stopped: str = ""
    noise: float = 1.0
    reasons: tuple[dict[int, str], ...] = ()
    taken_back: int = 0
    summed: int = 0

    def __post_init__(self) -> None:
        each = np.broadcast_to(self.noise_factor, len(self.problem.datasets))
        object.__setattr__(self, "noise_factor", each)

    @property
    def ended(self) -> bool:
        """Whether it converged, or was stopped with residuals like noise."""
        return self.converged or (bool(self.stopped) and like_noise(self.information))

    @property
    def reached(self) -> str:
        """How far a fit got that did not converge, in words."""
        rms = (self.information.square / max(self.information.count, 1)) ** 0.5
        return (f"after {pluralize(self.iterations, 'iteration')} residuals were at {rms:.3g} "
                "times the noise and it was still moving")

    @property
    def stated(self) -> Array:
        """The prior weights (C,) stated by measurement files, 0 for the tolerances."""
        return np.where(np.arange(self.prior.size) < len(self.problem.free), 0.0, self.prior)

    @property
    def by_tolerances(self) -> bool:
        """Whether parameter tolerances enter."""
        return bool(self.prior[:len(self.problem.free)].any())

    @property
    def outliers(self) -> list[Bools]:
        """Which rows with a pose were left out as outliers, by data set (N,)."""
        out = []
        for pose, keep, reasons in zip(self.state.poses, self.keep, self.reasons, strict=True):
            mask = np.zeros_like(keep)
            mask[[n for n, reason in reasons.items() if topic_of(reason) == OUTLIER]] = True
            out.append(mask & finite_rows(pose) & ~keep)
        return out


def unfitted(problem: Problem, state: State | None = None, keep: Sequence[Bools] = (),
             method: str = "prior", scale: float = 1.0) -> Fit:
    """Return a fit without any step: the information in rows (N,) about a machine as it stands.

    ``state``, ``keep``: by default the start, and the rows that have a pose there; ``method``,
    ``scale``: of the prior.
    """
    state = state or problem.start()
    keep = tuple(keep) or tuple(finite_rows(p) for p in state.poses)
    return Fit(problem, state, qr_factor(problem, state, keep),
               prior_weights(problem, method, scale), column_scale(problem), keep, 0, False)


def like_noise(rows: SquareRootInformation) -> bool:
    """Return whether residuals are no more than the noise (Morozov's discrepancy principle)."""
    return bool(chdtrc(rows.count, rows.square) > LIKE_NOISE)


def data_rows(fit: Fit) -> tuple[Array, Array]:
    """Return what files state at the end of a fit as rows |matrix s - right|^2 (k, C), (k,), SI.

    The measurements and the files' own scales: everything but the tolerances.
    """
    weight = fit.stated
    rows = np.flatnonzero(weight)
    return (np.concatenate([fit.information.root, np.diag(weight)[rows]]),
            np.concatenate([fit.information.right,
                            (weight * to_prior(fit.problem, fit.state))[rows]]))


def directions(fit: Fit, prior: Array | None = None) -> tuple[Array, Array, Bools]:
    """Return the information of data and prior, direction by direction, in natural units.

    Args:
        fit: the fit.
        prior: weights to use instead of the fit's (C,).

    Returns:
        singular values (r,), directions (r, C), and whether each is seen at all (r,).
    """
    weights = fit.prior if prior is None else prior
    matrix = np.concatenate([fit.information.root * fit.scale, np.diag(weights * fit.scale)])
    _, s, vt = svd(matrix)
    return s, vt, seen_directions(s)


def prediction_root(fit: Fit, slopes: Array, prior: Array | None = None) -> Array:
    """Return R (..., r), where R R^T is the covariance of slopes (..., C) . columns.

    Args:
        fit: the fit.
        slopes: of the prediction, by column.
        prior: weights to use instead of the fit's (C,).

    Returns:
        inf in rows that move with a direction that neither data nor prior see.
    """
    s, vt, seen = directions(fit, prior)
    units = slopes * fit.scale
    lost = np.linalg.norm(units @ vt[~seen].T, axis=-1) > 1e-6 * np.linalg.norm(units, axis=-1)
    return np.asarray(np.where(lost[..., None], np.inf, (units @ vt[seen].T) / s[seen]))


def prediction_covariance(fit: Fit) -> Array:
    """Return a covariance (C, C) that is valid for predictions of measured rows.

    Noise beyond the stated noise is in the rows (:func:`noise_estimate.with_noise`), never in the
    prior: a parameter is known at least as well as its tolerance says.
    Null directions do not move anything that was measured, so they are left out.
    """
    s, vt, seen = directions(fit)
    v = vt[seen].T / s[seen]
    return np.asarray((v @ v.T) * np.outer(fit.scale, fit.scale), dtype=float)


def values_fitted(seen: int, variance: Array, prior: Array) -> float:
    """Return the number of values absorbed by a fit with a prior: the trace of its hat matrix.

    tr J (J'J + P'P)^-1 J' = seen - sum of prior^2 variance: columns that data do not see, or see
    only in combination, or that their prior holds, absorb less than one value each. Residuals of
    n values have a mean square of (n - trace)/n times the noise variance, not (n - columns)/n.

    Args:
        seen: directions seen by data or prior, C if all are.
        variance: of each column given data and prior (C,).
        prior: weight of each column's distance from its nominal (C,), unit of 1/column.
    """
    return float(seen - np.sum(prior**2 * variance))


def values_taken(fit: Fit) -> float:
    """Return the number of values that a fit absorbed, see :func:`values_fitted`."""
    seen = int(np.sum(directions(fit)[2]))
    return values_fitted(seen, np.diagonal(prediction_covariance(fit)), fit.prior)


def residual_freedom(fit: Fit) -> float:
    """Return the degrees of freedom of the rows' residuals: values less those fitted, at least 1.

    Rows that stand for an earlier fit count as values too.
    """
    return max(fit.information.count - values_taken(fit), 1.0)


def posterior(fit: Fit) -> Array:
    """Return the covariance of all columns (C, C), SI; inf on the diagonal where unbounded.

    Columns that take part in a direction seen by neither data nor prior get an infinite
    variance; their covariances are those within the bounded part.
    """
    _, vt, seen = directions(fit)
    loose = np.sqrt(np.sum(vt[~seen] ** 2, axis=0)) > 1e-6
    out = prediction_covariance(fit)
    out[loose, loose] = np.inf
    return out
