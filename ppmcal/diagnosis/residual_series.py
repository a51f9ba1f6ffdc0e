"""Residuals against the input that each named effect follows, before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.diagnosis.residual_profiles import Binned, ProfileErrors, binned
from ppmcal.diagnosis.result import Diagnosis, NamedEffect
from ppmcal.linalg import Array, Ints
from ppmcal.model.effects import EffectInput, Inputs
from ppmcal.model.effects.inputs import (
    DIRECTION,
    LOAD,
    POSE,
    TEMPERATURE,
    TIME,
    TRAVEL,
    VELOCITY,
)
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism, resolved

MOST_SERIES = 12
EACH, NOTICEABLE = 2, 0.2
"""An effect of the whole machine is shown in so many coordinates, where it is strongest, and
further ones only where it is at least this part as strong."""
FOLLOWED = 0.05
"""What is left is shown against the input that it follows with such a p-value."""
OF_JOINTS = (TRAVEL, DIRECTION, VELOCITY, LOAD, TEMPERATURE, TIME)
"""Inputs that joints are shown against where nothing was named."""
LEFT = {"direction": DIRECTION, "velocity": VELOCITY, "payload": LOAD, "position": POSE,
        "rotation": POSE, "time": TIME, "temperature": TEMPERATURE}
"""Names of inputs in :mod:`ppmcal.diagnosis.adequacy` -> inputs."""


@dataclass(frozen=True)
class Series:
    """Mean residual against one input.

    Attributes:
        effect: index into the diagnosis's effects; None: what is left, or nothing was named.
        role: ``effect``, ``left`` (what is left follows it) or ``recorded``.
        on: actuators whose joint errors are shown together; empty: ``coordinate`` is shown.
        coordinate: of the measured pose.
        input: ``direction``, ``load``, ``temperature``...; which: its component or actuator.
        input_quantity, quantity: of input and error, for units.
        bins: the means.
        period: of a folded input, 0 where it is not.
    """

    effect: int | None
    role: str
    on: tuple[str, ...]
    coordinate: str
    input: str
    which: str
    input_quantity: str
    quantity: str
    bins: Binned
    period: float = 0.0


class _Source:
    """Makes series from errors and inputs."""

    def __init__(
        self,
        mechanism: Mechanism,
        before: ProfileErrors,
        after: ProfileErrors,
        inputs: Inputs,
        row: Ints,
    ) -> None:
        self.mechanism, self.inputs, self.row = mechanism, inputs, row
        self.before, self.after = before, after

    def worst(self, errors: ProfileErrors) -> str:
        """Return the joint with the largest errors in units of the noise."""
        rms = np.nanmean((errors.joint / np.maximum(errors.sigma, 1e-300)) ** 2, axis=0)
        return self.mechanism.actuators[int(np.argmax(rms))]

    def joints(self, on: Sequence[str], follows: EffectInput, period: float = 0.0
               ) -> Series | None:
        """Return the errors of some joints together, against one input of theirs."""
        mechanism = self.mechanism
        at = [mechanism.actuators.index(a) for a in on]
        at = [a for a in at if mechanism.actuator_quantity[a]
              == mechanism.actuator_quantity[at[0]]]
        quantity = mechanism.actuator_quantity[at[0]]
        names = tuple(mechanism.actuators[a] for a in at)
        x, naming = self._input(follows, at, names, period)
        bins = binned(x.reshape(-1), self.before.joint[:, at].reshape(-1),
                      self.after.joint[:, at].reshape(-1), np.repeat(self.row, len(at)), naming)
        if bins is None:
            return None
        return Series(None, "", names, "", follows.name, "", resolved(follows.quantity, quantity),
                      quantity, bins, period)

    def _input(self, follows: EffectInput, at: list[int], names: tuple[str, ...], period: float
               ) -> tuple[Array, Callable[[float], str] | None]:
        """Return an input (N, len(at)), and how its classes are called."""
        values = follows.value(self.inputs)
        if values.ndim == 1:
            return np.broadcast_to(values[:, None], (len(self.row), len(at))), None
        x = values[:, at]
        if follows.classes:
            way = np.where(np.abs(x) == 1.0, x, np.nan)
            return np.asarray(4.0 * np.arange(len(at)) + way), lambda v: (
                f"{names[round(v / 4.0)]} {'+' if v - 4.0 * round(v / 4.0) > 0 else '−'}")
        return np.asarray(np.mod(x, period) if period else x), None

    def coordinate(self, c: int, follows: EffectInput, component: int = 0) -> Series | None:
        """Return one measured coordinate's error against one input of the machine."""
        values = follows.value(self.inputs).reshape(len(self.row), -1)[:, component]
        bins = binned(values, self.before.measured[:, c], self.after.measured[:, c], self.row)
        if bins is None:
            return None
        which, unit = follows.components[component] if follows.components else (
            "", follows.quantity)
        return Series(None, "", (), POSE_COORDINATES[c], follows.name, which, unit,
                      "length" if c < 3 else "angle", bins)

    def machine(self, follows: EffectInput, after: bool) -> list[Series]:
        """Return coordinates against a machine's input, those that follow it most.

        ``after``: by what is left after the effects, else by what was there before.
        """
        names = [name for name, _ in follows.components] or [""]
        there = range(len(names)) if follows is not POSE else self.mechanism.dof
        seen = [c for c in range(6) if np.isfinite(self.before.measured[:, c]).any()]
        found = [self.coordinate(c, follows, k) for c in seen for k in there
                 if not follows.own_component or POSE_COORDINATES[c] == names[k]]
        return _strongest([s for s in found if s], after, EACH)


def _strongest(series: Sequence[Series], after: bool, count: int) -> list[Series]:
    best = sorted(series, key=lambda s: -s.bins.strength(after))[:count]
    return [s for s in best
            if s.bins.strength(after) >= NOTICEABLE * best[0].bins.strength(after)]


def all_series(
    result: Diagnosis, before: ProfileErrors, after: ProfileErrors, inputs: Inputs, row: Ints
) -> tuple[Series, ...]:
    """Return the series of each named effect, of what is left, or of what was recorded."""
    source = _Source(result.identification.mechanism, before, after, inputs, row)
    out: list[Series] = []
    for n, effect in enumerate(result.effects):
        out += [_as(s, n, "effect") for s in _of_effect(source, effect, result)]
    left = result.remainder
    if left.p_value < FOLLOWED and not left.adequate:
        out += [_as(s, None, "left") for s in _of_remainder(source, left.follows)]
    if not out:
        out = [_as(s, None, "recorded") for s in _recorded(source)]
    return tuple(out[:MOST_SERIES])


def _as(s: Series, effect: int | None, role: str) -> Series:
    return Series(effect, role, s.on, s.coordinate, s.input, s.which, s.input_quantity,
                  s.quantity, s.bins, s.period)


def _of_effect(source: _Source, effect: NamedEffect, result: Diagnosis) -> list[Series]:
    kind = effect.hypothesis.effect
    follows = kind.input if kind is not None else TRAVEL
    if kind is not None and follows.of_machine and (follows.components or not kind.per_actuator):
        return source.machine(follows, False)
    on = effect.on or source.mechanism.actuators
    period = 0.0
    if kind is not None and kind.period:
        values = {e.name: e.value for e in result.identification.estimates}
        period = next((abs(values[p]) for p in effect.parameters
                       if p.endswith(f".{kind.period}") and p in values), 0.0)
        if period == 0.0:
            follows = TRAVEL
    found = source.joints(on, follows, period)
    return [found] if found else []


def _of_remainder(source: _Source, follows: str) -> list[Series]:
    """Return where what is left shows most, against what it follows."""
    if follows in source.mechanism.actuators:
        found = source.joints([follows], TRAVEL)
        return [found] if found else []
    left = LEFT.get(follows)
    if left is None:
        return []
    if left is POSE:  # something in one joint shows against that joint rather than the pose
        worst = source.joints([source.worst(source.after)], TRAVEL)
        return ([worst] if worst else []) + source.machine(left, True)[:1]
    found_all = [source.joints([a], left) for a in source.mechanism.actuators]
    return _strongest([s for s in found_all if s], True, EACH)


def _recorded(source: _Source) -> list[Series]:
    """Return the joint with the largest errors against everything that was recorded."""
    worst = source.worst(source.before)
    return [s for s in (source.joints([worst], follows) for follows in OF_JOINTS) if s]
