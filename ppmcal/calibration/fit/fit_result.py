"""What a fit is: its options, its result, and the covariance that follows from it."""

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
"""How the reason begins for which such a row is left out."""
LIKE_NOISE = 0.05
"""Residuals are no more than the noise where chance gives a larger chi-squared this often."""


@dataclass(frozen=True)
class FitOptions:
    """How to identify.

    ``method``: ``prior``, ``flat`` (no prior), ``gcv`` (prior scale by generalised
    cross-validation) or ``damped`` ([PPM] section 4.5, with ``damping`` its 0.9).
    ``iterations``: at most so many; default 60, of the damped scheme 6000.
    """

    method: str = "prior"
    damping: float = 0.9
    robust: bool = True
    iterations: int | None = None

    @property
    def most(self) -> int:
        """Iterations of Gauss-Newton at most."""
        return self.iterations or ITERATIONS


@dataclass(frozen=True)
class Fit:
    """A converged (or stopped) fit.

    Attributes:
        problem, state: what was fitted and where it ended.
        information: the rows at the end.
        prior: weights 1/tau of the parameter columns, 0 without prior (C,).
        scale: one tolerance, or a unit of comparable effect, per column (C,).
        keep: rows used, by data set.
        iterations, converged: of the loop.
        times: by how many times the noise each row that was left out is off, by data set.
        repeated: of those that were left out because of their repeats, which these are: their times
            are of the scatter of repeats.
        contradicting: rows in use that were read at one place and of which one does not belong,
            nobody knows which: their indices, place by place, by data set.
        noise_factor: robust scale of the residuals over the stated noise, at least 1 (D,).
        prior_scale: factor on the tolerances that generalised cross-validation chose.
        stopped: where a fit was ended on purpose before it had converged, in words.
        noise: the rows at the end are white by this many times the stated noise.
        reasons: why rows were left out, by data set: row index -> reason.
        taken_back: rows that had no pose at the start and have one, and belong, at the end.
        summed: in how many of the iterations the step came from normal equations.
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
        """Whether it is at its minimum, or was stopped where residuals are like noise."""
        return self.converged or (bool(self.stopped) and like_noise(self.information))

    @property
    def reached(self) -> str:
        """How far a fit got that did not converge, in words."""
        rms = (self.information.square / max(self.information.count, 1)) ** 0.5
        return (f"after {pluralize(self.iterations, 'iteration')} residuals were at {rms:.3g} "
                "times the noise and it was still moving")

    @property
    def stated(self) -> Array:
        """The prior's weights (C,) that files of measurements state, 0 for the tolerances."""
        return np.where(np.arange(self.prior.size) < len(self.problem.free), 0.0, self.prior)

    @property
    def by_tolerances(self) -> bool:
        """Whether tolerances of parameters count."""
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
    """Return a fit that has made no step: what rows (N,) see of a machine where it stands.

    ``state``, ``keep``: default the start, and the rows that have a pose there; ``method``,
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
    """Return what files say at the end of a fit as rows |matrix s - right|^2 (k, C), (k,), SI.

    What was measured, and what files say of their own scales: all but the tolerances.
    """
    weight = fit.stated
    rows = np.flatnonzero(weight)
    return (np.concatenate([fit.information.root, np.diag(weight)[rows]]),
            np.concatenate([fit.information.right,
                            (weight * to_prior(fit.problem, fit.state))[rows]]))


def directions(fit: Fit, prior: Array | None = None) -> tuple[Array, Array, Bools]:
    """Return what data and prior know, direction by direction, in natural units.

    Args:
        fit: the fit.
        prior: weights in place of the fit's (C,).

    Returns:
        singular values (r,), directions (r, C), and which of them are seen at all (r,).
    """
    weights = fit.prior if prior is None else prior
    matrix = np.concatenate([fit.information.root * fit.scale, np.diag(weights * fit.scale)])
    _, s, vt = svd(matrix)
    return s, vt, seen_directions(s)


def prediction_root(fit: Fit, slopes: Array, prior: Array | None = None) -> Array:
    """Return R (..., r), R R^T the covariance of slopes (..., C) . columns.

    Args:
        fit: the fit.
        slopes: of what is predicted, by column.
        prior: weights in place of the fit's (C,).

    Returns:
        inf in rows of what moves with a direction that neither data nor prior see.
    """
    s, vt, seen = directions(fit, prior)
    units = slopes * fit.scale
    lost = np.linalg.norm(units @ vt[~seen].T, axis=-1) > 1e-6 * np.linalg.norm(units, axis=-1)
    return np.asarray(np.where(lost[..., None], np.inf, (units @ vt[seen].T) / s[seen]))


def prediction_covariance(fit: Fit) -> Array:
    """Return a covariance (C, C) that is right for predictions of measured rows.

    Noise beyond the stated one is in the rows (:func:`noise.with_noise`), never in the
    prior: a parameter is known at least as well as its tolerance says.
    Null directions do not move what the data saw, so they are left out altogether.
    """
    s, vt, seen = directions(fit)
    v = vt[seen].T / s[seen]
    return np.asarray((v @ v.T) * np.outer(fit.scale, fit.scale), dtype=float)


def values_fitted(seen: int, variance: Array, prior: Array) -> float:
    """Return how many values a fit with a prior takes: the trace of its hat matrix.

    tr J (J'J + P'P)^-1 J' = seen - sum of prior^2 variance: columns that data do not see, or see
    together only, and columns that their prior holds take less than one value each. Residuals of
    n values have a mean square of (n - trace) times the noise's, not of n less the columns.

    Args:
        seen: directions that data or prior see, C where all are.
        variance: of each column by data and prior (C,).
        prior: weight of each column's distance from its nominal (C,), unit of 1/column.
    """
    return float(seen - np.sum(prior**2 * variance))


def values_taken(fit: Fit) -> float:
    """Return how many values a fit took, as :func:`values_fitted` counts them."""
    seen = int(np.sum(directions(fit)[2]))
    return values_fitted(seen, np.diagonal(prediction_covariance(fit)), fit.prior)


def residual_freedom(fit: Fit) -> float:
    """Return the degrees of freedom of the rows' residuals: values less those fitted, at least 1.

    Rows that stand for an earlier fit count as values.
    """
    return max(fit.information.count - values_taken(fit), 1.0)


def posterior(fit: Fit) -> Array:
    """Return the covariance of all columns (C, C), SI; inf on the diagonal where unbounded.

    Columns that take part in a direction seen neither by data nor by prior get an infinite
    variance; their covariances are those within the bounded part.
    """
    _, vt, seen = directions(fit)
    loose = np.sqrt(np.sum(vt[~seen] ** 2, axis=0)) > 1e-6
    out = prediction_covariance(fit)
    out[loose, loose] = np.inf
    return out
