"""Do files of different instruments tell of one machine? Estimated noise hides it if they do not.

What heights and distances disagree about is left over where both are fitted, and an estimate takes
it for the noise of both. Each instrument alone shows what its own noise is: with that, the
chi-squared of the common fit exceeds the sum of those alone by no more than chance allows, if one
machine is behind both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from ppmcal.calibration.fit import (
    LEAST,
    Fit,
    NormalStep,
    coverage_by,
    known_part,
    seen_directions,
    to_prior,
    typical_noise,
)
from ppmcal.linalg import Array, svd
from ppmcal.model.dataset import Dataset

CHANCE = 0.01
"""Instruments pull apart below this p-value."""
DRAWS = 200
"""Of the noises, over which the probability is integrated."""
MOST_ROWS = 200
"""Each row in turn is left out of no more than so many."""


@dataclass(frozen=True)
class InstrumentRows:
    """The white rows of one kind of instrument, by the noise that its files stated.

    ``names``: of its data sets; ``rows``: Jacobian in natural units and the residual (n, C + 1);
    ``source``: data set and row behind each (n, 2).
    """

    names: tuple[str, ...]
    rows: Array
    source: Array

    def without(self, source: Array) -> InstrumentRows:
        """Return it without the values of one row (2,)."""
        stay = (self.source != source).any(axis=1)
        return InstrumentRows(self.names, self.rows[stay], self.source[stay])


@dataclass(frozen=True)
class PulledApart:
    """How instruments pull apart.

    ``p_value``: chance of as much if one machine is behind all; ``noise``: of each alone over the
    stated one, from so many ``degrees`` of freedom; ``row``: data set and row without which they
    agree best, None where they never do; ``without``: the chance then.
    """

    p_value: float
    noise: tuple[float, ...]
    degrees: tuple[float, ...]
    row: tuple[int, int] | None = None
    without: float = 0.0


def pulled_apart(fit: Fit, stated: Sequence[Dataset]) -> list[str]:
    """Return a sentence where instruments tell of different machines by more than their noise.

    Args:
        fit: with the noise as it was estimated.
        stated: its data sets with the noise as their files state it.
    """
    if not any(d.estimated for d in stated):
        return []    # the check of the noise tells it
    instruments = _instruments(fit, [typical_noise(now) / typical_noise(was) for now, was in
                                     zip(fit.problem.datasets, stated, strict=True)])
    if len(instruments) < 2:
        return []
    held = fit.prior * fit.scale
    found = split(instruments, held)
    if not found.p_value < CHANCE:
        return []
    found = _explained(instruments, held, found)
    return [_sentence(fit, instruments, found)]


def split(instruments: Sequence[InstrumentRows], held: Array, draws: int = DRAWS) -> PulledApart:
    """Return whether instruments pull apart.

    Args:
        instruments: at least two, linearised at one machine.
        held: weight of each column's distance from its nominal, natural units (C,).
        draws: of the noises.
    """
    alone = [_left(i.rows, held) for i in instruments]
    freedom = np.array([LEAST + degrees for _, degrees in alone])
    own = LEAST + np.array([chi2 for chi2, _ in alone])
    noise = np.sqrt(own / freedom)
    degrees = _left(_stacked(instruments, noise), held)[1] - sum(d for _, d in alone)
    if degrees <= 0:
        return PulledApart(1.0, tuple(noise.tolist()), tuple(freedom.tolist()))
    drawn = np.sqrt(own / np.random.default_rng(0).chisquare(freedom, (draws, own.size)))
    excess = [_left(_stacked(instruments, s), held)[0] - sum(
        chi2 / f**2 for (chi2, _), f in zip(alone, s, strict=True)) for s in drawn]
    p_value = float(np.mean(chdtrc(degrees, np.maximum(excess, 0.0))))
    return PulledApart(p_value, tuple(noise.tolist()), tuple(freedom.tolist()))


def _instruments(fit: Fit, factor: Sequence[float]) -> list[InstrumentRows]:
    """Return the rows in use by kind of instrument, white by the noise that was stated.

    Args:
        fit: with the noise as it was estimated.
        factor: by what the stated noise of each data set was multiplied (D,).
    """
    rows: dict[str, list[Array]] = {}
    source: dict[str, list[Array]] = {}
    names: dict[str, dict[str, None]] = {}
    for part in fit.problem.rows(fit.state, True, fit.keep):
        data = fit.problem.datasets[part.dataset]
        seen = part.observed
        white = np.concatenate([part.jacobian * fit.scale, part.residual[..., None]], axis=-1)
        rows.setdefault(data.kind, []).append(white[seen] * factor[part.dataset])
        index = np.broadcast_to(part.index[:, None], seen.shape)[seen]
        source.setdefault(data.kind, []).append(
            np.stack([np.full(index.size, part.dataset), index], axis=1))
        names.setdefault(data.kind, {})[data.name] = None
    return [InstrumentRows(tuple(names[k]), np.concatenate(rows[k]), np.concatenate(source[k]))
            for k in rows]


def _stacked(instruments: Sequence[InstrumentRows], noise: Sequence[float] | Array) -> Array:
    return np.concatenate([i.rows / s for i, s in zip(instruments, noise, strict=True)])


def _left(rows: Array, held: Array) -> tuple[float, int]:
    """Return chi-squared of what no error of the machine explains, and its degrees of freedom."""
    explained, taken = known_part(rows[:, :-1], rows[:, -1], held)
    return max(float(rows[:, -1] @ rows[:, -1]) - explained, 0.0), len(rows) - taken


def _explained(instruments: Sequence[InstrumentRows], held: Array, found: PulledApart
               ) -> PulledApart:
    """Return the split with the row without which the instruments agree best, where they do."""
    source = np.unique(np.concatenate([i.source for i in instruments]), axis=0)
    if len(source) > MOST_ROWS:
        return found
    chance = [split([i.without(n) for i in instruments], held, DRAWS // 4).p_value
              for n in source]
    best = int(np.argmax(chance))
    if chance[best] < CHANCE:
        return found
    return replace(found, row=(int(source[best][0]), int(source[best][1])), without=chance[best])


def _sentence(fit: Fit, instruments: Sequence[InstrumentRows], found: PulledApart) -> str:
    """Return what instruments say against each other, in units of the file."""
    names = [" and ".join(i.names) for i in instruments]
    values, sigma = zip(*(_alone(i.rows / s, fit) for i, s in
                          zip(instruments, found.noise, strict=True)), strict=True)
    out = (f"{' and '.join(names)} pull apart (p = {found.p_value:.2g}): each alone shows "
           + ", ".join(f"{n} {s:.3g}" for n, s in zip(names, found.noise, strict=True))
           + " times the stated noise, and together they show more")
    worst = _farthest(np.array(values), np.array(sigma))
    if worst is not None:
        out += "; " + ", ".join(
            f"{n} alone {'say' if k else 'say ' + _name(fit, worst)} "
            + _value(fit, worst, float(v[worst]), coverage_by(f) * float(d[worst]))
            for k, (n, v, d, f) in enumerate(zip(names, values, sigma, found.degrees,
                                                 strict=True)))
    if found.row is None:
        return (out + "; no single row explains it: one of them is off, or something is missing "
                "in the model")
    data = fit.problem.datasets[found.row[0]]
    return (out + f"; they agree best without {data.name} row {int(data.rows[found.row[1]])} "
            f"(p = {found.without:.2g}): measure it again")


def _name(fit: Fit, column: int) -> str:
    """Return the name of a free parameter."""
    return fit.problem.mechanism.names[fit.problem.free[column]]


def _value(fit: Fit, column: int, step: float, half: float) -> str:
    """Return a parameter's value and 95 % interval, a step of SI from the fit's, file units."""
    place = fit.problem.free[column]
    parameter, units = fit.problem.mechanism.parameters[place], fit.problem.mechanism.units
    factor = units.factor(parameter.quantity)
    return (f"{(float(fit.state.g[place]) + step) / factor:.6g} +- {half / factor:.2g} "
            f"{units.name(parameter.quantity)}")


def _alone(rows: Array, fit: Fit) -> tuple[Array, Array]:
    """Return what white rows and tolerances say of the parameters: steps and sigma (F,), SI."""
    count = len(fit.problem.free)
    u, s, vt = svd(np.concatenate([rows[:, :-1], np.diag(fit.prior * fit.scale)]))
    right = u.T @ np.concatenate([rows[:, -1], fit.prior * to_prior(fit.problem, fit.state)])
    whole = NormalStep(s, right, vt, fit.scale)
    sigma = np.sqrt(whole.seen()[1])
    sigma[np.linalg.norm(vt[~seen_directions(s)], axis=0) > 1e-6] = np.inf
    return whole.step()[0][:count], sigma[:count]


def _farthest(values: Array, sigma: Array) -> int | None:
    """Return the parameter about which two instruments (K, F) differ most, None without one."""
    lowest, highest = values.argmin(axis=0), values.argmax(axis=0)
    column = np.arange(values.shape[1])
    both = np.hypot(sigma[lowest, column], sigma[highest, column])
    known = np.isfinite(both) & (both > 0.0)
    if not known.any():
        return None
    ratio = np.where(known, np.ptp(values, axis=0) / np.where(known, both, 1.0), 0.0)
    return int(np.argmax(ratio))
