"""The row in which an event happened, from all rows of the campaign.

The search finds the onset from the training rows. Here every row near it is tried in the final fit:
with the step's own columns taken out of the model, the gain of a step from row r is profiled over
r; the interval has the rows within the 95 % point of chi-squared, with one degree of freedom, of
the best.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ppmcal import linalg
from ppmcal.calibration.fit import Fit, FitOptions
from ppmcal.diagnosis.at_sessions import session_starts
from ppmcal.diagnosis.linear_system import INVISIBLE, MOST_ROWS, System, build, range_basis
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.result import NamedEffect, Onset
from ppmcal.linalg import Array, Bools, finite_rows, subsample, unit_columns
from ppmcal.model.effects import ScanRange
from ppmcal.model.mechanism import Effect, Mechanism

LIKELY = float(chdtri(1.0, 0.05))
"""How much less than the best a row of the interval may explain, in variances of the noise."""
ROUNDS = 3
IN_STATE = 3.0
"""Rows with residuals up to this multiple of the noise belong to the state before or after,"""
LINEAR = 0.1
"""or up to this part of the step itself."""
NEAR = 25
"""Rows tried on each side of the onset found by the search."""


@dataclass(frozen=True)
class _Event:
    """One event: effects of one kind that start at one row, by their indices in the machine."""

    effects: tuple[int, ...]
    row: float


def refined(fit: Fit, options: FitOptions) -> tuple[Fit, dict[str, Onset]]:
    """Return the fit with every event at its most probable row, and the onsets by parameter name.

    Args:
        fit: of all rows, effects included.
        options: of the fits.
    """
    found: dict[str, Onset] = {}
    for _ in range(ROUNDS):
        moved = False
        for event in _events(fit.problem.mechanism, fit.state.g):
            onset = _profiled(fit, event)
            names = [_onset_name(fit.problem.mechanism, i) for i in event.effects]
            found |= dict.fromkeys(names, onset)
            if onset.row != event.row:
                fit = with_mechanism(fit, _moved(fit, names, onset.row), options)
                moved = True
        if not moved:
            break
    return fit, found


def with_onsets(effects: Sequence[NamedEffect], onsets: dict[str, Onset]
                ) -> tuple[NamedEffect, ...]:
    """Return the named effects, events with their onsets."""
    return tuple(replace(e, onset=next((onsets[p] for p in e.parameters if p in onsets), None))
                 for e in effects)


def _events(mechanism: Mechanism, g: Array) -> Iterator[_Event]:
    groups: dict[tuple[str, float], list[int]] = {}
    for i, effect in enumerate(mechanism.effects):
        if effect.kind.onset:
            row = float(g[effect.parameters[effect.kind.onset]])
            groups.setdefault((effect.kind.label, row), []).append(i)
    for (_, row), mine in groups.items():
        yield _Event(tuple(mine), row)


def _onset_name(mechanism: Mechanism, effect: int) -> str:
    own = mechanism.effects[effect]
    return mechanism.names[own.parameters[own.kind.onset]]


def _moved(fit: Fit, names: Sequence[str], row: int) -> Mechanism:
    """Return the machine with an event at another row, keeping fitted values."""
    mechanism = fit.problem.mechanism
    parameters = tuple(
        replace(p, value=float(row), nominal=float(row)) if p.name in names
        else replace(p, value=float(v)) for p, v in
        zip(mechanism.parameters, fit.state.g.tolist(), strict=True))
    return replace(mechanism, parameters=parameters)


def _profiled(fit: Fit, event: _Event) -> Onset:
    """Return the most probable row of an event and its interval."""
    mechanism = fit.problem.mechanism
    # rows next to a wrong onset may have been rejected as outliers
    there = [k | (o & finite_rows(p)) for k, o, p in zip(
        fit.keep, fit.outliers, fit.state.poses, strict=True)]
    keep: list[Bools] = subsample(there, MOST_ROWS)
    system = build(fit.problem, fit.state, keep)
    effects = [mechanism.effects[i] for i in event.effects]
    others = _others(mechanism, event)
    own = {p for e in (*effects, *others) for p in e.parameters.values()}
    rest = [c for c, p in enumerate((*fit.problem.free, *[-1] * (
        system.jacobian.shape[2] - len(fit.problem.free)))) if p not in own]
    # events of one joint replace each other: as cumulative steps they are linear
    flat = system.jacobian[..., rest].reshape(system.residual.size, -1)
    beside = np.zeros((len(flat), 0)) if not others else np.concatenate(
        [_steps(system, [e], _row(fit.state.g, e)) for e in others], axis=1)
    sizes = np.concatenate([_own_step(fit.state.g, e, others) for e in effects])
    here = _steps(system, effects, event.row) @ sizes
    used = np.concatenate([k[rows] for k, rows in zip(fit.keep, keep, strict=True)])
    weight = _in_a_state(system, here, _steps(system, effects, -np.inf) @ sizes, used)
    basis = _basis(weight[:, None] * flat, weight[:, None] * beside)
    target = _free_of(basis, (weight * (system.residual.reshape(-1) + here))[:, None])[:, 0]
    tried = _tried(system, mechanism, effects[0], event.row,
                   [_row(fit.state.g, e) for e in others])
    usual = np.concatenate([_usual(mechanism, fit.state.g, e) for e in effects])
    gains = np.array([_gain(
        _free_of(basis, weight[:, None] * _steps(system, effects, r)) * usual, target)
        for r in tried])
    noise = max(1.0, float(target @ target - gains.max()) / max(
        system.count - basis.shape[1] - sizes.size - 1, 1))
    near = tried[gains >= gains.max() - LIKELY * noise]
    best = int(tried[int(np.argmax(gains))])
    # an event that began with a session stays there if that is as probable as any other row
    begins = session_starts(fit.problem).values()
    least = LIKELY * noise if event.row in begins else 1e-9
    if event.row in tried and gains[tried == event.row][0] >= gains.max() - least:
        best = int(event.row)
    # rows between two used ones are all equally probable
    rows = np.concatenate([p.response.rows.row for p in system.parts])
    low = rows[rows < near.min()].max(initial=0.0) + 1.0
    return Onset(best, int(low), int(near.max()))


def _basis(geometry: Array, steps: Array) -> Array:
    """Return a basis (n, r) of whitened columns of geometry (n, C) and of other events (n, c).

    Directions that are invisible within the tolerances must not mimic a step: :data:`INVISIBLE`.
    """
    basis = range_basis(geometry, INVISIBLE)
    if not steps.shape[1]:
        return basis
    more = range_basis(unit_columns(_free_of(basis, steps)))
    return np.concatenate([basis, more], axis=1)


def _in_a_state(system: System, here: Array, after: Array, used: Bools) -> Array:
    """Return 1 for values (N m,) in use, or in the state before or after the event, otherwise 0.

    ``here``: the step's contribution now (N m,); ``after``: as if it had been present throughout.
    """
    before = system.residual + here.reshape(system.residual.shape)
    after = after.reshape(before.shape)
    # a step of many millimetres is not linear
    limit = np.maximum(IN_STATE, LINEAR * np.sqrt(np.mean(after**2, axis=1)))
    near = [np.sqrt(np.mean(s**2, axis=1)) < limit for s in (before, before - after)]
    return np.repeat((used | near[0] | near[1]).astype(float), before.shape[1])


def _row(g: Array, effect: Effect) -> float:
    return float(g[effect.parameters[effect.kind.onset]])


def _others(mechanism: Mechanism, event: _Event) -> list[Effect]:
    """Return other events of the same kind on the same joints."""
    mine = [mechanism.effects[i] for i in event.effects]
    on = np.any([e.on for e in mine], axis=0)
    return [e for i, e in enumerate(mechanism.effects) if e.kind is mine[0].kind
            and i not in event.effects and (np.array(e.on) & on).any()]


def _own_step(g: Array, effect: Effect, others: Sequence[Effect]) -> Array:
    """Return the change of an event relative to the previous one on its joints (c,)."""
    before = [e for e in others if _row(g, e) < _row(g, effect)
              and (np.array(e.on) & np.array(effect.on)).any()]
    last = max(before, key=lambda e: _row(g, e), default=None)
    return np.array([g[p] - (g[last.parameters[n]] if last else 0.0)
                     for n, p in effect.parameters.items() if n != effect.kind.onset])


def _tried(system: System, mechanism: Mechanism, effect: Effect, row: float,
           others: Sequence[float]) -> Array:
    """Return the rows to try: those nearby, and not beyond another event."""
    rows = np.unique(np.concatenate([p.response.rows.row for p in system.parts]))
    spec = next(s for s in effect.kind.parameters(mechanism.motion) if s.name == effect.kind.onset)
    assert spec.scan is not None
    all_rows = np.union1d(rows[1:], spec.scan(ScanRange(1.0, rows.size, tuple(rows.tolist()))))
    at = int(np.searchsorted(all_rows, row))
    near = np.union1d(all_rows[max(at - NEAR, 0):at + NEAR + 1], [row])
    low = max((o for o in others if o < row), default=-np.inf)
    high = min((o for o in others if o > row), default=np.inf)
    return np.asarray(near[(near > low) & (near < high)])


def _steps(system: System, effects: Sequence[Effect], row: float) -> Array:
    """Return the whitened columns (N m, c) of the events' sizes, with onset at a row."""
    out = []
    for effect in effects:
        values = dict.fromkeys(effect.parameters, 0.0) | {effect.kind.onset: row}
        terms = [effect.kind.evaluate(p.setting, np.array(effect.on), values).by
                 for p in system.parts]
        out += [system.column([by[n] for by in terms]).reshape(-1)
                for n in effect.parameters if n != effect.kind.onset]
    return np.stack(out, axis=-1)


def _free_of(basis: Array, columns: Array) -> Array:
    return np.asarray(columns - basis @ (basis.T @ columns))


def _gain(columns: Array, target: Array) -> float:
    """Return the reduction of the target's (n,) sum of squares by columns (n, c).

    Columns are in units of their usual size, which acts as a prior as in the fit: rows linearised
    beyond a step differ slightly from those before it, and a huge size would make that any step.
    """
    size = linalg.lstsq(np.concatenate([columns, np.eye(columns.shape[1])]),
                        np.concatenate([target, np.zeros(columns.shape[1])]))[0]
    return float(target @ (columns @ size))


def _usual(mechanism: Mechanism, g: Array, effect: Effect) -> Array:
    """Return the usual size of each coordinate of an event's step (c,), SI.

    Without a tolerance its fitted size, and at least a significant change.
    """
    return np.array([
        mechanism.parameters[p].prior_sigma or max(abs(float(g[p])),
                                                   mechanism.parameters[p].size or 0.0)
        for n, p in effect.parameters.items() if n != effect.kind.onset])
