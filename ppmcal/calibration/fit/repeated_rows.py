"""Rows judged by their repeats: readings that were taken again at one place.

For joint values alone noise has two levels: each place has its own error, from limbs that pull
against each other there and from errors of the model, and each reading has its scatter. Against
both together a reading far off its repeats may be hardly off at all. With r_i the closure
residual of row i of a place, white by the scatter of repeats,

    r_i = o + e_i,    o ~ N(0, 1 / rho),    e_i ~ N(0, 1), or a gross error of any size

so that given the others, of weights w, it is N(sum w_j r_j / W, 1 + 1 / W), with W = rho + sum w_j.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.inference.priors import NO_WEIGHT
from ppmcal.inference.row_weights import improbability, row_weights
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.repeats import repeats
from ppmcal.model.same_rows import step_of

ENOUGH_REPEATS = 30
"""Degrees of freedom of repeats from which they, not the stated sigma, define the noise."""
SWEEPS = 30
"""Maximum number of alternations between row weights and noise."""
STARTS = 24
"""Readings of one place tried as its true value, evenly spread; more of them would hardly differ
from their neighbours."""
BELONGS = 0.5
"""A place is consistent if each of its readings is likelier to belong than not."""
NO_PLACES = 1e-9
"""Variance of places over that of readings if rows scatter no more than repeats."""
ALIKE = 1e-3
"""Weights of readings that agree within this are the same solution."""


@dataclass(frozen=True, eq=False)
class RepeatedRows:
    """The judgement of a data set's rows by repeats: ``weight`` (N,), 1 for rows without any.

    ``times`` (N,): deviation of each from the others of its place in units of the scatter of
    repeats, nan without any; ``place`` (N,): a label per place. ``unsure`` (N,): one of the
    readings of its place does not belong, this one or another.
    """

    weight: Array
    times: Array
    place: Ints
    unsure: Bools


def repeats_scatter(fit: Fit, n: int, places: Ints) -> tuple[float, float] | None:
    """Return the scatter of readings at one place over their noise, and its degrees of freedom.

    A reading that does not belong does not make others noisy. None if there are too few.

    Args:
        fit: with the rows that it uses, and those that it left out as outliers.
        n: number of the data set.
        places: a label per place (N,).
    """
    index, white = _white(fit, n, fit.keep[n] | fit.outliers[n])
    if not index.size:
        return None
    _, place, count = np.unique(places[index], return_inverse=True, return_counts=True)
    mean = np.zeros((count.size, white.shape[1]))
    np.add.at(mean, place, white / count[place][:, None])
    part = (1.0 - 1.0 / count)[place] * white.shape[1]
    again = part > 0.0
    square, part = np.sum((white - mean[place]) ** 2, axis=1)[again], part[again]
    if part.sum() < ENOUGH_REPEATS:
        return None
    weight, ratio = np.ones(part.size), 1.0
    for _ in range(SWEEPS):
        ratio = float(np.sqrt(weight @ square / (weight @ part)))
        if ratio == 0.0:
            break
        weight = row_weights(square / ratio**2, part, float(part.sum()), int(weight.sum()))
    return ratio, float(part.sum())


def _white(fit: Fit, n: int, rows: Bools) -> tuple[Ints, Array]:
    """Return which of some rows (N,) have a pose, and their white residuals (n, m), unweighted."""
    parts = list(fit.problem.weighted(None).rows_of(n, fit.state, False, rows))
    return (np.concatenate([p.index for p in parts]) if parts else np.zeros(0, dtype=np.int64),
            np.concatenate([p.residual for p in parts]) if parts else np.zeros((0, 1)))


def by_repeats(fit: Fit, rows: Sequence[Bools], factor: Array) -> list[RepeatedRows]:
    """Return the judgement of each data set's rows by repeats.

    Args:
        fit: with the current row weights.
        rows: which are judged (N,), by data set.
        factor: noise of places and readings together, over the stated noise (D,).
    """
    return [_of_data(fit, n, own, float(f)) for n, (own, f) in
            enumerate(zip(rows, factor, strict=True))]


def _of_data(fit: Fit, n: int, rows: Bools, factor: float) -> RepeatedRows:
    data = fit.problem.datasets[n]
    same = repeats(data) if data.kind.blind else np.arange(len(data))
    out = RepeatedRows(np.ones(len(data)), np.full(len(data), np.nan), same,
                       np.zeros(len(data), dtype=bool))
    found = repeats_scatter(fit, n, same) if data.kind.blind else None
    if found is None:
        return out
    noise = max(found[0], _digits(data, fit.problem.sigma_joints[n]))
    if noise == 0.0:
        return out
    rho = noise**2 / max(factor**2 - noise**2, NO_PLACES * noise**2)
    index, white = _white(fit, n, rows & finite_rows(fit.state.poses[n]))
    known = _Known(found[1], int(fit.keep[n].sum()), fit.problem.mechanism.surplus, rho)
    out.weight[index], out.times[index], out.unsure[index] = known.weights(
        white / noise, same[index])
    return out


def _digits(data: Dataset, sigma: Array) -> float:
    """Return the noise due to the resolution of joint values (k,), over their noise; 0 for none.

    Readings that agree in every digit do not scatter, but are no better than their last digit.
    """
    steps = np.array([step_of(column) for column in data.q.T])
    return float(np.max(np.where(np.isfinite(steps), steps, 0.0) / np.sqrt(12.0)
                        / np.maximum(sigma, 1e-300), initial=0.0))


@dataclass(frozen=True)
class _Known:
    """What is known about readings.

    ``freedom``: degrees of freedom of their scatter; ``belong``: number that belong; ``values``
    in each; ``rho``: variance of readings over that of places.
    """

    freedom: float
    belong: int
    values: int
    rho: float

    def weights(self, white: Array, places: Ints) -> tuple[Array, Array, Bools]:
        """Return weights of readings (n, m) and their deviations (n,); 1 and nan for single ones.

        Also which are unsure (n,).

        Args:
            white: readings in units of their scatter.
            places: a label per place (n,).
        """
        _, place, count = np.unique(places, return_inverse=True, return_counts=True)
        again = np.flatnonzero(count[place] > 1)
        total = np.zeros((count.size, white.shape[1]))
        np.add.at(total, place, white)
        weight, square = np.ones(len(white)), np.full(len(white), np.nan)
        unsure = np.zeros(len(white), dtype=bool)
        square[again] = self._far(white[again], total[place[again]] - white[again],
                                  np.asarray(self.rho + count[place[again]] - 1.0, dtype=float))
        weight[again] = self._belongs(square[again])
        # most places are consistent
        for doubtful in np.unique(place[weight < BELONGS]).tolist():
            own = np.flatnonzero(place == doubtful)
            weight[own], square[own], unsure[own] = self._of_modes(white[own])
        return weight, np.sqrt(square / self.values), unsure

    def _of_modes(self, white: Array) -> tuple[Array, Array, Bools]:
        """Return the same for readings that contradict each other: any may be the true value.

        Each mode is as probable as all readings are under it.
        """
        starts = np.unique(np.linspace(0, len(white) - 1, min(STARTS, len(white))).astype(int))
        modes = list[tuple[Array, Array]]()
        for start in starts.tolist():
            weight = self._belongs(0.5 * np.sum((white - white[start]) ** 2, axis=1))
            for _ in range(SWEEPS):
                square, before = self._by_others(white, weight), weight
                weight = self._belongs(square)
                if np.abs(weight - before).max() < ALIKE:
                    break
            if not any(np.abs(weight - w).max() < BELONGS for w, _ in modes):
                modes.append((weight, square))
        chance = softmax([self._log_probability(white, w) for w, _ in modes])
        best, each = modes[int(np.argmax(chance))][1], np.array([w for w, _ in modes])
        weight, least = np.asarray(chance @ each), float(NO_WEIGHT)
        unsure = (each < least).any(axis=0) & (weight >= least) & (weight <= 1.0 - least)
        return weight, best, unsure

    def _by_others(self, white: Array, weight: Array) -> Array:
        """Return squared distances (n,) from the weighted mean of the other readings."""
        return self._far(white, weight @ white - weight[:, None] * white,
                         self.rho + weight.sum() - weight)

    def _far(self, white: Array, others: Array, weight: Array) -> Array:
        """Return the same from sums of others (n, m) and their ``weight`` (n,) with the place's."""
        middle = others / weight[:, None]
        return np.asarray(np.sum((white - middle) ** 2, axis=1) / (1.0 + 1.0 / weight))

    def _belongs(self, square: Array) -> Array:
        return row_weights(square, np.full(square.size, float(self.values)), self.freedom,
                           self.belong)

    def _log_probability(self, white: Array, weight: Array) -> float:
        """Return the log probability of all readings given these weights, up to a constant.

        Laplace's approximation to the integral over the place's error.
        """
        others = self.rho + weight.sum()
        middle = weight @ white / others
        far = np.sum((white - middle) ** 2, axis=1)
        lost = improbability(far, np.full(far.size, float(self.values))).sum()
        return float(-0.5 * (self.rho * (middle @ middle) + lost
                             + self.values * np.log(others)))
