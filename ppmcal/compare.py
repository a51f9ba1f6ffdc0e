"""Two calibrations of one machine: what has changed, and what only looks so.

With the data of the old one as rows |R s - r|^2 (:mod:`ppmcal.earlier`) and the new posterior
N(s, C), the rows' misfit e = r - R s has covariance I + R C R^T if nothing changed: one
chi-squared for all parameters together, whatever they trade among each other. A change d of
parameter j shows as -R (1 - C P) d in e, P being the prior's weight that the new fit holds it
back with; the smallest set of such changes that explains e is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr

from ppmcal import algebra as cga
from ppmcal.closure import Model
from ppmcal.earlier import Earlier, Posterior
from ppmcal.errors import BadInput
from ppmcal.fit import Fit, Options, prediction_covariance
from ppmcal.forward import forward
from ppmcal.identify import identify
from ppmcal.kinematics import inverse_table
from ppmcal.mechanism import POSE_COORDINATES, Mechanism

Array = NDArray[np.float64]

CHANGED = 0.01
"""A change is named where chance would show one this rarely among all parameters."""
AS_GOOD = 4.0
"""Another parameter explains a change as well if chi-squared is higher by less than this."""
VISIBLE = 1e-9
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
class Moved:
    """How far poses at the same joints lie apart, frames laid on each other; m and rad."""

    position_rms: float
    position_max: float
    rotation_rms: float
    rotation_max: float
    poses: int


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
    moved: Moved | None

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
    covariance = np.zeros((value.size, value.size))
    tolerance = np.full(value.size, np.inf)
    at = [new.places.index(p) for p in common]
    here = [old.places.index(p) for p in common]
    value[here] = new.value[at]
    covariance[np.ix_(here, here)] = new.covariance[np.ix_(at, at)]
    tolerance[here] = new.tolerance[at] * new.inflation
    poses = np.stack([rng.uniform(*volume.get(c, (0.0, 0.0)), POSES) for c in POSE_COORDINATES],
                     axis=-1)
    # a machine of fewer actuators than coordinates does not reach poses drawn at random
    reached = mechanism.conditions == len(mechanism.actuators)
    return compare(mechanism, old.data(), value, covariance, tolerance,
                   poses if reached else None), notes


def compare(mechanism: Mechanism, old: Earlier, new: Array, covariance: Array, tolerance: Array,
            volume: Array | None = None) -> Comparison:
    """Return what changed between two calibrations.

    Args:
        mechanism: the machine, parameters as the new one has them.
        old: what the old data knew.
        new: new values of the old one's parameters (F,), SI.
        covariance: their new posterior (F, F).
        tolerance: the prior's standard deviations (F,), inf where there was none.
        volume: poses (N, 6) at which the two are compared, base frame.
    """
    names = [mechanism.parameters[p].name for p in old.places]
    g = mechanism.values.copy()
    g[list(old.places)] = new
    rows, slope = old.rows(mechanism, old.places, g)
    inverse = np.where(np.isfinite(tolerance), 1.0 / tolerance**2, 0.0)
    spread = np.eye(rows.size) + slope @ covariance @ slope.T
    white = np.linalg.inv(np.linalg.cholesky(spread))
    misfit = white @ rows
    columns = -white @ (slope - slope @ covariance * inverse)
    changes, left = _changes(names, columns, misfit)
    chi2, freedom = float(misfit @ misfit), rows.size
    return Comparison(
        tuple(names), old.value, np.asarray(new), _difference(old, covariance, inverse, slope),
        _alone(columns, misfit), chi2, freedom, _chance(chi2, freedom), changes,
        _chance(float(left @ left), freedom - len(changes)),
        None if volume is None else moved(mechanism, old, new, volume))


def carried_on(fit: Fit, before: Posterior, options: Options) -> list[str]:
    """Return what is odd about a fit that earlier data took part in: the machine has changed."""
    alone = identify(replace(fit.problem, earlier=None), options, None, fit.state, near=True)
    free = {p: c for c, p in enumerate(fit.problem.free)}
    places = [p for p in before.places if p in free]
    if len(places) < len(before.places):
        return ["parameters that the earlier calibration had found are fixed now: "
                + ", ".join(fit.problem.mechanism.names[p] for p in before.places
                            if p not in free)]
    at = [free[p] for p in places]
    weight = np.where(alone.prior[at] > 0.0, alone.prior[at], np.nan)
    found = compare(fit.problem.mechanism, before.data(), alone.state.g[places],
                    prediction_covariance(alone)[np.ix_(at, at)],
                    np.where(np.isnan(weight), np.inf, 1.0 / weight))
    if found.p_value >= CHANGED:
        return []
    names = ", ".join(c.name for c in found.changes) or "no single parameter explains it"
    return [f"the machine has changed since the calibration in {before.source} (p = "
            f"{found.p_value:.2g}; {names}): the two do not belong in one fit, see ppmcal compare"]


def _chance(chi2: float, freedom: int) -> float:
    return float(chdtrc(freedom, chi2)) if freedom > 0 else 1.0


def _difference(old: Earlier, covariance: Array, inverse: Array, slope: Array) -> Array:
    """Return the standard deviation of new minus old values if nothing changed (F,).

    Of two posteriors C1, C2 with the same prior P: C1 + C2 - C1 P C2 - C2 P C1.
    """
    information = slope.T @ slope + np.diag(inverse)
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    first = np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * np.outer(
        scale, scale)
    both = first + covariance - (first * inverse) @ covariance - (covariance * inverse) @ first
    return np.asarray(np.sqrt(np.maximum(np.diagonal(both), 0.0)))


def _alone(columns: Array, misfit: Array) -> Array:
    """Return two-sided p of each change being needed, if it were the only one (F,)."""
    length = np.linalg.norm(columns, axis=0)
    seen = length > VISIBLE * length.max(initial=1e-300)
    z = np.where(seen, columns.T @ misfit / np.where(seen, length, 1.0), 0.0)
    return np.asarray(2.0 * ndtr(-np.abs(z)))


def _changes(names: Sequence[str], columns: Array, misfit: Array
             ) -> tuple[tuple[Change, ...], Array]:
    """Add the change that explains most until none is needed; drop what is not needed any more."""
    chosen: list[int] = []
    while len(chosen) < misfit.size - 1:
        rest, left = _without(columns, misfit, chosen)
        alone = _alone(rest, left)
        best = int(np.argmin(np.where(np.isin(np.arange(alone.size), chosen), 1.0, alone)))
        if alone[best] * alone.size > CHANGED:
            break
        chosen.append(best)
    out = []
    for j in list(chosen):
        others = [c for c in chosen if c != j]
        rest, left = _without(columns, misfit, others)
        chance = len(names) * float(_alone(rest[:, [j]], left)[0])
        if chance > CHANGED:
            chosen.remove(j)
            continue
        square = float(rest[:, j] @ rest[:, j])
        gain = _gains(rest, left)
        rivals = tuple(names[k] for k in np.argsort(-gain, kind="stable")
                       if k not in chosen and gain[k] > gain[j] - AS_GOOD)
        out.append(Change(names[j], float(rest[:, j] @ left) / square, float(square**-0.5),
                          chance, rivals))
    return tuple(out), _without(columns, misfit, chosen)[1]


def _gains(columns: Array, misfit: Array) -> Array:
    """Return by how much each column alone lowers chi-squared (F,)."""
    square = np.sum(columns**2, axis=0)
    seen = square > VISIBLE**2 * square.max(initial=1e-300)
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


def moved(mechanism: Mechanism, old: Earlier, new: Array, volume: Array) -> Moved | None:
    """Return how far the two machines' poses lie apart at the joints of poses ``volume`` (N, 6)."""
    ends = []
    g = mechanism.values.copy()
    g[list(old.places)] = old.value
    first = Model(mechanism, g)
    q = inverse_table(first, volume).q
    q = q[np.isfinite(q).all(axis=1)]
    if len(q) < 3:
        return None
    g = mechanism.values.copy()
    g[list(old.places)] = new
    for model in (first, Model(mechanism, g)):
        ends.append(forward(model, q).pose)
    good = np.isfinite(ends[0]).all(axis=1) & np.isfinite(ends[1]).all(axis=1)
    if good.sum() < 3:
        return None
    return _apart(ends[0][good], ends[1][good], mechanism.length_scale)


def _apart(one: Array, two: Array, size: float) -> Moved:
    """Lay poses (N, 8) on others by one rigid motion; points at ``size`` stand for rotations."""
    corners = np.concatenate([np.zeros((1, 3)), size * np.eye(3)])
    a, b = (cga.translation(p)[:, None, :] + corners @ np.swapaxes(
        cga.rotation_matrix(p), -1, -2) for p in (one, two))
    flat_a, flat_b = a.reshape(-1, 3), b.reshape(-1, 3)
    middle_a, middle_b = flat_a.mean(axis=0), flat_b.mean(axis=0)
    u, _, vt = np.linalg.svd((flat_b - middle_b).T @ (flat_a - middle_a))
    turn = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    position = np.linalg.norm((b[:, 0] - middle_b) @ turn.T + middle_a - a[:, 0], axis=1)
    both = np.swapaxes(cga.rotation_matrix(one), -1, -2) @ turn @ cga.rotation_matrix(two)
    sine = np.linalg.norm(both - np.swapaxes(both, -1, -2), axis=(-2, -1)) / np.sqrt(8.0)
    rotation = np.arcsin(np.minimum(sine, 1.0))
    return Moved(float(np.sqrt(np.mean(position**2))), float(position.max()),
                 float(np.sqrt(np.mean(rotation**2))), float(rotation.max()), len(one))
