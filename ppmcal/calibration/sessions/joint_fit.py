"""Two calibrations that had different parameters free, fitted again with the same ones free.

A difference between parameters fitted in one and held in the other is not a change of the machine,
and no linear step leads from one to the other: in directions that a session hardly sees they may be
hundreds of millimetres apart. So both sessions get all parameters that either had free, with their
tolerances. One fit to the rows of both, as if nothing had changed, gives a common linearisation
point; from there each is a linear problem of its own, and their results are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ppmcal import linalg
from ppmcal.calibration.fit import (
    LARGER,
    LEAST,
    Fit,
    FitOptions,
    Posterior,
    Problem,
    State,
    identify,
    noise_state,
    unfitted,
)
from ppmcal.calibration.sessions.change_detection import posterior_of
from ppmcal.errors import NoResult
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset


def fitted_together(old: Fit, new: Fit, known: tuple[Posterior, Posterior], options: FitOptions
                    ) -> tuple[Posterior, Posterior]:
    """Return the posteriors of two sessions for the same parameters, from a fit to both.

    Args:
        old: fit of the older session, with the machine's parameters free that both should have.
        new: of the newer one with the same free, each to its own rows.
        known: the two calibrations: their inputs, files, and noise if there are few rows.
        options: method of the fit to all rows; the rows are those that ``old`` and ``new`` kept,
            and left-out rows count as in :mod:`session_posteriors`.

    Raises:
        NoResult: the fit to all rows did not converge.
    """
    sides = [[d.take(k) for d, k in zip(f.problem.datasets, f.keep, strict=True)]
             for f in (old, new)]
    mechanism = old.problem.mechanism
    start = np.where(np.isfinite(mechanism.nominals), mechanism.nominals, mechanism.values)
    mechanism = mechanism.with_values(start)
    datasets = [one for label, own in zip(("old", "new"), sides, strict=True)
                for one in _labelled(own, label)]
    joint = identify(Problem(mechanism, tuple(datasets), old.problem.free),
                     replace(options, robust=False))
    if not joint.converged:
        raise NoResult(f"one fit to the rows of both: {joint.reached}", mechanism.source)
    count = len(sides[0])
    first, second = (_of_session(joint, own, part, one, options) for own, part, one in zip(
        (old, new), (slice(0, count), slice(count, None)), known, strict=True))
    return first, second


def _labelled(datasets: Sequence[Dataset], label: str) -> list[Dataset]:
    """Return a session's data sets under distinct names; homing is as in a fit of it alone."""
    out = []
    for i, d in enumerate(datasets):
        frame = d.frame if d.frame.same_as is None else replace(
            d.frame, same_as=f"{d.frame.same_as} ({label})")
        out.append(replace(d, name=f"{d.name} ({label})", frame=frame,
                           homing=d.homing if i else "shared"))
    return out


def _of_session(joint: Fit, own: Fit, part: slice, known: Posterior, options: FitOptions
                ) -> Posterior:
    """Return the posterior from one session's rows, at the minimum of them and the tolerances."""
    whole = joint.problem
    problem = Problem(whole.mechanism, own.problem.datasets, whole.free,
                      tuple(o.about for o in whole.opens[part]))
    poses, keep = [], []
    for pose, kept, there, used in zip(own.state.poses, own.keep, joint.state.poses[part],
                                       joint.keep[part], strict=True):
        poses.append(pose.copy())
        poses[-1][kept] = there
        keep.append(kept.copy())
        keep[-1][kept] = used
    state = State(joint.state.g, joint.state.registrations[part], tuple(poses))
    fit = replace(unfitted(problem, state, keep, options.method, joint.prior_scale),
                  noise_factor=own.noise_factor, reasons=own.reasons)
    found, places = posterior_of(fit, known.inputs), list(problem.free)
    inflation, held = _inflation(found, known), fit.prior[:len(places)]
    away = np.where(held > 0.0, whole.mechanism.nominals[places] - found.value, 0.0)
    step = _to_minimum(found.matrix / inflation, found.right / inflation, held, away, found.scale)
    return replace(found, inflation=inflation, source=known.source, known=known.known, step=step)


def _inflation(found: Posterior, known: Posterior) -> float:
    """Return the noise over the stated noise by the residuals, 1 if they agree."""
    session = found.session
    if session is None or session.degrees < LEAST:
        return known.inflation
    chance = float(chdtrc(session.degrees, session.degrees * session.noise**2))
    return session.noise if noise_state(session.noise, chance) == LARGER else 1.0


def _to_minimum(matrix: Array, right: Array, prior: Array, away: Array, scale: Array) -> Array:
    """Return the step (F,) to the minimum of |matrix s - right|^2 and |prior (s - away)|^2."""
    rows = np.concatenate([matrix * scale, np.diag(prior * scale)])
    found, _ = linalg.lstsq(rows, np.concatenate([right, prior * away]), rcond=1e-12)
    return np.asarray(scale * found)
