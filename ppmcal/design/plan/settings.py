"""Effects that a plan shall make visible, and the settings under which each pose is offered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import with_strokes
from ppmcal.kinematics.loads import loads, pretensions
from ppmcal.kinematics.needed_columns import by_load, remembers
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import STANDARD_GRAVITY
from ppmcal.model.effects import SORTS, EffectKind, EffectParameter, effect_kinds
from ppmcal.model.mechanism import (
    Given,
    Mechanism,
    joint_groups,
    joint_quantity,
    limbs_with_free,
    resolved,
    usable_joints,
    with_effect,
)
from ppmcal.model.parameters import free_indices

PLACE = "--for"
SETTABLE = ("dir", "vel", "load", "wrench", "temperature", "tension")
MOST_SETTINGS = 8
"""Settings under which one pose is offered, drawn where there are more."""
CROSSING = 10.0
"""Seconds that a joint takes through its range at the faster of two speeds."""
SLOWER = 0.2
STIFF = 1e-6
"""A stiffness that nobody knows gives way by this part of the reach, or of 1 rad: next to
nothing, since only how its effect is spread over the rows counts."""


@dataclass(frozen=True, eq=False)
class PlanSettings:
    """What the user wants the measurements to show besides geometry.

    ``kinds`` of effects; ``payload`` kg, ``temperature`` K and ``tension``, the mean with which
    ropes are pulled tight, N: the two ends that can be set, or None.
    """

    kinds: tuple[str, ...] = ()
    payload: tuple[float, float] | None = None
    temperature: tuple[float, float] | None = None
    tension: tuple[float, float] | None = None


def needs(asked: PlanSettings, mechanism: Mechanism) -> set[str]:
    """Return the columns that the kinds depend on."""
    return {n for kind in asked.kinds for n in by_load(effect_kinds()[kind].needs, mechanism)}


def with_kinds(mechanism: Mechanism, asked: PlanSettings, q: Array) -> Mechanism:
    """Return the nominal machine with the effects that are asked for, to be fitted.

    One effect for each actuator, as the file has it where it has that kind already. Other
    effects of the file are left out.

    Args:
        mechanism: as in its file.
        asked: what to show.
        q: joint values of the candidates (K, k), for the stroke.

    """
    own = [e for e in mechanism.effects if e.kind.name in asked.kinds]
    others = {p for e in mechanism.effects for p in e.parameters.values()}
    out = replace(mechanism.nominal(), effects=tuple(own),
                  free=tuple(p for p in mechanism.free if p not in others))
    made = list(out.parameters)
    for effect in own:
        fitted = [s.name for s in effect.kind.parameters(out.motion) if not s.constant
                  and not (s.optional and made[effect.parameters[s.name]].value == s.default)]
        for name in fitted:
            made[effect.parameters[name]] = replace(made[effect.parameters[name]], free=True)
    kept = {p for e in own for n, p in e.parameters.items() if made[p].free}
    out = replace(out, parameters=tuple(made), free=tuple(sorted({*out.free, *kept})))
    for name in asked.kinds:
        if name not in {e.kind.name for e in own}:
            out = _added(out, effect_kinds()[name], asked)
    return with_strokes(out, q) if out.effects else out


def refuse(mechanism: Mechanism, asked: PlanSettings) -> None:
    """Refuse kinds that cannot be planned for.

    Raises:
        BadInput: an unknown kind, or one that no choice of poses and settings can show.
    """
    for name in asked.kinds:
        _refuse(mechanism, name, asked)


def _refuse(mechanism: Mechanism, name: str, asked: PlanSettings) -> None:
    if name not in effect_kinds():
        raise unknown("effect", name, effect_kinds(), PLACE)
    kind = effect_kinds()[name]
    if not kind.exists_in(mechanism.motion):
        raise BadInput(kind.refused, PLACE, "Remove it")
    if not usable_joints(mechanism, kind).any():
        raise BadInput(f"{name} is an effect of {SORTS[kind.joints][0]}: this machine has none"
                       + kind.opposed * " that pull against each other", PLACE, "Remove it")
    own = tuple(e for e in mechanism.effects if e.kind.name == name)
    if {"order", "past"} & set(kind.needs) or remembers(replace(mechanism, effects=own)):
        raise BadInput(f"{name} cannot be planned for: it depends on the way from pose to pose",
                       PLACE, f"Leave it out, and {kind.remedy}")
    wanted = by_load(kind.needs, mechanism)
    for need in wanted:
        if need == "tension" and asked.tension is None:
            raise BadInput(f"{name} shows only where ropes are pulled tight by several forces",
                           PLACE, "Say by which they can be, in the mean, for example "
                           '--tension "20,80" (N)')
        if need not in SETTABLE:
            raise BadInput(f"{name} cannot be planned for: it depends on {need}, which passes by "
                           "itself", PLACE, "Go back to one pose now and then, and record `time`")
        if need in ("load", "wrench") and asked.payload is None:
            raise BadInput(f"{name} shows only under load", PLACE,
                           'Say which payloads can be put on, for example --payload "0,20" (kg)')
        if need == "temperature" and asked.temperature is None:
            raise BadInput(f"{name} shows only where the temperature changes", PLACE,
                           'Say between which it can be set, for example --temperature "18,26"')
    if need_load(wanted) and not np.any(mechanism.gravity):
        raise BadInput(f"{name} needs the direction of weight", PLACE, "Give `gravity`")
    bearing = [effect_kinds()[k] for k in asked.kinds if k in effect_kinds()]
    if kind.carried is not None and not any(
            k.uses_load and k.carried is None for k in bearing):
        raise BadInput(f"{name} shows only through what gives way to the load", PLACE,
                       f"Ask for such a kind too, for example --for compliance --for {name}")
    if kind.by_sign and asked.payload is not None and min(asked.payload) <= 0.0:
        raise BadInput(f"{name} jumps where the load changes its sign; without payload the sign "
                       "is not known", "--payload", "Give two payloads above 0")
    given = {e.kind.name for e in mechanism.effects}
    if kind.from_file is not None and kind.variants is not None and name not in given and (
            not kind.variants(mechanism.motion)):
        raise BadInput(f"{name} is made of what a file says, and the file has none", PLACE,
                       f"Put it with its {kind.from_file.entries[0]} among the file's `effects`")
    for spec in kind.parameters(mechanism.motion):
        if name not in given and _must_be_given(spec):
            raise BadInput(f"{name} cannot be planned for without its {spec.name}", PLACE,
                           f"Put {name} with its {spec.name} among the file's `effects`")
    for slot in kind.same_as:
        if limbs_with_free(mechanism, (slot,), mechanism.free):
            raise BadInput(f"a {slot} is itself free: {name} is the same", PLACE,
                           f"Remove {name}")


def need_load(needed: Sequence[str]) -> bool:
    """Whether columns depend on the payload."""
    return bool({"load", "wrench"} & set(needed))


def _must_be_given(spec: EffectParameter) -> bool:
    """Whether an effect is not linear in a parameter and nothing says how large it is."""
    return (spec.nonlinear and not spec.optional) or (
        spec.default is None and spec.low > 0.0 and not spec.reciprocal)


def _added(mechanism: Mechanism, kind: EffectKind, asked: PlanSettings) -> Mechanism:
    """Return the machine with one more effect for each actuator, or for the whole machine."""
    count = len(mechanism.actuators)
    which = (joint_groups(mechanism, kind) if kind.per_actuator else [(True,) * count])
    for on in which:
        mechanism = with_effect(mechanism, kind, on, {
            s.name: Given(_value(mechanism, s, on, asked), free=not (s.constant or s.optional))
            for s in kind.parameters(mechanism.motion)})
    return replace(mechanism, free=tuple(sorted({*mechanism.free, *free_indices(
        mechanism.parameters, ())})))


def _value(
    mechanism: Mechanism, spec: EffectParameter, on: Sequence[bool], asked: PlanSettings
) -> float:
    """Return where the linear model of an effect is taken: at next to nothing."""
    if not spec.reciprocal:
        return 0.0 if spec.default is None else spec.default
    joint = joint_quantity(mechanism, on)
    weight = STANDARD_GRAVITY * max(asked.payload or (1.0,))
    turns = resolved("joint", joint) == "angle"
    return weight * (mechanism.length_scale if turns else 1.0) / (
        STIFF * (1.0 if turns else mechanism.reach))


def offered(mechanism: Mechanism, asked: PlanSettings, q: Array, pose: Array, seed: int
            ) -> tuple[Ints, dict[str, Array]]:
    """Return under which settings each pose is offered; ``q`` (K, k), ``pose`` (K, 6).

    Returns:
        the pose of each row (R,), and its settings by column, SI (R,). Directions of approach
        come in opposite pairs, everything else at its ends.
    """
    rng = np.random.default_rng([seed, 2])
    wanted = needs(asked, mechanism)
    count, k = q.shape
    if not wanted:
        return np.arange(count), {}
    levels = _levels(wanted, asked)
    pairs = 2 if {"dir", "vel"} & wanted else 1
    size = len(levels) * 2 * pairs if {"dir", "vel"} & wanted else len(levels)
    pattern = rng.choice([-1.0, 1.0], (count, pairs, k))
    signs = np.concatenate([pattern, -pattern], axis=1)
    chosen = np.array([np.sort(rng.permutation(size)[:MOST_SETTINGS]) for _ in range(count)])
    at = np.repeat(np.arange(count), chosen.shape[1])
    which = chosen.ravel()
    level = {n: np.array([one[n] for one in levels])[which % len(levels)] for n in levels[0]}
    columns: dict[str, Array] = {}
    if {"dir", "vel"} & wanted:
        way = signs[at, which // len(levels)]
        columns |= {f"dir_{a}": way[:, i] for i, a in enumerate(mechanism.actuators)}
        if "vel" in wanted:
            speed = np.ptp(q, axis=0) / CROSSING
            columns |= {f"vel_{a}": way[:, i] * level["speed"] * speed[i]
                        for i, a in enumerate(mechanism.actuators)}
    if "tension" in level:
        columns |= _pulled(mechanism, q, pose, at, level)
    return at, columns | {n: v for n, v in level.items() if n not in ("speed", "tension")}


def _pulled(mechanism: Mechanism, q: Array, pose: Array, at: Ints, level: Mapping[str, Array]
            ) -> dict[str, Array]:
    """Return the tensions (R,) by column of ropes that are pulled tight evenly, and share a load.

    0 where they cannot pull against each other: nothing is to be seen there.
    """
    model = Model(replace(mechanism.nominal(), effects=()))
    here = pose_motor(pose)
    even = pretensions(model, q, here)
    ropes = [limb.actuator for limb in mechanism.limbs if limb.kind.pulls_only]
    out = even[at] * level["tension"][:, None]
    if "payload" in level:
        unit = np.concatenate([STANDARD_GRAVITY * mechanism.gravity, np.zeros(3)])
        out = out + loads(model, q, here, np.tile(unit, (len(q), 1)))[at] * (
            level["payload"][:, None])
    return {f"tension_{mechanism.actuators[a]}": np.nan_to_num(out[:, a]) for a in ropes}


def _levels(wanted: set[str], asked: PlanSettings) -> list[Mapping[str, float]]:
    """Return all combinations of what is set at two ends."""
    ends: dict[str, tuple[float, float]] = {}
    if {"load", "wrench"} & wanted and asked.payload:
        ends["payload"] = asked.payload
    if "temperature" in wanted and asked.temperature:
        ends["temperature"] = asked.temperature
    if "vel" in wanted:
        ends["speed"] = (SLOWER, 1.0)
    if "tension" in wanted and asked.tension:
        ends["tension"] = asked.tension
    out: list[Mapping[str, float]] = [{}]
    for name, values in ends.items():
        out = [{**one, name: v} for one in out for v in values]
    return out
