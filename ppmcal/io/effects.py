"""Reading and writing the ``effects`` of a mechanism or scenario file (contract section 4)."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.schema import (
    Flag,
    Label,
    Number,
    Sigma,
    Strict,
    check,
    is_number,
    refuse,
    show,
    times,
)
from ppmcal.model.effects import (
    GEOMETRY,
    SORTS,
    EffectKind,
    EffectParameter,
    effect_kinds,
    find_effect,
)
from ppmcal.model.limbs import LimbKind
from ppmcal.model.mechanism import (
    Effect,
    Given,
    Mechanism,
    joint_quantity,
    limbs_with_free,
    resolved,
    usable_joints,
    with_effect,
)
from ppmcal.model.motions import SPATIAL
from ppmcal.model.parameters import free_indices
from ppmcal.units import Units, to_file
from ppmcal.wording import pluralize


class ValueFile(Strict):
    """``{value, tolerance, free: true}``; ``nominal`` and ``sigma`` are written by identify."""

    value: Number | None = None
    """Present value, in the parameter's unit."""
    tolerance: Sigma | None = None
    """Standard deviation from `nominal` that is expected; without it there is no prior."""
    free: Flag | None = None
    """Whether identify fits it."""
    nominal: Number | None = None
    """Value before the fit, written by identify."""
    sigma: Sigma | None = None
    """Standard deviation of `value` after the fit, written by identify."""


def _value(raw: object) -> object:
    if isinstance(raw, dict):
        return raw
    if not is_number(raw, sys.float_info.max):
        raise refuse(f"{show(raw)} is not a parameter's value",
                     "Write a number, or {value: 0.02, tolerance: 0.01, free: true}")
    return {"value": raw}


class EffectFile(Strict):
    """``{kind: backlash, on: [leg1], parameters: {width: 0.02}}``."""

    model_config = ConfigDict(extra="allow")

    kind: Label
    """Kind of the effect."""
    on: list[Label] | None = None
    """Actuators that it acts on, sharing one value  [default: all]."""
    parameters: dict[Label, Annotated[ValueFile, BeforeValidator(_value)]] = Field(
        default_factory=dict)
    """Sizes, by name; those of the kind."""


class EffectsFile(Strict):
    """The list of effects."""

    effects: list[EffectFile]
    """The effects, one after another."""


def with_effects(mechanism: Mechanism, raw: object, units: Units, source: str) -> Mechanism:
    """Return the machine with the effects of a file added, the list ``raw`` (or None) in its units.

    Raises:
        BadInput: an unknown kind, actuator or parameter, a value out of range.
    """
    if raw is None or raw == []:
        return mechanism
    if not isinstance(raw, list):
        raise BadInput(f"{show(raw)} is not a list of effects", f"{source}: effects",
                       "Write [{kind: backlash, on: [leg1], parameters: {width: 0.02}}]")
    file = check(EffectsFile, {"effects": raw}, source)
    for i, one in enumerate(file.effects):
        place = f"{source}: effects[{i + 1}]"
        mechanism = (_geometry if one.kind == GEOMETRY else _added)(mechanism, one, units, place)
    return _with_free(mechanism)


def _with_free(mechanism: Mechanism) -> Mechanism:
    return replace(mechanism, free=tuple(free_indices(mechanism.parameters,
                                                      mechanism.free_patterns)))


def limb_entries(kind: LimbKind) -> tuple[str, ...]:
    """Return the keys of a limb that are parameters of an effect: of ropes what makes them longer.

    >>> from ppmcal.model.limbs.kind import find_kind
    >>> limb_entries(find_kind("rope"))
    ('elongation', 'weight')
    """
    if not kind.effect:
        return ()
    return tuple(s.name for s in find_effect(kind.effect).parameters(SPATIAL))


def with_limb_entries(mechanism: Mechanism, limbs: Sequence[Mapping[Any, Any]], units: Units,
                      source: str) -> Mechanism:
    """Return the machine with the effects that a file gives as entries of its ``limbs``.

    They are written as ``effects``, as which they are read again.

    Raises:
        BadInput: as :func:`with_effects`.
    """
    before = mechanism
    for limb, raw in zip(mechanism.limbs, limbs, strict=True):
        own = {name: raw[name] for name in limb_entries(limb.kind) if raw.get(name) is not None}
        if own:
            place = f"{source}: limbs.{limb.name}"
            one = check(EffectFile, {
                "kind": limb.kind.effect, "on": [mechanism.actuators[limb.actuator]],
                "parameters": own}, source, prefix=f"limbs.{limb.name}")
            mechanism = _added(mechanism, one, units, place)
    return before if mechanism is before else _with_free(mechanism)


def _added(mechanism: Mechanism, one: EffectFile, units: Units, place: str) -> Mechanism:
    refuse_unknown("effect", [one.kind], [*effect_kinds(), GEOMETRY], f"{place}.kind")
    kind = find_effect(one.kind)
    on = _actuators(one, kind, mechanism, place)
    joint = joint_quantity(mechanism, on)
    kind = _made(one, kind, joint, units, place)
    if not kind.exists_in(mechanism.motion):
        raise BadInput(kind.refused, f"{place}.kind", "Remove it")
    specs = kind.parameters(mechanism.motion)
    refuse_unknown("parameter", one.parameters, [s.name for s in specs], f"{place}.parameters")
    given = {s.name: _given(one, s, resolved(s.quantity, joint), units, place) for s in specs}
    if any(g.free for g in given.values()):
        _not_free_already(mechanism, kind, on, place)
    ends = kind.stroke_ends(mechanism.motion)
    if ends and given[ends[0]].value >= given[ends[1]].value:
        raise BadInput("the stroke ends where it begins, or before",
                       f"{place}.parameters.{ends[1]}",
                       f"Give a `{ends[1]}` above `{ends[0]}`, or neither")
    return with_effect(mechanism, kind, on, given)


def _made(one: EffectFile, kind: EffectKind, joint: str, units: Units, place: str) -> EffectKind:
    """Return the kind, made of the further entries of the file where it is one of those."""
    further = dict(one.model_extra or {})
    known = kind.from_file.entries if kind.from_file else ()
    refuse_unknown("key", further, ["kind", "on", "parameters", *known], place)
    if kind.from_file is None:
        return kind
    try:
        return kind.from_file.make(further, units, joint)
    except BadInput as error:
        raise BadInput(error.what, f"{place}.{error.where}", error.hint) from None


def _not_free_already(mechanism: Mechanism, kind: EffectKind, on: Sequence[bool],
                      place: str) -> None:
    for slot in kind.same_as:
        for limb in limbs_with_free(mechanism, (slot,), mechanism.free):
            if on[limb.actuator]:
                raise BadInput(f"the {slot} of {limb.name} is itself free", f"{place}.kind",
                               f"Fix the {slot}, or remove the {kind.name}: they are the same")


def _actuators(one: EffectFile, kind: EffectKind, mechanism: Mechanism, place: str
               ) -> tuple[bool, ...]:
    actuators = mechanism.actuators
    if not kind.per_actuator and one.on is not None and set(one.on) != set(actuators):
        raise BadInput(f"{kind.name} acts on the whole machine", f"{place}.on", "Remove `on`")
    chosen = list(actuators) if one.on is None else one.on
    refuse_unknown("actuator", chosen, actuators, f"{place}.on")
    on = tuple(a in chosen for a in actuators)
    quantities = {q for q, used in zip(mechanism.actuator_quantity, on, strict=True) if used}
    if not any(on):
        raise BadInput("the effect acts on no actuator", f"{place}.on", "Name at least one")
    usable = usable_joints(mechanism, kind)
    if kind.opposed and not mechanism.surplus:
        raise BadInput(f"{kind.name} is an effect of limbs that pull against each other, and this "
                       "machine has no more limbs than it needs", f"{place}.kind", "Remove it")
    if kind.joints in SORTS and not all(usable[np.array(on)]):
        sort, named = SORTS[kind.joints]
        raise BadInput(f"{kind.name} is an effect of {sort}", f"{place}.on", f"Name {named} only")
    if kind.opposed and sum(on) != mechanism.surplus:
        raise BadInput(f"{pluralize(sum(on), 'joint')} cannot pull at once: "
                       f"{len(on) - mechanism.surplus} must hold against them",
                       f"{place}.on", f"Name {mechanism.surplus}: those that pull")
    if kind.per_actuator and len(quantities) > 1:
        raise BadInput("the effect is shared by actuators that slide and others that turn",
                       f"{place}.on", "Write one effect for each sort")
    return on


def _given(one: EffectFile, spec: EffectParameter, quantity: str, units: Units, place: str
           ) -> Given:
    factor = units.factor(quantity)
    where = f"{place}.parameters.{spec.name}"
    given = times(one.parameters.get(spec.name, ValueFile()), factor)
    value = spec.default if given.value is None else given.value
    if value is None:
        unit = units.name(quantity) or "plain numbers"
        raise BadInput(f"the parameter '{spec.name}' has no value", where,
                       f"Add `{spec.name}: ...` in {unit}")
    # a fit may end beyond the range: what it found stands, with its sigma, and must read back
    fitted = given.sigma is not None and spec.low <= 0.0
    if not np.isnan(value) and not fitted and not spec.low <= value <= spec.high:
        low, high = spec.low / factor, spec.high / factor
        raise BadInput(f"{value / factor:g} is outside the physical range "
                       f"{low:g} to {high:g} {units.name(quantity)}", where,
                       "Check value and unit")
    if given.free and spec.constant:
        raise BadInput(f"'{spec.name}' cannot be fitted", where, "Remove `free`")
    return Given(value, given.tolerance, bool(given.free), given.nominal, given.sigma)


def _geometry(mechanism: Mechanism, one: EffectFile, units: Units, place: str) -> Mechanism:
    """Add errors of slots to the geometry itself."""
    made = list(mechanism.parameters)
    index = {n: i for i, p in enumerate(made) for n in (p.name, *p.aliases)}
    refuse_unknown("parameter", one.parameters, index, f"{place}.parameters")
    for name, given in one.parameters.items():
        p = made[index[name]]
        own, free = times(given, units.factor(p.quantity)), bool(given.free)
        made[index[name]] = replace(
            p, value=p.value + (own.value or 0.0), free=p.free or free,
            fixed=p.fixed and not free,
            tolerance=p.tolerance if own.tolerance is None else own.tolerance)
    return replace(mechanism, parameters=tuple(made))


def effects_tree(mechanism: Mechanism) -> list[dict[str, Any]]:
    """Return the ``effects`` list of a mechanism, in file units."""
    return [_written(mechanism, e) for e in mechanism.effects]


def _written(mechanism: Mechanism, effect: Effect) -> dict[str, Any]:
    out: dict[str, Any] = {"kind": effect.kind.name}
    if effect.kind.written is not None:
        out |= effect.kind.written(mechanism.units)
    if not all(effect.on):
        out["on"] = [a for a, used in zip(mechanism.actuators, effect.on, strict=True) if used]
    entries: dict[str, Any] = {}
    # a kind without its optional parameters is written as if it had none
    plain = {s.name: s.default for s in effect.kind.parameters(mechanism.motion) if s.optional}
    for name, i in effect.parameters.items():
        p = mechanism.parameters[i]
        if np.isnan(p.value) or (p.value == p.nominal == plain.get(name)
                                 and not p.free and p.tolerance is None):
            continue
        factor = mechanism.units.factor(p.quantity)
        parts: Mapping[str, float | None] = {
            "value": p.value, "nominal": None if p.nominal == p.value else p.nominal,
            "sigma": p.sigma, "tolerance": p.tolerance}
        entry: dict[str, Any] = {k: to_file(v, factor) for k, v in parts.items() if v is not None}
        if p.free:
            entry["free"] = True
        entries[name] = entry["value"] if set(entry) == {"value"} else entry
    out["parameters"] = entries
    return out
