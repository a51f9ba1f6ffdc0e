"""The influence of a machine's effects at given poses: shifted models, and derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.loads import limb_forces, loads, rope_tensions, spans, tensions
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import (
    Dataset,
    Environment,
    environment,
    unknown_environment,
    with_platform_directions,
)
from ppmcal.model.effects import (
    EffectKind,
    LimbSetting,
    Setting,
    Shift,
    Terms,
    total,
)
from ppmcal.model.history import History
from ppmcal.model.mechanism import Effect, Mechanism, with_effect
from ppmcal.model.motions import Motion
from ppmcal.model.parameters import Parameter

ROUNDS = 40
SETTLED = 1e-12
"""Loads, slots and poses are consistent if they change by less than this part of the reach."""
NO_FACTOR = 1e-8
"""Relative to the reach, the root of round-off: smaller moves do not show whether they shrink."""


def environment_of(mechanism: Mechanism, data: Dataset) -> Environment:
    """Return the environment of a data set's rows."""
    whole = data.entire
    # for a distance between two positions the order in which they were visited is unknown
    q = whole.q if whole.to_q is None else np.full_like(whole.q, np.nan)
    seen = environment(whole.columns, mechanism.actuators, mechanism.gravity, q,
                       whole.approach == "sequence")
    place = seen.place if data.place is None or seen.place is None else seen.place[data.place]
    found = replace(environment(data.columns, mechanism.actuators, mechanism.gravity, data.q),
                    row=data.numbers().astype(float), history=seen.history, place=place,
                    touch=np.full(len(data), data.kind.touches),
                    stood=data.groups if data.kind.blind else None)
    visited = data.directions()
    if visited is not None:
        return replace(found, approach=visited)
    axes = [f"dir_{c}" for c in "xyz"]
    if not any(a in data.columns for a in axes):
        return found
    blank = np.full(len(data), np.nan)
    by_axis = np.stack([data.columns.get(a, blank) for a in axes], axis=-1)
    model = Model(mechanism.nominal())
    pose = forward(model, data.q).pose
    rows = np.flatnonzero(finite_rows(pose))
    drive = np.zeros((len(data), len(mechanism.actuators), 3))
    if rows.size:
        closure = model.closure(data.q[rows])
        lines = closure.lines(pose[rows])
        moves = -linalg.pinv(closure.joint_matrix(pose[rows], lines)) @ closure.pose_matrix(
            pose[rows], lines)
        for column, c in enumerate(mechanism.dof):
            if c < 3:
                drive[rows, :, c] = moves[..., column]
    return with_platform_directions(found, by_axis, drive).with_directions()


def _where_joints_stood(model: Model, pose: Array, place: Ints) -> Array:
    """Return the joint values (N, k) at which all limbs close, the same at one place.

    If readings are the only measurements, an effect that followed them would follow their noise:
    a wave could imitate it, and a machine that is smaller by a scale has smaller gaps.
    """
    q = inverse(model, pose).q
    _, at = np.unique(place, return_inverse=True)
    out = np.empty_like(q)
    known = finite_rows(q)
    for column, values in enumerate(q.T):
        total = np.bincount(at, np.where(known, values, 0.0))
        out[:, column] = (total / np.maximum(np.bincount(at, known), 1.0))[at]
    return np.where(known[:, None], out, np.nan)


def setting(model: Model, environment: Environment, q: Array, pose: Array,
            loaded: Model | None = None) -> Setting:
    """Return what effects may use about N rows.

    Args:
        model: the machine without effects.
        environment: of the rows.
        q: joint values (N, k).
        pose: platform motors (N, 8).
        loaded: the machine that closes at these poses, for the loads; default ``model``.
    """
    mechanism = model.mechanism
    if environment.stood is not None:
        q = _where_joints_stood(loaded or model, pose, environment.stood)
    ratio = np.ones(len(mechanism.actuators))
    limbs = []
    for i, limb in enumerate(mechanism.limbs):
        values = model.limb_values[i]
        if limb.driven:
            ratio[limb.actuator] = values.get("ratio", 1.0)
        bars = [s.name for s in limb.kind.slots if s.is_bar]
        struts = {s: np.asarray(values[s], dtype=float) for s in bars}
        if not bars and limb.kind.actuator == "length":
            struts = {"offset": model.joint_coordinate(i, q)}
        ends = [{s: np.asarray(v, dtype=float) for s, v in values.items()
                 if s.rpartition(".")[0] == limb.kind.point(end)} for end in ("base", "platform")]
        limbs.append(LimbSetting(limb.actuator, struts, ends[0], ends[1], limb.kind.pulls_only))
    closed = loaded or model
    known = Setting(
        mechanism.motion, np.array([q == "angle" for q in mechanism.actuator_quantity]),
        ratio * q, np.sort(ratio[:, None] * mechanism.limits, axis=1), environment.approach,
        ratio * environment.velocity, environment.temperature, environment.wrench, environment.time,
        environment.row, tuple(limbs), lambda wrench: loads(closed, q, pose, wrench),
        lambda wrench: limb_forces(closed, q, pose, wrench), environment.weight, mechanism.gravity,
        cga.rotation_matrix(pose), history=environment.history, place=environment.place,
        ratio=ratio, touch=environment.touch,
        past_load_of=lambda: _past_loads(mechanism, environment.history, model.parameters),
        tensions_of=lambda on: tensions(closed, q, pose, on),
        tension_of=lambda wrench: rope_tensions(closed, q, pose, wrench, environment.tension),
        span_of=lambda: spans(closed, q, pose),
        pose_of=lambda: np.concatenate([cga.translation(pose), cga.rotation_vector(pose)], axis=1))
    return _carrying(mechanism, model.parameters, known)


def _carrying(mechanism: Mechanism, g: Array, known: Setting) -> Setting:
    """Return the setting with the load that the platform carries by the effects at ``g`` (P,)."""
    weight, wrench = known.weight, known.wrench
    carried: tuple[str | float, ...] = ()
    for effect in mechanism.effects:
        if effect.kind.carried is not None:
            values = {name: float(g[p]) for name, p in effect.parameters.items()}
            carried += (effect.kind.name, *values.values())
            weight, wrench = effect.kind.carried(
                replace(known, weight=weight, wrench=wrench), values)
    if wrench is known.wrench:
        return known
    return replace(known, weight=weight, wrench=wrench, known=known, carried=carried,
                   past_load_of=lambda: _past_loads(mechanism, known.history, g))


def _past_loads(mechanism: Mechanism, history: History | None, g: Array) -> Array:
    """Return the loads on the actuators at each row of a history (H, k), nominal geometry.

    An error of the geometry changes them by its part of the reach, some thousandth of them.
    The load that the platform carries is that of the effects at ``g`` (P,).
    """
    if history is None:
        return np.full((0, len(mechanism.actuators)), np.nan)
    bare = Model(replace(mechanism.nominal(), effects=()))
    pose = history.once("pose", lambda: forward(bare, history.q).pose)
    rows = replace(unknown_environment(*history.q.shape), wrench=history.wrench,
                   weight=history.weight)
    at = _carrying(mechanism, g, setting(bare, rows, history.q, pose))
    rests = np.all(history.wrench == 0.0, axis=1)[:, None]
    return history.once(f"loads {at.carried}", lambda: np.where(rests, 0.0, at.load))


def effect_terms(mechanism: Mechanism, g: Array, at: Setting) -> list[tuple[Effect, Terms]]:
    """Return the shift by each effect at parameters ``g`` (P,), with its derivatives."""
    out = []
    for effect in mechanism.effects:
        values = {name: float(g[p]) for name, p in effect.parameters.items()}
        until = _until(mechanism, g, effect)
        own = at if until is None else replace(at, until=until)
        terms = effect.kind.evaluate(own, np.array(effect.on), values)
        if effect.kind.carried is not None:
            terms = Terms(terms.shift, {n: _by_carried(mechanism, g, at, p)
                                        for n, p in effect.parameters.items()})
        out.append((effect, terms))
    return out


def carried_by(kind: EffectKind, model: Model, at: Setting,
               borne: Callable[[Setting], Shift] | None = None) -> Mapping[str, Shift]:
    """Return the derivatives of a shift by the parameters of a kind of carried load.

    Args:
        kind: with ``carried``; at the model's values if it has the effect, else at 0.
        model: the machine at its parameters.
        at: its rows.
        borne: the compliance under the load; default the model's own effects.
    """
    mechanism = model.mechanism
    if not any(e.kind is kind for e in mechanism.effects):
        mechanism = with_effect(mechanism, kind, (True,) * len(mechanism.actuators), {})
    g = np.concatenate([model.parameters, mechanism.values[len(model.parameters):]])
    own = next(e for e in reversed(mechanism.effects) if e.kind is kind)
    return {n: _by_carried(mechanism, g, at, p, borne) for n, p in own.parameters.items()}


CARRIED_STEP = 1e-4
"""Step of central differences, m or rad: exact for kinds that are linear in the load."""


def _by_carried(mechanism: Mechanism, g: Array, at: Setting, p: int,
                borne: Callable[[Setting], Shift] | None = None) -> Shift:
    """Return the derivative of the shift of all other effects by the carried load."""
    others = replace(mechanism, effects=tuple(
        e for e in mechanism.effects if e.kind.carried is None
        and (e.kind.uses_load or {"load", "wrench"} & set(e.kind.needs))))
    sides = []
    for sign in (-1.0, 1.0):
        moved = g.copy()
        moved[p] += sign * CARRIED_STEP
        there = _carrying(mechanism, moved, at.known or at)
        shift = borne(there) if borne is not None else total(
            [t.shift for _, t in effect_terms(others, g, there)])
        sides.append(shift.times(sign / (2.0 * CARRIED_STEP)))
    return total(sides)


def _until(mechanism: Mechanism, g: Array, effect: Effect) -> Array | None:
    """Return the row from which another event replaces an event, by joint (k,)."""
    if not effect.kind.onset:
        return None
    mine = float(g[effect.parameters[effect.kind.onset]])
    out = np.full(len(mechanism.actuators), np.inf)
    for other in mechanism.effects:
        if other.kind is effect.kind and other is not effect:
            row = float(g[other.parameters[effect.kind.onset]])
            if row > mine:
                out = np.where(np.array(other.on), np.minimum(out, row), out)
    return out


def shifted(model: Model, environment: Environment, q: Array, pose: Array) -> Model:
    """Return the model with its effects at these rows; unchanged without effects.

    Loads are those of the machine that closes at these poses, including its effects.

    Args:
        model: the machine at its parameters.
        environment: the variables that effects depend on, N rows.
        q: joint values (N, k).
        pose: closed platform motors (N, 8), base frame.
    """
    if not model.mechanism.effects:
        return model
    now = shifted_once(model, environment, q, pose)
    if any(e.kind.uses_load for e in model.mechanism.effects):
        now = _settled(now, environment, q, pose)
    return now


def _settled(now: Model, environment: Environment, q: Array, pose: Array) -> Model:
    """Iterate loads and slots to consistency; slots of rows that do not converge are unknown."""
    reach = now.mechanism.reach
    last, lost = np.full(len(q), np.inf), np.zeros(len(q), dtype=bool)
    for left in range(ROUNDS - 1, -1, -1):
        before, now = now, shifted_once(now, environment, q, pose)
        change = slots_apart(before, now, len(q))
        lost |= hopeless(change, last, SETTLED * reach, left, reach)
        last = change
        if not np.any((change > SETTLED * reach) & ~lost):
            break
    if not lost.any() or now.shift is None:
        return now
    slots = {s: np.where(lost, np.nan, v) for s, v in now.shift.slots.items()}
    return replace(now, shift=replace(now.shift, slots=slots))


def hopeless(change: Array, last: Array, limit: float, left: int, reach: float) -> Bools:
    """Return which rows cannot settle in the remaining rounds (N,).

    An attracting fixed point is approached by the same factor in every round. A row whose
    last factor would not bring it below the limit in twice the remaining rounds, or that
    moved farther than in the previous round, has no equilibrium.

    Args:
        change: how far each row moved, m (N,), nan without a pose.
        last: the same in the previous round, inf in the first.
        limit: below which a row has settled, m.
        left: remaining rounds.
        reach: of the machine, m; moves below the root of round-off give no factor.
    """
    if not left:
        return np.asarray(change > limit)
    moves = (change > max(limit, NO_FACTOR * reach)) & np.isfinite(last)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(moves, change / last, 0.0)
        needed = np.log(limit / change) / np.log(factor)
    return np.asarray(moves & ((factor >= 1.0) | (needed > 2.0 * left)))


def shifted_once(model: Model, environment: Environment, q: Array, pose: Array) -> Model:
    """Return the model with its effects, with the loads of ``model`` as it is.

    One round of the iteration in :func:`shifted`; arguments as there.
    """
    at = setting(replace(model, shift=None), environment, q, pose, model)
    whole = total([t.shift for _, t in effect_terms(model.mechanism, model.parameters, at)])
    n = q.shape[0]
    slots = {s: np.broadcast_to(v, (n,)) for s, v in whole.slots.items()}
    return replace(model, shift=replace(whole, slots=slots))


def beyond(model: Model, environment: Environment, q: Array, pose: Array) -> list[str]:
    """Return which effect is outside its known range at each row, in words, with the range (N,).

    Empty where none is; arguments as for :func:`shifted`.
    """
    out = [""] * len(q)
    effects = model.mechanism.effects
    if not any(e.kind.known for e in effects):
        return out
    at = setting(replace(model, shift=None), environment, q, pose, model)
    units = model.mechanism.units
    for number, effect in enumerate(effects, 1):
        for known in effect.kind.known:
            celsius = known.quantity == "deg C"
            factor = 1.0 if celsius else units.factor(known.quantity)
            unit = known.quantity if celsius else units.name(known.quantity)
            on = np.array(effect.on)
            x, outside = known.outside(at, on)
            of_joint = known.value(at).ndim == 2
            names = [n for n, used in zip(model.mechanism.actuators, on, strict=True) if used]
            low, high = (v / factor + known.zero for v in (known.low, known.high))
            for n in np.flatnonzero(outside.any(axis=1)):
                j = int(np.argmax(outside[n]))
                whose = f"{names[j]} " if of_joint else ""
                out[n] = out[n] or (
                    f"effects[{number}] of the model is not known here: {whose}{known.input} = "
                    f"{x[n, j] / factor + known.zero:.6g} {unit}, known {low:.6g} to {high:.6g}")
    return out


def final_shift(mechanism: Mechanism) -> Shift:
    """Return the permanent changes of frame and target, one row, after all events."""
    bare, k = replace(mechanism, effects=()), len(mechanism.actuators)
    at = setting(Model(bare), unknown_environment(1, k), np.full((1, k), np.nan),
                 mechanism.home[None])
    terms = effect_terms(mechanism, mechanism.values, at)
    return total([t.shift for e, t in terms if e.kind.onset and e.kind.instrument])


def slots_apart(before: Model, now: Model, rows: int) -> Array:
    """Return the largest difference of slots between two shifted models, row by row (N,)."""
    old, new = (m.shift.slots if m.shift else {} for m in (before, now))
    out = np.zeros(rows)
    for slot, value in new.items():
        change = np.abs(value - old[slot]) if slot in old else np.full(rows, np.inf)
        out = np.maximum(out, np.where(np.isfinite(value), change, 0.0))
    return out


def with_strokes(mechanism: Mechanism, q: Array) -> Mechanism:
    """Return the machine with strokes that the file leaves open set from joint values (N, k)."""
    parameters = list(mechanism.parameters)
    travel = setting(Model(mechanism), unknown_environment(*q.shape), q,
                     np.full((q.shape[0], 8), np.nan)).travel
    for effect in mechanism.effects:
        ends = [effect.parameters[n] for n in effect.kind.stroke_ends(mechanism.motion)]
        on = np.array(effect.on)
        if not ends or np.isfinite(mechanism.limits[on]).all() or not _spread(
                effect, mechanism.motion, parameters):
            continue
        for p, end in zip(ends, (np.nanmin, np.nanmax), strict=True):
            if np.isnan(parameters[p].value):
                value = float(end(travel[:, on]))
                parameters[p] = replace(parameters[p], value=value, nominal=value)
    return replace(mechanism, parameters=tuple(parameters))


def _spread(effect: Effect, motion: Motion, parameters: Sequence[Parameter]) -> bool:
    """Whether an effect varies over the stroke at all."""
    own = [(s, parameters[effect.parameters[s.name]])
           for s in effect.kind.parameters(motion)]
    spread = [p for s, p in own if s.of_stroke or s.per_stroke]
    return not spread or any(p.free or p.value != 0.0 for p in spread)
