"""Fits that start where a fit of the same measurements ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ppmcal import linalg
from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Problem,
    State,
    bounded,
    identify,
    posterior,
    residual_freedom,
)
from ppmcal.diagnosis.added_variable_test import log_p
from ppmcal.diagnosis.extended_model import Added
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import (
    INVISIBLE,
    MOST_ROWS,
    Whitening,
    build,
    range_basis,
)
from ppmcal.diagnosis.result import Found
from ppmcal.diagnosis.stage import scaling_columns, without
from ppmcal.linalg import Array, Bools, finite_rows, subsample, unit_columns
from ppmcal.model.dataset import Dataset
from ppmcal.model.effects import EffectParameter
from ppmcal.model.mechanism import Mechanism

NEAR = 30
"""Iterations of a fit that starts where one of the same measurements ended: at most so many."""
MOST_STEPS = 300
"""Steps that all fits of such a refit may try together, with those that leave rows out."""


def with_mechanism(fit: Fit, mechanism: Mechanism, options: FitOptions) -> Fit:
    """Fit a machine with further effects, or slots freed, to the rows of ``fit``.

    Args:
        fit: of the machine without them.
        mechanism: with them, started at their estimates; its parameters begin with those of
            the fitted machine.
        options: of the fit.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.fit.identify`.
    """
    return _near(*started(fit, mechanism), options)


def started(fit: Fit, mechanism: Mechanism) -> tuple[Problem, State]:
    """Return the problem of such a machine, and where its fit starts; poses as without it."""
    problem = replace(fit.problem, mechanism=mechanism, free=mechanism.free)
    old = fit.problem.mechanism
    g = mechanism.values.copy()
    kept = [p for p, name in enumerate(old.names)
            if mechanism.names[p] == name and mechanism.parameters[p].value
            == old.parameters[p].value]
    g[kept] = fit.state.g[kept]
    return problem, State(g, fit.state.registrations, fit.state.poses)


def of_rows(fit: Fit, rows: Sequence[Bools], options: FitOptions) -> Fit:
    """Fit the same machine to some rows (N,) of each data set."""
    datasets: tuple[Dataset, ...] = tuple(
        d.take(r) for d, r in zip(fit.problem.datasets, rows, strict=True))
    about = tuple(o.about for o in fit.problem.opens)
    problem = replace(fit.problem, datasets=datasets, pivots=about)
    poses = tuple(p[r] for p, r in zip(fit.state.poses, rows, strict=True))
    return _near(problem, replace(fit.state, poses=poses), options)


def _near(problem: Problem, state: State, options: FitOptions) -> Fit:
    """Fit from a state near by, or from scratch where rows get lost on the way.

    A fit that has not converged by :data:`NEAR` iterations wanders along a valley; it is given up
    with what it reached, and the findings say so.
    """
    options = replace(options, iterations=min(options.most, NEAR))
    start = problem.solve(state)
    lost = any((finite_rows(old) & ~finite_rows(new)).any()
               for old, new in zip(state.poses, start.poses, strict=True))
    with bounded(MOST_STEPS):
        if lost:
            return identify(replace(problem, pivots=None), options)
        return identify(problem, options, start=start, near=True)


SURE, MOSTLY_KNOWN = 0.01, 0.5
"""A size is known where chance gives it this rarely if there is nothing; of several, so many."""
APART = 1e-3
"""Periods of one hypothesis are not the same where chance takes them so far apart this rarely."""


Key = tuple[str, tuple[str, ...]]
"""Family and actuators of a hypothesis, or of several waves of it."""


def key_of(hypothesis: Hypothesis) -> Key:
    """Return what a hypothesis is told apart by."""
    return hypothesis.family, hypothesis.on


def lasting_values(fit: Fit, found: Found) -> dict[Key, float]:
    """Return the log p of each added hypothesis in all rows, 0 of one that is not to be named.

    Args:
        fit: of all rows, with the effects.
        found: on the training rows.
    """
    values = own_values(fit, found.added, found.last.noise, subsample(fit.keep, MOST_ROWS))
    covariance = posterior(fit)
    return {key: max(value, _known_size(fit, covariance, found.added, key),
                     _outside(fit, covariance, found, key)) for key, value in values.items()}


def nothing_named(found: Found) -> Found:
    """Return the same without any effect."""
    return Found(found.before, found.before, found.first, replace(found.first, chosen=()), ())


def _columns(fit: Fit, added: Sequence[Added], key: Key) -> list[int]:
    """Return the columns of the parameters that were added for a hypothesis."""
    names = fit.problem.mechanism.names
    own = {n for a in added if key_of(a.hypothesis) == key for n in a.parameters}
    return [c for c, p in enumerate(fit.problem.free) if names[p] in own]


def _known_size(fit: Fit, covariance: Array, added: Sequence[Added], key: Key) -> float:
    """Return the log p of an effect's size against zero, with all that geometry may do instead.

    ``covariance``: covariance of the fit's columns (C, C).

    The linear test counts as geometry what one tolerance can do; a fit may do more, and then the
    size of an effect is not known, however well it explains the rows. Of values for each actuator
    most have to be known.
    """
    mine = [a for a in added if key_of(a.hypothesis) == key]
    each = np.array([_against_zero(fit, covariance, _columns(fit, [a], key)) for a in mine])
    if np.mean(each < np.log(SURE)) < MOSTLY_KNOWN:
        return 0.0
    together = _columns(fit, mine, key)
    return _against_zero(fit, covariance, together) if len(mine) > 1 else float(each[0])


def _against_zero(fit: Fit, covariance: Array, columns: Sequence[int]) -> float:
    """Return the log p of the linear parameters among some columns of a fit being all 0."""
    mechanism = fit.problem.mechanism
    linear = [c for c in columns if not mechanism.parameters[fit.problem.free[c]].nonlinear]
    if not linear or not any(mechanism.parameters[fit.problem.free[c]].size for c in linear):
        return -np.inf  # a slot of the geometry
    parameters = [mechanism.parameters[fit.problem.free[c]] for c in linear]
    g = np.array([fit.state.g[fit.problem.free[c]] for c in linear])
    # a stiffness is judged by its inverse, in which the effect is linear
    inverse = np.array([p.reciprocal for p in parameters])
    value = np.where(inverse, 1.0 / g, g)
    slope = np.where(inverse, -1.0 / g**2, 1.0)
    linear_part = _given_optional(fit, covariance, columns, linear) * np.outer(slope, slope)
    if not np.isfinite(linear_part).all():
        return 0.0
    # residuals above the stated noise make everything less certain
    ratio = max(1.0, fit.reduced.square / residual_freedom(fit))
    square = float(value @ linalg.pinv(linear_part, hermitian=True) @ value) / ratio
    return float(np.log(max(chdtrc(len(linear), square), 1e-300)))


def _given_optional(fit: Fit, covariance: Array, columns: Sequence[int], linear: Sequence[int]
                  ) -> Array:
    """Return the covariance of linear columns with the effect's optional ones held where they are.

    Size and hardening may be known together only; whether there is anything is not the question
    how it hardens.
    """
    mechanism = fit.problem.mechanism
    optional = {e.parameters[s.name] for e in mechanism.effects
             for s in e.kind.parameters(mechanism.motion) if s.optional}
    held = [c for c in columns if fit.problem.free[c] in optional]
    out = covariance[np.ix_(linear, linear)]
    if held and np.isfinite(covariance[np.ix_(held, held)]).all():
        cross = covariance[np.ix_(linear, held)]
        out = out - cross @ linalg.pinv(covariance[np.ix_(held, held)],
                                           hermitian=True) @ cross.T
    return np.asarray(out)


def _outside(fit: Fit, covariance: Array, found: Found, key: Key) -> float:
    """Return 0 where what is not linear, a period, is none of a machine, else -inf.

    It has to be in the range that machines have. Joints that are made alike have one period, and
    two waves of their own on the same joints are more often some other shape.
    """
    kind = next((a.hypothesis.effect for a in found.added if key_of(a.hypothesis) == key), None)
    specs = kind.parameters(fit.problem.mechanism.motion) if kind else ()
    if any(_beyond(fit, found, key, s) for s in specs):
        return 0.0
    return max((_none_of_machines(fit, covariance, found, key, s) for s in specs if s.nonlinear),
               default=-np.inf)


def never_named(found: Found) -> bool:
    """Whether some effect has a value in the training rows at which it is never named."""
    fit, motion = found.after, found.after.problem.mechanism.motion
    return any(_beyond(fit, found, key_of(a.hypothesis), s) for a in found.added
               if a.hypothesis.effect is not None for s in a.hypothesis.effect.parameters(motion))


def _beyond(fit: Fit, found: Found, key: Key, spec: EffectParameter) -> bool:
    """Whether a value is beyond the range in which the effect is named."""
    names = fit.problem.mechanism.names
    values = [fit.state.g[fit.problem.free[c]] for c in _columns(fit, found.added, key)
              if names[fit.problem.free[c]].endswith(f".{spec.name}")]
    return any(not spec.named[0] <= v <= spec.named[1] for v in values)


def _none_of_machines(fit: Fit, covariance: Array, found: Found, key: Key, spec: EffectParameter
                      ) -> float:
    names = fit.problem.mechanism.names
    columns = [c for c in _columns(fit, found.added, key)
               if names[fit.problem.free[c]].endswith(f".{spec.name}")]
    if not columns:
        return -np.inf
    scale = spec.usual_scale(found.last.system.stroke)
    values = np.array([fit.state.g[fit.problem.free[c]] for c in columns])
    if np.any(values < spec.usual[0] * scale) or np.any(values > spec.usual[1] * scale):
        return 0.0
    weight = 1.0 / np.diagonal(covariance)[columns]
    mean = np.sum(values * weight) / max(float(weight.sum()), 1e-300)  # 0: nothing is known
    apart = float(np.sum((values - mean) ** 2 * weight))
    return 0.0 if len(values) > 1 and chdtrc(len(values) - 1, apart) < APART else -np.inf


def own_values(fit: Fit, added: Sequence[Added], noise: Whitening, keep: Sequence[Bools]
               ) -> dict[Key, float]:
    """Return the log p of each added hypothesis given geometry and the others, at a fit."""
    names = fit.problem.mechanism.names
    where: dict[Key, list[int]] = {}
    for a in added:
        own = where.setdefault(key_of(a.hypothesis), [])
        own += [c for c, p in enumerate(fit.problem.free) if names[p] in a.parameters]
    system = build(fit.problem, fit.state, keep)
    out = {}
    for key, own in where.items():
        alone = without(system, own)
        basis = range_basis(noise.apply(alone.jacobian, alone), INVISIBLE)
        scaling = scaling_columns(system, own)
        columns = noise.apply(np.stack([scaling.get(c, system.jacobian[..., c]) for c in own],
                                       axis=-1), system)
        left = noise.apply(alone.residual[..., None], alone)[:, 0]
        left = left - basis @ (basis.T @ left)
        columns = columns - basis @ (basis.T @ columns)
        plane = range_basis(unit_columns(columns))
        gain = float(np.sum((plane.T @ left) ** 2))
        freedom = system.count - basis.shape[1]
        out[key] = float(log_p(np.array([gain]), float(left @ left), plane.shape[1], freedom)[0])
    return out
