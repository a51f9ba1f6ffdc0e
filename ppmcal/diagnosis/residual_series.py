"""Residuals against the input that each named effect follows, before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.diagnosis.residual_profiles import Binned, Inputs, ProfileErrors, binned
from ppmcal.diagnosis.result import Diagnosis, NamedEffect
from ppmcal.linalg import Array, Ints
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism

MOST_SERIES = 12
EACH, NOTICEABLE = 2, 0.2
"""An effect of the whole machine is shown in so many coordinates, where it is strongest, and
further ones only where it is at least this part as strong."""
FOLLOWED = 0.05
"""What is left is shown against the input that it follows with such a p-value."""
FOLLOWS = {
    "backlash": "direction", "windup": "wound load", "compliance": "load", "clearance": "load",
    "leg_thermal": "temperature", "base_thermal": "temperature",
    "platform_thermal": "temperature", "drift": "time", "lag": "velocity", "gain": "travel",
    "curvature": "travel", "periodic": "phase", "eccentricity": "travel",
    "base_compliance": "wrench", "sensor_scale": "point", "tilt": "point", "geometry": "travel"}
"""The input that residuals follow, by kind of effect."""
OF_JOINTS = ("travel", "direction", "velocity", "load")
LEFT = {"direction": "direction", "velocity": "velocity", "payload": "load",
        "position": "pose", "rotation": "pose", "time": "time", "temperature": "temperature"}
"""Names of inputs in :mod:`ppmcal.diagnosis.adequacy` -> names here."""


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

    def joints(self, on: Sequence[str], name: str, period: float = 0.0) -> Series | None:
        """Return the errors of some joints together, against one input of theirs."""
        mechanism = self.mechanism
        at = [mechanism.actuators.index(a) for a in on]
        at = [a for a in at if mechanism.actuator_quantity[a]
              == mechanism.actuator_quantity[at[0]]]
        quantity = mechanism.actuator_quantity[at[0]]
        x, unit, naming = self._input(name, at, quantity, period)
        bins = binned(x.reshape(-1), self.before.joint[:, at].reshape(-1),
                      self.after.joint[:, at].reshape(-1), np.repeat(self.row, len(at)), naming)
        if bins is None:
            return None
        names = tuple(mechanism.actuators[a] for a in at)
        return Series(None, "", names, "", name, "", unit, quantity, bins, period)

    def _input(self, name: str, at: list[int], quantity: str, period: float
               ) -> tuple[Array, str, Callable[[float], str] | None]:
        """Return an input (N, len(at)), its quantity, and how its classes are called."""
        i = self.inputs
        load = {"length": "N", "angle": "N.m"}[quantity]
        shape = (len(self.row), len(at))
        if name == "direction":
            way = np.where(np.abs(i.approach[:, at]) == 1.0, i.approach[:, at], np.nan)
            names = [self.mechanism.actuators[a] for a in at]
            return np.asarray(4.0 * np.arange(len(at)) + way), "", lambda v: (
                f"{names[round(v / 4.0)]} {'+' if v - 4.0 * round(v / 4.0) > 0 else '−'}")
        if name == "wound load":
            return i.approach[:, at] * np.abs(i.load[:, at]), load, None
        if name == "phase":
            return np.asarray(np.mod(i.travel[:, at], period)), quantity, None
        if name in ("travel", "velocity", "load"):
            unit = {"travel": quantity, "velocity": f"{quantity}/s", "load": load}[name]
            return np.asarray(getattr(i, name))[:, at], unit, None
        values = {"temperature": i.temperature, "time": self._time()}[name]
        return np.broadcast_to(values[:, None], shape), {"temperature": "deg C", "time": "s"}[
            name], None

    def _time(self) -> Array:
        return self.inputs.time - float(np.nanmin(self.inputs.time)) if np.isfinite(
            self.inputs.time).any() else self.inputs.time

    def coordinate(self, c: int, name: str, component: int = 0) -> Series | None:
        """Return one measured coordinate's error against one input of the machine."""
        values = {"time": self._time()[:, None], "temperature": self.inputs.temperature[:, None],
                  "wrench": self.inputs.wrench, "pose": self.inputs.pose,
                  "point": self.inputs.point}[name][:, component]
        bins = binned(values, self.before.measured[:, c], self.after.measured[:, c], self.row)
        if bins is None:
            return None
        unit = {"time": "s", "temperature": "deg C", "wrench": "N" if component < 3 else "N.m"}
        place = "length" if component < 3 else "angle"
        which = {"wrench": ("fx", "fy", "fz", "mx", "my", "mz")[component],
                 "pose": POSE_COORDINATES[component],
                 "point": POSE_COORDINATES[component]}.get(name, "")
        return Series(None, "", (), POSE_COORDINATES[c], name, which, unit.get(name, place),
                      "length" if c < 3 else "angle", bins)

    def machine(self, name: str, after: bool) -> list[Series]:
        """Return coordinates against a machine's input, those that follow it most.

        ``after``: by what is left after the effects, else by what was there before.
        """
        of = {"wrench": range(6), "pose": self.mechanism.dof, "point": range(3)}.get(name, (0,))
        seen = [c for c in range(6) if np.isfinite(self.before.measured[:, c]).any()]
        found = [self.coordinate(c, name, k) for c in seen for k in of
                 if name != "point" or c == k]
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
    name = FOLLOWS.get(effect.kind, "travel")
    if name in ("time", "wrench", "point"):
        return source.machine(name, False)
    on = effect.on or source.mechanism.actuators
    period = 0.0
    if name == "phase":
        values = {e.name: e.value for e in result.identification.estimates}
        period = next((abs(values[p]) for p in effect.parameters if p.endswith(".period")
                       and p in values), 0.0)
        if period == 0.0:
            name = "travel"
    found = source.joints(on, name, period)
    return [found] if found else []


def _of_remainder(source: _Source, follows: str) -> list[Series]:
    """Return where what is left shows most, against what it follows."""
    if follows in source.mechanism.actuators:
        found = source.joints([follows], "travel")
        return [found] if found else []
    name = LEFT.get(follows, "")
    if name == "pose":  # something in one joint shows against that joint rather than the pose
        worst = source.joints([source.worst(source.after)], "travel")
        return ([worst] if worst else []) + source.machine(name, True)[:1]
    if not name:
        return []
    found_all = [source.joints([a], name) for a in source.mechanism.actuators]
    return _strongest([s for s in found_all if s], True, EACH)


def _recorded(source: _Source) -> list[Series]:
    """Return the joint with the largest errors against everything that was recorded."""
    worst = source.worst(source.before)
    names = (*OF_JOINTS, "temperature", "time")
    return [s for s in (source.joints([worst], name) for name in names) if s]
