"""Two calibrations of one machine: what has changed, and what only looks so.

With the data of the old one as rows |R s - r|^2 (:mod:`posterior`) and the new posterior
N(s, C), the rows' misfit e = r - R s has covariance I + R C R^T if nothing changed: one
chi-squared for all parameters together, whatever they trade among each other. A change d of
parameter j shows as -R (1 - C P) d in e, P being the prior's weight that the new fit holds it
back with; the smallest set of such changes that explains e is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, ndtr

from ppmcal.calibration.fit import Fit, FitOptions
from ppmcal.calibration.identify import identify
from ppmcal.calibration.noise import noise_check, with_noise
from ppmcal.calibration.pose_difference import PoseDifference, pose_difference
from ppmcal.calibration.posterior import BENT, Earlier, Posterior, of_data
from ppmcal.errors import BadInput
from ppmcal.linalg import Array, range_basis
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism

CHANGED = 0.01
"""A change is named where chance would show one this rarely among all parameters."""
AS_GOOD = 4.0
"""Another parameter explains a change as well if chi-squared is higher by less than this."""
VISIBLE = 1e-3
"""A change counts as seen where one tolerance of it makes so many standard deviations."""
POSES = 400


@dataclass(frozen=True)
class Change:
    """One parameter that changed, by ``value`` with ``sigma``, SI; ``instead``: or these."""

    name: str
    value: float
    sigma: float
    p_value: float
    instead: tuple[str, ...]


@dataclass(frozen=True)
class Comparison:
    """What two calibrations say together, SI.

    Attributes:
        names: parameters that both had free (F,).
        old, new: their values (F,).
        sigma: of the differences that noise and tolerances alone make (F,).
        alone: how often noise would ask as much for a change of this one alone (F,).
        chi2, freedom, p_value: of all together if nothing had changed.
        changes: the fewest that explain it; ``p_left``: of what they do not explain.
        moved: what it means at the platform, None where no pose was had.
    """

    names: tuple[str, ...]
    old: Array
    new: Array
    sigma: Array
    alone: Array
    chi2: float
    freedom: int
    p_value: float
    changes: tuple[Change, ...]
    p_left: float
    pose_difference: PoseDifference | None

    @property
    def changed(self) -> bool:
        """Whether all together say more than chance would."""
        return self.p_value < CHANGED or bool(self.changes)


def between(mechanism: Mechanism, old: Posterior, new: Posterior,
            volume: Mapping[str, tuple[float, float]], rng: np.random.Generator
            ) -> tuple[Comparison, list[str]]:
    """Return what changed between two identifications, and what makes that doubtful.

    ``mechanism``: the newer; ``volume``: coordinate -> (low, high) of the poses to compare at.

    Raises:
        BadInput: they have no free parameter in common.
    """
    common = [p for p in old.places if p in new.places]
    if not common:
        raise BadInput("has no free parameter in common with the newer one", old.source,
                       "Compare calibrations of one machine")
    notes = []
    both = sorted(set(old.inputs) & set(new.inputs))
    if both:
        notes.append(f"{new.inputs[both[0]]} is in both calibrations: they are not independent, "
                     "and changes look smaller than they are")
    only = {mechanism.names[p] for p in set(old.places) ^ set(new.places)}
    if only:
        notes.append(f"free in only one of the two, and taken as it is in the newer: "
                     f"{', '.join(sorted(only))}")
    # a parameter that only the older had free is known exactly now
    value = mechanism.values[list(old.places)]
    covariance, unseen = new.covariance()
    at = [new.places.index(p) for p in common]
    here = [old.places.index(p) for p in common]
    value[here] = new.value[at]
    now = Now(value, np.zeros((value.size, value.size)), np.zeros((value.size, unseen.shape[1])),
              np.full(value.size, np.inf), old.scale)
    now.covariance[np.ix_(here, here)] = covariance[np.ix_(at, at)]
    now.unseen[here] = unseen[at]
    now.tolerance[here] = new.tolerance[at]
    poses = np.stack([rng.uniform(*volume.get(c, (0.0, 0.0)), POSES) for c in POSE_COORDINATES],
                     axis=-1)
    # a machine of fewer actuators than coordinates does not reach poses drawn at random
    reached = mechanism.equations == len(mechanism.actuators)
    return compare(mechanism, old.data(), now, poses if reached else None), notes


@dataclass(frozen=True, eq=False)
class Now:
    """What the new calibration says of the old one's parameters, SI.

    ``value`` (F,), ``covariance`` (F, F) within what is seen, directions ``unseen`` (F, d) by
    data and prior, ``tolerance`` (F,) of the prior, natural units ``scale`` (F,).
    """

    value: Array
    covariance: Array
    unseen: Array
    tolerance: Array
    scale: Array


def compare(mechanism: Mechanism, old: Earlier, new: Now, volume: Array | None = None
            ) -> Comparison:
    """Return what changed between two calibrations.

    Args:
        mechanism: the machine, parameters as the new one has them.
        old: what the old data knew.
        new: what the new calibration says of the same parameters.
        volume: poses (N, 6) at which the two are compared, base frame.
    """
    names = [mechanism.parameters[p].name for p in old.places]
    g = mechanism.values.copy()
    g[list(old.places)] = new.value
    rows, slope = old.rows(mechanism, old.places, g)
    inverse = np.where(np.isfinite(new.tolerance), 1.0 / new.tolerance**2, 0.0)
    covariance = np.eye(rows.size) + slope @ new.covariance @ slope.T
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    blind = range_basis(white @ slope @ new.unseen, least=BENT)
    misfit = white @ rows
    columns = -white @ (slope - slope @ new.covariance * inverse) * new.scale
    misfit, columns = (v - blind @ (blind.T @ v) for v in (misfit, columns))
    freedom = rows.size - blind.shape[1]
    found, left = _changes(names, columns, misfit, freedom)
    changes = tuple(_in_units(mechanism, old, new, c) for c in found)
    chi2 = float(misfit @ misfit)
    return Comparison(
        tuple(names), old.value, np.asarray(new.value),
        _difference(old, new.covariance, inverse, slope, new.scale), _alone(columns, misfit),
        chi2, freedom, _chance(chi2, freedom), changes,
        _chance(float(left @ left), freedom - len(changes)),
        None if volume is None else pose_difference(mechanism, old, new.value, volume))


def _in_units(mechanism: Mechanism, old: Earlier, new: Now, change: Change) -> Change:
    """Return a change, found in natural units, in SI; of reciprocals through their steps."""
    c = next(i for i, p in enumerate(old.places) if mechanism.names[p] == change.name)
    step, now = change.value * float(new.scale[c]), float(new.value[c])
    value = now - mechanism.parameters[old.places[c]].stepped(now, -step)
    sigma = change.sigma * float(new.scale[c]) * (value / step if step else 1.0)
    return replace(change, value=value, sigma=sigma)


def posterior_of(fit: Fit, inputs: Mapping[str, str] | None = None) -> Posterior:
    """Return what a fit ended with; ``inputs``: as in :class:`posterior.Posterior`."""
    count, free = len(fit.problem.free), list(fit.problem.free)
    scale = fit.scale[:count]
    matrix, right = of_data(fit.reduced.triangle, fit.reduced.right, count, scale)
    with np.errstate(divide="ignore"):
        tolerance = 1.0 / fit.prior[:count]
    return Posterior(fit.problem.free, fit.state.g[free], matrix * fit.noise, right * fit.noise,
                     tolerance, scale, fit.noise, inputs or {}, "")


def carried_on(fit: Fit, before: Posterior, options: FitOptions) -> list[str]:
    """Return what is odd about a fit that earlier data took part in: the machine has changed."""
    free = set(fit.problem.free)
    fixed = [fit.problem.mechanism.names[p] for p in before.places if p not in free]
    if fixed:
        return [f"parameters that the earlier calibration had found are fixed now: "
                f"{', '.join(fixed[:4])}{' ...' if len(fixed) > 4 else ''}"]
    alone = identify(replace(fit.problem, earlier=None), options, None, fit.state, near=True)
    new = posterior_of(with_noise(alone, noise_check(alone).inflation, options))
    found, _ = between(fit.problem.mechanism, before, new, {}, np.random.default_rng(0))
    if not found.changed:
        return []
    names = ", ".join(c.name for c in found.changes) or "no single parameter explains it"
    return [f"the machine has changed since the calibration in {before.source} (p = "
            f"{found.p_value:.2g}; {names}): the two do not belong in one fit, see ppmcal compare"]


def _chance(chi2: float, freedom: int) -> float:
    return float(chdtrc(freedom, chi2)) if freedom > 0 else 1.0


def _difference(old: Earlier, covariance: Array, inverse: Array, slope: Array, scale: Array
                ) -> Array:
    """Return the standard deviation of new minus old values if nothing changed (F,).

    Of two posteriors C1, C2 with the same prior P: C1 + C2 - C1 P C2 - C2 P C1.
    """
    information = (slope.T @ slope + np.diag(inverse)) * np.outer(scale, scale)
    first = np.linalg.pinv(information, rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    both = first + covariance - (first * inverse) @ covariance - (covariance * inverse) @ first
    return np.asarray(np.sqrt(np.maximum(np.diagonal(both), 0.0)))


def _alone(columns: Array, misfit: Array) -> Array:
    """Return two-sided p of each change being needed, if it were the only one (F,)."""
    length = np.linalg.norm(columns, axis=0)
    seen = length > VISIBLE
    z = np.where(seen, columns.T @ misfit / np.where(seen, length, 1.0), 0.0)
    return np.asarray(2.0 * ndtr(-np.abs(z)))


def _changes(names: Sequence[str], columns: Array, misfit: Array, freedom: int
             ) -> tuple[list[Change], Array]:
    """Add the change that explains most until none is needed; drop what is not needed any more."""
    chosen: list[int] = []
    while len(chosen) < freedom - 1:
        rest, left = _without(columns, misfit, chosen)
        alone = _alone(rest, left)
        best = int(np.argmin(np.where(np.isin(np.arange(alone.size), chosen), 1.0, alone)))
        if alone[best] * alone.size > CHANGED:
            break
        chosen.append(best)
    for j in list(chosen):
        rest, left = _without(columns, misfit, [c for c in chosen if c != j])
        if len(names) * float(_alone(rest[:, [j]], left)[0]) > CHANGED:
            chosen.remove(j)
    out = []
    for j in chosen:
        rest, left = _without(columns, misfit, [c for c in chosen if c != j])
        square = float(rest[:, j] @ rest[:, j])
        gain = _gains(rest, left)
        rivals = tuple(names[k] for k in np.argsort(-gain, kind="stable")
                       if k not in chosen and gain[k] > gain[j] - AS_GOOD)
        out.append(Change(names[j], float(rest[:, j] @ left) / square, float(square**-0.5),
                          len(names) * float(_alone(rest[:, [j]], left)[0]), rivals))
    return out, _without(columns, misfit, chosen)[1]


def _gains(columns: Array, misfit: Array) -> Array:
    """Return by how much each column alone lowers chi-squared (F,)."""
    square = np.sum(columns**2, axis=0)
    seen = square > VISIBLE**2
    return np.asarray(np.where(seen, (columns.T @ misfit) ** 2 / np.where(seen, square, 1.0), 0.0))


def _without(columns: Array, misfit: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
    """Return columns and misfit with what the chosen columns explain taken out."""
    if not chosen:
        return columns, misfit
    q = np.linalg.qr(columns[:, list(chosen)])[0]
    rest = columns - q @ (q.T @ columns)
    length = np.linalg.norm(columns, axis=0)
    gone = np.linalg.norm(rest, axis=0) < 1e-6 * np.maximum(length, 1e-300)
    return np.where(gone, 0.0, rest), misfit - q @ (q.T @ misfit)
