"""Rows without a pose at the machine a fit began with, which may have one where it ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit.fit_result import Fit, prediction_covariance
from ppmcal.calibration.fit.row_distances import distances
from ppmcal.inference.priors import NO_WEIGHT
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import settle
from ppmcal.linalg import Array, Bools, finite_rows

NO_POSE = "no pose at these joint values"
"""Reason for which such a row is left out."""
ROUNDS = 2
"""Refits: with the first rows recovered, others may have a pose too."""
Refit = Callable[[Fit, Sequence[Bools], Sequence[dict[int, str]]], Fit]


def with_unsolved(fit: Fit, refit: Refit) -> Fit:
    """Return a fit including the rows that have a pose at the fitted machine, and belong.

    They are judged like left-out rows: predicted, with the uncertainty of the prediction. A row
    that has a pose but does not belong may be in another assembly mode, and stays out with both
    reasons.

    Args:
        fit: at its minimum, with ``reasons`` for rows without a pose.
        refit: fits again from a fit's state, to other rows with other reasons.
    """
    for _ in range(ROUNDS):
        found = fit.problem.datasets and _solved(fit)
        if not found:
            break
        poses, rows = found
        there = replace(fit, state=replace(fit.state, poses=tuple(
            np.where(r[:, None], new, old)
            for r, new, old in zip(rows, poses, fit.state.poses, strict=True))))
        keep, reasons, back = _judged(there, rows)
        if not back:
            return replace(fit, reasons=reasons)
        fit = replace(refit(there, keep, reasons), noise_factor=fit.noise_factor,
                      taken_back=fit.taken_back + back)
    return fit


def _solved(fit: Fit) -> tuple[list[Array], list[Bools]] | None:
    """Return poses at the fitted machine and which rows had none before; None if none is new."""
    model, poses, rows = Model(fit.problem.mechanism, fit.state.g), [], []
    for i, reasons in enumerate(fit.reasons):
        lost = np.zeros(len(fit.problem.datasets[i]), dtype=bool)
        lost[[n for n, reason in reasons.items() if reason == NO_POSE]] = True
        pose = np.full_like(fit.state.poses[i], np.nan)
        if lost.any():
            pose = fit.problem.reached(i, model, fit.state.registrations[i].homing)
            pose = np.where((lost & ~finite_rows(pose))[:, None], _beside(fit, i, model, lost),
                            pose)
        poses.append(pose)
        rows.append(lost & finite_rows(pose))
    return (poses, rows) if any(r.any() for r in rows) else None


def _beside(fit: Fit, i: int, model: Model, lost: Bools) -> Array:
    """Return poses of some rows (N, 8 or 16), led from the used row with the nearest joints."""
    data, state = fit.problem.datasets[i], fit.state
    used = np.flatnonzero(fit.keep[i] & finite_rows(state.poses[i]))
    out = np.full_like(state.poses[i], np.nan)
    if not used.size:
        return out
    at = np.flatnonzero(lost)
    away = np.linalg.norm(data.q[at][:, None] - data.q[used][None], axis=-1)
    start = state.poses[i].copy()
    start[at] = start[used[np.argmin(np.nan_to_num(away, nan=np.inf), axis=1)]]
    ends = fit.problem.ends(i, replace(state, poses=tuple(
        start if j == i else p for j, p in enumerate(state.poses))))
    found = [settle(model, np.where(lost[:, None], q, np.nan), fit.problem.environments[i], pose)[0]
             for q, pose in ends]
    out[lost] = np.concatenate(found, axis=1)[lost]
    return out


def _judged(fit: Fit, rows: Sequence[Bools]
            ) -> tuple[list[Bools], tuple[dict[int, str], ...], int]:
    """Return rows to use, reasons for those left out, and the number of ``rows`` that belong."""
    keep, reasons = [k.copy() for k in fit.keep], [dict(r) for r in fit.reasons]
    found = distances(fit.problem, fit.state, prediction_covariance(fit), keep)
    weights = found.weights(keep, fit.noise_factor)
    away, back = found.over_noise(fit.noise_factor), 0
    for i, some in enumerate(rows):
        for n in np.flatnonzero(some & (found.size[i] > 0)).tolist():
            if weights[i][n] >= float(NO_WEIGHT):
                keep[i][n] = True
                del reasons[i][n]
                back += 1
                continue
            reasons[i][n] = (f"no pose at the start; at the fitted machine {away[i][n]:.1f} times "
                             "the noise")
    return keep, tuple(reasons), back
