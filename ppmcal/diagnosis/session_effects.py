"""Whether an effect belongs to the machine or to a session: its size in each session.

In the final fit the columns of an effect are split by session, all other columns stay shared. At
the minimum only these split columns have a gradient, so that one linear step gives the sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Fit, column_scale, coverage_of, residual_freedom, variances
from ppmcal.diagnosis.hypotheses import UNLIKE
from ppmcal.diagnosis.linear_system import MOST_ROWS, System, build
from ppmcal.diagnosis.result import NamedEffect, SessionEffect
from ppmcal.inference.differences import differing
from ppmcal.inference.priors import SURE, UNKNOWN
from ppmcal.linalg import Array, Bools, subsample
from ppmcal.model.sessions import session_masks
from ppmcal.notes import Note
from ppmcal.wording import actuator_list

SEEN = 1e-10
"""An effect is not observable in a session with less than this part of its squared column."""


def with_sessions(fit: Fit, effects: Sequence[NamedEffect]
                  ) -> tuple[tuple[NamedEffect, ...], list[Note]]:
    """Return the effects with their size in each session, and notes on differences.

    Args:
        fit: of all rows, effects included.
        effects: named ones; events and slots of the geometry have no size by session.
    """
    found = session_effects(fit, effects)
    mechanism = fit.problem.mechanism
    told = []
    for effect, sizes in zip(effects, found, strict=True):
        if sizes is not None and sizes.same < 1.0 - SURE.value:
            first = sizes.names[0]
            quantity = mechanism.parameters[mechanism.names.index(first)].quantity
            unit = mechanism.units.factor(quantity)
            each = ", ".join(
                f"{value / unit:.3g} ± {half / unit:.2g} {mechanism.units.name(quantity)} in "
                f"{label}" for label, value, half in zip(
                    sizes.labels, sizes.value[:, 0], sizes.times * sizes.sigma[:, 0],
                    strict=True))
            place = actuator_list(effect.on, len(mechanism.actuators))
            # one hypothesis may have a value for each of several actuators
            kind = effect.hypothesis.label.partition(" on ")[0].removesuffix(UNLIKE)
            name = f"{kind} on {place}" if place else kind
            told.append(Note(f"{name} differs between sessions (equal with probability "
                             f"{sizes.same:.1g}): {first.rpartition('.')[2]} {each} (95 %)",
                             topic="sessions"))
    told += _begun(effects, len(mechanism.actuators))
    return tuple(replace(e, sessions=s) for e, s in zip(effects, found, strict=True)), told


def _begun(effects: Sequence[NamedEffect], count: int) -> list[Note]:
    """Return notes on events that begin with a session, joints of one event together."""
    on: dict[tuple[str, str, bool], list[str]] = {}
    for effect in effects:
        h = effect.hypothesis
        if h.begins:
            on.setdefault((h.called, h.begins, h.beside), []).extend(effect.on)
    out = []
    for (name, session, first), joints in on.items():
        place = actuator_list(joints, count)
        what = f"{name} on {place}" if place else name
        out.append(Note(f"{what} is already present in session {session}, relative to the drawing"
                        if first else f"{what} begins with session {session}: the machine or the "
                        "instrument was set up differently before it", topic="sessions"))
    return out


def session_effects(fit: Fit, effects: Sequence[NamedEffect]) -> list[SessionEffect | None]:
    """Return each effect's size by session; None if observable in fewer than two."""
    labels = session_masks(fit.problem.datasets)
    if len(labels) < 2:
        return [None] * len(effects)
    system = build(fit.problem, fit.state, subsample(fit.keep, MOST_ROWS))
    masks = [_rows(system, mask) for _, mask in labels]
    names = [fit.problem.mechanism.names[p] for p in fit.problem.free]
    out: list[SessionEffect | None] = []
    for effect in effects:
        own = [names.index(n) for n in effect.parameters if n in names]
        plain = effect.hypothesis.slot or effect.onset is not None
        out.append(None if plain or not own else _cut(fit, system, own, masks,
                                                      [label for label, _ in labels]))
    return out


def _rows(system: System, mask: Sequence[Bools]) -> Bools:
    """Return which rows of a system are in a mask by data set (N,)."""
    return np.array([mask[d][n] for d, n in zip(system.dataset.tolist(), system.row.tolist(),
                                                strict=True)], dtype=bool)


def _cut(fit: Fit, system: System, own: Sequence[int], masks: Sequence[Bools],
         labels: Sequence[str]) -> SessionEffect | None:
    scale = column_scale(fit.problem)
    columns = system.jacobian.shape[-1]
    rest = [c for c in range(columns) if c not in own]
    mine = system.jacobian[..., own]
    whole = np.sum(mine**2)
    seen = [s for s, m in enumerate(masks) if np.sum(mine[m] ** 2) > SEEN * whole]
    if len(seen) < 2:
        return None
    parts = [np.where(masks[s][:, None, None], mine, 0.0) for s in seen]
    matrix = np.concatenate([system.jacobian[..., rest], *parts], axis=-1)
    matrix = matrix.reshape(-1, matrix.shape[-1])
    weight = np.zeros(matrix.shape[1])
    weight[:len(rest)] = (fit.prior * scale)[rest] ** 2
    w, v = linalg.eigh(matrix.T @ matrix + np.diag(weight))
    use = w > SEEN * max(float(w[-1]), 1e-300)
    inverse = (v[:, use] / w[use]) @ v[:, use].T
    gradient = matrix.T @ system.residual.reshape(-1)
    gradient[:len(rest)] = 0.0
    left = len(rest)
    step = (inverse @ gradient)[left:].reshape(len(seen), len(own))
    degrees = residual_freedom(fit)
    noise = max(1.0, fit.information.square / degrees)
    covariance = inverse[left:, left:] * noise
    apart = _apart(step, covariance)
    size = scale[list(own)]
    parameters = [fit.problem.free[c] for c in own]
    value = fit.state.g[parameters] + step * size
    sigma = np.sqrt(np.diagonal(covariance)).reshape(step.shape) * size
    return SessionEffect(tuple(labels[s] for s in seen),
                         tuple(fit.problem.mechanism.names[p] for p in parameters), value, sigma,
                         apart, coverage_of(variances(fit.information.square / noise, degrees)))


def _apart(step: Array, covariance: Array) -> float:
    """Return the probability that all rows of ``step`` (S, p) are equal."""
    count, size = step.shape
    # differences from the first session
    differences = np.kron(np.concatenate([-np.ones((count - 1, 1)), np.eye(count - 1)], axis=1),
                          np.eye(size))
    away = differences @ step.reshape(-1)
    inverse = linalg.pinv(differences @ covariance @ differences.T, hermitian=True)
    odds = differing(float(away @ inverse @ away), (count - 1) * size)
    return 1.0 / (1.0 + odds * UNKNOWN.value / (1.0 - UNKNOWN.value))
