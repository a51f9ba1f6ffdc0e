"""How far sessions of one machine disagree, and how that widens the intervals.

Each session has a machine of its own, theta_s = theta + delta_s: drives are homed again, parts are
warmer, somebody leant on the frame. delta_s has one variance per class of parameters, in units of
their tolerances, and one per class for a growth that all of its parameters share. Given the
variances D, the estimate of the fit to everything, which weights rows by their noise alone, has

    H^-1 (psi^2 sum A_s + sum A_s D A_s + P) H^-1,    H = sum A_s + P,

with A_s the information of session s and P that of the prior. D and the noise within sessions are
drawn from their posterior given the rows, with theta and all frames integrated out (restricted
likelihood), and the uniform shrinkage prior of Daniels (Canad. J. Statist. 27, 1999); intervals
are quantiles of the mixture, so that few sessions give the wide tails of few degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc, expit, logit

from ppmcal import linalg
from ppmcal.calibration.fit import (
    Z95,
    Fit,
    coverage_of,
    half_of_mixture,
    posterior,
    prediction_covariance,
)
from ppmcal.calibration.knowledge.session_clusters import RIDGE, Clusters, Components, components
from ppmcal.errors import LinearAlgebraError
from ppmcal.inference.priors import MOVED, NOISE_FREEDOM, SURE
from ppmcal.inference.row_weights import log_ratio
from ppmcal.linalg import Array, Bools, Ints, reciprocals, svd

SWEEPS, WARM_UP, LEAST_SWEEPS = 600, 0.2, 80
"""Draws of all variances times clusters, the part discarded as warm-up, and minimum of sweeps."""
STEP = 1.3
"""Proposal width for the logarithm of a standard deviation."""
NOTHING = 1e-6
"""Difference of clusters in tolerances that stands for none."""
SMALLEST, APART, NOISES = -3.0, 1.5, 4
"""Grid over which the evidence that clusters differ is summed: log of the smallest size, in noise
of one cluster, step of the log, and number of noise sizes."""
WIDEST = 30.0
"""Sessions differ by at most this many tolerances, or units of comparable effect."""


@dataclass(frozen=True, eq=False)
class SessionVariance:
    """Effect of differing clusters of rows on the uncertainty, SI.

    Attributes:
        labels: of the clusters (S,).
        covariance: of all columns (C, C), disagreement included; frame and target of a single
            cluster are those in which the common machine appears there.
        half: half width of the 95 % interval of every column (C,), inf where unbounded.
        odds: log odds that clusters differ in anything.
        own, own_sigma: each cluster's own estimate of the parameters, with everything else
            fitted, as a step from the common one, and its uncertainty by noise (S, F).
        p_value: of all clusters having one value, by parameter (F,); for information only.
        apart: probability that they differ (F,).
        spread: class of parameters -> difference between clusters, in tolerances (rms).
        sessions: whether clusters are sessions, not blocks of rows.
        coverage: half width of a 95 % interval over ``own_sigma``, noise size integrated out.
    """

    labels: tuple[str, ...]
    covariance: Array
    half: Array
    odds: float
    own: Array
    own_sigma: Array
    p_value: Array
    apart: Array
    spread: dict[str, float]
    sessions: bool = True
    coverage: float = Z95

    @property
    def differ(self) -> bool:
        """Whether clusters more likely differ than not, in anything."""
        return self.odds > 0.0

    @property
    def disagree(self) -> Bools:
        """Parameters (F,) whose values surely differ between the clusters."""
        return np.asarray(self.apart > float(SURE), dtype=bool)


DIFFERENCES = "how far sessions, or stretches of rows, differ"


class _Posterior:
    """The posterior of the variances, with theta and all frames integrated out."""

    def __init__(self, data: Clusters, parts: Components, most: float, widest: float = WIDEST
                 ) -> None:
        self.data, self.parts, self.most, self.widest = data, parts, most, widest
        g = parts.directions
        each = "scm" if g.ndim > 2 else "cm"
        self.cross = np.einsum(f"{each},scd->smd", g, data.matrix)
        self.inner = self.cross @ g
        seen = np.einsum("sc,scm->sm", data.right, g) if g.ndim > 2 else data.right @ g
        self.sides = np.concatenate([self.cross, seen[..., None]], axis=-1)
        self.prior = np.diag(data.prior**2 + RIDGE)
        self.offset = data.prior**2 * data.away
        self.whole = data.matrix.sum(axis=0)
        self.covariance = linalg.inv(self.whole + self.prior, DIFFERENCES)
        if not np.all(np.diagonal(self.covariance) > 0.0):
            raise LinearAlgebraError(f"{DIFFERENCES} could not be had: the tolerances drown in "
                                     "the round-off of the data",
                                     hint="Look for a sigma that is far too small")

    @cached_property
    def shrinkage(self) -> Array:
        """Variances (K,) equal to one session's noise, in units of the tolerances."""
        g = self.parts.directions
        if g.ndim > 2:
            return np.ones(len(self.parts.names))
        one = self.data.count.size * np.einsum("cm,cd,dm->m", g, self.covariance, g)
        one /= np.sum(g**2, axis=0) ** 2
        return np.array([np.median(one[self.parts.member == k])
                         for k in range(len(self.parts.names))])

    def log(self, sizes: Array) -> float:
        """Return the log posterior of log sizes (K,) and, last, of the log noise factor."""
        variance = np.exp(2.0 * sizes[:-1])
        if np.any(variance > self.widest**2) or not 0.0 <= sizes[-1] <= self.most:
            return -np.inf
        prior = variance * self.shrinkage / (self.shrinkage + variance) ** 2
        return self.likelihood(sizes) + float(np.sum(np.log(prior)))

    def likelihood(self, sizes: Array) -> float:
        """Return the restricted log likelihood of log sizes (K,) and the log noise factor."""
        spread, noise = np.exp(sizes[:-1]), float(np.exp(2.0 * sizes[-1]))
        each = spread[self.parts.member]
        inner = each[:, None] * self.inner * each / noise
        inner += np.eye(each.size)
        factor = linalg.cholesky(inner, DIFFERENCES)
        half = linalg.solve(factor, each[:, None] * self.sides) / noise
        half = half.reshape(-1, half.shape[-1])
        gone = half.T @ half
        total = linalg.cholesky(self.whole / noise - gone[:-1, :-1] + self.prior, DIFFERENCES)
        right = self.data.right.sum(axis=0) / noise - gone[:-1, -1] + self.offset
        square = self.data.square.sum() / noise - gone[-1, -1]
        solved = linalg.solve(total, right)
        twice = (square - float(solved @ solved) + self.data.count.sum() * np.log(noise)
                 + 2.0 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum()
                 + 2.0 * np.log(np.diagonal(total)).sum())
        return -0.5 * float(twice)

    @cached_property
    def odds(self) -> float:
        """Log odds that clusters differ, in one class or in all, by any size."""
        k, usual = len(self.parts.names), 0.5 * np.log(self.shrinkage)
        none = np.full(k, np.log(NOTHING))
        widest = np.log(self.widest)
        steps = np.arange(SMALLEST, max(float(np.max(widest - usual)), 2.0 * APART), APART)
        some = [np.where(mine, np.minimum(usual + size, widest), none) for size in steps
                for mine in (*np.eye(k, dtype=bool), np.ones(k, dtype=bool))]
        noise = np.linspace(0.0, self.most, NOISES if self.most else 1)
        there, nothing = (float(linalg.logsumexp([self.likelihood(np.append(s, f)) for s in sizes
                                                  for f in noise])) - np.log(len(sizes))
                          for sizes in (some, [none]))
        return float(logit(float(MOVED)) + there - nothing)

    def draws(self, seed: int) -> Array:
        """Return draws of variances (n, K) and, last, of the squared noise factor."""
        rng = np.random.default_rng(seed)
        at = np.append(0.5 * np.log(self.shrinkage) - 1.0, 0.5 * self.most)
        at[:-1] = np.minimum(at[:-1], np.log(self.widest) - 0.1)
        free = range(at.size - (self.most == 0.0))
        width = np.append(np.full(at.size - 1, STEP), 0.1)
        log, out = self.log(at), []
        sweeps = max(LEAST_SWEEPS, SWEEPS // len(self.data.labels))
        for sweep in range(sweeps):
            for k in free:
                trial = at.copy()
                trial[k] += width[k] * rng.normal()
                new = self.log(trial)
                if np.log(rng.uniform()) < new - log:
                    at, log = trial, new
            if sweep >= WARM_UP * sweeps:
                out.append(at)
        return np.exp(2.0 * np.array(out))


def differs(fit: Fit, data: Clusters, inflation: float = 1.0, parts: Components | None = None,
            widest: float = WIDEST) -> bool:
    """Whether clusters more likely differ than not; a fast version of :func:`session_variance`."""
    return _chances(data, parts or components(fit), inflation, widest).odds > 0.0


def _chances(data: Clusters, parts: Components, inflation: float, widest: float = WIDEST
             ) -> _Posterior:
    """Return the posterior in units of the stated noise, with the estimate unchanged."""
    return _Posterior(data.weighted(inflation**2), parts, float(np.log(inflation)), widest)


def session_variance(fit: Fit, data: Clusters, inflation: float = 1.0, widest: float = WIDEST,
                     seed: int = 0, parts: Components | None = None, alike: bool = False
                     ) -> SessionVariance:
    """Return the effect of differing clusters of rows on the uncertainty of a fit.

    No interval is longer than one that contains all that the tolerance allows.

    Args:
        fit: with rows ``inflation`` times as noisy as stated.
        data: its rows by cluster.
        inflation: upper limit of the noise within clusters, relative to the stated noise.
        widest: maximum difference of clusters in tolerances.
        seed: of the draws.
        parts: in which directions clusters may differ; None: :func:`components`.
        alike: whether sizes of effects are mixed over clusters that differ and others that do not.
    """
    parts = parts or components(fit)
    chances = _chances(data, parts, inflation, widest)
    drawn = chances.draws(seed)
    unit = np.outer(fit.scale, fit.scale)
    known = prediction_covariance(fit) / unit
    directions = np.broadcast_to(parts.directions,
                                 (len(data.labels), *parts.directions.shape[-2:]))
    leaks = np.concatenate([known @ a @ g for a, g in zip(data.matrix, directions, strict=True)],
                           axis=1)
    leaks -= _registered(data, parts, len(fit.problem.free))
    member = np.tile(parts.member, len(data.labels))
    added = [leaks[:, member == k] @ leaks[:, member == k].T for k in range(len(parts.names))]
    # differences between clusters were counted as noise, which is smaller without them
    added.append(known @ data.matrix.sum(axis=0) @ known)
    parts_of = drawn / np.append(np.ones(len(parts.names)), inflation**2)
    parts_of[:, -1] -= 1.0
    variance = np.diagonal(known) + parts_of @ np.array([np.diagonal(b) for b in added])
    own, sigma, square = _each(data, chances.prior, len(fit.problem.free),
                                float(np.median(drawn[:, -1])) / inflation**2)
    apart = _apart(data, square)
    half = half_of_mixture(variance) * fit.scale
    if alike:
        sizes = _effect_columns(fit)
        chance = np.maximum(apart[sizes], expit(chances.odds))
        half[sizes] = _mixed(variance[:, sizes], np.diagonal(known)[sizes], chance
                             ) * fit.scale[sizes]
    allowed = np.abs(data.away) + Z95 * reciprocals(data.prior, np.inf)
    half = np.minimum(half, allowed * fit.scale)
    half[np.isinf(np.diagonal(posterior(fit)))] = np.inf
    # with few sessions the mean of the draws is that of the widest; hence the median
    middle = np.median(parts_of, axis=0)
    covariance = known + sum(m * b for m, b in zip(middle, added, strict=True))
    scale = fit.scale[:own.shape[1]]
    spread = {n: float(np.sqrt(np.median(v))) for n, v in
              zip(parts.names, drawn[:, :-1].T, strict=True)}
    return SessionVariance(data.labels, covariance * unit, half,
                           chances.odds, own * scale, sigma * scale,
                           np.asarray(chdtrc(len(own) - 1, square)), apart, spread,
                           coverage=coverage_of(drawn[:, -1] / np.median(drawn[:, -1])))


def _effect_columns(fit: Fit) -> Ints:
    """Return which columns of a fit are parameters of effects."""
    sizes = {p for e in fit.problem.mechanism.effects for p in e.parameters.values()}
    return np.array([c for c, p in enumerate(fit.problem.free) if p in sizes], dtype=np.int64)


def _mixed(differ: Array, alike: Array, chance: Array) -> Array:
    """Return half of 95 % intervals (c,) where sessions differ by a ``chance`` (c,), or are alike.

    Geometry always is a little another: joints are homed anew. That sessions differ in what stands
    for an effect is a cause beside it, as probable as the data make it: drawn as if it were there,
    by sizes of which few sessions say little, it would make longer what they agree about.

    ``differ``: drawn variances where they do (n, c); ``alike``: by noise alone (c,).
    """
    both = np.concatenate([differ, alike[None, :]])
    count = len(differ)
    return np.array([half_of_mixture(own[:, None], np.append(np.full(count, p / count), 1.0 - p))[0]
                     for own, p in zip(both.T, chance.tolist(), strict=True)]).reshape(-1)


def _registered(data: Clusters, parts: Components, count: int) -> Array:
    """Return the part of a cluster's difference absorbed by its own frames and targets (C, S m).

    The common machine is seen from such a frame on that day: a rigid difference is in the frame,
    and is no error of a command in it.
    """
    size = data.matrix.shape[1]
    seen = np.abs(np.diagonal(data.matrix, axis1=1, axis2=2)) > 0.0
    own = seen & (seen.sum(axis=0) == 1) & (np.arange(size) >= count)
    out = []
    directions = np.broadcast_to(parts.directions, (len(own), *parts.directions.shape[-2:]))
    for a, mine, g in zip(data.matrix, own, directions, strict=True):
        taken = np.zeros(g.shape)
        where = np.flatnonzero(mine)
        block = a[np.ix_(where, where)] + RIDGE * np.eye(where.size)
        taken[where] = linalg.solve(block, a[where] @ g)
        out.append(taken)
    return np.concatenate(out, axis=1)


def _each(data: Clusters, prior: Array, count: int, noise: float) -> tuple[Array, Array, Array]:
    """Return each cluster's own steps and their sigma (S, F), and chi-squared of S - 1 (F,).

    All clusters share the prior, so that it cancels in their differences as far as it is the
    same part of each estimate.
    """
    inverse = linalg.inv(data.matrix + prior)
    own = np.einsum("scd,sd->sc", inverse, data.right + np.diagonal(prior) * data.away)[:, :count]
    by_noise = noise * np.einsum("scd,sde,sec->sc", inverse, data.matrix, inverse)[:, :count]
    pull = np.einsum("scd,de,tec->cst", inverse, prior, inverse)[:count]
    total = pull + np.eye(len(own)) * by_noise.T[:, :, None]
    size = len(own)
    contrast = svd(np.eye(size) - 1.0 / size)[0][:, :size - 1]
    differs = own.T @ contrast
    among = contrast.T @ total @ contrast
    among += np.eye(size - 1) * 1e-12 * np.trace(among, axis1=-2, axis2=-1)[:, None, None]
    square = np.einsum("fa,fa->f", differs, linalg.solve(among, differs[..., None])[..., 0])
    return own, np.sqrt(np.maximum(by_noise, 0.0)), np.asarray(square)


def _apart(data: Clusters, square: Array) -> Array:
    """Return the probability (F,) that clusters differ in each parameter, by chi-squared (F,)."""
    more = log_ratio(np.maximum(square, 0.0), np.full(square.size, len(data.labels) - 1.0),
                     float(NOISE_FREEDOM) + float(data.count.sum()))
    return np.asarray(expit(logit(float(MOVED)) + more))
