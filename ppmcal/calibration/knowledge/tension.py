"""Do the files of different instruments belong to one machine? Noise estimates hide it if not.

A disagreement of heights and distances stays in the residuals of a fit to both, and an estimate
takes it for the noise of both. The noise of each instrument shows in a fit to it alone: with this
noise, the chi-squared of the common fit exceeds the sum of those alone by no more than noise
explains, if both are of one machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logit

from ppmcal import linalg
from ppmcal.calibration.fit import (
    LEAST,
    Fit,
    coverage_by,
    known_part,
    noise_quantity,
    typical_noise,
)
from ppmcal.calibration.knowledge.session_clusters import RIDGE, Clusters, unit_rows
from ppmcal.inference.priors import UNKNOWN
from ppmcal.inference.row_weights import log_ratio
from ppmcal.linalg import Array, eigh, reciprocals
from ppmcal.model.dataset import Dataset
from ppmcal.notes import Note

MOST_ROWS = 200
"""With at most this many rows, each is left out in turn."""


@dataclass(frozen=True)
class PulledApart:
    """How far instruments disagree.

    ``probability``: that they measured different machines; ``noise``: of each alone over the
    stated noise (S,), from so many ``degrees`` of freedom (S,).
    """

    probability: float
    noise: Array
    degrees: Array

    @property
    def likely(self) -> bool:
        """Whether they disagree more likely than not."""
        return self.probability > 0.5


def pulled_apart(fit: Fit, stated: Sequence[Dataset]) -> list[Note]:
    """Return a note if instruments disagree about the machine by more than their noise.

    Args:
        fit: with the estimated noise.
        stated: the file of each of its data sets, with the stated noise.
    """
    if not any(d.estimated for d in stated):
        return []    # the noise check reports it
    kinds = list(dict.fromkeys(d.kind for d, k in zip(stated, fit.keep, strict=True) if k.any()))
    if len(kinds) < 2:
        return []
    names = [" and ".join(dict.fromkeys(d.name for d, k in zip(stated, fit.keep, strict=True)
                                        if d.kind == kind and k.any())) for kind in kinds]
    factor = [typical_noise(now) / typical_noise(was) for now, was in
              zip(fit.problem.datasets, stated, strict=True)]
    apart = Clusters.nothing(fit, names)
    rows = [(kinds.index(stated[i].kind), i, int(n), own * factor[i], int(m))
            for i, block in unit_rows(replace(fit, noise=1.0))
            for n, own, m in zip(block.index, block.rows, block.values, strict=True)]
    for s, _, _, own, values in rows:
        apart.add(s, own, values)
    found = split(apart)
    return [Note(_sentence(fit, apart, found) + _worst_row(fit, apart, rows),
                 topic="instruments")] if found.likely else []


def split(data: Clusters) -> PulledApart:
    """Return whether instruments disagree.

    Args:
        data: rows of at least two, by instrument, white by the stated noise, linearised at one
            machine.
    """
    alone = [_left(data, [s]) for s in range(len(data.labels))]
    freedom = np.array([LEAST + degrees for _, degrees in alone])
    variance = np.array([LEAST + chi2 for chi2, _ in alone]) / freedom
    chi2, degrees = _left(data.weighted(1.0 / variance), list(range(len(alone))))
    degrees -= sum(d for _, d in alone)
    excess = chi2 - sum(c / v for (c, _), v in zip(alone, variance, strict=True))
    more = log_ratio(np.array([max(excess, 0.0)]), np.array([degrees]), float(freedom.sum()))[0] \
        if degrees > 0 else -np.inf
    return PulledApart(float(expit(logit(float(UNKNOWN)) + more)), np.sqrt(variance), freedom)


def _left(data: Clusters, some: Sequence[int]) -> tuple[float, float]:
    """Return chi-squared of what no error of the machine explains, and its degrees of freedom."""
    size, turn = eigh(data.matrix[some].sum(axis=0))
    size = np.sqrt(np.maximum(size, 0.0))
    explained, taken = known_part(size[:, None] * turn.T, reciprocals(size) * (
        turn.T @ data.right[some].sum(axis=0)), data.prior)
    return (max(float(data.square[some].sum()) - explained, 0.0),
            float(data.count[some].sum()) - taken)


def _worst_row(fit: Fit, data: Clusters, rows: Sequence[tuple[int, int, int, Array, int]]) -> str:
    """Return without which row the instruments agree best, if they do.

    ``rows``: instrument, data set, index, white values and number of values.
    """
    without = []
    for s, _, _, own, values in rows if len(rows) <= MOST_ROWS else ():
        data.add(s, own, values, -1.0)
        without.append(split(data))
        data.add(s, own, values)
    best = min(range(len(without)), key=lambda n: without[n].probability, default=None)
    if best is None or without[best].likely:
        return ("; no single row explains it: one of them is off, or the model lacks "
                "something")
    _, i, n, _, _ = rows[best]
    out = fit.problem.datasets[i]
    return (f"; they agree best without {out.name} row {int(out.rows[n])} (probability "
            f"{without[best].probability:.2g}): measure it again")


def _sentence(fit: Fit, data: Clusters, found: PulledApart) -> str:
    """Return the contradiction between instruments, in units of the file."""
    each = ", ".join(f"{n} {s:.3g}" for n, s in zip(data.labels, found.noise.tolist(),
                                                    strict=True))
    out = (f"{' and '.join(data.labels)} disagree (probability {found.probability:.2g}): alone "
           f"their noise is {each} times the stated noise, and together it is more")
    count, own = len(fit.problem.free), data.weighted(found.noise**-2)
    inverse = linalg.inv(own.matrix + np.diag(data.prior**2 + RIDGE))
    step = np.einsum("scd,sd->sc", inverse, own.right + data.prior**2 * data.away)[:, :count]
    sigma = np.sqrt(np.diagonal(inverse, axis1=1, axis2=2)[:, :count])
    worst = int(np.argmax(np.ptp(step, axis=0) / np.linalg.norm(sigma, axis=0)))
    place = fit.problem.free[worst]
    parameter, units = fit.problem.mechanism.parameters[place], fit.problem.mechanism.units
    factor, unit = units.factor(parameter.quantity), units.name(parameter.quantity)
    value, scale = float(fit.state.g[place]), float(fit.scale[worst])
    return out + "; " + ", ".join(
        f"{n} alone {'say' if k else f'say {parameter.name}'} "
        f"{(value + scale * v) / factor:.6g} +- {coverage_by(f) * scale * d / factor:.2g} {unit}"
        for k, (n, v, d, f) in enumerate(zip(data.labels, step[:, worst].tolist(),
                                             sigma[:, worst].tolist(), found.degrees.tolist(),
                                             strict=True)))


# --- is it noise, or a misfit taken for noise? ----------------------------------------------------
#
# An estimate takes any residual for noise, even measurements of another machine. If it exceeds what
# the tolerances do to the readings, the rows carry no information about the machine.

def noise_beyond_tolerances(fit: Fit, which: Sequence[bool]) -> list[Note]:
    """Return a note for each data set whose estimated noise hides the effect of all tolerances.

    Args:
        fit: with the estimated noise; without tolerances there is nothing to compare.
        which: data sets whose noise is estimated (D,).
    """
    out = []
    for i, data in enumerate(fit.problem.datasets):
        if not which[i] or not fit.keep[i].any():
            continue
        moved = _moved(fit, i)
        noise = typical_noise(data)
        if not 0.0 < moved < 1.0 or not np.isfinite(noise):
            continue
        of = noise_quantity(data)
        unit, factor = data.units.name(of), data.units.factor(of)
        out.append(
            Note(f"{data.name}: the residuals, {noise / factor:.3g} {unit}, are taken for noise, "
                 "but exceed what this machine's tolerances do to the readings "
                 f"({moved * noise / factor:.3g} {unit}): these rows carry no information about "
                 "the machine; check that they are of it, their columns, and the tolerances",
                 topic="noise"))
    return out


def _moved(fit: Fit, i: int) -> float:
    """Return how far tolerances move the readings of a data set over their noise, the median."""
    held = fit.prior[:len(fit.problem.free)] > 0.0
    if not held.any():
        return 0.0
    tau = reciprocals(fit.prior[:held.size])
    each: list[Array] = []
    for rows in fit.problem.rows_of(i, fit.state, True, fit.keep[i]):
        spread = np.linalg.norm(rows.jacobian[..., :held.size] * tau, axis=-1)
        each.append(spread[rows.observed])
    values = np.concatenate(each) if each else np.zeros(0)
    return float(np.median(values)) if values.size else 0.0
