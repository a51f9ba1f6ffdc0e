"""Residuals against the input of each named effect, before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ppmcal.calibration.fit import Z95
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
from ppmcal.model.mechanism import Mechanism, resolved
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.units import Quantity

MOST_SERIES = 12
EACH, NOTICEABLE = 2, 0.2
"""An effect of the whole machine is shown in at most this many coordinates, the strongest, and
beyond the first only if at least this part as strong."""
OF_JOINTS = (TRAVEL, DIRECTION, VELOCITY, LOAD, TEMPERATURE, TIME)
"""Inputs against which joint errors are shown if nothing was named."""
OF_UNIT, OF_INPUT = Quantity(of="unit", digits=6), Quantity(of="input_unit", digits=6)
OfUnit = Annotated[float, OF_UNIT]
Means = tuple[float | None, ...]


@dataclass(frozen=True)
class Series:
    """Mean errors in bins of one input, with half of their 95 % intervals.

    ``effect``: index into the diagnosis's effects, None if nothing was named. ``role``: ``effect``
    or ``recorded`` (``left`` in older files). The errors are those of the joints ``on`` or, without
    joints, of the measured ``coordinate``, in ``unit``; ``input``: ``direction``, ``load``...;
    ``which``: its component or actuator; ``x`` and, for a folded input, ``period`` are in
    ``input_unit``; ``names`` are those of classes.
    """

    effect: int | None
    role: str
    on: tuple[str, ...]
    coordinate: str
    input: str
    which: str
    input_unit: str
    unit: str
    period: Annotated[float | None, OF_INPUT]
    x: Annotated[Means, OF_INPUT]
    names: tuple[str, ...]
    count: tuple[int, ...]
    before: Annotated[Means, OF_UNIT]
    before_95: Annotated[Means, OF_UNIT]
    after: Annotated[Means, OF_UNIT]
    after_95: Annotated[Means, OF_UNIT]

    @classmethod
    def of(cls, follows: EffectInput, input_unit: str, unit: str, bins: Binned, which: str = "",
           on: tuple[str, ...] = (), coordinate: str = "", period: float = 0.0) -> Series:
        """Return the series of some bins, SI."""
        return cls(None, "", on, coordinate, follows.name, which, input_unit, unit, period or None,
                   tuple(bins.x), bins.names, tuple(bins.count.tolist()), tuple(bins.before),
                   tuple(bins.before_half), tuple(bins.after), tuple(bins.after_half))

    def strength(self, after: bool = False) -> float:
        """Return the mean square of the means over their standard errors: 1 for noise."""
        mean, half = np.array((self.after, self.after_95) if after else
                              (self.before, self.before_95), dtype=float)
        # values equal to the last digit show no noise
        seen = half > 1e-9 * np.abs(mean)
        if not seen.any():
            return 0.0
        return float(np.mean((Z95 * mean[seen] / half[seen]) ** 2))


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
        """Return the errors of some joints together, against one of their inputs."""
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
        return Series.of(follows, resolved(follows.quantity, quantity), quantity, bins, on=names,
                         period=period)

    def _input(self, follows: EffectInput, at: list[int], names: tuple[str, ...], period: float
               ) -> tuple[Array, Callable[[float], str] | None]:
        """Return an input (N, len(at)), and a function that names its classes."""
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
        return Series.of(follows, unit, "length" if c < 3 else "angle", bins, which,
                         coordinate=POSE_COORDINATES[c])

    def machine(self, follows: EffectInput, after: bool) -> list[Series]:
        """Return coordinates against an input of the machine, those that depend on it most.

        ``after``: judged by errors with the effects, otherwise without.
        """
        names = [name for name, _ in follows.components] or [""]
        there = range(len(names)) if follows is not POSE else self.mechanism.dof
        seen = [c for c in range(6) if np.isfinite(self.before.measured[:, c]).any()]
        found = [self.coordinate(c, follows, k) for c in seen for k in there
                 if not follows.own_component or POSE_COORDINATES[c] == names[k]]
        return _strongest([s for s in found if s], after, EACH)


def _strongest(series: Sequence[Series], after: bool, count: int) -> list[Series]:
    best = sorted(series, key=lambda s: -s.strength(after))[:count]
    return [s for s in best
            if s.strength(after) >= NOTICEABLE * best[0].strength(after)]


def all_series(
    result: Diagnosis, before: ProfileErrors, after: ProfileErrors, inputs: Inputs, row: Ints
) -> tuple[Series, ...]:
    """Return the series of each named effect, or of recorded inputs if nothing was named."""
    source = _Source(result.identification.mechanism, before, after, inputs, row)
    out: list[Series] = []
    for n, effect in enumerate(result.effects):
        out += [replace(s, effect=n, role="effect") for s in _of_effect(source, effect, result)]
    if not out:
        out = [replace(s, role="recorded") for s in _recorded(source)]
    return tuple(out[:MOST_SERIES])


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


def _recorded(source: _Source) -> list[Series]:
    """Return the joint with the largest errors against every recorded input."""
    worst = source.worst(source.before)
    return [s for s in (source.joints([worst], follows) for follows in OF_JOINTS) if s]
