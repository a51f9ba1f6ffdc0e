"""Two calibrations of one machine: what has changed, and what only seems to have.

The data of both as rows of one linear problem: parameters, their tolerances, and what both took
as known (:mod:`session_posteriors`) are common columns, so that errors shared by both are no
change. The misfit of the new rows, in the directions that the old ones and the tolerances
predict, has covariance 1 if nothing changed, however parameters trade off. Which explanations
are in it, or none, is a posterior (:mod:`explanations`); chi-squared of everything
together is reported beside it for information only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtr

from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Posterior,
    coverage_by,
    data_rows,
    identify,
    noise_check,
    of_data,
    secondary,
    with_noise,
)
from ppmcal.calibration.sessions.common_misfit import DifferenceNoise, noise_between
from ppmcal.calibration.sessions.explanations import (
    Explained,
    Explanation,
    TakenExplanation,
    explained_by,
    explanations,
)
from ppmcal.calibration.sessions.joint_rows import joint_rows
from ppmcal.calibration.sessions.pose_difference import PoseDifference, pose_difference
from ppmcal.calibration.sessions.session_posteriors import (
    defining_parameters,
    session_knowledge,
)
from ppmcal.errors import BadInput
from ppmcal.inference.priors import NOISE_FREEDOM, SURE
from ppmcal.linalg import Array, eigh, reciprocals
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import NOTE, Note

VISIBLE = 1e-3
"""A change counts as seen if one natural unit of it is at least this many standard deviations."""
POSES = 400
DRAWS = 20
"""Differences drawn from noise alone, for their effect at the platform."""


@dataclass(frozen=True)
class ChangePart:
    """One number of a change, ``value`` +- ``sigma``, SI; ``column``: a parameter or candidate."""

    name: str
    column: str
    value: float
    sigma: float


@dataclass(frozen=True)
class Change:
    """Something that changed, with its ``probability``; ``instead``: alternatives."""

    name: str
    parts: tuple[ChangePart, ...]
    probability: float
    instead: tuple[str, ...]


@dataclass(frozen=True)
class Comparison:
    """Comparison of two calibrations, SI.

    Attributes:
        names: parameters that both had free (F,).
        old, new: their values (F,).
        sigma: of differences due to noise and tolerances alone (F,).
        alone: chance that noise would suggest as large a change of this one alone (F,).
        explained: part of each change that the named changes explain (F,).
        chi2, freedom, p_value: of all together if nothing had changed; for information only.
        nothing: probability that nothing has changed.
        changes: the most probable explanations; ``unlisted``: probability that something not
            listed has changed, alone or beside them.
        noise: of the differences, over the stated noise.
        pose_difference: effect at the platform, None if no pose was available.
        covariance: of the differences, like ``sigma`` (F, F).
        why_not: why the two cannot be compared, empty if they can.
    """

    names: tuple[str, ...]
    old: Array
    new: Array
    sigma: Array
    alone: Array
    explained: Array
    chi2: float
    freedom: int
    p_value: float
    nothing: float
    changes: tuple[Change, ...]
    unlisted: float
    noise: DifferenceNoise
    pose_difference: PoseDifference | None
    covariance: Array
    why_not: str = ""

    @classmethod
    def impossible(cls, why: str) -> Comparison:
        """Return the comparison of two calibrations that cannot be compared, without p-value."""
        none = np.zeros(0)
        return cls((), none, none, none, none, none, 0.0, 0, np.nan, np.nan, (), np.nan,
                   DifferenceNoise(np.nan, np.nan, np.inf, 1.0, False), None, np.zeros((0, 0)),
                   why)

    @property
    def coverage(self) -> float:
        """Half width of a 95 % interval of a difference over its sigma."""
        return coverage_by(self.noise.degrees)

    @property
    def changed(self) -> bool:
        """Whether something has surely changed."""
        return not self.why_not and self.nothing < 1.0 - float(SURE)


def between(mechanism: Mechanism, old: Posterior, new: Posterior,
            volume: Mapping[str, tuple[float, float]], rng: np.random.Generator
            ) -> tuple[Comparison, list[Note]]:
    """Return what changed between two identifications, and what makes that doubtful.

    ``mechanism``: the newer; ``volume``: coordinate -> (low, high) of the poses at which the
    platform is compared, not compared if empty.

    Raises:
        BadInput: they had different parameters free; see :mod:`joint_fit`.
    """
    if set(old.places) != set(new.places):
        raise BadInput("had different parameters free from the newer one", old.source,
                       "Identify both with the same --free")
    common, notes = list(old.places), list[Note]()
    both = sorted(set(old.inputs) & set(new.inputs))
    if both:
        notes.append(Note(f"{new.inputs[both[0]]} is in both calibrations: they are not "
                          "independent, and changes look smaller than they are; identify each from "
                          "its own files", topic="inputs"))
    found = _compared(mechanism, old, new, common, notes)
    if not found.freedom:
        return Comparison.impossible("no direction was measured in both sessions, so that neither "
                                     "predicts anything of the other"), notes
    defining = new.defining.names if new.defining else ()
    notes += [Note(f"{c.name} defines a frame, so it is not fitted; the table shows its change as "
                   "a motion of the other points", NOTE, "gauge")
              for c in found.changes if c.name in defining]
    # a machine with fewer actuators than coordinates does not reach poses drawn at random
    if volume and not mechanism.dependent:
        poses = np.stack([rng.uniform(*volume.get(c, (0.0, 0.0)), POSES)
                          for c in POSE_COORDINATES], axis=-1)

        def apart() -> PoseDifference | None:
            return pose_difference(mechanism, old.places, found.old, found.new, poses,
                                   _drawn(found.covariance, DRAWS, rng))

        moved = secondary("how far the platform has moved", apart, None, notes)
        return replace(found, pose_difference=moved), notes
    return found, notes


def _compared(mechanism: Mechanism, old: Posterior, new: Posterior, common: list[int],
              notes: list[Note]) -> Comparison:
    noise = noise_between(old, new)
    rows = joint_rows(mechanism, old, new, noise)
    names, scale = [mechanism.names[p] for p in common], rows.scale
    place = {n: c for c, n in enumerate([*(mechanism.names[p] for p in new.places),
                                         *rows.candidates, *rows.defining])}

    def block(e: Explanation) -> Array:
        # columns of one number move by the same amount, whatever their natural units
        return np.stack([sum((w * scale[place[next(iter(part))]] / scale[place[n]]
                              * rows.columns[:, place[n]] for n, w in part.items()),
                             np.zeros(rows.misfit.size)) for part in e.columns], axis=1)

    known = float(NOISE_FREEDOM) + sum(p.session.degrees for p in (old, new) if p.session)

    def named() -> Explained:
        candidates = explanations(mechanism, names, rows.candidates, rows.defining)
        return explained_by(candidates, [block(e) for e in candidates], rows.misfit, known)

    # that something has changed is reported even without a name for it
    found = secondary("what has changed", named, explained_by((), (), rows.misfit, known), notes)
    here = [new.places.index(p) for p in common]
    covariance = rows.covariance()[np.ix_(here, here)]
    value, explained = new.estimate(mechanism)[here], np.zeros(len(common))
    seen = {} if new.defining is None else dict(zip(
        rows.defining, new.defining.seen[:, here] / new.defining.scale[:, None], strict=True))
    for f in found.taken:
        for part, step in zip(f.explanation.columns, f.value.tolist(), strict=True):
            step *= scale[place[next(iter(part))]]
            explained += [step * part.get(n, 0.0) for n in names]
            explained += step * sum(w * seen[n] for n, w in part.items() if n in seen)
    size, chi2 = rows.misfit.size, float(rows.misfit @ rows.misfit)
    return Comparison(
        tuple(names), old.estimate(mechanism), value,
        np.sqrt(np.maximum(np.diagonal(covariance), 0.0)),
        _alone(rows.columns[:, here], rows.misfit),
        np.array([_step(mechanism, p, v, s) for p, v, s in zip(
            common, value.tolist(), explained.tolist(), strict=True)]),
        chi2, size, _chance(chi2, size, noise.degrees), found.nothing, tuple(
            _in_units(mechanism, f, place, scale, new) for f in found.taken),
        found.unlisted, noise, None, covariance)


def _drawn(covariance: Array, count: int, rng: np.random.Generator) -> Array:
    """Draw vectors (count, F) of a covariance (F, F), which may be singular."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    size = np.where(sigma > 0.0, sigma, 1.0)
    w, v = eigh(covariance / size / size[:, None])
    return (rng.standard_normal((count, sigma.size)) * np.sqrt(np.maximum(w, 0.0))) @ v.T * sigma


def _step(mechanism: Mechanism, place: int, now: float, step: float) -> float:
    """Return a change of a parameter up to ``now``, SI, for a step; reciprocals differ."""
    return now - mechanism.parameters[place].stepped(now, -step) if step else 0.0


def _in_units(mechanism: Mechanism, found: TakenExplanation, place: Mapping[str, int], scale: Array,
              new: Posterior) -> Change:
    """Return a change, found in natural units, in SI."""
    parts = []
    for i, (name, column) in enumerate(zip(found.explanation.parts, found.explanation.columns,
                                           strict=True)):
        first = next(iter(column))
        at = place[first]
        step = float(found.value[i] * scale[at])
        sigma = float(np.sqrt(found.covariance[i, i])) * float(scale[at])
        value = step
        if at < len(new.places):
            value = _step(mechanism, new.places[at], float(new.estimate(mechanism)[at]), step)
            sigma *= value / step if step else 1.0
        parts.append(ChangePart(name, first, value, sigma))
    return Change(found.explanation.name, tuple(parts), found.probability, found.instead)


def posterior_of(fit: Fit, inputs: Mapping[str, str] | None = None) -> Posterior:
    """Return the posterior of a fit; ``inputs``: see :class:`prior_information.Posterior`."""
    count, free = len(fit.problem.free), list(fit.problem.free)
    scale = fit.scale[:count]
    matrix, right = of_data(*data_rows(fit), count, scale)
    return Posterior(fit.problem.free, fit.state.g[free], matrix * fit.noise, right * fit.noise,
                     reciprocals(fit.prior[:count], np.inf), scale, fit.noise, inputs or {}, "",
                     session_knowledge(fit), defining=defining_parameters(fit))


def carried_on(fit: Fit, before: Posterior, options: FitOptions) -> list[Note]:
    """Return what is wrong with a fit that includes earlier data: the machine has changed."""
    free = set(fit.problem.free)
    fixed = [fit.problem.mechanism.names[p] for p in before.places if p not in free]
    if fixed:
        return [Note("parameters identified by the earlier calibration are now fixed: "
                     f"{', '.join(fixed[:4])}{' ...' if len(fixed) > 4 else ''}; free them with "
                     "--free, or leave out --keep", topic="sessions")]
    # parameters free only for the new rows are put where the earlier calibration held them
    problem, g = replace(fit.problem, free=before.places, earlier=None), fit.state.g.copy()
    held = sorted(free - set(before.places))
    g[held] = problem.mechanism.values[held]
    state = problem.solve(replace(fit.state, g=g)) if held else fit.state
    alone = identify(problem, options, state, near=True)
    new = posterior_of(with_noise(alone, noise_check(alone).inflation, options))
    found, _ = between(fit.problem.mechanism, before, new, {}, np.random.default_rng(0))
    if not found.changed:
        return []
    names = ", ".join(c.name for c in found.changes) or "nothing by itself explains it"
    return [Note(f"the machine has changed since the calibration in {before.source} (probability "
                 f"of no change {found.nothing:.2g}; {names}): the two do not belong in one fit, "
                 "see ppmcal compare", topic="sessions")]


def _chance(square: float, freedom: int, degrees: float) -> float:
    """Return how often noise, known from so many ``degrees``, gives as large a sum of squares."""
    if freedom <= 0:
        return 1.0
    return float(chdtrc(freedom, square) if np.isinf(degrees)
                 else fdtrc(freedom, degrees, square / freedom))


def _alone(columns: Array, misfit: Array) -> Array:
    """Return the two-sided p-value of each change, if it were the only one (F,)."""
    length = np.linalg.norm(columns, axis=0)
    seen = length > VISIBLE
    z = np.where(seen, columns.T @ misfit / np.where(seen, length, 1.0), 0.0)
    return np.asarray(2.0 * ndtr(-np.abs(z)))
