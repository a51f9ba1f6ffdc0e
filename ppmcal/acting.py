"""Adding an effect to a machine: its parameters, named and in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ppmcal.effects import EffectKind
from ppmcal.mechanism import Effect, Mechanism
from ppmcal.parameters import Parameter, free_indices


@dataclass(frozen=True)
class Given:
    """What is known of one parameter of an effect, SI."""

    value: float
    tolerance: float | None = None
    free: bool = False
    nominal: float | None = None
    sigma: float | None = None


def resolved(quantity: str, joint: str) -> str:
    """Return a quantity with ``joint`` and ``load`` replaced by the actuator's own."""
    load = {"length": "N", "angle": "N.m"}[joint]
    return quantity.replace("joint", joint).replace("load", load)


def joint_quantity(mechanism: Mechanism, on: Sequence[bool]) -> str:
    """Return ``length`` or ``angle``: what the first of the actuators ``on`` measures."""
    return next(q for q, used in zip(mechanism.actuator_quantity, on, strict=True) if used)


def effect_label(mechanism: Mechanism, kind: EffectKind, on: Sequence[bool]) -> str:
    """Return a new name for an effect: ``backlash``, ``backlash.leg1+leg2``, ``backlash.2``."""
    where = "+".join(a for a, used in zip(mechanism.actuators, on, strict=True) if used)
    base = kind.name if all(on) else f"{kind.name}.{where}"
    label, count = base, 1
    while any(n.rpartition(".")[0] == label for n in mechanism.names):
        count += 1
        label = f"{base}.{count}"
    return label


def with_effect(mechanism: Mechanism, kind: EffectKind, on: Sequence[bool],
                given: Mapping[str, Given]) -> Mechanism:
    """Return the machine with one more effect.

    Args:
        mechanism: the machine so far.
        kind: of the effect.
        on: actuators that it acts on (k,).
        given: by name of the kind's parameters; those left out have their default.
    """
    joint = joint_quantity(mechanism, on)
    label = effect_label(mechanism, kind, on)
    made = []
    for spec in kind.parameters(mechanism.motion):
        g = given.get(spec.name, Given(0.0 if spec.default is None else spec.default))
        made.append(Parameter(
            f"{label}.{spec.name}", resolved(spec.quantity, joint), g.value,
            g.value if g.nominal is None else g.nominal, g.tolerance, not g.free, False, (),
            g.sigma, g.free, 0.1 * g.value if spec.reciprocal else spec.size, spec.reciprocal))
    first = len(mechanism.parameters)
    index = {s.name: first + i for i, s in enumerate(kind.parameters(mechanism.motion))}
    parameters = (*mechanism.parameters, *made)
    chosen = free_indices(made, None)
    return replace(mechanism, parameters=parameters,
                   effects=(*mechanism.effects, Effect(kind, tuple(on), index)),
                   free=(*mechanism.free, *(first + i for i in chosen)))
